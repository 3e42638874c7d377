"""The rates that links between hosts really carry, in coarse steps: measured while a link drops elements for lack of
room.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import floor, log
from typing import Final, NamedTuple

from cfgplan.domain import Environment
from cfgplan_runtime.children.messages import CrossingCounts

MEASURED_S: Final = 5.0
"""Seconds over which the streams of a link are measured."""
STEP: Final = 1.5
"""The ratio of a rate to the next lower one."""
LEAST_RATE: Final = 1000
"""The lowest rate, in bytes per second."""
FREE_S: Final = 60.0
"""A link that has dropped nothing for so many seconds may carry a step more; after each failure, for twice as many."""
LONGEST_FREE_S: Final = 960.0

Crossings = Mapping[tuple[str, str, str], CrossingCounts]
"""Counts by stream, source host and target host."""
Ends = tuple[str, str]
"""The two selectors of hosts that a link joins."""


class Use(NamedTuple):
    """The use of a link: bytes that streams `offered`, bytes that `arrived`, and by stream the dropped and all
    elements.
    """

    offered: int
    arrived: int
    dropped: Mapping[str, tuple[int, int]]


def uses(before: Crossings, now: Crossings) -> dict[tuple[str, str], Use]:
    """The use of each link between two counts, by source and target host. Streams that have ended do not count."""
    found: dict[tuple[str, str], Use] = {}
    for key, counts in now.items():
        stream, source, target = key
        if stream:
            then = before.get(key, CrossingCounts())
            known = found.get((source, target), Use(0, 0, {}))
            lost = counts.crowded - then.crowded
            dropped = {stream: (lost, counts.elements - then.elements)} if lost > 0 else {}
            found[source, target] = Use(
                known.offered + max(0, counts.offered_bytes - then.offered_bytes),
                known.arrived + max(0, counts.arrived_bytes - then.arrived_bytes),
                {**known.dropped, **dropped},
            )
    return found


@dataclass(frozen=True, slots=True)
class MeasuredLink:
    """The rate of a link in bytes per second, since when it has dropped nothing, and how long until it may rise."""

    rate: int
    free_since_s: float
    patience_s: float = FREE_S

    def after(self, arrived_per_s: float, at_s: float, *, is_crowded: bool) -> MeasuredLink:
        """The link after a measurement."""
        step = _step(arrived_per_s)
        if is_crowded:
            has_failed = step < self.rate
            patience_s = min(2 * self.patience_s, LONGEST_FREE_S) if has_failed else self.patience_s
            return MeasuredLink(step if has_failed or step > self.rate * STEP else self.rate, at_s, patience_s)
        if arrived_per_s > self.rate * STEP:
            return replace(self, rate=step)
        if at_s - self.free_since_s >= self.patience_s:
            return replace(self, rate=round(self.rate * STEP), free_since_s=at_s)
        return self


@dataclass(frozen=True, slots=True)
class LinkRates:
    """The last counts of streams between hosts with their time, and the links that were found to carry too little."""

    at_s: float = 0.0
    crossings: Crossings = field(default_factory=dict)
    links: Mapping[Ends, MeasuredLink] = field(default_factory=dict)

    def after(self, crossings: Crossings, world: Environment, at_s: float) -> LinkRates:
        """Add counts; the links of a world are measured every MEASURED_S seconds."""
        if not self.crossings:
            return LinkRates(at_s, crossings, self.links)
        span_s = at_s - self.at_s
        if span_s < MEASURED_S:
            return self
        arrived, crowded = dict[Ends, int](), set[Ends]()
        for (source, target), use in uses(self.crossings, crossings).items():
            ends = _ends(world, source, target)
            arrived[ends] = arrived.get(ends, 0) + use.arrived
            if use.dropped:
                crowded.add(ends)
        links = dict(self.links)
        for ends in arrived.keys() | links.keys():
            per_s, known = arrived.get(ends, 0) / span_s, links.get(ends)
            if known is not None:
                links[ends] = known.after(per_s, at_s, is_crowded=ends in crowded)
            elif ends in crowded and per_s > 0:
                links[ends] = MeasuredLink(_step(per_s), at_s)
        return LinkRates(at_s, crossings, links)

    def rates(self, world: Environment) -> dict[Ends, int]:
        """The rates of the links that carry less than a world declares, in bytes per second."""
        declared = {link.between: link.bandwidth for link in world.links}
        found = {}
        for ends, link in self.links.items():
            limit = declared.get(ends)
            if limit is None or link.rate < limit:
                found[ends] = link.rate
        return found


def _ends(world: Environment, source: str, target: str) -> Ends:
    """The selectors of the declared link between two hosts, or else their quoted names, in order."""
    link = world.link.get((source, target))
    if link is not None:
        return link.between
    first, second = sorted((source, target))
    return f"'{first}'", f"'{second}'"


def _step(rate: float) -> int:
    """The highest step that is no higher than a rate, in bytes per second."""
    return round(LEAST_RATE * STEP ** max(0, floor(log(max(rate, 1.0) / LEAST_RATE, STEP))))
