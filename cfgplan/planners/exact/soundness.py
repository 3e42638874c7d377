"""Whether a configuration is valid, before it becomes the incumbent and cuts anything off.

Every rule is checked for each configuration, because an invalid incumbent makes proofs false. The judge checks the
answer again, and shares no code with this module.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property

from cfgplan.domain import ALL, ComputationUnit, InputPort, Stream
from cfgplan.figures import links_bear, qualities_of_targets
from cfgplan.onward import grouped, reached
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.places import Rooms
from cfgplan.planners.exact.pruning import have_company, needed_in_all
from cfgplan.planners.exact.survivors import bears_all_failures, can_do_without
from cfgplan.planners.networks.keys import is_well_wired
from cfgplan.planning import Feature
from cfgplan.qualities import is_met


def flaws(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[str]:
    """Yield each flaw of a configuration as text; a valid one yields none.

    The candidates may be a part of all: the rules about units that must run are checked against the problem.
    """
    configuration = _Configuration(candidates, units)
    yield from configuration.of_wiring()
    yield from configuration.of_what_runs()
    if candidates.problem.features:
        yield from configuration.beyond_the_paper()
    if configuration.has_needless_units():
        yield "nothing needs some unit"


class _Configuration:
    def __init__(self, candidates: Candidates, units: Collection[ComputationUnit]) -> None:
        self.candidates, self.problem, self.environment = candidates, candidates.problem, candidates.environment
        self.units = units
        self.hot = {unit.id: unit for unit in units if not unit.standby}
        self.library = self.environment.transformation
        self.taken: Counter[Stream] = Counter(s.stream for unit in units for s in unit.subscriptions)
        self.taken.update(Stream(unit.id, p.port) for unit in units for p in unit.publications)

    def of_wiring(self) -> Iterator[str]:
        """Inputs that are not fed as they have to be, cycles, and targets that are not met by one stream each."""

        def label_of(unit_id: str) -> str | None:
            unit = self.hot.get(unit_id)
            return None if unit is None else unit.transformation

        for unit in self.hot.values():
            if not is_well_wired(self.problem, label_of, unit):
                yield f"unit {unit.id} is not wired as its transformation asks"
        published = Counter(p.topic for unit in self.units for p in unit.publications)
        if published != Counter(target.topic for target in self.environment.stream_targets):
            yield "not every target has one stream"
        running = {unit.transformation for unit in self.hot.values()}
        if not running.issuperset(self.environment.wanted_to_run.values()):
            yield "a target wants a unit that does not run"
        if not self._is_grounded():
            yield "units feed each other in a cycle"

    def _is_grounded(self) -> bool:
        """Whether each unit comes after those that feed its ordinary inputs."""
        waits_for = {
            unit.id: {
                s.stream.unit
                for s in unit.subscriptions
                if not self.library[unit.transformation].input[s.port].feedback
            }
            for unit in self.hot.values()
        }
        readers = grouped((feeder, unit_id) for unit_id, feeders in waits_for.items() for feeder in feeders)
        fed = Counter({unit_id: len(feeders) for unit_id, feeders in waits_for.items()})
        ahead = [unit_id for unit_id, number in fed.items() if not number]
        for unit_id in ahead:
            for reader in readers.get(unit_id, ()):
                fed[reader] -= 1
                if not fed[reader]:
                    ahead.append(reader)
        return len(ahead) == len(self.hot)

    def of_what_runs(self) -> Iterator[str]:
        """Pinned units that are missing."""
        there = {unit.id for unit in self.units}
        for unit in self.environment.units:
            kind = self.library.get(unit.transformation)
            if kind is None or not kind.pinned or unit.standby or unit.id in there:
                continue
            may_stay = not self.environment.hosts or unit.host in self.environment.hosts_for(kind)
            if may_stay and kind.label in self.candidates.closure.possible:
                yield f"the pinned unit {unit.id} is missing"

    def has_needless_units(self) -> bool:
        """Whether some unit is needless: no target, pin, number, company or failure needs it."""
        needed = needed_in_all(self.problem, self.units, ())
        spares: set[str] = set()
        if len(needed) < len(self.units) and self.problem.survive is not None:
            left = [unit for unit in self.units if unit.id not in needed]
            spares = {unit.id for unit in left if not can_do_without(self.candidates, self.units, unit)}
            needed = needed_in_all(self.problem, self.units, spares)
        return len(needed) < len(self.units)

    def beyond_the_paper(self) -> Iterator[str]:
        """The flaws by rules beyond the paper."""
        asked = self.problem.features
        if Feature.QUALITY in asked:
            yield from self._of_quality()
        if {Feature.HOSTS, Feature.CONFLICTS, Feature.INSTANCES, Feature.BESIDE} & asked:
            yield from self._of_company()
        if {Feature.OPTIONAL, Feature.COUNTS, Feature.LIMITS} & asked:
            yield from self._of_sharing()
        if not bears_all_failures(self.candidates, self.units):
            yield "a failure is not survived"

    def _of_quality(self) -> Iterator[str]:
        reached_at = qualities_of_targets(self.environment, self.units)
        for target in self.environment.targets:
            for wish in target.quality if target.label in reached_at else ():
                attribute = self.environment.quality[wish.attribute]
                if not is_met(attribute, wish, reached_at[target.label][wish.attribute]):
                    yield f"target {target.label} gets too bad a stream"

    def _of_company(self) -> Iterator[str]:
        """Flaws of hosts without room, of conflicts, of missing company, and of numbers of instances."""
        there = Counter(unit.transformation for unit in self.units)
        running = Counter(unit.transformation for unit in self.hot.values())
        rooms = Rooms(self.problem)
        allowed = {label: frozenset(self.environment.hosts_for(self.library[label])) for label in there}
        for unit in self.units:
            kind = self.library[unit.transformation]
            if unit.host not in allowed[kind.label]:
                yield f"unit {unit.id} is on a host where it may not be"
            elif not rooms.put(kind, unit.host):
                yield f"the host of unit {unit.id} has no room for it"
        if not have_company(self.environment, self.units):
            yield "a unit runs without one that it runs with"
        if not links_bear(self.problem, self.units):
            yield "a link has to carry too much"
        for kind in self.environment.library:
            if running[kind.label] < kind.min_instances:
                yield f"too few units of {kind.label} run"
            if kind.max_instances is not None and there[kind.label] > kind.max_instances:
                yield f"too many units of {kind.label} are there"
            if kind.conflicts and there[kind.label] and any(there[o] for o in kind.conflicts if o != kind.label):
                yield f"units of {kind.label} are there with one that they conflict with"

    def _of_sharing(self) -> Iterator[str]:
        """Flaws of streams with too many consumers, and of inputs with too few streams."""
        kinds = {unit.id: self.library[unit.transformation] for unit in self.hot.values()}
        left = {
            Stream(unit_id, port.name): port.serves - self.taken[Stream(unit_id, port.name)]
            for unit_id, kind in kinds.items()
            for port in kind.outputs
            if port.serves is not None
        }
        if any(number < 0 for number in left.values()):
            yield "too many take a stream"
        offers: dict[str, list[Stream]] = {}
        for unit in self.hot.values():
            for port in kinds[unit.id].inputs:
                if port.count != ALL and not (port.starts_nothing and port.name not in unit.feeds):
                    continue
                if port.tag not in offers:
                    outputs = [(i, p) for i, kind in kinds.items() for p in kind.outputs]
                    holds = self.problem.similarity.holds
                    offers[port.tag] = [Stream(i, p.name) for i, p in outputs if holds(p.tag, port.tag)]
                there = [stream for stream in offers[port.tag] if stream.unit != unit.id or port.count != ALL]
                if port.count == ALL and not set(unit.feeds.get(port.name, ())).issuperset(there):
                    yield f"input {port.name} of unit {unit.id} takes not all that there is"
                elif port.count != ALL and len(self._free(unit, port, there, left)) >= port.count:
                    yield f"input {port.name} of unit {unit.id} is not fed, but could be"

    def _free(
        self, unit: ComputationUnit, port: InputPort, there: Collection[Stream], left: Mapping[Stream, int]
    ) -> set[str]:
        """Return the units with a stream that may feed an input; for a distinct input, the transformations."""
        inputs = self.library[unit.transformation].inputs
        barred = set() if port.feedback else {*reached([unit.id], lambda here: self._readers.get(here, ()))}
        group = [p.name for p in inputs if p.distinct is not None and p.distinct == port.distinct]
        taken = {self.hot[s.unit].transformation for name in group for s in unit.feeds.get(name, ())}
        found = set()
        for stream in there:
            label = self.hot[stream.unit].transformation
            if stream.unit not in barred and left.get(stream, 1) > 0 and label not in taken:
                found.add(stream.unit if port.distinct is None else label)
        return found

    @cached_property
    def _readers(self) -> dict[str, list[str]]:
        """The units that each unit feeds, except by feedback inputs."""
        readers: dict[str, list[str]] = defaultdict(list)
        for unit in self.hot.values():
            inputs = self.library[unit.transformation].input
            for s in unit.subscriptions:
                if not inputs[s.port].feedback:
                    readers[s.stream.unit].append(unit.id)
        return readers
