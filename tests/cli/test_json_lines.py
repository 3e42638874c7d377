"""Errors and series of results with `--json`: each line is one JSON value, however a program splits text into lines."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from typing import Any, NoReturn

import pytest
from command import Run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfgplan.cli.main import VERBS, parser_with
from cfgplan.cli.screen import json_line
from cfgplan.errors import InputError

BREAKS = "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"
"""The characters at which `str.splitlines` splits."""
BAD_NUMBERS = ["-3", "nan", "1e999999", "", "x\u2028y", "\x85"]
BAD_FILES = ["absent.yaml", "a\u2028b.yaml", "broken.yaml", "lines.yaml", "folder", "", "x\x00y"]


def commands(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The words of each command that has `--json`."""
    inner = [each for each in parser._actions if isinstance(each, argparse._SubParsersAction)]
    for action in inner:
        for name, command in action.choices.items():
            yield from commands(command, (*words, name))
    if not inner and "--json" in parser._option_string_actions:
        yield words


COMMANDS = list(commands(parser_with(VERBS)))


def parser_of(words: tuple[str, ...]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = parser_with((words[0],))
    for word in words:
        (choices,) = (each.choices for each in parser._actions if isinstance(each, argparse._SubParsersAction))
        parser = choices[word]
    return parser


def refuse(text: str) -> NoReturn:
    raise ValueError(f"{text} is not in JSON")


def values(out: str) -> list[Any]:
    return [json.loads(line, parse_constant=refuse) for line in out.splitlines()]


def refused(option: argparse.Action) -> list[str]:
    """The words that are no value of an option; the empty one is never a value."""
    return [word for word in BAD_NUMBERS if not word or not is_value(option, word)]


def is_value(option: argparse.Action, word: str) -> bool:
    try:
        if callable(option.type):
            option.type(word)
    except (argparse.ArgumentTypeError, InputError, TypeError, ValueError):
        return False
    return True


@st.composite
def bad_commands(draw: st.DrawFn) -> list[str]:
    """A command with bad files for its operands, or with an option that is unknown or has a bad value."""
    command = draw(st.sampled_from(COMMANDS))
    parser = parser_of(command)
    operands = [each for each in parser._actions if not each.option_strings]
    valued = [each for each in parser._actions if each.option_strings and each.nargs is None]
    words = [draw(st.sampled_from(BAD_FILES)) for each in operands if each.required or draw(st.booleans())]
    bad = {"--bogus": BAD_NUMBERS, **{each.option_strings[-1]: refused(each) for each in valued}}
    options = draw(st.lists(st.sampled_from([*bad]), max_size=2))
    words += [f"{option}={draw(st.sampled_from(bad[option]))}" for option in options]
    return [*command, "--json", *(words or ["--bogus"])]


@settings(max_examples=180, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(command=bad_commands())
def test_each_line_of_an_error_is_a_json_value(
    command: list[str], run: Run, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Errors once were a document of several lines, among the lines of a series."""
    folder = tmp_path_factory.mktemp("bad")
    (folder / "folder").mkdir()
    (folder / "broken.yaml").write_text("format: cfgplan/1\ntransformations: {a\u2028: [}\n", encoding="utf-8")
    (folder / "lines.yaml").write_text('format: "a\\u2028b\\x85"\ntransformations: "x\\ny"\n', encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        code, out, err = run(*command)
    assert code == 30, out + err
    assert "Traceback" not in out + err
    (error,) = values(out)
    assert all(fault["message"] for fault in error["errors"])


def test_numbers_that_json_lacks_are_null() -> None:
    """A reader of `listen --json` once got `Infinity`, which laser scans have where they see nothing."""
    scan = {"ranges": [1.5, float("inf")], "angle": float("nan")}
    assert values(json_line({"value": scan})) == [
        {"format_version": 1, "value": {"ranges": [1.5, None], "angle": None}}
    ]


@given(st.text(st.sampled_from(BREAKS + "aé\ud800")))
def test_a_text_breaks_no_line(text: str) -> None:
    assert values(json_line({text: text})) == [{"format_version": 1, text: text}] or text == "format_version"
