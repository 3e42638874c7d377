"""The committed study: its rows can be read, do not contradict each other, and give the tables beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.compare import ENTRANTS, in_order
from experiments.study.instances import named
from experiments.study.invariants import breaches
from experiments.study.report import by_group, tables_text
from experiments.study.rows import Row, read_rows
from experiments.study.suites import SUITES

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "experiments" / "report"
QUOTED = ("cpsat", "highs", "scip", "clingo-usc", "fast-downward")
"""The planners in the table of the manual, in order."""


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return read_rows(REPORT / "results.jsonl")


def test_no_two_planners_of_the_study_contradict_each_other(rows: list[Row]) -> None:
    assert len(rows) > 1000
    assert breaches(rows) == []


def test_the_tables_are_those_of_the_results(rows: list[Row]) -> None:
    assert tables_text(in_order(rows)) == (REPORT / "tables.md").read_text()


def test_every_planner_ran_on_every_instance_of_the_suite(rows: list[Row]) -> None:
    names = {row.planner for row in rows}
    assert names <= set(ENTRANTS)
    assert len(names) >= 8
    ran = {(row.instance, row.planner) for row in rows}
    assert {(instance.name, name) for instance in SUITES["full"]() for name in names} <= ran


def test_the_instances_of_the_study_can_be_made_again(rows: list[Row]) -> None:
    for instance in ("nao(robots=20)#0", "random_library(transformations=500)#1", "adversarial(kind=cover, size=40)#0"):
        (digest,) = {row.digest for row in rows if row.instance == instance}
        assert named(instance).digest == digest


def test_the_text_shows_every_picture() -> None:
    text = (REPORT / "README.md").read_text()
    assert {path.name for path in REPORT.glob("*.png")} == {
        part.split(")")[0] for part in text.split("](") if ".png)" in part
    }


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("|")[1:-1]]


def test_readme_manual_and_report_quote_the_table_of_groups(rows: list[Row]) -> None:
    table = by_group(in_order(rows))
    groups = [dict(zip(table.heads, line, strict=True)) for line in table.lines]
    manual = (ROOT / "cfgplan" / "manual" / "comparison.md").read_text().splitlines()
    first = next(at for at, line in enumerate(manual) if line.startswith("| the case study"))
    found = [dict(zip(QUOTED, cells_of(line)[1:], strict=False)) for line in manual[first : first + len(groups)]]
    named = ["the case study", "random and replanning, 200", "smaller ones", "made by hand", "web service"]
    assert all(line.startswith(f"| {name}") for name, line in zip(named, manual[first:], strict=False))
    case, small, large, *others = groups
    assert found == [{name: group[name] for name in QUOTED} for group in (case, large, small, *others)]
    report = (REPORT / "README.md").read_text().splitlines()
    head = next(line for line in report if line.startswith("| | instances | `cpsat`"))
    names = ["group", *(cell.strip("`") for cell in cells_of(head)[1:])]
    for group in groups:
        assert "| " + " | ".join(group[name] for name in names) + " |" in report
    proven = {name: sum(row.proven for row in rows if row.planner == name) for name in QUOTED}
    total = f"cfgplan proves {proven['cpsat']} plans optimal, HiGHS {proven['highs']}, SCIP {proven['scip']}, "
    assert f"{total}clingo {proven['clingo-usc']}." in (ROOT / "README.md").read_text()
