"""`cfgplan solve` as a user and as a script see it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command import MODELS, Run

from cfgplan.cli.plan_text import why_unused
from cfgplan.domain import ChangeSet
from cfgplan.errors import InputError
from cfgplan.formats.plan_file import load_plan
from cfgplan.planning import Plan, Status

LOST = MODELS / "nao" / "2-segmenter-lost.yaml"
TWO_WAYS = """
transformations:
  - {label: cheap, labor: 1, upkeep: 0.5, outputs: {o: Wanted}}
  - {label: dear, labor: 9, upkeep: 0, outputs: {o: Wanted}}
targets: [{label: t, topic: /t, tag: Wanted}]
"""


def test_it_says_what_starts_is_rewired_and_stays_and_what_it_costs(run: Run) -> None:
    result = run("solve", LOST)
    assert result.code == 0
    assert "+ start   segmenter(piff).1" in result.out
    assert "y <- subsampler(piff).1/y80" in result.out
    assert "~ rewire  ball_detector(piff).1" in result.out
    assert "hull <- segmenter(piff).1/hull   (was not connected)" in result.out
    assert "= keep    bottom_cam(piff).1" in result.out
    assert "1 to start, 1 to rewire, 0 to stop, 4 kept" in result.out
    assert "18.95 s of CPU = labor 0.35 s + upkeep 18.6 s" in result.out
    assert "Optimal: no update is cheaper, proven by cpsat." in result.out


def test_that_a_required_transformation_can_not_be_used_is_said_only_where_it_is_proven(
    run: Run, write: Callable[[str], Path]
) -> None:
    env = write(
        """
transformations:
  - {label: plain, labor: 1, outputs: {o: Wanted}}
  - {label: source, labor: 1, outputs: {o: Raw}}
  - {label: fusion, labor: 9, required: true, inputs: {i: Raw}, outputs: {o: Wanted}}
targets: [{label: t, topic: /t, tag: Wanted}]
"""
    )
    said = "Required fusion is not used: "
    assert said not in run("solve", env).out
    assert (
        f"{said}branch-and-bound does not support `required`." in run("solve", env, "--planner", "branch-and-bound").out
    )
    assert f"{said}no valid configuration can use it with the others." in run("solve", env, "--without", "source").out
    plan = Plan("cpsat", Status.FEASIBLE, ChangeSet(), 1, unused_required=("fusion",))
    assert why_unused(plan) == "no plan that uses it was found in time"


def test_its_text_is_plain_where_there_is_no_terminal(run: Run) -> None:
    assert "\x1b" not in "".join(run("solve", LOST)[1:])


def test_a_longer_horizon_can_turn_the_choice(run: Run, write: Callable[[str], Path]) -> None:
    env = write(TWO_WAYS)
    assert "cheap.1" in run("solve", env).out
    assert "dear.1" in run("solve", env, "--horizon", "100").out


def test_a_changing_update_can_be_told_by_the_exit_code(run: Run, write: Callable[[str], Path]) -> None:
    assert run("solve", write(TWO_WAYS), "--detailed-exitcode").code == 2
    assert run("solve", MODELS / "nao" / "3-puff-registered.yaml", "--detailed-exitcode").code == 0


def test_no_plan_exits_with_10_and_a_reason_for_each_target(run: Run) -> None:
    result = run("solve", MODELS / "nao" / "0-target-only.yaml")
    assert result.code == 10
    assert "target ball wants Position" in result.out


def test_a_plan_above_the_largest_cost_exits_with_11_and_says_both_costs(run: Run) -> None:
    result = run("solve", LOST, "--max-cost", "18.9")
    assert result.code == 11
    assert "18.95 s" in result.out
    assert "18.9 s" in result.out
    assert run("solve", LOST, "--max-cost", "18.95").code == 0


def test_an_unproven_plan_exits_with_20(run: Run) -> None:
    result = run("solve", LOST, "--planner", "branch-and-bound")
    assert result.code == 20
    assert "has not proven it optimal" in result.out


def test_json_and_the_plan_file_are_the_same_document(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    result = run("solve", LOST, "--json", "--out", out)
    document = json.loads(out.read_text())
    assert result.document == document
    assert document["format_version"] == 1
    assert document["status"] == "optimal"
    assert [unit["id"] for unit in document["change_set"]["started"]] == ["segmenter(piff).1"]


def test_a_plan_can_not_be_written_where_there_is_no_folder(run: Run, tmp_path: Path) -> None:
    result = run("solve", LOST, "--out", tmp_path / "missing" / "plan.json")
    assert result.code == 30
    assert "missing" in result.err


def test_wrong_numbers_are_refused_with_the_option_named(run: Run) -> None:
    for option, value in (("--horizon", "1.5"), ("--horizon", "-1"), ("--max-cost", "nan"), ("--timeout", "-1")):
        result = run("solve", LOST, option, value)
        assert result.code == 30
        assert f"argument {option}" in result.err


def test_without_time_the_first_plan_is_given(run: Run) -> None:
    result = run("solve", LOST, "--timeout", "0", "--json")
    assert result.code in (0, 20)
    assert [unit["id"] for unit in result.document["change_set"]["started"]]


def test_progress_is_told_as_json_lines(run: Run) -> None:
    lines = [json.loads(line) for line in run("solve", LOST, "--progress").err.splitlines() if line.startswith("{")]
    assert lines
    assert lines[-1]["cost_us"] == 18_950_000


@pytest.mark.parametrize("env", [LOST, LOST.with_name("4-fusion-available.yaml")])
def test_neither_solver_nor_what_only_others_need_is_imported_where_the_bounds_meet(env: Path) -> None:
    code = (
        "import sys\nfrom cfgplan.cli import main\n"
        f"assert main(['solve', {str(env)!r}]) == 0\n"
        "assert not {'ortools', 'msgspec', 'numpy.ma', 'cfgplan.formats.xml_text'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


MOST_MODULES = 290
"""`solve` of the README's case may import so many modules; it imports 280."""
NEEDLESS = {"numpy", "pydantic", "pydantic_core", "rich", "ortools", "owlready2", "aiohttp", "starlette", "asyncio"}
NEEDLESS |= {"shutil", "logging", "calendar"}
NEEDLESS_PARTS = (
    *("cfgplan.matching.session", "cfgplan.formats.models", "cfgplan.explaining", "cfgplan.validity.rewiring"),
    *("cfgplan.planners.closing", "cfgplan.planners.bounding.bounds", "cfgplan.planners.exact.best_case"),
)


def test_a_small_plan_is_printed_to_a_file_without_numpy_pydantic_rich_and_reasoners(tmp_path: Path) -> None:
    """The second time, when answers about tags are kept; told by the modules rather than by a clock."""
    code = (
        "import sys\nfrom cfgplan.cli import main\n"
        f"assert main(['solve', {str(LOST)!r}]) == 0\n"
        "print(*sys.modules, sep='\\n', file=sys.stderr)"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    for _ in range(2):
        found = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
        )
    assert found.stdout.startswith("  + start   segmenter(piff).1")
    modules = found.stderr.splitlines()[1:]
    assert NEEDLESS.isdisjoint(name.partition(".")[0] for name in modules)
    assert not {*NEEDLESS_PARTS} & {*modules}
    assert len(modules) <= MOST_MODULES


def test_an_ontology_that_is_not_there_is_told_with_the_key_that_names_it(
    run: Run, write: Callable[[str], Path]
) -> None:
    result = run("solve", write("ontology: https://example.org/robots.ttl\n"))
    assert result.code == 30
    assert "web addresses are not fetched" in result.err


def _break_the_judge(*_: object) -> list[object]:
    raise RecursionError("too deep")


def _refuse(*_: object) -> list[str]:
    return ["the update costs 1 us"]


@pytest.mark.parametrize(
    ("broken", "what", "told"),
    [
        ("cfgplan.api.plan_violations", _break_the_judge, "the judge failed: RecursionError: too deep"),
        ("cfgplan.api.plan_violations", _refuse, "the answer of planner cpsat is wrong: the update costs 1 us"),
        ("cfgplan.cli.plan_text._summary", _break_the_judge, "it can't be shown: RecursionError: too deep"),
        ("cfgplan.api.plan_text", _break_the_judge, "it can't be shown: RecursionError: too deep"),
    ],
)
def test_a_plan_is_printed_and_marked_whatever_fails_after_it_was_found(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, broken: str, what: Callable[..., object], told: str
) -> None:
    monkeypatch.setattr(broken, what)
    result = run("solve", MODELS / "nao/2-segmenter-lost.yaml", "--out", tmp_path / "plan.json")
    assert result.code == 31
    assert "segmenter(piff).1" in result.out
    assert "Optimal" not in result.out
    assert f"Do not rely on this plan: {told}" in result.err
    assert "Traceback" not in result.err


def test_a_wrong_cost_of_a_planner_is_shown_beside_the_true_parts(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "liar.py").write_text(
        "from dataclasses import replace\n"
        "from cfgplan.planners import cpsat\n"
        "def plan(problem, *, time_limit_s=None, report=None):\n"
        "    return replace(cpsat.plan(problem, time_limit_s=time_limit_s), cost_us=100_000, bound_us=0)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    result = run("solve", LOST, "--planner", "liar:plan")
    assert result.code == 31
    line = next(line for line in result.out.splitlines() if line.startswith("Cost"))
    assert "18.95 s of CPU = labor 0.35 s + upkeep 18.6 s, but liar:plan says 0.1 s" in line
    assert "-" not in line and "−" not in line


def test_an_unjudged_plan_is_one_json_document_that_says_so_and_can_not_be_loaded(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("cfgplan.api.plan_violations", _break_the_judge)
    result = run("solve", MODELS / "nao/2-segmenter-lost.yaml", "--json", "--out", tmp_path / "plan.json")
    assert result.code == 31
    assert result.document["unjudged"] == "the judge failed: RecursionError: too deep"
    assert [unit["id"] for unit in result.document["change_set"]["started"]] == ["segmenter(piff).1"]
    assert (result.document["status"], result.document["bound_us"]) == ("feasible", 0)
    assert not (tmp_path / "plan.json").exists()
    (tmp_path / "kept.json").write_text(result.out)
    with pytest.raises(InputError, match="unjudged"):
        load_plan(tmp_path / "kept.json")


def test_where_nothing_was_found_before_a_fault_there_is_only_the_fault(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cfgplan.api.plan_violations", _break_the_judge)
    result = run("solve", MODELS / "nao/0-target-only.yaml")
    assert (result.code, result.out) == (31, "")
    assert "the judge failed" in result.err
