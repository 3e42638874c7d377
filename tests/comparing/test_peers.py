"""Each peer proves the same cost as cpsat, or refuses; one whose package is not installed is skipped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cfgplan.comparing import Limits, RunFailure
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Link,
    Objective,
    OutputPort,
    Similarity,
    Target,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status
from experiments.peers import LED, PEERS, downward
from experiments.peers.counting import Counting, is_counted
from experiments.peers.placing import Placing, selection_of
from experiments.peers.program import Program
from experiments.peers.selection import Selection
from experiments.study.instances import Instance, generated, given
from experiments.study.runner import run_one

LIMITS = Limits(time_limit_s=20)
pytestmark = pytest.mark.usefixtures("warm_runs")
every_peer = pytest.mark.parametrize("name", PEERS)


def filtered_by_feedback() -> Problem:
    tracker = Transformation(
        "tracker", (InputPort("old", "B", feedback=True), InputPort("new", "A")), (OutputPort("out", "B"),), 1_000
    )
    source = Transformation("source", (), (OutputPort("out", "A"),), 1_000)
    relation = Similarity({"A": frozenset("A"), "B": frozenset("B")})
    return Problem(Environment((), (tracker, source), (Target("q", "B", "/q"),)), relation, 1)


INSTANCES = [
    generated("random_library", 3, transformations=40, running=0.3),
    generated("replanning", 4, transformations=40, failures=2),
    generated("adversarial", kind="ring", size=4),
    generated("adversarial", kind="fusion", size=3),
    given("feedback", filtered_by_feedback()),
    FLEET := generated("fleet", 2, transformations=30, targets=2, room=0.2, memory=0.3),
    DEPLOYMENT := generated("deployment", 2, hosts=3, replicas=1),
    SERVING := generated("deployment", 1, hosts=4, replicas=2),
]
OPEN = {("clingo-bb", SERVING.name)}
"""What takes too long for a test."""
MAXSAT = ("rc2", "rc2-stratified")
REFUSED = {
    *((program, fleet.name) for program in (*LED, *MAXSAT, "fast-downward") for fleet in (FLEET, DEPLOYMENT, SERVING)),
    *((program, "feedback") for program in (*MAXSAT, "highs", "highs-led", "scip", "scip-led")),
    ("fast-downward", "feedback"),
    ("fast-downward", "adversarial(kind=fusion, size=3)#0"),
}


@every_peer
@pytest.mark.parametrize("instance", INSTANCES, ids=lambda instance: instance.name)
def test_a_peer_proves_the_optimum_or_refuses(name: str, instance: Instance) -> None:
    if (name, instance.name) in OPEN:
        pytest.skip("it has no bound for long")
    row = run_one(instance, PEERS[name], LIMITS)
    if row.outcome == RunFailure.UNAVAILABLE:
        pytest.skip(row.message)
    if (name, instance.name) in REFUSED:
        assert row.outcome == RunFailure.REFUSED
        assert "does not support" in row.message
        return
    optimum = PLANNERS["cpsat"](instance.problem)
    assert optimum.status is Status.OPTIMAL
    assert row.violations == ()
    assert (row.cost_us, row.bound_us, row.proven) == (optimum.cost_us, optimum.cost_us, True)


@every_peer
def test_a_peer_says_that_a_target_can_not_be_met(name: str) -> None:
    tracker = Transformation("tracker", (InputPort("in", "A"),), (OutputPort("out", "B"),), 1_000)
    relation = Similarity({"A": frozenset("A"), "B": frozenset("B")})
    problem = Problem(Environment((), (tracker,), (Target("q", "B", "/q"),)), relation, 1)
    row = run_one(given("unfed", problem), PEERS[name], LIMITS)
    if row.outcome == RunFailure.UNAVAILABLE:
        pytest.skip(row.message)
    assert row.outcome == Status.INFEASIBLE
    assert "tracker" in row.message


@every_peer
@pytest.mark.parametrize(
    "instance",
    [
        generated("fleet", 2, transformations=24, targets=2, room=0.12, memory=0.15),
        generated("deployment", 0, hosts=1, replicas=2),
    ],
    ids=lambda instance: instance.name,
)
def test_a_peer_proves_that_there_is_not_room_enough(name: str, instance: Instance) -> None:
    row = run_one(instance, PEERS[name], LIMITS)
    if row.outcome in (RunFailure.UNAVAILABLE, RunFailure.REFUSED):
        pytest.skip(row.message)
    assert (row.outcome, row.violations) == (Status.INFEASIBLE, ())


@every_peer
def test_streams_are_paid_for_once_for_each_host_they_come_to(name: str) -> None:
    """Two on the other host take the stream: a second source there would cost more than its journey, not than two."""
    far = {"host": "b", "labor_us": 1_000}
    library = (
        Transformation("camera", (), (OutputPort("out", "A", rate_uhz=10**6, size_bytes=10**6),), 1_000, host="a"),
        Transformation("spare", (), (OutputPort("out", "A"),), 9_000, host="b"),
        Transformation("one", (InputPort("in", "A"),), (OutputPort("out", "B"),), **far),
        Transformation("other", (InputPort("in", "A"),), (OutputPort("out", "C"),), **far),
    )
    hosts, targets = (Host("a"), Host("b")), (Target("p", "B", "/p"), Target("q", "C", "/q", host="b"))
    relation = Similarity({tag: frozenset(tag) for tag in "ABC"})
    problem = Problem(Environment((), library, targets, hosts, transfer_us=5_000), relation, 1)
    row = run_one(given("journeys", problem), PEERS[name], LIMITS)
    if row.outcome in (RunFailure.UNAVAILABLE, RunFailure.REFUSED):
        pytest.skip(row.message)
    assert row.violations == ()
    assert (row.cost_us, row.proven) == (8_000, True)


def changed(instance: Instance, **parts: Any) -> Problem:
    return instance.problem.with_parts(**parts)


RUNNING = (ComputationUnit("t0_0.1", "t0_0", host="h0"),)
LINK = (Link(("h0", "h1"), price_us=1),)
RENTED = (Host("h0", rent_us=1), Host("h1"), Host("h2"))


@pytest.mark.parametrize(
    ("problem", "unknown"),
    [
        (changed(FLEET, units=RUNNING), "fleets that run already"),
        (changed(FLEET, links=LINK), "links"),
        (changed(FLEET, hosts=RENTED), "rents"),
        (changed(FLEET, minimise=(Objective.UNITS,)), "an order of objectives"),
        (changed(DEPLOYMENT, minimise=(Objective.HOSTS,)), "an order of objectives"),
        (changed(DEPLOYMENT, units=(ComputationUnit("agent.1", "agent", host="large001"),)), "what runs already"),
        (changed(DEPLOYMENT, hosts=()), "numbers without hosts"),
        (replace(DEPLOYMENT.problem, max_cost_us=1), "a largest cost"),
    ],
)
def test_what_no_peer_knows_of_fleets_is_named(problem: Problem, unknown: str) -> None:
    with pytest.raises(InputError, match=f"does not support .*{unknown}"):
        Counting(problem, "peer") if is_counted(problem) else selection_of(problem, "peer")


def test_a_unit_is_on_one_host_and_hosts_have_limits() -> None:
    problem = Problem(
        Environment((), (Transformation("a", (), (OutputPort("o", "A"),), memory_mb=3),), (Target("q", "A", "/q"),)),
        Similarity({"A": frozenset("A")}),
        1,
    )
    placing = Placing(problem.with_parts(hosts=(Host("h", memory_mb=2), Host("i", memory_mb=7))), "peer")
    assert sorted((limit.most, *limit.takes.values()) for limit in placing.limits) == [(0, 1), (1, 1, 1), (2, 1)]


def ringed(**parts: Any) -> Problem:
    """A ring that nothing feeds, but a dear start, gives what is wanted; so does a source."""
    library = (
        Transformation("source", (), (OutputPort("out", "X"),), 1_000),
        Transformation("one", (InputPort("in", "Z"),), (OutputPort("out", "Y"), OutputPort("more", "X")), 1_000),
        Transformation("other", (InputPort("in", "Y"),), (OutputPort("out", "Z"),), 1_000),
        Transformation("start", (), (OutputPort("out", "Z"),), 9_000),
    )
    relation = Similarity({tag: frozenset(tag) for tag in "XYZ"})
    return Problem(Environment((), library, (Target("q", "X", "/q"),), **parts), relation, 1)


def test_what_a_solver_chose_beside_a_plan_is_left_out_of_it() -> None:
    """It ended SCIP, and cut off solutions."""
    selection = Selection(ringed(), "scip")
    of = {candidate.transformation.label: i for i, candidate in enumerate(selection.candidates)}
    ring = [of["one"], of["other"]]
    assert selection.plan_within([*ring, of["source"]]) == [of["source"]]
    assert selection.plan_within(ring) is None


def test_a_ring_on_one_host_misses_a_landmark_over_all_hosts() -> None:
    placing = Placing(ringed(hosts=(Host("a"), Host("b"))), "highs")
    labels = [candidate.transformation.label for candidate in placing.candidates]
    missed = Program(placing, None).missed([labels.index("one on a"), labels.index("other on a")])
    _, columns, _ = next(iter(missed.each()))
    assert {labels[i] for i in columns} == {"source on a", "source on b", "start on a", "start on b"}


def test_fast_downward_out_of_memory_is_told_as_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "downward"
    program.write_text(f"#!/bin/sh\nexit {downward.OUT_OF_MEMORY}\n")
    program.chmod(0o755)
    monkeypatch.setattr(downward, "_program", lambda: str(program))
    with pytest.raises(MemoryError):
        downward.plan(generated("random_library", 3, transformations=40).problem)
