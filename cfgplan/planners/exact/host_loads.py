"""The units that are placed on hosts, one after the other, and what a host lacks for one more."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping

from cfgplan.costs import taken
from cfgplan.domain import Transformation
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planning import Problem

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
        """How many transformations that a unit runs with are not on a host; less than 0 where it is waited for."""
        there, library = self.there[name], self.environment.transformation
        is_awaited = not there[kind.label] and any(kind.label in library[label].beside for label in there)
        return sum(not there[other] for other in kind.beside) - is_awaited

    def rent_us(self, name: HostName) -> int:
        """The rent of an empty host in microseconds per second; 0 for a host with units."""
        return 0 if name is None or self.there[name].total() else self.environment.host[name].rent_us

    def takes(self, kind: Transformation, name: HostName) -> Mapping[str, int]:
        """The resources that a unit takes on a host."""
        return {} if name is None else taken(kind, self.environment.host[name])
