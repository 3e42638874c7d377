"""Every run becomes a row, however it ends; planners here are functions of this module, run in child processes."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from base64 import b64decode
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import pytest

from cfgplan.comparing import Entrant, Limits, RunFailure, entrant, runs
from cfgplan.comparing.runs import pickled
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem, Progress, Status
from experiments.study.instances import Instance, generated, given, named
from experiments.study.rows import read_rows
from experiments.study.runner import Advance, run, run_one
from experiments.study.suites import SUITES

SMALL = generated("adversarial", kind="dedicated", size=3)
LIMITS = Limits(time_limit_s=20)
Report = Callable[[Progress], None] | None
TURNS_S = (0.35, 0.0, 0.15)


def hangs(_: Problem, *, report: Report = None, **__: object) -> Plan:
    assert report is not None
    report(Progress(0.0, 9, 4))
    time.sleep(60)
    return Plan("hangs", Status.UNKNOWN)


def kills_itself(_: Problem, **__: object) -> Plan:
    os.kill(os.getpid(), signal.SIGSEGV)
    return Plan("kills itself", Status.UNKNOWN)


def raises(_: Problem, **__: object) -> Plan:
    raise ZeroDivisionError("a bug")


def eats_memory(_: Problem, **__: object) -> Plan:
    return Plan(str(bytearray(2**33)), Status.UNKNOWN)


def takes_turns(_: Problem, *, report: Report = None, turns: tuple[float, ...] = TURNS_S, **__: object) -> Plan:
    """Takes as long as it is its turn, and says whose turn it was."""
    assert report is not None
    turn = int(os.environ.get("TURN", "0"))
    os.environ["TURN"] = str(turn + 1)
    time.sleep(turns[turn])
    report(Progress(0.0, None, turn))
    return Plan("takes turns", Status.UNKNOWN, bound_us=turn)


def is_slow(problem: Problem, *, report: Report = None, **_: object) -> Plan:
    return takes_turns(problem, report=report, turns=(0.6,))


def lies(problem: Problem, **_: object) -> Plan:
    sys.stdout.write("a planner may write what it likes\n")
    return replace(PLANNERS["cpsat"](problem), cost_us=1, bound_us=1)


def own(name: str) -> Entrant:
    return entrant(f"{__name__}:{name}")


def test_a_row_tells_what_the_planner_answered_and_when() -> None:
    row = run_one(SMALL, entrant("cpsat"), LIMITS)
    assert (row.outcome, row.cost_us, row.bound_us, row.proven) == (Status.OPTIMAL, 11_000_000, 11_000_000, True)
    assert row.violations == ()
    assert row.first_s is not None
    assert row.best_s is not None
    assert row.proof_s is not None
    assert 0 <= row.first_s <= row.best_s <= row.proof_s
    assert row.peak_mb is not None
    assert row.peak_mb > 10
    assert row.trace[-1][1:] == (11_000_000, 11_000_000)
    assert {"cfgplan", "ortools", "python"} <= row.versions.keys()
    assert {"closure", "bounds"} <= row.seconds.keys()
    assert sum(row.seconds.values()) <= (row.total_s or 0.0)
    assert (row.family, dict(row.parameters), row.seed) == ("adversarial", {"kind": "dedicated", "size": 3}, 0)


AT_ITS_FIRST_CALL = """
import pickle, sys
from cfgplan.comparing import entrant
problem, planner = pickle.load(sys.stdin.buffer), entrant("cpsat").planner()
loaded = set(sys.modules)
planner(problem)
print(sorted(name for name in sys.modules if name not in loaded))
"""


@pytest.mark.parametrize("instance", [SMALL, generated("fleet", transformations=30), generated("deployment", hosts=3)])
def test_what_the_planner_loads_is_loaded_before_its_clock_starts(instance: Instance) -> None:
    task = pickle.dumps(instance.problem)
    child = subprocess.run([sys.executable, "-c", AT_ITS_FIRST_CALL], input=task, stdout=subprocess.PIPE, check=True)
    assert child.stdout.decode().strip() == "[]"


def test_a_planner_without_a_proof_has_no_time_of_proof() -> None:
    row = run_one(SMALL, entrant("branch-and-bound"), LIMITS)
    assert (row.outcome, row.cost_us, row.proven, row.proof_s) == (Status.FEASIBLE, 30_000_000, False, None)


def test_a_planner_that_hangs_is_killed_and_what_it_had_found_is_kept() -> None:
    row = run_one(SMALL, own("hangs"), Limits(time_limit_s=0.5, grace_s=4))
    assert (row.outcome, row.cost_us, row.bound_us) == (RunFailure.KILLED, 9, 4)
    assert row.violations is None


IMPORTED_SLOWLY = """
import time

from cfgplan.planning import Plan, Status

time.sleep(3)


def plan(problem, **_):
    return Plan("imported slowly", Status.UNKNOWN)
"""


@pytest.mark.parametrize(("start_s", "outcome"), [(60.0, Status.UNKNOWN), (0.5, RunFailure.CRASHED)])
def test_the_time_of_imports_is_no_time_of_the_planner(
    start_s: float, outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "imported_slowly.py").write_text(IMPORTED_SLOWLY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(runs, "START_S", start_s)
    # A planner that is called has the time limit; these imports take longer than it.
    row = run_one(SMALL, entrant("imported_slowly:plan"), Limits(time_limit_s=0.5, grace_s=2))
    assert row.outcome == outcome
    assert ("its modules were not imported within 0.5 s" in row.message) == (outcome == RunFailure.CRASHED)


def test_a_short_run_is_repeated_and_the_median_one_is_told() -> None:
    row = run_one(SMALL, own("takes_turns"), LIMITS)
    assert row.bound_us == 2, "neither the first, of a cold start, nor the luckiest"
    assert [bound for _, _, bound in row.trace] == [2]
    assert row.total_s is not None
    assert row.total_s >= 0.15


def test_a_longer_run_is_made_once() -> None:
    row = run_one(SMALL, own("is_slow"), LIMITS)
    assert row.total_s is not None
    assert row.total_s >= 0.6


def test_a_crash_is_a_row() -> None:
    row = run_one(SMALL, own("kills_itself"), LIMITS)
    assert row.outcome == RunFailure.CRASHED
    assert "SIGSEGV" in row.message
    row = run_one(SMALL, own("raises"), LIMITS)
    assert row.outcome == RunFailure.CRASHED
    assert "ZeroDivisionError: a bug" in row.message


def test_too_much_memory_is_a_row() -> None:
    row = run_one(SMALL, own("eats_memory"), Limits(time_limit_s=20, memory_mb=2000))
    assert row.outcome == RunFailure.OUT_OF_MEMORY


def test_a_missing_package_and_a_refusal_are_rows() -> None:
    row = run_one(SMALL, entrant("no_such_module:plan"), LIMITS)
    assert (row.outcome, row.message) == (RunFailure.UNAVAILABLE, "No module named 'no_such_module'")
    row = run_one(generated("random_library"), entrant("exhaustive"), LIMITS)
    assert row.outcome == RunFailure.REFUSED
    assert "too many" in row.message


def test_the_judge_convicts_a_planner_that_lies() -> None:
    row = run_one(SMALL, own("lies"), LIMITS)
    assert row.violations is not None
    assert any("the update costs 11000000 us, but the plan says 1 us" in text for text in row.violations)


def test_a_row_that_is_there_is_not_run_again(tmp_path: Path) -> None:
    results, seen = tmp_path / "new" / "results.jsonl", list[Advance]()
    planners = [entrant("cpsat"), entrant("branch-and-bound")]
    first = run([SMALL], planners, LIMITS, results, watch=seen.append)
    assert [(s.done, s.total) for s in seen] == [(0, 2), (1, 2), (2, 2)]
    assert seen[0].ahead == f"cpsat on {SMALL.name}"
    assert seen[1].ahead == f"branch-and-bound on {SMALL.name}"
    seen.clear()
    assert run([SMALL], planners, LIMITS, results, watch=seen.append) == first == read_rows(results)
    assert [(s.done, s.total) for s in seen] == [(2, 2)]


def test_an_entrant_runs_only_where_it_takes_part(tmp_path: Path) -> None:
    planners = [entrant("cpsat"), entrant("branch-and-bound")]
    rows = run([SMALL], planners, LIMITS, tmp_path / "r.jsonl", takes_part=lambda _, who: who.name == "cpsat")
    assert [row.planner for row in rows] == ["cpsat"]


def test_an_interrupted_file_goes_on_where_it_was(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    planners = [entrant("cpsat"), entrant("branch-and-bound")]
    whole = run([SMALL], planners, LIMITS, results)
    text = results.read_text()
    results.write_text(text[: text.index("\n") + 100])
    assert read_rows(results) == whole[:1]
    again = run([SMALL], planners, LIMITS, results)
    assert [row.key for row in again] == [row.key for row in whole]
    assert read_rows(results) == again


def test_a_changed_problem_is_run_again(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    longer = replace(SMALL.problem, horizon_s=SMALL.problem.horizon_s + 1)
    for problem in (SMALL.problem, longer):
        run([given("mine", problem)], [entrant("branch-and-bound")], LIMITS, results)
    assert len(read_rows(results)) == 2


def test_a_run_that_lacked_a_package_is_tried_again(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    for _ in range(2):
        run([SMALL], [entrant("no_such_module:plan")], LIMITS, results)
    assert len(results.read_text().splitlines()) == 2
    assert len(read_rows(results)) == 1


def test_a_row_from_before_phases_were_kept_is_read(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    (row,) = run([SMALL], [entrant("branch-and-bound")], LIMITS, results)
    older = json.loads(results.read_text())
    del older["seconds"]
    results.write_text(json.dumps(older) + "\n")
    assert read_rows(results) == [replace(row, seconds={})]


def test_a_line_that_is_no_row_is_named(tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    for line in ("nonsense", json.dumps({"instance": "x"})):
        results.write_text(f"\n{line}\n")
        with pytest.raises(InputError) as caught:
            read_rows(results)
        assert caught.value.faults[0].line == 2


def test_a_file_that_holds_no_results_is_named_and_stays(tmp_path: Path) -> None:
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"\x89PNG\n")
    for results, says in ((picture, "this is no results file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=says):
            run([SMALL], [entrant("cpsat")], LIMITS, results)
    assert picture.read_bytes() == b"\x89PNG\n"


@pytest.mark.parametrize("family", ["random_library", "replanning"])
def test_a_problem_survives_the_way_to_another_process(family: str) -> None:
    instance = generated(family, 2)
    assert not instance.problem.features
    back = pickle.loads(b64decode(pickled(instance.problem)))
    assert back == instance.problem
    assert vars(back).keys() == {each.name for each in fields(back)}, "what was derived from it is not sent"


@pytest.mark.parametrize("suite", SUITES)
def test_the_name_of_an_instance_makes_it_again(suite: str) -> None:
    for instance in SUITES[suite]():
        assert named(instance.name) == instance
    assert named("random_library") == generated("random_library")


@pytest.mark.parametrize("name", ["", "random_library(", "random_library(depth)", "nao(robots=2)#x", "dynasty(size=2)"])
def test_a_name_of_no_instance_is_refused(name: str) -> None:
    with pytest.raises(InputError):
        named(name)


def test_unknown_names_and_limits_are_refused() -> None:
    with pytest.raises(InputError, match="no planner"):
        entrant("astrology")
    with pytest.raises(InputError, match="no family"):
        generated("dynasty")
    with pytest.raises(InputError, match="can't be made"):
        _ = generated("nao", wheels=4).problem
    with pytest.raises(InputError, match="it takes robots, event, fusion, sharing, cameras, horizon_s"):
        _ = generated("nao", robots="two").problem
    with pytest.raises(InvalidValueError):
        Limits(time_limit_s=0)
