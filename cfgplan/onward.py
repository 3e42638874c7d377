"""Relations as pairs: reachability, derivations and grouping."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Of = TypeVar("Of")
Premise = TypeVar("Premise")
Key = TypeVar("Key", contravariant=True)
Found = TypeVar("Found", covariant=True)


class Table(Protocol[Key, Found]):
    """A list or a mapping that is read by key."""

    def __getitem__(self, key: Key, /) -> Found: ...


class Counts(Protocol[Key]):
    """A list or a mapping of numbers that are counted down in place."""

    def __getitem__(self, key: Key, /) -> int: ...
    def __setitem__(self, key: Key, number: int, /) -> None: ...


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


def derivations(
    premises: Iterable[Premise], above: Table[Premise, Iterable[Item]], missing: Counts[Item]
) -> Iterator[tuple[Item, Premise]]:
    """Yield each item as soon as all of its premises hold, with the last of them.

    All closures follow this rule: a transformation can run when each of its required inputs is offered. The caller
    decides the order: its `premises` yields each premise once, as soon as it holds, also those that follow from the
    items yielded so far. `above` maps a premise to the items that need it. `missing` has the number of premises that
    each item still needs (1 if any one is enough), and is counted down. The caller handles items without premises.
    """
    for premise in premises:
        for item in above[premise]:
            missing[item] -= 1
            if not missing[item]:
                yield item, premise
