"""Candidates: the units that a configuration may contain, and the streams between them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from cfgplan.costs import keep_cost_us, standby_cost_us, start_cost_us, taken, transfer_cost_us
from cfgplan.domain import ComputationUnit, Environment, Host, Stream, Target, Transformation
from cfgplan.onward import grouped
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.keys import may_stay
from cfgplan.planners.networks.network import Network
from cfgplan.planners.reducing.closure import Closure
from cfgplan.planners.reducing.reduce import may_go_on
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Feature, Problem, fresh_units
from cfgplan.qualities import QualityAttribute, worst_allowed
from cfgplan.reasons import startable

ONLY_IN_THE_MODEL: Final = frozenset({Feature.OPTIONAL, Feature.COUNTS, Feature.LIMITS})
"""Features that first plans and bounds do not handle."""
_DERIVED: Final = ("kinds", "hosts", "host_kind", "network", "asked_for", "least_us")
"""The cached properties of candidates."""
HostName = str | None
"""Where something is; None where there are no hosts, or on no host in particular."""


Placement = tuple[str, HostName]
"""A transformation and, if transformations have companions on their host, a host.

Units of one placement can replace each other.
"""


@dataclass(frozen=True, slots=True)
class OnHost:
    """The cost of a unit that runs or waits on a host, and the resources that it takes there."""

    cost_us: int
    waiting_cost_us: int
    takes: Mapping[str, int]


@dataclass(frozen=True)
class HostKind:
    """Interchangeable hosts, or the only place (None) without hosts."""

    names: tuple[HostName, ...]
    rooms: Mapping[str, int]
    """How much one host has of each resource that candidates take; resources without a limit are left out."""
    rent_us: int = 0
    """The rent of one host over the horizon, in microseconds."""

    @property
    def first(self) -> HostName:
        return self.names[0]

    @property
    def is_one(self) -> bool:
        return len(self.names) == 1

    def apart(self) -> list[HostKind]:
        """Each of the hosts as a kind of its own."""
        return [HostKind((name,), self.rooms, self.rent_us) for name in self.names]


@dataclass(frozen=True)
class Candidate:
    """A unit of the environment, or a new one of a transformation. It `may_run`, or `may_wait` as a cold spare.

    `places` are the hosts it may be on: only its own if it exists already; only None without hosts.
    A candidate of a `size` above 1 stands for a group: so many new units of a transformation.
    """

    id: str
    transformation: Transformation
    running: ComputationUnit | None
    places: Mapping[HostName, OnHost]
    may_run: bool = True
    may_wait: bool = False
    size: int = 1

    @cached_property
    def hosts(self) -> tuple[HostName, ...]:
        return tuple(self.places)

    def spare_on(self, host: HostName) -> ComputationUnit:
        """The unit as a cold spare on a host."""
        return ComputationUnit(self.id, self.transformation.label, host=host, standby=True)

    @cached_property
    def cost_us(self) -> int:
        """The cost of running on the cheapest host."""
        return min(place.cost_us for place in self.places.values())

    @cached_property
    def waiting_cost_us(self) -> int:
        """The cost of waiting as a cold spare on the cheapest host."""
        return min(place.waiting_cost_us for place in self.places.values())


class Candidates:
    """The candidates by index, in canonical order; the new ones of a transformation stand side by side."""

    def __init__(
        self,
        problem: Problem,
        closure: Closure | None = None,
        among: Collection[str] | None = None,
        clock: Clock | None = None,
    ) -> None:
        """All candidates, or those of the transformations in `among` and of those that every plan has.

        The `clock` is looked at here and by those who use the candidates; raises OutOfTimeError.
        """
        self.problem = problem
        self.environment = problem.environment
        self.clock = Clock() if clock is None else clock
        self.closure = Closure.of(problem, self.clock) if closure is None else closure
        self.providers, self.possible = self.closure.providers, self.closure.possible
        labels = self.closure.relevant
        if among is not None:
            labels &= self.closure.asked_for.union(among)
        self.all = tuple(_candidates(problem, labels, self.clock))
        self.index_of = {candidate.id: i for i, candidate in enumerate(self.all)}
        self._units = grouped((candidate.transformation.label, i) for i, candidate in enumerate(self.all))
        self._is_closed = among is None and len(self._units) == len(labels)
        self._streams: dict[str, tuple[Stream, ...]] = {}
        self._feeders: dict[str, tuple[int, ...]] = {}
        self._may_stay: dict[int, bool] = {}
        self._carried_us: dict[tuple[Stream, int], int] = {}
        self.bounds = {
            (target.label, wish.attribute): attribute.badness(worst_allowed(attribute, wish))
            for target in problem.environment.targets
            for wish in target.quality
            for attribute in [problem.environment.quality[wish.attribute]]
            if wish.bound is not None
        }
        """By how much a target's stream may miss the best of an attribute."""
        self.least: dict[QualityAttribute, dict[Stream, int]] = {}
        self.most: dict[QualityAttribute, dict[str, int]] = {}
        """Caches of `best_case`: the least badness of each stream, and the largest of use for each demanded tag."""
        self.can_share: dict[tuple[object, ...], bool] = {}
        """A cache of `survivors`: whether so many units of each placement can meet some targets."""
        self.groups: tuple[tuple[int, ...], ...] | None = None
        """The units that each candidate stands for, by their numbers before `aggregated`; None before."""

    def aggregated(self, groups: Iterable[tuple[int, ...]], kinds: Sequence[HostKind]) -> Candidates:
        """The same problem with one candidate for each group of units, and one host, its first, for each kind.

        A stream is known by the first unit of its group. Units outside the groups are left out.
        """
        whole = tuple(groups)
        firsts = [self.all[group[0]] for group in whole]
        at = [{kind.first: c.places[kind.first] for kind in kinds if kind.first in c.places} for c in firsts]
        units = [
            replace(first, size=len(group), places=places)
            for group, first, places in zip(whole, firsts, at, strict=True)
        ]
        found = self._with(units, kinds)
        found.groups = whole
        found.index_of = {self.all[i].id: number for number, group in enumerate(whole) for i in group}
        return found

    def of_placements(self, units: Mapping[Placement, int], targets: Iterable[Target]) -> Candidates:
        """New units, so many of each placement, on its host, which have to meet some targets by their wiring alone."""
        kinds = self.environment.transformation
        placements = [placement for placement, number in sorted(units.items(), key=str) for _ in range(number)]
        found = self._with(
            [
                Candidate(str(i), kinds[label], None, {host: OnHost(0, 0, {})})
                for i, (label, host) in enumerate(placements)
            ],
            [HostKind((host,), {}) for host in dict.fromkeys(host for _, host in units)],
        )
        library = tuple(kinds[label] for label in sorted({label for label, _ in units}))
        wanted = tuple(replace(target, host=None, quality=()) for target in targets)
        found.environment = Environment((), library, wanted)
        found.problem = Problem(found.environment, self.problem.similarity, 0)
        return found

    def _with(self, candidates: Iterable[Candidate], hosts: Iterable[HostKind]) -> Candidates:
        """The same problem with other candidates and hosts. Forgets what was derived from the present ones."""
        found = copy.copy(self)
        for cached in _DERIVED:
            vars(found).pop(cached, None)
        found.all, found.hosts = tuple(candidates), tuple(hosts)
        found.index_of = {candidate.id: i for i, candidate in enumerate(found.all)}
        found._units = grouped((candidate.transformation.label, i) for i, candidate in enumerate(found.all))
        found._streams, found._feeders, found._may_stay = {}, {}, {}
        return found

    def among(self, labels: Collection[str]) -> Candidates:
        """The candidates of some transformations."""
        return Candidates(self.problem, self.closure, labels, self.clock)

    @cached_property
    def kinds(self) -> Mapping[str, Transformation]:
        """The transformations that have candidates, by their labels."""
        return {label: self.all[units[0]].transformation for label, units in self._units.items()}

    @cached_property
    def hosts(self) -> tuple[HostKind, ...]:
        """The hosts, each a kind of its own; kinds of several hosts only if the candidates are `aggregated`."""
        if not self.environment.hosts:
            return (HostKind((None,), {}),)
        horizon_s = self.problem.horizon_s
        resources = sorted({each for c in self.all for place in c.places.values() for each in place.takes})
        return tuple(
            HostKind(
                (host.name,),
                {each: room for each in resources if (room := host.room(each, horizon_s)) is not None},
                host.rent_us * horizon_s,
            )
            for host in self.environment.hosts
        )

    @cached_property
    def host_kind(self) -> Mapping[HostName, HostKind]:
        """The kinds of hosts by their first host."""
        return {kind.first: kind for kind in self.hosts}

    @cached_property
    def network(self) -> Network:
        """The network of transformations that have candidates and can be started among themselves, whatever the hosts.

        Targets that none of them can meet are left out.
        """
        library = tuple(self.kinds[label] for label in sorted(self.kinds))
        if not self._is_closed:
            left = startable(Environment((), library), self.providers, self.clock.each)
            library = tuple(t for t in library if t.label in left)
        labels = {t.label for t in library}
        targets = [target.tag for target in self.environment.targets]
        met = [tag for tag in targets if not labels.isdisjoint(self.providers.of(tag))]
        return Network(library, met, self.asked_for & labels, self.providers, self.clock.each)

    @cached_property
    def asked_for(self) -> frozenset[str]:
        """The transformations that have a pinned unit, a target of their own, or a least number of instances."""
        wanted = {*self.environment.wanted_to_run.values()}
        return frozenset(
            label
            for label, kind in self.kinds.items()
            if kind.min_instances or label in wanted or any(map(self.is_pinned, self._units[label]))
        )

    @cached_property
    def least_us(self) -> Ints:
        """The least cost of a unit of each transformation in the network."""
        units = [[c.cost_us for c in self.of(label) if c.may_run] for label in self.network.labels]
        return np.array([min(these, default=0) for these in units], np.int64)

    def numbers(self, labels: Iterable[str]) -> list[int]:
        """The numbers that transformations have in the network, sorted."""
        return sorted(self.network.number[label] for label in labels if label in self.network.number)

    def carried_us(self, stream: Stream, origin: HostName, host: HostName) -> int:
        """The cost of carrying a stream from one host to another over the horizon."""
        key = stream, self.environment.price_us(origin, host)
        if key not in self._carried_us:
            port = self.all[self.index_of[stream.unit]].transformation.output[stream.port]
            self._carried_us[key] = transfer_cost_us(port, self.problem.horizon_s, key[1])
        return self._carried_us[key]

    def label_of(self, stream: Stream) -> str:
        """The transformation of a stream's unit."""
        return self.all[self.index_of[stream.unit]].transformation.label

    def of(self, label: str) -> list[Candidate]:
        """The candidates of a transformation."""
        return [self.all[i] for i in self._units.get(label, ())]

    def units_of(self, label: str) -> Sequence[int]:
        """The indices of the candidates of a transformation."""
        return self._units.get(label, ())

    def first_of_each(self, labels: Iterable[str]) -> set[int]:
        """Return the first unit of each label, a running one if possible, and all running units of pinned labels."""
        return {self._units[label][0] for label in labels} | set(filter(self.is_pinned, range(len(self.all))))

    def streams(self, tag: str) -> tuple[Stream, ...]:
        """The streams of candidates that may run and match the demanded tag."""
        if tag not in self._streams:
            self._streams[tag] = tuple(
                Stream(self.all[i].id, port.name)
                for label in self.providers.of(tag)
                for i in self._units.get(label, ())
                if self.all[i].may_run
                for port in self.all[i].transformation.outputs
                if self.problem.similarity.holds(port.tag, tag)
            )
        return self._streams[tag]

    def feeders(self, tag: str) -> tuple[int, ...]:
        """The candidates that may run and have an output that matches the demanded tag."""
        if tag not in self._feeders:
            units = [i for label in self.providers.of(tag) for i in self._units.get(label, ())]
            self._feeders[tag] = tuple(i for i in units if self.all[i].may_run)
        return self._feeders[tag]

    def gives(self, stream: Stream, tag: str) -> bool:
        """Whether the stream is one of a candidate that may run, and matches the demanded tag."""
        index = self.index_of.get(stream.unit)
        if index is None or not self.all[index].may_run:
            return False
        output = self.all[index].transformation.output.get(stream.port)
        return output is not None and self.problem.similarity.holds(output.tag, tag)

    def stream_of(self, feeder: int, tag: str, old: Iterable[Stream] = ()) -> Stream:
        """The stream by which a candidate meets a demanded tag: an `old` one if that does, else its first."""
        candidate = self.all[feeder]
        for stream in old:
            if stream.unit == candidate.id and self.gives(stream, tag):
                return stream
        holds = self.problem.similarity.holds
        return Stream(candidate.id, next(p.name for p in candidate.transformation.outputs if holds(p.tag, tag)))

    def may_stay(self, index: int) -> bool:
        """Whether a running unit's wiring is valid, looked at by itself: see `networks.keys`."""
        if index not in self._may_stay:
            unit = self.all[index].running
            self._may_stay[index] = unit is not None and self.all[index].may_run and self._is_valid(unit)
        return self._may_stay[index]

    def _is_valid(self, unit: ComputationUnit) -> bool:
        inputs = self.environment.transformation[unit.transformation].input
        return may_stay(self.problem, self._units, unit) and all(
            self.gives(s.stream, inputs[s.port].tag) and (s.stream.unit != unit.id or inputs[s.port].feedback)
            for s in unit.subscriptions
        )

    def is_pinned(self, index: int) -> bool:
        """Whether the candidate is a running unit that must be kept."""
        candidate = self.all[index]
        return (
            candidate.transformation.pinned
            and candidate.running is not None
            and candidate.may_run
            and candidate.transformation.label in self.possible
        )


def _candidates(problem: Problem, labels: frozenset[str], clock: Clock) -> Iterator[Candidate]:
    """Running units, then new ones."""
    environment, horizon_s = problem.environment, problem.horizon_s
    for unit in clock.each(environment.units):
        if unit.transformation in labels and may_go_on(problem, unit):
            transformation = environment.transformation[unit.transformation]
            yield Candidate(
                unit.id,
                transformation,
                unit,
                _places(transformation, [environment.place_of(unit)], horizon_s, keep_cost_us),
                not unit.standby,
                unit.standby,
            )
    for label, unit_ids in clock.each(fresh_units(environment, _numbers_of_new(problem, labels, clock)).items()):
        transformation = environment.transformation[label]
        places = _places(transformation, environment.places_for(transformation), horizon_s, start_cost_us)
        for unit_id in unit_ids if places else ():
            yield Candidate(
                unit_id,
                transformation,
                None,
                places,
                may_wait=problem.survive is not None and transformation.standby_us is not None,
            )


def _places(
    transformation: Transformation,
    hosts: Iterable[Host | None],
    horizon_s: int,
    cost_us: Callable[[Transformation, int, Host | None], int],
) -> Mapping[HostName, OnHost]:
    return {
        None if host is None else host.name: OnHost(
            cost_us(transformation, horizon_s, host),
            standby_cost_us(transformation, horizon_s, host),
            taken(transformation, host),
        )
        for host in hosts
    }


def _numbers_of_new(problem: Problem, labels: frozenset[str], clock: Clock) -> dict[str, int]:
    """The most new units of each transformation.

    Where nothing is asked beyond the paper, a new unit beside a running one pays only if it costs no labor, or lets
    more required transformations be used.
    """
    environment, library = problem.environment, problem.environment.transformation
    is_any = problem.features or any(library[label].required for label in labels)
    running = () if is_any else {unit.transformation for unit in environment.units}
    return {
        label: problem.most_new(library[label])
        for label in clock.each(sorted(labels))
        if label not in running or library[label].labor_us == 0
    }
