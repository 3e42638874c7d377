"""From what happens to units to perturbations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cfgplan_runtime.lifecycle.configuration import Situation
from cfgplan_runtime.lifecycle.perturbations import SubscriptionLost, UnitGone, UnitKeepsFailing
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.supervision.delays import doubling_s
from cfgplan_runtime.supervision.events import (
    Event,
    InputLost,
    UnitDied,
    UnitFailed,
    UnitHung,
    UnitReady,
    UnitStatus,
    UnitStopped,
    UnitTooLarge,
)

IN_A_ROW_S = 10.0
"""The same input that is lost again within so much time is lost in a row."""


@dataclass(slots=True)
class _Failing:
    """The counts and the time since which a unit has had no step without an error."""

    since_s: float
    steps: int
    errors: int


class Noticing:
    """Tells which events are perturbations. What a unit's end is due to is told by the events before."""

    def __init__(self, situation: Situation, policy: Policy) -> None:
        self._situation = situation
        self._policy = policy
        self._ends: dict[str, Literal["hung", "too large"]] = {}
        self._failing: dict[str, _Failing] = {}
        self._last_error: dict[str, str] = {}
        self._losses: dict[SubscriptionLost, tuple[int, float]] = {}
        """How often each has been lost in a row, and when last."""

    def delay_s(self, lost: SubscriptionLost, at_s: float) -> float:
        """How long a lost input waits for a review: for the death that explains it, and longer if it is lost again."""
        times, last_s = self._losses.get(lost, (0, at_s))
        times = times + 1 if at_s - last_s < IN_A_ROW_S else 1
        self._losses[lost] = times, at_s
        policy = self._policy
        return max(policy.explain_s, doubling_s(times - 1, policy.retry_s, policy.most_loss_s))

    def perturbation(self, event: Event, at_s: float) -> UnitGone | UnitKeepsFailing | SubscriptionLost | None:
        """The perturbation that an event is, if it is one."""
        match event:
            case UnitReady(unit) | UnitStopped(unit):
                self._forget(unit)
            case UnitHung(unit):
                self._ends[unit] = "hung"
            case UnitTooLarge(unit):
                self._ends[unit] = "too large"
            case UnitFailed(unit, text=text):
                self._last_error[unit] = text or self._last_error.get(unit, "")
            case UnitDied(unit, cause):
                return self._gone(unit, cause)
            case InputLost(unit_or_none, port):
                return SubscriptionLost(unit_or_none, port)
            case UnitStatus(unit):
                return self._still_failing(unit, event, at_s)
        return None

    def _forget(self, unit: str) -> None:
        """A unit is gone, or another has its id."""
        self._ends.pop(unit, None)
        self._failing.pop(unit, None)
        self._last_error.pop(unit, None)

    def _gone(self, unit: str, cause: str) -> UnitGone | None:
        label = self._situation.label_of(unit)
        how = "killed" if unit in self._situation.killed else self._ends.get(unit, "died")
        self._forget(unit)
        return None if label is None else UnitGone(unit, label, how, cause)  # type: ignore[arg-type]

    def _still_failing(self, unit: str, status: UnitStatus, at_s: float) -> UnitKeepsFailing | None:
        label = self._situation.label_of(unit)
        if label is None or unit in self._situation.failing:
            return None
        record = self._failing.get(unit)
        errors = 0 if record is None else status.errors - record.errors
        # The step that has begun last may not have failed yet.
        if record is None or status.steps - record.steps > errors + 1 or errors == 0:
            self._failing[unit] = _Failing(at_s, status.steps, status.errors)
            return None
        if errors < self._policy.failing_steps or at_s - record.since_s < self._policy.failing_s:
            return None
        return UnitKeepsFailing(unit, label, errors, self._last_error.get(unit, ""))
