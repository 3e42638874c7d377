"""A planner of one's own, named as module:function, in `solve`, `run` and `compare` and in Python."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path

import pytest

import cfgplan
from cfgplan.cli import main
from cfgplan.cli.exits import Exit
from cfgplan.comparing import Limits, RunFailure, entrant, run_one
from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS, exhaustive
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planning import OwnPlannerError, Plan, Planner, PlannerFaultError, Problem, Status
from experiments.study.instances import generated
from experiments.study.plots import write_plots
from experiments.study.runner import run_one as row_of

ROOT = Path(__file__).parents[2]
LOST = str(ROOT / "models" / "nao" / "2-segmenter-lost.yaml")
SMALL = generated("adversarial", kind="dedicated", size=3)
LIMITS = Limits(time_limit_s=20)


def knows_better(problem: Problem, **_: object) -> Plan:
    return PLANNERS["cpsat"](problem)


def breaks(problem: Problem, **_: object) -> Plan:
    raise ZeroDivisionError(f"{len(problem.environment.library)} transformations are too many for me")


def answers_with_a_number(_: Problem, **__: object) -> int:
    return 42


def asks_for_less(_: Problem) -> Plan:
    raise AssertionError("it can't be called")


def boasts(problem: Problem, **_: object) -> Plan:
    return replace(PLANNERS["cpsat"](problem), cost_us=1, bound_us=1)


def makes_an_impossible_value(problem: Problem, **_: object) -> Plan:
    return replace(PLANNERS["cpsat"](problem), counts={"steps": "many"})  # type: ignore[dict-item]


def reports_a_text(problem: Problem, *, report: Callable[[object], None] | None = None, **_: object) -> Plan:
    assert report is not None
    report("half done")
    return PLANNERS["cpsat"](problem)


def leaves(_: Problem, **__: object) -> Plan:
    raise SystemExit(2)


def named(function: Callable[..., object]) -> str:
    return f"{__name__}:{function.__name__}"


def test_it_solves_under_its_own_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", LOST, "--planner", named(knows_better)]) == Exit.OK
    assert f"proven by {named(knows_better)}" in capsys.readouterr().out
    problem = cfgplan.match(cfgplan.load(LOST))
    assert cfgplan.plan(problem, planner=knows_better) == cfgplan.plan(problem, planner=named(knows_better))


@pytest.mark.parametrize(
    ("planner", "name"),
    [(PlannerSession().plan, "cpsat"), (exhaustive.plan, "exhaustive"), (PLANNERS["cpsat"], "cpsat")],
)
def test_a_function_of_cfgplan_plans_under_the_name_of_its_planner(planner: Planner, name: str) -> None:
    problem = cfgplan.match(cfgplan.load(LOST))
    assert cfgplan.plan(problem, planner=planner).planner == name


def test_a_planner_that_wraps_one_of_cfgplan_is_its_author_s_own() -> None:
    """`functools.wraps` gives it the module's name of cfgplan's planner: its faults were told as cfgplan's."""

    @wraps(exhaustive.plan)
    def broken(problem: Problem, **_: object) -> Plan:
        raise ZeroDivisionError(f"{len(problem.environment.library)} are too many")

    with pytest.raises(OwnPlannerError, match="failed: ZeroDivisionError"):
        cfgplan.plan(cfgplan.match(cfgplan.load(LOST)), planner=broken)


def test_the_fault_of_a_planner_that_it_calls_is_told_as_that_planner_s() -> None:
    fault = PlannerFaultError("a wrong bound", Plan("cpsat", Status.UNKNOWN))

    def calls(problem: Problem, **_: object) -> Plan:
        raise fault if problem.environment.library else ZeroDivisionError

    with pytest.raises(PlannerFaultError) as raised:
        cfgplan.plan(cfgplan.match(cfgplan.load(LOST)), planner=calls)
    assert raised.value is fault


def test_run_takes_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", LOST, "--dry-run", "--planner", named(knows_better)]) == Exit.OK
    assert "segmenter(piff).1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("planner", "says", "mend"),
    [
        (breaks, "failed: ZeroDivisionError: 6 transformations are too many for me", "CFGPLAN_TRACEBACK=1 shows where"),
        (answers_with_a_number, "returned 42, not a cfgplan.Plan", "return a cfgplan.Plan, with the status UNKNOWN"),
        (makes_an_impossible_value, "failed: InvalidValueError: Plan", "CFGPLAN_TRACEBACK=1 shows where"),
        (leaves, "failed: SystemExit: 2", "CFGPLAN_TRACEBACK=1 shows where"),
        (asks_for_less, "can't be called: got an unexpected keyword argument", "write it as `def plan(problem, *,"),
    ],
)
def test_a_fault_of_its_own_is_told_as_such(
    planner: Callable[..., object],
    says: str,
    mend: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("CFGPLAN_TRACEBACK", raising=False)
    assert main(["solve", LOST, "--planner", named(planner)]) == Exit.BAD_INPUT
    said = capsys.readouterr().err
    assert says in said
    assert mend in said
    assert "bug in cfgplan" not in said
    monkeypatch.setenv("CFGPLAN_TRACEBACK", "1")
    with pytest.raises(OwnPlannerError):
        main(["solve", LOST, "--planner", named(planner)])


def test_a_plan_that_the_judge_refuses_is_its_own_fault(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", LOST, "--planner", named(boasts)]) == Exit.INTERNAL
    said = capsys.readouterr().err
    assert "Do not rely on this plan" in said
    assert f"This is a bug in the planner {named(boasts)}, not in cfgplan." in said


@pytest.mark.parametrize("verb", ["solve", "run", "compare", "explain"])
def test_one_that_is_not_there_is_named_before_any_work(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, "nothing.yaml", "--planner", "no_such_module:plan"]) == Exit.BAD_INPUT
    said = capsys.readouterr().err
    assert "No module named 'no_such_module'" in said
    assert "nothing.yaml:" not in said


def test_one_in_the_folder_of_the_call_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "planner_of_this_folder.py").write_text(
        "from cfgplan.planners import PLANNERS\n\ndef plan(problem, **more):\n    return PLANNERS['cpsat'](problem)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [entry for entry in __import__("sys").path if entry])
    for verb in ("solve", "compare"):
        assert main([verb, LOST, "--planner", "planner_of_this_folder:plan"]) == Exit.OK
        assert "planner_of_this_folder:plan" in capsys.readouterr().out


@pytest.mark.parametrize("verb", ["solve", "compare"])
@pytest.mark.parametrize(
    ("code", "says", "mend"),
    [
        ("def plan(problem) pass", "can't be imported: SyntaxError: expected ':'", "CFGPLAN_TRACEBACK=1 shows where"),
        ("import sys\nsys.exit('no')", "can't be imported: SystemExit: no", "CFGPLAN_TRACEBACK=1 shows where"),
        ("import no_such_package", "No module named 'no_such_package'", "broken_planner imports it: correct that line"),
        ("from cfgplan import Plane", "cannot import name 'Plane'", "broken_planner imports it: correct that line"),
    ],
)
def test_a_fault_of_its_module_is_told_as_such(
    verb: str,
    code: str,
    says: str,
    mend: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It was called a bug in cfgplan, or a module that is not there."""
    (tmp_path / "broken_planner.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    assert main([verb, LOST, "--planner", "broken_planner:plan"]) == Exit.BAD_INPUT
    said = capsys.readouterr().err
    assert says in said
    assert mend in said
    assert "bug in cfgplan" not in said


def test_compare_tells_no_line_of_its_own_for_one_that_can_t_be_called() -> None:
    row = run_one(SMALL.problem, entrant(named(asks_for_less)), LIMITS)
    assert row.message == "TypeError: asks_for_less() got an unexpected keyword argument 'time_limit_s'"


def test_compare_says_why_one_crashed_and_does_not_end_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["compare", LOST, "--planner", "cpsat", "--planner", named(breaks)]
    assert main(arguments) == Exit.INVALID
    out = capsys.readouterr().out
    assert "ZeroDivisionError: 6 transformations are too many for me (test_own_planner.py, line" in out
    assert "proofs agree" not in out
    assert "Traceback" not in out
    assert main([*arguments, "--traceback"]) == Exit.INVALID
    assert "Traceback (most recent call last)" in capsys.readouterr().out
    assert run_one(SMALL.problem, entrant(named(answers_with_a_number)), LIMITS).outcome == RunFailure.CRASHED


@pytest.mark.parametrize(
    ("planner", "error"),
    [
        (makes_an_impossible_value, "InvalidValueError: Plan: counts must be a mapping"),
        (reports_a_text, "TypeError: it reported 'half done', not a cfgplan.Progress"),
    ],
)
def test_a_crash_inside_of_cfgplan_is_told_with_the_line_of_the_planner(
    planner: Callable[..., object], error: str
) -> None:
    row = run_one(SMALL.problem, entrant(named(planner)), LIMITS)
    assert row.outcome == RunFailure.CRASHED, "it is no refusal"
    first = planner.__code__.co_firstlineno
    assert row.message.startswith(error)
    line = re.search(r"\(test_own_planner\.py, line (\d+)\)$", row.message)
    assert line is not None
    assert first < int(line[1]) <= first + 3


def test_one_that_ends_its_process_is_told_without_a_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", LOST, "--planner", named(leaves)]) == Exit.INVALID
    said = capsys.readouterr()
    assert f"{named(leaves)} crashed: exit code 2\n" in said.out
    assert "--traceback" not in said.err


@pytest.mark.parametrize("name", ["./own.py:plan", ".own:plan", "..:plan", "a b:plan", "own.:plan", ":plan", "own:"])
def test_a_name_that_is_no_module_and_function_is_refused(name: str) -> None:
    problem = cfgplan.match(cfgplan.load(LOST))
    with pytest.raises(InputError, match=f"planner '{re.escape(name)}' can't be used: "):
        cfgplan.plan(problem, planner=name)


@pytest.mark.parametrize(
    ("name", "mend"),
    [
        ("greedy.py:plan", "write greedy:plan: a module has no ending"),
        ("planners/greedy.py:best", "write greedy:best, in the folder planners: a module has no ending"),
    ],
)
def test_a_file_in_place_of_a_module_is_told_how_it_is_named(name: str, mend: str) -> None:
    problem = cfgplan.match(cfgplan.load(LOST))
    with pytest.raises(InputError) as caught:
        cfgplan.plan(problem, planner=name)
    assert caught.value.faults[0].mend == mend


def test_what_the_judge_refuses_is_in_no_proof_no_time_and_no_plot(tmp_path: Path) -> None:
    row = row_of(SMALL, entrant(named(boasts)), LIMITS)
    assert row.violations
    assert (row.proven, row.has_plan, row.bound_us, row.trace) == (False, False, 0, ())
    assert {row.first_s, row.best_s, row.proof_s, row.total_s} == {None}
    assert write_plots([row], tmp_path) == []
