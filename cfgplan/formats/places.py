"""Places in a file: paths of keys, and the lines and columns that they lead to."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from cfgplan.errors import Fault
from cfgplan.frozen import dataclass

DEEPEST_NESTING = 64
"""Documents nested deeper are refused."""

Path: TypeAlias = tuple[str | int, ...]
"""Keys and list positions from the document's root, such as `("transformations", 3, "inputs")`."""


class Place(NamedTuple):
    """A file, and a line and a column in it that count from 1."""

    file: str
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Spot:
    """A key or value in a file's text.

    `text` is a scalar as it was written, without quotes. `text_column` is the column of its first
    character if the whole scalar stands literally on that line, so that columns inside of it add up.
    """

    line: int
    column: int
    text: str | None = None
    text_column: int | None = None


Locate: TypeAlias = Callable[[Path, bool], Spot]
"""Finds the value at a path or, if the flag is set, its key; the nearest value above if the path leads nowhere."""


@dataclass(frozen=True)
class Source:
    """A file that was read: plain data, syntax faults, and a way back to its text.

    Positions are computed only on demand, for an error message. If it `is_plain`, no text in it has a `$`.
    """

    file: str
    data: object
    locate: Locate
    faults: tuple[Fault, ...] = ()
    is_plain: bool = False

    def fault(
        self, path: Path, message: str, mend: str | None = None, *, at_key: bool = False, text_column: int | None = None
    ) -> Fault:
        """A fault at a path; `text_column` counts from 1 inside the text that stands there."""
        spot = self.locate(path, at_key)
        column = spot.column
        if text_column is not None and spot.text_column is not None:
            column = spot.text_column + text_column - 1
        return Fault(message, self.file, spot.line, column, key_text(path) or None, mend)


class Passage(NamedTuple):
    """A value in a file: its place, and the list for its faults."""

    source: Source
    path: Path
    faults: list[Fault]

    def at(self, *steps: str | int) -> Passage:
        """The inner passage, by keys and positions."""
        return Passage(self.source, (*self.path, *steps), self.faults)

    def note(
        self, message: str, mend: str | None = None, *, at_key: bool = False, text_column: int | None = None
    ) -> None:
        """Add a fault of this value, or of its key; `text_column` counts from 1 inside its text."""
        self.faults.append(self.source.fault(self.path, message, mend, at_key=at_key, text_column=text_column))

    @property
    def place(self) -> Place:
        """Where the value begins."""
        spot = self.source.locate(self.path, False)
        return Place(self.source.file, spot.line, spot.column)


def has_no_dollar(text: str) -> bool:
    """Whether no value of a file's text can have a `$`, not even by an escape."""
    return "$" not in text and "\\" not in text


def key_text(path: Path) -> str:
    """A path as people write it: `transformations[3].inputs.image.tag`."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text
