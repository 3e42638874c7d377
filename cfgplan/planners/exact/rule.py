"""A rule of validity as the planner keeps it, and what rules look at: units that are checked, and loads of hosts."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cfgplan.costs import taken
from cfgplan.domain import ComputationUnit, Environment, Host, Stream, Transformation
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planning import Feature, Problem

if TYPE_CHECKING:
    from cfgplan.planners.exact.model import Model  # the solver takes long to import


class CheckedUnits:
    """The units of a configuration; `hot` has those that run."""

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


Lacks = Callable[["HostLoads", Transformation, HostName], Iterator[str]]
"""What a rule says that a host lacks for one more unit, as text."""


class HostLoads:
    """The units that are placed on each host. Without hosts, one host has room for everything."""

    def __init__(self, problem: Problem, lacks: Iterable[Lacks]) -> None:
        self.problem, self.environment = problem, problem.environment
        self.taken: Counter[tuple[HostName, str]] = Counter()
        """The amounts of resources that units take, by host and resource."""
        self.there: dict[HostName, Counter[str]] = defaultdict(Counter)
        """The number of units of each transformation, by host."""
        self._lacks = tuple(lacks)

    def put(self, kind: Transformation, name: HostName) -> bool:
        """Put a unit on a host; False if the host lacks something for it."""
        if any(self.lacks(kind, name)):
            return False
        self.there[name][kind.label] += 1
        for resource, amount in self.takes(kind, name).items():
            self.taken[name, resource] += amount
        return True

    def lacks(self, kind: Transformation, name: HostName) -> Iterator[str]:
        """Yield what a host lacks for one more unit, as text; nothing if it lacks nothing."""
        for lacks in self._lacks:
            yield from lacks(self, kind, name)

    def missing_companions(self, kind: Transformation, name: HostName) -> int:
        """How many companions of a transformation are missing on a host, less 1 if it is a missing companion itself."""
        there, library = self.there[name], self.environment.transformation
        is_awaited = not there[kind.label] and any(kind.label in library[label].beside for label in there)
        return sum(not there[other] for other in kind.beside) - is_awaited

    def rent_us(self, name: HostName) -> int:
        """The rent of an empty host in microseconds per second; 0 for a host with units."""
        return 0 if name is None or self.there[name].total() else self.environment.host[name].rent_us

    def takes(self, kind: Transformation, name: HostName) -> Mapping[str, int]:
        """The resources that a unit takes on a host."""
        return {} if name is None else taken(kind, self.environment.host[name])


@dataclass(frozen=True)
class Rule:
    """A rule, which holds for problems with the `feature`, or for all if that is None.

    `add` adds it to the constraint model; None if the search cuts off what breaks it. Candidates may be groups of
    units, and hosts kinds of hosts (`Candidates.aggregated`). `flaws` yields, as text, where units break the rule. A
    rule about units on hosts says instead what a host `lacks` for one more unit, beside those that are placed already:
    first plans obey it, checks follow from it, and explanations quote it.

    Hosts are interchangeable only if they have the same `trait`. An `is_placed` rule ignores the
    wiring. A rule that `keeps_units` may need units that feed no other and meet no target.
    """

    add: Callable[[Model], None] | None
    feature: Feature | None = None
    flaws: Callable[[CheckedUnits], Iterator[str]] | None = None
    lacks: Lacks | None = None
    trait: Callable[[Environment, Host], Hashable] | None = None
    is_placed: bool = False
    keeps_units: bool = False

    def __call__(self, model: Model) -> None:
        """Add the rule to a model, if its problem asks for it."""
        if self.add is not None and self.is_asked_by(model.problem.features):
            self.add(model)

    def is_asked_by(self, features: frozenset[Feature]) -> bool:
        """Whether problems with these features ask for it."""
        return self.feature is None or self.feature in features
