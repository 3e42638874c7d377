"""Which chosen candidates can run on each other's streams, and which streams may feed each of their inputs.

Streams are added one by one, the best first, and a unit runs as soon as earlier streams can feed its inputs. So there
is no cycle. Where no rule makes a value better than its inputs, values are as good as the choice allows.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from heapq import heappop, heappush

from cfgplan.domain import InputPort, Stream
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.qualities import Better, QualityAttribute, propagated
from cfgplan.reasons import assign_different, distinct_groups


class Grounded:
    """The candidates that run, in an `order` in which they can be started, and the `streams` that meet each tag."""

    def __init__(self, candidates: Candidates, chosen: Collection[int], attribute: QualityAttribute | None) -> None:
        """With an `attribute`, inputs are fed by the streams whose value of it is best."""
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
            self._ahead: list[tuple[int, int, Stream]] = []
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
        return self._as_good([s for s in self.streams.get(port.tag, ()) if self._place[s] < before])

    def published(self, tag: str) -> list[Stream]:
        """The streams that a target may take."""
        return self._as_good(self.streams.get(tag, []))

    def _as_good(self, streams: list[Stream]) -> list[Stream]:
        return [s for s in streams if self._attribute is None or self._value[s] == self._value[streams[0]]]

    def _tags_of_streams(self, chosen: Collection[int]) -> dict[Stream, list[str]]:
        all_of = self.candidates.all
        units = {all_of[i].id for i in chosen}
        tags = {port.tag for i in chosen for port in all_of[i].transformation.inputs}
        tags |= {target.tag for target in self.candidates.environment.targets}
        meets: dict[Stream, list[str]] = defaultdict(list)
        for tag in sorted(tags):
            for stream in self.candidates.streams(tag):
                if stream.unit in units:
                    meets[stream].append(tag)
        return meets

    def _start(self, chosen: list[int]) -> None:
        waiting: dict[str, list[int]] = defaultdict(list)
        missing: dict[int, int] = {}
        crowded: list[int] = []

        def look(unit: int) -> None:
            if distinct_groups(self.candidates.all[unit].transformation):
                crowded.append(unit)
            else:
                self._run(unit)

        for unit in chosen:
            tags = {port.tag for port in self.candidates.all[unit].transformation.inputs if not port.feedback}
            missing[unit] = len(tags)
            for tag in tags:
                waiting[tag].append(unit)
        for unit in chosen:
            if not missing[unit]:
                look(unit)
        while self._ahead:
            _, _, stream = heappop(self._ahead)
            self._place[stream] = len(self._place)
            for tag in self._meets.get(stream, ()):
                self.streams.setdefault(tag, []).append(stream)
                for unit in waiting.pop(tag, ()):
                    missing[unit] -= 1
                    if not missing[unit]:
                        look(unit)
            for unit in [unit for unit in crowded if self._assign(unit)]:
                crowded.remove(unit)
                self._run(unit)

    def _assign(self, unit: int) -> bool:
        """Feed the distinct groups of a unit by the streams so far. False if that is not possible."""
        all_of, index_of = self.candidates.all, self.candidates.index_of
        for group in distinct_groups(all_of[unit].transformation):
            first: dict[str, dict[str, Stream]] = {}
            for port in group:
                first[port.name] = {}
                for stream in self.streams.get(port.tag, ()):
                    first[port.name].setdefault(all_of[index_of[stream.unit]].transformation.label, stream)
            found = assign_different({name: list(labels) for name, labels in first.items()})
            if found is None:
                return False
            self._assigned |= {(unit, name): first[name][label] for name, label in found.items()}
        return True

    def _run(self, unit: int) -> None:
        candidate, attribute = self.candidates.all[unit], self._attribute
        self._before[unit] = len(self._place)
        self.order.append(unit)
        ordinary = [port for port in candidate.transformation.inputs if not port.feedback]
        inputs = [self._value[self.choices(unit, port)[0]] for port in ordinary]
        for port in candidate.transformation.outputs:
            stream, value, sign = Stream(candidate.id, port.name), 0, 1
            if attribute is not None:
                stated = {c.attribute: c for c in port.quality}.get(attribute.name)
                value = propagated(attribute, stated, inputs)
                sign = 1 if attribute.better is Better.LOWER else -1
            self._value[stream] = value
            heappush(self._ahead, (sign * value, len(self._value), stream))
