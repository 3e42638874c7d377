"""The ways in which a plan breaks its own claims (Definitions 8 and 10)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from cfgplan.domain import ComputationUnit, Environment, Objective, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Feature, Measured, Plan, Problem, Status
from cfgplan.validity.counts import unfed_us
from cfgplan.validity.environments import violations
from cfgplan.validity.facts import costs_there, known_units, meeting_targets, needed_by
from cfgplan.validity.hosts import carried_us, rents_us
from cfgplan.validity.quality import priced_us
from cfgplan.validity.rules import Rule, Violation
from cfgplan.validity.startable import providers_by_tag, startable


def plan_violations(problem: Problem, plan: Plan) -> list[Violation]:
    """Return every way in which a plan contradicts itself or the problem; empty for a good plan.

    The judge does not repeat the planner's proof that no plan is cheaper or uses more required transformations, but
    reports when the running configuration refutes it. While pairs of tags are open, the change set must be valid even
    if none of them matches. A refusal, and an optimal plan's claim that every pinned unit that can be fed is kept, must
    hold even if all of them match. An optimal plan depends on no open pair.
    """
    if (plan.change_set is not None) != (plan.status in (Status.OPTIMAL, Status.FEASIBLE)):
        text = f"a plan that is {plan.status} must have a change set exactly if one was found"
        return [Violation(Rule.CONSISTENT, text)]
    if plan.change_set is None:
        return list(_bad_refusal(problem, plan))
    try:
        after = problem.environment.update(plan.change_set)
    except InvalidValueError as error:
        return [Violation(Rule.CONSISTENT, str(error))]
    return [
        *violations(after, problem.similarity, problem.survive, problem.horizon_s, before=problem.environment),
        *_bad_change_set(problem.environment, plan, after),
        *_dropped_pinned_units(problem, plan, after),
        *_misreported_required(plan, after),
        *_bad_cost(problem, plan, after),
        *_bad_objectives(problem, plan, after),
        *_refuted_by_running_units(problem, plan),
    ]


def _bad_refusal(problem: Problem, plan: Plan) -> Iterator[Violation]:
    possible = startable(problem.environment, problem.similarity.optimistic)
    providers = providers_by_tag(problem.environment, problem.similarity.optimistic)
    impossible = {
        target.label for target in problem.environment.targets if possible.isdisjoint(providers.get(target.tag, set()))
    }
    labels = {target.label for target in problem.environment.targets}
    if plan.status is Status.INFEASIBLE and not impossible and not problem.is_plain and set(plan.reasons) <= labels:
        return
    if plan.status is Status.INFEASIBLE and set(plan.reasons) != impossible:
        text = f"the targets that can't be met are {sorted(impossible)}, but the plan names {sorted(plan.reasons)}"
        yield Violation(Rule.MET, text)
    if plan.status is Status.INFEASIBLE and not impossible:
        yield Violation(Rule.MET, "every target can be met, but the plan says infeasible")
    if plan.status is Status.TOO_EXPENSIVE:
        if impossible:
            yield Violation(Rule.MET, f"the plan says too expensive, but {sorted(impossible)} can't be met at all")
        if problem.max_cost_us is None or plan.bound_us <= problem.max_cost_us:
            yield Violation(Rule.BOUND, "the plan says too expensive, but its bound does not exceed the largest cost")


def _bad_change_set(before: Environment, plan: Plan, after: Environment) -> Iterator[Violation]:
    assert plan.change_set is not None
    if replace(after, units=before.units) != before:
        yield Violation(Rule.CONSISTENT, "a planner may change units, and nothing else")
    mentioned = {s.stream.unit for unit in before.units for s in unit.subscriptions}
    for unit in plan.change_set.started:
        if unit.id in mentioned:
            text = f"the new unit {unit.id} takes the id of a unit that is gone but still subscribed to"
            yield Violation(Rule.CONSISTENT, text, unit.id)
    for unit in plan.change_set.rewired:
        was = before.unit[unit.id]
        if unit == was:
            yield Violation(Rule.CONSISTENT, f"unit {unit.id} is said to be rewired, but stays as it is", unit.id)
        if unit.transformation != was.transformation:
            yield Violation(Rule.CONSISTENT, f"unit {unit.id} can't change its transformation", unit.id)
        if (unit.host, unit.standby) != (was.host, was.standby):
            text = f"unit {unit.id} can't be moved, started or put in standby by rewiring it"
            yield Violation(Rule.CONSISTENT, text, unit.id)


def silent_stops(problem: Problem, plan: Plan) -> list[Violation]:
    """Return the pinned units that a plan stops without a reason: a planner may omit it, a final plan may not."""
    if plan.change_set is None:
        return []
    dropped = _dropped_pinned(problem.environment, problem.environment.update(plan.change_set))
    return [
        Violation(Rule.PINNED, f"unit {unit.id} is pinned, and it is not said why it is stopped", unit.id)
        for unit, _ in dropped
        if unit.id not in plan.reasons
    ]


def _dropped_pinned(before: Environment, after: Environment) -> list[tuple[ComputationUnit, Transformation]]:
    return [
        (unit, transformation)
        for unit, transformation in known_units(before)
        if transformation.pinned and unit.id not in after.unit and not unit.standby
        if not after.hosts or unit.host in after.hosts_for(transformation)
    ]


def _dropped_pinned_units(problem: Problem, plan: Plan, after: Environment) -> Iterator[Violation]:
    dropped = _dropped_pinned(problem.environment, after)
    similarity = problem.similarity.optimistic if plan.status is Status.OPTIMAL else problem.similarity
    possible = startable(problem.environment, similarity) if dropped else set()
    for unit, transformation in dropped:
        if transformation.label in possible:
            yield Violation(Rule.PINNED, f"unit {unit.id} is pinned and can be fed, but is stopped", unit.id)


def unused_required(environment: Environment) -> tuple[str, ...]:
    """The labels of the required transformations without a unit that serves a target."""
    needed = needed_by(environment, meeting_targets(environment))
    used = {environment.unit[unit_id].transformation for unit_id in needed}
    return tuple(t.label for t in environment.library if t.required and t.label not in used)


def _misreported_required(plan: Plan, after: Environment) -> Iterator[Violation]:
    unused = unused_required(after)
    if unused != plan.unused_required:
        text = (
            f"the unused required transformations are {list(unused)}, but the plan names {list(plan.unused_required)}"
        )
        yield Violation(Rule.REQUIRED, text)
    if plan.status is Status.OPTIMAL and unused and not plan.required_proven:
        text = f"the plan says optimal, but not that no plan uses more than it does: {', '.join(unused)} may be of use"
        yield Violation(Rule.REQUIRED, text)


def _refuted_by_running_units(problem: Problem, plan: Plan) -> Iterator[Violation]:
    """Yield each claim about all plans that a valid running configuration refutes; none if the plan changes nothing."""
    before, changes = problem.environment, plan.change_set
    if not changes or violations(before, problem.similarity, problem.survive, problem.horizon_s):
        return
    if _unknown_spares(before):
        return
    values = values_of(problem, before, before.minimise)
    more_unused = len(unused_required(before)) - len(plan.unused_required)
    if (
        Feature.ORDER in problem.features
        and problem.max_cost_us is not None
        and values[Objective.COST] > problem.max_cost_us
    ):
        return
    if plan.required_proven and more_unused < 0:
        text = "the plan says that no valid configuration uses more required transformations, but what runs does"
        yield Violation(Rule.REQUIRED, text)
    for one in plan.measured if more_unused <= 0 else ():
        value = values[one.objective]
        if one.bound > value:
            text = f"the bound of the {one.objective} is {one.bound}, but what runs has {value}"
            yield Violation(Rule.BOUND, text)
        if more_unused < 0 or not one.is_proven or value != one.value:
            return
    if plan.ties_proven and (changes.rewired or changes.started) and more_unused == 0:
        yield Violation(Rule.BOUND, "the plan says that ties are proven, but what runs is as good without a change")


_PRICES: Final[tuple[tuple[Callable[[Environment, int], int], Feature], ...]] = (
    (carried_us, Feature.HOSTS),
    (lambda environment, horizon_s: rents_us(environment) * horizon_s, Feature.HOSTS),
    (lambda environment, _: priced_us(environment), Feature.QUALITY),
    (unfed_us, Feature.OPTIONAL),
)
"""The parts of the cost beside labor and upkeep, each with the feature without which it is 0."""


def kept_us(environment: Environment, horizon_s: int) -> int:
    """Return the cost of keeping the running configuration for `horizon_s`, in microseconds.

    Units of unknown transformations cost nothing.
    """
    cost = sum(price(environment, horizon_s) for price, feature in _PRICES if feature in environment.features)
    for unit, transformation in known_units(environment):
        _, upkeep_us, standby_us = costs_there(environment, unit, transformation)
        cost += (standby_us if unit.standby else upkeep_us) * horizon_s
    return cost


def cost_us(problem: Problem, after: Environment) -> int:
    """The cost of the update to an environment, in microseconds."""
    before = problem.environment.unit
    new = [known for known in known_units(after) if known[0].id not in before and not known[0].standby]
    return kept_us(after, problem.horizon_s) + sum(costs_there(after, *known)[0] for known in new)


def values_of(
    problem: Problem, after: Environment, objectives: Iterable[Objective] = Objective
) -> dict[Objective, int]:
    """The objectives' values of the update to an environment."""
    return {objective: _VALUES[objective](problem, after) for objective in objectives}


def _used_hosts(after: Environment) -> int:
    there = {unit.host for unit in after.units}
    return sum(host.name in there for host in after.hosts)


def _rewired(before: Mapping[str, ComputationUnit], after: Environment) -> int:
    return sum(unit.id in before and unit != before[unit.id] for unit in after.units)


_VALUES: Final[Mapping[Objective, Callable[[Problem, Environment], int]]] = {
    Objective.RENT: lambda problem, after: rents_us(after) * problem.horizon_s,
    Objective.COST: cost_us,
    Objective.UNITS: lambda _, after: sum(not unit.standby for unit in after.units),
    Objective.HOSTS: lambda _, after: _used_hosts(after),
    Objective.REWIRED: lambda problem, after: _rewired(problem.environment.unit, after),
    Objective.STARTED: lambda problem, after: len(after.unit.keys() - problem.environment.unit.keys()),
}


def _bad_objectives(problem: Problem, plan: Plan, after: Environment) -> Iterator[Violation]:
    named = problem.environment.minimise if Feature.ORDER in problem.features else ()
    if tuple(one.objective for one in plan.objectives) != named:
        yield Violation(Rule.CONSISTENT, f"the objectives are {', '.join(named)}, but the plan names others")
        return
    values = values_of(problem, after, named)
    for one in plan.objectives:
        value, cost = values[one.objective], Measured(Objective.COST, plan.cost_us or 0, plan.bound_us)
        if one.value != value or (one.objective is Objective.COST and one != cost):
            yield Violation(Rule.COST, f"the update has a {one.objective} of {value}, but the plan says {one.value}")
        if one.bound > value:
            yield Violation(Rule.BOUND, f"the bound {one.bound} exceeds the {one.objective}, {value}")
    if plan.status is Status.OPTIMAL and not all(one.is_proven for one in plan.objectives):
        yield Violation(Rule.BOUND, "the plan says optimal, but not all that is minimised is proven")


def _unknown_spares(environment: Environment) -> list[str]:
    """The cold spares of transformations that have none, which no plan keeps."""
    return [unit.id for unit, kind in known_units(environment) if unit.standby and kind.standby_us is None]


def _bad_cost(problem: Problem, plan: Plan, after: Environment) -> Iterator[Violation]:
    for spare in _unknown_spares(after):
        yield Violation(Rule.COST, f"unit {spare} is in standby, which its transformation does not know")
    cost = cost_us(problem, after)
    if plan.cost_us != cost:
        yield Violation(Rule.COST, f"the update costs {cost} us, but the plan says {plan.cost_us} us")
    if problem.max_cost_us is not None and cost > problem.max_cost_us:
        yield Violation(Rule.COST, f"the update costs {cost} us, more than the {problem.max_cost_us} us allowed")
    if plan.bound_us > cost:
        yield Violation(Rule.BOUND, f"the bound {plan.bound_us} us exceeds the cost {cost} us")
    if plan.status is Status.OPTIMAL and plan.bound_us != cost:
        yield Violation(Rule.BOUND, f"the plan says optimal, but its bound is {plan.bound_us} us of {cost} us")
    is_proven = all(one.bound and one.is_proven for one in plan.measured)  # a bound of 0 claims nothing
    is_proven &= plan.required_proven or not plan.unused_required
    if plan.status is Status.FEASIBLE and is_proven and not plan.undecided:
        yield Violation(Rule.BOUND, f"the plan says feasible, but its bound is its cost of {cost} us")
    if plan.status is Status.FEASIBLE and plan.ties_proven:
        yield Violation(Rule.BOUND, "the plan says that ties are proven, but its cost is not")
    if plan.status is Status.OPTIMAL and plan.undecided:
        yield Violation(Rule.BOUND, "the plan says optimal, but names pairs of tags on which its bound depends")
