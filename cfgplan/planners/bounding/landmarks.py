"""Landmarks: every plan contains at least one transformation of a landmark, or several.

For any set of facts (a *zone*) with one that the goal needs, every plan has a transformation that offers a fact of the
zone and needs none of it: the first to enter. If a fact takes several givers, that many have entered before any label
can need it. Labels that count as *there* already lower this number. A label that enters may be replaced by labels that
enter the zone *behind* it: a zone with a fact that it needs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from itertools import chain
from types import MappingProxyType

import numpy as np

from cfgplan.frozen import dataclass
from cfgplan.planners.networks.core import NEVER, Core, Floats, Ints

Zones = Mapping[int, Collection[int]]
NOTHING: Zones = MappingProxyType({})


@dataclass(frozen=True)
class Crowd:
    """A demand of a landmark: the `counts` of its members that a plan contains add up to `least` or more.

    `there`, `behind` and `most` are the arguments of `landmark_of` that made it.
    """

    least: int
    counts: Ints
    there: frozenset[int]
    behind: Zones
    most: int

    def renumbered(self, counts: Ints, label: Ints, fact: Ints) -> Crowd:
        """The crowd in the numbering of a part, or of the whole, with the members' `counts`; -1 stands for none."""
        there = frozenset(number for number in label[list(self.there)].tolist() if number >= 0)
        behind = {
            int(label[i]): [number for number in fact[list(zone)].tolist() if number >= 0]
            for i, zone in self.behind.items()
            if label[i] >= 0
        }
        return Crowd(self.least, counts, there, behind, self.most)

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for crowds made with the same arguments."""
        return self.most, self.there, tuple((label, tuple(zone)) for label, zone in self.behind.items())


@dataclass(frozen=True)
class Landmark:
    """A zone of facts and the labels that may enter it first; without a crowd every plan has one of them."""

    zone: Ints
    members: Ints
    crowd: Crowd | None = None

    @property
    def least(self) -> int:
        """The counts of a plan's members add up to this or more."""
        return 1 if self.crowd is None else self.crowd.least

    @property
    def counted(self) -> Ints:
        """The members, each as often as it counts."""
        return self.members if self.crowd is None else np.repeat(self.members, self.crowd.counts)

    @property
    def is_impossible(self) -> bool:
        """True if all members together count less than `least`."""
        return len(self.counted) < self.least

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for landmarks made from the same zone with the same arguments."""
        return self.zone.tobytes(), None if self.crowd is None else self.crowd.key

    def hit_by(self, fractions: Floats) -> float:
        """The share of its demand that fractions of labels cover: 1 or more if they hit it."""
        if self.crowd is None:
            return float(fractions[self.members].sum())
        return float(fractions[self.members] @ self.crowd.counts) / self.crowd.least

    def outside(self, part: Core) -> Landmark:
        """The landmark of a part of a core in the numbering of the whole, without members outside the part."""
        crowd = self.crowd and self.crowd.renumbered(self.crowd.counts, part.labels, part.facts)
        return Landmark(part.facts[self.zone], part.labels[self.members], crowd)

    def made_again(self, core: Core) -> Landmark:
        """The landmark of the same zone and arguments, with all members that it has in `core`."""
        crowd = self.crowd
        if crowd is None:
            return landmark_of(core, self.zone.tolist())
        return landmark_of(core, self.zone.tolist(), crowd.there, crowd.behind, crowd.most)


def landmark_of(
    core: Core,
    zone: Iterable[int],
    there: frozenset[int] = frozenset(),
    behind: Zones = NOTHING,
    most: int = int(NEVER),
) -> Landmark:
    """The landmark of a zone of the core's facts.

    Where facts take several givers: labels in `there` count as entered, labels with a zone `behind` them may be
    replaced by those that enter it, and at most `most` is demanded.
    """
    givers, needed_by = core.givers.lists, core.needed_by.lists
    facts = list(zone)
    if core.crowd_takes.keys().isdisjoint(facts):
        members = set().union(*[givers[fact] for fact in facts]).difference(*[needed_by[fact] for fact in facts])
        return Landmark(np.array(facts, np.int64), np.array(sorted(members), np.int64))
    late = set().union(*[needed_by[fact] for fact in facts])
    entering = [_entering(core, fact, late, there) for fact in facts]
    least = min(most, max(takes for _, takes in entering))
    counts: dict[int, int] = {}
    for labels, takes in entering:
        ways = [_ways_to(core, behind[label], late, there) if label in behind else {label} for label in labels]
        for way, times in Counter(chain.from_iterable(ways)).items():
            counts[way] = max(counts.get(way, 0), min(times * -(-least // takes), least))
    for label in sorted(there & counts.keys()):
        if counts[label] < least:
            least -= counts.pop(label)
    members_in_order = sorted(counts)
    counts_in_order = [min(counts[label], least) for label in members_in_order]
    crowd = Crowd(least, np.array(counts_in_order, np.int64), there, behind, most)
    return Landmark(np.array(facts, np.int64), np.array(members_in_order, np.int64), crowd)


def _entering(core: Core, fact: int, late: Collection[int], there: Collection[int]) -> tuple[list[int], int]:
    """The givers of a fact that are not `late`, and how many it takes.

    Where it takes several, those `there` are left out of both as long as more are needed.
    """
    labels = [label for label in core.givers.lists[fact] if label not in late]
    takes = core.crowd_takes.get(fact, 1)
    others = [label for label in labels if label not in there]
    left = takes - (len(labels) - len(others))
    return (others, left) if takes > 1 and left > 0 else (labels, takes)


def _ways_to(core: Core, zone: Collection[int], late: Collection[int], there: Collection[int]) -> set[int]:
    """The labels that may enter a zone first, before any that are late."""
    needed_by = core.needed_by.lists
    later = set(late).union(*[needed_by[fact] for fact in zone])
    return {label for fact in zone for label in _entering(core, fact, later, there)[0]}


def ways_into(core: Core, goal: int, facts: list[int], residual: list[int]) -> Landmark:
    """Return the landmark of the zone from which `goal` comes free by the most expensive needs; `facts` are h_max of
    each.

    Labels that are free together with all that they need count as there. Other free labels get a zone behind them.
    """
    givers, needs, takes = core.givers.lists, core.needs.lists, core.crowd_takes
    there: set[int] = set()
    crowds: list[int] = []

    def spread(zone: list[int], is_whole: bool) -> list[int]:
        seen = set(zone)
        for fact in zone:
            if fact in takes:
                free = [i for i in givers[fact] if not residual[i] and not any(facts[need] for need in needs[i])]
                there.update(free)
                if is_whole and takes[fact] - len(free) > 1:
                    crowds.append(fact)
                    continue
            for label in givers[fact]:
                if not residual[label] and needs[label]:
                    need = max(needs[label], key=facts.__getitem__)
                    if need not in seen and facts[need]:
                        seen.add(need)
                        zone.append(need)
        return zone

    zone = spread([goal], True)
    behind = {
        label: spread([max(needs[label], key=facts.__getitem__)], False)
        for label in sorted({label for fact in crowds for label in givers[fact]} - there)
        if not residual[label] and needs[label] and set(zone).isdisjoint(needs[label])
    }
    landmark = landmark_of(core, zone, frozenset(there), behind)
    if landmark.crowd is not None and any(
        residual[label] < count
        for label, count in zip(landmark.members.tolist(), landmark.crowd.counts.tolist(), strict=True)
    ):
        return landmark_of(core, zone, frozenset(there), behind, 1)
    return landmark
