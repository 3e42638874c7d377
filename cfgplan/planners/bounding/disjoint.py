"""A lower bound from parts of a plan that share nothing.

If a fact takes `n` of its providers, every plan pays for `n` of them and for all labels that these force. A part is a
provider with the labels that it forces, and counts only labels that no other provider of the fact may need. The costs
of the `n` cheapest parts therefore add up. The facts that a part forces are bounded in the same way. A set is an
integer: its bits stand for labels, the goal, and facts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from operator import and_, or_
from typing import Final

from cfgplan.onward import reached
from cfgplan.planners.networks.core import Core
from cfgplan.reasons import Each

DEEPEST: Final = 50
"""Parts within this many others are bounded without the facts that they force."""


def disjoint_bound(
    core: Core, cost: Sequence[int], certain: Collection[int], each: Each = iter
) -> tuple[int, set[int]]:
    """Return a lower bound on the cost of plans, and a set of labels that may be a plan of this cost.

    `certain` has labels that every plan uses.
    """
    parts = _Parts(core, cost, each)
    forced = reduce(or_, [parts.forced[label] for label in certain], parts.forced[core.goal])
    value, chosen = parts.least(forced, parts.everything, DEEPEST)
    return value, set(_members(chosen & ((1 << core.goal) - 1)))


class _Parts:
    """By label, all that every plan with it has (`forced`) and all that it may need (`behind`), itself included."""

    def __init__(self, core: Core, cost: Sequence[int], each: Each) -> None:
        needs, self._providers = core.needs.lists, core.providers.lists
        self._takes = [1] * len(core.providers) if core.takes is None else core.takes.tolist()
        self._cost = [*cost, 0]
        self._labels = len(self._cost)
        self.everything = (1 << self._labels + len(self._takes)) - 1
        self.forced = [1 << label for label in range(self._labels)]
        self.behind = self.forced[:]
        order = reached([core.goal], lambda label: (one for fact in needs[label] for one in self._providers[fact]))
        order.reverse()
        while self._follow(each(order), needs):
            pass

    def _follow(self, labels: Iterable[int], needs: Mapping[int, list[int]]) -> bool:
        """Extend `forced` and `behind` of each label by those of its needs. Returns whether a set grew."""
        forced, behind, is_new = self.forced, self.behind, False
        of_fact: dict[int, tuple[int, int]] = {}
        for label in labels:
            all_forced = all_behind = 1 << label
            for fact in needs[label]:
                if fact not in of_fact:
                    providers, itself = self._providers[fact], 1 << self._labels + fact
                    each_forced = [forced[one] for one in providers]
                    common = reduce(or_ if len(providers) <= self._takes[fact] else and_, each_forced)
                    of_fact[fact] = itself | common, reduce(or_, [behind[one] for one in providers], itself)
                all_forced |= of_fact[fact][0]
                all_behind |= of_fact[fact][1]
            is_new = is_new or (forced[label], behind[label]) != (all_forced, all_behind)
            forced[label], behind[label] = all_forced, all_behind
        return is_new

    def least(self, forced: int, countable: int, depth: int) -> tuple[int, int]:
        """Return a lower bound on the cost of `countable` labels in plans with `forced`, and a choice at this cost.

        If `forced` has a label, it must have all that this label forces.
        """
        value, chosen, facts = 0, forced, []
        for one in _members(forced & countable):
            if one < self._labels:
                value += self._cost[one]
            else:
                facts.append(one - self._labels)
        countable &= ~forced
        for fact in facts if depth else ():
            takes, providers = self._takes[fact], self._providers[fact]
            if sum([forced >> one & 1 for one in providers]) >= takes:
                continue
            shared = behind = 0
            for one in providers:
                shared |= behind & self.behind[one]
                behind |= self.behind[one]
            own = countable & ~shared
            parts = [self.least(self.forced[one], own, depth - 1) for one in providers]
            for part, choice in sorted(parts)[:takes]:
                value += part
                chosen |= choice
            countable &= shared | ~behind
        return value, chosen


def _members(bits: int) -> Iterator[int]:
    while bits:
        last = bits & -bits
        yield last.bit_length() - 1
        bits ^= last
