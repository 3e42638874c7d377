"""How good streams say they are, and what that teaches of the transformations that give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import exp, sqrt

from cfgplan.domain import Environment, Statement
from cfgplan.observed import learned, stated_at, taught, usual_variance
from cfgplan.qualities import QualityRule
from cfgplan_runtime.lifecycle.perturbations import QualitiesObserved
from cfgplan_runtime.lifecycle.reports import QualityView
from cfgplan_runtime.lifecycle.seen_qualities import SeenQualities
from cfgplan_runtime.lifecycle.turns import Turn


def qualities_learned(turn: Turn) -> Turn:
    """Learn from what streams have said. A review is due if one is better or worse for sure than was known."""
    state, at_s = turn.state, turn.at_s
    seen, situation = state.seen, state.situation
    if not seen.is_new:
        return turn
    world = state.living.world.environment.with_facts(situation.facts)
    running = replace(world, units=tuple(unit for unit in state.running.units if not unit.standby), targets=())
    samples = {said: sample for said, window in seen.windows.items() if (sample := window.sample) is not None}
    fresh = frozenset(said for said, window in seen.windows.items() if window.is_full) - seen.confirmed
    lesson = learned(running, samples, seen.estimates, at_s, fresh=fresh)
    seen = replace(seen, is_new=False, confirmed=seen.confirmed | fresh, estimates=lesson.estimates)
    turn = turn.to(replace(state, seen=seen))
    if not (lesson.news or fresh):
        return turn
    qualities = taught(world, lesson.estimates, at_s)
    turn = turn.situated(replace(situation, qualities=qualities))
    if not lesson.news or qualities == situation.qualities:
        return turn
    changed = [
        one for one in qualities.keys() | situation.qualities.keys() if _differs(one, qualities, situation.qualities)
    ]
    after = world.with_qualities(qualities)
    return turn.perturbed(QualitiesObserved(tuple(sorted(_told(after, one) for one in changed))))


def qualities_faded(turn: Turn) -> Turn:
    """Let the next plan know what is left of what was learned of streams that nobody has seen for long."""
    state = turn.state
    if not state.seen.estimates:
        return turn
    world = state.living.world.environment.with_facts(state.situation.facts)
    return turn.situated(replace(state.situation, qualities=taught(world, state.seen.estimates, turn.at_s)))


def quality_views(world: Environment, seen: SeenQualities, at_s: float) -> tuple[QualityView, ...]:
    """What was learned of each output of a world with stated qualities, by name."""
    found = []
    handed = taught(world, seen.estimates, at_s)
    for statement, known in sorted(seen.estimates.items()):
        stated = stated_at(world, statement)
        if stated is None:
            continue
        estimate = known.at(at_s, usual_variance(stated))
        is_factor = stated.rule is QualityRule.SCALE
        value = stated.stated * exp(estimate.deviation) if is_factor else stated.stated + estimate.deviation
        error = sqrt(estimate.variance) * (abs(value) if is_factor else 1.0)
        planned = stated.taught(handed.get(statement, 0)).value
        found.append(
            QualityView(
                *statement, stated.stated, planned, round(value), round(error), max(0.0, at_s - estimate.seen_s)
            )
        )
    return tuple(found)


def _differs(statement: Statement, one: Mapping[Statement, int], other: Mapping[Statement, int]) -> bool:
    return one.get(statement) != other.get(statement)


def _told(world: Environment, statement: Statement) -> str:
    """What is so now: `sonar/p error 0.62 m, 0.2 m declared`."""
    stated = stated_at(world, statement)
    assert stated is not None  # only what the world states is taught
    name = f"{statement.transformation}/{statement.output} {statement.attribute}"
    return f"{name} {world.shown(stated, stated.value)}, {world.shown(stated, stated.stated)} declared"
