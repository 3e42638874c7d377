"""Relations as pairs: reachability, derivation and grouping."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
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


def derived(missing: dict[Item, int], ahead: list[Item], above: Callable[[Item], Iterable[Item]]) -> Iterator[Item]:
    """Yield the items `ahead`, then each item whose premises were all yielded, in the order of derivation.

    `missing` has the number of premises that each other item still needs (1 if any one of them is enough); it is
    counted down, and `ahead` grows. `above` gives the items that have an item as a premise.
    """
    for item in ahead:
        yield item
        for other in above(item):
            if other in missing:
                missing[other] -= 1
                if not missing[other]:
                    ahead.append(other)
