"""A wiring for a given choice of units, without search: whatever can stay as it is stays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable
from heapq import heappop, heappush

from cfgplan.domain import ComputationUnit, InputPort, Publication, Stream, Subscription
from cfgplan.planners.networks.site import Site
from cfgplan.reasons import assign_different, distinct_groups


def wire(site: Site, chosen: Collection[int]) -> list[ComputationUnit] | None:
    """The chosen candidates wired, less those that nothing needs; None if they do not ground each other."""
    ordering = _Ordering(site, chosen)
    is_grounded = ordering.run()
    publisher = {
        target.topic: _publisher(site, target.tag, target.topic, chosen) for target in site.environment.targets
    }
    if not is_grounded or None in publisher.values():
        return None
    topics: dict[int, list[Publication]] = defaultdict(list)
    for target in site.environment.targets:
        who = publisher[target.topic]
        assert who is not None
        topics[who].append(Publication(published_port(site, who, target.tag, target.topic), target.topic))
    pinned = [i for i in chosen if site.is_kept_pinned(i)]
    ahead = sorted({*topics, *pinned})
    units: dict[int, ComputationUnit] = {}
    for i in ahead:
        if i not in units:
            candidate = site.candidates[i]
            subscriptions = tuple(
                Subscription(port.name, fed_stream(site, i, port, [feeder]))
                for port in candidate.transformation.inputs
                for feeder in [ordering.placed[i][port.name]]
            )
            units[i] = ComputationUnit(candidate.id, candidate.transformation.label, subscriptions, tuple(topics[i]))
            ahead += ordering.placed[i].values()
    return list(units.values())


def forced_changes(site: Site, chosen: Collection[int]) -> int:
    """How many of the chosen running units must be rewired, whatever the wiring."""
    kept = {site.candidates[i].id for i in chosen}
    return sum(
        candidate.running is not None
        and not (candidate.may_stay and all(s.stream.unit in kept for s in candidate.running.subscriptions))
        for candidate in (site.candidates[i] for i in chosen)
    )


def fed_stream(site: Site, unit: int, port: InputPort, feeders: Iterable[int]) -> Stream:
    """The stream by which the first of `feeders` feeds an input; the one it has already, if one of them gives it."""
    feeders = list(feeders)
    running = site.candidates[unit].running
    old = running.feeds.get(port.name) if running else None
    if old is not None and site.index_of.get(old.unit) in feeders and site.gives(old, port.tag):
        return old
    return Stream(site.candidates[feeders[0]].id, site.port_for(feeders[0], port.tag))


def published_port(site: Site, publisher: int, tag: str, topic: str) -> str:
    """The output to publish on the topic: the one that does already, if it matches."""
    candidate = site.candidates[publisher]
    for publication in candidate.running.publications if candidate.running else ():
        if publication.topic == topic and site.gives(Stream(candidate.id, publication.port), tag):
            return publication.port
    return site.port_for(publisher, tag)


def _publisher(site: Site, tag: str, topic: str, chosen: Collection[int]) -> int | None:
    """Who publishes the topic: a unit that does already and may stay, else one that has to change anyway."""

    def reluctance(feeder: int) -> tuple[bool, bool, int]:
        candidate = site.candidates[feeder]
        publishes = candidate.running is not None and any(p.topic == topic for p in candidate.running.publications)
        return not publishes, candidate.may_stay != publishes, feeder

    return min((feeder for feeder in site.feeders(tag) if feeder in chosen), key=reluctance, default=None)


class _Ordering:
    """Places chosen units from sources on, each with the feeder of each input; units that can stay come first.

    A unit is looked at when the last thing that it waits for is placed, so that a chain takes as many looks as it has
    units.
    """

    def __init__(self, site: Site, chosen: Collection[int]) -> None:
        self.placed: dict[int, dict[str, int]] = {}
        self._site, self._chosen = site, frozenset(chosen)
        self._feeders: dict[str, list[int]] = {}
        self._first: dict[str, int] = {}
        self._gives: dict[int, list[str]] = defaultdict(list)
        self._readers: dict[str, list[int]] = defaultdict(list)
        self._choosy: dict[str, list[int]] = defaultdict(list)
        self._unfed: dict[int, int] = {}
        self._kept_by: dict[int, list[int]] = defaultdict(list)
        self._gone: dict[int, int] = {}
        self._staying: list[int] = []
        self._changing: list[int] = []
        self._others: list[int] = []
        self._ready: set[int] = set()
        for i in sorted(self._chosen):
            self._wait(i)

    def run(self) -> bool:
        """Place all; False if some of them can't be."""
        while len(self.placed) < len(self._chosen):
            if self._staying:
                ready = {i: {s.port: self._site.index_of[s.stream.unit] for s in self._old(i)} for i in self._staying}
                self._staying = []
            else:
                ready = {i: feeds for i in self._next() if (feeds := self._new_feeds(i)) is not None}
            if not ready:
                return False
            self.placed |= ready
            for i in ready:
                self._tell(i)
        return True

    def _old(self, unit: int) -> tuple[Subscription, ...]:
        return self._site.old_subscriptions(unit)

    def _wait(self, unit: int) -> None:
        """Note what a unit waits for: its old feeders if it can stay with them, and a feeder for each demanded tag."""
        candidate = self._site.candidates[unit]
        ports = candidate.transformation.input
        old = {s.port: self._site.index_of.get(s.stream.unit, -1) for s in self._old(unit)}
        if candidate.may_stay and self._chosen.issuperset(old.values()):
            before = [feeder for port, feeder in old.items() if not ports[port].feedback]
            self._gone[unit] = len(before)
            for feeder in before:
                self._kept_by[feeder].append(unit)
            if not before:
                self._staying.append(unit)
        tags = {port.tag: port.feedback for port in sorted(ports.values(), key=lambda port: not port.feedback)}
        self._unfed[unit] = sum(not is_feedback or not self._feeding(tag) for tag, is_feedback in tags.items())
        for tag in (tag for tag, is_feedback in tags.items() if not is_feedback and self._feeding(tag)):
            self._readers[tag].append(unit)
        for tag in {port.tag for group in distinct_groups(candidate.transformation) for port in group}:
            self._choosy[tag].append(unit)
        self._look_at(unit)

    def _feeding(self, tag: str) -> list[int]:
        """The chosen units that give what a tag demands, in order."""
        if tag not in self._feeders:
            self._feeders[tag] = sorted(i for i in self._site.feeders(tag) if i in self._chosen)
            for feeder in self._feeders[tag]:
                self._gives[feeder].append(tag)
        return self._feeders[tag]

    def _look_at(self, unit: int) -> None:
        """Let a unit be wired anew if now it can be."""
        if self._unfed[unit] or unit in self._ready or unit in self.placed or self._new_feeds(unit) is None:
            return
        self._ready.add(unit)
        if unit in self._gone:
            heappush(self._others, unit)
        else:
            self._changing.append(unit)

    def _next(self) -> list[int]:
        """The units to be wired anew: all that have to change anyway, else the first."""
        if self._changing:
            changing, self._changing = self._changing, []
            return sorted(changing)
        while self._others and self._others[0] in self.placed:
            heappop(self._others)
        return self._others[:1]

    def _tell(self, unit: int) -> None:
        """Tell those that wait for a unit that it is placed."""
        for reader in self._kept_by.pop(unit, ()):
            self._gone[reader] -= 1
            if not self._gone[reader] and reader not in self.placed:
                self._staying.append(reader)
        for tag in self._gives[unit]:
            is_first = tag not in self._first
            self._first[tag] = min(unit, self._first.get(tag, unit))
            for reader in self._readers[tag] if is_first else ():
                self._unfed[reader] -= 1
                self._look_at(reader)
            for reader in self._choosy[tag]:
                self._look_at(reader)

    def _new_feeds(self, unit: int) -> dict[str, int] | None:
        """A feeder for each input of a unit among those before it, the present one if possible.

        None if there are too few different ones for a distinct group.
        """
        transformation = self._site.candidates[unit].transformation
        old = {s.port: self._site.index_of.get(s.stream.unit, -1) for s in self._old(unit)}
        feeds: dict[str, int] = {}
        for port in transformation.inputs:
            present = old.get(port.name, -1)
            stays = present in self._before(port) and port.tag in self._gives[present]
            feeds[port.name] = (
                present if stays else self._feeders[port.tag][0] if port.feedback else self._first[port.tag]
            )
        for group in distinct_groups(transformation):
            first: dict[str, dict[str, int]] = {}
            for port in group:
                by_label = first[port.name] = {}
                for i in (feeds[port.name], *self._feeders[port.tag]):
                    if i in self._before(port):
                        by_label.setdefault(self._site.candidates[i].transformation.label, i)
            assigned = assign_different(first)
            if assigned is None:
                return None
            feeds.update({name: first[name][label] for name, label in assigned.items()})
        return feeds

    def _before(self, port: InputPort) -> Collection[int]:
        """Who may feed an input: what is placed, or at a feedback input whatever is chosen."""
        return self._chosen if port.feedback else self.placed
