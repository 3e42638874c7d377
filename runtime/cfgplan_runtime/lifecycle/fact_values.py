"""How facts of the world get their values in a run: by request, by the streams that observe them, by silence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from cfgplan.domain import Environment
from cfgplan.errors import InputError, InvalidValueError, known
from cfgplan.facts import FactValue, kind_of, said
from cfgplan.noise import NoisyMean
from cfgplan_runtime.lifecycle.inbox import Asked, Outcome
from cfgplan_runtime.lifecycle.perturbations import FactsChanged
from cfgplan_runtime.lifecycle.reports import FactSilent
from cfgplan_runtime.lifecycle.state import Heard
from cfgplan_runtime.lifecycle.turns import Respond, Tell, Turn


def fact_set(turn: Turn, name: str, value: str, request: Asked) -> Turn:
    """A fact has a value by request, until a stream says another. A review is due only if other units may run now."""
    state, facts = turn.state, turn.state.scene.world.environment.fact
    known(name, facts, "fact")
    try:
        values = {**state.situation.facts, name: facts[name].read(value)}
    except InvalidValueError as error:
        raise InputError.of(str(error)) from None
    heard = {other: last for other, last in state.heard.items() if other != name}
    return _with_facts(turn.to(replace(state, heard=heard)), values, (request.outcome,))


def fact_seen(turn: Turn, name: str, value: FactValue) -> Turn:
    """A stream says the value of a fact. Values of facts that are gone, or of another kind now, are ignored."""
    state, fact = turn.state, turn.state.living.world.environment.fact.get(name)
    if fact is None or fact.observed_on is None or kind_of(value) != kind_of(fact.declared):
        return turn
    mean = None
    if fact.noise is not None and isinstance(value, int):
        known_mean = state.heard[name].mean if name in state.heard else None
        mean = NoisyMean(value, turn.at_s) if known_mean is None else known_mean.after(value, turn.at_s)
        before = fact.being(state.situation.facts.get(name)).value
        assert isinstance(before, int)
        value = mean.told(fact.noise, before, state.living.world.environment.bounds.get(name, ()))
    turn = turn.to(replace(state, heard={**state.heard, name: Heard(turn.at_s, mean)}))
    return _with_facts(turn, {**state.situation.facts, name: value})


def facts_fallen_silent(turn: Turn) -> Turn:
    """Let the declared values count again of the facts that have been silent for too long."""
    state = turn.state
    gone = [name for name, at_s in state.silences_of_facts.items() if at_s <= turn.at_s]
    if not gone:
        return turn
    facts = state.living.world.environment.fact
    told = [FactSilent(name, turn.at_s - state.heard[name].at_s, said(facts[name].declared)) for name in gone]
    heard = {name: last for name, last in state.heard.items() if name not in gone}
    values = {name: value for name, value in state.situation.facts.items() if name not in gone}
    return _with_facts(turn.to(replace(state, heard=heard)).also(*map(Tell, told)), values)


def _with_facts(turn: Turn, values: Mapping[str, FactValue], outcomes: Iterable[Outcome] = ()) -> Turn:
    """Let facts have these values: a review is due only if other transformations may run now."""
    state, declared = turn.state, turn.state.living.world.environment
    turn = turn.situated(replace(state.situation, facts=values))
    if not _sides_differ(declared, state.situation.facts, values):
        return turn.also(*(Respond(outcome) for outcome in outcomes))
    before = state.scene.world.environment
    was, now = before.left_out.keys(), turn.state.scene.world.environment.left_out.keys()
    if was == now:
        return turn.also(*(Respond(outcome) for outcome in outcomes))
    return turn.perturbed(FactsChanged(tuple(sorted(now - was)), tuple(sorted(was - now))), outcomes)


def _sides_differ(world: Environment, old: Mapping[str, FactValue], new: Mapping[str, FactValue]) -> bool:
    """Whether a comparison of some `requires` is true of one of two sets of values only."""
    names = (name for name in old.keys() | new.keys() if old.get(name) != new.get(name) and name in world.fact)
    facts = (world.fact[name] for name in names)
    return any(
        comparison.holds(fact.being(old.get(fact.name)).value) != comparison.holds(fact.being(new.get(fact.name)).value)
        for fact in facts
        for comparison in world.comparisons.get(fact.name, ())
    )
