"""How bad streams are, in the constraint model: by how much they miss the best, in steps.

A stream may count as worse than the wiring makes it, never as better: since every rule is monotone and only good
streams are asked for, the solver makes them as good as they are. Only where a stream is chosen there is a variable.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import partial
from math import gcd

from ortools.sat.python.cp_model import IntVar, LinearExpr, LinearExprT, LiteralT

from cfgplan.domain import InputPort, Stream
from cfgplan.planners.exact.best_case import Making, least_badness, most_badness
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.planning import Feature
from cfgplan.qualities import MICRO, Over, QualityAttribute, QualityRule, Wish


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
            badness = _Badness(model, attribute)
            for target, wish in asked:
                missed_by = badness.of_choice(target.label, target.tag, model.publishes[target.label])
                badness.grant(wish, missed_by)
                model.missed_by[target.label, attribute.name] = missed_by, badness.step
            badness.follow_rules()


def chains_are_as_bad_as_who_runs_lets_them(model: Model, cuts: Iterable[ChainCut]) -> None:
    """Add the cuts on chains: implied, but the linear relaxation needs them."""
    index_of = model.candidates.index_of
    for cut in cuts:
        missed_by, step = model.missed_by[cut.target, cut.attribute]
        ahead = {index_of[unit]: by for unit, by in cut.ahead.items() if unit in index_of}
        terms = [-(-by // step) * model.runs[i] for i, by in ahead.items() if i in model.runs]
        model.cp.add(LinearExpr.sum([missed_by, *terms]) >= -(-cut.least // step))


def _step(candidates: Candidates, attribute: QualityAttribute) -> int:
    """Return a number of which all badness is a multiple: small numbers are what the engine is good at.

    It is 1 where all badness is 0, as on a scale whose worst is its best.
    """
    outputs = [port for t in candidates.kinds.values() for port in t.outputs]
    stated = [c for port in outputs for c in port.quality if c.attribute == attribute.name]
    is_cut = any(c.rule is QualityRule.SCALE or c.over is Over.MEAN for c in stated)
    late = [link.latency for link in candidates.environment.links if link.adds == attribute.name]
    return 1 if is_cut else max(1, gcd(attribute.worst, attribute.best, *(c.value for c in stated), *late))


class _Badness:
    """Variables of an attribute where a stream is chosen: at targets, at inputs told apart, in hubs."""

    def __init__(self, model: Model, attribute: QualityAttribute) -> None:
        self.model, self.attribute = model, attribute
        self.step = _step(model.candidates, attribute)
        self._scale = attribute.scale // self.step
        self._least = {stream: bad // self.step for stream, bad in least_badness(model.candidates, attribute).items()}
        self._of: dict[Hashable, IntVar] = {}
        self._together: dict[tuple[int, Over], tuple[LinearExprT, list[LiteralT]]] = {}
        self._choices: list[tuple[Hashable, IntVar, Mapping[Stream, IntVar]]] = []
        self._most: dict[int, int] = {}
        """The badness up to which a stream for a demand is of use to anybody; spares may get any quality."""
        of_use = most_badness(model.candidates, attribute) if Feature.SURVIVAL not in model.problem.features else {}
        for tag, most in of_use.items():
            demand = model.demand(tag)
            self._most[demand] = max(most // self.step, self._most.get(demand, 0))

    def of_choice(self, where: Hashable, tag: str, choices: Mapping[Stream, IntVar]) -> IntVar:
        """A variable no better than the stream that is taken for a demand."""
        if where not in self._of:
            known = {stream: taken for stream, taken in choices.items() if stream in self._least}
            most = self._most.get(self.model.demand(tag), self._scale)
            least = min([most, *(self._least[stream] for stream in known)])
            self._of[where] = self.model.cp.new_int_var(least, most, "")
            self._choices.append((where, self._of[where], known))
        return self._of[where]

    def grant(self, wish: Wish, missed_by: IntVar) -> None:
        """Demand a wish's bound on `missed_by`, and add its price to the cost."""
        cp = self.model.cp
        if wish.bound is not None:
            cp.add(missed_by <= self.attribute.badness(wish.bound) // self.step)
        if wish.weight_us:
            common = gcd(wish.weight_us * self.step, MICRO)
            weight, by = wish.weight_us * self.step // common, MICRO // common
            price = cp.new_int_var(0, -(-weight * self._scale // by), "")
            cp.add(by * price >= weight * missed_by)
            self.model.more_costs.append(price)

    def follow_rules(self) -> None:
        """Let each variable be what the rules of the streams make of their inputs, which get variables too."""
        for where, badness, choices in self.model.candidates.clock.each(self._choices):
            self._is_no_better_than_what_is_taken(where, badness, choices)

    def _is_no_better_than_what_is_taken(
        self, where: Hashable, badness: IntVar, choices: Mapping[Stream, IntVar]
    ) -> None:
        cp, (start, most) = self.model.cp, badness.proto.domain
        held: list[LiteralT] = []
        if most == self._scale:  # what is worse than the scale counts as its worst
            is_worst = cp.new_bool_var("")
            cp.add(badness == most).only_enforce_if(is_worst)
            held.append(is_worst.negated())
        terms: list[LinearExprT] = [start]
        for stream, taken in choices.items():
            least = self._least[stream]
            if least > most:
                cp.add_bool_or([taken.negated()])
                continue
            terms.append((least - start) * taken)
            delay = self._delay(where, stream)
            if delay is not None:
                cp.add(badness - delay >= least).only_enforce_if([taken, *held])
            sent = badness if delay is None else badness - delay
            for by, made, so in self._made(stream):
                cp.add(by * sent >= made).only_enforce_if([taken, *held, *so])
        cp.add(badness >= LinearExpr.sum(terms))  # implied, but what the linear relaxation needs

    def _delay(self, where: Hashable, stream: Stream) -> IntVar | None:
        """What links add to a stream's badness on its way to a target or an input told apart; None if they do not."""
        model, made_on = self.model, self.model.runs_on[self.model.unit_of(stream)]
        if Feature.LATENCY not in model.problem.features:
            return None
        wanted: Mapping[HostName, list[IntVar]] = {}
        if isinstance(where, str):
            wanted = {model.environment.target[where].host: []}
        elif isinstance(where, tuple) and where[0] == "input":
            wanted = {host: [on] for host, on in model.runs_on[where[1]].items()}
        latency = partial(model.environment.latency, self.attribute.name)
        late = {(one, other): latency(one, other) // self.step for one in made_on for other in wanted}
        if not any(late.values()):
            return None
        delay = model.cp.new_int_var(0, max(late.values()), "")
        for (one, other), by in late.items():
            model.cp.add(delay >= by).only_enforce_if([made_on[one], *wanted[other]])
        return delay

    def _made(self, stream: Stream) -> Iterable[tuple[int, LinearExprT, list[LiteralT]]]:
        """What the badness of a stream times a number is at least where some literals hold."""
        unit = self.model.unit_of(stream)
        transformation = self.model.candidates.all[unit].transformation
        making = Making.of(self.attribute, transformation, transformation.output[stream.port])
        yield 1, making.least // self.step, []
        inputs: list[tuple[LinearExprT, list[LiteralT]]] = []
        if making.inputs:
            found = [one for port in making.inputs for one in self._counted(unit, port)]
            inputs = list({one.index: (one, so) for one, so in found}.values())
            if all(so for _, so in found):
                yield 1, making.alone // self.step, [~counts for _, so in found for counts in so]
            if making.over is not Over.WORST and len(found) > 1:
                inputs = [self._combined(unit, making.over, found)]
        common = gcd(making.gain * self.step, MICRO * self.step, making.shift)
        for badness, so in inputs:
            made = making.gain * self.step // common * badness + making.shift // common
            yield MICRO * self.step // common, made, so

    def _counted(self, unit: int, port: InputPort) -> list[tuple[IntVar, list[LiteralT]]]:
        """How bad what comes at an input is, and, if it may take none or several streams, that each is taken."""
        if port.is_usual:
            return [(self._at(unit, port), [])]
        where, connects = ("input", unit, port.name), self.model.connects[unit, port.name]
        return [(self.of_choice((*where, s), port.tag, {s: taken}), [taken]) for s, taken in connects.items()]

    def _at(self, unit: int, port: InputPort) -> IntVar:
        """How bad the stream at a candidate's input is."""
        model, where = self.model, ("input", unit, port.name)
        if (unit, port.name) in model.connects:
            return self.of_choice(where, port.tag, model.connects[unit, port.name])
        if where not in self._of:
            keys = [(wired, model.hub_key(port.tag, host)) for host, wired in model.wired_on(unit).items()]
            met = [(wired, self.of_choice(key, port.tag, model.meets[key])) for wired, key in keys]
            running = model.candidates.all[unit].running
            kept = running.feeds[port.name][0] if unit in model.stays and running is not None else None
            if len({badness.index for _, badness in met}) == 1 and kept is None:
                self._of[where] = met[0][1]
                return met[0][1]
            badness = self._of[where] = model.cp.new_int_var(0, self._scale, "")
            if kept is not None:
                known = {kept: model.stays[unit]} if kept in self._least else {}
                self._choices.append((where, badness, known))
            for wired, theirs in met:
                model.cp.add(badness >= theirs).only_enforce_if(wired)
        return self._of[where]

    def _combined(
        self, unit: int, over: Over, inputs: Sequence[tuple[IntVar, list[LiteralT]]]
    ) -> tuple[LinearExprT, list[LiteralT]]:
        """How bad all that counts is together, and the literal that something does, if there may be nothing."""
        where = unit, over
        if where not in self._together:
            self._together[where] = self._new_combined(over, inputs)
        return self._together[where]

    def _new_combined(
        self, over: Over, inputs: Sequence[tuple[IntVar, list[LiteralT]]]
    ) -> tuple[LinearExprT, list[LiteralT]]:
        cp, otherwise = self.model.cp, self._scale if over is Over.BEST else 0
        counted = [self._or_else(badness, so, otherwise) for badness, so in inputs]
        literals = [counts for _, so in inputs for counts in so]
        number = LinearExpr.sum(literals) + len(inputs) - len(literals)
        is_any: list[LiteralT] = []
        if len(literals) == len(inputs):
            is_any = [cp.new_bool_var("")]
            cp.add_max_equality(is_any[0], literals)
        if over is Over.SUM:
            best = self.attribute.sign * self.attribute.best // self.step
            return LinearExpr.sum(counted) + best * (number - 1), is_any
        together = cp.new_int_var(0, self._scale, "")
        if over is Over.BEST:
            cp.add_min_equality(together, counted)
            return together, is_any
        for n in range(max(1, len(inputs) - len(literals)), len(inputs) + 1):
            are_more = cp.new_bool_var("")
            cp.add(number != n).only_enforce_if(are_more)
            cp.add(n * together >= LinearExpr.sum(counted)).only_enforce_if(~are_more)
        return together, is_any

    def _or_else(self, badness: IntVar, so: list[LiteralT], otherwise: int) -> IntVar:
        """How bad something is that counts if a literal holds, else another number."""
        if not so:
            return badness
        found = self.model.cp.new_int_var(0, self._scale, "")
        self.model.cp.add(found == badness).only_enforce_if(so)
        self.model.cp.add(found == otherwise).only_enforce_if([~counts for counts in so])
        return found
