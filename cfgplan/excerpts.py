"""The line that a fault is about, of a file or of the command line, with a caret under the place."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from cfgplan.errors import Fault

_WIDTH = 120
_MARGIN = 40
"""The most characters of a long line that are shown before the place."""
_MARKED_WORD = re.compile(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'|\$\{[^}]*\}|[^\s,:{}\[\]()"\']+|\S')
_OPTION = re.compile(r"(?:^|argument |\s)(--?[\w-]+)")
_VALUE = re.compile(r"^argument [^:]*: (\S+)")
_QUOTED = re.compile(r"`([^`]+)`|'([^']*)'")
_MISSING = "the following arguments are required"


class Excerpt(NamedTuple):
    """A line of a text, and a place in it: `length` characters from `column` on, counted from 0."""

    line: str
    column: int
    length: int
    number: int | None = None
    """The line's number in its file; None for the command line."""


def excerpt(fault: Fault, command: Sequence[str]) -> Excerpt | None:
    """The line that a fault is about; None if it is about no line that can be shown."""
    if fault.file is not None and fault.line is not None:
        return _of_file(fault.file, fault.line, fault.column, fault.message)
    return _of_command(fault, command) if fault.line is None and command else None


def _of_file(file: str, number: int, column: int | None, message: str) -> Excerpt | None:
    try:
        if not Path(file).is_file():  # a pipe can't be read twice
            return None
        with Path(file).open(encoding="utf-8-sig", errors="replace") as text:
            line = next(islice(text, number - 1, number), None)
    except (OSError, ValueError):
        return None
    if line is None:
        return Excerpt("", 0, 1, number)
    line = line.rstrip("\r\n")
    if column is None:
        start = len(line) - len(line.lstrip())
        return Excerpt(line, start, max(1, len(line) - start), number)
    if column > len(line) + 1:
        return None
    word = _MARKED_WORD.match(line, column - 1)
    told = [one or other for one, other in _QUOTED.findall(message)]
    texts = [word[0] if word else " ", *(text for text in told if line.startswith(text, column - 1))]
    return Excerpt(line, column - 1, max(map(len, texts)), number)


def _of_command(fault: Fault, words: Sequence[str]) -> Excerpt | None:
    quoted = [shlex.quote(word) for word in words]
    line = " ".join(["cfgplan", *quoted])
    if fault.message.startswith(_MISSING):
        return Excerpt(line, len(line) + 1, 1)
    at = _named(fault, words)
    if at is None:
        return None
    return Excerpt(line, len(" ".join(["cfgplan", *quoted[:at], ""])), len(quoted[at]))


def _named(fault: Fault, words: Sequence[str]) -> int | None:
    """The position of the word of a command line that a fault is about; None if there is none."""
    if "" in words and "empty" in fault.message:
        return words.index("")
    told = [one or other for one, other in _QUOTED.findall(fault.message)]
    told += [*_VALUE.findall(fault.message), *_option_of(fault)[1:]]
    for name in _options(fault):
        for at, word in enumerate(words):
            if word.partition("=")[0] == name and name:
                after = words[at + 1 : at + 2]
                return at + 1 if after and any(each and each in after[0] for each in told) else at
    unknown = fault.message.partition("unrecognized arguments: ")[2].split()[:1]
    for name in (fault.file or "", *unknown, *told):
        for at, word in enumerate(words):
            if name and name in (word, *word.partition("=")[::2]):
                return at
    return None


def _options(fault: Fault) -> Iterator[str]:
    """The options that a fault names, in the order in which it names them."""
    yield from _option_of(fault)[:1]
    yield from _OPTION.findall(fault.message)


def _option_of(fault: Fault) -> list[str]:
    """The option that stands for a fault's file or key, and its value; empty without one."""
    return next((each.split() for each in (fault.file, fault.key) if each is not None and each.startswith("-")), [])


def drawn(found: Excerpt) -> tuple[str, str, str]:
    """Three texts to print: the line with its number, the space below it, and the carets."""
    from rich.cells import cell_len

    margin = f"{found.number:>5} | " if found.number is not None else "    $ "
    first = max(0, found.column - _MARGIN) if len(found.line) > _WIDTH else 0
    shown = found.line[first : first + _WIDTH]
    before = "".join(_plain(one) for one in found.line[first : found.column])
    within = "".join(_plain(one) for one in shown[found.column - first :][: found.length])
    line = "".join(map(_plain, shown))
    below = " " * 5 + " | " if found.number is not None else " " * 6
    space = " " * (cell_len(before) + (found.column > len(found.line)))
    cut, cut_space = ("...", "   ") if first else ("", "")
    return f"{margin}{cut}{line}".rstrip(), f"{below}{cut_space}{space}", "^" * max(1, cell_len(within))


def _plain(character: str) -> str:
    """A character as one of a terminal's that it would not obey."""
    return character if character.isprintable() else " "
