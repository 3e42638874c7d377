"""The manual: its examples run, its links lead somewhere, and what it says of keys and verbs is what the code says.

`python tests/test_manual.py` writes the tables of keys, verbs and kinds of events.
"""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import cfgplan_runtime
import pytest
from cfgplan_runtime.lifecycle.kinds import KINDS, Level, Urgency, always
from cfgplan_runtime.lifecycle.perturbations import Perturbation
from cfgplan_runtime.lifecycle.reports import Report, Reviewed
from cfgplan_runtime.supervision.events import Event

import cfgplan
from cfgplan.cli import main
from cfgplan.cli.main import VERBS
from cfgplan.cli.manual import names, with_docstrings
from cfgplan.formats import fields
from cfgplan.formats.fields import ELEMENT, Part, Use

ROOT = Path(__file__).parent.parent
MANUAL = ROOT / "cfgplan" / "manual"
PAGES = sorted(MANUAL.glob("*.md"))
TEXT = {page.stem: page.read_text(encoding="utf-8") for page in PAGES}
PARTS: dict[str, type[Part]] = {
    "The environment": fields.EnvironmentPart,
    "A transformation": fields.TransformationPart,
    "Its `run`": fields.RunPart,
    "Its `conflicts`": fields.ConflictsPart,
    "An input": fields.InputPart,
    "An output": fields.OutputPart,
    "What it makes of a quality": fields.ContributionPart,
    "A quality by a fact": fields.CurvePart,
    "A unit": fields.UnitPart,
    "A target": fields.TargetPart,
    "What it asks of a quality": fields.WishPart,
    "A host": fields.HostPart,
    "A link": fields.LinkPart,
    "A quality attribute": fields.AttributePart,
    "A fact": fields.FactPart,
    "`defaults`": fields.DefaultsPart,
}
PACKAGES = {"cfgplan", "cfgplan_runtime"}
YAML_ONLY = (
    fields.ConflictsPart,
    fields.ContributionPart,
    fields.CurvePart,
    fields.WishPart,
    fields.HostPart,
    fields.LinkPart,
    fields.AttributePart,
    fields.FactPart,
)


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_the_tour_does_what_it_says(tmp_path: Path) -> None:
    library, running = blocks(TEXT["tutorial"], "yaml")[:2]
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


def test_every_page_is_in_the_index_once() -> None:
    groups = re.findall(r":caption: .*?\n\n(.*?)```", TEXT["index"], re.DOTALL)
    assert sorted(name for group in groups for name in group.split()) == sorted(TEXT.keys() - {"index"})


def test_the_reference_has_every_public_name_and_its_docstring() -> None:
    packages = (cfgplan, cfgplan_runtime)
    public = [f"{package.__name__}.{name}" for package in packages for name in package.__all__]
    assert sorted(names(TEXT["reference"])) == sorted(public)
    text = with_docstrings(TEXT["reference"])
    assert "cfgplan.load(" in text
    assert "Read the environment file" in text
    assert "* `OPTIMAL`: `optimal`" in text
    entries = re.split(r"(?m)^### |^\*\*Example", text)
    undocumented = [entry for entry in entries if re.fullmatch(r"\w+\s+```python[^`]*```\s+", entry)]
    assert undocumented == []


@pytest.mark.parametrize("section", TEXT["reference"].split("\n## ")[1:], ids=lambda text: text.partition("\n")[0])
def test_an_example_uses_each_name_of_its_section(section: str) -> None:
    """`tests/test_code_blocks.py` runs the examples."""
    examples = "\n".join(blocks(section, "python"))
    listed = [name.rpartition(".")[2] for name in names(section)]
    assert listed
    assert [name for name in listed if not re.search(rf"\b{name}\b", examples)] == []


def test_the_page_on_what_is_public_lists_the_names_that_each_package_hands_out() -> None:
    rows = re.findall(r"\| `(cfgplan[\w.]*)` \| (.*) \|", TEXT["public"])
    listed = {package: re.findall(r"`(\w+)`", names) for package, names in rows}
    assert listed == {package: sorted(import_module(package).__all__) for package in listed}
    assert {"cfgplan", "cfgplan.matching", "cfgplan.testing", "cfgplan_runtime", "cfgplan_runtime.testing"} <= set(
        listed
    )


def test_a_package_that_hands_out_names_lazily_or_by_a_list_is_on_the_page() -> None:
    """A new `__all__` is a promise: it stands on the page, or in this list."""
    inner = {"cfgplan.cli", "cfgplan.comparing", "cfgplan.validity"}
    found = set()
    for top in (ROOT / "cfgplan", ROOT / "runtime" / "cfgplan_runtime"):
        for path in top.rglob("*.py"):
            if re.search(r"^__all__\b", path.read_text(encoding="utf-8"), re.MULTILINE):
                found.add(".".join(path.relative_to(top.parent).with_suffix("").parts).removesuffix(".__init__"))
    assert found - inner == set(re.findall(r"\| `(cfgplan[\w.]*)` \|", TEXT["public"]))


def test_code_of_the_manual_imports_public_names_or_those_that_are_said_not_to_be() -> None:
    rows = re.findall(r"\| `(cfgplan[\w.]*)` \| (.*) \|", TEXT["public"])
    public = {f"{package}.{name}" for package, names in rows for name in re.findall(r"`(\w+)`", names)}
    (said,) = re.findall(r"^Examples on the pages (.*)$", TEXT["public"], re.MULTILINE)
    excepted, pages = re.findall(r"`([\w.]+)`", said), re.findall(r"\((\w+)\.md\)", said)
    others = set[tuple[str, str]]()
    for page, text in TEXT.items():
        for block in blocks(text, "python"):
            for found in ast.walk(ast.parse(block)):
                if isinstance(found, ast.ImportFrom) and (found.module or "").partition(".")[0] in PACKAGES:
                    imported = {f"{found.module}.{each.name}" for each in found.names}
                    others |= {(page, name) for name in imported - public}
    assert {name for page, name in others if not name.startswith(tuple(f"{each}." for each in excepted))} == set()
    assert sorted({page for page, _ in others}) == pages


def test_what_the_page_on_trouble_quotes_is_said_somewhere() -> None:
    code = "".join(
        path.read_text(encoding="utf-8") for room in ("cfgplan", "runtime") for path in (ROOT / room).rglob("*.py")
    )
    symptoms = [line.split("|")[1] for line in TEXT["troubleshooting"].splitlines() if line.startswith("| ")]
    quoted = [quote for symptom in symptoms for quote in re.findall(r'"(.*?)"', symptom)]
    assert len(quoted) > 5
    assert [quote for quote in quoted if quote not in code] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_of_the_manual_lead_somewhere(page: Path) -> None:
    for link, heading in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", TEXT[page.stem]):
        if "://" in link:
            continue
        target = (MANUAL / link) if link else page
        assert target.exists(), link
        assert not heading or heading in anchors(target.read_text(encoding="utf-8")), f"{link}#{heading}"


def anchors(text: str) -> set[str]:
    """The ids that headings get: small letters, dashes for spaces, no other marks."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [page for page in PAGES if page.stem != "index"], ids=lambda page: page.stem)
def test_a_page_is_shown_in_the_terminal(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", page.stem]) == 0
    assert TEXT[page.stem].partition("\n")[0].removeprefix("# ") in capsys.readouterr().out


def test_the_pages_are_listed_and_a_misspelt_one_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    listed = capsys.readouterr().out
    assert all(page in listed for page in TEXT.keys() - {"index"})
    assert listed.index("tutorial") < listed.index("environment"), "in the order of the index"
    assert main(["help", "tutorail"]) == 30
    assert "did you mean `tutorial`?" in capsys.readouterr().err


def tables() -> str:
    """The tables of all keys, made from the rows of the fields."""
    text = ""
    for title, part in PARTS.items():
        text += f"\n### {title}\n\n| key | meaning | default | XML | for |\n|---|---|---|---|---|\n"
        for key, row in part.rows().items():
            field = part.all_keys()[key]
            default = "required" if field.default is ... else _default(row.default)
            xml = "no" if not row.xml or part in YAML_ONLY else "element" if row.xml == ELEMENT else f"`{row.xml}`"
            uses = ", ".join(str(use.name).lower() for use in (Use.PLANNING, Use.RUNNING) if use in row.use)
            text += f"| `{key}` | {field.meaning} | {default} | {xml} | {uses} |\n"
    return text


def _default(value: object) -> str:
    """A default as the file would say it; empty for one that only the meaning of the key tells."""
    if isinstance(value, list):
        return f"`[{', '.join(map(str, value))}]`" if value else ""
    if value is None or value in ("", {}):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def verbs() -> str:
    return "".join(f"| `cfgplan {verb}` | {does} |\n" for verb, does in VERBS.items())


def kinds_of(*families: type[object]) -> str:
    """The rows of the kinds of some families, made from their docstrings and the table of what happens."""
    text = ""
    for of, row in KINDS.items():
        if row.urgency is Urgency.SIGN or not issubclass(of, families):
            continue
        levels = [row.level] if row.is_grave is always else [row.level, Level.INFORMATION]
        level = " or ".join(each.name.lower() for each in levels)
        fields_ = "see below" if of is Reviewed else ", ".join(f"`{name}`" for name in of.__struct_fields__)
        text += f"| `{of.__name__}` | {level} | {fields_} | {' '.join(str(of.__doc__).split()).removesuffix('.')} |\n"
    return text


def made_anew() -> dict[str, str]:
    """The pages with tables, these made from the code."""
    before, _, _ = TEXT["environment"].partition(f"\n### {next(iter(PARTS))}\n")
    environment = before + tables()
    commands = re.sub(r"(?<=\| command \| does \|\n\|---\|---\|\n)(\|.*\n)*", verbs(), TEXT["commands"])
    rows = r"(?<=\| {} \| level \| fields \| meaning \|\n\|---\|---\|---\|---\|\n)(\|.*\n)*"
    events = TEXT["events"]
    for name, families in {"event": (Event, Report), "perturbation": (Perturbation,)}.items():
        events = re.sub(rows.format(name), kinds_of(*families).replace("\\", r"\\"), events)
    return {"environment": environment, "commands": commands, "events": events}


@pytest.mark.parametrize("page", made_anew())
def test_tables_say_what_the_code_says(page: str) -> None:
    assert TEXT[page] == made_anew()[page], "run `python tests/test_manual.py`"


def test_every_key_of_run_is_explained() -> None:
    rows = [line.split("|")[1] for line in TEXT["runtime"].splitlines() if line.startswith("| ")]
    assert {*fields.RunPart.all_keys()} <= set(re.findall(r"`(\w+)`", "\n".join(rows)))


if __name__ == "__main__":
    for name, text in made_anew().items():
        (MANUAL / f"{name}.md").write_text(text, encoding="utf-8")
