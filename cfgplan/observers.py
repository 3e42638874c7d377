"""Transformations that observe a fact of the world, and those that feed them: none of them may require the fact.

A fact that leaves out its own observer is never observed again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from typing import Final

from cfgplan.domain import Environment, Similarity, Transformation
from cfgplan.facts import Fact, requirement, said
from cfgplan.frozen import dataclass
from cfgplan.noise import settled_variance
from cfgplan.qualities import MICRO

UNKNOWN_RATE_HZ: Final = 1.0
MOST_OF_THE_WAY: Final = Fraction(1, 3)
"""The mean of two bounds' bands may be at most this share of their distance, so that both are passed in time."""


@dataclass(frozen=True, slots=True)
class Circle:
    """A transformation that requires the fact which it observes, or whose observer it feeds."""

    transformation: str
    fact: str
    observer: str

    def __str__(self) -> str:
        how = "observes" if self.observer == self.transformation else f"feeds {self.observer}, which observes"
        return f"{self.transformation} requires {self.fact}, and {how} it"


def observed_tag(environment: Environment, fact: Fact) -> str | None:
    """The tag of the stream that observes a fact; None if none does."""
    found = (target.tag for target in environment.stream_targets if target.topic == fact.observed_on)
    return next(found, None)


def observers(environment: Environment, similarity: Similarity, fact: Fact) -> dict[str, str]:
    """The transformations that may observe a fact, and all that those can't run without, each with one it runs for.

    Inputs that may stay unfed, or close a cycle, are not followed.
    """
    tag = observed_tag(environment, fact)
    if tag is None:
        return {}
    found = {t.label: t.label for t in _giving(environment, similarity, tag)}
    ahead = deque(found)
    while ahead:
        label = ahead.popleft()
        needed = environment.transformation[label]
        more = [other for other in needed.beside if other in environment.transformation]
        for port in needed.inputs:
            if not (port.optional or port.feedback):
                more += [giver.label for giver in _giving(environment, similarity, port.tag)]
        for other in more:
            if other not in found:
                found[other] = found[label]
                ahead.append(other)
    return found


def circles(environment: Environment, similarity: Similarity) -> Iterator[Circle]:
    """Yield the transformations that require a fact which they help to observe."""
    for fact in environment.variable.values():
        for label, observer in observers(environment, similarity, fact).items():
            requires = environment.transformation[label].requires
            if requires is not None and fact.name in {each.fact for each in requirement(requires).comparisons}:
                yield Circle(label, fact.key, observer)


def blurred(environment: Environment, similarity: Similarity) -> Iterator[str]:
    """The bounds that noisy values can't tell apart in time: their bands are most of the way from one to the other.

    The rate of the values is that of the slowest source that they may come from.
    """
    for fact in environment.variable.values():
        bounds = environment.bounds.get(fact.name, ())
        if fact.noise is None or len(bounds) < 2:
            continue
        library = environment.transformation
        rates = [library[label].run.rate_hz for label in observers(environment, similarity, fact)]
        rate_hz = min((rate for rate in rates if rate is not None), default=None)
        variance = settled_variance(rate_hz or UNKNOWN_RATE_HZ)
        for low, high in pairwise(bounds):
            bands = [fact.noise.band(bound, variance) for bound in (low, high)]
            if sum(bands) > 2 * (high - low) * MOST_OF_THE_WAY:
                yield (
                    f"{fact.key} does not tell {said(low)} from {said(high)} in time: a noise of {fact.noise} at "
                    f"{_rate_text(rate_hz)} takes {max(bands) / MICRO:.2g} beyond a bound to be sure; "
                    "observe it more often, or compare it with numbers further apart"
                )


def _rate_text(rate_hz: float | None) -> str:
    if rate_hz is None:
        return f"{UNKNOWN_RATE_HZ:g} value a second (no source says `run: {{rate: ...}}`)"
    return f"{rate_hz:g} {'value' if rate_hz == 1 else 'values'} a second"


def _giving(environment: Environment, similarity: Similarity, tag: str) -> Iterator[Transformation]:
    for transformation in environment.library:
        if any(similarity.holds(port.tag, tag) for port in transformation.outputs):
            yield transformation
