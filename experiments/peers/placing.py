"""A fleet as a plain problem with limits: the candidates are units on a host, and transfers of streams to a host.

A unit on a host demands streams on that host: streams of its units, or streams transferred to it. So the rules of
groundedness hold here too. Limits are the capacity of a host, and one host for each unit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from math import gcd

from cfgplan.costs import start_cost_us, taken, transfer_cost_us
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.planning import Feature, Plan, Problem, fresh_unit_ids
from experiments.peers.selection import Limit, Selection


class Placing(Selection):
    """The units on hosts, and the transfers, of a problem in which nothing runs yet and every unit has a host.

    Raises InputError for any other problem.
    """

    def __init__(self, problem: Problem, who: str) -> None:
        environment = problem.environment
        unknown = {
            "quality, numbers or company of units": problem.features > {Feature.HOSTS},
            "fleets that run already": bool(environment.units),
            "links": bool(environment.links),
            "rents": any(host.rent_us for host in environment.hosts),
            "distinct groups on hosts": any(p.distinct is not None for t in environment.library for p in t.inputs),
        }
        for what in (what for what, is_asked in unknown.items() if is_asked):
            raise InputError.of(f"{who} does not support {what}", mend="use the planner cpsat")
        self._fleet = problem
        self._place_of: dict[str, tuple[str, str]] = {}
        """Label and host by the label of the choice to run a unit there."""
        super().__init__(self._plain(), who)
        self._places: dict[str, list[int]] = defaultdict(list)
        for i, candidate in enumerate(self.candidates):
            if candidate.transformation.label in self._place_of:
                self._places[self._place_of[candidate.transformation.label][0]].append(i)
        bare = replace(environment, hosts=(), targets=tuple(replace(t, host=None) for t in environment.targets))
        self.hostless = Selection(replace(problem, environment=bare), who)
        """The same, if there were no hosts."""
        self.limits, self.implied = tuple(self._limits()), tuple(self._wherever_it_is())

    def answer(
        self, chosen: Collection[int] | None, bound_us: int, *, seconds: Mapping[str, float], counts: Mapping[str, int]
    ) -> Plan:
        found = super().answer(chosen, bound_us, seconds=seconds, counts=counts)
        if found.change_set is None:
            return found
        return replace(found, change_set=self._fleet.environment.change_to(self._units(found.change_set.started)))

    def places(self, kinds: Collection[int]) -> list[int]:
        """Return the candidates that run some of the hostless candidates, on any host."""
        return [i for kind in kinds for i in self._places[self.hostless.candidates[kind].transformation.label]]

    def kinds(self, chosen: Collection[int]) -> list[int]:
        """Return the hostless candidates that have a chosen unit."""
        return [i for i in range(len(self.hostless.candidates)) if not set(chosen).isdisjoint(self.places([i]))]

    def _plain(self) -> Problem:
        """The problem with a transformation for each unit on a host and each journey, which cost what these cost."""
        fleet, horizon_s = self._fleet.environment, self._fleet.horizon_s
        library: list[Transformation] = []
        offers: dict[str, set[str]] = defaultdict(set)
        demanded = {port.tag for t in fleet.library for port in t.inputs} | {t.tag for t in fleet.targets}
        for kind in fleet.library:
            at = [host for host in fleet.places_for(kind) if host is not None]
            for host in at:
                label = f"{kind.label} on {host.name}"
                self._place_of[label] = kind.label, host.name
                inputs = tuple(replace(port, tag=_there(port.tag, host.name)) for port in kind.inputs)
                outputs = tuple(OutputPort(p.name, f"{kind.label}/{p.name} of {host.name}") for p in kind.outputs)
                library.append(Transformation(label, inputs, outputs, start_cost_us(kind, horizon_s, host)))
            for port in kind.outputs:
                stream = f"{kind.label}/{port.name}"
                made = {host.name: f"{stream} of {host.name}" for host in at}
                price_us = transfer_cost_us(port, horizon_s, fleet.transfer_us)
                matched = [tag for tag in demanded if self._fleet.similarity.holds(port.tag, tag)]
                for name in fleet.host:
                    journey = OutputPort("out", f"{stream} to {name}")
                    elsewhere = InputPort("in", f"{stream} for {name}")
                    offers[elsewhere.tag].update(made[other] for other in made if other != name)
                    library.append(Transformation(journey.tag, (elsewhere,), (journey,), price_us))
                    for tag in matched:
                        offers[_there(tag, name)] |= {journey.tag, *({made[name]} if name in made else ())}
                for tag in matched:
                    offers[tag].update(made.values())
        targets = [Target(t.label, _there(t.tag, t.host) if t.host else t.tag, t.topic) for t in fleet.targets]
        similarity = Similarity({tag: frozenset(these) for tag, these in offers.items()})
        plain = Environment((), tuple(library), tuple(targets))
        return Problem(plain, similarity, horizon_s=0, max_cost_us=self._fleet.max_cost_us)

    def _limits(self) -> Iterator[Limit]:
        fleet = self._fleet.environment
        taking: dict[tuple[str, str], dict[int, int]] = defaultdict(dict)
        for label, places in self._places.items():
            if len(places) > 1:
                yield Limit(1, dict.fromkeys(places, 1))
            for i in places:
                _, name = self._place_of[self.candidates[i].transformation.label]
                for resource, amount in taken(fleet.transformation[label], fleet.host[name]).items():
                    taking[name, resource][i] = amount
        for (name, resource), amounts in taking.items():
            room = fleet.host[name].room(resource, self._fleet.horizon_s)
            if room is not None and (unit := gcd(*amounts.values())):
                yield Limit(room // unit, {i: amount // unit for i, amount in amounts.items()})

    def _wherever_it_is(self) -> Iterator[Limit]:
        """A unit runs only if a provider of each need runs, on any host: rules for each host by itself are weaker."""
        library = self._fleet.environment.transformation
        providers: dict[str, list[int]] = defaultdict(list)
        for tag in {port.tag for label in self._places for port in library[label].inputs}:
            for label, places in self._places.items():
                if any(self._fleet.similarity.holds(port.tag, tag) for port in library[label].outputs):
                    providers[tag] += places
        for label, places in self._places.items():
            for tag in {port.tag: None for port in library[label].inputs}:
                yield Limit(0, dict.fromkeys(providers[tag], -1) | dict.fromkeys(places, 1))

    def _units(self, chosen: Collection[ComputationUnit]) -> Iterator[ComputationUnit]:
        """The units on their hosts, who take from each other what journeys brought."""
        by_id = {unit.id: unit for unit in chosen}
        ids = fresh_unit_ids(self._fleet.environment, list(self._fleet.environment.transformation))

        def origin(stream: Stream) -> Stream:
            unit = by_id[stream.unit]
            if unit.transformation not in self._place_of:
                return origin(unit.subscriptions[0].stream)
            return Stream(ids[self._place_of[unit.transformation][0]], stream.port)

        published: dict[str, list[Publication]] = defaultdict(list)
        for unit in chosen:
            for publication in unit.publications:
                stream = origin(Stream(unit.id, publication.port))
                published[stream.unit].append(Publication(stream.port, publication.topic))
        for unit in chosen:
            if unit.transformation in self._place_of:
                label, host = self._place_of[unit.transformation]
                wires = tuple(Subscription(s.port, origin(s.stream)) for s in unit.subscriptions)
                yield ComputationUnit(ids[label], label, wires, tuple(published[ids[label]]), host)


def _there(tag: str, host: str) -> str:
    return f"{tag} at {host}"


def selection_of(problem: Problem, who: str) -> Selection:
    """Return the candidates of a plain problem, or of a fleet."""
    return Placing(problem, who) if Feature.HOSTS in problem.features else Selection(problem, who)
