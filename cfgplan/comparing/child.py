"""The process of one run: reads a task from stdin, and writes progress and the answer to stdout as JSON lines.

The line `CALLED` comes first, when everything is imported.

Before each run the problem is unpickled again and existing objects are excluded from garbage collection. A run shorter
than `SHORT_S` is repeated and the median run is reported, since other load and cold caches may double its time.
Output that the planner prints itself goes to stderr. If the process is killed, it writes no answer; the parent records
the run as killed.
"""

from __future__ import annotations

import gc
import json
import os
import pickle
import resource
import sys
from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from sysconfig import get_path
from time import perf_counter
from traceback import extract_tb, format_exc
from typing import Any, TextIO

from cfgplan.comparing.entrants import Entrant
from cfgplan.comparing.runs import CALLED, Point, RunFailure
from cfgplan.errors import InputError
from cfgplan.planning import Plan, Planner, Problem, Progress
from cfgplan.unmet import shared_reasons
from cfgplan.validity import plan_violations

_NOT_OWN = (Path(__file__).parents[1], *(Path(get_path(kind)) for kind in ("stdlib", "purelib", "platlib")))
"""The folders of cfgplan, of Python and of installed packages."""
SHORT_S, RUNS = 0.5, 3
"""A run shorter than SHORT_S seconds is repeated, RUNS times in all."""


def main() -> None:
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    task = json.load(sys.stdin)
    if task["memory_mb"] is not None:
        limit = task["memory_mb"] * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    try:
        entrant = Entrant(**task["entrant"])
        answer = _run(entrant, b64decode(task["problem"]), task["time_limit_s"], out)
    except ImportError as error:
        answer = {"outcome": RunFailure.UNAVAILABLE, "message": str(error)}
    except MemoryError:
        answer = {"outcome": RunFailure.OUT_OF_MEMORY}
    except InputError as error:
        answer = {"outcome": RunFailure.REFUSED, "message": str(error)}
    except Exception as error:
        answer = {"outcome": RunFailure.CRASHED, "message": crash_text(error), "traceback": format_exc()}
    print(json.dumps(answer, ensure_ascii=False), file=out, flush=True)


def crash_text(error: Exception) -> str:
    """Return an exception's type, message and place in at most 300 characters.

    The place is the last line outside of cfgplan, Python and installed packages, if there is one: that of a planner of
    the user's own. A call that the planner refuses has no place.
    """
    places = extract_tb(error.__traceback__)
    place = next((place for place in reversed(places) if _is_own(place.filename)), places[-1])
    where = "" if place.filename == __file__ else f" ({Path(place.filename).name}, line {place.lineno})"
    return f"{type(error).__name__}: {error}{where}"[:300]


def _is_own(file: str) -> bool:
    """Return whether a file is the user's; names such as `<string>` are those of code that is in no file."""
    return not file.startswith("<") and not any(Path(file).is_relative_to(each) for each in _NOT_OWN)


def _run(entrant: Entrant, problem: bytes, time_limit_s: float, out: TextIO) -> dict[str, Any]:
    planner = entrant.planner()
    gc.collect()
    gc.freeze()

    def tell(point: Point) -> None:
        print(json.dumps(point), file=out, flush=True)

    print(CALLED, file=out, flush=True)
    runs = [_timed(planner, problem, time_limit_s, tell)]
    peak_mb = _peak_mb()
    while runs[0].total_s < SHORT_S and len(runs) < RUNS:
        runs.append(_timed(planner, problem, time_limit_s, lambda _: None))
    run = sorted(runs, key=lambda run: run.total_s)[len(runs) // 2]
    plan = run.plan
    if not isinstance(plan, Plan):
        return {"outcome": RunFailure.CRASHED, "message": f"it returned {plan!r:.60}, not a cfgplan.Plan"}
    return {
        "outcome": plan.status,
        "cost_us": plan.cost_us,
        "bound_us": plan.bound_us,
        "unused_required": len(plan.unused_required),
        "total_s": round(run.total_s, 6),
        "trace": run.trace,
        "peak_mb": round(peak_mb, 1),
        "counts": dict(plan.counts),
        "seconds": {phase: round(seconds, 6) for phase, seconds in plan.seconds.items()},
        "violations": [str(violation) for violation in plan_violations(pickle.loads(problem), plan)],
        "message": "; ".join(shared.text for shared in shared_reasons(plan.reasons))[:300],
    }


@dataclass(frozen=True)
class _Run:
    plan: Plan
    total_s: float
    trace: list[Point]


def _timed(planner: Planner, pickled: bytes, time_limit_s: float, tell: Callable[[Point], None]) -> _Run:
    """Run a planner on a freshly unpickled problem, and call `tell` with each step of its progress."""
    problem: Problem = pickle.loads(pickled)
    trace: list[Point] = []
    began = perf_counter()

    def report(progress: Progress) -> None:
        if not isinstance(progress, Progress):
            raise TypeError(f"it reported {progress!r:.60}, not a cfgplan.Progress")
        trace.append((perf_counter() - began, progress.cost_us, progress.bound_us))
        tell(trace[-1])

    plan = planner(problem, time_limit_s=time_limit_s, report=report)
    return _Run(plan, perf_counter() - began, trace)


def _peak_mb() -> float:
    """The largest resident memory so far of this process, or of one that it waited for.

    `ru_maxrss` of a new process starts from that of its parent on Linux; the kernel's own figure does not.
    """
    started = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    status = Path("/proc/self/status")
    if not status.exists():
        scale = 2**20 if sys.platform == "darwin" else 1024
        return max(started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale)
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return max(started, int(line.split()[1]) / 1024)


if __name__ == "__main__":
    main()
