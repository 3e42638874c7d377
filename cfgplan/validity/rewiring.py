"""Search for a wiring that meets targets if units compete for streams.

They compete if outputs have a `serves` limit, or an input takes all streams: a further unit may then take a stream that
another one needs, or close a cycle. So the search starts only units that it needs, and tries every way to feed them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from functools import cache

from cfgplan.domain import ALL, ComputationUnit, InputPort, Similarity, Stream, Target, Transformation
from cfgplan.frozen import dataclass

Known = tuple[ComputationUnit, Transformation]
"""A unit and its transformation."""


@dataclass(frozen=True)
class _Need:
    """A need for streams or for a running unit.

    A topic needs one stream. With a `port`, the input of the unit `reader` needs `more` streams, of units after the
    place `last`. With a `label`, a running unit of that transformation is needed: on `host`, if the need `is_local`.
    """

    tag: str = ""
    reader: str = ""
    port: InputPort | None = None
    more: int = 1
    last: int = -1
    label: str | None = None
    host: str | None = None
    is_local: bool = False


@dataclass
class _PartialWiring:
    """A wiring under construction: running units, who feeds whom, and needs that are still open."""

    needs: list[_Need]
    running: set[str] = field(default_factory=set)
    readers: dict[str, set[str]] = field(default_factory=dict)
    """The units that each unit feeds, except by feedback inputs."""
    taken: dict[Stream, int] = field(default_factory=dict)
    groups: set[tuple[str, str, str]] = field(default_factory=set)
    """A unit, a distinct group of its inputs, and a transformation that feeds the group."""

    def copy(self) -> _PartialWiring:
        readers = {unit: set(these) for unit, these in self.readers.items()}
        return _PartialWiring(list(self.needs), set(self.running), readers, dict(self.taken), set(self.groups))

    def leads_to(self, start: str, end: str) -> bool:
        """Whether a unit is another one, or feeds it directly or through others."""
        seen, ahead = {start}, [start]
        for here in ahead:
            new = self.readers.get(here, set()) - seen
            seen |= new
            ahead += new
        return end in seen


class Rewiring:
    """A search for a wiring of some of the given units that meets every target."""

    def __init__(self, units: list[Known], similarity: Similarity, targets: tuple[Target, ...]) -> None:
        self._units = {unit.id: (unit, kind) for unit, kind in sorted(units, key=lambda known: known[0].id)}
        self._place = {unit_id: place for place, unit_id in enumerate(self._units)}
        self._holds = similarity.holds
        self._targets = targets
        self._offers = cache(self._streams)
        kinds = {kind.label: kind for _, kind in units}.values()
        is_limited = any(port.serves is not None for kind in kinds for port in kind.outputs)
        self._is_shared = is_limited or any(port.count == ALL for kind in kinds for port in kind.inputs)

    def exists(self) -> bool:
        """Return whether some of the units can run, all fed, so that every target is met.

        Each target by itself is tried first.
        """
        wanted = [_Need(target.tag) if target.run is None else _Need(label=target.run) for target in self._targets]
        parts = [[one] for one in wanted] if len(wanted) > 1 else []
        return not self._is_shared or all(self._can_be_met(needs) for needs in (*parts, wanted))

    def _can_be_met(self, needs: list[_Need]) -> bool:
        ahead = [iter([_PartialWiring(list(needs))])]
        while ahead:
            wiring = next(ahead[-1], None)
            if wiring is None:
                ahead.pop()
            elif not wiring.needs:
                return True
            else:
                ahead.append(self._ways(wiring, wiring.needs.pop()))
        return False

    def _ways(self, wiring: _PartialWiring, need: _Need) -> Iterator[_PartialWiring]:
        """Yield the wiring with the need met, or with one stream more for it, in every way."""
        if need.label is not None:
            units = [i for i, (u, kind) in self._units.items() if kind.label == need.label]
            units = [i for i in units if not need.is_local or self._units[i][0].host == need.host]
            yield from self._with_one_of(wiring, units)
        elif need.port is not None and need.port.count == ALL:
            yield from self._with_one_of(wiring, [s.unit for s in self._offers(need.tag) if s.unit != need.reader])
        else:
            yield from self._fed(wiring, need)

    def _with_one_of(self, wiring: _PartialWiring, units: list[str]) -> Iterator[_PartialWiring]:
        """The wiring if one of the units runs; else with each of them started."""
        if not wiring.running.isdisjoint(units):
            yield wiring
            return
        for unit_id in sorted(self._next(wiring).intersection(units)):
            started = wiring.copy()
            if self._starts(started, unit_id):
                yield started

    def _fed(self, wiring: _PartialWiring, need: _Need) -> Iterator[_PartialWiring]:
        """With each stream that may feed the need, those of running units first."""
        following = self._next(wiring)
        streams = [s for s in self._offers(need.tag) if self._place[s.unit] > need.last]
        running = [s for s in streams if s.unit in wiring.running]
        for stream in [*running, *(s for s in streams if s.unit in following)]:
            fed = wiring.copy()
            if need.more > 1:
                last = self._place[stream.unit]
                fed.needs.append(_Need(need.tag, need.reader, need.port, need.more - 1, last))
            is_there = stream.unit in fed.running or self._starts(fed, stream.unit)
            if is_there and self._connects(fed, stream, need.reader, need.port):
                yield fed

    def _next(self, wiring: _PartialWiring) -> set[str]:
        """Yield the first stopped unit of each transformation on each host: the others are interchangeable with it."""
        found: dict[tuple[str, str | None], str] = {}
        for unit_id, (unit, kind) in self._units.items():
            if unit_id not in wiring.running:
                found.setdefault((kind.label, unit.host), unit_id)
        return set(found.values())

    def _starts(self, wiring: _PartialWiring, unit_id: str) -> bool:
        """Start a unit with its needs; False if an input that takes all streams can't take this unit's."""
        unit, kind = self._units[unit_id]
        others = [self._units[other] for other in sorted(wiring.running)]
        wiring.running.add(unit_id)
        for port in kind.needed_inputs:
            wiring.needs.append(_Need(port.tag, unit_id, port, port.count))
        wiring.needs.extend(_Need(label=other, host=unit.host, is_local=True) for other in kind.beside)
        pairs = [pair for other in others for pair in ((other, (unit, kind)), ((unit, kind), other))]
        return all(
            self._connects(wiring, Stream(giver.id, output.name), taker.id, port)
            for (giver, gives), (taker, takes) in pairs
            for port in takes.inputs
            for output in gives.outputs
            if port.count == ALL and self._holds(output.tag, port.tag)
        )

    def _connects(self, wiring: _PartialWiring, stream: Stream, reader: str, port: InputPort | None) -> bool:
        """Feed an input, or a topic, by a stream of a running unit; False if that breaks a rule."""
        _, kind = self._units[stream.unit]
        most = kind.output[stream.port].serves
        wiring.taken[stream] = wiring.taken.get(stream, 0) + 1
        if most is not None and wiring.taken[stream] > most:
            return False
        if port is not None and port.distinct is not None:
            entry = (reader, port.distinct, kind.label)
            if entry in wiring.groups:
                return False
            wiring.groups.add(entry)
        if port is not None and not port.feedback:
            if wiring.leads_to(reader, stream.unit):
                return False
            wiring.readers.setdefault(stream.unit, set()).add(reader)
        return True

    def _streams(self, tag: str) -> list[Stream]:
        return [
            Stream(unit_id, port.name)
            for unit_id, (_, kind) in self._units.items()
            for port in kind.outputs
            if self._holds(port.tag, tag)
        ]
