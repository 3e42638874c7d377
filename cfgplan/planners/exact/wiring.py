"""A wiring for a given choice of units, without search: whatever can stay as it is stays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from heapq import heappop, heappush

from cfgplan.domain import ComputationUnit, InputPort, Publication, Stream, Subscription, Target
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.reasons import assign_different, distinct_groups


def wire(candidates: Candidates, chosen: Collection[int]) -> list[ComputationUnit] | None:
    """The chosen candidates wired, kept ones on their hosts; None if they do not ground each other.

    Where nothing is asked beyond the paper, those that nothing needs are left out. Raises OutOfTimeError by the
    candidates' clock.
    """
    ordering = _Ordering(candidates, chosen)
    is_grounded = ordering.run()
    targets = candidates.environment.targets
    publisher = {target.label: _publisher(candidates, target, chosen) for target in targets}
    if not is_grounded or None in publisher.values():
        return None
    topics: dict[int, list[Publication]] = defaultdict(list)
    for target in candidates.environment.stream_targets:
        who = publisher[target.label]
        assert who is not None
        topics[who].append(Publication(published_stream(candidates, who, target).port, target.topic))
    ahead = sorted({*topics, *filter(candidates.is_pinned, chosen)} if candidates.problem.is_plain else chosen)
    units: dict[int, ComputationUnit] = {}
    for i in ahead:
        if i not in units:
            candidate = candidates.all[i]
            feeds = candidate.running.feeds if candidate.running is not None else {}
            placed = ordering.placed[i]
            subscriptions = tuple(
                Subscription(p.name, candidates.stream_of(placed[p.name], p.tag, feeds.get(p.name, ())))
                for p in candidate.transformation.inputs
            )
            host = None if candidate.running is None else candidate.running.host
            label = candidate.transformation.label
            units[i] = ComputationUnit(candidate.id, label, subscriptions, tuple(topics[i]), host)
            ahead += placed.values()
    return list(units.values())


def forced_changes(candidates: Candidates, chosen: Collection[int]) -> int:
    """How many of the chosen running units must be rewired, whatever the wiring."""
    kept = {candidates.all[i].id for i in chosen}
    running = {i: unit for i in chosen if (unit := candidates.all[i].running) is not None}
    return sum(
        not (candidates.may_stay(i) and all(s.stream.unit in kept for s in unit.subscriptions))
        for i, unit in running.items()
    )


def published_stream(candidates: Candidates, publisher: int, target: Target) -> Stream:
    """The stream to publish as the target: the one on its topic already, if that matches."""
    running = candidates.all[publisher].running
    old = [Stream(running.id, p.port) for p in running.publications if p.topic == target.topic] if running else []
    return candidates.stream_of(publisher, target.tag, old)


def _publisher(candidates: Candidates, target: Target, chosen: Collection[int]) -> int | None:
    """The publisher of a target: a unit that is it already and may stay, else one that has to change anyway.

    Of a target that wants a unit, such a one. None if no chosen unit can be.
    """

    def reluctance(feeder: int) -> tuple[bool, bool, int]:
        running = candidates.all[feeder].running
        publishes = running is not None and any(p.topic == target.topic for p in running.publications)
        return not publishes, candidates.may_stay(feeder) != publishes, feeder

    return min((feeder for feeder in candidates.feeders(target.tag) if feeder in chosen), key=reluctance, default=None)


class _Ordering:
    """Places chosen units from sources on, each with the feeder of each input; units that can stay come first.

    A unit is looked at when the last unit that it waits for is placed, so that a chain takes as many looks as it has
    units.
    """

    def __init__(self, candidates: Candidates, chosen: Collection[int]) -> None:
        self.placed: dict[int, dict[str, int]] = {}
        self._candidates, self._chosen = candidates, frozenset(chosen)
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
        for i in candidates.clock.each(sorted(self._chosen)):
            self._wait(i)

    def run(self) -> bool:
        """Place all; False if some of them can't be."""
        for _ in self._candidates.clock.each(self._chosen):
            if len(self.placed) == len(self._chosen):
                break
            if self._staying:
                ready = {
                    i: {s.port: self._candidates.index_of[s.stream.unit] for s in self._old(i)} for i in self._staying
                }
                self._staying = []
            else:
                ready = {i: feeds for i in self._next() if (feeds := self._new_feeds(i)) is not None}
            if not ready:
                return False
            self.placed |= ready
            for i in ready:
                self._tell(i)
        return len(self.placed) == len(self._chosen)

    def _old(self, unit: int) -> tuple[Subscription, ...]:
        running = self._candidates.all[unit].running
        return running.subscriptions if running is not None else ()

    def _wait(self, unit: int) -> None:
        """Note what a unit waits for: its old feeders if it can stay with them, and a feeder for each demanded tag."""
        candidate = self._candidates.all[unit]
        ports = candidate.transformation.input
        old = {s.port: self._candidates.index_of.get(s.stream.unit, -1) for s in self._old(unit)}
        if self._candidates.may_stay(unit) and self._chosen.issuperset(old.values()):
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
            self._feeders[tag] = sorted(i for i in self._candidates.feeders(tag) if i in self._chosen)
            for feeder in self._feeders[tag]:
                self._gives[feeder].append(tag)
        return self._feeders[tag]

    def _look_at(self, unit: int) -> None:
        """Queue a unit to be wired anew if now it can be."""
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
        transformation = self._candidates.all[unit].transformation
        old = {s.port: self._candidates.index_of.get(s.stream.unit, -1) for s in self._old(unit)}
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
                        by_label.setdefault(self._candidates.all[i].transformation.label, i)
            assigned = assign_different(first)
            if assigned is None:
                return None
            feeds.update({name: first[name][label] for name, label in assigned.items()})
        return feeds

    def _before(self, port: InputPort) -> Collection[int]:
        """Who may feed an input: what is placed, or at a feedback input whatever is chosen."""
        return self._chosen if port.feedback else self.placed
