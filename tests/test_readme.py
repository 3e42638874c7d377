"""What the README shows is what happens; the keys of the environment file are those of its fields.

`python tests/test_readme.py` writes the tables of keys anew.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import cfgplan
from cfgplan.cli import main
from cfgplan.formats import fields
from cfgplan.formats.fields import ELEMENT, Part, Use

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
KEYS = ROOT / "cfgplan" / "formats" / "README.md"
PARTS: dict[str, type[Part]] = {
    "The environment": fields.EnvironmentPart,
    "A transformation": fields.TransformationPart,
    "Its `run`": fields.RunPart,
    "Its `conflicts`": fields.ConflictsPart,
    "An input": fields.InputPart,
    "An output": fields.OutputPart,
    "What it makes of a quality": fields.ContributionPart,
    "A unit": fields.UnitPart,
    "A target": fields.TargetPart,
    "What it asks of a quality": fields.WishPart,
    "A host": fields.HostPart,
    "A link": fields.LinkPart,
    "A quality attribute": fields.AttributePart,
    "`defaults`": fields.DefaultsPart,
}
YAML_ONLY = (
    fields.ConflictsPart,
    fields.ContributionPart,
    fields.WishPart,
    fields.HostPart,
    fields.LinkPart,
    fields.AttributePart,
)


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_first_command_ends_with_what_the_readme_shows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    job = blocks("sh")[0].split(" && ")[-1].split()
    assert job[0].endswith("/cfgplan")
    assert main(job[1:]) == 0
    assert blocks("text")[0].strip("\n") in capsys.readouterr().out


def test_the_tour_does_what_it_says(tmp_path: Path) -> None:
    library, running = blocks("yaml")[:2]
    env = tmp_path / "office.yaml"

    env.write_text(library)
    first = cfgplan.plan(cfgplan.match(cfgplan.load(env))).change_set
    assert first is not None
    assert [unit.id for unit in first.started] == ["camera.1", "fire_alarm.1", "thermometer.1"]

    env.write_text(library + running)
    problem = cfgplan.match(cfgplan.load(env))
    assert [v.rule.name for v in cfgplan.violations(problem.environment, problem.similarity)] == ["FED"]
    second = cfgplan.plan(problem).change_set
    assert second is not None
    assert [unit.id for unit in second.started] == ["thermometer.1"]
    assert [unit.id for unit in second.rewired] == ["fire_alarm.1"]
    assert second.stopped == ()


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_the_python_examples_run(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(blocks("python")[number], names)
    plan = names["plan"]
    assert isinstance(plan, cfgplan.Plan)
    assert plan.status is cfgplan.Status.OPTIMAL


def test_every_file_that_the_readme_links_to_is_there() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert "://" in link or (ROOT / link).exists(), link


def tables() -> str:
    """The tables of all keys, made from the rows of the fields."""
    text = ""
    for title, part in PARTS.items():
        text += f"\n### {title}\n\n| key | meaning | if absent | XML | for |\n|---|---|---|---|---|\n"
        for key, row in part.rows().items():
            field = part.model_fields[key]
            absent = "not allowed" if field.is_required() else f"`{row.default}`" if row.default else ""
            xml = "no" if not row.xml or part in YAML_ONLY else "element" if row.xml == ELEMENT else f"`{row.xml}`"
            uses = ", ".join(str(use.name).lower() for use in (Use.PLANNING, Use.RUNNING) if use in row.use)
            text += f"| `{key}` | {field.description} | {absent} | {xml} | {uses} |\n"
    return text


def test_every_key_of_the_environment_file_is_in_its_table() -> None:
    _, _, found = KEYS.read_text(encoding="utf-8").partition("\n###")
    assert "\n###" + found == tables(), "run `python tests/test_readme.py`"


if __name__ == "__main__":
    KEYS.write_text(KEYS.read_text(encoding="utf-8").partition("\n###")[0] + tables(), encoding="utf-8")
