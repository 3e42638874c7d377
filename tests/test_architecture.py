"""ARCHITECTURE.md is true of the tree: what it names is there, no room is left out, and its words are few."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import FrameType

import pytest

from cfgplan.cli import main

ROOT = Path(__file__).parent.parent
MAP = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
FILES = {path.relative_to(ROOT).as_posix() for room in ("cfgplan", "runtime", "tests", "experiments", "models")
         for path in (ROOT / room).rglob("*.*")}  # fmt: skip
NAMED = sorted(set(re.findall(r"`(?:python )?(?:\.\./)?([\w/]+\.(?:py|yaml|md))`", MAP)))
ROOMS = sorted({path.parent.name for place in ("cfgplan", "runtime/cfgplan_runtime")
                for path in (ROOT / place).glob("*/__init__.py")})  # fmt: skip


@pytest.mark.parametrize("name", NAMED)
def test_a_file_on_the_map_is_there(name: str) -> None:
    assert any(f"/{file}".endswith(f"/{name}") for file in FILES)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_is_on_the_map(room: str) -> None:
    assert re.search(rf"\b{room}\b", MAP.split("```mermaid")[1].split("```")[0])


STEPS = {
    "formats/document.py": "read_document",
    "formats/fields.py": "values",
    "matching/ontology_files.py": "load_ontology",
    "formats/assembly.py": "build",
    "matching/matrix.py": "match",
    "planners/exact/stages.py": "decide_all",
    "validity/plans.py": "plan_violations",
    "cli/plan_text.py": "update_text",
}
"""What is done on the way of an environment file, by file."""
BESIDE_THE_WAY = {"cli/main.py", "api.py", "arguments.py", "planners/solving/clock.py"}
"""The command's finder, what joins the rooms, what checks arguments, and the lists that time limits."""


def test_solve_goes_through_the_twelve_files_that_the_map_names(capsys: pytest.CaptureFixture[str]) -> None:
    way: set[str] = set()
    ahead = dict(STEPS)
    rooms = f"{ROOT}/cfgplan/"

    def note(frame: FrameType | None, event: str, _: object) -> None:
        assert frame is not None
        name = frame.f_code.co_filename.removeprefix(rooms)
        if event == "call" and ahead.get(name) == frame.f_code.co_name:
            del ahead[name]
            while frame is not None:
                way.add(frame.f_code.co_filename)
                frame = frame.f_back

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        assert main(["solve", str(ROOT / "models/nao/2-segmenter-lost.yaml")]) == 0
    finally:
        sys.setprofile(before)
    assert "Optimal" in capsys.readouterr().out
    files = {path.removeprefix(rooms) for path in way if path.startswith(rooms)} - BESIDE_THE_WAY
    told = MAP.split("## The way of an environment file")[1].split("## The way of a perturbation")[0]
    named = set(re.findall(r"`([\w/]+\.py)`", told))
    assert not ahead
    assert [file for file in sorted(files) if not any(f"/{file}".endswith(f"/{name}") for name in named)] == []
    assert len(files) <= 12


def test_the_glossary_has_at_most_thirty_words() -> None:
    words = re.findall(r"\*\*([a-z ]+)\*\*", MAP.split("## Words")[1])
    assert 20 <= len(set(words)) == len(words) <= 30
