"""The judge: every rule that an environment or a plan breaks, in words (Definitions 8-10).

It shares no code with any planner and recomputes feasibility and cost from the definitions alone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from graphlib import CycleError, TopologicalSorter

from cfgplan.domain import ComputationUnit, Environment, Similarity, Stream, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Plan, Problem, Status


class Rule(StrEnum):
    """What a valid environment, and a truthful plan, must satisfy."""

    KNOWN = "every unit instantiates a transformation of the library (Definition 9.1)"
    FED = "every input of a unit is fed by a stream of a running unit (Definition 9.2)"
    MET = "every target is met by exactly one stream, published on its topic (Definition 9.3)"
    MATCHING = "every stream's tag is subsumed by the tag of what it feeds (Definition 9.4)"
    GROUNDED = "every unit's data comes from sources: no cycle without a feedback input"
    DISTINCT = "inputs of one distinct group are fed by different transformations"
    LEAN = "no unit runs that no target needs, unless it is pinned"
    PUBLISHED = "a topic carries only what a target asks for"
    PINNED = "a running unit of a pinned transformation is kept where it can be fed"
    REQUIRED = "a plan says which required transformations it leaves unused"
    CONSISTENT = "a change set can be applied and says exactly what changes"
    COST = "cost is labor of what starts plus upkeep of what runs over the horizon (Definition 8)"
    BOUND = "the bound is at most the cost, and equal to it when the plan is optimal"


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken rule, with the unit or target (and port) where it is broken."""

    rule: Rule
    text: str
    unit: str | None = None
    port: str | None = None
    target: str | None = None

    def __str__(self) -> str:
        return self.text


def violations(environment: Environment, similarity: Similarity) -> list[Violation]:
    """Every rule that the running configuration violates; empty when it is valid (Definition 9)."""
    return [
        *_unknown_transformations(environment),
        *_bad_subscriptions(environment, similarity),
        *_bad_publications(environment, similarity),
        *_cycles(environment),
        *_indistinct_feeds(environment),
        *_needless_units(environment),
    ]


def plan_violations(problem: Problem, plan: Plan) -> list[Violation]:
    """Every way in which a plan fails to be what it says it is; empty for a good plan.

    That no plan is cheaper is the planner's proof and is not repeated here.
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
        *violations(after, problem.similarity),
        *_bad_change_set(problem.environment, plan, after),
        *_dropped_pinned_units(problem, after),
        *_misreported_required(plan, after),
        *_bad_cost(problem, plan, after),
    ]


# --- environments ------------------------------------------------------------------------------


def _unknown_transformations(environment: Environment) -> Iterator[Violation]:
    for unit in environment.units:
        if unit.transformation not in environment.transformation:
            yield Violation(
                Rule.KNOWN, f"unit {unit.id} instantiates {unit.transformation}, which is not in the library", unit.id
            )


def _bad_subscriptions(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    for unit, transformation in _known_units(environment):
        for port in transformation.inputs:
            if port.name not in unit.feeds:
                text = f"input {port.name} of unit {unit.id} has no subscription"
                yield Violation(Rule.FED, text, unit.id, port.name)
        for name, stream in unit.feeds.items():
            if name not in transformation.input:
                text = f"unit {unit.id} subscribes at {name}, which is no input of {transformation.label}"
                yield Violation(Rule.FED, text, unit.id, name)
                continue
            offered = _tag_of(environment, stream)
            if offered is None:
                text = f"input {name} of unit {unit.id} subscribes to {stream}, which nothing produces"
                yield Violation(Rule.FED, text, unit.id, name)
            elif not similarity.holds(offered, transformation.input[name].tag):
                wanted = transformation.input[name].tag
                text = f"input {name} of unit {unit.id} needs {wanted}, but {stream} gives {offered}"
                yield Violation(Rule.MATCHING, text, unit.id, name)


def _bad_publications(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    published: dict[str, list[Stream]] = defaultdict(list)
    topics = {target.topic for target in environment.targets}
    for unit, transformation in _known_units(environment):
        for publication in unit.publications:
            published[publication.topic].append(Stream(unit.id, publication.port))
            if publication.port not in transformation.output:
                text = f"unit {unit.id} publishes {publication.port}, which is no output of {transformation.label}"
                yield Violation(Rule.PUBLISHED, text, unit.id, publication.port)
            if publication.topic not in topics:
                text = f"unit {unit.id} publishes on {publication.topic}, which no target names"
                yield Violation(Rule.PUBLISHED, text, unit.id, publication.port)
    for target in environment.targets:
        streams = published[target.topic]
        if len(streams) != 1:
            found = f"{len(streams)} streams are" if streams else "no stream is"
            text = f"{found} published on {target.topic}, the topic of target {target.label}"
            yield Violation(Rule.MET, text, target=target.label)
        for stream in streams:
            offered = _tag_of(environment, stream)
            if offered is not None and not similarity.holds(offered, target.tag):
                text = f"target {target.label} wants {target.tag}, but {stream} gives {offered}"
                yield Violation(Rule.MATCHING, text, target=target.label)


def _cycles(environment: Environment) -> Iterator[Violation]:
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for unit, transformation in _known_units(environment):
        for name, stream in unit.feeds.items():
            if name in transformation.input and not transformation.input[name].feedback:
                sorter.add(unit.id, stream.unit)
    try:
        sorter.prepare()
    except CycleError as error:
        ring = error.args[1]
        text = f"units feed each other in a cycle with nothing from outside: {' -> '.join(ring)}"
        yield Violation(Rule.GROUNDED, text, ring[0])


def _indistinct_feeds(environment: Environment) -> Iterator[Violation]:
    for unit, transformation in _known_units(environment):
        feeders: dict[tuple[str, str], list[str]] = defaultdict(list)
        for port in transformation.inputs:
            stream = unit.feeds.get(port.name)
            if port.distinct is not None and stream is not None and stream.unit in environment.unit:
                feeders[port.distinct, environment.unit[stream.unit].transformation].append(port.name)
        for (_, feeder), ports in feeders.items():
            if len(ports) > 1:
                text = f"inputs {' and '.join(ports)} of unit {unit.id} must differ, but {feeder} feeds them all"
                yield Violation(Rule.DISTINCT, text, unit.id, ports[0])


def _needless_units(environment: Environment) -> Iterator[Violation]:
    pinned = {unit.id for unit, transformation in _known_units(environment) if transformation.pinned}
    needed = _needed_by(environment, _publishers(environment) | pinned)
    for unit in environment.units:
        if unit.id not in needed:
            yield Violation(Rule.LEAN, f"unit {unit.id} runs, but no target needs it", unit.id)


# --- plans -------------------------------------------------------------------------------------


def _bad_refusal(problem: Problem, plan: Plan) -> Iterator[Violation]:
    possible = _startable(problem.environment, problem.similarity)
    givers = _givers(problem.environment, problem.similarity)
    impossible = {
        target.label for target in problem.environment.targets if possible.isdisjoint(givers.get(target.tag, set()))
    }
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
    if (after.library, after.targets) != (before.library, before.targets):
        yield Violation(Rule.CONSISTENT, "a planner may change units, not the library or the targets")
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


def _dropped_pinned_units(problem: Problem, after: Environment) -> Iterator[Violation]:
    possible = _startable(problem.environment, problem.similarity)
    for unit, transformation in _known_units(problem.environment):
        if transformation.pinned and transformation.label in possible and unit.id not in after.unit:
            yield Violation(Rule.PINNED, f"unit {unit.id} is pinned and can be fed, but is stopped", unit.id)


def _misreported_required(plan: Plan, after: Environment) -> Iterator[Violation]:
    needed = _needed_by(after, _publishers(after))
    used = {after.unit[unit_id].transformation for unit_id in needed}
    unused = tuple(t.label for t in after.library if t.required and t.label not in used)
    if unused != plan.unused_required:
        text = (
            f"the unused required transformations are {list(unused)}, but the plan names {list(plan.unused_required)}"
        )
        yield Violation(Rule.REQUIRED, text)


def _bad_cost(problem: Problem, plan: Plan, after: Environment) -> Iterator[Violation]:
    cost = 0
    for unit, transformation in _known_units(after):
        cost += transformation.upkeep_us * problem.horizon_s
        if unit.id not in problem.environment.unit:
            cost += transformation.labor_us
    if plan.cost_us != cost:
        yield Violation(Rule.COST, f"the update costs {cost} us, but the plan says {plan.cost_us} us")
    if problem.max_cost_us is not None and cost > problem.max_cost_us:
        yield Violation(Rule.COST, f"the update costs {cost} us, more than the {problem.max_cost_us} us allowed")
    if plan.bound_us > cost:
        yield Violation(Rule.BOUND, f"the bound {plan.bound_us} us exceeds the cost {cost} us")
    if plan.status is Status.OPTIMAL and plan.bound_us != cost:
        yield Violation(Rule.BOUND, f"the plan says optimal, but its bound is {plan.bound_us} us of {cost} us")


# --- what both need ----------------------------------------------------------------------------


def _known_units(environment: Environment) -> Iterator[tuple[ComputationUnit, Transformation]]:
    for unit in environment.units:
        if unit.transformation in environment.transformation:
            yield unit, environment.transformation[unit.transformation]


def _tag_of(environment: Environment, stream: Stream) -> str | None:
    unit = environment.unit.get(stream.unit)
    transformation = environment.transformation.get(unit.transformation) if unit else None
    port = transformation.output.get(stream.port) if transformation else None
    return port.tag if port else None


def _publishers(environment: Environment) -> set[str]:
    topics = {target.topic for target in environment.targets}
    return {unit.id for unit in environment.units if any(p.topic in topics for p in unit.publications)}


def _needed_by(environment: Environment, roots: Collection[str]) -> set[str]:
    """The ids of `roots` and of all units whose streams they use, directly or through others."""
    needed: set[str] = set()
    ahead = [root for root in roots if root in environment.unit]
    while ahead:
        unit_id = ahead.pop()
        if unit_id not in needed:
            needed.add(unit_id)
            ahead += [s.unit for s in environment.unit[unit_id].feeds.values() if s.unit in environment.unit]
    return needed


def _startable(environment: Environment, similarity: Similarity) -> set[str]:
    """The labels of all transformations of which a unit can run in some valid wiring.

    More providers never hurt, so it is enough to look at all of them running at once: the largest
    set whose ordinary inputs are fed by members that come before and feedback inputs by any member.
    """
    givers = _givers(environment, similarity)
    candidates = set(environment.transformation)
    while True:
        grounded: set[str] = set()
        while True:
            more = {
                label
                for label in candidates - grounded
                if _can_be_fed(givers, environment.transformation[label], grounded, candidates)
            }
            if not more:
                break
            grounded |= more
        if grounded == candidates:
            return grounded
        candidates = grounded


def _can_be_fed(
    givers: Mapping[str, set[str]], transformation: Transformation, before: set[str], anywhere: set[str]
) -> bool:
    choices: dict[str, dict[str, set[str]]] = defaultdict(dict)
    for port in transformation.inputs:
        group = port.distinct if port.distinct is not None else f"\0{port.name}"
        allowed = anywhere if port.feedback else before
        choices[group][port.name] = givers.get(port.tag, set()) & allowed
    return all(_different_choices_exist(group) for group in choices.values())


def _givers(environment: Environment, similarity: Similarity) -> dict[str, set[str]]:
    """For each demanded tag the transformations with an output that matches it."""
    offering: dict[str, set[str]] = defaultdict(set)
    for transformation in environment.library:
        for port in transformation.outputs:
            offering[port.tag].add(transformation.label)
    return {
        demanded: {label for tag in offered for label in offering.get(tag, ())}
        for demanded, offered in similarity.offers.items()
    }


def _different_choices_exist(choices: Mapping[str, set[str]]) -> bool:
    """Whether each port can have a feeder of its own (a matching, by augmenting paths)."""
    port_of: dict[str, str] = {}

    def assign(port: str, tried: set[str]) -> bool:
        for feeder in choices[port] - tried:
            tried.add(feeder)
            if feeder not in port_of or assign(port_of[feeder], tried):
                port_of[feeder] = port
                return True
        return False

    return all(assign(port, set()) for port in choices)
