"""The quality of streams: attributes, their propagation along the wiring, and the demands of targets.

All values are integers in micro-units of the attribute. Every rule is monotone: a better input never gives a
worse output. So the best value that a stream can have is well defined, attribute by attribute, and a bound
that the best wiring misses is missed by all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from fractions import Fraction
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Final

from cfgplan.arguments import Natural, checked
from cfgplan.errors import InvalidValueError, did_you_mean
from cfgplan.rows import FOUND, Row, Use

MICRO = 1_000_000
LARGEST_QUALITY = 100_000 * MICRO
"""The end of every scale, in micro-units; with the largest factor it stays far below 2**63."""
LARGEST_FACTOR = 10 * MICRO


def micro_units(value: Decimal | int, largest_micro: int = LARGEST_QUALITY) -> int:
    """A value in micro-units, exactly; raises InvalidValueError for a non-finite, too large or too fine one."""
    number = Decimal(value)
    if not number.is_finite():
        raise InvalidValueError(f"{value} is not a finite number")
    largest = largest_micro // MICRO
    if not -largest <= number <= largest:  # `abs` fails for the largest exponents
        raise InvalidValueError(f"{value} is too large: the limit is {largest:,}")
    if number != round(number, 6):
        raise InvalidValueError(f"{value} is finer than a millionth: write at most six decimals")
    return int(number * MICRO)


def units(micro: int) -> Decimal:
    """A value in units of its attribute, exactly."""
    return (Decimal(micro) / MICRO).normalize()


class Better(StrEnum):
    """The better direction of an attribute's values."""

    LOWER = "lower"
    HIGHER = "higher"


class QualityRule(StrEnum):
    """How an output's value follows from the combined value of its inputs."""

    ADD = "add"
    """Its own value is added, as latencies add up."""
    LIMIT = "limit"
    """The worse of its own value and theirs, as the rate of a stream is that of its slowest part."""
    SCALE = "scale"
    """Theirs times its own value, rounded to the worse side, as an error is amplified or damped."""
    SET = "set"
    """Its own value, whatever they are."""


class Over(StrEnum):
    """How the values of several inputs become one."""

    WORST = "worst"
    BEST = "best"
    MEAN = "mean"
    SUM = "sum"


@dataclass(frozen=True, slots=True, order=True)
@checked
class QualityAttribute:
    """A measure of streams: rate, latency, accuracy or the user's own.

    Values are clamped to the range from `worst` to `best` (micro-units). `worst` is also the value of a source's stream
    that states none. `name` identifies the measure, `better` says which direction is better, and `unit` is printed
    behind values. `rule` applies to outputs that state only a value.
    """

    name: Annotated[str, Row("the name of the attribute; unique")]
    better: Annotated[Better, Row("`lower` or `higher`: which values are better", form="BetterName")]
    rule: Annotated[
        QualityRule,
        Row(
            "`add`, `limit`, `scale` or `set`: the rule of outputs whose quality is only a number",
            form="RuleName",
            use=Use.NONE,
        ),
    ] = QualityRule.ADD
    unit: Annotated[str | None, Row("the unit of measure, as free text; none if absent", use=Use.NONE)] = None
    worst: Annotated[
        int,
        Row(
            "the worst value, also of a source that states no quality; if absent 0, or 100000 with `better: lower`",
            form="PositiveMicro",
            absent=None,
        ),
    ] = -1
    best: Annotated[
        int,
        Row(
            "the best value, from which `weight` counts; if absent 100000, or 0 with `better: lower`",
            form="PositiveMicro",
            absent=None,
        ),
    ] = -1

    def __post_init__(self) -> None:
        low, high = 0, LARGEST_QUALITY
        is_low = self.better is Better.LOWER
        if self.worst == -1:
            object.__setattr__(self, "worst", high if is_low else low)
        if self.best == -1:
            object.__setattr__(self, "best", low if is_low else high)
        if not (low <= self.best <= high and low <= self.worst <= high and not self.is_better(self.worst, self.best)):
            raise InvalidValueError(f"the scale of {self.name} is wrong: its worst value is better than its best")

    def shown(self, value: int) -> str:
        """A value for people: `0.3 m`."""
        return f"{units(value):f}{' ' + self.unit if self.unit else ''}"

    def is_better(self, one: int, other: int) -> bool:
        """Whether the value `one` is better than `other`."""
        return one < other if self.better is Better.LOWER else one > other

    @property
    def sign(self) -> int:
        """1 where less is better, else -1."""
        return 1 if self.better is Better.LOWER else -1

    @property
    def scale(self) -> int:
        """How bad the worst value is."""
        return self.badness(self.worst)

    def badness(self, value: int) -> int:
        """By how much a value misses the best, in micro-units; less than 0 if it is better."""
        return self.sign * (value - self.best)

    def at(self, badness: int) -> int:
        """The value that misses the best by `badness`."""
        return self.best + self.sign * badness


MEASURES: Final[Mapping[str, tuple[str | None, ...]]] = MappingProxyType(
    {"rate": (None, "Hz", "1/s"), "age": (None, "s"), "jitter": (None, "s"), "loss": (None,)}
)
"""The qualities of streams that a run measures, each with the units that its attribute may have; `loss` is a share."""


@dataclass(frozen=True, slots=True, order=True)
@checked
class Curve:
    """How a value follows a fact of the world: straight lines between points (fact, value), level beyond the ends.

    Both are in millionths.
    """

    fact: str
    points: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        facts = [fact for fact, _ in self.points]
        if len(facts) < 2 or any(low >= high for low, high in pairwise(facts)):
            raise InvalidValueError(f"the points by {self.fact} do not rise: write two or more, the least fact first")

    def at(self, fact: int) -> int:
        """The value for a value of the fact."""
        if fact <= self.points[0][0]:
            return self.points[0][1]
        for (low, first), (high, last) in pairwise(self.points):
            if fact <= high:
                return first + round(Fraction((last - first) * (fact - low), high - low))
        return self.points[-1][1]


class Teller(StrEnum):
    """What tells the quality of streams on a topic of ROS, beside them."""

    DIAGNOSTICS = "diagnostics"
    STATISTICS = "statistics"


TELLERS: Final[Mapping[str, str]] = MappingProxyType(
    {Teller.DIAGNOSTICS: "diagnostics.STATUS.KEY", Teller.STATISTICS: "statistics.NODE.age"}
)
"""The forms of `observe` for what topics tell, by their first word."""
STATISTICS: Final = ("age", "period")
"""What a node of ROS 2 with topic statistics tells of the messages that it gets, in seconds."""


@dataclass(frozen=True, slots=True, order=True)
class Told:
    """A number that a topic tells: a `key` of the status of a `name` in diagnostics, or a statistic of a node."""

    teller: Teller
    name: str
    key: str


@dataclass(frozen=True, slots=True, order=True)
@checked
class Contribution:
    """An output's statement about one `attribute`: a `rule`, its own `value` (micro-units) and how inputs are combined.

    `over` says how the values of several inputs become one. An output without inputs that count (all but feedback) has
    its own value, whatever the rule. If the value follows a fact, it is the value for the fact's present state, and
    `by` is the curve. `observe` names the field of an element that gives the element's own quality, in units of the
    attribute, or what a run measures: `measured.` and one of MEASURES, or what a topic of ROS tells beside the
    stream: see `told`. `seen` is the part of `value` that was learned from observed streams; the rest is `stated`.
    `seen_on` has the part learned on each host where it was observed, in micro-units; see `on`.
    """

    attribute: str
    rule: QualityRule
    value: int
    over: Over = Over.WORST
    by: Annotated[Curve | None, FOUND] = None
    observe: Annotated[
        str | None,
        Row(
            "where a run observes the quality: the field of an element, such as `error`, `pose.error` in a mapping "
            "or `covariance.0` in a list; or `measured.NAME`, `diagnostics.STATUS.KEY`, `statistics.NODE.NAME`; not "
            "observed if absent",
            use=Use.RUNNING,
        ),
    ] = None
    seen: Annotated[int, FOUND] = 0
    seen_on: Annotated[tuple[tuple[str, int], ...], FOUND] = ()

    def __post_init__(self) -> None:
        if self.measured is not None and self.measured not in MEASURES:
            mend = did_you_mean(self.measured, MEASURES, f"write measured. and one of {', '.join(MEASURES)}")
            raise InvalidValueError(f"a run does not measure {self.measured!r}: {mend}")
        if self.told is not None and not (self.told.name and self.told.key):
            form = next(form for form in TELLERS.values() if (self.observe or "").startswith(form.partition(".")[0]))
            raise InvalidValueError(f"{self.observe!r} names nothing that a topic tells: write {form}")
        if self.told is not None and self.told.teller is Teller.STATISTICS and self.told.key not in STATISTICS:
            mend = did_you_mean(self.told.key, STATISTICS, f"end it with one of {', '.join(STATISTICS)}")
            raise InvalidValueError(f"topic statistics have no {self.told.key!r}: {mend}")
        is_of_stream = self.measured is not None or (self.told is not None and self.told.teller is Teller.STATISTICS)
        if is_of_stream and self.rule is not QualityRule.SET:
            raise InvalidValueError(
                f"{self.observe} is of the whole stream, not of this transformation alone: write `set` in place of "
                f"`{self.rule}`"
            )
        largest = LARGEST_FACTOR if self.rule is QualityRule.SCALE else LARGEST_QUALITY
        least = -LARGEST_QUALITY if self.rule is QualityRule.ADD else 0
        for value in (*(value for _, value in (self.by.points if self.by else ())), self.value):
            if not least <= value <= largest:
                what = "factor" if self.rule is QualityRule.SCALE else "value"
                raise InvalidValueError(
                    f"the {what} {units(value):f} of {self.attribute} is out of range: "
                    f"write {units(least):f} to {units(largest):f}"
                )

    @property
    def measured(self) -> str | None:
        """What a run measures of the stream itself; None if its elements say it, or nothing is observed."""
        is_measured = self.observe is not None and self.observe.startswith("measured.")
        return self.observe.removeprefix("measured.") if is_measured and self.observe is not None else None

    @property
    def told(self) -> Told | None:
        """What a topic of ROS tells of the stream; None if its elements say it, a run measures it, or nothing is
        observed.
        """
        teller, _, rest = (self.observe or "").partition(".")
        if teller not in TELLERS:
            return None
        name, _, key = rest.rpartition(".")
        return Told(Teller(teller), name, key)

    @property
    def of_stream(self) -> str | None:
        """What `observe` says, unless a topic tells it beside the stream."""
        return None if self.told is not None else self.observe

    @property
    def stated(self) -> int:
        """The own value without what observed streams have taught."""
        return self.value - self.seen

    @property
    def learned(self) -> Mapping[str | None, int]:
        """The part learned from observed streams by host, in micro-units; for None, that of all other hosts."""
        return {None: self.seen, **dict(self.seen_on)} if self.seen else dict(self.seen_on)

    def on(self, host: str | None) -> Contribution:
        """Return the contribution of a unit on a host, with the value that was learned there, if any."""
        if not self.seen_on:
            return self
        seen = dict(self.seen_on).get(host or "", self.seen)
        return replace(self, value=self.stated + seen, seen=seen, seen_on=())

    def taught(self, learned: Mapping[str | None, int]) -> Contribution:
        """Return the contribution whose values differ from the stated one by what was learned, as far as the rule
        allows; see `learned`.
        """
        largest = LARGEST_FACTOR if self.rule is QualityRule.SCALE else LARGEST_QUALITY
        least = -LARGEST_QUALITY if self.rule is QualityRule.ADD else 0
        stated = self.stated
        allowed = {host: min(max(stated + seen, least), largest) - stated for host, seen in learned.items()}
        seen = allowed.pop(None, 0)
        seen_on = tuple(sorted((host, by) for host, by in allowed.items() if host is not None and by != seen))
        return replace(self, value=stated + seen, seen=seen, seen_on=seen_on)


@dataclass(frozen=True, slots=True, order=True)
@checked
class Wish:
    """A target's demand on one `attribute`: a `bound` (micro-units) that its stream must not be worse than, or a price.

    The bound may lie outside the attribute's scale: a bound at or below `worst` is always met, one beyond `best` never.

    The price is `weight_us` microseconds of CPU time for each whole unit by which the value is worse than the best of
    the scale, rounded up to a microsecond.
    """

    attribute: str
    bound: int | None = None
    weight_us: Annotated[
        Natural, Row("a price in CPU seconds, multiplied by the difference between the value and the best one")
    ] = 0


def propagated(attribute: QualityAttribute, contribution: Contribution | None, inputs: Sequence[int]) -> int:
    """Return the value of an output, from its contribution and the values of the inputs that count."""
    if not inputs:
        return _within(attribute, attribute.worst if contribution is None else contribution.value)
    if contribution is None:
        return _combined(attribute, Over.WORST, inputs)
    theirs = _combined(attribute, contribution.over, inputs)
    match contribution.rule:
        case QualityRule.ADD:
            return _within(attribute, theirs + contribution.value)
        case QualityRule.LIMIT:
            is_worse = attribute.is_better(theirs, contribution.value)
            return _within(attribute, contribution.value if is_worse else theirs)
        case QualityRule.SCALE:
            return _within(attribute, _divided(attribute, theirs * contribution.value, MICRO))
        case QualityRule.SET:
            return _within(attribute, contribution.value)


def delayed(attribute: QualityAttribute, value: int, by: int) -> int:
    """Return the value of a stream after a transfer that adds `by` to it."""
    return _within(attribute, value + by) if by else value


def price_us(attribute: QualityAttribute, wish: Wish, value: int) -> int:
    """Return the price that a target puts on a stream of this value, in microseconds."""
    return -(-wish.weight_us * abs(value - attribute.best) // MICRO)


def is_met(attribute: QualityAttribute, wish: Wish, value: int) -> bool:
    """Whether a value is within a target's bound."""
    return wish.bound is None or not attribute.is_better(wish.bound, value)


def worst_allowed(attribute: QualityAttribute, wish: Wish) -> int:
    """The worst value of the scale within a target's bound; the bound itself if it is better than the whole scale."""
    if wish.bound is not None and attribute.is_better(wish.bound, attribute.worst):
        return wish.bound
    return attribute.worst


def _combined(attribute: QualityAttribute, over: Over, inputs: Sequence[int]) -> int:
    is_low = attribute.better is Better.LOWER
    match over:
        case Over.WORST:
            return max(inputs) if is_low else min(inputs)
        case Over.BEST:
            return min(inputs) if is_low else max(inputs)
        case Over.MEAN:
            return _divided(attribute, sum(inputs), len(inputs))
        case Over.SUM:
            return sum(inputs)


def _divided(attribute: QualityAttribute, number: int, by: int) -> int:
    """A quotient, rounded to the worse side."""
    return -(-number // by) if attribute.better is Better.LOWER else number // by


def _within(attribute: QualityAttribute, value: int) -> int:
    low, high = sorted((attribute.worst, attribute.best))
    return min(max(value, low), high)
