"""Grounding: the chosen candidates that can run on each other's streams, and the streams that may feed each input.

Streams are added one by one, and a unit runs as soon as earlier streams can feed its inputs, so no cycle arises. With
an attribute the best stream comes first: if no rule makes a value better than its inputs, values are as good as the
choice allows. Otherwise units that can stay as they are come first, and units that could only stay if others came
before come last.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from heapq import heappop, heappush
from itertools import chain, count, repeat
from typing import Final

from cfgplan.domain import InputPort, Stream
from cfgplan.onward import derivations, grouped
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.qualities import QualityAttribute, propagated
from cfgplan.reasons import assign_different

SOON: Final = -(2**62)
"""Comes before any value of a stream."""


class Grounded:
    """The candidates that run, in an `order` in which they can be started, and the `streams` that meet each tag."""

    def __init__(self, candidates: Candidates, chosen: Collection[int], attribute: QualityAttribute | None) -> None:
        """With an `attribute`, inputs are fed by the streams whose value of it is best. Raises OutOfTimeError."""
        self.candidates = candidates
        self._attribute = attribute
        self._meets = self._tags_of_streams(chosen)
        left = sorted(chosen)
        while True:
            self.order: list[int] = []
            self.streams: dict[str, list[Stream]] = {}
            self._value: dict[Stream, int] = {}
            self._place: dict[Stream, int] = {}
            self._before: dict[int, int] = {}
            self._assigned: dict[tuple[int, str], Stream] = {}
            self._missing_old: dict[int, int] = {}
            self._kept_by: dict[int, list[int]] = defaultdict(list)
            self._ahead: list[tuple[int, int, Stream | int]] = []
            self._number = count()
            self._note_who_may_stay(left if attribute is None else ())
            self._start(left)
            whole = [unit for unit in left if unit in self._before and self._has_feedback(unit)]
            if len(whole) == len(self.order):
                break
            left = whole

    def _has_feedback(self, unit: int) -> bool:
        """Whether the feedback inputs of a unit that runs can be fed."""
        return all(
            port.tag in self.streams for port in self.candidates.all[unit].transformation.inputs if port.feedback
        )

    def choices(self, unit: int, port: InputPort) -> list[Stream]:
        """The streams that may feed an input of a unit that runs, in the order in which they were added."""
        if (unit, port.name) in self._assigned:
            return [self._assigned[unit, port.name]]
        before = len(self._place) if port.feedback else self._before[unit]
        streams = self.streams.get(port.tag, [])
        return self._as_good(streams[: bisect_left(streams, before, key=self._place.__getitem__)])

    def published(self, tag: str) -> list[Stream]:
        """The streams that a target may take."""
        return self._as_good(self.streams.get(tag, []))

    def _as_good(self, streams: list[Stream]) -> list[Stream]:
        if self._attribute is None:
            return streams
        return [stream for stream in streams if self._value[stream] == self._value[streams[0]]]

    def _tags_of_streams(self, chosen: Collection[int]) -> dict[Stream, list[str]]:
        all_of = self.candidates.all
        units = {all_of[i].id for i in chosen}
        tags = {port.tag for i in chosen for port in all_of[i].transformation.inputs}
        tags |= {target.tag for target in self.candidates.environment.stream_targets}
        streams = ((stream, tag) for tag in sorted(tags) for stream in self.candidates.streams(tag))
        return grouped((stream, tag) for stream, tag in streams if stream.unit in units)

    def _note_who_may_stay(self, chosen: Sequence[int]) -> None:
        """Count for each unit that can stay as it is how many of those that feed it have to run before it."""
        candidates, there = self.candidates, frozenset(chosen)
        for unit in candidates.clock.each(chosen):
            running = candidates.all[unit].running
            if running is None or not candidates.may_stay(unit):
                continue
            ports = candidates.all[unit].transformation.input
            feeders = {s.port: candidates.index_of[s.stream.unit] for s in running.subscriptions}
            if there.issuperset(feeders.values()):
                before = {feeder for port, feeder in feeders.items() if not ports[port].feedback}
                self._missing_old[unit] = len(before)
                for feeder in before:
                    self._kept_by[feeder].append(unit)

    def _start(self, chosen: list[int]) -> None:
        """Run units one by one, those without distinct groups as soon as all their tags are offered."""
        waiting: dict[str, list[int]] = defaultdict(list)
        missing: dict[int, int] = {}
        crowded: list[int] = []
        for unit in chosen:
            tags = {port.tag for port in self.candidates.all[unit].transformation.inputs if not port.feedback}
            missing[unit] = len(tags)
            for tag in tags:
                waiting[tag].append(unit)
        sources = [unit for unit in chosen if not missing[unit]]
        for unit in chain(sources, (unit for unit, _ in derivations(self._offered(crowded), waiting, missing))):
            if self._assign(unit):
                self._wait(unit)
            else:
                crowded.append(unit)

    def _offered(self, crowded: list[int]) -> Iterator[str]:
        """Process units and streams in order; yield each tag at its first stream.

        A `crowded` unit has too few streams for a distinct group so far; it is tried again after each stream.
        """
        for _ in self.candidates.clock.each(repeat(None)):
            if not self._ahead:
                break
            _, _, item = heappop(self._ahead)
            if isinstance(item, int):
                self._run(item)
                continue
            self._place[item] = len(self._place)
            for tag in self._meets.get(item, ()):
                streams = self.streams.setdefault(tag, [])
                streams.append(item)
                if len(streams) == 1:
                    yield tag
            for unit in [unit for unit in crowded if unit in self._before or self._assign(unit)]:
                crowded.remove(unit)
                self._wait(unit)

    def _wait(self, unit: int) -> None:
        """Queue a unit that can be fed."""
        if self._attribute is not None:
            key = SOON
        elif unit not in self._missing_old:
            key = 1
        else:
            key = 2 if self._missing_old[unit] else 0
        heappush(self._ahead, (key, next(self._number), unit))

    def _assign(self, unit: int) -> bool:
        """Feed the distinct groups of a unit by streams so far, its present ones if possible. False if it is not."""
        all_of, index_of = self.candidates.all, self.candidates.index_of
        running = all_of[unit].running
        for group in all_of[unit].transformation.distinct_groups:
            if sum(len(self.streams.get(tag, ())) for tag in {port.tag for port in group}) < len(group):
                return False  # it is tried after each stream
            first: dict[str, dict[str, Stream]] = {}
            for port in group:
                first[port.name] = {}
                streams = self.streams.get(port.tag, [])
                old = () if running is None else running.feeds.get(port.name, ())
                for stream in (*(stream for stream in old if stream in streams), *streams):
                    first[port.name].setdefault(all_of[index_of[stream.unit]].transformation.label, stream)
            found = assign_different({name: list(labels) for name, labels in first.items()})
            if found is None:
                return False
            self._assigned |= {(unit, name): first[name][label] for name, label in found.items()}
        return True

    def _run(self, unit: int) -> None:
        if unit in self._before:
            return
        candidate, attribute = self.candidates.all[unit], self._attribute
        self._before[unit] = len(self._place)
        self.order.append(unit)
        self._assign(unit)
        ordinary = [port for port in candidate.transformation.inputs if attribute is not None and not port.feedback]
        inputs = [self._value[self.choices(unit, port)[0]] for port in ordinary]
        for port in candidate.transformation.outputs:
            stream, value, key = Stream(candidate.id, port.name), 0, -1
            if attribute is not None:
                from cfgplan.planners.exact.best_case import stated_of

                value = propagated(attribute, stated_of(port, attribute, candidate.hosts), inputs)
                key = attribute.sign * value
            self._value[stream] = value
            heappush(self._ahead, (key, next(self._number), stream))
        for reader in self._kept_by[unit]:
            self._missing_old[reader] -= 1
            if not self._missing_old[reader]:
                self._wait(reader)
