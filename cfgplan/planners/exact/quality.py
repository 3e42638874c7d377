"""How good streams are, in the constraint model.

A value may be worse than the wiring makes it, never better: since every rule is monotone and only
good values are asked for, the solver makes them as good as they are. Only where a stream is chosen there is a variable.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import gcd

from ortools.sat.python.cp_model import IntVar, LinearExpr, LinearExprT, LiteralT

from cfgplan.domain import InputPort, Stream
from cfgplan.planners.exact.best_case import best_values, worst_of_use
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.planning import Notion
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish


def targets_get_the_quality_they_ask_for(model: Model) -> None:
    """Targets' bounds on quality are kept, and their prices are a part of the cost."""
    for attribute in model.environment.qualities:
        asked = [
            (target, wish)
            for target in model.environment.targets
            for wish in target.quality
            if wish.attribute == attribute.name
        ]
        if asked:
            values = _Values(model, attribute)
            for target, wish in asked:
                value = values.of_choice(target.label, target.tag, model.publishes[target.label])
                missed_by = _badness(values.scaled.attribute, value)
                _grant(model, values.scaled, wish, missed_by)
                model.missed_by[target.label, attribute.name] = missed_by, values.scaled.step
            values.follow_rules()


def chains_are_as_bad_as_who_runs_lets_them(model: Model, cuts: Iterable[ChainCut]) -> None:
    """Add the cuts on chains: implied, but the linear relaxation needs them."""
    index_of = model.candidates.index_of
    for cut in cuts:
        missed_by, step = model.missed_by[cut.target, cut.attribute]
        ahead = {index_of[unit]: by for unit, by in cut.ahead.items() if unit in index_of}
        terms = [-(-by // step) * model.runs[i] for i, by in ahead.items() if i in model.runs]
        model.cp.add(LinearExpr.sum([missed_by, *terms]) >= -(-cut.least // step))


class Scaled:
    """An attribute in steps of which all values are multiples: small numbers are what the engine is good at."""

    def __init__(self, candidates: Candidates, attribute: QualityAttribute) -> None:
        transformations = {c.transformation.label: c.transformation for c in candidates.all}.values()
        stated = [
            c for t in transformations for port in t.outputs for c in port.quality if c.attribute == attribute.name
        ]
        is_cut = any(c.rule is QualityRule.SCALE or c.over is Over.MEAN for c in stated)
        late = [link.latency for link in candidates.environment.links if link.adds == attribute.name]
        self.step = 1 if is_cut else gcd(attribute.worst, attribute.best, *(c.value for c in stated), *late)
        self.attribute = replace(attribute, worst=attribute.worst // self.step, best=attribute.best // self.step)
        self.best = {stream: value // self.step for stream, value in best_values(candidates, attribute).items()}

    def at_most(self, value: int) -> int:
        """The worst multiple that is no worse than a value."""
        return value // self.step if self.attribute.better is Better.LOWER else -(-value // self.step)

    def own(self, stated: Contribution) -> int:
        return stated.value if stated.rule is QualityRule.SCALE else stated.value // self.step


class _Values:
    """Variables for the values of an attribute where a stream is chosen: at targets, at inputs told apart, in hubs."""

    def __init__(self, model: Model, attribute: QualityAttribute) -> None:
        self.model, self.scaled = model, Scaled(model.candidates, attribute)
        self.attribute = self.scaled.attribute
        self._is_low = attribute.better is Better.LOWER
        self._of: dict[Hashable, IntVar] = {}
        self._choices: list[tuple[Hashable, IntVar, Mapping[Stream, IntVar]]] = []
        self._worst: dict[int, int] = {}
        """The worst value at which a demand is of use to anybody; spares may get any quality."""
        allowed = worst_of_use(model.candidates, attribute) if Notion.SURVIVAL not in model.problem.notions else {}
        for tag, value in allowed.items():
            worst = self.scaled.at_most(value)
            self._worst[model.demand(tag)] = self._worse(worst, self._worst.get(model.demand(tag), worst))

    def _worse(self, *values: int) -> int:
        return max(values) if self._is_low else min(values)

    def _better(self, *values: int) -> int:
        return min(values) if self._is_low else max(values)

    def of_choice(self, where: Hashable, tag: str, choices: Mapping[Stream, IntVar]) -> IntVar:
        """A variable no better than the value of the stream that is taken for a demand."""
        if where not in self._of:
            known = {stream: taken for stream, taken in choices.items() if stream in self.scaled.best}
            worst = self._worst.get(self.model.demand(tag), self.attribute.worst)
            best = self._better(worst, *(self.scaled.best[stream] for stream in known))
            self._of[where] = self.model.cp.new_int_var(min(best, worst), max(best, worst), "")
            self._choices.append((where, self._of[where], known))
        return self._of[where]

    def follow_rules(self) -> None:
        """Let each variable be what the rules of the streams make of their inputs, which get variables too."""
        for where, value, choices in self.model.candidates.clock.each(self._choices):
            self._is_no_better_than_what_is_taken(where, value, choices)

    def _is_no_better_than_what_is_taken(
        self, where: Hashable, value: IntVar, choices: Mapping[Stream, IntVar]
    ) -> None:
        cp, ends = self.model.cp, list(value.proto.domain)
        start, worst = self._better(*ends), self._worse(*ends)
        held: list[LiteralT] = []
        if worst == self.attribute.worst:  # what is worse than the scale counts as its worst
            is_worst = cp.new_bool_var("")
            cp.add(value == worst).only_enforce_if(is_worst)
            held.append(is_worst.negated())
        terms: list[LinearExprT] = [start]
        for stream, taken in choices.items():
            best = self.scaled.best[stream]
            if self._worse(best, worst) != worst:
                cp.add_bool_or([taken.negated()])
                continue
            terms.append((best - start) * taken)
            delay = self._delay(where, stream)
            if delay is not None:
                cp.add(value - delay >= best).only_enforce_if([taken, *held])
            sent = value if delay is None else value - delay
            for other, by in self._made(stream):
                no_better = by * sent >= other if self._is_low else by * sent <= other
                cp.add(no_better).only_enforce_if([taken, *held])
        at_best = LinearExpr.sum(terms)  # implied, but what the linear relaxation needs
        cp.add(value >= at_best if self._is_low else value <= at_best)

    def _delay(self, where: Hashable, stream: Stream) -> IntVar | None:
        """What links add to a stream's value on its way to a target or an input told apart; None if they do not."""
        model, made_on = self.model, self.model.runs_on[self.model.unit_of(stream)]
        if Notion.LATENCY not in model.problem.notions:
            return None
        wanted: Mapping[HostName, list[IntVar]] = {}
        if isinstance(where, str):
            wanted = {model.environment.target[where].host: []}
        elif isinstance(where, tuple) and where[0] == "input":
            wanted = {host: [on] for host, on in model.runs_on[where[1]].items()}
        latency = partial(model.environment.latency, self.attribute.name)
        late = {(one, other): latency(one, other) // self.scaled.step for one in made_on for other in wanted}
        if not any(late.values()):
            return None
        delay = model.cp.new_int_var(0, max(late.values()), "")
        for (one, other), by in late.items():
            model.cp.add(delay >= by).only_enforce_if([made_on[one], *wanted[other]])
        return delay

    def _made(self, stream: Stream) -> Iterable[tuple[LinearExprT, int]]:
        """What a stream's value times a number is no better than."""
        unit = self.model.unit_of(stream)
        transformation = self.model.candidates.all[unit].transformation
        stated = {c.attribute: c for c in transformation.output[stream.port].quality}.get(self.attribute.name)
        own = 0 if stated is None else self.scaled.own(stated)
        ordinary = [port for port in transformation.inputs if not port.feedback]
        if not ordinary:
            yield self.attribute.worst if stated is None else own, 1
            return
        rule = QualityRule.ADD if stated is None else stated.rule
        if rule in (QualityRule.SET, QualityRule.LIMIT):
            yield own, 1
        if rule is QualityRule.SET:
            return
        inputs = list({value.index: value for value in (self._at(unit, port) for port in ordinary)}.values())
        if stated is not None and stated.over is not Over.WORST:
            inputs = [self._combined(unit, stated.over, [self._at(unit, port) for port in ordinary])]
        for theirs in inputs:
            if rule is QualityRule.SCALE:
                common = gcd(own, MICRO)
                yield own // common * theirs, MICRO // common
            else:
                yield theirs + (own if rule is QualityRule.ADD else 0), 1

    def _at(self, unit: int, port: InputPort) -> IntVar:
        """The value at a candidate's input."""
        model, where = self.model, ("input", unit, port.name)
        if (unit, port.name) in model.connects:
            return self.of_choice(where, port.tag, model.connects[unit, port.name])
        if where not in self._of:
            keys = [(wired, model.hub_key(port.tag, host)) for host, wired in model.wired_on(unit).items()]
            met = [(wired, self.of_choice(key, port.tag, model.meets[key])) for wired, key in keys]
            running = model.candidates.all[unit].running
            kept = running.feeds[port.name][0] if unit in model.stays and running is not None else None
            if len({value.index for _, value in met}) == 1 and kept is None:
                self._of[where] = met[0][1]
                return met[0][1]
            low, high = sorted((self.attribute.worst, self.attribute.best))
            value = self._of[where] = model.cp.new_int_var(low, high, "")
            if kept is not None:
                known = {kept: model.stays[unit]} if kept in self.scaled.best else {}
                self._choices.append((where, value, known))
            for wired, theirs in met:
                model.cp.add(value >= theirs if self._is_low else value <= theirs).only_enforce_if(wired)
        return self._of[where]

    def _combined(self, unit: int, over: Over, inputs: Sequence[IntVar]) -> IntVar:
        where = ("combined", unit, over)
        if len(inputs) == 1:
            return inputs[0]
        if where not in self._of:
            self._of[where] = _combined(self.model, self.attribute, over, inputs)
        return self._of[where]


def _grant(model: Model, scaled: Scaled, wish: Wish, missed_by: LinearExprT) -> None:
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


def _combined(model: Model, attribute: QualityAttribute, over: Over, inputs: Sequence[IntVar]) -> IntVar:
    result = model.cp.new_int_var(0, max(attribute.worst, attribute.best) * len(inputs), "")
    is_low = attribute.better is Better.LOWER
    match over:
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


def _badness(attribute: QualityAttribute, value: IntVar) -> LinearExprT:
    """By how much a value misses the best."""
    return value - attribute.best if attribute.better is Better.LOWER else attribute.best - value


def _badness_of(attribute: QualityAttribute, value: int) -> int:
    return value - attribute.best if attribute.better is Better.LOWER else attribute.best - value
