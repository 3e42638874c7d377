"""Unit code with numpy, for the tests of the runtime."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator

import numpy
from numpy.typing import NDArray


def draw() -> Iterator[int]:
    """Prints a random number of Python and one of numpy."""
    sys.stdout.write(f"{random.random()} {numpy.random.random()}\n")
    yield 0


def images() -> Iterator[NDArray[numpy.uint8]]:
    """Pictures of 460 kB whose first 8 bytes are their number."""
    number = 0
    while True:
        image = numpy.zeros((480, 960), numpy.uint8)
        image.reshape(-1)[:8] = numpy.frombuffer(number.to_bytes(8, "little"), numpy.uint8)
        yield image
        number += 1


def shades() -> Iterator[NDArray[numpy.uint8]]:
    """Pictures of 460 kB whose columns rise from 0 to 255, again and again."""
    while True:
        yield numpy.tile(numpy.arange(960).astype(numpy.uint8), (480, 1))


def image_number(x: NDArray[numpy.uint8]) -> int:
    return int.from_bytes(x.reshape(-1)[:8].tobytes(), "little")
