"""The values of decisions: the inputs of a manager, its effects, and the transition from a state to the next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import msgspec

from cfgplan.domain import ChangeSet, Environment, Statement
from cfgplan.errors import InputError
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.changes import WorldChange
from cfgplan_runtime.lifecycle.configuration import PlanInput, Situation
from cfgplan_runtime.lifecycle.deliberation import Findings, Looked
from cfgplan_runtime.lifecycle.inbox import Asked, Item, Outcome
from cfgplan_runtime.lifecycle.perturbations import Perturbation, Started
from cfgplan_runtime.lifecycle.reports import BackedOff, Perturbed, Report, Review
from cfgplan_runtime.lifecycle.state import Entry, State
from cfgplan_runtime.lifecycle.worlds import WorldVersion
from cfgplan_runtime.supervision.backend import Failures
from cfgplan_runtime.supervision.observation import Observation

# Inputs, besides the items of the inbox.


@dataclass(frozen=True, slots=True)
class Tick:
    """All items have been handled; `time_s` is the time since 1970."""

    time_s: float


@dataclass(frozen=True, slots=True)
class Matched:
    """The world after a change was matched within `seconds`; or the change is bad, and `found` is the error."""

    asked: Asked
    found: WorldVersion | InputError
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Seen:
    """Units were observed."""

    observations: tuple[Observation, ...]


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan was made; if it `was_interrupted`, an item has come that it does not know."""

    findings: Findings
    was_interrupted: bool = False


@dataclass(frozen=True, slots=True)
class GivenJudged:
    """The findings about a given plan; without a change set it is not valid here, for the reason in `cause`."""

    findings: Findings


@dataclass(frozen=True, slots=True)
class Updated:
    """An update took `seconds` of wall time; `error` is set if it failed."""

    seconds: float = 0.0
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class Finished:
    """The manager's work is over: all units are stopped, or something has gone wrong that `cause` names."""

    cause: str = ""


Input: TypeAlias = Item | Started | Tick | Matched | Seen | Planned | GivenJudged | Looked | Updated | Finished


@dataclass(frozen=True, slots=True)
class TimedInput:
    """An input, its time on the manager's clock, and the configuration that runs then."""

    at_s: float
    what: Input
    running: Environment


# Effects.


class Effect(msgspec.Struct, frozen=True):
    """An effect that a manager has to carry out; each kind is a class of its own."""


class Tell(Effect, frozen=True):
    """Report something."""

    report: Report


class Respond(Effect, frozen=True):
    """Answer a request: with the finished review, with None if none will follow, or with an error."""

    outcome: Future[Any]
    answer: Review | Exception | None = None


class Match(Effect, frozen=True):
    """Make and match the world after a change: Matched follows at once."""

    version: WorldVersion
    asked: Asked
    change: WorldChange


class Terminate(Effect, frozen=True):
    """End a unit at once."""

    unit: str


class Observe(Effect, frozen=True):
    """Observe all units, and let the estimator learn from that: Seen follows at once."""


class LearnOfFailure(Effect, frozen=True):
    """Let the estimator learn that a unit of a transformation has failed, on a host."""

    place: Place


class Remember(Effect, frozen=True):
    """Let the middleware keep the failures at a place for the next manager; None: forget them."""

    place: Place
    failures: Failures | None


class MakePlan(Effect, frozen=True):
    """Plan an update: Planned follows. If it `is_last` of its review, only the manager's end interrupts it."""

    plan_input: PlanInput
    optimises: bool
    is_last: bool


class MakePreview(Effect, frozen=True):
    """Answer a request for a preview, unless an item comes in between: then it is requested again."""

    plan_input: PlanInput
    outcomes: tuple[Future[Preview], ...]


class JudgeGiven(Effect, frozen=True):
    """Judge a change set that was given: GivenJudged follows at once."""

    plan_input: PlanInput
    change_set: ChangeSet


class MakeLook(Effect, frozen=True):
    """Plan as if transformations were as good as hoped, to run one of them for a moment: Looked follows."""

    plan_input: PlanInput
    hopes: Mapping[Place, Mapping[Statement, int]]
    """By place, in the order in which looks are due: the deviations that outputs may have there."""
    unmet: Mapping[str, str]
    known: frozenset[Place]
    """The known places on hosts: the hope of a place without a host does not count there."""


class ApplyUpdate(Effect, frozen=True):
    """Carry out an update of `basis`: Updated follows."""

    change_set: ChangeSet
    basis: Environment


class Prepare(Effect, frozen=True):
    """Let the planner prepare to repair the running units, unless an item has come."""

    plan_input: PlanInput


class StopAll(Effect, frozen=True):
    """Stop every unit: Finished follows."""


@dataclass(frozen=True, slots=True)
class Transition:
    """A step of the manager: its next state, and the effects to carry out. Immutable: each method returns a new one."""

    state: State
    at_s: float
    effects: tuple[Effect, ...] = ()

    def to(self, state: State) -> Transition:
        return replace(self, state=state)

    def also(self, *effects: Effect) -> Transition:
        return replace(self, effects=(*self.effects, *effects))

    def situated(self, situation: Situation) -> Transition:
        return self.to(replace(self.state, situation=situation))

    def perturbed(
        self, perturbation: Perturbation, outcomes: Iterable[Outcome] = (), *, delay_s: float = 0.0
    ) -> Transition:
        """Tell of a perturbation, and have a review answer it after a delay."""
        entry = Entry(perturbation, self.at_s, self.at_s + delay_s, tuple(outcomes))
        entries = (*self.state.entries, entry)
        return self.to(replace(self.state, entries=entries)).also(Tell(Perturbed(perturbation)))

    def blamed(self, place: Place, lived_s: float, cause: str, *, is_costly: bool = False) -> Transition:
        """Note a failure of a transformation whose unit has lived so long; see `BackOffs.after_failure`."""
        situation = self.state.situation
        back_offs = situation.back_offs.after_failure(place, lived_s, self.at_s, cause, is_costly=is_costly)
        transition = self.also(LearnOfFailure(place)).situated(replace(situation, back_offs=back_offs))
        return transition.to(replace(transition.state, failed=transition.state.failed | {place.label}))

    def telling_of_failed(self) -> Transition:
        """Report the back-offs of the transformations that have failed since the last plan."""
        told = self
        for label in sorted(self.state.failed):
            told = told.telling_back_off(label)
        return told.to(replace(told.state, failed=frozenset())) if self.state.failed else self

    def telling_back_off(self, label: str) -> Transition:
        """Report the back-off of a transformation, if it has one now."""
        views = self.state.situation.back_offs.view(self.at_s)
        return self.also(*(Tell(BackedOff(view)) for view in views if view.transformation == label))

    def answered(self, unit: str) -> Transition:
        """Tell those who wait for a unit's end that no review will follow."""
        outcomes = self.state.waiting.get(unit, ())
        return self.no_more_awaited(unit).also(*(Respond(outcome) for outcome in outcomes))

    def no_more_awaited(self, unit: str) -> Transition:
        """Forget who waits for a unit's end."""
        left = {other: outcomes for other, outcomes in self.state.waiting.items() if other != unit}
        return self.to(replace(self.state, waiting=left)) if len(left) < len(self.state.waiting) else self
