"""Unit code for the tests of the runtime."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

from cfgplan_runtime import At


def count() -> Iterator[int]:
    """0, 1, 2, ..."""
    number = 0
    while True:
        yield number
        number += 1


VARIOUS: list[Any] = [
    *(1, -1, 127, 128, -128, 70_000, -70_000, 1 << 40, 0.5, True, False, "", "x" * 40, "ü" * 300, b"bytes" * 20),
    *([], list(range(20)), {}, {"a": [{"b": 1.5}]}, {str(n): n for n in range(20)}, "x" * 70_000, list(range(70_000))),
]
"""Values of each kind that msgpack writes in another way."""


def once() -> Iterator[int]:
    """A number, and no other one."""
    yield 0
    while True:
        time.sleep(60)
        yield 0


def various() -> Iterator[Any]:
    while True:
        yield from VARIOUS


def fails(x: Any) -> Any:
    raise ValueError(f"no {x}")


def even(x: int) -> int | None:
    """Only the even numbers."""
    return None if x % 2 else x


def same(x: Any) -> Any:
    return x


def leave_heir(note: str) -> None:
    """Start a process of a session of its own, which keeps every socket of this one, once; `note` gets its id."""
    if not Path(note).exists():
        heir = os.fork()
        if heir == 0:
            os.setsid()
            time.sleep(3600)
        Path(note).write_text(str(heir))


def count_with_heir(note: str) -> Iterator[int]:
    leave_heir(note)
    yield from count()


class SameWithHeir:
    def __init__(self, note: str) -> None:
        self.note = note

    def __call__(self, x: Any) -> Any:
        leave_heir(self.note)
        return x


def add(a: int, b: int) -> int:
    return a + b


def square(x: int) -> int:
    return x * x


class Pool:
    """Squares in a process that it starts by `multiprocessing`."""

    def __init__(self, method: Literal["fork", "forkserver", "spawn"]) -> None:
        self.pool = ProcessPoolExecutor(1, mp_context=get_context(method))

    def __call__(self, x: int) -> int:
        return self.pool.submit(square, x).result()

    def close(self) -> None:
        self.pool.shutdown(cancel_futures=True)


class Slow:
    """Takes its time."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __call__(self, x: Any) -> Any:
        time.sleep(self.seconds)
        return x


class SlowToConstruct:
    """Is constructed once there is a file `note`."""

    def __init__(self, note: str) -> None:
        while not Path(note).exists():
            time.sleep(0.01)

    def __call__(self, x: Any) -> Any:
        return x


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


class LargeTally(Tally):
    """Its state has 16 MB."""

    def get_state(self) -> Any:
        return [self.steps, bytes(16 << 20)]

    def set_state(self, state: Any) -> None:
        self.steps = state[0]


class Pairs:
    """Gives the number of its steps, which survives a restart, and its inputs."""

    def __init__(self) -> None:
        self.steps = 0

    def __call__(self, a: int, b: int) -> list[int]:
        self.steps += 1
        return [self.steps, a, b]

    def get_state(self) -> int:
        return self.steps

    def set_state(self, state: Any) -> None:
        self.steps = state


class Clock:
    """A source that counts its elements; the count survives a restart."""

    def __init__(self) -> None:
        self.ticks = 0

    def __call__(self) -> int:
        self.ticks += 1
        return self.ticks

    def get_state(self) -> int:
        return self.ticks

    def set_state(self, state: Any) -> None:
        self.ticks = state


class SlowFirst(Clock):
    """A source whose first step takes longer than a hand-over."""

    def __init__(self) -> None:
        super().__init__()
        self.has_begun = False

    def __call__(self) -> int:
        ticks = super().__call__()
        if not self.has_begun:
            self.has_begun = True
            time.sleep(0.2)
        return ticks


class Numbered:
    """Gives at each step, or some, the step's number, which survives a restart, and the numbers of its inputs."""

    def __init__(self, every: int = 1, size: int = 0) -> None:
        self.every, self.size, self.steps = every, size, 0

    def __call__(self, **inputs: Any) -> list[Any] | None:
        self.steps += 1
        if self.steps % self.every:
            return None
        return [self.steps, {port: _number(value) for port, value in inputs.items()}, bytes(self.size)]

    def get_state(self) -> int:
        return self.steps

    def set_state(self, state: int) -> None:
        self.steps = state


def _number(value: Any) -> Any:
    return None if value is None else [one[0] for one in value] if isinstance(value[0], list) else value[0]


class FailsWithState(Tally):
    """Fails at each step."""

    def __call__(self, x: Any) -> int:
        raise ValueError(f"no step with {x}")


class KeepsItsState:
    """Fails to tell its state, or takes long for it."""

    def __init__(self, deed: Literal["fail", "sleep"]) -> None:
        self.deed = deed

    def __call__(self, x: Any) -> Any:
        return x

    def get_state(self) -> int:
        if self.deed == "fail":
            raise ValueError("no state today")
        time.sleep(3)
        return 0

    def set_state(self, state: Any) -> None:
        assert state == 0


class Naughty:
    """Does at input 5 what its parameter says, else gives its input."""

    def __init__(self, deed: str) -> None:
        self.deed = deed
        self.hoard: list[bytearray] = []
        if deed == "fail at start":
            raise ValueError("no such camera")
        if deed == "die at start":
            os._exit(3)
        if deed == "never ready":
            time.sleep(3600)

    def __call__(self, x: int) -> Any:
        if self.deed == "die at first":
            os._exit(6)
        if x % 10 != 5:
            return x
        match self.deed:
            case "raise":
                raise ValueError("five is too much")
            case "wrong ports":
                return {"z": 1}
            case "not sendable":
                return object()
            case "print":
                print("hello from the unit")  # noqa: T201
                sys.stderr.write("and from its stderr\n")
            case "exit":
                sys.exit(4)
            case "hard exit":
                os._exit(5)
            case "hang":
                time.sleep(3600)
            case "eat memory":
                while True:
                    self.hoard.append(bytearray(1 << 20))
            case "start a child":
                if os.fork() == 0:
                    time.sleep(3600)
        return x


class Scribbler:
    """Writes garbage into all descriptors that it has, once, as a C library's double close may."""

    def __init__(self, note: str) -> None:
        self.note = Path(note)
        self.steps = 0

    def __call__(self, x: int) -> int:
        self.steps += 1
        if self.steps == 20 and not self.note.exists():
            self.note.touch()
            for number in range(3, 64):
                with suppress(OSError):
                    os.write(number, b"\x05\0\0\0\0\0\0\0hello" * 3)
        return x


class Chatterer:
    """Has a program print without end, as fast as it can."""

    def __init__(self) -> None:
        subprocess.Popen(["yes", "hello"])

    def __call__(self, x: int) -> int:
        return x


class LeavesAChatterer:
    """Leaves a program that prints without end in a session of its own, once, and dies; `note` gets its id."""

    def __init__(self, note: str) -> None:
        self.note = Path(note)

    def __call__(self, x: int) -> int:
        if not self.note.exists():
            left = subprocess.Popen(["yes", "hello"], start_new_session=True)
            self.note.write_text(str(left.pid))
            os._exit(3)
        return x


class TwoOutputs:
    def __init__(self, deed: str = "") -> None:
        self.deed = deed

    def __call__(self, x: int) -> Any:
        return {"z": 1} if self.deed == "wrong ports" else {"even": x if x % 2 == 0 else None, "double": 2 * x}


def twice(x: int) -> Iterator[int]:
    yield x
    yield x


def countdown() -> Iterator[int]:
    """3, 2, 1, at its own pace, then no more."""
    for number in (3, 2, 1):
        time.sleep(0.05)
        yield number


def raising() -> Iterator[int]:
    """0, 1, then an exception."""
    yield 0
    yield 1
    raise OSError("camera: frame timeout")


class Flaky:
    """Raises at every other call, and ends after `last`."""

    def __init__(self, last: int, raises_last: bool) -> None:
        self.number, self.last, self.raises_last = 0, last, raises_last

    def __iter__(self) -> Iterator[int]:
        return self

    def __next__(self) -> int:
        self.number += 1
        if self.number > self.last:
            raise StopIteration
        if (self.number % 2 == 1) == (self.raises_last == (self.last % 2 == 1)):
            raise OSError("camera: frame timeout")
        return self.number


def timed() -> Iterator[At]:
    """Elements with a time of their own."""
    for second in range(1, 1000):
        yield At(second * 1_000_000_000, second)


def lacks(x: Any, z: Any) -> Any:
    """Whether the second input has nothing."""
    return [x, z is None]


def named(name: str) -> Iterator[list[Any]]:
    """["name", 0], ["name", 1], ..."""
    for number in count():
        yield [name, number]
