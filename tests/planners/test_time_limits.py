"""Wherever the time is over, the planner ends soon after, with the best plan known and an honest bound.

Nothing is timed: the clock is one that goes on by a second whenever somebody looks at it.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Collection, Iterator
from dataclasses import replace
from math import inf
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from unittest.mock import patch

import pytest
from fleets import TOGETHER, fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from worlds import examples, problems

import cfgplan.planners
from cfgplan.figures import cost_parts
from cfgplan.planners.cpsat import plan
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.reducing.closure import Closure
from cfgplan.planners.solving import clock
from cfgplan.planners.solving.clock import STOPPING_S, Clock, OutOfTimeError
from cfgplan.planning import Failures, Feature, Plan, Problem, Status
from cfgplan.qualities import MICRO
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library
from experiments.fleet import instances

FEW_MORE = 40
"""So often somebody may look at the clock once the time is over."""
NEVER_S = 10**9
WIRING = frozenset({Feature.OPTIONAL, Feature.COUNTS, Feature.LIMITS})


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
    """A clock that goes on by a second at each look. At some looks Ctrl-C is pressed; from then on it stands still."""

    def __init__(self, pressed: Collection[int] = ()) -> None:
        self.looks = self.cpu_looks = 0
        self._pressed = pressed

    def process_time(self) -> float:
        """CPU time, of which a look takes a thousandth of a second."""
        self.cpu_looks += 1
        return self.cpu_looks / 1000

    def monotonic(self) -> float:
        self.looks += 1
        if self.looks in self._pressed:
            raise KeyboardInterrupt
        return float(min((self.looks, *self._pressed)))


def after(looks: int, problem: Problem) -> tuple[Plan, int]:
    """The plan when the time is over after so many looks at the clock, and how many there were."""
    return seen_through(Looks(), problem, looks)


def interrupted(pressed: Collection[int], problem: Problem) -> Plan:
    """The plan when Ctrl-C is pressed at some looks at the clock."""
    return seen_through(Looks(pressed), problem, NEVER_S)[0]


def seen_through(fake: Looks, problem: Problem, time_limit_s: float) -> tuple[Plan, int]:
    with patch.object(clock, "time", SimpleNamespace(monotonic=fake.monotonic, process_time=fake.process_time)):
        found = plan(problem, time_limit_s=time_limit_s)
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
        assert found.status in (Status.OPTIMAL, Status.FEASIBLE)
        if found.status is Status.FEASIBLE and not found.unused_required:
            assert found.cost_us is not None
            assert found.bound_us <= best.cost_us <= found.cost_us


def rank(found: Plan) -> tuple[int, int]:
    """How good a plan is: unused required transformations, then the cost in microseconds."""
    assert found.cost_us is not None
    return len(found.unused_required), found.cost_us


@st.composite
def at_work(draw: st.DrawFn, drawn: st.SearchStrategy[Problem]) -> tuple[Problem, tuple[int, int]]:
    """A problem in which what runs is valid, and the rank of keeping it; labor has moved since it was planned."""
    problem = replace(draw(drawn), max_cost_us=None)
    first = plan(problem)
    assume(first.change_set is not None)
    assert first.change_set is not None
    running = problem.environment.update(first.change_set)
    library = tuple(replace(t, labor_us=draw(st.integers(0, 9))) for t in running.library)
    more = tuple(
        replace(t, label=f"{t.label}'", pinned=False, min_instances=0, upkeep_us=0, conflicts=())
        for t in library
        if draw(st.booleans())
    )
    problem = replace(problem, environment=replace(running, library=(*library, *more)))
    unused = sum(t.required for t in more) + len(first.unused_required)
    return problem, (unused, cost_parts(problem, problem.environment.units).total_us)


@examples(100)
@given(
    at_work(st.one_of(problems(most=8), problems(most=8, special=False), fleets(TOGETHER, most=3))),
    st.integers(0, 60),
    st.booleans(),
)
def test_a_plan_cut_short_is_no_worse_than_what_runs_and_claims_nothing_wrong(
    running: tuple[Problem, tuple[int, int]], looks: int, is_interrupted: bool
) -> None:
    problem, kept = running
    exact = plan(problem)
    found = interrupted({looks}, problem) if is_interrupted and looks > 1 else after(looks, problem)[0]
    assert plan_violations(problem, found) == []
    assert rank(exact) <= rank(found) <= kept
    if len(found.unused_required) == len(exact.unused_required):
        assert exact.cost_us is not None
        assert found.bound_us <= exact.cost_us
    else:
        assert not found.required_proven


@examples(60)
@given(at_work(st.one_of(fleets(frozenset(Feature) - {Feature.SURVIVAL}, most=2), fleets(WIRING, most=3))))
def test_what_runs_is_kept_at_a_limit_of_0_whatever_is_asked(running: tuple[Problem, tuple[int, int]]) -> None:
    problem, kept = running
    found = plan(problem, time_limit_s=0)
    assert plan_violations(problem, found) == []
    assert rank(found) <= kept


@examples(100)
@given(st.one_of(problems(most=8), problems(most=8, special=False), fleets(frozenset(Feature), most=3)))
def test_a_limit_of_0_gives_a_plan_if_there_is_one_and_no_false_proof(problem: Problem) -> None:
    best, found = plan(problem), plan(problem, time_limit_s=0)
    assert plan_violations(problem, found) == []
    has_both = problem.max_cost_us is not None and bool(problem.environment.required)
    assert found.change_set is not None or best.change_set is None or has_both
    if found.change_set is None:
        assert found.status in (best.status, Status.UNKNOWN)
    elif len(found.unused_required) == len(best.unused_required):
        assert best.cost_us is not None
        assert found.cost_us is not None
        assert found.bound_us <= best.cost_us <= found.cost_us


@pytest.mark.parametrize("kind", PROBLEMS)
def test_ctrl_c_at_any_moment_ends_with_a_plan_and_a_second_one_at_once(kind: str) -> None:
    problem = PROBLEMS[kind]
    _, enough = after(NEVER_S, problem)
    for looks in at_all_sizes(enough):
        if looks > 1:
            found = interrupted({looks}, problem)
            assert plan_violations(problem, found) == []
            assert found.change_set is not None
    with pytest.raises(KeyboardInterrupt):
        interrupted({2, 3}, problem)


@pytest.mark.parametrize("kind", PROBLEMS)
def test_soon_after_the_closure_a_plan_is_known(kind: str) -> None:
    best, _ = after(10**9, PROBLEMS[kind])
    found, _ = after(round(best.seconds["closure"]) + FEW_MORE, PROBLEMS[kind])
    assert found.change_set is not None


def test_an_infinite_limit_is_none() -> None:
    assert Clock(inf).left_s() is None


def test_some_time_after_a_stop_nothing_is_begun_any_more() -> None:
    stop, fake = Event(), Looks()
    with patch.object(clock, "time", SimpleNamespace(monotonic=fake.monotonic)):
        watched = Clock(None, stop)
        next(watched.each("a"))
        stop.set()
        assert watched.is_over()
        with pytest.raises(OutOfTimeError):
            for _ in range(2 + int(STOPPING_S)):
                next(watched.each("a"))


def test_new_units_get_no_numbers_once_the_time_is_over() -> None:
    problem, numbered = PROBLEMS["plain"], "cfgplan.planners.exact.candidates.fresh_units"
    closure = Closure.of(problem, Clock())
    with patch(numbered, side_effect=AssertionError), pytest.raises(OutOfTimeError):
        Candidates(problem, closure, clock=Clock(0.0))


def test_work_is_given_up_by_loops_over_each_alone() -> None:
    room = Path(cfgplan.planners.__file__).parent
    for path in (*room.rglob("*.py"), room.parent / "reasons.py"):
        names = {
            node.attr if isinstance(node, ast.Attribute) else node.arg if isinstance(node, ast.arg) else node.id
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Attribute | ast.arg | ast.Name)
        }
        assert names.isdisjoint({"watch", "check"}), path
        assert path == room / "solving" / "clock.py" or "_check" not in names, path
