"""The reports of a manager: the record of a review, a view of its whole state, and its events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import msgspec

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Stream
from cfgplan.errors import Fault
from cfgplan.facts import Fact
from cfgplan.planning import Pair
from cfgplan_runtime.lifecycle.perturbations import Perturbation
from cfgplan_runtime.supervision.events import Event
from cfgplan_runtime.supervision.observation import Observation


class Decision(StrEnum):
    """How a review ended."""

    APPLIED = "applied"
    """The configuration was changed."""
    KEPT = "kept"
    """No configuration is better than the running one."""
    DEFERRED = "deferred"
    """The running configuration is valid and meets all targets that can be met; a cheaper one waits for the horizon."""
    FAILED = "failed"
    """The update was undone or refused; another review follows."""
    UNDECIDED = "undecided"
    """No plan was found in time, or matching was impossible; another review follows."""


PHASES = ("detect", "match", "estimate", "plan", "judge", "apply")


@dataclass(frozen=True)
class Review:
    """One review interval.

    It began at `at_s` on the manager's clock, which is `time_s` since 1970. `seconds` is the wall time of each of
    PHASES: `detect` from the first perturbation to the beginning, `plan` with the questions to the reasoner about open
    pairs. Costs are over the horizon, in microseconds of CPU time: `cost_before_us` of keeping the configuration as it
    was, gaps included, `cost_us` of the plan, its labor included. `change_set` was applied, or would be. `unmet` gives
    the reason for each target that is given up. `is_proven` is true if no plan is cheaper.
    """

    number: int
    at_s: float
    time_s: float
    perturbations: tuple[Perturbation, ...]
    decision: Decision
    horizon_s: int
    cost_before_us: int
    cost_us: int | None = None
    bound_us: int = 0
    is_proven: bool = False
    change_set: ChangeSet | None = None
    met: tuple[str, ...] = ()
    unmet: Mapping[str, str] = field(default_factory=dict, hash=False)
    avoided: Mapping[str, str] = field(default_factory=dict, hash=False)
    """The transformations that were left out, with the reason: failures, a host that is gone, or facts."""
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)
    warnings: tuple[str, ...] = ()
    cause: str = ""
    """Why it failed or was undecided."""
    undecided: tuple[Pair, ...] = ()
    """The open (offered, demanded) pairs of tags that a better plan may use."""
    external: tuple[str, ...] = ()
    """The new units that run already: external nodes of ROS."""
    is_undone: bool = False
    """Whether a step of the update failed for `cause`, and all was undone."""


@dataclass(frozen=True)
class TargetView:
    """A target now: the unit that meets it, with its stream if the target wants one, or the reason why none does."""

    label: str
    tag: str
    topic: str
    priority: int
    stream: Stream | None = None
    reason: str = ""
    is_silent: bool = False
    """Whether it has been silent for longer than it may."""
    unit: str | None = None

    @property
    def is_met(self) -> bool:
        return self.unit is not None and not self.is_silent


@dataclass(frozen=True)
class UnitView:
    """A unit now; `observation` is the last one, None before the first. `is_prepared` concerns cold spares."""

    unit: ComputationUnit
    host: str | None = None
    observation: Observation | None = None
    is_prepared: bool = False


@dataclass(frozen=True, slots=True)
class BackingOff:
    """A transformation that keeps failing; it is not started again for `left_s` seconds (inf: until it changes).

    If it has failed on a `host`, it may be started on other ones.
    """

    transformation: str
    failures: int
    left_s: float
    cause: str
    host: str | None = None


@dataclass(frozen=True, slots=True)
class QualityView:
    """The own part of an output, as observed streams have taught it; in micro-units, a factor in millionths.

    Plans go by `planned`: the `stated` value until the `estimate` is another for sure. `error` is the standard error of
    the estimate, which was observed last `ago_s` seconds ago. `host` is where it was learned; None without hosts.
    """

    transformation: str
    output: str
    attribute: str
    host: str | None
    stated: int
    planned: int
    estimate: int
    error: int
    ago_s: float


class Phase(StrEnum):
    """Where in its cycle a manager is."""

    REVIEW = "review"
    STABLE = "stable"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Snapshot:
    """The state of a run at one moment; `at_s` is on the manager's clock.

    `environment` holds the running units, and the library (with declared costs) and targets that count now. `cost_us`
    is the cost of keeping the units over the horizon, by the estimates. `horizon_left_s` is the time until the horizon
    is reached. `reviews` are the last ones, the newest last. `faults` are those of the world's file; the last valid
    version holds.
    """

    at_s: float
    phase: Phase
    environment: Environment
    targets: tuple[TargetView, ...]
    units: tuple[UnitView, ...]
    pending: tuple[Perturbation, ...]
    reviews: tuple[Review, ...]
    backing_off: tuple[BackingOff, ...]
    lost_hosts: tuple[str, ...]
    declared: tuple[str, ...]
    """Names under which something was declared."""
    horizon_s: int
    horizon_left_s: float
    cost_us: int
    saving_us: int = 0
    """The saving of the update that was put off until the horizon, in microseconds of CPU time."""
    faults: tuple[Fault, ...] = ()
    removed: tuple[str, ...] = ()
    """Labels and names that were removed on request."""
    clocks_ahead_us: Mapping[str, int] = field(default_factory=dict)
    """By joined host: the microseconds by which its clock is ahead of the manager's."""
    facts: tuple[Fact, ...] = ()
    """The facts of the world and of each host as they are now."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """The reasons why transformations may not run with the present facts, by label."""
    barred: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """The reasons why transformations may not run on hosts with the present facts of these, by label and host."""
    facts_heard_s: Mapping[str, float] = field(default_factory=dict)
    """By fact that a stream observes: how long ago its last value came."""
    qualities_now: Mapping[str, str] = field(default_factory=dict)
    """The qualities that follow facts or were observed; see `Environment.qualities_now`."""
    qualities: tuple[QualityView, ...] = ()
    """What observed streams have taught of outputs."""
    old_code: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By file of unit code that has changed: the units that run with the code from before."""


class Report(msgspec.Struct, frozen=True):
    """A report of a manager; each kind is a class of its own."""


class Perturbed(Report, frozen=True):
    """A perturbation was noticed."""

    perturbation: Perturbation


class ReviewBegan(Report, frozen=True):
    """A review interval begins."""

    number: int
    perturbations: tuple[Perturbation, ...]


class Reviewed(Report, frozen=True):
    """A review interval is over."""

    review: Review


class UnitEvent(Report, frozen=True):
    """Something happened to a unit, on its host if it has one; all but signs of life."""

    event: Event
    host: str | None = None


class Observed(Report, frozen=True):
    """Units were observed and the estimator told."""

    observations: tuple[Observation, ...]


class BackedOff(Report, frozen=True):
    """A transformation has failed again and is not started for some time.

    `backing_off` has the transformation, the number of its failures, left_s (the seconds until it may start again),
    the cause and the host (null: on any host).
    """

    backing_off: BackingOff


class WorldRefused(Report, frozen=True):
    """The environment file has errors (`faults` with message, file, line, mend), and the last valid version holds; if
    `faults` is empty, the file is valid again.
    """

    by: str
    faults: tuple[Fault, ...]


class OldCodeRuns(Report, frozen=True):
    """The unit code in `file` has changed, and these `units` run with the code from before; if `units` is empty, none
    does any more: the code was changed back, or these units have ended.
    """

    file: str
    units: tuple[str, ...]


class FactSilent(Report, frozen=True):
    """The stream that observes a fact has been silent for so long that the declared value counts again."""

    fact: str
    silent_s: float
    declared: str


class Ended(Report, frozen=True):
    """The manager has ended, by request or by a `cause`."""

    cause: str = ""
