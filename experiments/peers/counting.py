"""A deployment as numbers of units of each transformation on each host, and the wiring of these units.

If transfers are free and the problem has no cycles, the numbers determine the cost.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

from networkx import DiGraph, is_directed_acyclic_graph

from cfgplan.domain import ALL, ComputationUnit, Publication, Stream, Subscription, Transformation
from cfgplan.errors import InputError
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.pruning import lean
from cfgplan.planning import Feature, Plan, Problem, Status

KNOWN = {Feature.HOSTS, Feature.CONFLICTS, Feature.BESIDE, Feature.INSTANCES, Feature.COUNTS, Feature.LIMITS}
Where = tuple[str, str]
"""The label of a transformation and the name of a host."""


def is_counted(problem: Problem) -> bool:
    """Return whether a problem uses features beyond the paper other than hosts, so that numbers of units must be
    chosen.
    """
    return not problem.features <= {Feature.HOSTS}


class Counting:
    """The transformations and hosts of a problem without running units. Raises InputError for unknown features.

    If a stream serves a limited number of consumers, no other transformation may offer its tag. Its consumers are then
    known, and assigning them in turn uses the streams of its units about equally.
    """

    def __init__(self, problem: Problem, who: str) -> None:
        environment, self.problem, self.who = problem.environment, problem, who
        self.candidates = Candidates(problem)
        self.kinds = {label: self.candidates.of(label) for label in sorted(self.candidates.kinds)}
        ports = [port for label in self.kinds for port in self.kind(label).inputs]
        self.tags = {port.tag for port in ports} | {target.tag for target in environment.targets}
        alone = [
            tag for tag in self.tags if len(self.providers(tag)) > 1 and any(map(self.serves, self.providers(tag)))
        ]
        unknown = {
            ", ".join(sorted(problem.features - KNOWN)): not problem.features <= KNOWN,
            "numbers of what runs already": bool(environment.units),
            "numbers without hosts": not environment.hosts,
            "required transformations": bool(environment.required),
            "a largest cost of deployments": problem.max_cost_us is not None,
            "streams with a price between hosts, and numbers": bool(environment.links)
            or (environment.transfer_us and any(o.bytes_per_s for t in environment.library for o in t.outputs)),
            "numbers where all streams or different ones are taken": any(
                port.count == ALL or port.distinct is not None for port in ports
            ),
            "several providers of what serves only so many": bool(alone),
            "cycles of several units": not is_directed_acyclic_graph(DiGraph(self._feeds())),
        }
        for what in (what for what, is_asked in unknown.items() if is_asked):
            raise InputError.of(f"{who} does not support {what}", mend="use the planner cpsat")

    def kind(self, label: str) -> Transformation:
        return self.problem.environment.transformation[label]

    def providers(self, tag: str) -> tuple[Where, ...]:
        """Return the label and the output of each provider of a demanded tag."""
        return tuple(dict.fromkeys((self.candidates.label_of(s), s.port) for s in self.candidates.streams(tag)))

    def serves(self, provider: Where) -> int | None:
        """Return the number of consumers that a stream may serve; None if unlimited."""
        return self.kind(provider[0]).output[provider[1]].serves

    @cached_property
    def most(self) -> dict[Where, int]:
        """Return the largest number of units of each transformation that fit on each host alone; pairs with 0 are
        missing.
        """
        found = {}
        for label, units in self.kinds.items():
            for name, place in units[0].places.items():
                rooms = {each: self.room(str(name), each) for each in place.takes}
                by_room = [room // place.takes[r] for r, room in rooms.items() if room is not None and place.takes[r]]
                per_host = self.kind(label).per_host
                found[label, str(name)] = min(len(units), *by_room, *([] if per_host is None else [per_host]))
        return {where: most for where, most in found.items() if most}

    def room(self, host: str, resource: str) -> int | None:
        return self.problem.environment.host[host].room(resource, self.problem.horizon_s)

    def cost_us(self, where: Where) -> int:
        """Return the cost of a unit of a transformation on a host, in microseconds."""
        return self.kinds[where[0]][0].places[where[1]].cost_us

    def takes(self, where: Where) -> Mapping[str, int]:
        return self.kinds[where[0]][0].places[where[1]].takes

    @cached_property
    def rents_us(self) -> dict[str, int]:
        return {host.name: host.rent_us * self.problem.horizon_s for host in self.problem.environment.hosts}

    def alike(self) -> Iterator[tuple[str, str]]:
        """Yield consecutive pairs of interchangeable hosts."""
        kinds: dict[object, list[str]] = defaultdict(list)
        for host in self.problem.environment.hosts:
            here = [where for where in self.most if where[1] == host.name]
            units = [(label, self.cost_us((label, name)), self.takes((label, name))) for label, name in here]
            kinds[repr((replace(host, name="any", labels=()), units))].append(host.name)
        for names in kinds.values():
            yield from pairwise(names)

    @property
    def resources(self) -> list[str]:
        return sorted({resource for where in self.most for resource in self.takes(where)})

    def company(self, label: str) -> dict[str, tuple[str, ...]]:
        """Return the labels that a transformation conflicts with, anywhere or on a host, and needs beside it."""
        kind = self.kind(label)
        said = {"conflict": kind.conflicts, "conflict_on_host": kind.conflicts_on_host}
        apart = {name: tuple(o for o in others if o != label and o in self.kinds) for name, others in said.items()}
        return {**apart, "beside": kind.beside}

    def limited(self) -> Iterator[tuple[Where, int]]:
        """Yield the outputs with a limited number of consumers, and the limit."""
        for label in self.kinds:
            for port in self.kind(label).outputs:
                if port.serves is not None:
                    yield (label, port.name), port.serves

    def takers(self, provider: Where) -> Iterator[tuple[str, int]]:
        """Yield the consumers of a limited stream: their label (empty for targets), and the streams that each unit
        takes.
        """
        for label in self.kinds:
            for port in self.kind(label).inputs:
                if provider in self.providers(port.tag):
                    yield label, port.count
        for target in self.problem.environment.targets:
            if provider in self.providers(target.tag):
                yield "", 1

    def answer(
        self,
        numbers: Mapping[Where, int] | None,
        bound_us: int,
        *,
        seconds: Mapping[str, float],
        counts: Mapping[str, int],
    ) -> Plan:
        """Return the plan with these numbers of units; `bound_us` is the proven lower bound of the cost."""
        if numbers is None:
            return Plan(self.who, Status.UNKNOWN, bound_us=bound_us, seconds=seconds, counts=counts)
        units = lean(self.candidates, list(self._wired(numbers)))
        cost_us = self.plan_us(Counter((unit.transformation, str(unit.host)) for unit in units))
        changes, bound_us = self.problem.environment.change_to(units), min(bound_us, cost_us)
        status = Status.of_plan(cost_us, bound_us, is_required_proven=True)
        return Plan(self.who, status, changes, cost_us, bound_us, required_proven=True, seconds=seconds, counts=counts)

    def plan_us(self, numbers: Mapping[Where, int]) -> int:
        hosts = {host for (_, host), number in numbers.items() if number}
        return sum(self.cost_us(w) * n for w, n in numbers.items()) + sum(self.rents_us[host] for host in hosts)

    def _feeds(self) -> Iterator[Where]:
        for label in self.kinds:
            for port in self.kind(label).inputs:
                yield from ((provider, label) for provider, _ in self.providers(port.tag))

    def _wired(self, numbers: Mapping[Where, int]) -> Iterator[ComputationUnit]:
        """Who takes streams that serve only so many takes the next ones, others take the first ones."""
        hosts: dict[str, list[str]] = defaultdict(list)
        for (label, host), number in sorted(numbers.items()):
            hosts[label] += [host] * number
        taken: Counter[Where] = Counter()

        def streams(tag: str, count: int) -> list[Stream]:
            providers = self.providers(tag)
            units = {unit.id: port for label, port in providers for unit in self.kinds[label][: len(hosts[label])]}
            there = [Stream(unit, port) for unit, port in units.items()]
            first = taken[providers[0]] if any(map(self.serves, providers)) else 0
            taken[providers[0]] += count
            return [there[(first + n) % len(there)] for n in range(count)]

        topics: dict[str, list[Publication]] = defaultdict(list)
        for target in self.problem.environment.targets:
            (stream,) = streams(target.tag, 1)
            topics[stream.unit].append(Publication(stream.port, target.topic))
        for label, places in hosts.items():
            for unit, host in zip(self.kinds[label], places, strict=False):
                inputs = self.kind(label).inputs
                wires = tuple(Subscription(p.name, stream) for p in inputs for stream in streams(p.tag, p.count))
                yield ComputationUnit(unit.id, label, wires, tuple(topics[unit.id]), host)
