"""Unit code for the conformance kit: each way to end leaves a mark in the folder `notes`."""

from __future__ import annotations

import atexit
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def mark(notes: str, name: str) -> None:
    with (Path(notes) / name).open("a") as file:
        file.write(".")


def generator(notes: str) -> Iterator[int]:
    """0, 1, 2, ... until it is closed."""
    number = 0
    try:
        while True:
            yield number
            number += 1
    finally:
        mark(notes, "generator")


class Same:
    """Gives what it takes."""

    def __init__(self, notes: str) -> None:
        self.notes = notes

    def __call__(self, x: Any) -> Any:
        return x


class Closed(Same):
    def close(self) -> None:
        mark(self.notes, "closed")


class Managed(Same):
    def __exit__(self, *_: object) -> None:
        mark(self.notes, "managed")


class AtExit(Same):
    def __init__(self, notes: str) -> None:
        super().__init__(notes)
        atexit.register(mark, notes, "at_exit")


class Flushed(Same):
    """Writes a mark that waits in the buffer of a file, which is never closed."""

    def __init__(self, notes: str) -> None:
        super().__init__(notes)
        self.file = (Path(notes) / "flushed").open("a")
        self.file.write(".")


class Slow(Same):
    """Takes a moment for each element, and marks it."""

    def __init__(self, notes: str, name: str, moment: float) -> None:
        super().__init__(notes)
        self.name, self.moment = name, moment

    def __call__(self, x: Any) -> Any:
        mark(self.notes, self.name)
        time.sleep(self.moment)
        return x


class Stubborn(Same):
    """Stays in its first step."""

    def __call__(self, x: Any) -> Any:  # noqa: ARG002
        mark(self.notes, "stubborn")
        while True:
            try:
                time.sleep(3600)
            except BaseException:
                mark(self.notes, "interrupted")
