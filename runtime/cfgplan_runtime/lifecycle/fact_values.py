"""How facts get their values in a run: by request, by the streams that observe them, by silence."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Final

from cfgplan.domain import Environment
from cfgplan.errors import InputError, InvalidValueError, known
from cfgplan.facts import Fact, FactValue, kind_of, value_text
from cfgplan.noise import NoisyMean
from cfgplan_runtime.lifecycle.inbox import Asked, Outcome
from cfgplan_runtime.lifecycle.perturbations import FactsChanged
from cfgplan_runtime.lifecycle.reports import FactSilent
from cfgplan_runtime.lifecycle.seen_qualities import SeenQualities
from cfgplan_runtime.lifecycle.state import Heard, State
from cfgplan_runtime.lifecycle.transitions import Respond, Tell, Transition

NEWS: Final = Fraction(1, 20)
"""A stream has to change a quality that follows its fact by this share of it; less is no reason for a review."""


def fact_set(transition: Transition, name: str, value: str, request: Asked) -> Transition:
    """Set a fact by request, until a stream says another value. A review is due only if other units may run now."""
    state, facts = transition.state, transition.state.plan_input.world.environment.variable
    known(name, facts, "fact", None if facts else "declare it under `facts:` in the environment file")
    try:
        values = {**state.situation.facts, name: facts[name].read(value)}
    except InvalidValueError as error:
        raise InputError.of(str(error)) from None
    heard = {other: last for other, last in state.heard.items() if other != name}
    return _with_facts(transition.to(replace(state, heard=heard)), values, (request.outcome,))


def fact_seen(transition: Transition, name: str, value: FactValue) -> Transition:
    """Take in a fact's value from a stream. Values of facts that are gone, or of another kind now, are ignored."""
    state, world = transition.state, transition.state.version.world.environment
    fact = world.variable.get(name)
    if fact is None or fact.observed_on is None or kind_of(value) != kind_of(fact.declared):
        return transition
    mean, band, known_value = None, 0.0, fact.being(state.situation.facts.get(name)).value
    if fact.noise is not None and isinstance(value, int):
        assert isinstance(known_value, int)
        known_mean = state.heard[name].mean if name in state.heard else None
        mean = known_mean or NoisyMean(known_value, transition.at_s)
        mean = mean.after(value, transition.at_s, fact.noise)
        value = mean.planned_value(fact.noise, known_value, world.bounds.get(fact.name, ()))
        band = fact.noise.band(value, mean.variance)
    if fact.name in world.curves and not _is_news(world, fact, known_value, value, band):
        value = known_value
    transition = transition.to(replace(state, heard={**state.heard, name: Heard(transition.at_s, mean)}))
    return _with_facts(transition, {**state.situation.facts, name: value})


def facts_fallen_silent(transition: Transition) -> Transition:
    """Return facts that have been silent for too long to their declared values."""
    state = transition.state
    gone = [name for name, at_s in state.silences_of_facts.items() if at_s <= transition.at_s]
    if not gone:
        return transition
    facts = state.version.world.environment.variable
    reports = [
        FactSilent(name, transition.at_s - state.heard[name].at_s, value_text(facts[name].declared)) for name in gone
    ]
    heard = {name: last for name, last in state.heard.items() if name not in gone}
    values = {name: value for name, value in state.situation.facts.items() if name not in gone}
    return _with_facts(transition.to(replace(state, heard=heard)).also(*map(Tell, reports)), values)


def _with_facts(
    transition: Transition, values: Mapping[str, FactValue], outcomes: Iterable[Outcome] = ()
) -> Transition:
    """Let facts have these values: a review is due only if other transformations may run now."""
    state, declared = transition.state, transition.state.version.world.environment
    transition = transition.situated(replace(state.situation, facts=values))
    if not any(_is_other(declared, fact, state.situation.facts, values) for fact in declared.variable.values()):
        return transition.also(*(Respond(outcome) for outcome in outcomes))
    before, after = state.plan_input.world.environment, transition.state.plan_input.world.environment
    lost, back = _newly_barred(before, after), _newly_barred(after, before)
    library = before.transformation
    requalified = [label for label in after.following if after.transformation[label] != library[label]]
    if not (lost or back or requalified):
        return transition.also(*(Respond(outcome) for outcome in outcomes))
    transition = transition.to(replace(transition.state, seen=_unheard(transition.state, requalified)))
    changed = FactsChanged(tuple(sorted(lost)), tuple(sorted(back)), tuple(sorted(requalified)))
    return transition.perturbed(changed, outcomes)


def _newly_barred(before: Environment, after: Environment) -> set[str]:
    """Return the transformations that may run in `before` and not in `after`. `mapper on r1` is one that this concerns
    only on a host.
    """
    found = after.left_out.keys() - before.left_out.keys()
    for label, hosts in after.barred.items():
        if label not in before.left_out:
            found |= {f"{label} on {host}" for host in hosts.keys() - before.barred.get(label, {}).keys()}
    return found


def _unheard(state: State, requalified: Collection[str]) -> SeenQualities:
    """What streams have said, without those of some transformations and behind them: they were otherwise."""
    running, seen = state.running, state.seen
    behind = {unit.id for unit in running.units if unit.transformation in requalified}
    while more := {
        unit.id
        for unit in running.units
        if unit.id not in behind and any(one.stream.unit in behind for one in unit.subscriptions)
    }:
        behind |= more
    for unit in behind:
        seen = seen.without(unit)
    return seen


def _is_other(world: Environment, fact: Fact, old: Mapping[str, FactValue], new: Mapping[str, FactValue]) -> bool:
    """Whether a comparison of some `requires`, or a quality that follows a fact, tells two of its values apart."""
    before, after = fact.being(old.get(fact.key)).value, fact.being(new.get(fact.key)).value
    return before != after and (
        _sides(world, fact, before) != _sides(world, fact, after) or _followers(world, fact, before, after) != []
    )


def _is_news(world: Environment, fact: Fact, before: FactValue, after: FactValue, band: float) -> bool:
    """Whether a value that a stream says changes a comparison, or a quality by NEWS and for sure, in spite of noise."""
    if _sides(world, fact, before) != _sides(world, fact, after):
        return True
    if isinstance(before, str) or isinstance(after, str) or abs(after - before) <= band:
        return False
    return any(abs(new - old) > NEWS * abs(old) for old, new in _followers(world, fact, before, after))


def _sides(world: Environment, fact: Fact, value: FactValue) -> list[bool]:
    return [comparison.holds(value) for comparison in world.comparisons.get(fact.name, ())]


def _followers(world: Environment, fact: Fact, before: FactValue, after: FactValue) -> list[tuple[int, int]]:
    """The qualities that follow a fact and differ for two of its values."""
    if isinstance(before, bool | str) or isinstance(after, bool | str):
        return []
    values = ((curve.at(before), curve.at(after)) for curve in world.curves.get(fact.name, ()))
    return [(old, new) for old, new in values if old != new]
