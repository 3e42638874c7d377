"""What `manual/hosts.md` promises, a test for each sentence.

Rounding of means, products and prices is asked by `tests/test_qualities.py`, speeds and resources by
`tests/planners/test_hosts.py`, survival by `tests/test_fleet_validity.py`; all of it by the oracle, too.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from promised import solved

from cfgplan.errors import InputError
from cfgplan.transformations import MOST_INSTANCES
from cfgplan.validity import unused_required

WISHED = """\
qualities: [{{name: error, better: lower, worst: 5, best: 0}}]
transformations:
  - {{label: cheap, labor: 1, outputs: {{x: {{tag: A, quality: {{error: 3}}}}}}}}
  - {{label: good, labor: 9, outputs: {{x: {{tag: A, quality: {{error: 1}}}}}}}}
  - {{label: silent, labor: 0, outputs: {{x: A}}}}
targets: [{{label: t, topic: /t, tag: A, quality: {{error: {wish}}}}}]
"""


@pytest.mark.parametrize(
    ("wish", "runs"),
    [
        ("{at_most: 5}", ["silent"]),
        ("{at_most: 9}", ["silent"]),
        ("{at_most: 4}", ["cheap"]),
        ("{at_most: 2}", ["good"]),
        ("{weight: 1}", ["cheap"]),
        ("{weight: 5}", ["good"]),
    ],
)
def test_a_bound_no_better_than_worst_asks_for_nothing_and_a_weight_is_a_price_once(
    wish: str, runs: list[str], tmp_path: Path
) -> None:
    for horizon in (10, 1000):
        assert solved(tmp_path, f"horizon: {horizon}\n" + WISHED.format(wish=wish)).runs == runs


def test_a_bound_better_than_best_can_not_be_kept(tmp_path: Path) -> None:
    text = WISHED.format(wish="{at_most: 0.5}").replace("best: 0", "best: 1")
    assert solved(tmp_path, text).plan.status == "infeasible"


def test_transfers_cold_spares_and_missed_quality_are_part_of_the_cost_that_max_cost_limits(tmp_path: Path) -> None:
    found = solved(tmp_path, WISHED.format(wish="{weight: 1}"))
    assert found.cost_s == 1 + 3
    assert solved(tmp_path, "max_cost: 3.9\n" + WISHED.format(wish="{weight: 1}")).plan.status == "too expensive"


def test_of_a_resource_that_a_host_does_not_name_it_has_nothing_but_no_limit_of_cpu_memory_and_power(
    tmp_path: Path,
) -> None:
    text = """\
hosts: [{{name: h}}]
transformations: [{{label: s, upkeep: 7, memory: 99999, needs: {{power: 99{gpu}}}, outputs: {{x: A}}}}]
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text.format(gpu="")).plan.status == "optimal"
    assert solved(tmp_path, text.format(gpu=", gpu: 1")).plan.status == "infeasible"


def test_on_a_host_of_half_the_speed_a_unit_costs_and_takes_twice_the_cpu_seconds(tmp_path: Path) -> None:
    text = """\
hosts: [{{name: h, speed: 0.5, cpu: {cpu}}}]
transformations: [{{label: s, labor: 1, upkeep: 0.1, outputs: {{x: A}}}}]
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text.format(cpu=0.2)).cost_s == 2 * (1 + 10 * 0.1)
    assert solved(tmp_path, text.format(cpu=0.19)).plan.status == "infeasible"


def test_a_stream_is_paid_for_once_for_each_other_host_where_it_is_wanted(tmp_path: Path) -> None:
    text = """\
hosts: [{name: a}, {name: b}, {name: c}]
transfer: 0.5
transformations:
  - {label: s, labor: 0, host: a, outputs: {x: {tag: A, rate: 2, size: 1000000}}}
  - {label: one, labor: 0, host: b, inputs: {x: A}}
  - {label: two, labor: 0, host: b, inputs: {x: A}}
targets: [{label: t, run: one}, {label: u, run: two}, {label: v, topic: /v, tag: A, host: c}]
"""
    assert solved(tmp_path, text).cost_s == 2 * (2 * 10 * 0.5), "to b once, though two units are there, and to c"


def test_the_price_of_a_link_counts_instead_of_transfer_and_its_bandwidth_limits_all_that_crosses_it(
    tmp_path: Path,
) -> None:
    text = """\
hosts: [{{name: a}}, {{name: b}}]
transfer: 0.5
links: [{{between: [a, b], price: 0.1, bandwidth: {bandwidth}}}]
transformations:
  - {{label: s, labor: 0, host: a, outputs: {{x: {{tag: A, rate: 2, size: 1000000}}}}}}
  - {{label: r, labor: 0, host: a, outputs: {{x: {{tag: B, rate: 1, size: 1000000}}}}}}
  - {{label: one, labor: 0, host: b, inputs: {{x: A, y: B}}}}
targets: [{{label: t, run: one}}]
"""
    assert solved(tmp_path, text.format(bandwidth=3_000_000)).cost_s == pytest.approx(3 * 10 * 0.1)
    assert solved(tmp_path, text.format(bandwidth=2_999_999)).plan.status == "infeasible"


NUMBERED = """\
transformations:
  - {{label: s, labor: 1, outputs: {{x: A}}{more}}}
  - {{label: f, inputs: {{x: {{tag: A, count: {count}}}}}, outputs: {{y: B}}}}
targets: [{{label: t, topic: /t, tag: B}}]
"""


@pytest.mark.parametrize(
    ("more", "count", "number"),
    [
        ("", 1, 1),
        ("", 9, 9),
        (", min_instances: 3", 1, 3),
        (", max_instances: 2", 2, 2),
        (", max_instances: 2", 3, None),
    ],
)
def test_a_plan_starts_one_unit_unless_instances_or_the_largest_count_say_more(
    more: str, count: int, number: int | None, tmp_path: Path
) -> None:
    found = solved(tmp_path, NUMBERED.format(more=more, count=count))
    if number is None:
        assert found.plan.status == "infeasible"
    else:
        assert found.runs.count("s") == number


def test_a_plan_starts_64_units_of_a_transformation_at_most_unless_an_input_counts_more(tmp_path: Path) -> None:
    problem = solved(tmp_path, NUMBERED.format(more=", max_instances: 1000", count=1)).problem
    assert problem.most_new(problem.environment.transformation["s"]) == MOST_INSTANCES == 64
    problem = solved(tmp_path, NUMBERED.format(more=", max_instances: 1000", count=70)).problem
    assert problem.most_new(problem.environment.transformation["s"]) == 70
    with pytest.raises(InputError, match="min_instances"):
        solved(tmp_path, NUMBERED.format(more=", min_instances: 65", count=1))


def test_two_units_may_be_started_where_failures_are_to_be_survived(tmp_path: Path) -> None:
    text = "survive: units\ntransformations: [{label: s, outputs: {x: A}}]\ntargets: [{label: t, topic: /t, tag: A}]\n"
    assert solved(tmp_path, text).runs == ["s", "s"]


def test_without_hosts_per_host_with_and_conflicts_are_about_the_one_computer(tmp_path: Path) -> None:
    text = """\
transformations:
  - {{label: s, outputs: {{x: A}}{more}}}
  - {{label: other, outputs: {{x: B}}}}
targets: [{{label: t, topic: /t, tag: A}}, {{label: u, topic: /u, tag: A}}{wants}]
"""
    other = ", {label: o, topic: /o, tag: B}"
    assert solved(tmp_path, text.format(more=", with: [other]", wants="")).runs == ["other", "s"]
    conflicts = text.format(more=", conflicts: {host: [other]}", wants=other)
    assert solved(tmp_path, conflicts).plan.status == "infeasible"
    once = text.format(more=", min_instances: 2, max_instances: 2, per_host: 1", wants="")
    assert solved(tmp_path, once).plan.status == "infeasible"


COMPANY = """\
hosts: [{{name: a}}, {{name: b}}]
transformations:
  - {{label: driver, labor: 1, outputs: {{x: D}}{required}}}
  - {{label: one, labor: 1, host: a, with: [driver], outputs: {{x: A}}}}
  - {{label: two, labor: 1, host: a, with: [driver], outputs: {{x: B}}}}
  - {{label: far, labor: 1, host: b, with: [driver], outputs: {{x: C}}}}
targets: [{{label: t, topic: /t, tag: A}}, {{label: u, topic: /u, tag: B}}, {{label: v, topic: /v, tag: C}}]
"""


def test_one_unit_on_each_host_is_company_enough_for_all_that_run_with_it(tmp_path: Path) -> None:
    assert solved(tmp_path, COMPANY.format(required="")).hosts_of("driver") == ["a", "b"]


def test_a_unit_that_others_only_run_with_does_not_count_as_used(tmp_path: Path) -> None:
    found = solved(tmp_path, COMPANY.format(required=", required: true"))
    assert "driver" in found.runs
    assert found.plan.unused_required == unused_required(found.after) == ("driver",)


def test_a_running_unit_never_becomes_a_cold_spare(tmp_path: Path) -> None:
    text = """\
survive: units
transformations: [{label: s, labor: 1, upkeep: 0.2, standby: 0.01, outputs: {x: A}}]
units: [{id: s.1, transformation: s}, {id: s.2, transformation: s}]
targets: [{label: t, topic: /t, tag: A}]
"""
    after = solved(tmp_path, text).after
    assert not any(unit.standby for unit in after.units if unit.id in ("s.1", "s.2"))


def test_targets_at_the_failed_host_are_not_asked_for(tmp_path: Path) -> None:
    text = """\
survive: hosts
hosts: [{{name: a}}, {{name: b}}]
transformations: [{{label: s, labor: 1, host: a, outputs: {{x: A}}}}]
targets: [{{label: t, topic: /t, tag: A{host}}}]
"""
    assert solved(tmp_path, text.format(host=", host: a")).plan.status == "optimal"
    assert solved(tmp_path, text.format(host=", host: b")).plan.status == "infeasible"


def test_conflicts_and_numbers_count_spares_and_min_instances_does_not(tmp_path: Path) -> None:
    text = """\
survive: units
transformations: [{{label: s, labor: 1, upkeep: 1, standby: 0.01, {number}, outputs: {{x: A}}}}]
targets: [{{label: t, topic: /t, tag: A}}]
"""
    assert solved(tmp_path, text.format(number="max_instances: 1")).plan.status == "infeasible"
    found = solved(tmp_path, text.format(number="min_instances: 2"))
    assert found.runs == ["s", "s"]
    assert len(found.after.units) == 2, "two that run survive a failure, and no spare is needed"
    cold = solved(tmp_path, text.format(number="max_instances: 2"))
    assert [unit.standby for unit in cold.after.units] == [False, True]
