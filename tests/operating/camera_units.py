"""Unit code for the tests of a run in operation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy
from numpy.typing import NDArray


def camera() -> Iterator[NDArray[numpy.uint8]]:
    """Images that are numbered in their first pixel."""
    number = 0
    while True:
        yield numpy.full((32, 32), number % 256, numpy.uint8)
        number += 1


def brightness(image: NDArray[numpy.uint8]) -> dict[str, object]:
    return {"mean": float(image.mean()), "image": image}
