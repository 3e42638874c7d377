"""`cfgplan compare`: planners side by side on the user's own files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from command import MODELS, Run

import cfgplan
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem

TWO_WAYS = """
transformations:
  - {label: one, labor: 3, outputs: {out: A}}
  - {label: both, labor: 4, outputs: {a: A, b: B}}
targets:
  - {label: a, tag: A, topic: /a}
  - {label: b, tag: B, topic: /b}
"""
pytestmark = pytest.mark.usefixtures("warm_runs")
PAIR = ("--planner", "branch-and-bound", "--planner", "exhaustive", "--timeout", "30")


def boasts(problem: Problem, **_: object) -> Plan:
    return replace(PLANNERS["cpsat"](problem), cost_us=1, bound_us=1)


def test_planners_are_compared_on_an_environment_file(run: Run, write: Callable[[str], Path]) -> None:
    path = write(TWO_WAYS)
    result = run("compare", path, *PAIR)
    assert result.code == 0
    assert str(path) in result.out
    lines = {line.split()[0]: line.split() for line in result.out.splitlines() if line.split()}
    assert lines["branch-and-bound"][1:4] == ["feasible", "7", "s"]
    assert lines["exhaustive"][1:4] == ["optimal", "4", "s"]
    assert "All proofs agree" in result.out


def test_the_plot_has_a_picture_of_each_file_with_each_planner_and_its_answer(
    run: Run, write: Callable[[str], Path], tmp_path: Path
) -> None:
    path, plot = write(TWO_WAYS), tmp_path / "planners.svg"
    other = MODELS / "nao" / "2-segmenter-lost.yaml"
    assert run("compare", path, other, *PAIR, "--plot", plot).code == 0
    drawn = plot.read_text()
    for text in (path, other, "branch-and-bound: feasible", "exhaustive: optimal"):
        assert f"<!-- {text} -->" in drawn, text
    refused = run("compare", path, "--plot", tmp_path / "planners.txt")
    assert refused.code == 30 and "does not end as a plot does" in refused.err


def test_without_any_proof_none_are_said_to_agree(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare", write(TWO_WAYS), "--planner", "branch-and-bound")
    assert result.code == 0
    assert "proofs agree" not in result.out


def test_every_run_on_every_file_is_in_the_json(run: Run, write: Callable[[str], Path]) -> None:
    path, other = write(TWO_WAYS), MODELS / "nao" / "2-segmenter-lost.yaml"
    result = run("compare", path, other, "--planner", "branch-and-bound", "--planner", "cpsat", "--json")
    assert result.code == 0
    assert result.document["contradictions"] == []
    about = {key: result.document[key] for key in ("cfgplan", "time_limit_s", "memory_mb")}
    assert about == {"cfgplan": cfgplan.__version__, "time_limit_s": 10.0, "memory_mb": None}
    digests = {each["environment"]: each["environment_digest"] for each in result.document["runs"]}
    assert digests == {str(env): cfgplan.load(env).digest for env in (path, other)}
    assert [(r["environment"], r["planner"], r["cost_us"]) for r in result.document["runs"][:2]] == [
        (str(path), "branch-and-bound", 7_000_000),
        (str(path), "cpsat", 4_000_000),
    ]
    assert [r["environment"] for r in result.document["runs"][2:]] == [str(other)] * 2


def test_what_the_paper_does_not_know_is_planned_by_those_who_do(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare", write(f"hosts: [{{name: a}}]\n{TWO_WAYS}"), *PAIR, "--planner", "cpsat", "--json")
    assert [r["outcome"] for r in result.document["runs"]] == ["refused", "optimal", "optimal"]


def test_a_planner_that_lies_is_contradicted(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare", write(TWO_WAYS), "--planner", "cpsat", "--planner", f"{__name__}:boasts")
    assert result.code == 1
    assert "contradiction" in result.out
    assert "the update costs 4000000 us, but the plan says 1 us" in result.out


def test_nothing_to_compare_and_unknown_planners_are_bad_input(run: Run, write: Callable[[str], Path]) -> None:
    result = run("compare")
    assert result.code == 30
    assert "ENV" in result.err
    result = run("compare", write(TWO_WAYS), "--planner", "astrology")
    assert result.code == 30
    assert "there is no planner `astrology`" in result.err


@pytest.mark.parametrize(
    ("planner", "says"),
    [
        ("os:nothere", "module os has no function nothere"),
        ("os:sep", "module os has no function sep"),
        ("no_such_module:plan", "No module named 'no_such_module'"),
        ("os:", "'os:' is not module:function"),
    ],
)
def test_a_planner_that_is_not_there_is_refused_before_any_run(
    run: Run, write: Callable[[str], Path], planner: str, says: str
) -> None:
    result = run("compare", write(TWO_WAYS), "--planner", "branch-and-bound", "--planner", planner)
    assert (result.code, result.out) == (30, "")
    assert says in result.err
