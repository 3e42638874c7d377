"""Facts that take several different givers at once, as the inputs of a distinct group do.

A group can be fed by different transformations if and only if any n of its inputs have at least n givers together (Hall
1935). So it needs some *crowds*: facts that hold as soon as so many of their givers are there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import TypeVar

import numpy as np
import numpy.typing as npt

MOST = 4
"""A group that asks for more different things has crowds for single ones, pairs and all together only."""

Number = TypeVar("Number", np.int64, np.float64)


def crowds_of_group(inputs: Mapping[tuple[int, ...], int]) -> Iterator[tuple[tuple[int, ...], int]]:
    """The crowds of a distinct group: givers, and how many of them it takes.

    `inputs` says how many inputs of the group each set of givers feeds.
    """
    sizes: Iterable[int] = range(1, len(inputs) + 1) if len(inputs) <= MOST else (1, 2, len(inputs))
    for size in sizes:
        for together in combinations(inputs, size):
            givers = sorted(set().union(*together))
            if size == 1 or len(givers) < sum(map(len, together)):
                yield together[0] if size == 1 else tuple(givers), sum(inputs[one] for one in together)


class Crowds:
    """The facts that take more than one giver; their givers are numbers below `labels`."""

    def __init__(self, facts: npt.NDArray[np.int64], takes: Sequence[int], givers: Sequence[list[int]], labels: int):
        self.facts = facts
        most = max(*map(len, givers), *takes)
        self._givers = np.array([row + [labels] * (most - len(row)) for row in givers])
        self._is_padded = bool((self._givers == labels).any())
        self._places = np.arange(len(takes)), np.array(takes) - 1

    def least(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """For each of the facts the n-th least value of its givers, n being how many it takes."""
        values: npt.NDArray[Number] = self._sorted(of_label)[self._places]
        return values

    def least_sums(self, of_label: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """For each of the facts the least sum over as many givers as it takes."""
        sums: npt.NDArray[np.float64] = self._sorted(of_label).cumsum(axis=1)[self._places]
        return sums

    def _sorted(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        if self._is_padded:
            never = np.inf if of_label.dtype == np.float64 else np.iinfo(np.int64).max
            of_label = np.append(of_label, np.array(never, of_label.dtype))
        values: npt.NDArray[Number] = of_label[self._givers]
        values.sort(axis=1)
        return values
