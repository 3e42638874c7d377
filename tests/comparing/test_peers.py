"""Each peer proves the same cost as cpsat, or refuses; one whose package is not installed is skipped."""

from __future__ import annotations

from pathlib import Path

import pytest

from cfgplan.comparing import Limits, RunFailure
from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status
from experiments.peers import PEERS, downward
from experiments.peers.selection import Selection
from experiments.study.instances import Instance, generated, given
from experiments.study.runner import run_one

LIMITS = Limits(time_limit_s=20)
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
]
REFUSED = {
    *((program, "feedback") for program in ("highs", "highs-led", "scip", "scip-led")),
    ("fast-downward", "feedback"),
    ("fast-downward", "adversarial(kind=fusion, size=3)#0"),
}


@every_peer
@pytest.mark.parametrize("instance", INSTANCES, ids=lambda instance: instance.name)
def test_a_peer_proves_the_optimum_or_refuses(name: str, instance: Instance) -> None:
    row = run_one(instance, PEERS[name], LIMITS)
    if row.outcome == RunFailure.UNAVAILABLE:
        pytest.skip(row.message)
    if (name, instance.name) in REFUSED:
        assert row.outcome == RunFailure.REFUSED
        assert "does not know" in row.message
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


def test_what_a_solver_chose_beside_a_plan_is_left_out_of_it() -> None:
    """It ended SCIP, and cut off solutions: a ring that nothing feeds gives what is wanted, but so does a source."""
    library = (
        Transformation("source", (), (OutputPort("out", "X"),), 1_000),
        Transformation("one", (InputPort("in", "Z"),), (OutputPort("out", "Y"), OutputPort("more", "X")), 1_000),
        Transformation("other", (InputPort("in", "Y"),), (OutputPort("out", "Z"),), 1_000),
        Transformation("start", (), (OutputPort("out", "Z"),), 9_000),
    )
    relation = Similarity({tag: frozenset(tag) for tag in "XYZ"})
    selection = Selection(Problem(Environment((), library, (Target("q", "X", "/q"),)), relation, 1), "scip")
    of = {candidate.transformation.label: i for i, candidate in enumerate(selection.candidates)}
    ring = [of["one"], of["other"]]
    assert selection.plan_within([*ring, of["source"]]) == [of["source"]]
    assert selection.plan_within(ring) is None


def test_fast_downward_out_of_memory_is_told_as_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "downward"
    program.write_text(f"#!/bin/sh\nexit {downward.OUT_OF_MEMORY}\n")
    program.chmod(0o755)
    monkeypatch.setattr(downward, "_program", lambda: str(program))
    with pytest.raises(MemoryError):
        downward.plan(generated("random_library", 3, transformations=40).problem)
