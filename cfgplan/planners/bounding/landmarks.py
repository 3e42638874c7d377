"""Landmarks: disjunctive action landmarks; every plan contains at least one of a landmark's transformations, or
several.

For any set of facts (a *zone*) with one that the goal needs, every plan has a transformation that offers a fact of the
zone and needs none of it: the first to enter. If a fact takes several providers, that many have entered before any
label can need it. Labels that count as *there* already lower this number. A label that enters may be replaced by
the labels that enter another zone, *behind* it, with a fact that it needs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from cfgplan.planners.networks.core import NEVER, Core, Floats, Ints
from cfgplan.planners.solving.arrays import np

Zones = Mapping[int, Collection[int]]
NOTHING: Zones = MappingProxyType({})


@dataclass(frozen=True)
class MultiDemand:
    """A demand of a landmark: the `counts` of its members that a plan contains add up to `least` or more.

    `there`, `replaceable_by` and `most` are the arguments of `landmark_of` that made it.
    """

    least: int
    counts: Ints
    there: frozenset[int]
    replaceable_by: Zones
    most: int

    def renumbered(self, counts: Ints, label: Ints, fact: Ints) -> MultiDemand:
        """The demand with labels and facts renumbered by these arrays (-1: left out), and the members' new `counts`."""
        there = frozenset(number for number in label[list(self.there)].tolist() if number >= 0)
        replaceable_by = {
            int(label[i]): [number for number in fact[list(zone)].tolist() if number >= 0]
            for i, zone in self.replaceable_by.items()
            if label[i] >= 0
        }
        return MultiDemand(self.least, counts, there, replaceable_by, self.most)

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for demands made with the same arguments."""
        return self.most, self.there, tuple((label, tuple(zone)) for label, zone in self.replaceable_by.items())


@dataclass(frozen=True)
class Landmark:
    """A zone of facts and the labels that may enter it first; without a `multi_demand` every plan has one of them."""

    zone: Ints
    members: Ints
    multi_demand: MultiDemand | None = None

    @property
    def least(self) -> int:
        """The counts of a plan's members add up to this or more."""
        return 1 if self.multi_demand is None else self.multi_demand.least

    @property
    def counted(self) -> Ints:
        """The members, each as often as it counts."""
        return self.members if self.multi_demand is None else np.repeat(self.members, self.multi_demand.counts)

    @property
    def is_impossible(self) -> bool:
        """True if all members together count less than `least`."""
        return len(self.counted) < self.least

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for landmarks made from the same zone with the same arguments."""
        return self.zone.tobytes(), None if self.multi_demand is None else self.multi_demand.key

    def hit_by(self, fractions: Floats) -> float:
        """The share of its demand that fractions of labels cover: 1 or more if they hit it."""
        if self.multi_demand is None:
            return float(fractions[self.members].sum())
        return float(fractions[self.members] @ self.multi_demand.counts) / self.multi_demand.least

    def outside(self, part: Core) -> Landmark:
        """The landmark of a part of a core in the numbering of the whole, without members outside the part."""
        multi_demand = self.multi_demand and self.multi_demand.renumbered(
            self.multi_demand.counts, part.labels, part.facts
        )
        return Landmark(part.facts[self.zone], part.labels[self.members], multi_demand)

    def made_again(self, core: Core) -> Landmark:
        """The landmark of the same zone and arguments, with all members that it has in `core`."""
        multi_demand = self.multi_demand
        if multi_demand is None:
            return landmark_of(core, self.zone.tolist())
        return landmark_of(core, self.zone.tolist(), multi_demand.there, multi_demand.replaceable_by, multi_demand.most)


def landmark_of(
    core: Core,
    zone: Iterable[int],
    there: frozenset[int] = frozenset(),
    replaceable_by: Zones = NOTHING,
    most: int = int(NEVER),
) -> Landmark:
    """The landmark of a zone of the core's facts.

    Three arguments matter where facts take several providers: labels in `there` count as entered, a label may be
    replaced by those that enter the zone that `replaceable_by` has for it, and at most `most` is demanded.
    """
    providers, needed_by = core.providers.lists, core.needed_by.lists
    facts = list(zone)
    if core.multi_takes.keys().isdisjoint(facts):
        members = set().union(*[providers[fact] for fact in facts]).difference(*[needed_by[fact] for fact in facts])
        return Landmark(np.array(facts, np.int64), np.array(sorted(members), np.int64))
    late = set().union(*[needed_by[fact] for fact in facts])
    entering = [_entering(core, fact, late, there) for fact in facts]
    least = min(most, max(takes for _, takes in entering))
    counts: dict[int, int] = {}
    for labels, takes in entering:
        each = -(-least // takes)
        times: dict[int, int] = {}
        for label in labels:
            behind = replaceable_by.get(label)
            for way in (label,) if behind is None else _ways_to(core, behind, late, there):
                times[way] = times.get(way, 0) + each
        for way, count in times.items():
            counts[way] = max(counts.get(way, 0), min(count, least))
    for label in sorted(there & counts.keys()):
        if counts[label] < least:
            least -= counts.pop(label)
    members_in_order = sorted(counts)
    counts_in_order = [min(counts[label], least) for label in members_in_order]
    multi_demand = MultiDemand(least, np.array(counts_in_order, np.int64), there, replaceable_by, most)
    return Landmark(np.array(facts, np.int64), np.array(members_in_order, np.int64), multi_demand)


def _entering(core: Core, fact: int, late: Collection[int], there: Collection[int]) -> tuple[list[int], int]:
    """The providers of a fact that are not `late`, and how many it takes.

    Where it takes several, those `there` are left out of both as long as more are needed.
    """
    labels = [label for label in core.providers.lists[fact] if label not in late]
    takes = core.multi_takes.get(fact, 1)
    others = [label for label in labels if label not in there]
    left = takes - (len(labels) - len(others))
    return (others, left) if takes > 1 and left > 0 else (labels, takes)


def _ways_to(core: Core, zone: Collection[int], late: Collection[int], there: Collection[int]) -> set[int]:
    """The labels that may enter a zone first, before any that are late."""
    providers, needed_by, takes = core.providers.lists, core.needed_by.lists, core.multi_takes
    if takes.keys().isdisjoint(zone):
        ways = set().union(*[providers[fact] for fact in zone])
        return ways.difference(late, *[needed_by[fact] for fact in zone])
    later = set(late).union(*[needed_by[fact] for fact in zone])
    return {label for fact in zone for label in _entering(core, fact, later, there)[0]}


def ways_into(core: Core, goal: int, facts: list[int], residual: list[int]) -> Landmark:
    """Return the landmark of the zone from which `goal` comes free by the most expensive needs; `facts` are h_max of
    each.

    Labels that are free together with all that they need count as there. Other free labels are replaceable by those
    that enter a zone behind them.
    """
    providers, needs, takes = core.providers.lists, core.needs.lists, core.multi_takes
    there: set[int] = set()
    multi_facts: list[int] = []

    def spread(zone: list[int], is_whole: bool) -> list[int]:
        seen = set(zone)
        for fact in zone:
            if fact in takes:
                free = [i for i in providers[fact] if not residual[i] and not any(facts[need] for need in needs[i])]
                there.update(free)
                if is_whole and takes[fact] - len(free) > 1:
                    multi_facts.append(fact)
                    continue
            for label in providers[fact]:
                if not residual[label] and needs[label]:
                    need = max(needs[label], key=facts.__getitem__)
                    if need not in seen and facts[need]:
                        seen.add(need)
                        zone.append(need)
        return zone

    zone = spread([goal], True)
    in_zone = set(zone)
    replaceable_by = {
        label: spread([max(needs[label], key=facts.__getitem__)], False)
        for label in sorted({label for fact in multi_facts for label in providers[fact]} - there)
        if not residual[label] and needs[label] and in_zone.isdisjoint(needs[label])
    }
    landmark = landmark_of(core, zone, frozenset(there), replaceable_by)
    if landmark.multi_demand is not None and any(
        residual[label] < count
        for label, count in zip(landmark.members.tolist(), landmark.multi_demand.counts.tolist(), strict=True)
    ):
        return landmark_of(core, zone, frozenset(there), replaceable_by, 1)
    return landmark
