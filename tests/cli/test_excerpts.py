"""The line of a fault with its caret: long lines, wide and odd characters, places that are not there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from command import Run

from cfgplan.errors import Fault
from cfgplan.excerpts import drawn, excerpt


def shown(fault: Fault, command: Sequence[str] = ()) -> list[str] | None:
    """The two lines that are printed; None if nothing is."""
    found = excerpt(fault, command)
    if found is None:
        return None
    line, space, carets = drawn(found)
    return [line, space + carets]


def in_file(path: Path, text: str, line: int, column: int | None) -> list[str] | None:
    path.write_text(text, encoding="utf-8")
    return shown(Fault("no", str(path), line, column))


@pytest.mark.parametrize(
    ("text", "place", "lines"),
    [
        ("a: 1\nb: two words\n", (2, 4), ["    2 | b: two words", "      |    ^^^"]),
        ("a: 'two words'\n", (1, 4), ["    1 | a: 'two words'", "      |    ^^^^^^^^^^^"]),
        ("a: ${Room:b}x\n", (1, 4), ["    1 | a: ${Room:b}x", "      |    ^^^^^^^^^"]),
        ("\tb: 2\n", (1, 1), ["    1 |  b: 2", "      | ^"]),
        ("a: 厨房 x\n", (1, 7), ["    1 | a: 厨房 x", "      |         ^"]),
        ("a: 厨房 x\n", (1, 4), ["    1 | a: 厨房 x", "      |    ^^^^"]),
        ("a: \x1b[31mx\n", (1, 4), ["    1 | a:  [31mx", "      |    ^"]),
        ("\ufeffa: x\n", (1, 4), ["    1 | a: x", "      |    ^"]),
        ("a: x", (1, 5), ["    1 | a: x", "      |     ^"]),
        ("a: x\n", (2, 1), ["    2 |", "      | ^"]),
        ("  a: x\n", (1, None), ["    1 |   a: x", "      |   ^^^^"]),
        ("a: x\n", (1, 99), None),
    ],
)
def test_the_caret_stands_under_the_word_of_the_place(
    tmp_path: Path, text: str, place: tuple[int, int | None], lines: list[str] | None
) -> None:
    assert in_file(tmp_path / "env.yaml", text, *place) == lines


def test_of_a_long_line_the_part_around_the_place_is_shown(tmp_path: Path) -> None:
    line, carets = in_file(tmp_path / "env.json", "x" * 500 + " here " + "y" * 500, 1, 502) or []
    assert len(line) < 140
    assert line[carets.index("^") :].startswith("here ")
    assert carets.strip(" |") == "^^^^"


@pytest.mark.parametrize("file", ["nowhere.yaml", "/dev/stdin", "a\0b", "."])
def test_a_file_that_is_not_there_or_can_be_read_only_once_has_no_line(file: str) -> None:
    assert shown(Fault("no", file, 1, 1)) is None


@pytest.mark.parametrize(
    ("fault", "command", "marked"),
    [
        (Fault("it is so", file="a b.yaml"), ["solve", "a b.yaml"], "'a b.yaml'"),
        (Fault("argument --horizon: 'x' is not a horizon"), ["solve", "e", "--horizon=x"], "--horizon=x"),
        (Fault("there is no planner `x`"), ["solve", "e", "--planner=x"], "--planner=x"),
        (Fault("there is no unit `x`"), ["solve", "e"], None),
        (Fault("it is so", line=3), ["solve", "e"], None),
        (Fault("it is so"), [], None),
    ],
)
def test_the_caret_stands_under_the_word_of_the_command(fault: Fault, command: list[str], marked: str | None) -> None:
    lines = shown(fault, command)
    assert (None if lines is None else lines[0][lines[1].index("^") : len(lines[1])]) == marked


def test_a_fault_of_an_included_file_shows_the_line_of_that_file(run: Run, tmp_path: Path) -> None:
    (tmp_path / "part.json").write_text('{"transformations": [{"label": "a", "upkep": 1}]}')
    (tmp_path / "env.yaml").write_text("format: cfgplan/1\ninclude: part.json\n")
    err = run("check", tmp_path / "env.yaml").err
    assert '    1 | {"transformations": [{"label": "a", "upkep": 1}]}\n' in err
    assert f"      | {' ' * 36}{'^' * 7}\n" in err


def test_a_name_before_an_equals_sign_is_marked_with_its_value() -> None:
    shown_lines = shown(Fault("there is no fact `x`"), ["ctl", "fact", "x=1"])
    assert shown_lines == ["    $ cfgplan ctl fact x=1", "                       ^^^"]
