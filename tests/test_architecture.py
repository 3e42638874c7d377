"""ARCHITECTURE.md is true of the tree: what it names is there, no room is left out, and its words are few."""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

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


ENTERED = """
import sys
from pathlib import Path
import cfgplan
from cfgplan.cli import main

room, files = f"{Path(cfgplan.__file__).parent}/", set()

def note(frame, event, _):
    if event == "call" and frame.f_code.co_filename.startswith(room):
        files.add(frame.f_code.co_filename.removeprefix(room))

main(["solve", sys.argv[1]])
sys.setprofile(note)
main(["solve", sys.argv[1]])
sys.setprofile(None)
print("entered", *sorted(files))
"""
"""Which files of the product `solve` enters, once all that it needs is imported."""
WAY = MAP.split("## The way of an environment file")[1].split("## The way of a perturbation")[0]


@cache
def entered(world: str) -> list[str]:
    """The files that `solve` enters for a world of `models/`."""
    command = [sys.executable, "-c", ENTERED, str(ROOT / "models" / world)]
    out = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    return out.splitlines()[-1].split()[1:]


PLAIN, FLEET = "nao/2-segmenter-lost.yaml", "nao/7-robot-may-fail.yaml"


def test_solve_enters_as_many_files_as_the_map_says() -> None:
    """For a plain problem and, in brackets, for a fleet: in all, and of each room."""
    in_all = re.search(r"enters about (\d+) files of the product \((\d+) for a fleet\)", WAY)
    of_rooms = {name: numbers for *numbers, name in re.findall(r"(\d+) \((\d+)\) of `(\w+)`", WAY)}
    assert in_all is not None
    assert len(of_rooms) == 5
    for place, world in enumerate((PLAIN, FLEET)):
        for name, told in {"": in_all.groups(), **of_rooms}.items():
            files = [file for file in entered(world) if file.startswith(f"{name}/" if name else "")]
            said = f"the map says {told[place]} of {name or 'all'}, but {len(files)}: {files}"
            assert abs(len(files) - int(told[place])) <= len(files) // 10, said


ONLY_FOR = {
    ".": ("facts", "observers"),
    "planners/exact": (
        "answer_sets",
        "deployment",
        "fleet",
        "first_plans",
        "required",
        "quality",
        "search",
        "survival",
        "model",
    ),
    "validity": ("counts", "hosts", "quality", "survival", "rewiring", "startable"),
}


@pytest.mark.parametrize("room", ONLY_FOR)
def test_a_plain_problem_enters_no_file_that_only_others_need(room: str) -> None:
    named = {(Path(room) / f"{name}.py").as_posix() for name in ONLY_FOR[room]}
    assert {f"cfgplan/{file}" for file in named} <= FILES
    assert named.isdisjoint(entered(PLAIN))
    assert not named.isdisjoint(entered(FLEET))


def test_solve_enters_each_file_that_the_map_names_as_a_station() -> None:
    files = entered(PLAIN)
    stations = [
        name for name in re.findall(r"`([\w/]+\.py)`", WAY) if name.startswith(("cli/", "formats/", "validity/"))
    ]
    assert len(stations) > 5
    assert {name for name in stations if name not in files} == {
        "formats/plan_file.py",  # it writes what --out asks for
        "formats/models.py",  # it says why a value is refused
    }


def test_the_glossary_has_at_most_thirty_words() -> None:
    words = re.findall(r"\*\*([a-z ]+)\*\*", MAP.split("## Words")[1])
    assert 20 <= len(set(words)) == len(words) <= 30
