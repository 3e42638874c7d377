"""A lower bound from parts of a plan that share nothing.

If a fact takes `n` of its providers, every plan pays for `n` of them and for all that these can't do without. Labels
that only one of the providers may need are counted for this one alone, so the costs of the `n` cheapest add up. The
same holds for every fact that a part can't do without. Sets are bits of an integer: of labels, the goal, and facts.
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
"""The facts of a part that lies within so many others are not looked at."""


def disjoint_bound(
    core: Core, cost: Sequence[int], certain: Collection[int], each: Each = iter
) -> tuple[int, set[int]]:
    """Return a lower bound on the cost of plans, and labels that may be a plan of this cost.

    Every plan has the `certain` labels.
    """
    parts = _Parts(core, cost, each)
    forced = reduce(or_, [parts.forced[label] for label in certain], parts.forced[core.goal])
    value, chosen = parts.least(forced, parts.everything, DEEPEST)
    return value, set(_members(chosen & ((1 << core.goal) - 1)))


class _Parts:
    """For each label, what every plan with it has (`forced`) and what may be needed for it (`behind`), with itself."""

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
        """Add what the needs of each label force and what is behind them. Returns whether anything was new."""
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
        """Return the least cost of `countable` labels in plans with all that is `forced`, and a choice at this cost.

        With a label, all that it forces must be forced.
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
