"""`reduce` removes the parts of a problem that no plan can use, and the keys that can't bind.

The library loses transformations that can't be started or that nothing wanted can need, with all that they say. Limits,
qualities and hosts go if no configuration can reach them. Optional inputs without worth cost nothing and start nothing:
they are fed after the plan. `Reduced.answer` makes a plan of the whole problem. If one host lacks room for all units,
or if feeding an input rewires a unit, the planner plans again with `is_certain`.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from cfgplan.canonical import with_fields
from cfgplan.costs import labor_us, start_cost_us, taken, transfer_cost_us, upkeep_us
from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Objective,
    Stream,
    Subscription,
    Transformation,
)
from cfgplan.onward import reached
from cfgplan.planners.reducing.closure import relevant
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Feature, Measured, OnProgress, Plan, Problem, Progress, Status
from cfgplan.reasons import Each, Providers, startable
from cfgplan.rows import attributes, least_limit

GONE = "\0"
"""The transformation of a unit that no plan can keep: none is called so."""
_FIELDS: Final = attributes(Transformation)
_LIMITS_OF_UNITS: Final = {each.name: each.default for each in _FIELDS if each.row.limits_units}
_BY_HOST: Final = {each.name: each.default for each in _FIELDS if each.row.is_by_host}
_ONLY_WITH_HOSTS: Final = {each.name: each.default for each in _FIELDS if each.row.is_of_hosts}
"""The attributes of transformations that state rules of these kinds, and their defaults."""
OF_HOSTS = (Objective.HOSTS, Objective.RENT)
"""The objectives that are the same for all plans where no hosts are left."""


@dataclass(frozen=True)
class Numbered(Problem):
    """A part of a problem. A plan starts at most `most` units of each transformation, as in the whole problem."""

    most: Mapping[str, int] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Check nothing: no plan of a part costs more than one of the whole, which was checked."""

    def most_new(self, transformation: Transformation) -> int:
        return self.most[transformation.label]


@dataclass(frozen=True)
class Reduced:
    """A `whole` problem, and the `problem` that is left of it.

    If hosts were left out, all units are at `home`, which `is_roomy` if it has room for all that a plan may have.
    `startable` is the number of transformations of the whole problem that can be started.
    """

    whole: Problem
    problem: Problem
    home: Host | None = None
    is_roomy: bool = True
    startable: int = 0

    @property
    def rent_us(self) -> int:
        """The rent of home over the horizon, which the reduced problem leaves out of each plan's cost."""
        return 0 if self.home is None else self.home.rent_us * self.whole.horizon_s

    def reporting(self, report: OnProgress | None) -> OnProgress | None:
        """A reporter of the part's progress as that of the whole problem, without costs that may not hold."""
        if report is None or self.problem is self.whole:
            return report

        def tell(progress: Progress) -> None:
            cost_us = None if progress.cost_us is None or not self.is_roomy else progress.cost_us + self.rent_us
            report(replace(progress, cost_us=cost_us, bound_us=progress.bound_us + self.rent_us))

        return tell

    def part_of(self, units: Sequence[ComputationUnit]) -> list[ComputationUnit]:
        """Units of the whole problem as units of the part."""
        library = self.problem.environment.transformation
        return [
            replace(
                unit,
                host=unit.host if self.home is None else None,
                subscriptions=tuple(s for s in unit.subscriptions if s.port in library[unit.transformation].input),
            )
            for unit in units
        ]

    def answer(self, found: Plan) -> Plan | None:
        """The answer to the whole problem that a plan of the reduced one gives; None if home lacks room for it.

        Its ties are not proven where an input that is fed afterwards has rewired a unit.
        """
        if self.problem is self.whole:
            return found
        sizes = {"transformations": len(self.whole.environment.library), "startable": self.startable}
        counts = {**found.counts, **(sizes if sizes.keys() <= found.counts.keys() else {})}
        cost_us = None if found.cost_us is None else found.cost_us + self.rent_us
        found = replace(found, counts=counts, cost_us=cost_us, bound_us=found.bound_us + self.rent_us)
        if found.change_set is None:
            return found if self.is_roomy or found.status is Status.INFEASIBLE else None
        units = self._units(found)
        return self._told(found, units) if self._fit(units) else None

    def _units(self, found: Plan) -> list[ComputationUnit]:
        """The units after a plan, at home, with the inputs fed that start nothing."""
        after = self.problem.after(found).units
        if self.home is not None:
            after = tuple(replace(unit, host=self.home.name) for unit in after)
        return fed_afterwards(self.whole, self.problem, after)

    def _fit(self, units: Collection[ComputationUnit]) -> bool:
        if self.home is None or self.is_roomy:
            return True
        return _has_room(self.whole, self.home, Counter([unit.transformation for unit in units]))

    def _told(self, found: Plan, units: Sequence[ComputationUnit]) -> Plan:
        """The plan with its change set, objectives and unused transformations as they are of the whole problem."""
        environment, old = self.whole.environment, found.change_set
        changes = environment.change_to(units)
        hopeless = set(environment.required).difference(self.problem.environment.required)
        unused = hopeless.union(found.unused_required)
        return replace(
            found,
            change_set=changes,
            unused_required=tuple(label for label in environment.required if label in unused),
            ties_proven=found.ties_proven and old is not None and len(changes.rewired) == len(old.rewired),
            objectives=tuple(self._objectives(found, is_used=bool(units))),
        )

    def _objectives(self, found: Plan, *, is_used: bool) -> Iterator[Measured]:
        """Return the values of all objectives, also of the ones that are equal for all plans."""
        known = {one.objective: one for one in found.objectives}
        for each in self.whole.environment.minimise if Feature.ORDER in self.whole.features else ():
            if each is Objective.COST:
                yield Measured(each, found.cost_us or 0, found.bound_us)
            elif each in known:
                yield known[each]
            else:
                value = 0 if self.home is None or not is_used else 1 if each is Objective.HOSTS else self.rent_us
                yield Measured(each, value, value)


@dataclass(frozen=True)
class _Use:
    """The transformations that plans may use, by `labels`; the most `units` of each, and its `running` ones.

    `startable` is the number of transformations that can be started.
    """

    startable: int
    labels: frozenset[str]
    providers: Providers
    units: Mapping[str, int]
    running: Mapping[str, int]


def reduce(problem: Problem, clock: Clock, *, is_certain: bool = False) -> Reduced:
    """Return the problem without parts that can't affect its plans; a problem of the paper's kind stays as it is.

    With `is_certain`, each plan of it gives a plan of the whole problem that is as good in ties. Raises OutOfTimeError.
    """
    use = None if problem.is_plain else _use(problem, clock.each)
    if use is None:
        return Reduced(problem, problem)
    left = _without_easy_wishes(_with_used_parts(problem, use))
    left = _without_lone_streams(_without_wide_limits(left, use), use)
    home = _home(left)
    is_roomy = home is not None and _has_room(left, home, {t.label: _most(t, use) for t in left.environment.library})
    if home is not None and (is_roomy or not is_certain):
        left = _at_home(left, home)
    else:
        home, is_roomy = None, True
    left = _without_idle_inputs(left, use, is_certain=is_certain)
    left = _without_numbers(_without_what_all_have(left), use)
    return Reduced(problem, left, home, is_roomy, use.startable)


def may_go_on(problem: Problem, unit: ComputationUnit) -> bool:
    """Whether a unit may stay on its host. A cold spare may stay only if failures have to be survived."""
    environment, transformation = problem.environment, problem.environment.transformation[unit.transformation]
    if environment.hosts and unit.host not in environment.hosts_for(transformation):
        return False
    return not unit.standby or (problem.survive is not None and transformation.standby_us is not None)


def _use(problem: Problem, each: Each) -> _Use | None:
    """Return the transformations that plans may use; None if a target or pin can't be met, which needs all reasons."""
    environment, similarity = problem.environment, problem.similarity
    library = environment.library
    optimistic = possible = startable(environment, Providers(library, similarity), each)
    while True:
        library = tuple(t for t in library if t.label in possible and _may_be_somewhere(environment, t, possible))
        if len(library) == len(possible):
            break
        possible = startable(Environment((), library), Providers(library, similarity), each)
    providers = Providers(library, similarity)
    going_on = [
        u for u in environment.units if u.transformation in environment.transformation and may_go_on(problem, u)
    ]
    kept = {u.transformation for u in going_on if environment.transformation[u.transformation].pinned and not u.standby}
    asked = kept & optimistic | {t.label for t in environment.library if t.min_instances}
    if not asked <= possible or any(possible.isdisjoint(providers.of(target.tag)) for target in environment.targets):
        return None
    labels = relevant(replace(environment, library=library), providers, possible, each)
    running = Counter(unit.transformation for unit in going_on if unit.transformation in labels)
    units = {label: running[label] + problem.most_new(environment.transformation[label]) for label in sorted(labels)}
    return _Use(len(optimistic), labels, providers.among(labels), units, running)


def _may_be_somewhere(environment: Environment, t: Transformation, possible: Collection[str]) -> bool:
    is_allowed = t.max_instances != 0 and all(other in possible for other in t.beside)
    return is_allowed and bool(environment.hosts_for(t))


def _with_used_parts(problem: Problem, use: _Use) -> Problem:
    """Leave out transformations, conflicts with them, and what units say that no plan keeps."""
    environment = problem.environment
    library = tuple(_without_conflicts_but(use, t) for t in environment.library if t.label in use.labels)
    if not environment.hosts:
        library = tuple(map(_without_host_fields, library))
    units = tuple(
        unit
        if unit.transformation in use.labels and may_go_on(problem, unit)
        else ComputationUnit(unit.id, GONE, unit.subscriptions)
        for unit in environment.units
    )
    most = {t.label: use.units[t.label] - use.running.get(t.label, 0) for t in library}
    left = replace(environment, library=library, units=units)
    return Numbered(left, problem.similarity, problem.horizon_s, problem.max_cost_us, problem.survive, most)


def _without_conflicts_but(use: _Use, t: Transformation) -> Transformation:
    """The transformation less its conflicts with itself and with what no plan uses."""
    if not (t.conflicts or t.conflicts_on_host):
        return t
    others = use.labels - {t.label}
    left, on_host = (tuple(label for label in these if label in others) for these in (t.conflicts, t.conflicts_on_host))
    return replace(t, conflicts=left, conflicts_on_host=on_host)


def _without_host_fields(t: Transformation) -> Transformation:
    """The transformation less the limits that say nothing where no hosts are declared."""
    said = {name: usual for name, usual in _limits_of_units(t) if name in _ONLY_WITH_HOSTS}
    return with_fields(t, **said) if said else t


def _without_easy_wishes(problem: Problem) -> Problem:
    """Leave out the qualities that targets ask for and every stream has."""
    quality = problem.environment.quality
    targets = []
    for target in problem.environment.targets:
        kept = tuple(
            wish
            for wish in target.quality
            if wish.weight_us
            or (wish.bound is not None and quality[wish.attribute].is_better(wish.bound, quality[wish.attribute].worst))
        )
        targets.append(target if kept == target.quality else replace(target, quality=kept))
    return problem.with_parts(targets=tuple(targets))


def _without_wide_limits(problem: Problem, use: _Use) -> Problem:
    """Leave out limits on instances and on who takes a stream that no configuration can reach."""
    consumers = _consumers(problem, use)

    def freed(t: Transformation) -> Transformation:
        outputs = tuple(
            port if port.serves is None or consumers[port.tag] > port.serves else with_fields(port, serves=None)
            for port in t.outputs
        )
        wide = {name: usual for name, usual in _limits_of_units(t) if use.units[t.label] <= _least(t, name)}
        return t if not wide and outputs == t.outputs else with_fields(t, outputs=outputs, **wide)

    return problem.with_parts(library=tuple(map(freed, problem.environment.library)))


def _consumers(problem: Problem, use: _Use) -> Counter[str]:
    """How many inputs and topics may take a stream, by its tag, where some stream serves only so many."""
    environment, consumers = problem.environment, Counter[str]()
    if Feature.LIMITS not in problem.features:
        return consumers
    demanded = Counter(target.tag for target in environment.stream_targets)
    for t in environment.library:
        for port in t.inputs:
            demanded[port.tag] += _most(t, use)
    for tag, number in demanded.items():
        for offered in use.providers.accepted(tag):
            consumers[offered] += number
    return consumers


def _most(t: Transformation, use: _Use) -> int:
    """How many units of a transformation may be there."""
    units = use.units[t.label]
    return units if t.max_instances is None else min(units, t.max_instances)


def _without_lone_streams(problem: Problem, use: _Use) -> Problem:
    """An input that takes all streams takes one where no more than one can be there for it.

    An optional one stays: it must take that stream even if this closes a cycle.
    """
    library = problem.environment.transformation

    def one_for(t: Transformation, port: InputPort) -> InputPort:
        if port.count != ALL or port.optional:
            return port
        providers = [library[label] for label in use.providers.of(port.tag)]
        accepted = use.providers.accepted(port.tag)
        streams = sum(
            _most(provider, use) * sum(out.tag in accepted for out in provider.outputs) for provider in providers
        )
        return replace(port, count=1) if streams == 1 and t not in providers else port

    return _with_inputs(problem, one_for)


def _with_inputs(problem: Problem, of: Callable[[Transformation, InputPort], InputPort | None]) -> Problem:
    """The problem with other inputs, or without those for which there is None."""

    def changed(t: Transformation) -> Transformation:
        found = tuple(port for port in (of(t, port) for port in t.inputs) if port is not None)
        return t if found == t.inputs else replace(t, inputs=found)

    return problem.with_parts(library=tuple(map(changed, problem.environment.library)))


def _home(problem: Problem) -> Host | None:
    """A host where all units may be, at the least cost, and where it is best that they are: nothing is carried then.

    None if no host is like that, or if a rule may be kept by several hosts and not by one.
    """
    environment = problem.environment
    if not environment.hosts or problem.survive is not None or Feature.LATENCY in problem.features:
        return None
    if any(_may_need_several(environment, t) for t in environment.library):
        return None
    if Feature.QUALITY in problem.features and any(one.host for some in environment.taught.values() for one in some):
        return None
    at = {unit.host for unit in environment.units if unit.transformation != GONE}
    at.update(target.host for target in environment.targets if target.host is not None)
    least_us = min(host.rent_us for host in environment.hosts)
    if least_us and not (environment.targets and problem.max_cost_us is None):
        return None
    if Feature.ORDER in problem.features and problem.max_cost_us is not None:
        return None
    left = {h.name: h for h in environment.hosts if h.rent_us == least_us and at <= {h.name}}
    for t in environment.library:
        costs_us = {
            name: start_cost_us(t, problem.horizon_s, environment.host[name or ""]) for name in environment.hosts_for(t)
        }
        cheapest_us = min(costs_us.values())
        left = {name: host for name, host in left.items() if costs_us.get(name) == cheapest_us}
        if not left:
            return None
    return next(iter(left.values()), None)


def _may_need_several(environment: Environment, t: Transformation) -> bool:
    """Whether a transformation states a rule that several hosts can keep where one can't, or not in the same way."""
    is_several = len(environment.hosts) > 1
    return any(
        getattr(t, name) != usual and (is_several or name in _ONLY_WITH_HOSTS) for name, usual in _BY_HOST.items()
    )


def _limits_of_units(t: Transformation) -> Iterator[tuple[str, Any]]:
    """Yield each attribute by which a transformation limits the number of its units, and its default."""
    for name, usual in _LIMITS_OF_UNITS.items():
        if getattr(t, name) != usual:
            yield name, usual


def _least(t: Transformation, name: str) -> int:
    """The least number of units that an attribute allows."""
    least = least_limit(getattr(t, name))
    assert least is not None
    return least


def _has_room(problem: Problem, host: Host, units: Mapping[str, int]) -> bool:
    """Whether a host has room for so many units of each transformation."""
    library, loads = problem.environment.transformation, Counter[str]()
    for label, number in units.items():
        for resource, amount in taken(library[label], host).items():
            loads[resource] += number * amount
    rooms = {resource: host.room(resource, problem.horizon_s) for resource in loads}
    return all(room is None or loads[resource] <= room for resource, room in rooms.items())


def _at_home(problem: Problem, home: Host) -> Problem:
    """The problem without hosts, with what units cost at home."""
    library = tuple(
        replace(t, labor_us=labor_us(t, home), upkeep_us=upkeep_us(t, home), **_ONLY_WITH_HOSTS)
        for t in problem.environment.library
    )
    units = tuple(replace(unit, host=None) for unit in problem.environment.units)
    targets = tuple(replace(target, host=None) for target in problem.environment.targets)
    return problem.with_parts(library=library, units=units, targets=targets, hosts=(), links=(), transfer_us=0)


def _without_idle_inputs(problem: Problem, use: _Use, *, is_certain: bool) -> Problem:
    """Leave out optional inputs without worth, but for those that make a stream worse, dear to carry, or forbid it.

    A unit that runs is rewired when such an input is fed: if it `is_certain` that ties count, it keeps them.
    """
    environment = problem.environment
    largest_us = environment.prices_us[-1]
    is_limited = any(link.bandwidth is not None for link in environment.links)
    outputs = [port for t in environment.library for port in t.outputs]
    offered = {port.tag for port in outputs}
    carried = {
        port.tag
        for port in (outputs if environment.hosts else ())
        if transfer_cost_us(port, problem.horizon_s, largest_us) or (is_limited and port.bytes_per_s)
    }
    counts_for_quality = Feature.QUALITY in problem.features
    counts_rewired = is_certain or Objective.REWIRED in environment.minimise

    def kept(t: Transformation, port: InputPort) -> InputPort | None:
        if not port.starts_nothing:
            return port
        feeding = use.providers.accepted(port.tag) & offered
        is_kept = feeding and (
            port.count == ALL
            or (counts_for_quality and not port.feedback)
            or feeding & carried
            or (counts_rewired and use.running.get(t.label))
        )
        return port if is_kept else None

    left = _with_inputs(problem, kept)
    units = tuple(_without_gone_inputs(problem, left, unit) for unit in environment.units)
    return left.with_parts(units=units)


def _without_gone_inputs(before: Problem, left: Problem, unit: ComputationUnit) -> ComputationUnit:
    """Drop a unit's subscriptions at inputs that are gone; invalid ones stay, so that the unit has to be rewired."""
    if unit.transformation == GONE:
        return unit
    ports = left.environment.transformation[unit.transformation].input
    inputs = before.environment.transformation[unit.transformation].input
    gone = {
        name
        for name, streams in unit.feeds.items()
        if name in inputs and name not in ports and _is_valid(before, unit, inputs[name], streams)
    }
    if not gone:
        return unit
    return replace(unit, subscriptions=tuple(s for s in unit.subscriptions if s.port not in gone))


def _is_valid(problem: Problem, unit: ComputationUnit, port: InputPort, streams: Sequence[Stream]) -> bool:
    """Whether streams may feed an input, looked at by itself."""
    environment = problem.environment
    if not port.takes(len(streams)) or len({stream.unit for stream in streams}) < len(streams):
        return False
    for stream in streams:
        feeder = environment.unit.get(stream.unit)
        kind = None if feeder is None else environment.transformation.get(feeder.transformation)
        output = None if kind is None else kind.output.get(stream.port)
        if output is None or not problem.similarity.holds(output.tag, port.tag):
            return False
        if stream.unit == unit.id and not port.feedback:
            return False
    return True


def _without_what_all_have(problem: Problem) -> Problem:
    """Leave out objectives about hosts if the environment has none: they are the same for all plans."""
    environment = problem.environment
    if environment.hosts or problem.max_cost_us is not None:
        return problem
    return problem.with_parts(minimise=tuple(each for each in environment.minimise if each not in OF_HOSTS))


def _without_numbers(problem: Problem, use: _Use) -> Problem:
    """The problem as one that asks nothing beyond the paper, if that is so.

    A plan then has no more units of a transformation than run already, and a new one only where none runs, or where it
    costs no labor.
    """
    environment = problem.environment
    if (
        problem.features - {Feature.INSTANCES}
        or environment.required
        or any(t.min_instances for t in environment.library)
    ):
        return problem
    library = []
    for t in environment.library:
        running = use.running.get(t.label, 0)
        most = running + (not running or not t.labor_us)
        limits = dict(_limits_of_units(t))
        if any(_least(t, name) < most for name in limits):
            return problem
        library.append(replace(t, **limits) if limits else t)
    plain = replace(environment, library=tuple(library))
    return Problem(plain, problem.similarity, problem.horizon_s, problem.max_cost_us)


def fed_afterwards(whole: Problem, part: Problem, units: Sequence[ComputationUnit]) -> list[ComputationUnit]:
    """Return the units of a part's plan, with the inputs that the part lacks fed by the present streams.

    An input keeps its present streams.
    """
    library, others = whole.environment.transformation, part.environment.transformation
    gone = {
        label: [port for port in library[label].inputs if port.name not in others[label].input]
        for label in {unit.transformation for unit in units}
    }
    open_inputs = [(unit, port) for unit in units if not unit.standby for port in gone[unit.transformation]]
    if not open_inputs:
        return list(units)
    wiring = _Wiring(whole, units)
    for keeps in (True, False):
        for unit, port in open_inputs:
            wiring.feed(unit, port, keeps=keeps)
    return wiring.units()


class _Wiring:
    """Units, and more and more streams that feed their inputs."""

    def __init__(self, problem: Problem, units: Sequence[ComputationUnit]) -> None:
        self._problem, self._units = problem, {unit.id: unit for unit in units}
        self._feeds = {unit.id: dict(unit.feeds) for unit in units}
        self._taken = Counter(s.stream for unit in units for s in unit.subscriptions)
        self._taken.update(Stream(unit.id, p.port) for unit in units for p in unit.publications)
        self._readers: dict[str, set[str]] = defaultdict(set)
        self._offers: dict[str, list[Stream]] = defaultdict(list)
        for unit in units:
            inputs = self._kind(unit.id).input
            for s in unit.subscriptions:
                if not inputs[s.port].feedback:
                    self._readers[s.stream.unit].add(unit.id)
            for output in self._kind(unit.id).outputs if not unit.standby else ():
                self._offers[output.tag].append(Stream(unit.id, output.name))

    def _kind(self, unit_id: str) -> Transformation:
        return self._problem.environment.transformation[self._units[unit_id].transformation]

    def units(self) -> list[ComputationUnit]:
        return [
            replace(
                unit,
                subscriptions=tuple(
                    Subscription(name, stream) for name, streams in self._feeds[unit.id].items() for stream in streams
                ),
            )
            for unit in self._units.values()
        ]

    def feed(self, unit: ComputationUnit, port: InputPort, *, keeps: bool) -> None:
        """Feed an unfed input if enough streams may feed it; with `keeps`, by its present streams only."""
        if port.name in self._feeds[unit.id]:
            return
        free = list(self._free(unit, port))
        was = self._problem.environment.unit.get(unit.id)
        old = () if was is None else was.feeds.get(port.name, ())
        choices = [stream for stream in old if stream in free] if keeps else free
        by_feeder: dict[str, Stream] = {}
        for stream in choices:
            by_feeder.setdefault(stream.unit if port.distinct is None else self._kind(stream.unit).label, stream)
        if len(by_feeder) < max(port.count, 1) or (keeps and len(by_feeder) < len(old)):
            return
        taken = tuple(by_feeder.values())[: port.count]
        self._feeds[unit.id][port.name] = taken
        self._taken.update(taken)
        for stream in taken if not port.feedback else ():
            self._readers[stream.unit].add(unit.id)

    def _free(self, unit: ComputationUnit, port: InputPort) -> Iterator[Stream]:
        """Yield the streams that may feed an input beside the inputs that are fed already."""
        below = set() if port.feedback else set(reached([unit.id], lambda here: sorted(self._readers[here])))
        there = self._feeding_the_group(unit, port)
        for tag in sorted(self._offers.keys() & self._problem.similarity.offers.get(port.tag, frozenset())):
            for stream in self._offers[tag]:
                kind = self._kind(stream.unit)
                serves = kind.output[stream.port].serves
                is_left = serves is None or self._taken[stream] < serves
                if is_left and stream.unit not in below and kind.label not in there:
                    yield stream

    def _feeding_the_group(self, unit: ComputationUnit, port: InputPort) -> set[str]:
        """The transformations that feed the group of a distinct input."""
        if port.distinct is None:
            return set()
        group = [other.name for other in self._kind(unit.id).inputs if other.distinct == port.distinct]
        streams = (stream for name in group for stream in self._feeds[unit.id].get(name, ()))
        return {self._kind(stream.unit).label for stream in streams}
