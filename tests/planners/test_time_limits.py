"""Wherever the time is over, the planner ends soon after, with the best plan known and an honest bound.

Nothing is timed: the clock is one that goes on by a second whenever somebody looks at it.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from cfgplan.comparing.families.random_library import random_library
from cfgplan.planners.cpsat import plan
from cfgplan.planners.solving import clock
from cfgplan.planners.solving.clock import STOPPING_S, Clock, OutOfTimeError
from cfgplan.planning import Failures, Plan, Problem, Status
from cfgplan.qualities import MICRO
from cfgplan.validity import plan_violations

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments" / "fleet"))

import instances

FEW_MORE = 40
"""So often somebody may look at the clock once the time is over."""


def with_a_required_one(problem: Problem) -> Problem:
    library = list(problem.environment.library)
    library[-1] = replace(library[-1], required=True)
    return replace(problem, environment=replace(problem.environment, library=tuple(library)))


PROBLEMS = {
    "plain": random_library(0, transformations=60),
    "running": random_library(1, transformations=60, running=0.3),
    "required": with_a_required_one(random_library(0, transformations=30)),
    "weighed quality": instances.weighted(0, 40, 2),
    "bounded quality": instances.bounded(0, 40, 2, most_latency=20 * MICRO),
    "hosts": instances.hosted(0, 40, 2, hosts=2),
    "survival": replace(random_library(0, transformations=12, targets=1), survive=Failures.UNITS),
}


class Looks:
    """A clock that goes on by a second at each look."""

    def __init__(self) -> None:
        self.looks = 0

    def monotonic(self) -> float:
        self.looks += 1
        return float(self.looks)


def after(looks: int, problem: Problem) -> tuple[Plan, int]:
    """The plan when the time is over after so many looks at the clock, and how many there were."""
    fake = Looks()
    with patch.object(clock, "time", SimpleNamespace(monotonic=fake.monotonic)):
        found = plan(problem, time_limit_s=looks)
    return found, fake.looks


def at_all_sizes(most: int) -> Iterator[int]:
    return itertools.takewhile(lambda looks: looks < most, (round(1.6**i) for i in range(60)))


@pytest.mark.parametrize("kind", PROBLEMS)
def test_the_time_may_be_over_at_any_moment(kind: str) -> None:
    problem = PROBLEMS[kind]
    best, enough = after(10**9, problem)
    assert best.status is Status.OPTIMAL
    assert best.cost_us is not None
    for looks in at_all_sizes(enough):
        found, looked = after(looks, problem)
        assert looked <= looks + FEW_MORE
        assert plan_violations(problem, found) == []
        assert found.status in (Status.OPTIMAL, Status.FEASIBLE, Status.UNKNOWN)
        if found.status is Status.FEASIBLE and not found.unused_required:
            assert found.cost_us is not None
            assert found.bound_us <= best.cost_us <= found.cost_us


@pytest.mark.parametrize("kind", PROBLEMS)
def test_soon_after_the_closure_a_plan_is_known(kind: str) -> None:
    best, _ = after(10**9, PROBLEMS[kind])
    found, _ = after(round(best.seconds["closure"]) + FEW_MORE, PROBLEMS[kind])
    assert found.change_set is not None


def test_some_time_after_a_stop_nothing_is_begun_any_more() -> None:
    stop, fake = Event(), Looks()
    with patch.object(clock, "time", SimpleNamespace(monotonic=fake.monotonic)):
        watched = Clock(None, stop)
        watched.check()
        stop.set()
        assert watched.is_over()
        with pytest.raises(OutOfTimeError):
            for _ in range(2 + int(STOPPING_S)):
                watched.check()
