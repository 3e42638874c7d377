"""Supposed changes: the plan that a review would make after a change, in the calling thread; no review waits for it."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace

from cfgplan import costs
from cfgplan.domain import Host, Transformation
from cfgplan.errors import InputError
from cfgplan.planning import Planner
from cfgplan_runtime.lifecycle import changes
from cfgplan_runtime.lifecycle.configuration import PlanInput, check_host
from cfgplan_runtime.lifecycle.deliberation import Deliberation, Findings
from cfgplan_runtime.lifecycle.guarded_estimator import GuardedEstimator
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.state import State
from cfgplan_runtime.lifecycle.warm_matching import WarmMatching
from cfgplan_runtime.supervision.observation import Observation


class LastEstimates:
    """An estimator that repeats the costs of the last review, by label, and declared costs for other transformations.

    Unlike the manager's estimator, it may be asked in any thread.
    """

    def __init__(self) -> None:
        self.known: Mapping[str, Transformation] = {}

    def observe(self, observations: Sequence[Observation], now_s: float) -> None:
        """Do nothing: the costs are those of the last review."""

    def failed(self, transformation: str, now_s: float, host: str | None = None) -> None:
        """Do nothing: the costs are those of the last review."""

    def labor_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:  # noqa: ARG002
        return costs.labor_us(self.known.get(transformation.label, transformation), host)

    def upkeep_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:  # noqa: ARG002
        return costs.upkeep_us(self.known.get(transformation.label, transformation), host)


class Supposing:
    """Plans for supposed changes, one after the other, with a matching and a planner session of its own."""

    def __init__(self, planner: Planner | None, policy: Policy) -> None:
        self._planner = planner
        self._policy = policy
        self._lock = threading.Lock()
        self._estimates = LastEstimates()
        self._matching: WarmMatching | None = None
        self._deliberation: Deliberation | None = None

    def think(self, state: State, change: changes.Change) -> Findings:
        """Return the findings of an optimising review after a change. Raises InputError for a change that is bad, or
        that can't be supposed.
        """
        plan_input = supposed_input(state, change)
        with self._lock:
            if self._matching is None or self._deliberation is None:
                self._matching = WarmMatching(self._policy.reasoner, self._policy.match_limit_s)
                guarded = GuardedEstimator(self._estimates)
                self._deliberation = Deliberation(self._planner, guarded, self._policy, self._matching)
            self._estimates.known = state.costs
            self._matching.take(plan_input.world)
            return self._deliberation.think(plan_input, optimises=True, stop=threading.Event())


def supposed_input(state: State, change: changes.Change) -> PlanInput:
    """Return the input of a plan after a change of the world, or of the hosts in service. Raises InputError."""
    situation = state.situation
    match change:
        case changes.LoseHost(host):
            check_host(state.version.world.environment, host)
            given_up = replace(situation, given_up_hosts=situation.given_up_hosts | {host})
            return replace(state.plan_input, situation=given_up)
        case changes.RegainHost(host):
            check_host(state.version.world.environment, host)
            return replace(
                state.plan_input, situation=replace(situation, given_up_hosts=situation.given_up_hosts - {host})
            )
        case (
            changes.KillUnit()
            | changes.RestartUnits()
            | changes.SetFact()
            | changes.FaultyCode()
            | changes.ReviewNow()
            | changes.ApplyPlan()
            | changes.Stop()
        ):
            mend = "suppose a change of targets, transformations, individuals or hosts"
            raise InputError.of(f"{type(change).__name__} can't be supposed", mend=mend)
        case change:
            return replace(state.plan_input, world=situation.as_it_is(state.version.after(change).world))
