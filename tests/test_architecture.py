"""ARCHITECTURE.md is true of the tree: what it names is there, no room is left out, and its words are few."""

from __future__ import annotations

import re
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


def test_the_glossary_has_at_most_thirty_words() -> None:
    words = re.findall(r"\*\*([a-z ]+)\*\*", MAP.split("## Words")[1])
    assert 20 <= len(set(words)) == len(words) <= 30
