"""What tables, plots and invariants say about rows; and a tiny comparison of every registered planner."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_rows import row

from cfgplan.comparing import REGISTERED, Limits, RunFailure
from cfgplan.comparing.runs import thinned
from cfgplan.planning import Status
from experiments.study.invariants import breaches, failures, gap, references
from experiments.study.plots import LEAST_GAP, anytime, gap_profile, performance_profile, styles
from experiments.study.report import by_family, detail, effort, overview, ratio_to, write_report
from experiments.study.rows import Row
from experiments.study.runner import run
from experiments.study.suites import SUITES


def test_planners_that_agree_breach_nothing() -> None:
    assert breaches([row("exact", 10, 1.0), row("other", 10, 2.0), row("greedy", 12), row("slow", None)]) == []


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (
            [row("exact", 10, 1.0), row("magic", 9)],
            "claims that no plan costs less than 10 us, but magic has a plan of 9 us",
        ),
        ([row("exact", 10, 1.0), row("other", 11, 1.0)], "claims that no plan costs less than 11 us"),
        ([row("exact", 10, 1.0), row("bold", None, bound_us=11)], "claims that no plan costs less than 11 us"),
        ([row("exact", 10, 1.0), row("sad", None, 1.0, outcome=Status.INFEASIBLE, bound_us=0)], "says infeasible"),
        ([row("liar", 10, violations=("it is not valid",))], "it is not valid"),
        ([row("unjudged", 10, violations=None)], "was not judged"),
    ],
)
def test_each_contradiction_is_found(rows: list[Row], says: str) -> None:
    assert any(says in text for text in breaches(rows))


def test_a_planner_without_answers_is_told_once_with_the_reason() -> None:
    rows = [
        row("fine", 10, 1.0),
        row("lost", None, outcome=RunFailure.UNAVAILABLE, message="No module named 'lost'"),
        row("lost", None, outcome=RunFailure.UNAVAILABLE, message="No module named 'lost'"),
        row("broken", None, outcome=RunFailure.CRASHED, message="KeyError: 'x' (broken.py, line 3)"),
    ]
    assert failures(rows) == [
        "broken: crashed at it: KeyError: 'x' (broken.py, line 3)",
        "lost: unavailable at it: No module named 'lost'",
    ]


def test_a_plan_that_the_judge_refuses_is_no_reference() -> None:
    rows = [row("liar", 1, violations=("false",)), row("honest", 10), row("dear", 15)]
    assert references(rows)["it", "d"].cost_us == 10
    assert [gap(r, references(rows)) for r in rows] == [None, 0.0, 0.5]


def test_costs_compare_only_between_plans_that_use_as_many_required_transformations() -> None:
    rows = [row("exact", 20, 1.0), row("cheap", 5, unused_required=1)]
    assert breaches(rows) == []
    assert gap(rows[1], references(rows)) is None
    assert "leaves a required one unused" in detail(rows).lines[0]


def test_the_ratio_is_over_what_both_proved() -> None:
    rows = [row("cpsat", 1, 2.0), row("other", 1, 8.0)]
    rows += [row("cpsat", 1, 1.0, instance="two"), row("other", 1, instance="two")]
    assert ratio_to(rows, "other", "cpsat") == (pytest.approx(4.0), 1)
    assert ratio_to(rows, "nobody", "cpsat") == (None, 0)


def test_time_outs_and_failures_are_counted_not_dropped() -> None:
    outcomes = [Status.UNKNOWN, RunFailure.KILLED, RunFailure.CRASHED, RunFailure.OUT_OF_MEMORY, RunFailure.REFUSED]
    rows = [row("p", None, instance=str(i), outcome=outcome, violations=None) for i, outcome in enumerate(outcomes)]
    column = {line[0]: line[1] for line in overview(rows).lines}
    counts = {"runs": "5", "proven": "0", "no answer in time": "2", "failed": "2", "refused": "1"}
    assert counts.items() <= column.items()
    shown = [line[-1] for line in detail(rows).lines]
    assert shown == ["no plan", "killed at the time limit", "crashed", "out of memory", "refused"]
    assert by_family(rows).lines[0][-1] == "0 of 4"


def test_each_planner_counts_its_own_effort() -> None:
    rows = [row("search", 1, counts={"nodes": 12345}), row("solver", 1, counts={"rounds": 2, "conflicts": 7})]
    assert effort(rows).lines == (("it", "12,345", "7"),)


def test_a_table_is_markdown() -> None:
    text = detail([row("exact", 2_000_000, 0.5, instance="a|b")]).markdown()
    assert "| a\\|b | 2 | 0.5 |" in text


def test_a_thinned_trace_keeps_its_ends() -> None:
    trace = [(float(i), i, 0) for i in range(1000)]
    thin = thinned(trace)
    assert len(thin) == 40
    assert (thin[0], thin[-1]) == (trace[0], trace[-1])
    assert thinned(trace[:5]) == tuple(trace[:5])


@pytest.fixture(scope="module")
def tiny_rows(warm_runs: None, tmp_path_factory: pytest.TempPathFactory) -> list[Row]:  # noqa: ARG001
    results = tmp_path_factory.mktemp("tiny") / "results.jsonl"
    return run(list(SUITES["tiny"]()), list(REGISTERED.values()), Limits(time_limit_s=20), results)


@pytest.mark.xdist_group("tiny")
def test_every_registered_planner_keeps_the_invariants_on_the_tiny_suite(tiny_rows: list[Row]) -> None:
    assert breaches(tiny_rows) == []
    tried = [r for r in tiny_rows if r.outcome != RunFailure.REFUSED]
    assert {r.planner for r in tried} == set(REGISTERED)
    assert [r.instance for r in tried if r.planner != "branch-and-bound" and not r.proven] == []
    assert all(r.has_plan and r.violations == () for r in tried)
    reference = references(tiny_rows)
    assert max(gap(r, reference) or 0.0 for r in tiny_rows if r.planner == "branch-and-bound") > 2


def test_a_panel_over_time_shows_curves_that_coincide_and_names_who_has_none() -> None:
    pytest.importorskip("matplotlib", reason="the plots need the extra `plots`")
    figure = anytime([row("thick", 10, 1.0), row("thin", 10, 1.0), row("late", None)])
    assert figure is not None
    (panel,) = figure.axes
    assert panel.get_xlabel() == "without: late"
    under, over = (line.get_linewidth() for line in panel.lines)
    assert under > over


@pytest.mark.parametrize("slowest", [1.0, 3.0, 4000.0])
def test_the_axes_of_profiles_end_where_their_data_end(slowest: float) -> None:
    """Their ends were fixed, and two decades of the axis were empty."""
    pytest.importorskip("matplotlib", reason="the plots need the extra `plots`")
    rows = [row("fast", 10, 1.0), row("slow", round(10 * slowest), slowest)]
    for profile, largest in ((performance_profile(rows), slowest), (gap_profile(rows), max(LEAST_GAP, slowest - 1))):
        assert profile is not None
        (axis,) = profile.axes
        assert largest < axis.get_xlim()[1] < 2 * largest


@pytest.mark.xdist_group("tiny")
def test_a_report_has_tables_and_plots(tiny_rows: list[Row], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the plots need the extra `plots`")
    files = write_report(tiny_rows, tmp_path / "report")
    assert {file.name for file in files} == {"tables.md", "gaps.png", "performance.png", "anytime.png", "bounds.png"}
    assert all(file.stat().st_size > 1000 for file in files)
    assert "None: all proofs agree" in files[0].read_text()


@pytest.mark.parametrize("suite", SUITES)
def test_the_instances_of_a_suite_have_names_of_their_own(suite: str) -> None:
    names = [instance.name for instance in SUITES[suite]()]
    assert len(set(names)) == len(names)


def test_each_of_many_planners_has_a_curve_and_a_mark_of_its_own() -> None:
    given = styles([row(f"planner {number:02}", 1) for number in range(30)]).values()
    assert len({(style.color, style.line[1]) for style in given}) == 30
    assert len({(style.color, style.marker) for style in given}) == 30
