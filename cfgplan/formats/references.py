"""Running units as written: what they refer to must be there, and they may not feed each other in a ring."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter

from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription, Target, Transformation
from cfgplan.errors import Fault, InvalidValueError
from cfgplan.formats.document import Document
from cfgplan.formats.fields import UnitPart
from cfgplan.formats.fleet import FleetReader
from cfgplan.formats.left_out import LeftOut
from cfgplan.formats.places import Path, Source
from cfgplan.formats.suggestions import did_you_mean

MOST_CYCLES_SHOWN = 10


class UnitChecker:
    """Makes the units of one document; what is wrong goes into `faults`.

    A reference to what may be a part that is left out for its own faults is no fault.
    """

    def __init__(
        self,
        document: Document,
        left_out: LeftOut,
        library: Mapping[str, Transformation],
        targets: Mapping[str, Target],
        fleet: FleetReader,
        origins: dict[tuple[str, str], tuple[Source, Path]],
        faults: list[Fault],
    ) -> None:
        self._document = document
        self._left_out = left_out
        self._library = library
        self._topics = {target.topic for target in targets.values()}
        self._fleet = fleet
        self._origins = origins
        self._faults = faults
        self._parts: dict[str, tuple[Source, Path, UnitPart]] = {}

    def units(self) -> list[ComputationUnit]:
        """The units that have no faults."""
        for file in self._document.files:
            for index, part in file.units:
                self._register(file.source, ("units", index), part)
        units = [self._unit(source, path, part) for source, path, part in self._parts.values()]
        self._check_cycles(units)
        return units

    def _register(self, source: Source, path: Path, part: UnitPart) -> None:
        if part.id in self._parts:
            first_source, first_path, _ = self._parts[part.id]
            first = first_source.place(first_path)
            message = f"the unit id `{part.id}` is taken: it stands in {first.file}, line {first.line} already"
            self._faults.append(source.fault((*path, "id"), message, "give each unit an id of its own"))
            return
        self._parts[part.id] = (source, path, part)
        self._origins["unit", part.id] = (source, path)

    def _unit(self, source: Source, path: Path, part: UnitPart) -> ComputationUnit:
        transformation = self._library.get(part.transformation)
        if transformation is None and not self._left_out.may_have("transformations", part.transformation):
            hint = "write the label of one of the transformations, templates expanded"
            mend = did_you_mean(part.transformation, self._library, hint)
            message = f"there is no transformation `{part.transformation}`"
            self._faults.append(source.fault((*path, "transformation"), message, mend))
        subscriptions = tuple(self._subscriptions(source, path, part, transformation))
        publications = tuple(self._publications(source, path, part, transformation))
        if part.standby and (subscriptions or publications):
            message = f"unit `{part.id}` is a spare that does not run, so it can't have inputs or topics"
            self._faults.append(source.fault((*path, "standby"), message, "remove them, or `standby`"))
            subscriptions = publications = ()
        host = self._host(source, path, part, transformation)
        wiring = {"subscriptions": subscriptions, "publications": publications, "host": host}
        return ComputationUnit(**{**part.values(), **wiring})

    def _host(self, source: Source, path: Path, part: UnitPart, transformation: Transformation | None) -> str | None:
        if transformation is None:
            return None
        allowed = transformation.hosts if transformation.host is None else (transformation.host,)
        only = allowed[0] if len(allowed) == 1 else None
        return self._fleet.host_of(source, path, part, only)

    def _subscriptions(
        self, source: Source, path: Path, part: UnitPart, transformation: Transformation | None
    ) -> Iterator[Subscription]:
        for port, text in (part.inputs or {}).items():
            place = (*path, "inputs", port)
            if transformation is not None and port not in transformation.input:
                self._note_unknown_port(source, place, port, "input", transformation, list(transformation.input))
            if text is None:
                continue
            try:
                stream = Stream.parse(text)
            except InvalidValueError:
                mend = "write it as unit/port, such as `camera.1/image`"
                self._faults.append(source.fault(place, f"{text!r} is not a stream", mend))
                continue
            self._check_stream(source, place, stream)
            yield Subscription(port, stream)

    def _check_stream(self, source: Source, place: Path, stream: Stream) -> None:
        feeder = self._parts.get(stream.unit)
        if feeder is None:
            if not self._left_out.may_have("units", stream.unit):
                mend = did_you_mean(stream.unit, self._parts, "write null if the feeder is gone")
                self._faults.append(source.fault(place, f"no unit `{stream.unit}` is running", mend))
            return
        transformation = self._library.get(feeder[2].transformation)
        if transformation is not None and stream.port not in transformation.output:
            self._note_unknown_port(
                source, place, stream.port, "output", transformation, list(transformation.output), at_key=False
            )

    def _publications(
        self, source: Source, path: Path, part: UnitPart, transformation: Transformation | None
    ) -> Iterator[Publication]:
        times = Counter(topic for topics in (part.topics or {}).values() for topic in topics)
        seen: set[str] = set()
        for port, topics in (part.topics or {}).items():
            if transformation is not None and port not in transformation.output:
                place = (*path, "topics", port)
                self._note_unknown_port(source, place, port, "output", transformation, list(transformation.output))
            for index, topic in enumerate(topics):
                place = (*path, "topics", port, index)
                if topic not in self._topics and not self._left_out.any_of("targets"):
                    mend = did_you_mean(topic, self._topics, "add a target with this topic, or remove it here")
                    self._faults.append(source.fault(place, f"no target names the topic `{topic}`", mend))
                if topic in seen:
                    message = f"the unit publishes on `{topic}` {times[topic]} times"
                    self._faults.append(source.fault(place, message, "publish one stream on a topic"))
                    continue
                seen.add(topic)
                yield Publication(port, topic)

    def _note_unknown_port(
        self,
        source: Source,
        place: Path,
        port: str,
        kind: str,
        transformation: Transformation,
        known: list[str],
        *,
        at_key: bool = True,
    ) -> None:
        hint = f"its {kind}s are {', '.join(known)}" if known else f"it has no {kind}s"
        message = f"transformation `{transformation.label}` has no {kind} `{port}`"
        self._faults.append(source.fault(place, message, did_you_mean(port, known, hint), at_key=at_key))

    def _check_cycles(self, units: list[ComputationUnit]) -> None:
        feeders: dict[str, dict[str, str]] = {}
        for unit in units:
            transformation = self._library.get(unit.transformation)
            if transformation is None:
                continue
            for port, stream in unit.feeds.items():
                if port in transformation.input and not transformation.input[port].feedback:
                    feeders.setdefault(unit.id, {})[stream.unit] = port
        for _ in range(MOST_CYCLES_SHOWN):
            try:
                TopologicalSorter(feeders).prepare()
            except CycleError as error:
                # graphlib's ring runs from a feeder to the unit that it feeds, beginning anywhere.
                ring = error.args[1][1:]
                start = ring.index(min(ring))
                ring = [*ring[start:], *ring[: start + 1]]
                feeder, fed = ring[-2:]
                self._note_cycle(ring, fed, feeders[fed].pop(feeder))
            else:
                return

    def _note_cycle(self, ring: list[str], fed: str, port: str) -> None:
        source, path, _ = self._parts[fed]
        if len(ring) == 2:
            message = f"unit `{fed}` feeds itself"
        else:
            message = f"units feed each other in a cycle: {' -> '.join(ring)}"
        mend = "feed one of them from outside, write null, or declare the input `feedback: true`"
        self._faults.append(source.fault((*path, "inputs", port), message, mend))
