"""The comparison at scale: what its tables say about rows, and that the committed ones are those of the rows there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from made_rows import row

from cfgplan.comparing import RunFailure
from cfgplan.domain import Similarity
from cfgplan.planning import Status
from experiments.compare import AT_SCALE, ENTRANTS, in_order
from experiments.families.random_library import random_library
from experiments.planning import ALL_SEEDS, THREE_SEEDS, VARIANTS, takes_part
from experiments.planning.scale_suite import SCALE, SCALE_SEEDS, scale
from experiments.planning.scale_tables import (
    behind,
    building,
    everyone,
    families,
    known_after,
    peer_by_peer,
    quoted,
    scale_text,
    summary,
)
from experiments.planning.scaling import load_s, read_loads
from experiments.study.instances import generated
from experiments.study.invariants import breaches
from experiments.study.rows import Row, read_rows

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "experiments" / "planning" / "scale"
SMALL, LARGE = SCALE["50"], SCALE["5,000"]

ROWS = [
    row("cpsat", 10, 1.0, instance="s#0", parameters=SMALL, seconds={"closure": 0.25, "bounds": 0.5, "search": 0.25}),
    row("highs", 10, 4.0, instance="s#0", parameters=SMALL, seconds={"build": 0.5, "search": 3.5}),
    row("cuts-alone", 10, 0.5, instance="s#0", parameters=SMALL),
    row("cpsat", 10, 2.0, instance="s#1", parameters=SMALL),
    row("highs", 10, 1.0, instance="s#1", parameters=SMALL),
    row("cpsat", 100, instance="l#0", parameters=LARGE, bound_us=90),
    row("highs", 110, instance="l#0", parameters=LARGE, bound_us=95),
]


def test_rows_belong_to_the_family_of_their_parameters() -> None:
    assert {name: len(group) for name, group in families(ROWS).items()} == {"50": 5, "5,000": 2}


def test_the_summary_names_the_closest_peer_and_the_mean_over_families() -> None:
    assert summary(ROWS).lines == (
        ("50", "2 of 2", "1.4 (1 to 2)", "highs", "1.4", "1.4"),
        ("5,000", "0 of 1", "-", "highs", "1 open: bounds 0:1, plans 1:0", "1 open: bounds 0:1, plans 1:0"),
        ("geometric mean", "", "", "", "1.4 (families: 1)", "1.4 (families: 1)"),
    )


def test_each_peer_is_compared_by_itself_on_all_families() -> None:
    assert peer_by_peer(ROWS).lines == (("highs", "2 of 3", "1.4 (families: 1)", "1.4 (50)"),)


def test_every_instance_with_another_ahead_is_named() -> None:
    assert [line[:2] for line in behind(ROWS).lines] == [("s#0", "cuts-alone"), ("s#1", "highs"), ("l#0", "highs")]


def test_planning_is_set_against_loading_and_building_against_solving() -> None:
    small, large = building(ROWS, {"s#0": 0.5}).lines
    assert small == ("50", "0.5", "2", "4", "25%", "50%", "25%", "0.5")
    assert large[:4] == ("5,000", "-", "5", "-")


def test_gaps_of_what_is_not_proven_are_to_the_best_cost_of_all_planners() -> None:
    lines = {line[:2]: line[2:] for line in everyone(ROWS).lines}
    assert lines["5,000", "highs"] == ("0 of 1", "-", "-5.0%", "+10.0%", "10", "1 open: bounds 0:1, plans 1:0")
    assert lines["50", "highs"] == ("2 of 2", "2 (1 to 4)", "", "", "10", "1.4")


def test_gaps_are_those_after_ten_seconds_also_of_what_is_proven_later() -> None:
    trace = ((1.0, 20, 0), (9.0, 12, 8), (11.0, 10, 9))
    late = row("highs", 10, 12.0, instance="s#0", parameters=SMALL, time_limit_s=30.0, trace=trace)
    assert everyone([ROWS[0], late]).lines[1][2:6] == ("1 of 1", "12", "-20.0%", "+20.0%")
    assert known_after(late, 12.0) is late
    assert known_after(late, 0.5).outcome is Status.UNKNOWN


@pytest.mark.parametrize("name", VARIANTS)
def test_variants_say_what_can_not_be_met(name: str) -> None:
    found = VARIANTS[name].planner()(replace(random_library(0, transformations=8), similarity=Similarity({})))
    assert found.status is Status.INFEASIBLE
    assert found.reasons


def test_how_a_planner_failed_is_told() -> None:
    lost = row("highs", None, instance="s#0", parameters=SMALL, outcome=RunFailure.OUT_OF_MEMORY, violations=None)
    assert everyone([ROWS[0], lost]).lines[1][2:6] == ("0 of 1, 1 out of memory", "-", "-100.0%", "1 without")


def test_what_a_planner_refuses_counts_neither_as_a_run_nor_as_a_gap() -> None:
    refused = row("highs", None, instance="s#0", parameters=SMALL, outcome=RunFailure.REFUSED, violations=None)
    assert everyone([ROWS[0], refused]).lines[1][2:6] == ("1 refused", "-", "", "")
    assert everyone([ROWS[0], refused, ROWS[4]]).lines[1][2:6] == ("1 of 1, 1 refused", "1", "", "")


def test_who_ran_on_a_part_of_a_family_is_not_its_closest_peer() -> None:
    once = row("clingo-bb", 10, 0.1, instance="s#0", parameters=SMALL)
    assert summary([*ROWS, once]).lines[0][3] == "highs"


def test_one_planner_alone_has_tables_too() -> None:
    assert "### Every planner" in scale_text([each for each in ROWS if each.planner == "cpsat"], {})


def test_everyone_takes_part_in_the_first_seed_of_each_family_some_in_three_and_the_closest_in_all() -> None:
    for instance in scale():
        names = {name for name in AT_SCALE if takes_part(instance, ENTRANTS[name])}
        assert names >= ALL_SEEDS
        assert (names == set(AT_SCALE)) == (instance.seed == SCALE_SEEDS[0])
        assert (names >= THREE_SEEDS) == (instance.seed in SCALE_SEEDS[:3])


def test_loading_is_timed_in_a_process_of_its_own() -> None:
    assert 0 < load_s(generated("random_library", 0, transformations=20)) < 10


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return in_order(read_rows(REPORT / "results.jsonl"))


def test_no_two_planners_contradict_each_other_at_scale(rows: list[Row]) -> None:
    assert breaches(rows) == []


def test_the_tables_at_scale_are_those_of_the_results(rows: list[Row]) -> None:
    assert scale_text(rows, read_loads(REPORT)) == (REPORT / "tables.md").read_text()


def test_every_planner_ran_on_every_instance_that_it_takes_part_in(rows: list[Row]) -> None:
    assert set(AT_SCALE) <= set(ENTRANTS)
    due = {(i.name, name) for i in scale() for name in AT_SCALE if takes_part(i, ENTRANTS[name])}
    assert {(row.instance, row.planner) for row in rows} == due


def test_the_manual_quotes_the_table_made_for_it(rows: list[Row]) -> None:
    manual = (ROOT / "cfgplan" / "manual" / "comparison.md").read_text().splitlines()
    for line in quoted(rows).lines:
        assert "| " + " | ".join(line) + " |" in manual
