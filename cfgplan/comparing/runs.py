"""Run each planner on each problem in a process of its own, and find contradictions between their answers."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

from cfgplan.comparing.entrants import Entrant
from cfgplan.domain import Similarity
from cfgplan.errors import InvalidValueError
from cfgplan.planning import REFUSED, Problem, Status


class RunFailure(StrEnum):
    """The outcome of a run without an answer; the other outcomes are those of `planning.Status`."""

    REFUSED = "refused"
    """The planner said that it can't take this problem."""
    UNAVAILABLE = "unavailable"
    """A package that the planner needs is not installed."""
    KILLED = "killed at the time limit"
    OUT_OF_MEMORY = "out of memory"
    CRASHED = "crashed"


PROVEN = frozenset({Status.OPTIMAL, *REFUSED})

Point = tuple[float, int | None, int]
"""Seconds since the start, best cost so far, proven bound."""
MOST_POINTS = 40
MOST_SAID = 4000
"""Number of characters kept of the output of a crashed process."""
CALLED = "called"
"""The first line that the process of a run writes: the planner's time begins."""
START_S = 120.0
"""Seconds that the process of a run has for its imports; they do not count as the planner's time."""
_WATCH_S = 0.2
"""Seconds between two looks at a process."""
CHILD = (sys.executable, "-m", "cfgplan.comparing.child")
"""The command that starts the process of a run."""


@dataclass(frozen=True)
class Run:
    """One run of one planner on one problem; times are in seconds since the planner was called.

    `outcome` is a `Status` or a `RunFailure`. `violations` are the judge's; None if there was no answer to judge.
    `peak_mb` is the largest resident memory of the process, or of the solver if that is a process of its own. `trace`
    lists the best cost and the bound over time. `proof_s` is when the planner had proven its answer (that no plan
    exists, or none is cheaper); None if it has not. Breaking ties between equal costs may last until `total_s`.
    `seconds` are the planner's phases. An answer that the judge refuses keeps its claimed cost, but has no bound, times
    or trace. `traceback` is that of a crash.
    """

    planner: str
    outcome: str
    cost_us: int | None
    bound_us: int
    unused_required: int
    first_s: float | None
    best_s: float | None
    proof_s: float | None
    total_s: float | None
    trace: tuple[Point, ...]
    counts: Mapping[str, int]
    peak_mb: float | None
    violations: tuple[str, ...] | None
    message: str
    seconds: Mapping[str, float] = field(default_factory=dict)
    traceback: str = ""

    @property
    def proven(self) -> bool:
        return self.proof_s is not None

    @property
    def has_plan(self) -> bool:
        """Return whether the run has a plan and the judge did not refuse it."""
        return self.outcome in (Status.OPTIMAL, Status.FEASIBLE) and not self.violations


@dataclass(frozen=True)
class Limits:
    """The limits of a run.

    The planner gets `time_limit_s` seconds, from its call on; `grace_s` seconds later (time for the last step and the
    judge) its process is killed. `memory_mb` limits the address space. Raises InvalidValueError if not positive.
    """

    time_limit_s: float = 10.0
    grace_s: float = 10.0
    memory_mb: int | None = None

    def __post_init__(self) -> None:
        if self.time_limit_s <= 0 or self.grace_s < 0 or (self.memory_mb is not None and self.memory_mb <= 0):
            raise InvalidValueError("the limits of a comparison must be positive")


def run_one(problem: Problem, entrant: Entrant, limits: Limits) -> Run:
    """Run one planner on one problem in a new process, and say how it ended, however it ends."""
    trace, answer = _answer(entrant, limits, pickled(problem))
    if trace and answer["outcome"] in (RunFailure.KILLED, RunFailure.OUT_OF_MEMORY):
        answer |= {"cost_us": trace[-1][1], "bound_us": trace[-1][2]}
    first_s, best_s = _times(trace, answer)
    run = Run(
        planner=entrant.name,
        outcome=answer["outcome"],
        cost_us=answer.get("cost_us"),
        bound_us=answer.get("bound_us", 0),
        unused_required=answer.get("unused_required", 0),
        first_s=first_s,
        best_s=best_s,
        proof_s=_proof_s(trace, answer),
        total_s=answer.get("total_s"),
        trace=thinned(trace),
        counts=answer.get("counts", {}),
        peak_mb=answer.get("peak_mb"),
        violations=tuple(answer["violations"]) if "violations" in answer else None,
        message=answer.get("message", ""),
        seconds=answer.get("seconds", {}),
        traceback=answer.get("traceback", ""),
    )
    if not run.violations:
        return run
    return replace(run, bound_us=0, first_s=None, best_s=None, proof_s=None, total_s=None, trace=())


def contradictions(runs: Sequence[Run]) -> Iterator[str]:
    """Yield each contradiction between runs on one problem: plans that the judge refuses, and answers that disagree."""
    for run in runs:
        yield from (f"{run.planner}: {text}" for text in run.violations or ())
    plans = best_used(runs)
    cheapest = min(plans, key=lambda plan: plan.cost_us or 0, default=None)
    for run in runs:
        if run.has_plan and run.violations is None:
            yield f"{run.planner}: the plan was not judged"
        if cheapest is not None and cheapest.cost_us is not None:
            least = f"{cheapest.planner} has a plan of {cheapest.cost_us} us"
            if run in plans and run.proven and (run.cost_us or 0) > cheapest.cost_us:
                yield f"{run.planner}: claims that no plan costs less than {run.cost_us} us, but {least}"
            if run.bound_us > cheapest.cost_us and not run.unused_required:
                yield f"{run.planner}: claims that no plan costs less than {run.bound_us} us, but {least}"
        if run.outcome in REFUSED:
            for other in runs:
                if other.has_plan or (other.proven and other.outcome != run.outcome):
                    yield f"{run.planner}: says {run.outcome}, but {other.planner} says {other.outcome}"


AnyRun = TypeVar("AnyRun", bound=Run)


def best_used(runs: Iterable[AnyRun]) -> list[AnyRun]:
    """The judged plans that leave the fewest required transformations unused: only their costs compare."""
    plans = [run for run in runs if run.has_plan and run.violations == ()]
    fewest = min((run.unused_required for run in plans), default=0)
    return [run for run in plans if run.unused_required == fewest]


def pickled(problem: Problem) -> str:
    """Return a problem pickled for another process, in base 64, without open pairs of tags."""
    decided = Similarity(dict(problem.similarity.offers))
    return b64encode(pickle.dumps(replace(problem, similarity=decided))).decode()


def thinned(trace: Sequence[Point]) -> tuple[Point, ...]:
    """At most about `MOST_POINTS` points of a trace, evenly chosen, the first and the last among them."""
    if len(trace) <= MOST_POINTS:
        return tuple(trace)
    step = (len(trace) - 1) / (MOST_POINTS - 1)
    return tuple(trace[round(i * step)] for i in range(MOST_POINTS))


def _answer(entrant: Entrant, limits: Limits, problem: str) -> tuple[list[Point], dict[str, Any]]:
    """Return the progress and the answer of a child process, or how it failed."""
    task = {
        "problem": problem,
        "entrant": asdict(entrant),
        "time_limit_s": limits.time_limit_s,
        "memory_mb": limits.memory_mb,
    }
    out, err, code = _run_process(task, limits.time_limit_s + limits.grace_s)
    trace, answer = _parsed(out)
    return trace, answer or _failure(code, out, err)


def _run_process(task: Mapping[str, Any], limit_s: float) -> tuple[str, str, int | None]:
    """Return the output, the errors and the exit code of a child.

    The code is None if the child was killed: `START_S` seconds after its start, or `limit_s` after the planner's call.
    """
    process = _started()
    given: str | None = json.dumps(task)
    was_called, end_s = False, time.monotonic() + START_S
    try:
        while True:
            try:
                out, err = process.communicate(given, timeout=_WATCH_S)
                return out, err, process.returncode
            except subprocess.TimeoutExpired as error:
                given = None
                if error.output and not was_called:
                    was_called, end_s = True, time.monotonic() + limit_s
            if time.monotonic() >= end_s:
                _kill(process)
                return *process.communicate(), None
    except BaseException:
        _kill(process)
        process.wait()
        raise


def _kill(process: subprocess.Popen[str]) -> None:
    with suppress(ProcessLookupError):  # it may just have ended
        os.killpg(process.pid, signal.SIGKILL)


def _started() -> subprocess.Popen[str]:
    """Start the process of a run."""
    path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    return subprocess.Popen(
        CHILD,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
        env={**os.environ, "PYTHONPATH": path},
        start_new_session=True,
    )


def _parsed(out: str) -> tuple[list[Point], dict[str, Any] | None]:
    """The progress, that of the run that is answered for, and the answer, if one came.

    A line that was cut short is passed over.
    """
    trace: list[Point] = []
    for line in out.splitlines():
        try:
            data = json.loads(line)
        except ValueError:
            continue
        if isinstance(data, dict):
            told = data.get("trace", trace)
            return [(round(when, 6), cost, bound) for when, cost, bound in told], data
        trace.append((round(data[0], 6), data[1], data[2]))
    return trace, None


def _failure(code: int | None, out: str, err: str) -> dict[str, Any]:
    if code is None and not out:
        return {"outcome": RunFailure.CRASHED, "message": f"its modules were not imported within {START_S:g} s"}
    if code is None:
        return {"outcome": RunFailure.KILLED}
    if "MemoryError" in err or "bad_alloc" in err:
        return {"outcome": RunFailure.OUT_OF_MEMORY}
    ending = err.strip().splitlines()[-1:] or [""]
    how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    message = f"{how}: {ending[0]}" if ending[0] else how
    return {"outcome": RunFailure.CRASHED, "message": message[:300], "traceback": err[-MOST_SAID:]}


def _times(trace: Sequence[Point], answer: dict[str, Any]) -> tuple[float | None, float | None]:
    """When the first and when the best plan was known; a plan that was never reported came at the end."""
    costs = [(when, cost) for when, cost, _ in trace if cost is not None]
    end = answer.get("total_s")
    if answer["outcome"] not in (Status.OPTIMAL, Status.FEASIBLE):
        return (costs[0][0], costs[-1][0]) if costs and answer.get("cost_us") is not None else (None, None)
    first_s = costs[0][0] if costs else end
    best_s = next((when for when, cost in costs if cost == answer["cost_us"]), end)
    return first_s, best_s


def _proof_s(trace: Sequence[Point], answer: dict[str, Any]) -> float | None:
    """Return when the answer was proven: for a plan, when the bound reached its cost, even if ties were
    broken later.
    """
    if answer["outcome"] == Status.OPTIMAL:
        at_cost = (when for when, cost, bound in trace if cost == bound == answer["cost_us"])
        return next(at_cost, float(answer["total_s"]))
    return float(answer["total_s"]) if answer["outcome"] in PROVEN else None
