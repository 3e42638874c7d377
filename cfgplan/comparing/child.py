"""The process of one run: a task comes in on stdin, progress and the answer go out as JSON lines.

A task without a problem only asks whether there is such a planner.

What the planner prints itself goes to stderr. Nothing is written where the process is killed, and the
parent makes a row of that too.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

from cfgplan.comparing.entrants import Entrant
from cfgplan.comparing.families.random_library import random_library
from cfgplan.comparing.rows import Failure
from cfgplan.comparing.transport import restored
from cfgplan.errors import CfgplanError
from cfgplan.planning import Planner, Problem, Progress
from cfgplan.validity import plan_violations

WARM_UP_S = 1.0
"""So long a planner may take over the library that it warms up with."""


def main() -> None:
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    task = json.load(sys.stdin)
    if task["memory_mb"] is not None:
        limit = task["memory_mb"] * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    try:
        entrant = Entrant(**task["entrant"])
        if task["problem"] is None:
            entrant.planner()
            answer: dict[str, Any] = {"outcome": "ready"}
        else:
            answer = _run(entrant, restored(task["problem"]), task["time_limit_s"], out)
    except ImportError as error:
        answer = {"outcome": Failure.UNAVAILABLE, "message": str(error)}
    except MemoryError:
        answer = {"outcome": Failure.OUT_OF_MEMORY}
    except CfgplanError as error:
        answer = {"outcome": Failure.REFUSED, "message": str(error)}
    print(json.dumps(answer, ensure_ascii=False), file=out, flush=True)


def _run(entrant: Entrant, problem: Problem, time_limit_s: float, out: TextIO) -> dict[str, Any]:
    planner = entrant.planner()
    _warm_up(planner)
    began = perf_counter()

    def report(progress: Progress) -> None:
        print(json.dumps([perf_counter() - began, progress.cost_us, progress.bound_us]), file=out, flush=True)

    plan = planner(problem, time_limit_s=time_limit_s, report=report)
    total_s = perf_counter() - began
    peak_mb = _peak_mb()
    return {
        "outcome": plan.status,
        "cost_us": plan.cost_us,
        "bound_us": plan.bound_us,
        "unused_required": len(plan.unused_required),
        "total_s": round(total_s, 6),
        "peak_mb": round(peak_mb, 1),
        "counts": dict(plan.counts),
        "seconds": {phase: round(s, 6) for phase, s in plan.seconds.items()},
        "violations": [str(violation) for violation in plan_violations(problem, plan)],
        "message": "; ".join(sorted(set(plan.reasons.values())))[:300],
    }


def _warm_up(planner: Planner) -> None:
    """Plan a small library, so that what a planner loads and fills at its first call is not counted."""
    with suppress(CfgplanError):
        planner(random_library(0, transformations=50), time_limit_s=WARM_UP_S)


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
