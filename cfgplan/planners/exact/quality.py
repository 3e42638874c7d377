"""How good streams are, in the constraint model.

A value may be worse than the wiring makes it, never better: since every rule is monotone and only
good values are asked for, the solver makes them as good as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import gcd
from typing import Protocol

from ortools.sat.python.cp_model import CpModel, IntVar, LinearExpr, LinearExprT

from cfgplan.domain import Environment, InputPort, Stream, Target
from cfgplan.planners.exact.best_case import range_of_use
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish


class QualityModel(Protocol):
    """What a constraint model must have to know quality."""

    candidates: Candidates
    environment: Environment
    cp: CpModel
    more_costs: list[LinearExprT]

    def ways_to_run(self, unit: int) -> list[IntVar]:
        """Booleans one of which holds if the candidate runs."""


QualityValues = dict[Stream, IntVar]
Choices = Iterable[tuple[Stream, IntVar]]
"""Streams of which one is taken, with the booleans that say which."""


def targets_get_the_quality_they_ask_for(
    model: QualityModel,
    published: Callable[[Target], Choices],
    value_at: Callable[[QualityAttribute, int, InputPort, QualityValues], IntVar],
    cuts: Iterable[ChainCut] = (),
) -> None:
    """Demand the targets' bounds on quality, and add their prices to the cost.

    `published` gives what a target may take, `value_at` a variable for the value at a candidate's input.
    """
    for attribute in model.environment.qualities:
        asked = [
            (target, wish)
            for target in model.environment.targets
            for wish in target.quality
            if wish.attribute == attribute.name
        ]
        if asked:
            scaled = Scaled(model.candidates, attribute)
            values = _values(model, scaled, value_at)
            missed_by = {target.label: _grant(model, scaled, wish, published(target), values) for target, wish in asked}
            mine = [cut for cut in cuts if cut.attribute == attribute.name]
            chains_are_as_bad_as_who_runs_lets_them(model, mine, missed_by, scaled.step)


def chains_are_as_bad_as_who_runs_lets_them(
    model: QualityModel, cuts: Iterable[ChainCut], missed_by: dict[str, IntVar], step: int
) -> None:
    """Add the cuts on chains: implied, but the linear relaxation needs them. `missed_by` of each target is in steps."""
    for cut in cuts:
        terms = [missed_by[cut.target]]
        terms += [
            -(-ahead // step) * runs
            for unit, ahead in zip(cut.units.tolist(), cut.ahead.tolist(), strict=True)
            for runs in model.ways_to_run(unit)
        ]
        model.cp.add(LinearExpr.sum(terms) >= -(-cut.least // step))


class Scaled:
    """An attribute in steps of which all values are multiples: small numbers are what the engine is good at."""

    def __init__(self, candidates: Candidates, attribute: QualityAttribute) -> None:
        transformations = {c.transformation.label: c.transformation for c in candidates.all}.values()
        stated = [
            c for t in transformations for port in t.outputs for c in port.quality if c.attribute == attribute.name
        ]
        is_cut = any(c.rule is QualityRule.SCALE or c.over is Over.MEAN for c in stated)
        self.step = 1 if is_cut else gcd(attribute.worst, attribute.best, *(c.value for c in stated))
        self.attribute = replace(attribute, worst=attribute.worst // self.step, best=attribute.best // self.step)
        self.ranges = {
            stream: (best // self.step, self.at_most(worst))
            for stream, (best, worst) in range_of_use(candidates, attribute).items()
        }

    def at_most(self, value: int) -> int:
        """The worst multiple that is no worse than a value."""
        return value // self.step if self.attribute.better is Better.LOWER else -(-value // self.step)

    def own(self, stated: Contribution) -> int:
        return stated.value if stated.rule is QualityRule.SCALE else stated.value // self.step


def value_of_choice(
    model: QualityModel, attribute: QualityAttribute, choices: Choices, values: QualityValues
) -> IntVar:
    """A variable no better than the value of the stream that is taken."""
    choices = [(stream, taken) for stream, taken in choices if stream in values]
    is_low = attribute.better is Better.LOWER
    ends = [end for stream, _ in choices for end in values[stream].proto.domain]
    value = model.cp.new_int_var(min(ends), max(ends), "") if ends else model.cp.new_constant(attribute.worst)
    for stream, taken in choices:
        model.cp.add(value >= values[stream] if is_low else value <= values[stream]).only_enforce_if(taken)
    if choices:  # implied, but what the linear relaxation needs
        best_of = min if is_low else max
        start = best_of(ends)
        at_best = LinearExpr.sum([(best_of(values[stream].proto.domain) - start) * taken for stream, taken in choices])
        at_best += start
        model.cp.add(value >= at_best if is_low else value <= at_best)
    return value


def _grant(model: QualityModel, scaled: Scaled, wish: Wish, choices: Choices, values: QualityValues) -> IntVar:
    """Demand what a target asks. Returns the variable for what its stream misses the best by, in steps."""
    attribute = scaled.attribute
    missed_by = model.cp.new_int_var(0, abs(attribute.worst - attribute.best), "")
    for stream, published in choices:
        if stream not in values:
            continue
        distance = _badness(attribute, values[stream])
        model.cp.add(missed_by >= distance).only_enforce_if(published)
    known = [(stream, published) for stream, published in choices if stream in values]
    best_of = min if attribute.better is Better.LOWER else max
    at_best = [_badness_of(attribute, best_of(values[s].proto.domain)) * published for s, published in known]
    model.cp.add(missed_by >= LinearExpr.sum(at_best))
    grant(model, scaled, wish, missed_by)
    return missed_by


def grant(model: QualityModel, scaled: Scaled, wish: Wish, missed_by: IntVar) -> None:
    """Demand a wish's bound on `missed_by`, and add its price to the cost."""
    attribute = scaled.attribute
    if wish.bound is not None:
        bound = scaled.at_most(wish.bound)
        model.cp.add(missed_by <= max(0, _badness_of(attribute, bound)))
        if _badness_of(attribute, bound) < 0:
            model.cp.add_bool_or([])
    if wish.weight_us:
        common = gcd(wish.weight_us * scaled.step, MICRO)
        weight, by = wish.weight_us * scaled.step // common, MICRO // common
        price = model.cp.new_int_var(0, -(-weight * abs(attribute.worst - attribute.best) // by), "")
        model.cp.add(by * price >= weight * missed_by)
        model.more_costs.append(price)


def _values(
    model: QualityModel, scaled: Scaled, value_at: Callable[[QualityAttribute, int, InputPort, QualityValues], IntVar]
) -> QualityValues:
    """A variable for the value of each stream that is of use."""
    attribute, ranges = scaled.attribute, scaled.ranges
    values = {stream: model.cp.new_int_var(min(ends), max(ends), "") for stream, ends in ranges.items()}
    for i, candidate in model.candidates.clock.each(enumerate(model.candidates.all)):
        outputs = [port for port in candidate.transformation.outputs if Stream(candidate.id, port.name) in values]
        ordinary = [port for port in candidate.transformation.inputs if not port.feedback] if outputs else []
        inputs = [value_at(attribute, i, port, values) for port in ordinary]
        for port in outputs:
            stated = {c.attribute: c for c in port.quality}.get(attribute.name)
            value = values[Stream(candidate.id, port.name)]
            no_better = _NoBetter(model, attribute, value, ranges[Stream(candidate.id, port.name)][1], i)
            if not inputs:
                no_better.than(attribute.worst if stated is None else scaled.own(stated))
                continue
            theirs = _combined(model, attribute, Over.WORST if stated is None else stated.over, inputs)
            rule, own = (QualityRule.ADD, 0) if stated is None else (stated.rule, scaled.own(stated))
            if rule in (QualityRule.SET, QualityRule.LIMIT):
                no_better.than(own)
            if rule is QualityRule.SCALE:
                common = gcd(own, MICRO)
                no_better.than(own // common * theirs, MICRO // common)
            elif rule is not QualityRule.SET:
                no_better.than(theirs + (own if rule is QualityRule.ADD else 0))
    return values


def _combined(model: QualityModel, attribute: QualityAttribute, over: Over, inputs: Sequence[IntVar]) -> IntVar:
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


@dataclass(frozen=True)
class _NoBetter:
    """Keeps a candidate's value from being better than another; `end` is the worst value that it can have.

    Values worse than the scale count as its worst. If `end` is better than that, the candidate does not run unless its
    value is good enough.
    """

    model: QualityModel
    attribute: QualityAttribute
    value: IntVar
    end: int
    unit: int

    def than(self, other: LinearExprT, by: int = 1) -> None:
        """Demand that the value times `by` is no better than `other`."""
        cp, is_low = self.model.cp, self.attribute.better is Better.LOWER
        no_better = by * self.value >= other if is_low else by * self.value <= other
        if self.end != self.attribute.worst:
            for runs in self.model.ways_to_run(self.unit):
                cp.add(no_better).only_enforce_if(runs)
        else:
            is_worst = cp.new_bool_var("")
            cp.add(self.value == self.attribute.worst).only_enforce_if(is_worst)
            cp.add(no_better).only_enforce_if(is_worst.negated())


def _badness(attribute: QualityAttribute, value: IntVar) -> LinearExprT:
    """By how much a value misses the best."""
    return value - attribute.best if attribute.better is Better.LOWER else attribute.best - value


def _badness_of(attribute: QualityAttribute, value: int) -> int:
    return value - attribute.best if attribute.better is Better.LOWER else attribute.best - value
