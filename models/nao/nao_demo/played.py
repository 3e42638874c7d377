"""The results of the steps of a play."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from cfgplan_runtime.lifecycle.perturbations import UnitGone
from cfgplan_runtime.lifecycle.reports import Review
from cfgplan_runtime.supervision.observation import Observation

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Subscription
from nao_demo.listening import Sample
from nao_demo.story import Step

TOPIC = "/result"
FRAME_NS = 1_000_000_000 / 15


@dataclass(frozen=True, slots=True)
class Alternative:
    """A plan that was not chosen, and its cost in microseconds of CPU time over the horizon."""

    what: str
    cost_us: int


@dataclass(frozen=True, slots=True)
class Silence:
    """The longest time without a position: the last position before it, the first after it, and the frames between."""

    last: Sample
    first: Sample
    lost_frames: int


@dataclass(frozen=True)
class Played:
    """The result of a step.

    Times are in nanoseconds since the epoch; `first` is the first position of a picture taken after the step began.
    """

    step: Step
    began_ns: int
    ended_ns: int
    before: Environment
    after: Environment
    review: Review
    others: tuple[Alternative, ...] = ()
    samples: tuple[Sample, ...] = ()
    observed: tuple[Observation, ...] = ()
    first: Sample | None = None
    silence: Silence | None = None

    @property
    def gone(self) -> tuple[str, ...]:
        """The units that have died."""
        return tuple(one.unit for one in self.review.perturbations if isinstance(one, UnitGone))

    @property
    def left(self) -> Environment:
        """The configuration before the step, without the units that died, and with the targets after the step."""
        units = (replace(u, subscriptions=_living(u, self.gone)) for u in self.before.units if u.id not in self.gone)
        return replace(self.before, units=tuple(units), targets=self.after.targets)

    @property
    def changes(self) -> ChangeSet:
        """The changes from `left` to the configuration afterwards."""
        return self.left.change_to(self.after.units)

    @property
    def source(self) -> str | None:
        """The transformation whose positions are on the topic after the step."""
        publishing = (u for u in self.after.units if any(p.topic == TOPIC for p in u.publications))
        return next((unit.transformation for unit in publishing), None)

    @property
    def updated_ns(self) -> int:
        """The time when the update was complete."""
        return updated_ns(self.review)

    @property
    def settled(self) -> tuple[Sample, ...]:
        """The positions whose pictures were taken after the update."""
        return tuple(sample for sample in self.samples if sample.time_ns >= self.updated_ns)

    @property
    def rms_error_m(self) -> float | None:
        """The root mean square error of the positions after the update, in metres; None without positions."""
        squares = [sample.error_m**2 for sample in self.settled]
        return math.sqrt(sum(squares) / len(squares)) if squares else None


def updated_ns(review: Review) -> int:
    """Return the time when the update of a review was complete, in nanoseconds since the epoch."""
    seconds = sum(took for phase, took in review.seconds.items() if phase != "detect")
    return round((review.time_s + seconds) * 1e9)


def _living(unit: ComputationUnit, gone: Sequence[str]) -> tuple[Subscription, ...]:
    return tuple(subscription for subscription in unit.subscriptions if subscription.stream.unit not in gone)


def silence(samples: Sequence[Sample], began_ns: int, until_ns: int) -> Silence | None:
    """Return the longest pause between two positions that overlaps a span of time, extended by a frame at each end.

    None without a pause.
    """
    near = [
        (last, first)
        for last, first in pairwise(samples)
        if first.time_ns > began_ns - FRAME_NS and last.time_ns < until_ns + FRAME_NS
    ]
    if not near:
        return None
    last, first = max(near, key=lambda pair: pair[1].time_ns - pair[0].time_ns)
    return Silence(last, first, max(0, round((first.time_ns - last.time_ns) / FRAME_NS) - 1))
