"""What observes the facts of the world, and what it needs for that: none of it may require the fact.

A fact that leaves out its own observer is never observed again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from cfgplan.domain import Environment, Similarity, Transformation
from cfgplan.facts import Fact, requirement


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
    """The transformations that require what they help to observe."""
    for fact in environment.facts:
        for label, observer in observers(environment, similarity, fact).items():
            requires = environment.transformation[label].requires
            if requires is not None and fact.name in {each.fact for each in requirement(requires).comparisons}:
                yield Circle(label, fact.name, observer)


def _giving(environment: Environment, similarity: Similarity, tag: str) -> Iterator[Transformation]:
    for transformation in environment.library:
        if any(similarity.holds(port.tag, tag) for port in transformation.outputs):
            yield transformation
