"""`cfgplan compare` on the user's own files and on suites."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from command import Run

TWO_WAYS = """
transformations:
  - {label: one, labor: 3, outputs: {out: A}}
  - {label: both, labor: 4, outputs: {a: A, b: B}}
targets:
  - {label: a, tag: A, topic: /a}
  - {label: b, tag: B, topic: /b}
"""
PAIR = ("--planner", "branch-and-bound", "--planner", "exhaustive", "--timeout", "30")
"""The time covers the warm-up of the oracle too, beside whatever else the machine does."""


def test_planners_are_compared_on_an_environment_file(run: Run, write: Callable[[str], Path]) -> None:
    path = write(TWO_WAYS)
    result = run("compare", path, *PAIR)
    assert result.code == 0
    assert f"| {path} | 4 | +75.0% |" in result.out
    assert "All proofs agree" in result.out


def test_without_any_proof_none_are_said_to_agree(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare", write(TWO_WAYS), "--planner", "branch-and-bound")
    assert result.code == 0
    assert "proofs agree" not in result.out


def test_every_run_is_in_the_json(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare", write(TWO_WAYS), *PAIR, "--json")
    assert result.code == 0
    assert result.document["contradictions"] == []
    assert [(r["planner"], r["cost_us"]) for r in result.document["runs"]] == [
        ("branch-and-bound", 7_000_000),
        ("exhaustive", 4_000_000),
    ]


def test_results_that_are_kept_are_not_run_again(run: Run, write: Callable[[str], Path], tmp_path: Path) -> None:
    path, kept = write(TWO_WAYS), tmp_path / "kept.jsonl"
    run("compare", path, *PAIR, "--results", kept)
    before = kept.read_text()
    assert before.count("\n") == 2
    assert run("compare", path, *PAIR, "--results", kept).code == 0
    assert kept.read_text() == before


def test_a_report_is_written(run: Run, write: Callable[[str], Path], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the plots need the extra `plots`")
    result = run("compare", write(TWO_WAYS), *PAIR, "--report", tmp_path / "report")
    assert result.code == 0
    assert "Results of the comparison" in (tmp_path / "report" / "tables.md").read_text()


def test_nothing_to_compare_and_unknown_planners_are_bad_input(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare")
    assert result.code == 30
    assert "name environment files" in result.err
    result = run("compare", write(TWO_WAYS), "--planner", "astrology")
    assert result.code == 30
    assert "there is no planner 'astrology'" in result.err


@pytest.mark.parametrize(
    ("planner", "says"),
    [
        ("os:nothere", "module os has no function nothere"),
        ("os:sep", "module os has no function sep"),
        ("no_such_module:plan", "No module named 'no_such_module'"),
        ("os:", "there is no planner 'os:'"),
    ],
)
def test_a_planner_that_is_not_there_is_refused_before_any_run(
    run: Run, write: Callable[[str], Path], planner: str, says: str, tmp_path: Path
) -> None:
    kept = tmp_path / "kept.jsonl"
    result = run("compare", write(TWO_WAYS), "--planner", "branch-and-bound", "--planner", planner, "--results", kept)
    assert (result.code, result.out) == (30, "")
    assert says in result.err
    assert not kept.exists()


def test_a_report_that_can_not_be_written_is_refused_before_any_run(
    run: Run, write: Callable[[str], Path], tmp_path: Path
) -> None:
    path, kept = write(TWO_WAYS), tmp_path / "kept.jsonl"
    for report in (path, path / "report"):
        result = run("compare", path, *PAIR, "--results", kept, "--report", report)
        assert (result.code, result.out) == (30, "")
        assert f"error: {report}: the report can't be written" in result.err
        assert not kept.exists()


def test_a_report_without_matplotlib_is_refused_before_any_run(
    run: Run, write: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cfgplan.cli.compare.find_spec", lambda _: None)
    result = run("compare", write(TWO_WAYS), *PAIR, "--report", tmp_path / "report")
    assert (result.code, result.out) == (30, "")
    assert "pip install 'cfgplan[plots]'" in result.err
