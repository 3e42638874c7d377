"""The values that streams can have, numbered without the ranges that no stream can have: large integers mislead CP-SAT.

The values of an attribute lie in a few spans: mostly one of what units state and what wirings make of that, and the end
of the scale, far away, of streams about which nothing is stated. Rules are monotone and take a span into a span. So the
number of a value is its place among the possible values, and within a span numbers differ as values do.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from math import ceil, floor, gcd
from typing import Final

from cfgplan.domain import ALL, InputPort, OutputPort
from cfgplan.onward import grouped
from cfgplan.planners.exact.best_case import OutputRule, stated_of
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.qualities import MICRO, Over, QualityAttribute, QualityRule

Span = tuple[int, int]
"""The least and the largest of some integers; any between may be there."""
Output = tuple[str, str, int]
"""A transformation's label, the name of an output port, and its own value on some hosts (0 if it states none)."""

LEAST_SKIP: Final = 2**24
"""A shorter range is not skipped: variables of that size are harmless, a boolean for each side is not."""
MOST_SKIPS: Final = 3
"""Only so many ranges are skipped, the largest ones."""


@dataclass(frozen=True)
class Numbers:
    """The numbers of an attribute's possible values, the larger the worse. `spans` are of badness in steps, sorted."""

    spans: tuple[Span, ...]
    images: Mapping[Output, Mapping[int, int]]
    """By output and by the span in which what counts for it is, the span in which it is then itself."""
    step: int
    """All badness is a multiple of it."""
    has_worst: bool
    """Whether some stream may be kept at the worst of the scale: then that is the largest number."""

    @cached_property
    def first(self) -> tuple[int, ...]:
        """The number of the least value of each span."""
        found = [0]
        for low, high in self.spans[:-1]:
            found.append(found[-1] + high - low + 1)
        return tuple(found)

    @cached_property
    def top(self) -> int:
        """The largest number."""
        low, high = self.spans[-1]
        return self.first[-1] + high - low

    def offset(self, span: int) -> int:
        """The badness of a number in a span, in steps, less the number."""
        return self.spans[span][0] - self.first[span]

    def at_least(self, badness: int) -> int:
        """The least number of a value that is as bad or worse; beyond all if there is none."""
        steps = -(-badness // self.step)
        for first, (low, high) in zip(self.first, self.spans, strict=True):
            if steps <= high:
                return first + max(0, steps - low)
        return self.top + 1

    def at_most(self, badness: int) -> int:
        """The largest number of a value that is no worse; below 0 if there is none."""
        steps, found = badness // self.step, -1
        for first, (low, high) in zip(self.first, self.spans, strict=True):
            if low <= steps:
                found = first + min(high, steps) - low
        return found


def variants_of(
    port: OutputPort, attribute: QualityAttribute, hosts: Iterable[HostName]
) -> Mapping[int, list[HostName]]:
    """Return the own values of an output on some hosts, each with its hosts; 0 if it states none."""
    stated = stated_of(port, attribute, ())
    if stated is None or not stated.seen_on:
        return {0 if stated is None else stated.value: [*hosts]}
    return grouped((stated.on(host).value, host) for host in hosts)


def most_together(candidates: Candidates, making: OutputRule) -> int:
    """How many streams may count together for an output."""
    return sum(len(candidates.streams(p.tag)) if p.count == ALL else p.count for p in making.inputs)


def numbers_of(candidates: Candidates, attribute: QualityAttribute) -> Numbers:
    """The numbers of the values that any wiring of candidates can make."""
    values = _Values(candidates, attribute)
    spans = values.without_small_skips([span for known in values.of.values() for span in known])
    spans = spans or ((values.low, values.low),)
    is_closed = False
    while not is_closed:
        images = {output: values.images(output, spans) for output in candidates.clock.each(values.makers)}
        whole = [span for of_output in images.values() for pair in of_output for span in pair]
        joined = _joined([*spans, *whole])
        is_closed, spans = joined == spans, joined
    steps = tuple([((low - values.low) // values.step, (high - values.low) // values.step) for low, high in spans])

    def place(span: Span) -> int:
        return next(n for n, (low, high) in enumerate(spans) if low <= span[0] and span[1] <= high)

    places = {output: {place(fed): place(made) for fed, made in pairs} for output, pairs in images.items()}
    return Numbers(steps, places, values.step, spans[-1][1] == values.high)


def _joined(spans: Iterable[Span], least_skip: int = 1) -> tuple[Span, ...]:
    """Spans sorted; those that overlap, or are less than `least_skip` apart, are joined."""
    found: list[Span] = []
    for low, high in sorted(spans):
        if found and low - found[-1][1] < least_skip:
            found[-1] = found[-1][0], max(found[-1][1], high)
        else:
            found.append((low, high))
    return tuple(found)


@dataclass(frozen=True)
class _Maker:
    """An output's value is `gain` millionths of its inputs' together plus `add`, at best `least`; `alone` without any.

    All values are signed: a larger one is worse.
    """

    inputs: tuple[InputPort, ...]
    gain: int
    add: int
    least: int
    alone: int
    times: int
    """How many inputs' values are added up at most."""
    is_joined: bool
    """Whether several values become another one, between them or their sum."""


class _Values:
    """The values that the outputs of candidates may have where they are taken, each output's as a few spans."""

    def __init__(self, candidates: Candidates, attribute: QualityAttribute) -> None:
        self.candidates, self.attribute = candidates, attribute
        self.low, self.high = attribute.sign * attribute.best, attribute.sign * attribute.worst
        late = [link.latency for link in candidates.environment.links if link.adds == attribute.name]
        self._delay = max(late, default=0)
        self.step = _step(candidates, attribute, late)
        self._variants = {
            (label, port.name): variants_of(port, attribute, candidates.environment.host or (None,))
            for label, transformation in candidates.kinds.items()
            for port in transformation.outputs
        }
        self.makers = {
            (label, port, value): self._maker(label, port, hosts)
            for (label, port), variants in self._variants.items()
            for value, hosts in variants.items()
        }
        self._outputs_of = grouped((output[0], output) for output in self.makers)
        self._providing: dict[str, dict[Output, None]] = {}
        self.of: dict[Output, tuple[Span, ...]] = {}
        for labels in candidates.clock.each(self._rings()):
            self._know(labels)

    def _maker(self, label: str, port: str, hosts: Collection[HostName]) -> _Maker:
        transformation, best = self.candidates.kinds[label], self.low
        making = OutputRule.of(self.attribute, transformation, transformation.output[port], hosts)
        add = (making.shift + best * (MICRO - making.gain)) // MICRO
        most = most_together(self.candidates, making) if making.over in (Over.MEAN, Over.SUM) else 1
        times = most if making.over is Over.SUM else 1
        least, alone = best + making.least, best + making.alone
        return _Maker(making.inputs, making.gain, add, least, alone, max(times, 1), most > 1)

    def _providers(self, tag: str) -> dict[Output, None]:
        if tag not in self._providing:
            outputs = ((self.candidates.label_of(stream), stream.port) for stream in self.candidates.streams(tag))
            self._providing[tag] = {(*output, value): None for output in outputs for value in self._variants[output]}
        return self._providing[tag]

    def _rings(self) -> Iterator[list[str]]:
        """The transformations, those together that may feed each other, after all that may feed them."""
        from networkx import DiGraph, condensation, topological_sort

        graph: DiGraph[Hashable] = DiGraph()
        graph.add_nodes_from((0, label) for label in self.candidates.kinds)
        for label, transformation in self.candidates.clock.each(self.candidates.kinds.items()):
            for tag in {port.tag for port in transformation.inputs if not port.feedback}:
                if (1, tag) not in graph:
                    graph.add_edges_from(((0, provider), (1, tag)) for provider, _, _ in self._providers(tag))
                graph.add_edge((1, tag), (0, label))
        cycles = condensation(graph)
        for cycle in topological_sort(cycles):
            labels = [name for kind, name in cycles.nodes[cycle]["members"] if kind == 0]
            if labels:
                yield sorted(labels)

    def _know(self, labels: Sequence[str]) -> None:
        outputs = [output for label in labels for output in self._outputs_of.get(label, ())]
        units = {label: sum(c.may_run for c in self.candidates.of(label)) for label in labels}
        if len(labels) == 1 and units[labels[0]] <= 1:
            found = {output: self._made(self.makers[output]) for output in outputs}
            self.of |= {output: self._arriving(spans) for output, spans in found.items()}
        else:
            self.of |= dict.fromkeys(outputs, self._arriving(self._made_in_a_ring(outputs, units)))

    def _made(self, maker: _Maker) -> list[Span]:
        """The values of an output whose inputs' values are known."""
        found = [self._image(maker, span) for span in self._together(maker)]
        if all(port.optional for port in maker.inputs):
            found.append((maker.alone, maker.alone))
        return found

    def _made_in_a_ring(self, outputs: Collection[Output], units: Mapping[str, int]) -> list[Span]:
        """The values of outputs of units that may feed each other: no chain has a unit twice."""
        each = self.candidates.clock.each
        makers = [self.makers[output] for output in outputs]
        spans = [span for maker in each(makers) for span in self._fed(maker)]
        spans = [*spans, *((maker.alone, maker.alone) for maker in makers)]
        up = down = 0
        growth = Fraction(1)
        is_added_up = all(maker.gain == MICRO and not maker.is_joined for maker in makers if maker.inputs)
        for label, number in each(units.items()):
            theirs = [self.makers[output] for output in self._outputs_of.get(label, ()) if self.makers[output].inputs]
            rounded = 0 if is_added_up else self.step
            up += number * (max([0, *(maker.add for maker in theirs)]) + self._delay + rounded)
            down += number * max([0, *(-maker.add for maker in theirs)])
            times = max([Fraction(1), *(Fraction(maker.gain * maker.times, MICRO) for maker in theirs)])
            for _ in range(number):
                growth = min(growth * times, Fraction(self.high - self.low + 1))
        if is_added_up:
            return [(low - down, high + up) for low, high in spans]
        low, high = min(low for low, _ in spans), max(high for _, high in spans)
        return [(floor((min(low, 0) - down) * growth), ceil((max(high, 0) + up) * growth))]

    def _fed(self, maker: _Maker) -> tuple[Span, ...]:
        """The known values of the streams that may feed the inputs that count for an output."""
        providers = {provider for port in maker.inputs for provider in self._providers(port.tag)}
        return _joined(span for provider in providers for span in self.of.get(provider, ()))

    def _together(self, maker: _Maker) -> tuple[Span, ...]:
        """The values that the inputs which count for an output may have together."""
        spans = self._fed(maker)
        return ((spans[0][0], spans[-1][1]),) if spans and maker.is_joined else spans

    def _image(self, maker: _Maker, span: Span) -> Span:
        """The values of an output for inputs in a span."""
        low, high = min(span[0], span[0] * maker.times), max(span[1], span[1] * maker.times)
        made = [max(maker.least, -(-maker.gain * value // MICRO) + maker.add) for value in (low, high)]
        return self._within((made[0], made[1]))

    def _within(self, span: Span) -> Span:
        """A span kept on the scale, its ends multiples of the step."""
        low, high = (min(max(value, self.low), self.high) - self.low for value in span)
        return self.low + low // self.step * self.step, self.low - -high // self.step * self.step

    def _sent(self, span: Span) -> Span:
        """A span with what links add."""
        return self._within((span[0], span[1] + self._delay))

    def _arriving(self, spans: Iterable[Span]) -> tuple[Span, ...]:
        """Spans with what links add."""
        return self.without_small_skips(map(self._sent, spans))

    def without_small_skips(self, spans: Iterable[Span]) -> tuple[Span, ...]:
        """Spans joined across all but the largest ranges between them."""
        found = _joined(spans, LEAST_SKIP * self.step)
        skips = sorted((after[0] - before[1] for before, after in pairwise(found)), reverse=True)
        return _joined(found, skips[MOST_SKIPS] + 1) if len(skips) > MOST_SKIPS else found

    def images(self, output: Output, spans: Sequence[Span]) -> list[tuple[Span, Span]]:
        """For each of some spans that what counts for an output may be in, the part it may be in, and its image."""
        maker = self.makers[output]
        together = self._together(maker)
        parts = [[part for part in together if low <= part[0] and part[1] <= high] for low, high in spans]
        inside = [(these[0][0], these[-1][1]) for these in parts if these]
        whole = [part for part in together if not any(part in these for these in parts)]
        return [(part, self._sent(self._image(maker, part))) for part in [*inside, *whole]]


def _step(candidates: Candidates, attribute: QualityAttribute, late: Iterable[int]) -> int:
    """Return a common divisor of all badness; 1 on a scale whose worst is its best, where all is 0."""
    outputs = [port for t in candidates.kinds.values() for port in t.outputs]
    stated = [c for port in outputs for c in port.quality if c.attribute == attribute.name]
    values = [c.stated + seen for c in stated for seen in (0, *c.learned.values())]
    is_cut = any(c.rule is QualityRule.SCALE or c.over is Over.MEAN for c in stated)
    return 1 if is_cut else max(1, gcd(attribute.worst, attribute.best, *values, *late))
