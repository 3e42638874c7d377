"""The peer RC2 when its time is over: whatever it asks just then, it claims no bound above the optimum."""

from __future__ import annotations

from typing import Any

import pytest

from cfgplan.planning import Progress, Status
from experiments.study.instances import generated

maxsat = pytest.importorskip("experiments.peers.maxsat")


@pytest.mark.parametrize(("name", "engine"), [("plan", "_Anytime"), ("plan_stratified", "_Stratified")])
def test_a_peer_that_is_stopped_claims_no_bound_above_the_optimum(
    name: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = generated("random_library", 3, transformations=40, running=0.3).problem
    last, asked = 0, 0
    ask = getattr(maxsat, engine)._call_oracle

    def counted(solver: Any, *arguments: Any, **options: Any) -> bool | None:
        nonlocal asked
        asked += 1
        if asked >= last > 0:
            solver.stop()
            return None
        answer: bool | None = ask(solver, *arguments, **options)
        return answer

    monkeypatch.setattr(getattr(maxsat, engine), "_call_oracle", counted)
    planner, told = getattr(maxsat, name), list[Progress]()
    whole = planner(problem)
    assert whole.status is Status.OPTIMAL
    for question in range(1, asked + 1):
        last, asked = question, 0
        plan = planner(problem, report=told.append)
        assert plan.status is not Status.INFEASIBLE
        assert max([plan.bound_us, *(progress.bound_us for progress in told)]) <= whole.cost_us
