"""Every world under `models/` gives the answer that stands beside it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
import yaml

import cfgplan
from cfgplan.costs import microseconds
from cfgplan.figures import cost_parts, qualities_of_targets
from cfgplan.qualities import micro_units

MODELS = Path(__file__).parent.parent / "models"
CASES = [
    pytest.param(path, number, id=f"{path.parent.name}/{path.name.removesuffix('.expected.yaml')}[{number}]")
    for path in sorted(MODELS.rglob("*.expected.yaml"))
    for number in range(len(yaml.load(path.read_text(), yaml.CSafeLoader)))
]


@pytest.mark.parametrize(("expected_file", "number"), CASES)
def test_the_answer_is_the_one_beside_the_environment(expected_file: Path, number: int) -> None:
    expected: dict[str, Any] = yaml.load(expected_file.read_text(), yaml.BaseLoader)[number]
    world = cfgplan.load(expected_file.with_name(expected_file.name.replace(".expected.yaml", ".yaml")))
    horizon_s = int(expected["horizon"]) if "horizon" in expected else None
    problem = cfgplan.match(world, horizon_s=horizon_s)
    plan = cfgplan.plan(problem, planner=expected.get("planner", "cpsat"))

    assert plan.status == expected["status"]
    assert cfgplan.plan_violations(problem, plan) == []
    if plan.change_set is None:
        assert sorted(plan.reasons) == expected["unmet"]
        return
    assert plan.cost_us == microseconds(Decimal(expected["cost"]))
    assert [unit.id for unit in plan.change_set.started] == expected["started"]
    assert [unit.id for unit in plan.change_set.rewired] == expected["rewired"]
    assert list(plan.change_set.stopped) == expected["stopped"]
    after = problem.environment.update(plan.change_set)
    reached = qualities_of_targets(after, after.units)
    for target, values in expected.get("quality", {}).items():
        assert {name: reached[target][name] for name in values} == {
            name: micro_units(Decimal(value)) for name, value in values.items()
        }
    if "hosts" in expected:
        number = Counter(unit.host or "" for unit in after.units)
        assert among_alike(number) == among_alike({host: int(count) for host, count in expected["hosts"].items()})
    assert sum(unit.standby for unit in after.units) == int(expected.get("spares", 0))
    parts = cost_parts(problem, after.units)
    assert parts.transfer_us == microseconds(Decimal(expected.get("transfers", 0)))
    assert parts.rent_us == microseconds(Decimal(expected.get("rent", 0)))


def among_alike(number: Mapping[str, int]) -> dict[str, list[int]]:
    """How many units there are on each host, where copies of one host are alike."""
    found = defaultdict(list)
    for host, count in number.items():
        found[host.partition(".")[0]].append(count)
    return {host: sorted(counts) for host, counts in found.items()}


def test_each_stage_of_the_case_study_starts_where_the_last_one_ended() -> None:
    def solved(name: str) -> cfgplan.Environment:
        problem = cfgplan.match(cfgplan.load(MODELS / "nao" / f"{name}.yaml"))
        change_set = cfgplan.plan(problem).change_set
        assert change_set is not None
        return problem.environment.update(change_set)

    mended = solved("2-segmenter-lost")
    assert mended.units == solved("1-piff-registered").units
    assert mended.units == cfgplan.load(MODELS / "nao" / "3-puff-registered.yaml").environment.units
    assert mended.units == solved("3-puff-registered").units == solved("4-fusion-available").units


@pytest.mark.parametrize("stage", ["2-radio-weak", "3-mule-tired", "5-long-way"])
def test_the_robots_begin_each_stage_as_planned(stage: str) -> None:
    problem = cfgplan.match(cfgplan.load(MODELS / "rescue" / "1-start.yaml"))
    started = problem.after(cfgplan.plan(problem)).units
    assert cfgplan.load(MODELS / "rescue" / f"{stage}.yaml").environment.units == started


def test_the_whole_matrix_of_the_case_study_has_nine_rows_and_twenty_columns() -> None:
    environment = cfgplan.load(MODELS / "nao" / "1-piff-registered.yaml").environment
    assert sum(len(t.inputs) for t in environment.library) + len(environment.targets) == 9
    assert sum(len(t.outputs) for t in environment.library) == 20
