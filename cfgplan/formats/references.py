"""Running units as written: their references must exist, and they must not feed each other in a cycle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription, Transformation
from cfgplan.errors import InvalidValueError, did_you_mean
from cfgplan.formats.fields import UnitPart
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Passage

MOST_CYCLES_SHOWN = 10


class UnitChecker:
    """Makes units from `parts` (by id: each unit as written, with its place) and notes faults at their places.

    A reference is no fault if it may name a part that was left out for its own faults.
    """

    def __init__(
        self,
        parts: Mapping[str, tuple[Passage, UnitPart]],
        library: Mapping[str, Transformation],
        topics: Collection[str],
        fleet: FleetReader,
        left_out: LeftOut,
    ) -> None:
        self._parts = parts
        self._library = library
        self._topics = topics
        self._fleet = fleet
        self._left_out = left_out

    def units(self) -> list[ComputationUnit]:
        """The units that have no faults."""
        units = [self._unit(entry, part) for entry, part in self._parts.values()]
        self._check_cycles(units)
        return units

    def _unit(self, entry: Passage, part: UnitPart) -> ComputationUnit:
        transformation, host = self._library.get(part.transformation), None
        if transformation is not None:
            allowed = transformation.hosts if transformation.host is None else (transformation.host,)
            host = self._fleet.host_of(entry, part, allowed[0] if len(allowed) == 1 else None)
        elif not self._left_out.may_have("transformations", part.transformation):
            hint = "write the label of one of the transformations, templates expanded"
            mend = did_you_mean(part.transformation, self._library, hint)
            entry.at("transformation").note(f"there is no transformation `{part.transformation}`", mend)
        subscriptions = tuple(self._subscriptions(entry.at("inputs"), part, transformation))
        publications = tuple(self._publications(entry.at("topics"), part, transformation))
        if part.standby and (subscriptions or publications):
            message = f"unit `{part.id}` is a spare that does not run, so it can't have inputs or topics"
            entry.at("standby").note(message, "remove them, or `standby`")
            subscriptions = publications = ()
        wiring = {"subscriptions": subscriptions, "publications": publications, "host": host}
        return ComputationUnit(**{**part.values(), **wiring})

    def _subscriptions(
        self, entry: Passage, part: UnitPart, transformation: Transformation | None
    ) -> Iterator[Subscription]:
        for port, said in (part.inputs or {}).items():
            if transformation is not None and port not in transformation.input:
                _note_unknown_port(entry.at(port), port, "input", transformation)
            places = [(entry.at(port), said)] if isinstance(said, str) else self._each(entry.at(port), said or [])
            for place, text in places:
                try:
                    stream = Stream.parse(text)
                except InvalidValueError:
                    place.note(f"{text!r} is not a stream", "write it as unit/port, such as `camera.1/image`")
                    continue
                self._check_stream(place, stream)
                yield Subscription(port, stream)

    def _each(self, entry: Passage, streams: Sequence[str]) -> list[tuple[Passage, str]]:
        """Return the streams of a list with their places; a stream listed twice is noted."""
        for index, stream in enumerate(streams):
            if stream in streams[:index]:
                entry.at(index).note(f"`{stream}` feeds the input twice", "name it once")
        return [(entry.at(index), stream) for index, stream in enumerate(streams) if stream not in streams[:index]]

    def _check_stream(self, entry: Passage, stream: Stream) -> None:
        if stream.unit not in self._parts:
            if not self._left_out.may_have("units", stream.unit):
                mend = did_you_mean(stream.unit, self._parts, "write null if the feeder is gone")
                entry.note(f"no unit `{stream.unit}` is running", mend)
            return
        _, feeder = self._parts[stream.unit]
        transformation = self._library.get(feeder.transformation)
        if transformation is not None and stream.port not in transformation.output:
            _note_unknown_port(entry, stream.port, "output", transformation, at_key=False)

    def _publications(
        self, entry: Passage, part: UnitPart, transformation: Transformation | None
    ) -> Iterator[Publication]:
        times = Counter(topic for topics in (part.topics or {}).values() for topic in topics)
        seen: set[str] = set()
        for port, topics in (part.topics or {}).items():
            if transformation is not None and port not in transformation.output:
                _note_unknown_port(entry.at(port), port, "output", transformation)
            for index, topic in enumerate(topics):
                place = entry.at(port, index)
                if topic not in self._topics and not self._left_out.any_of("targets"):
                    mend = did_you_mean(topic, self._topics, "add a target with this topic, or remove it here")
                    place.note(f"no target names the topic `{topic}`", mend)
                if topic in seen:
                    place.note(f"the unit publishes on `{topic}` {times[topic]} times", "publish one stream on a topic")
                    continue
                seen.add(topic)
                yield Publication(port, topic)

    def _check_cycles(self, units: list[ComputationUnit]) -> None:
        feeders: dict[str, dict[str, str]] = {}
        for unit in units:
            transformation = self._library.get(unit.transformation)
            if transformation is None:
                continue
            for s in unit.subscriptions:
                if s.port in transformation.input and not transformation.input[s.port].feedback:
                    feeders.setdefault(unit.id, {})[s.stream.unit] = s.port
        for _ in range(MOST_CYCLES_SHOWN):
            try:
                TopologicalSorter(feeders).prepare()
            except CycleError as error:
                # graphlib's cycle runs from a feeder to the unit that it feeds, beginning anywhere.
                cycle = error.args[1][1:]
                start = cycle.index(min(cycle))
                cycle = [*cycle[start:], *cycle[: start + 1]]
                feeder, fed = cycle[-2:]
                self._note_cycle(cycle, fed, feeders[fed].pop(feeder))
            else:
                return

    def _note_cycle(self, cycle: list[str], fed: str, port: str) -> None:
        entry, _ = self._parts[fed]
        message = f"units feed each other in a cycle: {' -> '.join(cycle)}"
        if len(cycle) == 2:
            message = f"unit `{fed}` feeds itself"
        mend = "feed one of them from outside, write null, or declare the input `feedback: true`"
        entry.at("inputs", port).note(message, mend)


def _note_unknown_port(
    entry: Passage, port: str, kind: str, transformation: Transformation, *, at_key: bool = True
) -> None:
    known = list(transformation.input if kind == "input" else transformation.output)
    hint = f"its {kind}s are {', '.join(known)}" if known else f"it has no {kind}s"
    message = f"transformation `{transformation.label}` has no {kind} `{port}`"
    entry.note(message, did_you_mean(port, known, hint), at_key=at_key)
