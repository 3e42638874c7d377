"""Quality in the constraint model: each possible value of an attribute has a number, larger for a worse value.

A stream may count as worse than the wiring makes it, never as better: since every rule is monotone and only good
streams are asked for, the solver makes them as good as they are. Variables exist only where a stream is chosen.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from math import gcd
from typing import TYPE_CHECKING, Final, TypeAlias

from cfgplan.domain import InputPort, Stream
from cfgplan.figures import qualities_of_targets
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planners.exact.rule import CheckedUnits, Rule
from cfgplan.planning import Feature
from cfgplan.qualities import MICRO, Over, QualityAttribute, Wish, is_met

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar, LinearExprT, LiteralT

    from cfgplan.planners.exact.model import Model
    from cfgplan.planners.exact.quality_chains import ChainCut

Counted: TypeAlias = "tuple[IntVar, list[LiteralT]]"
"""How bad what comes at an input is, and, if it may take none or several streams, that this one is taken."""


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
                model.missed_by[target.label, attribute.name] = badness.steps(missed_by), badness.numbers.step
            badness.follow_rules()


def _too_bad(checked: CheckedUnits) -> Iterator[str]:
    environment = checked.environment
    reached_at = qualities_of_targets(environment, checked.units)
    for target in environment.targets:
        for wish in target.quality if target.label in reached_at else ():
            if not is_met(environment.quality[wish.attribute], wish, reached_at[target.label][wish.attribute]):
                yield f"target {target.label} gets too bad a stream"


def running_units_bound_the_badness_of_chains(model: Model, cuts: Iterable[ChainCut]) -> None:
    """Add the cuts on chains: implied, but the linear relaxation needs them."""
    index_of = model.candidates.index_of
    for cut in cuts:
        missed_by, step = model.missed_by[cut.target, cut.attribute]
        ahead = {index_of[unit]: by for unit, by in cut.ahead.items() if unit in index_of}
        terms = [-(-by // step) * model.runs[i] for i, by in ahead.items() if i in model.runs]
        model.cp.add(model.total([missed_by, *terms]) >= -(-cut.least // step))


class _Badness:
    """Variables of an attribute where a stream is chosen: at targets, at explicit inputs, in hubs.

    Their values are `numbers`; only numbers within one span differ as badness does.
    """

    def __init__(self, model: Model, attribute: QualityAttribute) -> None:
        from cfgplan.planners.exact.best_case import least_badness, most_badness
        from cfgplan.planners.exact.quality_numbers import numbers_of

        self.model, self.attribute = model, attribute
        self.numbers = numbers = numbers_of(model.candidates, attribute)
        found = least_badness(model.candidates, attribute)
        self._least = {stream: numbers.at_least(bad) for stream, bad in found.items()}
        self._of: dict[Hashable, IntVar] = {}
        self._together: dict[tuple[int, Over], tuple[LinearExprT, list[LiteralT]]] = {}
        self._choices: list[tuple[Hashable, IntVar, Mapping[Stream, IntVar]]] = []
        self._fed: dict[int, IntVar] = {}
        self._is_beyond: dict[tuple[int, int], IntVar] = {}
        self._most: dict[int, int] = {}
        """The badness up to which a stream for a demand is of use to anybody; spares may get any quality."""
        of_use = most_badness(model.candidates, attribute) if Feature.SURVIVAL not in model.problem.features else {}
        for tag, most in of_use.items():
            demand = model.demand(tag)
            self._most[demand] = max(numbers.at_most(most), self._most.get(demand, 0))

    def of_choice(self, where: Hashable, tag: str, choices: Mapping[Stream, IntVar]) -> IntVar:
        """A variable no better than the stream that is taken for a demand."""
        if where not in self._of:
            known = {stream: taken for stream, taken in choices.items() if stream in self._least}
            most = self._most.get(self.model.demand(tag), self.numbers.top)
            least = min([most, *(self._least[stream] for stream in known)])
            self._of[where] = self.model.cp.new_int_var(least, most, "")
            self._choices.append((where, self._of[where], known))
        return self._of[where]

    def grant(self, wish: Wish, missed_by: IntVar) -> None:
        """Demand a wish's bound on `missed_by`, and add its price to the cost."""
        cp, numbers = self.model.cp, self.numbers
        if wish.bound is not None:
            cp.add(missed_by <= numbers.at_most(self.attribute.badness(wish.bound)))
        if wish.weight_us:
            common = gcd(wish.weight_us * numbers.step, MICRO)
            weight, by = wish.weight_us * numbers.step // common, MICRO // common
            each, weight = divmod(weight, by)  # what is left of the price is smaller than the number
            least = [weight * low // by for low, _ in numbers.spans]
            most = max(-(-weight * high // by) - known for (_, high), known in zip(numbers.spans, least, strict=True))
            price = cp.new_int_var(0, most, "")
            for span, where in self._in_spans(missed_by, range(len(numbers.spans))):
                rest = weight * numbers.offset(span) - by * least[span]
                cp.add(by * price >= weight * missed_by + rest).only_enforce_if(where)
            firsts = [each * numbers.offset(span) + known for span, known in enumerate(least)]
            self.model.more_costs += [self._by_span(missed_by, firsts), each * missed_by, price]

    def steps(self, number: IntVar) -> LinearExprT:
        """The badness of a number, in steps."""
        offsets = [self.numbers.offset(span) for span in range(len(self.numbers.spans))]
        return self.model.total([number, self._by_span(number, offsets)])

    def _by_span(self, number: IntVar, values: Sequence[int]) -> LinearExprT:
        """The value, out of one for each span, of the span that a number is in."""
        terms: list[LinearExprT] = [values[0]]
        for span, (before, value) in enumerate(pairwise(values), 1):
            if (is_beyond := self._beyond(number, span)) is not False:
                terms.append(value - before if is_beyond is True else (value - before) * is_beyond)
        return self.model.total(terms)

    def _beyond(self, number: IntVar, span: int) -> IntVar | bool:
        """The boolean that a number is in a span or in a worse one, if it may be there and elsewhere."""
        least, most = number.proto.domain
        first = self.numbers.first[span]
        if most < first or first <= least:
            return bool(first <= least)
        key = number.index, span
        if key not in self._is_beyond:
            found = self._is_beyond[key] = self.model.cp.new_bool_var("")
            self.model.cp.add(number >= first).only_enforce_if(found)
            self.model.cp.add(number < first).only_enforce_if(~found)
        return self._is_beyond[key]

    def _in_spans(self, number: IntVar, spans: Collection[int]) -> Iterator[tuple[int, list[LiteralT]]]:
        """The spans that a number may be in, or be the next number before, with the literals that say so."""
        ordered = sorted(spans)
        if not ordered:
            return
        is_beyond = [True, *(self._beyond(number, span) for span in ordered[1:]), False]
        for span, (here, worse) in zip(ordered, pairwise(is_beyond), strict=True):
            if here is not False and worse is not True:
                yield span, [*([here] if here is not True else []), *([~worse] if worse is not False else [])]

    def follow_rules(self) -> None:
        """Let each variable be what the rules of the streams make of their inputs, which get variables too."""
        for where, badness, choices in self.model.candidates.clock.each(self._choices):
            self._is_no_better_than_what_is_taken(where, badness, choices)

    def _is_no_better_than_what_is_taken(
        self, where: Hashable, badness: IntVar, choices: Mapping[Stream, IntVar]
    ) -> None:
        cp, (start, most) = self.model.cp, badness.proto.domain
        held: list[LiteralT] = []
        if most == self.numbers.top and self.numbers.has_worst:  # what is worse than the scale counts as its worst
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
            for there, variant in self._variants(stream):
                for by, made, so in self._made(stream, variant):
                    cp.add(by * sent >= made).only_enforce_if([taken, *held, *there, *so])
        cp.add(badness >= self.model.total(terms))  # implied, but what the linear relaxation needs

    def _delay(self, where: Hashable, stream: Stream) -> IntVar | None:
        """Return the badness that links add on the way to a target or an explicit input; None if they add none."""
        model, made_on = self.model, self.model.runs_on[self.model.unit_of(stream)]
        if Feature.LATENCY not in model.problem.features:
            return None
        wanted: Mapping[HostName, list[IntVar]] = {}
        if isinstance(where, str):
            wanted = {model.environment.target[where].host: []}
        elif isinstance(where, tuple) and where[0] == "input":
            wanted = {host: [on] for host, on in model.runs_on[where[1]].items()}
        latency = partial(model.environment.latency, self.attribute.name)
        late = {(one, other): latency(one, other) // self.numbers.step for one in made_on for other in wanted}
        if not any(late.values()):
            return None
        delay = model.cp.new_int_var(0, max(late.values()), "")
        for (one, other), by in late.items():
            model.cp.add(delay >= by).only_enforce_if([made_on[one], *wanted[other]])
        return delay

    def _variants(self, stream: Stream) -> Iterator[tuple[list[LiteralT], tuple[int, list[HostName]]]]:
        """Yield each own value of a stream's output with its hosts, after the literals that its unit is on one."""
        from cfgplan.planners.exact.quality_numbers import variants_of

        unit = self.model.unit_of(stream)
        on, transformation = self.model.runs_on[unit], self.model.candidates.all[unit].transformation
        for value, hosts in variants_of(transformation.output[stream.port], self.attribute, on).items():
            there: list[LiteralT] = [on[host].negated() for host in on if host not in hosts]
            yield [on[hosts[0]]] if len(hosts) == 1 < len(there) else there, (value, hosts)

    def _made(
        self, stream: Stream, variant: tuple[int, list[HostName]]
    ) -> Iterator[tuple[int, LinearExprT, list[LiteralT]]]:
        """The lower bound of a stream's number times another one, under some literals, on the hosts of a variant."""
        from cfgplan.planners.exact.best_case import OutputRule
        from cfgplan.planners.exact.quality_numbers import most_together

        model, numbers, unit = self.model, self.numbers, self.model.unit_of(stream)
        transformation, (value, hosts) = model.candidates.all[unit].transformation, variant
        making = OutputRule.of(self.attribute, transformation, transformation.output[stream.port], hosts)
        yield 1, numbers.at_least(making.least), []
        found = [one for port in making.inputs for one in self._counted(unit, port)]
        if making.inputs and all(so for _, so in found):
            yield 1, numbers.at_least(making.alone), [~counts for _, so in found for counts in so]
        if not found:
            return
        images = numbers.images[transformation.label, stream.port, value]
        common = gcd(making.gain * numbers.step, MICRO * numbers.step, making.shift)
        gain, by = making.gain * numbers.step // common, MICRO * numbers.step // common
        shift_to = {span: making.shift // common - by * numbers.offset(image) for span, image in images.items()}
        if making.over in (Over.SUM, Over.MEAN) and most_together(model.candidates, making) > 1:
            for span, shift in shift_to.items():
                together, is_any = self._combined(unit, making.over, found, span)
                yield by, gain * together + shift, is_any
            return
        inputs = list({number.index: (number, so) for number, so in found}.values())
        if making.over is Over.BEST and len(inputs) > 1:
            inputs = [self._best(unit, inputs)]
        for number, so in inputs:
            for span, where in self._in_spans(number, images):
                yield by, gain * number + gain * numbers.offset(span) + shift_to[span], [*so, *where]

    def _counted(self, unit: int, port: InputPort) -> list[Counted]:
        if port.is_usual:
            return [(self._at(unit, port), [])]
        where, connects = ("input", unit, port.name), self.model.connects[unit, port.name]
        return [(self.of_choice((*where, s), port.tag, {s: taken}), [taken]) for s, taken in connects.items()]

    def _at(self, unit: int, port: InputPort) -> IntVar:
        """The number of the stream at a candidate's input."""
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
            badness = self._of[where] = model.cp.new_int_var(0, self.numbers.top, "")
            if kept is not None:
                known = {kept: model.stays[unit]} if kept in self._least else {}
                self._choices.append((where, badness, known))
            for wired, theirs in met:
                model.cp.add(badness >= theirs).only_enforce_if(wired)
        return self._of[where]

    def _best(self, unit: int, inputs: Sequence[Counted]) -> Counted:
        """The number of the best that counts, and the literal that something does, if there may be nothing."""
        where = "best of", unit
        is_any = self._is_any(unit, inputs)
        if where not in self._of:
            best = self._of[where] = self.model.cp.new_int_var(0, self.numbers.top, "")
            counted = [self._or_else(number, so, 0, self.numbers.top) for number, so in inputs]
            self.model.cp.add_min_equality(best, counted)
        return self._of[where], is_any

    def _combined(
        self, unit: int, over: Over, inputs: Sequence[Counted], span: int
    ) -> tuple[LinearExprT, list[LiteralT]]:
        """How bad all that counts, in one span, is together, in steps; and the literal that something does."""
        where = unit, over
        if where not in self._together:
            self._together[where] = self._new_combined(over, inputs, span), self._is_any(unit, inputs)
        return self._together[where]

    def _is_any(self, unit: int, inputs: Sequence[Counted]) -> list[LiteralT]:
        """The literal that some input counts; none if one always does."""
        if not all(so for _, so in inputs):
            return []
        if unit not in self._fed:
            self._fed[unit] = self.model.cp.new_bool_var("")
            self.model.cp.add_max_equality(self._fed[unit], [counts for _, so in inputs for counts in so])
        return [self._fed[unit]]

    def _new_combined(self, over: Over, inputs: Sequence[Counted], span: int) -> LinearExprT:
        cp, numbers = self.model.cp, self.numbers
        first, low = numbers.first[span], numbers.spans[span][0]
        above = [self._or_else(number, so, first, 0) for number, so in inputs]
        literals = [counts for _, so in inputs for counts in so]
        number = self.model.total(literals) + len(inputs) - len(literals)
        if over is Over.SUM:
            best = self.attribute.sign * self.attribute.best // numbers.step
            return self.model.total(above) + (low + best) * number - best
        together = cp.new_int_var(-first, numbers.top - first, "")
        for n in range(max(1, len(inputs) - len(literals)), len(inputs) + 1):
            are_more = cp.new_bool_var("")
            cp.add(number != n).only_enforce_if(are_more)
            cp.add(n * together >= self.model.total(above)).only_enforce_if(~are_more)
        return together + low

    def _or_else(self, number: IntVar, so: list[LiteralT], less: int, otherwise: int) -> LinearExprT:
        """By how much a number that counts if a literal holds exceeds another; something else if it does not hold."""
        if not so:
            return number - less
        least, most = number.proto.domain
        found = self.model.cp.new_int_var(min(least - less, otherwise), max(most - less, otherwise), "")
        self.model.cp.add(found == number - less).only_enforce_if(so)
        self.model.cp.add(found == otherwise).only_enforce_if([~counts for counts in so])
        return found


ASKED: Final = Rule(targets_get_the_quality_they_ask_for, Feature.QUALITY, _too_bad)
