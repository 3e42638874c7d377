"""Unit code of storms: a source sends 1 at 50 Hz, every other unit the sum of its inputs."""

from __future__ import annotations

import time
from collections.abc import Iterator


def give0(seed: float = 0.0) -> Iterator[int]:  # noqa: ARG001
    while True:
        time.sleep(0.02)
        yield 1


def give1(x0: int, seed: float = 0.0) -> int:  # noqa: ARG001
    return x0


def give2(x0: int, x1: int, seed: float = 0.0) -> int:  # noqa: ARG001
    return x0 + x1
