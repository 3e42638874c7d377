"""A manager's knowledge beyond the configuration: the transformation of each unit, the avoided transformations, and the
input of a plan.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from cfgplan.api import World
from cfgplan.costs import labor_us, upkeep_us
from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Host, Statement, Transformation
from cfgplan.errors import InputError, did_you_mean
from cfgplan.facts import FactValue
from cfgplan.planning import fresh_units
from cfgplan.ros.sources import NodeSource
from cfgplan_runtime.lifecycle.back_off import BackOffs, Place
from cfgplan_runtime.lifecycle.differences import can_run_as
from cfgplan_runtime.lifecycle.seams import Estimator
from cfgplan_runtime.lifecycle.silence import Silence

T = TypeVar("T")

LARGEST_ESTIMATE_US = 10**12
"""Larger estimates are cut to this: 11 days of CPU time, which means never."""


@dataclass(frozen=True, slots=True)
class Running:
    """The transformation that a unit was started as, when, and on which host."""

    transformation: Transformation
    since_s: float
    host: str | None = None

    @property
    def place(self) -> Place:
        """Where its failures count."""
        return Place(self.transformation.label, self.host)


@dataclass(frozen=True, slots=True)
class Situation:
    """Knowledge about the running units, beyond their configuration."""

    back_offs: BackOffs
    units: Mapping[str, Running] = field(default_factory=dict)
    """By unit id, including units whose death has not been noticed yet."""
    failing: frozenset[str] = frozenset()
    """Ids of running units that will be replaced."""
    killed: frozenset[str] = frozenset()
    """Ids of units that were killed on request."""
    presence: Mapping[str, bool] = field(default_factory=dict)
    """By host: whether it has joined, by the middleware's last report."""
    clocks_ahead_us: Mapping[str, int] = field(default_factory=dict)
    """By joined host: the microseconds by which its clock is ahead of the manager's."""
    awaits_hosts: bool = False
    """Whether hosts without a report of the middleware count as not joined yet."""
    facts: Mapping[str, FactValue] = field(default_factory=dict)
    """The facts of the world that have been set since the run began, by name."""
    qualities: Mapping[Statement, int] = field(default_factory=dict)
    """By how much outputs are better or worse than stated, as observed streams have taught; in micro-units."""
    link_rates: Mapping[tuple[str, str], int] = field(default_factory=dict)
    """The measured rates of links that carry less than declared, in bytes per second, by their two selectors."""
    code_faults: Mapping[str, str] = field(default_factory=dict)
    """The faults of code that can't be started, by the transformation's label."""
    given_up_hosts: frozenset[str] = frozenset()
    """Hosts that were taken out of service on request."""
    prepared: frozenset[str] = frozenset()
    """Ids of the cold spares that the middleware has prepared."""
    silences: tuple[Silence, ...] = ()
    """Targets that count as unmet though a stream is published for them."""

    def label_of(self, unit: str) -> str | None:
        """The label of a unit's transformation; None if the unit is not known."""
        running = self.units.get(unit)
        return None if running is None else running.transformation.label

    def why_not(self, label: str, host: str | None) -> str | None:
        """The reason why no unit of a transformation may be started on a host now, apart from facts; None
        if one may.
        """
        if self.is_lost(host):
            return gone_host(host)
        return self.code_faults.get(label) or self.back_offs.why_not(label, host)

    def as_it_is(self, world: World) -> World:
        """The world with its present facts, learned qualities and measured rates of links."""
        if not (self.facts or self.qualities or self.link_rates):
            return world
        environment = world.environment.with_facts(self.facts).with_qualities(self.qualities)
        if self.link_rates:
            environment = environment.with_link_rates(self.link_rates)
        return replace(world, environment=environment)

    def is_lost(self, host: str | None) -> bool:
        """Whether plans may not use a host, since it is lost or out of service."""
        return host is not None and (host in self.given_up_hosts or not self.presence.get(host, not self.awaits_hosts))

    def lost_hosts(self, world: Environment) -> tuple[str, ...]:
        """The hosts of a world that plans may not use, sorted."""
        return tuple(host for host in hosts_of(world) if self.is_lost(host))

    def without(self, *gone: str) -> Situation:
        """The situation without these units."""
        left = {unit: running for unit, running in self.units.items() if unit not in gone}
        failing, killed, prepared = (ids.difference(gone) for ids in (self.failing, self.killed, self.prepared))
        return replace(self, units=left, failing=failing, killed=killed, prepared=prepared)

    def with_started(self, units: Iterable[ComputationUnit], library: Environment, now_s: float) -> Situation:
        """Add the units that are not known yet: they run since `now_s` as `library` says."""
        known = library.transformation
        new = {
            unit.id: Running(known[unit.transformation], now_s, unit.host or known[unit.transformation].host)
            for unit in units
            if unit.id not in self.units and unit.transformation in known and not unit.standby
        }
        return replace(self, units={**self.units, **new}) if new else self


@dataclass(frozen=True, slots=True)
class PlanInput:
    """The input of a plan: the world, the running configuration, and the other knowledge about running units."""

    world: World
    running: Environment
    situation: Situation


def hosts_of(world: Environment) -> tuple[str, ...]:
    """The hosts that are declared; if none are, those that transformations name, sorted."""
    if world.hosts:
        return tuple(world.host)
    return tuple(sorted({t.host for t in world.library if t.host is not None}))


def is_outdated(running: Running, world: Environment) -> bool:
    """Whether a unit was started as an earlier version of its transformation, so that its failures say nothing about
    the present one.
    """
    now = world.transformation.get(running.transformation.label)
    return now is not None and not can_run_as(running.transformation, now)


def check_host(world: Environment, host: str) -> None:
    """Raise InputError if a world has no host of this name."""
    hosts = hosts_of(world)
    if host not in hosts:
        choice = f"choose one of {', '.join(hosts)}" if hosts else "no transformation names a host"
        raise InputError.of(f"there is no host {host!r}", mend=did_you_mean(host, hosts, choice))


class EstimatedLibrary:
    """Transformations with estimated instead of declared costs; the same object while its estimates stay the same."""

    def __init__(self) -> None:
        self._estimated: dict[str, tuple[Transformation, Transformation]] = {}

    def estimated(self, world: Environment, estimator: Estimator, horizon_s: int) -> Mapping[str, Transformation]:
        """The library of a world by label, with the estimated costs on each host where units may run."""
        return {one.label: self._of(one, world, estimator, horizon_s) for one in world.library}

    def _of(
        self, transformation: Transformation, world: Environment, estimator: Estimator, horizon_s: int
    ) -> Transformation:
        costs_us = (transformation.labor_us, transformation.upkeep_us)
        seen_us = {}
        for host in world.places_for(transformation):
            there = [host] if host is not None else []
            expected_us = (
                _capped(estimator.labor_us(transformation, horizon_s, *there)),
                _capped(estimator.upkeep_us(transformation, horizon_s, *there)),
            )
            if host is None:
                costs_us = expected_us
            elif expected_us != (labor_us(transformation, host), upkeep_us(transformation, host)):
                seen_us[host.name] = expected_us
        declared, known = self._estimated.get(transformation.label, (transformation, transformation))
        if declared is not transformation or (known.labor_us, known.upkeep_us, known.seen_us) != (*costs_us, seen_us):
            known = replace(transformation, labor_us=costs_us[0], upkeep_us=costs_us[1], seen_us=seen_us)
        if known == transformation and not seen_us:
            return transformation
        self._estimated[transformation.label] = (transformation, known)
        return known


def _capped(cost_us: int) -> int:
    return max(0, min(cost_us, LARGEST_ESTIMATE_US))


def avoided_now(plan_input: PlanInput) -> dict[str, str]:
    """The reasons why transformations are left out, by label. One that backs off is kept while a good unit
    of it runs.
    """
    world, situation = plan_input.world.environment, plan_input.situation
    avoided = dict(world.left_out)
    for label, transformation in world.transformation.items():
        places = world.hosts_for(transformation) if world.hosts else (transformation.host,)
        if label in avoided or not places or may_start(plan_input, transformation):
            continue
        lost = [host for host in places if situation.is_lost(host)]
        if len(lost) == len(places):
            avoided[label] = gone_host(*places)
        else:
            avoided[label] = next(
                why for host in places if host not in lost and (why := situation.why_not(label, host))
            )
    return avoided


def may_start(plan_input: PlanInput, transformation: Transformation) -> tuple[str | None, ...]:
    """The hosts where units of a transformation may run now: nothing rules them out, or a unit of it runs well there.

    None stands for the only place of a world without hosts.
    """
    world, situation = plan_input.world.environment, plan_input.situation
    places = world.hosts_for(transformation) if world.hosts else (transformation.host,)
    against = {host for host in places if situation.why_not(transformation.label, host) is not None}
    if not against:
        return places
    sound = {
        unit.host
        for unit in plan_input.running.units
        if unit.id in situation.units
        and unit.id not in situation.failing
        and situation.units[unit.id].transformation.label == transformation.label
        and _has_ports_of(situation.units[unit.id].transformation, transformation)
    }
    return tuple(host for host in places if host not in against or (host in sound and not situation.is_lost(host)))


def environment_to_plan(
    plan_input: PlanInput, avoided: Mapping[str, str], costs: Mapping[str, Transformation]
) -> Environment:
    """The environment that an update is planned for.

    It has no host that is lost, and no target there. A unit that can't go on (given up, of a transformation that runs
    otherwise now, or on a host that it does not have) gets a label that the library does not have, so that the planner
    stops it, and replaces it where it is needed.
    """
    world, situation = plan_input.world.environment, plan_input.situation
    library = tuple(_where_it_may(plan_input, costs[label]) for label in world.transformation if label not in avoided)
    omitted = tuple((costs[label], why) for label, why in avoided.items())
    hosts = tuple(host for host in world.hosts if not situation.is_lost(host.name))
    targets = tuple(target for target in world.targets if not situation.is_lost(target.host))
    units = tuple(_as_planned(unit, world, hosts, situation) for unit in plan_input.running.units)
    return replace(world, units=units, library=library, targets=targets, hosts=hosts, omitted=omitted)


def _where_it_may(plan_input: PlanInput, transformation: Transformation) -> Transformation:
    """Return the transformation without the reachable hosts on which it keeps failing."""
    world, situation = plan_input.world.environment, plan_input.situation
    if not situation.back_offs.places_of(transformation.label) or not world.hosts or transformation.host is not None:
        return transformation
    allowed = may_start(plan_input, transformation)
    there = [host for host in world.hosts_for(transformation) if not situation.is_lost(host)]
    hosts = tuple(host for host in allowed if host is not None)
    return transformation if len(allowed) == len(there) else replace(transformation, hosts=hosts)


def as_it_runs(world: Environment, running: Environment) -> Environment:
    """The running configuration in the present world, which may have lost some of its hosts."""
    return replace(world, units=running.units, hosts=tuple({**running.host, **world.host}.values()))


def gone_host(*hosts: str | None) -> str:
    """The reason why a part that needs one of these hosts is missing."""
    names = ", ".join(host for host in hosts if host is not None)
    return f"host {names} is gone" if len(hosts) == 1 else f"hosts {names} are gone"


def _as_planned(
    unit: ComputationUnit, world: Environment, hosts: Sequence[Host], situation: Situation
) -> ComputationUnit:
    known = situation.units.get(unit.id)
    is_old = (
        known is not None
        and is_outdated(known, world)
        and situation.why_not(known.transformation.label, unit.host) is None
    )
    is_there = unit.host in [host.name for host in hosts] if hosts else unit.host is None
    if is_old or not is_there or unit.id in situation.failing:
        return replace(unit, transformation=f"{unit.transformation} (to be replaced)", host=None)
    return unit


def _has_ports_of(one: Transformation, other: Transformation) -> bool:
    return (set(one.input), set(one.output)) == (set(other.input), set(other.output))


def external_units(changes: ChangeSet | None, library: Environment) -> tuple[str, ...]:
    """The new units of a change set that are external nodes of ROS, for which nothing is started."""
    new = () if changes is None else changes.started
    return tuple(unit.id for unit in new if is_external(library.transformation[unit.transformation]))


def is_external(transformation: Transformation) -> bool:
    """Whether units of a transformation are external nodes of ROS, which the run does not start."""
    node = NodeSource.read(transformation.source)
    return node is not None and node.kind == "external"


def restarting(running: Environment, units: Iterable[str]) -> ChangeSet:
    """The change set that replaces running units by new ones, on the same hosts and with the same wiring.

    Ids of units that do not run are ignored.
    """
    old = [unit for unit in running.units if unit.id in set(units)]
    fresh = {
        label: iter(ids) for label, ids in fresh_units(running, Counter(unit.transformation for unit in old)).items()
    }
    new_id = {unit.id: next(fresh[unit.transformation]) for unit in old}

    def led(unit: ComputationUnit) -> ComputationUnit:
        subscriptions = tuple(
            replace(one, stream=replace(one.stream, unit=new_id.get(one.stream.unit, one.stream.unit)))
            for one in unit.subscriptions
        )
        return replace(unit, id=new_id.get(unit.id, unit.id), subscriptions=subscriptions)

    return running.change_to(map(led, running.units))


def with_world(change_set: ChangeSet, world: Environment, known: Environment) -> ChangeSet:
    """Add to a change set over units how library, targets, hosts and qualities get from `known` to `world`."""
    return replace(
        change_set,
        added_transformations=_new(world.transformation, known.transformation),
        removed_transformations=_gone(world.transformation, known.transformation),
        added_targets=_new(world.target, known.target),
        removed_targets=_gone(world.target, known.target),
        added_hosts=_new(world.host, known.host),
        removed_hosts=_gone(world.host, known.host),
        added_qualities=_new(world.quality, known.quality),
        removed_qualities=_gone(world.quality, known.quality),
    )


def _new(wanted: Mapping[str, T], known: Mapping[str, T]) -> tuple[T, ...]:
    return tuple(value for name, value in wanted.items() if known.get(name) != value)


def _gone(wanted: Mapping[str, T], known: Mapping[str, T]) -> tuple[str, ...]:
    return tuple(sorted(known.keys() - wanted.keys()))
