"""Chains of thousands of units, and as many side by side: each step looks at each of them a few times only."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from cfgplan.cli.plan_text import in_stream_order
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners.bounding.bounds import Bound, cheapest_way, tightened
from cfgplan.planners.bounding.landmarks import ways_into
from cfgplan.planners.cpsat import PlannerSession, plan
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.grounded import Grounded
from cfgplan.planners.exact.pruning import lean
from cfgplan.planners.networks.greedy import first_plan, plan_at
from cfgplan.planners.networks.network import Network
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL
from cfgplan.planning import Problem, Status
from cfgplan.qualities import Better, Contribution, QualityAttribute, QualityRule, Wish
from cfgplan.reasons import Providers, forward_closure, startable
from cfgplan.validity import plan_violations


def chain(length: int, *, dead: int | None = None) -> Problem:
    """Each unit feeds the next one; all run but the dead one, or, if there is none, none does."""
    library = [
        Transformation(
            f"t{i:05}",
            (InputPort("i", f"T{i - 1}"),) if i else (),
            (OutputPort("o", f"T{i}"),),
            labor_us=9,
            upkeep_us=1,
        )
        for i in range(length)
    ]
    units = [
        ComputationUnit(
            f"{t.label}.1",
            t.label,
            (Subscription("i", Stream(f"{library[i - 1].label}.1", "o")),) if i else (),
            (Publication("o", "/t"),) if i == length - 1 else (),
        )
        for i, t in enumerate(library if dead is not None else ())
        if i != dead
    ]
    environment = Environment(tuple(units), tuple(library), (Target("t", f"T{length - 1}", "/t"),))
    return Problem(environment, Similarity({f"T{i}": frozenset({f"T{i}"}) for i in range(length)}), 1)


def flat(width: int) -> Problem:
    """As many targets as sources, each for one."""
    library = [Transformation(f"t{i}", (), (OutputPort("o", f"T{i}"),), labor_us=9) for i in range(width)]
    targets = [Target(f"t{i}", f"T{i}", f"/{i}") for i in range(width)]
    similarity = Similarity({f"T{i}": frozenset({f"T{i}"}) for i in range(width)})
    return Problem(Environment((), tuple(library), tuple(targets)), similarity, 1)


@pytest.mark.parametrize(
    ("made", "changes"),
    [
        (partial(chain, 5_000), (5_000, 0)),
        (partial(chain, 5_000, dead=2_500), (1, 1)),
        (partial(flat, 5_000), (5_000, 0)),
    ],
)
def test_five_thousand_units_are_planned_with_one_look_at_each_event(
    made: Callable[[], Problem], changes: tuple[int, int]
) -> None:
    problem = made()
    looks = 0
    choices = Grounded.choices

    def counted(grounded: Grounded, unit: int, port: InputPort) -> list[Stream]:
        nonlocal looks
        looks += 1
        return choices(grounded, unit, port)

    with patch.object(Grounded, "choices", counted):
        found = plan(problem)
    assert found.change_set is not None
    assert found.status is Status.OPTIMAL
    assert (len(found.change_set.started), len(found.change_set.rewired)) == changes
    assert looks <= 20_000
    assert plan_violations(problem, found) == []


def test_units_are_told_with_the_stream_however_deep_they_are() -> None:
    environment = chain(3_000, dead=0).environment
    assert [unit.id for unit in in_stream_order(environment)] == [f"t{i:05}.1" for i in range(1, 3_000)]


@pytest.mark.parametrize("most", [1, 60])
def test_facts_cost_the_same_whether_followed_in_passes_or_one_by_one(most: int) -> None:
    library = (
        Transformation("a", (), (OutputPort("o", "A"),), labor_us=3),
        Transformation("b", (InputPort("i", "A"),), (OutputPort("o", "B"),), labor_us=5),
        Transformation("c", (InputPort("i", "B"),), (OutputPort("o", "B"),), labor_us=1),
        Transformation("d", (InputPort("i", "B", "g"), InputPort("j", "B", "g")), (OutputPort("o", "D"),), labor_us=1),
    )
    similarity = Similarity({tag: frozenset({tag}) for tag in "ABD"})
    network = Network(library, ["D"], [], Providers(library, similarity))
    with (
        patch("cfgplan.planners.bounding.bounds.MOST_PASSES", most),
        patch("cfgplan.planners.networks.greedy.MOST_PASSES", most),
    ):
        _, before = cheapest_way(network.core, np.array([3, 5, 1, 1]))
        found = plan_at(network, np.array([3, 5, 1, 1]), np.array([3.0, 5.0, 1.0, 1.0]))
    assert before.tolist() == [0, 3, 8, 9, 10]
    assert found == {0, 1, 2, 3}


def test_what_hosts_and_quality_ask_of_a_chain_is_found_by_looking_at_each_unit_a_few_times() -> None:
    problem = chain(2_000)
    error = QualityAttribute("error", Better.LOWER, worst=4_000)
    library = tuple(
        replace(t, outputs=tuple(replace(o, quality=(Contribution("error", QualityRule.ADD, 1),)) for o in t.outputs))
        for t in problem.environment.library
    )
    (target,) = problem.environment.targets
    asked = replace(target, quality=(Wish("error", 3_000, 1_000_000),))
    hosts = (Host("left"), Host("right"))
    environment = Environment((), library, (asked,), hosts, (error,), transfer_us=3)
    found = plan(replace(problem, environment=environment))
    assert (found.status, found.cost_us, found.ties_proven) == (Status.OPTIMAL, 2_000 * 10 + 2_000, True)
    assert "rounds" not in found.counts
    assert plan_violations(replace(problem, environment=environment), found) == []


def test_what_falls_through_feedback_falls_in_few_closures() -> None:
    """Each but the last waits for the next one by feedback, and the last for what nobody offers."""
    length = 3_000
    library = tuple(
        Transformation(
            f"t{i:05}",
            (InputPort("i", f"T{i + 1}", feedback=True), *((InputPort("j", f"T{i - 1}"),) if i else ())),
            (OutputPort("o", f"T{i}"),),
        )
        for i in range(length)
    )
    similarity = Similarity({f"T{i}": frozenset({f"T{i}"}) for i in range(length)})
    with patch("cfgplan.reasons.forward_closure", wraps=forward_closure) as closures:
        assert startable(Environment((), library), Providers(library, similarity)) == frozenset()
    assert closures.call_count <= 3


def pairs(layers: int) -> Problem:
    """Each layer has two units that need both of the layer before: added up, that is 2 to the power of the layers."""
    pair = (InputPort("a", "", "both"), InputPort("b", "", "both"))
    library = tuple(
        Transformation(
            f"s{layer}_{k}",
            tuple(replace(port, tag=f"T{layer - 1}") for port in pair) if layer else (),
            (OutputPort("o", f"T{layer}"),),
            labor_us=5 + k,
        )
        for layer in range(layers)
        for k in range(2)
    )
    similarity = Similarity({f"T{i}": frozenset({f"T{i}"}) for i in range(layers)})
    return Problem(Environment((), library, (Target("t", f"T{layers - 1}", "/t"),)), similarity, 1)


def test_a_deep_row_of_pairs_is_proven_by_parts_that_share_nothing() -> None:
    found = plan(pairs(300))
    assert (found.status, found.cost_us, found.ties_proven) == (Status.OPTIMAL, 299 * 11 + 5, True)
    assert "landmarks" not in found.counts


def test_a_deep_row_of_pairs_has_a_first_plan() -> None:
    problem = pairs(1_200)
    library = problem.environment.library
    network = Network(library, ["T1199"], [], Providers(library, problem.similarity))
    found = first_plan(network, np.full(len(library), 5, np.int64), 0, Clock())
    assert found is not None
    assert {network.labels[i] for i in found} == {t.label for t in library} - {"s1199_1"}


def test_no_more_landmarks_are_looked_for_than_pay_where_the_way_is_deep() -> None:
    problem, offered = pairs(100), []
    costs: list[int | None] = []

    def first(*arguments: Any, **more: Any) -> Bound:
        offered.append(costs[-1] if costs else None)
        return tightened(*arguments, **more)

    with (
        patch("cfgplan.planners.bounding.bounds.ways_into", wraps=ways_into) as landmarks,
        patch("cfgplan.planners.bounding.bounds.tightened", first),
    ):
        session = PlannerSession(USUAL.without_search(), is_asked_once=True)
        found = session.plan(problem, report=lambda progress: costs.append(progress.cost_us))
    assert (found.status, found.cost_us) == (Status.OPTIMAL, 99 * 11 + 5)
    assert offered == [found.cost_us]
    assert landmarks.call_count <= 100


def test_what_nothing_needs_is_taken_away_in_a_time_that_grows_with_its_number() -> None:
    def seconds(number: int) -> float:
        library = tuple(
            Transformation(f"t{i:05}", (), (OutputPort("x", f"T{i}"),), 1000, 10, standby_us=1) for i in range(number)
        )
        units = [ComputationUnit(t.label + ".1", t.label, host="h") for t in library]
        units[0] = replace(units[0], publications=(Publication("x", "/t"),))
        environment = Environment(tuple(units), library, (Target("t", "T0", "/t"),), (Host("h"),))
        candidates = Candidates(Problem(environment, Similarity({"T0": frozenset({"T0"})}), 10))
        began = time.process_time()
        assert [unit.id for unit in lean(candidates, units)] == ["t00000.1"]
        return time.process_time() - began

    few, many = (min(seconds(number) for _ in range(3)) for number in (500, 4_000))
    assert many < 24 * few  # 8 times as many; in pairs it would be 64 times
