"""Unit code that has something to do at its end; each note is a file in the folder `notes`."""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO


def note(notes: str, name: str, text: str = "") -> None:
    (Path(notes) / name).write_text(text)


def motor(notes: str) -> Iterator[int]:
    """0, 1, 2, ... while the motor is on."""
    note(notes, "motor", "on")
    number = 0
    try:
        while True:
            yield number
            number += 1
    finally:
        note(notes, "motor", "off")


def blocks(notes: str) -> Iterator[int]:
    """An element, then a wait for what never comes."""
    note(notes, "motor", "on")
    try:
        yield 0
        note(notes, "blocks")
        time.sleep(3600)
    finally:
        note(notes, "motor", "off")


def stubborn(notes: str) -> Iterator[int]:
    yield 0
    note(notes, "blocks")
    while True:
        try:
            time.sleep(3600)
        except BaseException:
            note(notes, "interrupted")


class Writer:
    """Writes each input to a file that it never closes, and notes all that is called at its end."""

    def __init__(self, notes: str) -> None:
        self.notes = notes
        self.rows: TextIO = (Path(notes) / "rows").open("w")
        atexit.register(note, notes, "atexit")
        self._is_closed = threading.Event()
        threading.Thread(target=self._late).start()

    def __call__(self, x: Any) -> Any:
        self.rows.write(f"{x}\n")
        return x

    def close(self) -> None:
        note(self.notes, "close")
        self._is_closed.set()

    def _late(self) -> None:
        self._is_closed.wait()
        note(self.notes, "thread")


class Managed:
    """A context manager without `close`."""

    def __init__(self, notes: str) -> None:
        self.notes = notes

    def __exit__(self, *_: object) -> None:
        note(self.notes, "exit")

    def __call__(self, x: Any) -> Any:
        return x


class FailsToClose:
    def __init__(self, notes: str) -> None:
        self.notes = notes

    def __call__(self, x: Any) -> Any:
        return x

    def close(self) -> None:
        raise OSError("the motor does not answer")


class FailsBesideAThread:
    """Exits at its first input, while a thread of it goes on."""

    def __init__(self, notes: str) -> None:
        self.notes = notes
        threading.Thread(target=time.sleep, args=(3600,)).start()

    def __call__(self, x: Any) -> Any:  # noqa: ARG002
        raise SystemExit(7)


class Steady:
    """Takes a tenth of a second for each input, and writes what it has done."""

    def __init__(self, notes: str) -> None:
        self.notes = notes

    def __call__(self, x: Any) -> Any:
        with (Path(self.notes) / "done").open("a") as file:
            file.write(f"{x}\n")
        time.sleep(0.1)
        return x
