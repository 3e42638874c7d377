"""Relations as pairs: reachability and grouping."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")
Of = TypeVar("Of")


def grouped(pairs: Iterable[tuple[Of, Item]]) -> defaultdict[Of, list[Item]]:
    """Return the second elements of pairs by the first, in order."""
    found: defaultdict[Of, list[Item]] = defaultdict(list)
    for of, item in pairs:
        found[of].append(item)
    return found


def reached(starts: Iterable[Item], onward: Callable[[Item], Iterable[Item]]) -> list[Item]:
    """Return the starts and everything reachable from them, each once, in breadth-first order."""
    found = dict.fromkeys(starts)
    ahead = list(found)
    for here in ahead:
        new = dict.fromkeys(one for one in onward(here) if one not in found)
        found |= new
        ahead += new
    return ahead
