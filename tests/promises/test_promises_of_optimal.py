"""What `manual/optimal.md` promises, a test for each sentence.

That the judge shares no code with planners is a contract of `lint-imports`; that planner and oracle agree is asked by
`tests/planners`. Qualities, hosts and failures are promised by `manual/hosts.md`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import pytest
from promised import solved

import cfgplan
from cfgplan.cli import main
from cfgplan.domain import ChangeSet, Objective
from cfgplan.planning import Measured, Plan, Status
from cfgplan.validity.plans import silent_stops

TWO_WAYS = """\
horizon: {horizon}
transformations:
  - {{label: dear_start, labor: 5, upkeep: 0.1, outputs: {{x: A}}}}
  - {{label: dear_run, labor: 1, upkeep: 0.5, outputs: {{x: A}}}}
targets: [{{label: t, topic: /t, tag: A}}]
"""


@pytest.mark.parametrize(
    ("horizon", "runs", "cost_us"),
    [(0, "dear_run", 1_000_000), (9, "dear_run", 5_500_000), (11, "dear_start", 6_100_000)],
)
def test_the_cost_is_labor_plus_upkeep_over_the_horizon_in_exact_microseconds(
    horizon: int, runs: str, cost_us: int, tmp_path: Path
) -> None:
    found = solved(tmp_path, TWO_WAYS.format(horizon=horizon))
    assert found.runs == [runs]
    assert found.plan.cost_us == cost_us
    assert isinstance(found.plan.cost_us, int)


def test_what_runs_already_costs_no_labor(tmp_path: Path) -> None:
    units = "units: [{id: dear_start.1, transformation: dear_start}]\n"
    found = solved(tmp_path, TWO_WAYS.format(horizon=9) + units)
    assert (found.runs, found.plan.cost_us) == (["dear_start"], 900_000)


TIES = """\
transformations:
  - {label: a, labor: 0, outputs: {x: A}}
  - {label: b, labor: 0, outputs: {x: A}}
  - {label: one, labor: 0, inputs: {x: A}, outputs: {y: B}}
  - {label: half, labor: 0, outputs: {z: C}}
  - {label: other, labor: 0, inputs: {z: C}, outputs: {y: B}}
"""


def test_among_updates_of_one_cost_the_one_that_rewires_fewest_units_is_taken(tmp_path: Path) -> None:
    text = (
        TIES + "units:\n  - {id: a.1, transformation: a}\n"
        "  - {id: one.1, transformation: one, inputs: {x: a.1/x}, topics: {y: [/t]}}\n"
        "targets: [{label: t, topic: /t, tag: B}, {label: u, topic: /u, tag: A}]\n"
    )
    found = solved(tmp_path, text)
    assert found.plan.change_set is not None
    assert found.plan.change_set.rewired == (), "to publish a.1 on /u would rewire it"
    assert found.started == ["b.1"]


def test_among_those_the_one_that_starts_fewest_units_is_taken(tmp_path: Path) -> None:
    text = TIES.replace("inputs: {x: A}, ", "") + "targets: [{label: t, topic: /t, tag: B}]\n"
    assert solved(tmp_path, text).started == ["one.1"]


def test_the_answer_does_not_depend_on_the_order_of_the_file(tmp_path: Path) -> None:
    lines = [
        "  - {label: s1, labor: 1, outputs: {x: A}}\n",
        "  - {label: s2, labor: 1, outputs: {x: A}}\n",
        "  - {label: f, labor: 1, inputs: {x: A}, outputs: {y: B}}\n",
        "  - {label: g, labor: 1, inputs: {x: A}, outputs: {y: B}}\n",
    ]
    targets = "targets: [{label: t, topic: /t, tag: B}]\n"
    answers = {
        (solved(tmp_path, f"transformations:\n{''.join(order)}{targets}").plan.change_set)
        for order in permutations(lines)
    }
    assert len(answers) == 1


def test_every_input_that_is_not_optional_is_fed_by_as_many_running_units_as_it_takes(tmp_path: Path) -> None:
    text = """\
transformations:
  - {label: s, labor: 1, outputs: {x: A}}
  - {label: wrong, labor: 0, outputs: {x: B}}
  - {label: f, inputs: {two: {tag: A, count: 2}, one: A, more: {tag: C, optional: true}}, outputs: {y: D}}
targets: [{label: t, topic: /t, tag: D}]
"""
    feeds = solved(tmp_path, text).unit("f.1").feeds
    assert {port: len({stream.unit for stream in streams}) for port, streams in feeds.items()} == {"one": 1, "two": 2}
    assert {stream.unit.partition(".")[0] for streams in feeds.values() for stream in streams} == {"s"}


def test_every_target_is_met_by_exactly_one_stream_on_its_topic_or_has_the_unit_that_it_wants(tmp_path: Path) -> None:
    text = """\
transformations:
  - {label: s, outputs: {x: A, y: A}}
  - {label: shown, inputs: {x: A}}
targets: [{label: t, topic: /t, tag: A}, {label: u, topic: /u, tag: A}, {label: v, run: shown}]
"""
    found = solved(tmp_path, text)
    topics = [p.topic for unit in found.after.units for p in unit.publications]
    assert sorted(topics) == ["/t", "/u"]
    assert found.runs == ["s", "shown"]


@pytest.mark.parametrize(("more", "status"), [("", "infeasible"), (", feedback: true", "optimal")])
def test_data_comes_from_sources_with_no_cycle_except_through_feedback(more: str, status: str, tmp_path: Path) -> None:
    text = f"""\
transformations:
  - {{label: a, inputs: {{x: {{tag: B{more}}}}}, outputs: {{y: A}}}}
  - {{label: b, inputs: {{x: A}}, outputs: {{y: B}}}}
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text).plan.status == status


def test_inputs_of_a_distinct_group_are_fed_by_different_transformations(tmp_path: Path) -> None:
    text = """\
transformations:
  - {label: s, labor: 1, outputs: {x: A}}
  - {label: dear, labor: 9, outputs: {x: A}}
  - {label: f, inputs: {l: {tag: A, distinct: eyes}, r: {tag: A, distinct: eyes}}, outputs: {y: B}}
targets: [{label: t, topic: /t, tag: B}]
"""
    assert solved(tmp_path, text).runs == ["dear", "f", "s"]
    assert solved(tmp_path, text.replace(", distinct: eyes", "")).runs == ["f", "s"]


@pytest.mark.parametrize(("serves", "status"), [(1, "infeasible"), (2, "optimal")])
def test_no_stream_is_taken_by_more_inputs_and_topics_than_its_output_serves(
    serves: int, status: str, tmp_path: Path
) -> None:
    text = f"""\
transformations:
  - {{label: s, outputs: {{x: {{tag: A, serves: {serves}}}}}}}
  - {{label: f, inputs: {{x: A}}, outputs: {{y: B}}}}
targets: [{{label: t, topic: /t, tag: B}}, {{label: u, topic: /u, tag: A}}]
"""
    assert solved(tmp_path, text).plan.status == status


@pytest.mark.parametrize(("pinned", "runs"), [("", ["s"]), (", pinned: true", ["idle", "s"])])
def test_nothing_runs_that_no_target_needs_unless_it_is_pinned(pinned: str, runs: list[str], tmp_path: Path) -> None:
    text = f"""\
transformations:
  - {{label: s, outputs: {{x: A}}}}
  - {{label: idle, outputs: {{x: B}}{pinned}}}
units: [{{id: idle.1, transformation: idle}}]
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text).runs == runs


PINNED = """\
format: cfgplan/1
transformations:
  - {{label: s, labor: 9, outputs: {{x: {gives}}}}}
  - {{label: keeper, pinned: true, inputs: {{x: Wanted}}}}
units: [{{id: keeper.1, transformation: keeper, inputs: {{x: null}}}}]
"""


def test_a_pinned_unit_goes_on_wherever_it_can_be_fed_at_all(tmp_path: Path) -> None:
    found = solved(tmp_path, PINNED.format(gives="Wanted").partition("\n")[2])
    assert found.runs == ["keeper", "s"]


def test_a_pinned_unit_that_can_not_be_fed_is_stopped_with_a_warning_that_names_input_and_nearest_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (env := tmp_path / "env.yaml").write_text(PINNED.format(gives="Wantet"))
    assert main(["solve", str(env)]) == 0
    said = capsys.readouterr()
    assert "- stop    keeper.1" in said.out
    assert "pinned unit keeper.1 is stopped" in said.err
    assert "input x wants Wanted" in said.err
    assert "nearest: s/x gives Wantet" in said.err
    assert main(["explain", str(env), "--unit", "keeper.1"]) == 0
    assert "nearest: s/x gives Wantet" in capsys.readouterr().out


def test_the_judge_refuses_a_plan_that_stops_a_pinned_unit_without_the_reason(tmp_path: Path) -> None:
    found = solved(tmp_path, PINNED.format(gives="Other").partition("\n")[2])
    assert "keeper.1" in found.plan.reasons
    assert silent_stops(found.problem, found.plan) == []
    (refused,) = silent_stops(found.problem, replace(found.plan, reasons={}))
    assert "keeper.1 is pinned, and it is not said why it is stopped" in str(refused)


DEMANDING = """\
max_cost: {max_cost}
transformations:
  - {{label: cheap, labor: 1, outputs: {{x: A}}}}
  - {{label: dear, labor: 5, required: true, outputs: {{x: A}}}}
targets: [{{label: t, topic: /t, tag: A}}]
"""


def test_required_comes_before_max_cost(tmp_path: Path) -> None:
    assert solved(tmp_path, DEMANDING.format(max_cost=5)).runs == ["dear"]
    refused = solved(tmp_path, DEMANDING.format(max_cost=4)).plan
    assert (refused.status, refused.cost_us) == ("too expensive", 5_000_000)
    assert main(["solve", str(tmp_path / "env.yaml")]) == 11
    assert solved(tmp_path, DEMANDING.format(max_cost=4).replace("required: true, ", "")).runs == ["cheap"]


def test_too_expensive_says_that_no_update_within_max_cost_meets_every_target(tmp_path: Path) -> None:
    """There is none at any cost: each target can be met alone, but not both, and both take more than is allowed."""
    text = """\
max_cost: 1
transformations:
  - {label: a, labor: 5, max_instances: 1, conflicts: [b], outputs: {x: A}}
  - {label: b, labor: 5, outputs: {x: B}}
targets: [{label: t, topic: /t, tag: A}, {label: u, topic: /u, tag: B}]
"""
    plan = solved(tmp_path, text).plan
    assert plan.status in (Status.TOO_EXPENSIVE, Status.INFEASIBLE)
    assert plan.cost_us is None
    assert solved(tmp_path, text.replace("max_cost: 1", "max_cost: 99")).plan.status is Status.INFEASIBLE
    bounded = replace(plan, status=Status.TOO_EXPENSIVE, bound_us=1_000_001, reasons={})
    problem = solved(tmp_path, text).problem
    assert cfgplan.plan_violations(problem, bounded) == []
    assert cfgplan.plan_violations(problem, replace(bounded, bound_us=1_000_000)) != []


ORDERED = """\
hosts: [{{name: h1, rent: {rent}}}, {{name: h2, rent: 0.1}}, {{name: h3, rent: 0.1}}]
minimise: [{order}]
max_cost: {max_cost}
transformations:
  - {{label: a, labor: 1, host: [h1, h2], outputs: {{x: A}}}}
  - {{label: b, labor: 1, host: [h1, h3], outputs: {{x: B}}}}
targets: [{{label: t, topic: /t, tag: A}}, {{label: u, topic: /u, tag: B}}]
"""


@pytest.mark.parametrize(
    ("order", "hosts"), [("hosts, rent", {"h1"}), ("rent, hosts", {"h2", "h3"}), ("cost", {"h2", "h3"})]
)
def test_what_is_named_first_is_minimised_first(order: str, hosts: set[str], tmp_path: Path) -> None:
    found = solved(tmp_path, ORDERED.format(rent=1, order=order, max_cost=99))
    assert {unit.host for unit in found.after.units} == hosts
    assert found.plan.status is Status.OPTIMAL


def test_the_cost_follows_what_is_named(tmp_path: Path) -> None:
    plan = solved(tmp_path, ORDERED.format(rent=1, order="hosts, rent", max_cost=99)).plan
    assert [one.objective for one in plan.objectives] == [Objective.HOSTS, Objective.RENT, Objective.COST]


def test_the_best_update_is_the_best_of_those_that_cost_no_more_than_max_cost(tmp_path: Path) -> None:
    """On one host both cost 12 s, on two 4 s."""
    for max_cost, hosts in ((12, {"h1"}), (11, {"h2", "h3"})):
        found = solved(tmp_path, ORDERED.format(rent=1, order="hosts", max_cost=max_cost))
        assert {unit.host for unit in found.after.units} == hosts


def test_the_gap_is_that_of_the_first_objective_that_is_not_proven() -> None:
    objectives = (
        Measured(Objective.HOSTS, 2, 2),
        Measured(Objective.RENT, 10_000_000, 8_000_000),
        Measured(Objective.COST, 20_000_000, 0),
    )
    plan = Plan("mine", Status.FEASIBLE, ChangeSet(), 20_000_000, 0, objectives=objectives)
    assert plan.gap == pytest.approx(0.2)


def test_the_judge_recomputes_the_cost_of_every_plan(tmp_path: Path) -> None:
    found = solved(tmp_path, TWO_WAYS.format(horizon=10))
    assert found.plan.cost_us is not None
    wrong = replace(found.plan, cost_us=found.plan.cost_us - 1, bound_us=0, status=Status.FEASIBLE)
    assert any("cost" in str(one) for one in cfgplan.plan_violations(found.problem, wrong))
