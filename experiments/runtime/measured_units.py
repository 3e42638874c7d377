"""Unit code of the experiments with the runtime."""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy


def count() -> Iterator[int]:
    """0, 1, 2, ..."""
    number = 0
    while True:
        yield number
        number += 1


def some(number: int) -> Iterator[int]:
    """0, 1, 2, ..., so many."""
    yield from range(number)


def images() -> Iterator[Any]:
    """Pictures of 460 kB whose pixels are their number modulo 256."""
    number = 0
    while True:
        yield numpy.full((480, 960), number % 256, numpy.uint8)
        number += 1


def large(size: int) -> Iterator[Any]:
    """Arrays of so many bytes."""
    number = 0
    while True:
        yield numpy.full(size, number % 256, numpy.uint8)
        number += 1


def pack(x: Any) -> bytes:
    """An array of bytes, compressed."""
    return zlib.compress(x.tobytes(), 1)


def unpack(x: bytes) -> Any:
    return numpy.frombuffer(zlib.decompress(x), numpy.uint8)


def same(x: Any) -> Any:
    return x


class Steps:
    """Gives the number of its steps, which survives a restart."""

    def __init__(self) -> None:
        self._steps = 0

    def __call__(self, x: Any) -> int:  # noqa: ARG002
        self._steps += 1
        return self._steps

    def get_state(self) -> int:
        return self._steps

    def set_state(self, state: int) -> None:
        self._steps = state


class Constructed:
    """Takes `seconds` to construct, as a model takes to load; gives its process id and its input."""

    def __init__(self, seconds: float) -> None:
        time.sleep(seconds)

    def __call__(self, x: Any) -> Any:
        return [os.getpid(), x]


class FailsToStart:
    def __init__(self) -> None:
        raise RuntimeError("no such device")


def stamped(size: int) -> Iterator[Any]:
    """Payloads of a size in bytes with the time at which they were made."""
    data = payload(size)
    while True:
        yield [time.monotonic_ns(), data]


def payload(size: int) -> Any:
    return bytes(size) if size <= 100 else numpy.zeros(size, numpy.uint8)


class Ages:
    """Collects how old payloads are when they come; gives count and the sorted ages in microseconds."""

    def __init__(self, every: int) -> None:
        self.every = every
        self.ages: list[float] = []

    def __call__(self, x: Any) -> Any:
        self.ages.append((time.monotonic_ns() - x[0]) / 1000)
        if len(self.ages) < self.every:
            return None
        ages, self.ages = self.ages, []
        return [len(ages), sorted(ages)[len(ages) // 2], sorted(ages)[len(ages) * 99 // 100], time.monotonic_ns()]


class SameWithHeir:
    """Gives its input; on request, it leaves behind a process in a session of its own, for some seconds."""

    def __init__(self) -> None:
        self._wish = Path(os.environ["CFGPLAN_SOAK_HEIR"])

    def __call__(self, x: Any) -> Any:
        if self._wish.exists():
            with suppress(FileNotFoundError):
                self._wish.unlink()
                if os.fork() == 0:
                    os.setsid()
                    time.sleep(5)
                    os._exit(0)
        return x
