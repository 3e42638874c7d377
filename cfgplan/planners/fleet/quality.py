"""How good streams are, in the constraint model.

A value may be worse than the wiring makes it, never better: since every rule is monotone and only
good values are asked for, the solver makes them as good as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import gcd
from typing import Protocol

from ortools.sat.python.cp_model import CpModel, IntVar, LinearExpr, LinearExprT

from cfgplan.domain import Environment, InputPort, Stream, Target
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.qualities import MICRO, Better, Over, QualityAttribute, Rule, Wish


class Model(Protocol):
    """What a constraint model must have to know quality."""

    candidates: Candidates
    environment: Environment
    cp: CpModel
    more_costs: list[LinearExprT]


Values = dict[Stream, IntVar]
Choices = Iterable[tuple[Stream, IntVar]]
"""Streams of which one is taken, with the booleans that say which."""


def targets_get_the_quality_they_ask_for(
    model: Model,
    published: Callable[[Target], Choices],
    value_at: Callable[[QualityAttribute, int, InputPort, Values], IntVar],
) -> None:
    """Bounds are met; prices are added to the cost.

    `published` says what a target may take, `value_at` gives a variable for the value at a candidate's input.
    """
    for attribute in model.environment.qualities:
        asked = [
            (target, wish)
            for target in model.environment.targets
            for wish in target.quality
            if wish.attribute == attribute.name
        ]
        if asked:
            values = _values(model, attribute, value_at)
            for target, wish in asked:
                _grant(model, attribute, wish, published(target), values)


def value_of_choice(model: Model, attribute: QualityAttribute, choices: Choices, values: Values) -> IntVar:
    """A variable no better than the value of the stream taken."""
    low, high = sorted((attribute.worst, attribute.best))
    value = model.cp.new_int_var(low, high, "")
    for stream, taken in choices:
        is_low = attribute.better is Better.LOWER
        model.cp.add(value >= values[stream] if is_low else value <= values[stream]).only_enforce_if(taken)
    return value


def _grant(model: Model, attribute: QualityAttribute, wish: Wish, choices: Choices, values: Values) -> None:
    missed_by = model.cp.new_int_var(0, abs(attribute.worst - attribute.best), "")
    for stream, published in choices:
        distance = _badness(attribute, values[stream])
        model.cp.add(missed_by >= distance).only_enforce_if(published)
    if wish.bound is not None:
        model.cp.add(missed_by <= max(0, _badness_of(attribute, wish.bound)))
        if _badness_of(attribute, wish.bound) < 0:
            model.cp.add_bool_or([])
    if wish.weight_us:
        common = gcd(wish.weight_us, MICRO)
        weight, by = wish.weight_us // common, MICRO // common
        price = model.cp.new_int_var(0, -(-weight * abs(attribute.worst - attribute.best) // by), "")
        model.cp.add(by * price >= weight * missed_by)
        model.more_costs.append(price)


def _values(
    model: Model,
    attribute: QualityAttribute,
    value_at: Callable[[QualityAttribute, int, InputPort, Values], IntVar],
) -> Values:
    """A variable for the value of each candidate's streams."""
    low, high = sorted((attribute.worst, attribute.best))
    running = [(i, candidate) for i, candidate in enumerate(model.candidates.all) if candidate.may_run]
    values = {
        Stream(candidate.id, port.name): model.cp.new_int_var(low, high, "")
        for _, candidate in running
        for port in candidate.transformation.outputs
    }
    for i, candidate in running:
        inputs = [value_at(attribute, i, port, values) for port in candidate.transformation.inputs if not port.feedback]
        for port in candidate.transformation.outputs:
            stated = {c.attribute: c for c in port.quality}.get(attribute.name)
            value = values[Stream(candidate.id, port.name)]
            if not inputs:
                _no_better(model, attribute, value, attribute.worst if stated is None else stated.value)
                continue
            theirs = _combined(model, attribute, Over.WORST if stated is None else stated.over, inputs)
            rule, own = (Rule.ADD, 0) if stated is None else (stated.rule, stated.value)
            if rule in (Rule.SET, Rule.LIMIT):
                _no_better(model, attribute, value, own)
            if rule is Rule.SCALE:
                common = gcd(own, MICRO)
                _no_better(model, attribute, value, own // common * theirs, MICRO // common)
            elif rule is not Rule.SET:
                _no_better(model, attribute, value, theirs + (own if rule is Rule.ADD else 0))
    return values


def _combined(model: Model, attribute: QualityAttribute, over: Over, inputs: Sequence[IntVar]) -> IntVar:
    if len(inputs) == 1:
        return inputs[0]
    result = model.cp.new_int_var(0, max(attribute.worst, attribute.best) * len(inputs), "")
    is_low = attribute.better is Better.LOWER
    match over:
        case Over.WORST:
            for value in inputs:
                model.cp.add(result >= value if is_low else result <= value)
        case Over.BEST if is_low:
            model.cp.add_min_equality(result, inputs)
        case Over.BEST:
            model.cp.add_max_equality(result, inputs)
        case Over.MEAN:
            total = LinearExpr.sum(list(inputs))
            model.cp.add(len(inputs) * result >= total if is_low else len(inputs) * result <= total)
        case Over.SUM:
            model.cp.add(result == LinearExpr.sum(list(inputs)))
    return result


def _no_better(model: Model, attribute: QualityAttribute, value: IntVar, than: LinearExprT, by: int = 1) -> None:
    """`value` times `by` is not better than `than`, unless it is as bad as can be."""
    is_worst = model.cp.new_bool_var("")
    model.cp.add(value == attribute.worst).only_enforce_if(is_worst)
    is_low = attribute.better is Better.LOWER
    model.cp.add(by * value >= than if is_low else by * value <= than).only_enforce_if(is_worst.negated())


def _badness(attribute: QualityAttribute, value: IntVar) -> LinearExprT:
    """By how much a value misses the best."""
    return value - attribute.best if attribute.better is Better.LOWER else attribute.best - value


def _badness_of(attribute: QualityAttribute, value: int) -> int:
    return value - attribute.best if attribute.better is Better.LOWER else attribute.best - value
