"""A deployment as numbers: how many units of each transformation are on each host; and which unit then takes which
stream.

Where streams are carried for nothing, and providers come before takers, that is all there is to decide.
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
    """Whether a problem asks for more than hosts beyond the paper: then numbers of units have to be chosen."""
    return not problem.features <= {Feature.HOSTS}


class Counting:
    """The transformations and hosts of a problem without running units. Raises InputError for unknown features.

    If a stream serves a limited number, no other transformation gives its tag: so its consumers are known, and if they
    are assigned in turn, the streams of its units are used about equally often.
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
        """The labels with an output that matches a demanded tag, and the output."""
        return tuple(dict.fromkeys((self.candidates.label_of(s), s.port) for s in self.candidates.streams(tag)))

    def serves(self, provider: Where) -> int | None:
        """How many may take a stream; None: any number."""
        return self.kind(provider[0]).output[provider[1]].serves

    @cached_property
    def most(self) -> dict[Where, int]:
        """Return how many units of a transformation each host holds by itself; pairs that hold none are missing."""
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
        """Return the cost of a unit."""
        return self.kinds[where[0]][0].places[where[1]].cost_us

    def takes(self, where: Where) -> Mapping[str, int]:
        return self.kinds[where[0]][0].places[where[1]].takes

    @cached_property
    def rents_us(self) -> dict[str, int]:
        return {host.name: host.rent_us * self.problem.horizon_s for host in self.problem.environment.hosts}

    def alike(self) -> Iterator[tuple[str, str]]:
        """Hosts that may take each other's place, each with the next one."""
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
        """With whom a transformation does not run, and with whom it has to."""
        kind = self.kind(label)
        said = {"conflict": kind.conflicts, "conflict_on_host": kind.conflicts_on_host}
        apart = {name: tuple(o for o in others if o != label and o in self.kinds) for name, others in said.items()}
        return {**apart, "beside": kind.beside}

    def limited(self) -> Iterator[tuple[Where, int]]:
        """The outputs that serve only so many."""
        for label in self.kinds:
            for port in self.kind(label).outputs:
                if port.serves is not None:
                    yield (label, port.name), port.serves

    def takers(self, provider: Where) -> Iterator[tuple[str, int]]:
        """Whose units take streams that serve only so many, how many each; targets have no label."""
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
        """The plan with so many units; `bound_us` is proven."""
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
