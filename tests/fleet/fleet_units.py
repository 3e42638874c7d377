"""Unit code for the tests of fleets."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil


def count() -> Iterator[int]:
    """0, 1, 2, ..."""
    number = 0
    while True:
        yield number
        number += 1


class Tally:
    """Counts its steps, each as `by`; the count survives a restart."""

    def __init__(self, by: int = 1) -> None:
        self.by, self.steps = by, 0

    def __call__(self, x: Any) -> int:  # noqa: ARG002
        self.steps += self.by
        return self.steps

    def get_state(self) -> int:
        return self.steps

    def set_state(self, state: Any) -> None:
        self.steps = state


def count_until(note: str) -> Iterator[int]:
    """0, 1, 2, ... until there is a file `note`; the last number is written there."""
    number = 0
    while not Path(note).exists():
        yield number
        number += 1
    Path(note).write_text(str(number - 1))


def count_beside_a_daemon(note: str) -> Iterator[int]:
    """0, 1, 2, ...; a process of a session of its own, whose parent ends, notes its id in the file `note`."""
    between = os.fork()
    if between == 0:
        os.setsid()
        if os.fork() == 0:
            Path(note).write_text(str(os.getpid()))
            time.sleep(3600)
        os._exit(0)
    os.waitpid(between, 0)
    for number in count():
        yield number
        time.sleep(0.1)


def gauge(file: str) -> Iterator[dict[str, float]]:
    """The number in a file, ten times a second, as a battery gauge says it."""
    while True:
        yield {"percent": float(Path(file).read_text())}
        time.sleep(0.1)


def same(x: Any) -> Any:
    return x


def package() -> Iterator[int]:
    """What only has to be there."""
    yield from ()


def image(x: int) -> Any:
    """A picture of 460 kB that is bright as `x`."""
    return np.full((480, 960), x % 256, np.uint8)


def slow(x: Any) -> Any:
    time.sleep(0.002)
    return x


def slower(x: Any) -> Any:
    time.sleep(0.05)
    return x


class Waits:
    """Waits in a step as long as there is a file `hold`, and makes a file `hold.waiting` before."""

    def __init__(self, hold: str) -> None:
        self.hold = Path(hold)

    def __call__(self, x: int) -> int:
        if self.hold.exists():
            self.hold.with_suffix(".waiting").touch()
            while self.hold.exists():
                time.sleep(0.01)
        return x


class FailsOn:
    """Fails at its start on one host, and notes this in a file. On other hosts, it returns its input."""

    def __init__(self, host: str, note: str) -> None:
        lines = [" ".join(one.cmdline()) for one in psutil.Process().parents()]
        agent = next(line for line in lines if "cfgplan_runtime.fleet.local" in line)
        if host in agent.split():
            with Path(note).open("a") as file:
                file.write("failed\n")
            raise ValueError("no camera")

    def __call__(self, x: Any) -> Any:
        return x


class Broken:
    def __init__(self) -> None:
        raise ValueError("no such device")
