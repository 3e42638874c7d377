"""What the README shows is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import cfgplan
from cfgplan.cli import main

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


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
