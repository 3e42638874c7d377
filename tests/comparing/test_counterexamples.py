"""How the weaknesses in `models/counterexamples` grow; their answers stand beside them, see `tests/test_models.py`."""

from __future__ import annotations

from itertools import pairwise

import pytest

from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Status
from experiments.study.instances import generated


def answer(planner: str, kind: str, size: int) -> Plan:
    return PLANNERS[planner](generated("adversarial", kind=kind, size=size).problem)


def test_the_papers_tree_grows_sixfold_with_each_floor() -> None:
    nodes = [answer("branch-and-bound", "blow-up", floors).counts["nodes"] for floors in range(1, 5)]
    assert [round(after / before) for before, after in pairwise(nodes)] == [6, 6, 6]


@pytest.mark.parametrize("targets", [2, 5, 9])
def test_the_papers_answer_can_be_dearer_by_any_factor(targets: int) -> None:
    paper, best = answer("branch-and-bound", "dedicated", targets), answer("cpsat", "dedicated", targets)
    assert paper.cost_us == targets * 10_000_000
    assert best.cost_us == 11_000_000


def test_the_papers_tree_prefers_a_direct_way_to_a_cheaper_graph() -> None:
    paper, best = answer("branch-and-bound", "tower", 4), answer("cpsat", "tower", 4)
    assert (paper.cost_us, best.cost_us) == (12_000_000, 10_000_000)


def test_the_papers_fusion_gets_one_stream_twice_at_any_size() -> None:
    for size in (2, 3, 4):
        plan = answer("branch-and-bound", "fusion", size)
        assert plan.status is Status.UNKNOWN
        assert "must differ" in plan.reasons["q"]
