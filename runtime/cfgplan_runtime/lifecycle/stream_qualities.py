"""Learn the qualities of transformations from the qualities that their streams say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import Final

from cfgplan.domain import Environment, Statement
from cfgplan.observed import TEACHES_S, Lesson, learned, own_part, planned_deviations
from cfgplan.validity.quality import quality_violations
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.perturbations import QualitiesObserved
from cfgplan_runtime.lifecycle.reports import Decision, QualityView
from cfgplan_runtime.lifecycle.state import State
from cfgplan_runtime.lifecycle.transitions import Transition
from cfgplan_runtime.streams.measured_stream import Quality
from cfgplan_runtime.supervision.delays import doubling_s

FIRST_CALM_S: Final = 4.0
LONGEST_CALM_S: Final = 16.0
"""After a review of qualities that changed nothing, the next one waits: first 4 s, then twice as long each time.
A plan that would be cheaper comes later by this at most; experiments/observed/drifting.py shows what it costs.
"""


def quality_told(transition: Transition, statement: Statement, value: float) -> Transition:
    """Take in the quality that a topic tells of an output, for all running units of its transformation."""
    seen = transition.state.seen
    for unit in transition.state.running.units:
        if unit.transformation == statement.transformation and not unit.standby:
            said = {statement.output: {statement.attribute: Quality(1, value, 0.0)}}
            seen = seen.after_said(unit.id, said, transition.at_s)
    return transition.to(replace(transition.state, seen=seen))


def qualities_learned(transition: Transition) -> Transition:
    """Learn from the qualities that streams have said. A significant change makes a review due."""
    if not transition.state.seen.is_new:
        return transition
    transition, running, lesson = _taught(transition, ends_look=False)
    state, at_s, world = transition.state, transition.at_s, _world_now(transition.state)
    if any(stream.unit in state.looks.units for stream, _ in lesson.news):
        state = replace(state, looks=state.looks.ending(state.running, state.seen, at_s))
        transition = transition.to(state)
    before = state.situation.qualities  # a slow drift is never news: it is confirmed little by little
    now = planned_deviations(world, lesson.estimates, before, at_s, only_sure=not lesson.news)
    waits = at_s < (state.looks.until_s if state.looks.units else _calm_until_s(state))
    if now == before or (waits and not _bounds_are_crossed(transition, running, now)):
        return transition
    return _planned_with(transition, now)


def look_learned(transition: Transition) -> Transition:
    """Learn from all that the streams of a look have said; the review at its end plans with all present estimates."""
    transition, _, lesson = _taught(transition, ends_look=True)
    before, world = transition.state.situation.qualities, _world_now(transition.state)
    now = planned_deviations(world, lesson.estimates, before, transition.at_s)
    return transition if now == before else _planned_with(transition, now)


def _planned_with(transition: Transition, now: Mapping[Statement, int]) -> Transition:
    """Plan with these deviations from now on, and report the qualities that have changed."""
    situation, before = transition.state.situation, transition.state.situation.qualities
    said_now = _world_now(transition.state).with_qualities(now).qualities_now
    changed = sorted((one for one in now.keys() | before.keys() if now.get(one) != before.get(one)), key=str)
    outputs = tuple(f"{one} {said_now.get(str(one), 'as declared')}" for one in changed)
    return transition.situated(replace(situation, qualities=now)).perturbed(QualitiesObserved(outputs))


def _world_now(state: State) -> Environment:
    """The environment with the present facts and the stated qualities."""
    return state.version.world.environment.with_facts(state.situation.facts)


def _taught(transition: Transition, *, ends_look: bool) -> tuple[Transition, Environment, Lesson]:
    """Learn from the running streams. Return also the environment of the running units, and the lesson.

    A stream confirms estimates once in TEACHES_S. A stream of a look does so at the end of the look, with all that it
    has said.
    """
    state, at_s, world = transition.state, transition.at_s, _world_now(transition.state)
    seen, looked_at = state.seen, state.looks.units
    units = (unit for unit in state.running.units if not unit.standby and (unit.host is None) is (not world.hosts))
    running = replace(world, units=tuple(units), targets=())
    samples = {said: sample for said, window in seen.windows.items() if (sample := window.sample) is not None}
    due = {said for said in samples if at_s - seen.taught_s.get(said, -TEACHES_S) >= TEACHES_S}
    fresh = frozenset(said for said in samples if (ends_look if said[0].unit in looked_at else said in due))
    lesson = learned(running, samples, seen.estimates, at_s, fresh=fresh)
    return transition.to(replace(state, seen=seen.after_lesson(lesson, fresh, at_s))), running, lesson


def _calm_until_s(state: State) -> float:
    """Until when only a crossed bound is a reason for another review of qualities: the last ones changed nothing."""
    idle = 0
    for review in reversed(state.reviews):
        if review.decision is Decision.APPLIED or {*map(type, review.perturbations)} != {QualitiesObserved}:
            break
        idle += 1
    return state.reviews[-1].at_s + doubling_s(idle + 1, FIRST_CALM_S, LONGEST_CALM_S) if idle else -inf


def _bounds_are_crossed(transition: Transition, running: Environment, now: Mapping[Statement, int]) -> bool:
    """Whether running streams meet other bounds of targets with the qualities known now than with those used so far."""
    running = replace(running, targets=transition.state.version.world.environment.targets)
    used, known = (running.with_qualities(seen) for seen in (transition.state.situation.qualities, now))
    return _missed(used) != _missed(known)


def _missed(environment: Environment) -> set[str | None]:
    return {violation.target for violation in quality_violations(environment)}


def qualities_faded(transition: Transition) -> Transition:
    """Use the faded estimates of streams that were not observed for long in the next plan, if no look can observe
    them.
    """
    state, situation = transition.state, transition.state.situation
    if not state.seen.estimates:
        return transition
    world = state.version.world.environment.with_facts(situation.facts)
    is_blind, impossible = state.policy.look_every_s is None, state.looks.impossible

    def fades(one: Statement) -> bool:
        return is_blind or Place(one.transformation, one.host) in impossible

    now = planned_deviations(world, state.seen.estimates, situation.qualities, transition.at_s, fades=fades)
    return transition.situated(replace(situation, qualities=now))


def qualities_restated(transition: Transition, before: Environment) -> Transition:
    """Forget the deviations of outputs whose stated quality has changed: they were learned relative to the old one."""
    state, now = transition.state, transition.state.version.world.environment

    def is_as_before(one: Statement) -> bool:
        is_same_scale = now.quality.get(one.attribute) == before.quality.get(one.attribute)
        is_same_place = (one.host is None) is (not now.hosts)
        return is_same_scale and is_same_place and now.stated(one) == before.stated(one)

    known, told_now = state.seen.estimates, state.situation.qualities
    if all(map(is_as_before, known)):
        return transition
    estimates = {one: estimate for one, estimate in known.items() if is_as_before(one)}
    qualities = {one: seen for one, seen in told_now.items() if is_as_before(one)}
    transition = transition.to(replace(state, seen=replace(state.seen, estimates=estimates)))
    return transition.situated(replace(state.situation, qualities=qualities))


def quality_views(world: Environment, state: State, at_s: float) -> tuple[QualityView, ...]:
    """Return the learned quality of each output of a world with stated qualities, sorted by name."""
    found = []
    for statement in sorted(state.seen.estimates, key=str):
        stated, known = world.stated(statement), state.seen.estimates[statement]
        if stated is not None:
            value, error = own_part(stated, known, at_s)
            planned = stated.taught({None: state.situation.qualities.get(statement, 0)}).value
            ago_s = max(0.0, at_s - known.seen_s)
            found.append(QualityView(*statement, stated.stated, planned, round(value), round(error), ago_s))
    return tuple(found)
