"""Pruning removes units that no target, pin, number of instances, company or failure needs."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from heapq import heappop, heappush
from itertools import repeat

from cfgplan.domain import ALL, ComputationUnit, Environment
from cfgplan.onward import grouped, reached
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.company import Running, have_company, running_on
from cfgplan.planners.exact.survivors import survive_without, survives_all_failures
from cfgplan.planners.networks.keys import needed_feeders
from cfgplan.planning import Problem
from cfgplan.reasons import Each


def lean(candidates: Candidates, units: Collection[ComputationUnit], each: Each = iter) -> list[ComputationUnit]:
    """Return the units without those that nothing needs, taken away one after the other.

    Where failures have to be survived, `units` must survive them. `each` counts the steps, and may raise to end the
    work. Needless units that need each other stay if another unit needs one of them.
    """
    pruning = _Pruning(candidates, units)
    for _ in each(repeat(None)):
        if not pruning.goes_on():
            break
    return pruning.left()


class _Pruning:
    """Units on their way to those that are needed.

    A unit becomes needed when it is the last one that others run with, or that a number asks for. Units go whose
    streams nothing takes that is left; new ones go before kept ones.
    """

    def __init__(self, candidates: Candidates, units: Collection[ComputationUnit]) -> None:
        self._candidates, self._environment = candidates, candidates.environment
        self._units = {unit.id: unit for unit in units}
        self._running = running_on(units) if self._environment.companions else {}
        self._number = Counter(unit.transformation for unit in units if not unit.standby)
        self._users: dict[str, set[str]] = defaultdict(set)
        """By unit: those that take its streams and are a reason for it to run."""
        self._consumers: dict[str, set[str]] = defaultdict(set)
        """By unit: all that take its streams."""
        for unit in units:
            for feeder in needed_feeders(self._environment, unit) - {unit.id}:
                self._users[feeder].add(unit.id)
            for s in unit.subscriptions:
                self._consumers[s.stream.unit].add(unit.id)
        self._beside = grouped((other, t.label) for t in self._environment.library for other in t.beside)
        """By transformation: those that run with it."""
        self._needed: set[str] = set()
        meeting = self._environment.meeting(units).values()
        asked = (unit for unit in units if _is_asked_for(self._environment, self._number, unit))
        self._need([unit.id for unit in (*asked, *meeting)])
        self._ahead: list[tuple[bool, str]] = []
        for unit_id in self._units:
            self._look_at(unit_id)

    def left(self) -> list[ComputationUnit]:
        """The units that are left."""
        return list(self._units.values())

    def goes_on(self) -> bool:
        """Take a needless unit away, or keep it if a failure asks for it. False if none is left that may go."""
        while self._ahead:
            _, unit_id = heappop(self._ahead)
            if unit_id in self._units and unit_id not in self._needed and not self._depending_on(unit_id):
                if self._survives_without(unit_id):
                    self._take_away({unit_id})
                else:
                    self._need([unit_id])
                return True
        needless = sorted(self._units.keys() - self._needed, key=self._order)
        return any(map(self._goes_with_its_users, needless))

    def _survives_without(self, unit_id: str) -> bool:
        problem, units = self._candidates.problem, self._units
        return problem.survive is None or survive_without(self._candidates, units.values(), units[unit_id])

    def _goes_with_its_users(self, unit_id: str) -> bool:
        """Remove a unit of a cycle, and the units that can't run without it. False if a needed unit is among them."""
        going = {*reached([unit_id], self._breaking_without)}
        others = [unit for unit in self._units.values() if unit.id not in going]
        running = Counter(unit.transformation for unit in others if not unit.standby)
        if (
            not going.isdisjoint(self._needed)
            or any(running[t.label] < t.min_instances for t in self._environment.library)
            or not have_company(self._environment, others)
            or not survives_all_failures(self._candidates, others)
        ):
            return False
        self._take_away(going)
        return True

    def _breaking_without(self, unit_id: str) -> Iterator[str]:
        """The units that can't run without another: an input that takes all streams may take one less."""
        for other in sorted(self._depending_on(unit_id)):
            unit = self._units[other]
            ports = self._environment.transformation[unit.transformation].input
            taken = [s for s in unit.subscriptions if s.stream.unit == unit_id]
            if not taken or not all(
                s.port in ports and ports[s.port].count == ALL and any(o.unit != unit_id for o in unit.feeds[s.port])
                for s in taken  # a unit may still take what its transformation has no input for any more
            ):
                yield other

    def _depending_on(self, unit_id: str) -> set[str]:
        """The units left that take another's streams, or run with it alone."""
        unit = self._units[unit_id]
        users = {user for user in self._users[unit_id] if user in self._units}
        if unit.transformation in self._environment.companions and not unit.standby:
            users |= self._with(unit) if self._running[unit.host, unit.transformation] == [unit_id] else set()
        return users - {unit_id}

    def _with(self, unit: ComputationUnit) -> set[str]:
        """The units left that run with a unit's transformation on its host."""
        labels = self._beside.get(unit.transformation, ())
        return {user for label in labels for user in self._running.get((unit.host, label), ())}

    def _need(self, unit_ids: Iterable[str]) -> None:
        self._needed.update(reached([i for i in unit_ids if i in self._units], self._needs))

    def _needs(self, unit_id: str) -> set[str]:
        unit = self._units[unit_id]
        return {i for i in needed_feeders(self._environment, unit) if i in self._units} | _lone_company(
            self._environment, self._running, unit
        )

    def _take_away(self, going: Collection[str]) -> None:
        gone = [self._units.pop(unit_id) for unit_id in going]
        for unit in gone:
            label = unit.transformation
            if not unit.standby:
                self._number[label] -= 1
                if self._environment.companions:
                    self._running[unit.host, label].remove(unit.id)
        for unit in gone:
            self._forget(unit)
        for unit in gone:
            least = self._environment.transformation[unit.transformation].min_instances
            if least and self._number[unit.transformation] <= least and not unit.standby:
                same = (one for one in self._units.values() if one.transformation == unit.transformation)
                self._need(one.id for one in same if not one.standby)
            if unit.transformation in self._environment.companions and not unit.standby:
                self._keep_the_last(unit)
        for feeder in sorted({s.stream.unit for unit in gone for s in unit.subscriptions}):
            self._look_at(feeder)
        for unit in gone if self._environment.companions else ():
            for label in self._environment.transformation[unit.transformation].beside:
                for one in self._running.get((unit.host, label), ()):
                    self._look_at(one)

    def _keep_the_last(self, gone: ComputationUnit) -> None:
        """Need the last unit of a transformation on a host if a unit needs it that is needed itself."""
        there = self._running[gone.host, gone.transformation]
        if len(there) == 1 and not self._needed.isdisjoint(self._with(gone)):
            self._need(there)

    def _forget(self, gone: ComputationUnit) -> None:
        """Let the units that are left take no stream of one that is gone."""
        for unit in (self._units[consumer] for consumer in sorted(self._consumers[gone.id]) if consumer in self._units):
            kept = tuple(s for s in unit.subscriptions if s.stream.unit != gone.id)
            self._units[unit.id] = replace(unit, subscriptions=kept)

    def _look_at(self, unit_id: str) -> None:
        """Have a unit go if it is needless and no unit that is left depends on it."""
        if unit_id in self._units and unit_id not in self._needed and not self._depending_on(unit_id):
            heappush(self._ahead, self._order(unit_id))

    def _order(self, unit_id: str) -> tuple[bool, str]:
        return unit_id in self._environment.unit, unit_id


def needed_in_all(problem: Problem, units: Collection[ComputationUnit], spares: Collection[str]) -> set[str]:
    """The ids of the units that a target, pin or number needs, directly or through others, or one of the `spares`."""
    environment, number = problem.environment, Counter(unit.transformation for unit in units if not unit.standby)
    roots = [u for u in units if u.id in spares or _is_asked_for(environment, number, u)]
    return needed_units(environment, units, [*roots, *environment.meeting(units).values()])


def _is_asked_for(environment: Environment, number: Mapping[str, int], unit: ComputationUnit) -> bool:
    """Return whether a unit is no cold spare, and is pinned or one of at most `min_instances` units."""
    transformation = environment.transformation[unit.transformation]
    is_pinned = transformation.pinned and unit.id in environment.unit
    return not unit.standby and (is_pinned or number[unit.transformation] <= transformation.min_instances)


def needed_units(
    environment: Environment, units: Iterable[ComputationUnit], roots: Iterable[ComputationUnit]
) -> set[str]:
    """The ids of the roots and of all units that they need, directly or through others."""
    by_id = {unit.id: unit for unit in units}
    starts = [root.id for root in roots]
    if not environment.companions:
        return set(reached(starts, lambda unit_id: needed_feeders(environment, by_id[unit_id])))
    running = running_on(by_id.values())

    def needs(unit_id: str) -> set[str]:
        unit = by_id[unit_id]
        return needed_feeders(environment, unit) | _lone_company(environment, running, unit)

    return set(reached(starts, needs))


def _lone_company(environment: Environment, running: Running, unit: ComputationUnit) -> set[str]:
    """The units that a running one runs with, where they are the only ones of their transformation there."""
    beside = environment.transformation[unit.transformation].beside if not unit.standby else ()
    company = [running.get((unit.host, label), ()) for label in beside]
    return {ids[0] for ids in company if len(ids) == 1}
