"""The state of a manager as one value: the world, the running configuration, the perturbations, and the
work under way.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from math import inf
from typing import Literal, TypeAlias

from cfgplan.api import World
from cfgplan.domain import ChangeSet, Environment, Transformation
from cfgplan.errors import Fault
from cfgplan.noise import NoisyMean
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.configuration import PlanInput, Situation
from cfgplan_runtime.lifecycle.deliberation import Findings
from cfgplan_runtime.lifecycle.inbox import Asked, Outcome
from cfgplan_runtime.lifecycle.link_rates import LinkRates
from cfgplan_runtime.lifecycle.looks import Looks, known_places, last_seen_s
from cfgplan_runtime.lifecycle.perturbations import Perturbation, SubscriptionLost, UnitGone, UpdateFailed
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Phase, Review
from cfgplan_runtime.lifecycle.seen_qualities import SeenQualities
from cfgplan_runtime.lifecycle.silence import Giving
from cfgplan_runtime.lifecycle.worlds import WorldVersion
from cfgplan_runtime.supervision.observation import Observation


@dataclass(frozen=True, slots=True)
class Entry:
    """A perturbation, the time of its notice, the time at which a review is due, and the requests that wait for that
    review.
    """

    perturbation: Perturbation
    at_s: float
    due_s: float
    outcomes: tuple[Outcome, ...] = ()


@dataclass(frozen=True, slots=True)
class Heard:
    """The time of a fact's last value, and the mean of its values if they are noisy."""

    at_s: float
    mean: NoisyMean | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """The record of a unit's troubles: the reason why it is being killed, its last error, and the time when it last
    worked.

    `well` is the time of the first sign of life, or of the last one with good steps after errors; with it, the steps
    and errors until then.
    """

    end: Literal["hung", "too large"] | None = None
    error: str = ""
    well: tuple[float, int, int] | None = None


@dataclass(frozen=True, slots=True)
class Gathering:
    """A review is due: perturbations until `until_s` are part of it."""

    until_s: float


@dataclass(frozen=True, slots=True)
class Planning:
    """A review is under way: its plan number `plans` is being made, for the running units in `world`."""

    number: int
    at_s: float
    time_s: float
    detect_s: float
    world: World
    entries: tuple[Entry, ...] = ()
    plans: int = 0
    optimises: bool = False


@dataclass(frozen=True, slots=True)
class Updating:
    """An update is under way. `gone` are new units of it that have died, with how long each lived (None: blameless)."""

    planning: Planning
    findings: Findings
    change_set: ChangeSet
    gone: tuple[tuple[UnitGone, float | None], ...] = ()

    @property
    def starting(self) -> frozenset[str]:
        """Ids of the new units. Their deaths wait for the update's end; the death of another unit abandons it."""
        return frozenset(unit.id for unit in self.change_set.started)


Doing: TypeAlias = Gathering | Planning | Updating | None


@dataclass(frozen=True, slots=True)
class State:
    """Everything that the next decision of a manager depends on; a value. Times: seconds on the manager's clock."""

    policy: Policy
    version: WorldVersion
    situation: Situation
    running: Environment = field(default_factory=Environment)
    """The running configuration, as of the last event."""
    doing: Doing = None
    entries: tuple[Entry, ...] = ()
    """The perturbations that no review has begun to answer."""
    waiting: Mapping[str, tuple[Outcome, ...]] = field(default_factory=dict)
    """By unit: the requests that wait for the review after its end."""
    notes: Mapping[str, Note] = field(default_factory=dict)
    failed: frozenset[str] = frozenset()
    """The transformations whose last back-off is reported as soon as a plan shows whether it is shortened."""
    losses: Mapping[SubscriptionLost, tuple[int, float]] = field(default_factory=dict)
    """How often each subscription was lost in a row, and when last."""
    giving: Giving = field(default_factory=Giving)
    heard: Mapping[str, Heard] = field(default_factory=dict)
    """By fact of the world that a stream observes: what came last."""
    seen: SeenQualities = field(default_factory=SeenQualities)
    looks: Looks = field(default_factory=Looks)
    link_rates: LinkRates = field(default_factory=LinkRates)
    faults: tuple[Fault, ...] = ()
    """The faults of the last version of the world's file."""
    old_code: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By file of unit code that has changed: the units that run with the code from before."""
    stops: tuple[Outcome, ...] = ()
    """The requests for the end."""
    previews: tuple[Future[Preview], ...] = ()
    """The requests for a preview."""
    given: tuple[Asked, ...] = ()
    """Plans to carry out and units to restart, as soon as no review is due or under way."""
    is_closing: bool = False
    is_over: bool = False
    number: int = 0
    """The number of the last review."""
    failures: int = 0
    """How many updates have failed in a row."""
    owes_optimising: bool = False
    """Whether an optimising review has failed."""
    reviews: tuple[Review, ...] = ()
    costs: Mapping[str, Transformation] = field(default_factory=dict)
    """The library of the last review, with estimated costs, by label."""
    match_s: float = 0.0
    """Wall time that matching has taken since the last review."""
    cycle_began_s: float = inf
    observe_at_s: float = inf
    observations: Mapping[str, Observation] = field(default_factory=dict)

    @property
    def plan_input(self) -> PlanInput:
        """The input of a plan that is made now."""
        return PlanInput(self.situation.as_it_is(self.version.world), self.running, self.situation)

    @property
    def phase(self) -> Phase:
        if self.is_over:
            return Phase.STOPPED
        return Phase.STABLE if self.doing is None else Phase.REVIEW

    @property
    def due_s(self) -> float:
        """The time at which the next review is due; inf without a perturbation."""
        return min((entry.due_s for entry in self.entries), default=inf)

    @property
    def horizon_at_s(self) -> float:
        """When the review at the horizon is due; not during a look, which it would end."""
        return inf if self.looks.units else self.cycle_began_s + (self.version.world.horizon_s or inf)

    @property
    def silence_at_s(self) -> float:
        """When the first of the facts that streams observe will have been silent for too long; inf if none may be."""
        return min(self.silences_of_facts.values(), default=inf)

    @property
    def silences_of_facts(self) -> dict[str, float]:
        """By fact that was heard of and may not be silent for ever: when it will have been silent for too long."""
        facts = self.version.world.environment.variable
        limits = {name: facts[name].silent_us for name in self.heard if name in facts}
        return {
            name: self.heard[name].at_s + limit_us / 1e6 for name, limit_us in limits.items() if limit_us is not None
        }

    @property
    def known_places(self) -> frozenset[Place]:
        """The places on hosts where a transformation runs, was observed, or was looked at."""
        return known_places(self.running, self.seen.estimates, self.looks)

    @property
    def looks_due_s(self) -> dict[Place, float]:
        """When the next look may be due at each place that can be observed and has no running unit, in this order."""
        every_s, environment = self.policy.look_every_s, self.version.world.environment
        if every_s is None or not environment.observable:
            return {}
        seen_s = last_seen_s(environment, self.running, self.seen.estimates, self.known_places)
        due_s = {place: self.looks.due_s(place, last_s, every_s) for place, last_s in seen_s.items()}
        return dict(sorted(due_s.items(), key=lambda one: (one[1], one[0].label, one[0].host or "")))

    @property
    def look_at_s(self) -> float:
        """When the next look is due; inf if there is nothing to look at, and until no perturbation waits."""
        if self.looks.units or self.entries:
            return inf
        first_s = min(self.looks_due_s.values(), default=inf)
        if first_s == inf:
            return inf
        qualities, units = self.situation.qualities, self.running.units
        return max(first_s, self.looks.next_s(qualities, units, self.policy.look_every_s or 0.0))

    @property
    def wake_s(self) -> float:
        """The time at which the manager has to act if no item comes in."""
        if isinstance(self.doing, Gathering):
            return self.doing.until_s
        if self.has_waiting_plans:
            return min(self.due_s, 0.0)
        return min(
            self.due_s,
            self.situation.back_offs.next_end_s,
            self.horizon_at_s,
            self.observe_at_s,
            self.silence_at_s,
            self.looks.until_s,
            self.look_at_s,
        )

    @property
    def has_waiting_plans(self) -> bool:
        """Whether a plan was requested or given, and no change of the configuration is imminent."""
        return self.doing is None and not self.waiting and bool(self.previews or self.given)

    @property
    def is_settled(self) -> bool:
        """Whether no unit's end is awaited, and no review due or under way but retries after a middleware's fault."""
        faults = (isinstance(each.perturbation, UpdateFailed) and each.perturbation.is_fault for each in self.entries)
        return self.doing is None and all(faults) and not (self.waiting or self.previews or self.given)
