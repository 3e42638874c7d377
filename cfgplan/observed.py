"""Learn how much quality each output itself adds or takes (its own part), from streams that say how good they are.

An output's own part deviates from the stated value by a normally distributed amount: its mean is 0 and its standard
deviation TRUST of the stated value (of its logarithm where the rule is `scale`). If a stream deviates from its
prediction, the parts between it and the nearest streams upstream that say how good they are share the deviation in
proportion to their variances (an extended Kalman filter with a diagonal covariance). A part that is not observed any
more fades to the stated value. Units of a transformation on one host share an estimate; on a host where none was
observed, the stated value counts.

A part keeps its estimate if the deviation can't be attributed: behind the better of two inputs whose qualities do not
differ significantly, behind a factor on an input near 0, and at the ends of the scale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from math import exp, inf, sqrt
from types import MappingProxyType
from typing import Final, NamedTuple

from cfgplan.domain import ComputationUnit, Environment, Similarity, Statement, Stream
from cfgplan.qualities import MICRO, Contribution, Over, QualityAttribute, QualityRule
from cfgplan.summary import some

TRUST: Final = 0.5
"""The standard deviation of a part that was not observed, as a share of the stated value."""
FORGET_S: Final = 300.0
"""After so many seconds without an observation, half of what was learned is left."""
NEWS: Final = 0.05
"""A stream changes estimates only if it differs from its prediction by more than this share of the prediction."""
NEWS_ERRORS: Final = 4.0
"""A stream changes estimates only if it differs from its prediction by more than so many standard errors: less may
be noise."""
APART_ERRORS: Final = 2.0
MEMORY_S: Final = 5.0
"""After so many seconds, an element of a stream has half its weight in the mean; in a slow stream, after
MEMORY_ELEMENTS more elements.
"""
MEMORY_ELEMENTS: Final = 10
"""The spread of fewer values is unknown."""
TEACHES_S: Final = 2 * MEMORY_S
"""A stream that keeps to its prediction confirms the estimates once in so many seconds."""
LEAST_ELEMENTS: Final = 5
_DOUBT: Final = 8.0
"""Few values say little of their own spread: with ten of them, the variance of their mean counts 1.8 times."""
_ROUNDS: Final = 20
_STEP: Final = 1.0
"""The logarithm of a factor moves by at most this in a round, lest it overshoots."""
_LEAST_DOUBT: Final = 1e-6
"""No part is surer than this share of its usual variance, however exact a stream is: it may change."""
_STILL: Final = 0.001
"""A fit ends when a round moves the prediction by no more than this share."""


@dataclass(frozen=True, slots=True)
class Figures:
    """The number of some values, their mean, and the sum of the squared distances from the mean."""

    number: int
    mean: float
    squares: float = 0.0


@dataclass(frozen=True, slots=True)
class Window:
    """An exponential mean of the quality that a stream says, in micro-units of the attribute; new values count most.

    `weight` and `weight2` are the sums of the values' weights and of their squares, `squares` is the weighted sum of
    squared distances from the mean. `number` counts all values.
    """

    at_s: float
    number: int = 0
    mean: float = 0.0
    weight: float = 0.0
    weight2: float = 0.0
    squares: float = 0.0

    def after(self, figures: Figures, at_s: float) -> Window:
        """The window with more values, which have come by `at_s`."""
        fading = 0.5 ** min((at_s - self.at_s) / MEMORY_S, figures.number / MEMORY_ELEMENTS)
        old, new = self.weight * fading, float(figures.number)
        distance = figures.mean - self.mean
        return replace(
            self,
            at_s=at_s,
            number=self.number + figures.number,
            mean=self.mean + distance * new / (old + new) if new else self.mean,
            weight=old + new,
            weight2=self.weight2 * fading**2 + new,
            squares=self.squares * fading + figures.squares + (distance**2 * old * new / (old + new) if new else 0.0),
        )

    @property
    def sample(self) -> Sample | None:
        """The mean with its variance; None while there are too few values."""
        if self.number < LEAST_ELEMENTS or self.weight <= 0:
            return None
        share = self.weight2 / self.weight**2
        return Sample(self.mean, self.squares / self.weight * share * (1 + _DOUBT * share))


class Sample(NamedTuple):
    """The mean quality that a stream says, and the variance of that mean; in micro-units."""

    mean: float
    variance: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimated deviation of a part from its stated value, with its variance.

    Both are in micro-units; for `scale`, they are of the logarithm.
    """

    deviation: float
    variance: float
    seen_s: float

    def at(self, at_s: float, usual: float) -> Estimate:
        """The estimate as it has faded by a time; `usual` is the variance of a part that was never observed."""
        left = 0.5 ** (max(0.0, at_s - self.seen_s - MEMORY_S) / FORGET_S)
        return Estimate(self.deviation * left, usual + (self.variance - usual) * left**2, self.seen_s)


Estimates = Mapping[Statement, Estimate]
Said = tuple[Stream, str]
"""A stream, and the quality attribute that it says of itself."""
Samples = Mapping[Said, Sample]


@dataclass(frozen=True, slots=True)
class Lesson:
    """The estimates learned from samples, and the streams that differed significantly from their predictions."""

    estimates: Estimates
    news: frozenset[Said] = frozenset()


@dataclass(frozen=True, slots=True)
class _Predicted:
    """A predicted value, how it depends on parts (its derivatives), and the variance that it has from samples."""

    value: float
    by: Mapping[Statement, float] = field(default_factory=dict)
    variance: float = 0.0

    def times(self, factor: float) -> _Predicted:
        by = {part: slope * factor for part, slope in self.by.items()}
        return _Predicted(self.value * factor, by, self.variance * factor**2)

    def plus(self, other: _Predicted) -> _Predicted:
        by = dict(self.by)
        for part, slope in other.by.items():
            by[part] = by.get(part, 0.0) + slope
        return _Predicted(self.value + other.value, by, self.variance + other.variance)


def learned(
    environment: Environment,
    samples: Samples,
    estimates: Estimates,
    at_s: float,
    *,
    fresh: frozenset[Said] = frozenset(),
) -> Lesson:
    """Return the estimates after samples of running units, in an environment with stated qualities.

    A stream changes estimates if it differs significantly from its prediction. A `fresh` stream changes them also
    otherwise: as predicted, it confirms them.
    """
    found, news = _Parts(environment, samples, dict(estimates), at_s), set[Said]()
    for unit in _feeders_first(environment):
        for port in environment.transformation[unit.transformation].outputs:
            for stated in port.quality:
                said = Stream(unit.id, port.name), stated.attribute
                if said in samples and found.learn(unit, said[0], stated, is_fresh=said in fresh):
                    news.add(said)
    return Lesson(MappingProxyType(found.estimates), frozenset(news))


def planned_deviations(
    environment: Environment,
    estimates: Estimates,
    before: Mapping[Statement, int],
    at_s: float,
    *,
    fades: Callable[[Statement], bool] = lambda _: False,
    only_sure: bool = False,
) -> dict[Statement, int]:
    """Return the deviations of outputs from their stated values that plans use (see `Environment.with_qualities`).

    A deviation that was returned `before` is kept until it is wrong by more than NEWS of the value, and with
    `only_sure` also by more than NEWS_ERRORS standard errors of the part. If an output is not observed any more, its
    deviation is kept, or becomes the faded estimate if it `fades`.
    """
    found: dict[Statement, int] = {}
    for statement, known in estimates.items():
        stated = environment.stated(statement)
        if stated is None:
            continue
        value, error = own_part(stated, known, at_s)
        seen, was = round(value) - stated.stated, before.get(statement, 0)
        may_change = fades(statement) or at_s - known.seen_s <= MEMORY_S
        least = max(NEWS * abs(stated.stated + was), NEWS_ERRORS * error if only_sure else 0.0)
        if kept := (seen if may_change and abs(seen - was) > least else was):
            found[statement] = kept
    return found


def own_part(stated: Contribution, known: Estimate, at_s: float) -> tuple[float, float]:
    """Return the estimate of an output's own part, and its standard error; in micro-units, a factor in millionths."""
    estimate = known.at(at_s, usual_variance(stated))
    value, error = _own_value(stated, estimate.deviation), sqrt(estimate.variance)
    return value, abs(value) * error if stated.rule is QualityRule.SCALE else error


def hoped_deviation(stated: Contribution, attribute: QualityAttribute, known: Estimate | None, at_s: float) -> int:
    """Return a deviation from the stated value that an output may have if it is good, in micro-units.

    It is better than the estimate by one standard deviation, which grows while the output is not observed, and never
    worse than the stated value.
    """
    usual = usual_variance(stated)
    estimate = (known or Estimate(0.0, usual, -inf)).at(at_s, usual)
    value = _own_value(stated, estimate.deviation - attribute.sign * sqrt(estimate.variance))
    deviation = round(value) - stated.stated
    return deviation if attribute.sign * deviation < 0 else 0


def _own_value(stated: Contribution, deviation: float) -> float:
    return stated.stated * exp(deviation) if stated.rule is QualityRule.SCALE else stated.stated + deviation


def hidden(environment: Environment, similarity: Similarity) -> Iterator[str]:
    """Yield a line for each output whose own part may stay as declared, since its binding input can't be determined."""
    for transformation in environment.library:
        ordinary = [port for port in transformation.inputs if not port.feedback]
        if len(ordinary) < 2 and all(port.count == 1 for port in ordinary):
            continue
        for port in transformation.outputs:
            for stated in port.quality:
                if (
                    stated.observe is None
                    or stated.rule is QualityRule.SET
                    or stated.over not in (Over.WORST, Over.BEST)
                ):
                    continue
                silent = [
                    f"{provider.label}/{given.name}"
                    for provider in environment.library
                    for given in provider.outputs
                    if any(similarity.holds(given.tag, one.tag) for one in ordinary)
                    and not any(one.attribute == stated.attribute and one.observe for one in given.quality)
                ]
                if silent:
                    yield (
                        f"{transformation.label}/{port.name} observes its {stated.attribute}, but may not learn it: "
                        f"only its {stated.over} input counts, and {some(silent)} observes none; "
                        "add `observe:` there, or count the inputs by `of: mean` or `of: sum`"
                    )


def usual_variance(stated: Contribution) -> float:
    """The variance of a part that was never observed, in squared micro-units; for `scale`, of the logarithm."""
    return TRUST**2 if stated.rule is QualityRule.SCALE else (TRUST * max(abs(stated.stated), 1)) ** 2


class _Parts:
    """Estimates while they learn."""

    def __init__(
        self, environment: Environment, samples: Samples, estimates: dict[Statement, Estimate], at_s: float
    ) -> None:
        self._environment = environment
        self._samples = samples
        self.estimates = estimates
        self._at_s = at_s
        self._trail: set[Stream] = set()

    def learn(self, unit: ComputationUnit, stream: Stream, stated: Contribution, *, is_fresh: bool) -> bool:
        """Learn from the sample of a stream that is fresh or significantly off its prediction. True for the latter."""
        attribute, sample = self._environment.quality[stated.attribute], self._samples[(stream, stated.attribute)]
        ends = sorted((attribute.worst, attribute.best))
        if not ends[0] < sample.mean < ends[1]:
            sample = Sample(min(max(sample.mean, ends[0]), ends[1]), sample.variance)
        first = self._predicted(unit, stream, attribute, sample.mean)
        if first is None or not first.by:
            return False
        self._refresh(first.by)
        before = {part: self._estimate(part) for part in first.by}
        known = sum(slope**2 * before[part].variance for part, slope in first.by.items() if part in self.estimates)
        misses, noise = sample.mean - first.value, sample.variance + first.variance
        spread = sum(slope**2 * before[part].variance for part, slope in first.by.items())
        if abs(misses) > max(NEWS * abs(first.value), NEWS_ERRORS * sqrt(noise + known)):
            wider = max(1.0, (misses**2 - noise) / spread) if spread else 1.0
            self._fit(unit, stream, attribute, sample, before, wider)
            return True
        if not is_fresh or spread + noise <= 0:
            return False
        self._fit(unit, stream, attribute, sample, before, 1.0)
        moved = misses * spread / (spread + noise)
        return abs(moved) > max(NEWS * abs(first.value), NEWS_ERRORS * sqrt(spread * noise / (spread + noise)))

    def _fit(
        self,
        unit: ComputationUnit,
        stream: Stream,
        attribute: QualityAttribute,
        sample: Sample,
        before: Mapping[Statement, Estimate],
        wider: float,
    ) -> None:
        """Move parts to where their prediction meets a sample, by their variances `wider` than before."""
        variance = {part: before[part].variance * wider for part in before}
        least = {part: _LEAST_DOUBT * self._usual(part) for part in before}
        longest = {part: _STEP if self._is_factor(part) else inf for part in before}
        for _ in range(_ROUNDS):
            now = self._predicted(unit, stream, attribute, sample.mean)
            if now is None or not now.by.keys() <= before.keys():
                return
            spread = sum(slope**2 * variance[part] for part, slope in now.by.items())
            total = spread + sample.variance + now.variance
            if total <= 0:
                return
            held = {part: self._estimate(part).deviation for part in now.by}
            moved = sum(slope * (held[part] - before[part].deviation) for part, slope in now.by.items())
            share = (sample.mean - now.value + moved) / total
            for part, slope in now.by.items():
                wanted = before[part].deviation + slope * variance[part] * share
                deviation = min(max(wanted, held[part] - longest[part]), held[part] + longest[part])
                left = variance[part] * (1 - slope**2 * variance[part] / total)
                self.estimates[part] = Estimate(deviation, max(left, least[part]), self._at_s)
            change = sum(slope * (self.estimates[part].deviation - held[part]) for part, slope in now.by.items())
            if abs(change) <= _STILL * abs(now.value):
                return

    def _refresh(self, parts: Mapping[Statement, float]) -> None:
        """Note that parts are observed now, so that their estimates do not fade."""
        for part in parts:
            if part in self.estimates:
                known = self._estimate(part)
                self.estimates[part] = replace(known, seen_s=self._at_s)

    def _usual(self, part: Statement) -> float:
        stated = self._environment.stated(part)
        assert stated is not None  # predictions name statements of the library
        return usual_variance(stated)

    def _is_factor(self, part: Statement) -> bool:
        stated = self._environment.stated(part)
        return stated is not None and stated.rule is QualityRule.SCALE

    def _estimate(self, part: Statement) -> Estimate:
        usual = self._usual(part)
        known = self.estimates.get(part)
        return Estimate(0.0, usual, self._at_s) if known is None else known.at(self._at_s, usual)

    def _predicted(
        self, unit: ComputationUnit, stream: Stream, attribute: QualityAttribute, said: float | None = None
    ) -> _Predicted | None:
        """Predict the quality of a stream; None if that is not possible. `said` is the quality that the stream says."""
        transformation = self._environment.transformation[unit.transformation]
        port = transformation.output[stream.port]
        stated = next((each for each in port.quality if each.attribute == attribute.name), None)
        part = Statement(unit.transformation, port.name, attribute.name, unit.host)
        self._trail.add(stream)
        try:
            inputs = self._inputs(unit, attribute)
        finally:
            self._trail.discard(stream)
        if inputs is None:
            return None
        if not inputs:
            return (
                _Predicted(float(attribute.worst)) if stated is None else _clipped(attribute, self._own(part, stated))
            )
        theirs = self._combined(attribute, Over.WORST if stated is None else stated.over, inputs)
        if stated is None or theirs is None:
            return None if theirs is None else _kept(attribute, theirs)
        own = self._own(part, stated)
        match stated.rule:
            case QualityRule.SET:
                return _clipped(attribute, own)
            case QualityRule.ADD:
                return _kept(attribute, own.plus(theirs))
            case QualityRule.SCALE:
                if abs(theirs.value) <= APART_ERRORS * sqrt(theirs.variance):
                    return None
                factor = own.value / MICRO
                scaled = theirs.times(factor)
                return _kept(attribute, scaled.plus(_Predicted(0.0, {part: theirs.value * factor})))
            case QualityRule.LIMIT:
                binding = self._limiting(attribute, own, theirs, said)
                return None if binding is None else _kept(attribute, binding)

    def _limiting(
        self, attribute: QualityAttribute, own: _Predicted, theirs: _Predicted, said: float | None
    ) -> _Predicted | None:
        """Return the worse of an own part and the inputs; None if they do not differ significantly.

        If both the inputs and the stream say how good they are, return the one that explains the stream.
        """
        if said is not None and theirs.by == {}:
            is_bound_by_own = attribute.sign * (said - theirs.value) > NEWS * abs(theirs.value)
            is_own_too_bad = attribute.sign * (own.value - said) > 0
            return own if is_bound_by_own or is_own_too_bad else theirs
        return self._first_if_apart(*sorted((own, theirs), key=lambda one: -attribute.sign * one.value))

    def _own(self, part: Statement, stated: Contribution) -> _Predicted:
        deviation = self._estimate(part).deviation
        if stated.rule is QualityRule.SCALE:
            return _Predicted(stated.stated * exp(deviation), {part: stated.stated * exp(deviation)})
        return _Predicted(stated.stated + deviation, {part: 1.0})

    def _inputs(self, unit: ComputationUnit, attribute: QualityAttribute) -> list[_Predicted] | None:
        """Return the predicted streams at the inputs of a unit; None if one of them can't be predicted."""
        environment, found = self._environment, []
        ordinary = [port.name for port in environment.transformation[unit.transformation].inputs if not port.feedback]
        for stream in (stream for name in ordinary for stream in unit.feeds.get(name, ())):
            provider = environment.unit.get(stream.unit)
            if provider is None or not _is_known(environment, provider) or stream in self._trail:
                return None
            sample = self._samples.get((stream, attribute.name))
            known = (
                self._predicted(provider, stream, attribute)
                if sample is None
                else _Predicted(sample.mean, {}, sample.variance)
            )
            if known is None:
                return None
            journey = environment.latency(attribute.name, provider.host, unit.host)
            found.append(known.plus(_Predicted(float(journey))) if journey else known)
        return found

    def _combined(self, attribute: QualityAttribute, over: Over, inputs: list[_Predicted]) -> _Predicted | None:
        if len(inputs) == 1:
            return inputs[0]
        if over in (Over.SUM, Over.MEAN):
            total = _Predicted(0.0)
            for one in inputs:
                total = total.plus(one)
            return total if over is Over.SUM else total.times(1 / len(inputs))
        worst_first = sorted(inputs, key=lambda one: -attribute.sign * one.value)
        binding, next_to_it = worst_first[:2] if over is Over.WORST else worst_first[:-3:-1]
        return self._first_if_apart(binding, next_to_it)

    def _first_if_apart(self, first: _Predicted, second: _Predicted) -> _Predicted | None:
        """Return the first of two predictions; None if one depends on parts and they do not differ significantly."""
        doubt = APART_ERRORS * sqrt(self._error(first) ** 2 + self._error(second) ** 2)
        is_sure = not (first.by or second.by) or abs(first.value - second.value) > doubt
        return first if is_sure else None

    def _error(self, predicted: _Predicted) -> float:
        """The standard error of a prediction."""
        of_parts = (slope**2 * self._estimate(part).variance for part, slope in predicted.by.items())
        return sqrt(predicted.variance + sum(of_parts))


def _clipped(attribute: QualityAttribute, own: _Predicted) -> _Predicted:
    """An own part that is all of the prediction, within the scale. A value at an end is learned too: no loss."""
    low, high = sorted((attribute.worst, attribute.best))
    return replace(own, value=min(max(own.value, low), high))


def _kept(attribute: QualityAttribute, predicted: _Predicted) -> _Predicted:
    """The prediction within the scale; at its ends it depends on nothing."""
    low, high = sorted((attribute.worst, attribute.best))
    if low < predicted.value < high:
        return predicted
    return _Predicted(min(max(predicted.value, low), high))


def _is_known(environment: Environment, unit: ComputationUnit) -> bool:
    """Whether the environment has the transformation and the host of a unit."""
    is_there = unit.host is None or unit.host in environment.host
    return is_there and unit.transformation in environment.transformation


def _feeders_first(environment: Environment) -> list[ComputationUnit]:
    """The known units, each after its feeders; units in a cycle, or fed by one, are left out."""
    known = {unit.id: unit for unit in environment.units if _is_known(environment, unit)}
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for unit in known.values():
        ports = environment.transformation[unit.transformation].input
        sorter.add(unit.id, *(one.stream.unit for one in unit.subscriptions if not ports[one.port].feedback))
    order: list[str] = []
    with suppress(CycleError):
        sorter.prepare()
    while sorter.is_active():
        ready = sorter.get_ready()
        sorter.done(*ready)
        order += ready
    return [known[unit_id] for unit_id in order if unit_id in known]
