"""Labels that are used only together count as one, and the solver chooses among these parts."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_against_the_oracle import agree, fewer, many
from test_disjoint_parts import core_of, cores
from worlds import running_units

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.planners.bounding.contraction import Contraction, cheapest_choice
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.networks.core import Core, Rows
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planning import Problem, Status
from experiments.families.nao import nao


def is_grounded(core: Core, chosen: Collection[int]) -> bool:
    """Whether the labels and the goal can be started one after the other."""
    started: set[int] = set()
    while True:
        new = {
            label
            for label in {*chosen, core.goal} - started
            if all(
                len(started.intersection(core.providers.lists[fact])) >= core.multi_takes.get(fact, 1)
                for fact in core.needs.lists[label]
            )
        }
        if not new:
            return started == {*chosen, core.goal}
        started |= new


def least_cost(core: Core, cost: list[int], certain: Collection[int]) -> int | None:
    choices = [chosen for size in range(core.goal + 1) for chosen in combinations(range(core.goal), size)]
    plans = [chosen for chosen in choices if set(certain) <= set(chosen) and is_grounded(core, chosen)]
    return min((sum(cost[label] for label in chosen) for chosen in plans), default=None)


@fewer
@given(cores(), st.sets(st.integers(0, 6), max_size=2))
def test_the_choice_is_grounded_and_none_is_cheaper(drawn: tuple[Core, list[int]], wanted: set[int]) -> None:
    core, cost = drawn
    certain = sorted(label for label in wanted if label < core.goal)
    *needs, goal = core.needs.lists.values()
    goal = sorted({*goal, *(fact for label in certain for fact in needs[label])})  # as in a network
    core = replace(core, needs=Rows.of([*needs, goal]))
    chosen = cheapest_choice(core, cost, certain, Clock())
    least = least_cost(core, cost, certain)
    assert (chosen is None) == (least is None)
    if chosen is not None:
        assert chosen.issuperset(certain)
        assert is_grounded(core, chosen)
        assert sum(cost[label] for label in chosen) == least


@many
@given(cores())
def test_each_label_that_a_plan_may_use_is_in_one_part(drawn: tuple[Core, list[int]]) -> None:
    contraction = Contraction(*drawn, ())
    labels = [label for part in contraction.parts for label in part]
    assert len(labels) == len(set(labels))
    assert sum(contraction.costs) == sum(drawn[1][label] for label in labels)


def test_a_pipeline_is_a_part_and_a_shared_source_is_another() -> None:
    core, cost = core_of(
        [[], [0], [1], [0], [2], [3]], [[0], [1], [3], [2, 4]], [1, 1, 1, 1], [1, 2, 4, 8, 16]
    )  # 0 feeds 1 and 3, 1 feeds 2, 3 feeds 4
    contraction = Contraction(core, cost, ())
    assert sorted(map(sorted, contraction.parts)) == [[], [0], [1, 2], [3, 4]]
    assert sorted(contraction.costs) == [0, 1, 6, 24]


def test_labels_that_feed_each_other_are_no_plan() -> None:
    core, cost = core_of([[1], [0], [], [0]], [[1, 2], [0]], [1, 1], [1, 1, 9])
    assert cheapest_choice(core, cost, (), Clock()) == {2}


@pytest.mark.parametrize("limits", [{"parts": 1, "contracted": 0.0}, {"choosing": 0.0}])
def test_nothing_is_chosen_beyond_the_limits(limits: dict[str, float]) -> None:
    core, cost = core_of([[], [], [0]], [[0, 1]], [1], [1, 2])
    tuning: Tuning = replace(USUAL, decide=replace(USUAL.decide, **limits))  # type: ignore[arg-type]
    assert cheapest_choice(core, cost, (), Clock()) == {0}
    assert cheapest_choice(core, cost, (), Clock(tuning=tuning)) is None


@pytest.mark.parametrize("event", ["registered", "lost", "left"])
@pytest.mark.parametrize(("sharing", "cameras"), [(2, 1), (4, 1), (1, 2), (2, 2), (1, 4)])
def test_robots_that_share_cameras_need_neither_landmarks_nor_the_full_model(
    event: str, sharing: int, cameras: int
) -> None:
    problem = nao(8342, robots=20, fusion=10, event=event, sharing=sharing, cameras=cameras)
    found = PlannerSession().plan(problem)
    assert (found.status, found.ties_proven) == (Status.OPTIMAL, True)
    assert found.counts.keys().isdisjoint({"landmarks", "rounds"})


@st.composite
def overlapping(draw: st.DrawFn) -> Problem:
    """Robots that may use some of two or three cameras; the positions that two or three of them give are fused.

    A robot may be pinned or required, have a feedback or an optional input, and feed a camera.
    """
    paid, rate = st.integers(0, 9), st.integers(0, 1)
    seldom = st.sampled_from([False, False, False, True])
    robots = [str(i) for i in range(draw(st.integers(2, 4)))]
    library = []
    for camera in range(draw(st.integers(2, 3))):
        films = sorted(draw(st.sets(st.sampled_from(robots), min_size=1)))
        inputs = (InputPort("p", "P", feedback=draw(seldom)),) if draw(seldom) else ()
        outputs = tuple(OutputPort(f"o{robot}", f"I{robot}") for robot in films)
        library.append(Transformation(f"camera{camera}", inputs, outputs, draw(paid), draw(rate)))
    for robot in robots:
        inputs = (InputPort("i", f"I{robot}"),)
        if draw(seldom):
            tag = draw(st.sampled_from(["P", *(f"I{other}" for other in robots)]))
            feedback = draw(st.booleans())
            inputs += (InputPort("more", tag, feedback=feedback, optional=not feedback),)
        special = {"pinned": draw(seldom), "required": draw(seldom)}
        library.append(Transformation(robot, inputs, (OutputPort("p", "P"),), draw(paid), draw(rate), **special))
    fused = [InputPort(f"p{i}", "P", distinct="g") for i in range(draw(st.integers(2, min(3, len(robots)))))]
    library.append(Transformation("fuse", tuple(fused), (OutputPort("q", "Q"),), draw(paid)))
    tags = {port.tag for t in library for port in t.outputs}.union(f"I{robot}" for robot in robots)
    relation = Similarity({tag: frozenset({tag}) for tag in tags})
    targets = [Target("Q", "Q", "/Q")]
    units = draw(running_units(library, targets, relation)) if draw(st.booleans()) else []
    return Problem(Environment(tuple(units), tuple(library), tuple(targets)), relation, draw(st.integers(0, 2)))


@fewer
@given(overlapping())
def test_fused_robots_that_share_cameras_are_planned_as_well_as_by_the_oracle(problem: Problem) -> None:
    agree(problem)
