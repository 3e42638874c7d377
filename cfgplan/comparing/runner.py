"""The runner: each planner on each instance in a process of its own, every run a row."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.comparing.entrants import Entrant
from cfgplan.comparing.instances import Instance
from cfgplan.comparing.rows import PROVEN, Point, Row, RunFailure, RunKey, append_row, read_rows, thinned
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.planning import Status

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Limits:
    """What a run may take.

    The planner is told `time_limit_s`; `grace_s` after that (for the start of the process, the last step
    and the judge) it is killed. `memory_mb` limits the process's address space.
    """

    time_limit_s: float = 10.0
    grace_s: float = 10.0
    memory_mb: int | None = None

    def __post_init__(self) -> None:
        if self.time_limit_s <= 0 or self.grace_s < 0 or (self.memory_mb is not None and self.memory_mb <= 0):
            raise InvalidValueError("the limits of a comparison must be positive")


@dataclass(frozen=True)
class Advance:
    """How far a comparison is: runs done (also before) out of all, and the planner and instance that come next."""

    done: int
    total: int
    ahead: str


def everyone(_instance: Instance, _entrant: Entrant) -> bool:
    """All entrants take part in all instances."""
    return True


def run(
    instances: Iterable[Instance],
    entrants: Sequence[Entrant],
    limits: Limits,
    results: Path,
    *,
    takes_part: Callable[[Instance, Entrant], bool] = everyone,
    watch: Callable[[Advance], None] | None = None,
) -> list[Row]:
    """Run every entrant on every instance that it takes part in and append a row for each to the file `results`.

    A run whose row is there already is not repeated, unless a package was missing then. Returns the
    rows of exactly these runs. `watch` is told of each run before it starts, and of the end.
    """
    known = {row.key: row for row in read_rows(results) if row.outcome != RunFailure.UNAVAILABLE}
    tasks = [(instance, entrant) for instance in instances for entrant in entrants if takes_part(instance, entrant)]
    left = [(i, e) for i, e in tasks if _key(i, e, limits) not in known]
    for number, (instance, entrant) in enumerate(left):
        if watch is not None:
            watch(Advance(len(tasks) - len(left) + number, len(tasks), f"{entrant.name} on {instance.name}"))
        row = run_one(instance, entrant, limits)
        append_row(results, row)
        known[row.key] = row
    if watch is not None:
        watch(Advance(len(tasks), len(tasks), ""))
    return [known[_key(instance, entrant, limits)] for instance, entrant in tasks]


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[Advance], None]]:
    """A function to `watch` a run with; the bar is shown on a terminal only."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("about"),
        TimeRemainingColumn(),
        TextColumn("left"),
        TextColumn("{task.description}", style="dim"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, speed_estimate_period=1e6) as bar:
        task = bar.add_task("", total=None)
        yield lambda s: bar.update(task, total=s.total, completed=s.done, description=s.ahead, refresh=True)


def run_one(instance: Instance, entrant: Entrant, limits: Limits) -> Row:
    """Run one planner on one instance in a new process and make a row of however it ends."""
    task = {
        "problem": instance.pickled,
        "entrant": asdict(entrant),
        "time_limit_s": limits.time_limit_s,
        "memory_mb": limits.memory_mb,
    }
    out, err, code = _run_process(json.dumps(task), limits.time_limit_s + limits.grace_s)
    trace, answer = _parsed(out)
    if answer is None:
        answer = _failure(code, err)
        if trace and answer["outcome"] != RunFailure.CRASHED:
            answer |= {"cost_us": trace[-1][1], "bound_us": trace[-1][2]}
    first_s, best_s = _times(trace, answer)
    environment = instance.problem.environment
    return Row(
        instance=instance.name,
        family=instance.family,
        parameters=dict(instance.parameters),
        seed=instance.seed,
        digest=instance.digest,
        transformations=len(environment.library),
        planner=entrant.name,
        time_limit_s=limits.time_limit_s,
        memory_mb=limits.memory_mb,
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
        versions=entrant.versions() | {"python": platform.python_version()},
        machine=machine(),
        seconds=answer.get("seconds", {}),
    )


def require(entrant: Entrant, limits: Limits) -> None:
    """Find out, in a process like that of a run, whether there is such a planner. Raises InputError."""
    task = {"problem": None, "entrant": asdict(entrant), "memory_mb": limits.memory_mb}
    out, err, code = _run_process(json.dumps(task), limits.time_limit_s + limits.grace_s)
    _, answer = _parsed(out)
    answer = answer or _failure(code, err)
    if answer["outcome"] != "ready":
        why = answer.get("message") or answer["outcome"]
        raise InputError.of(f"the planner {entrant.name!r} can't be used: {why}", mend="name it as module:function")


@cache
def machine() -> dict[str, object]:
    """What the runs ran on; times compare only within one machine."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count() or 1,
        "memory_gb": round(memory / 2**30, 1),
    }


def _key(instance: Instance, entrant: Entrant, limits: Limits) -> RunKey:
    return (instance.name, instance.digest, entrant.name, limits.time_limit_s, limits.memory_mb)


def _run_process(task: str, limit_s: float) -> tuple[str, str, int | None]:
    """The output, the errors and the exit code of a child; no code if it had to be killed."""
    path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    process = subprocess.Popen(
        [sys.executable, "-m", "cfgplan.comparing.child"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
        env={**os.environ, "PYTHONPATH": path},
        start_new_session=True,
    )
    try:
        out, err = process.communicate(task, timeout=limit_s)
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        return out, err, None
    except BaseException:
        with suppress(ProcessLookupError):  # Ctrl-C may come when it has just ended
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    return out, err, process.returncode


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


def _failure(code: int | None, err: str) -> dict[str, Any]:
    if code is None:
        return {"outcome": RunFailure.KILLED}
    if "MemoryError" in err or "bad_alloc" in err:
        return {"outcome": RunFailure.OUT_OF_MEMORY}
    ending = err.strip().splitlines()[-1:] or [""]
    how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    return {"outcome": RunFailure.CRASHED, "message": f"{how}: {ending[0]}"[:300]}


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
    """When the answer was proven: for a plan, when the bound had reached its cost, whatever became of ties later."""
    if answer["outcome"] == Status.OPTIMAL:
        at_cost = (when for when, cost, bound in trace if cost == bound == answer["cost_us"])
        return next(at_cost, float(answer["total_s"]))
    return float(answer["total_s"]) if answer["outcome"] in PROVEN else None
