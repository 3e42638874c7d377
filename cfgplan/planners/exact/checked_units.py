"""The units of a configuration that is checked, and what rules ask of them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection
from functools import cached_property

from cfgplan.domain import ComputationUnit, Stream, Transformation
from cfgplan.planners.exact.candidates import Candidates


class CheckedUnits:
    """Units, of which the `hot` ones run, and figures of them."""

    def __init__(self, candidates: Candidates, units: Collection[ComputationUnit]) -> None:
        self.candidates, self.problem, self.environment = candidates, candidates.problem, candidates.environment
        self.units = units
        self.hot = {unit.id: unit for unit in units if not unit.standby}
        self._offers: dict[str, list[Stream]] = {}

    @cached_property
    def there(self) -> Counter[str]:
        """The number of units of each transformation, spares included."""
        return Counter(unit.transformation for unit in self.units)

    @cached_property
    def running(self) -> Counter[str]:
        """The number of running units of each transformation."""
        return Counter(unit.transformation for unit in self.hot.values())

    def kind(self, unit: ComputationUnit) -> Transformation:
        """The transformation of a unit."""
        return self.environment.transformation[unit.transformation]

    def offers(self, tag: str) -> list[Stream]:
        """The streams of running units that match a demanded tag."""
        if tag not in self._offers:
            holds, ports = (
                self.problem.similarity.holds,
                ((u.id, p) for u in self.hot.values() for p in self.kind(u).outputs),
            )
            self._offers[tag] = [Stream(unit_id, port.name) for unit_id, port in ports if holds(port.tag, tag)]
        return self._offers[tag]

    @cached_property
    def left_to_serve(self) -> dict[Stream, int]:
        """How many more inputs and topics may take each stream that serves only so many."""
        taken = Counter(s.stream for unit in self.units for s in unit.subscriptions)
        taken.update(Stream(unit.id, p.port) for unit in self.units for p in unit.publications)
        return {
            stream: port.serves - taken[stream]
            for unit in self.hot.values()
            for port in self.kind(unit).outputs
            for stream in [Stream(unit.id, port.name)]
            if port.serves is not None
        }

    @cached_property
    def readers(self) -> dict[str, list[str]]:
        """The units that each unit feeds, except by feedback inputs."""
        readers: dict[str, list[str]] = defaultdict(list)
        for unit in self.hot.values():
            inputs = self.kind(unit).input
            for s in unit.subscriptions:
                if not inputs[s.port].feedback:
                    readers[s.stream.unit].append(unit.id)
        return readers
