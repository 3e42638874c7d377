"""The runner: each planner on each instance, every run a row of a file; an interrupted study continues where it
stopped.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.comparing import Entrant, Limits, RunFailure
from cfgplan.comparing import run_one as run_problem
from experiments.study.instances import Instance
from experiments.study.rows import Row, RunKey, append_row, read_rows

if TYPE_CHECKING:
    from rich.console import Console


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

    A run that has a row already is not repeated, unless a package was missing then. Returns the rows of exactly these
    runs. `watch` is called before each run, and at the end.
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
    return Row(
        **vars(run_problem(instance.problem, entrant, limits)),
        instance=instance.name,
        family=instance.family,
        parameters=dict(instance.parameters),
        seed=instance.seed,
        digest=instance.digest,
        transformations=len(instance.problem.environment.library),
        time_limit_s=limits.time_limit_s,
        memory_mb=limits.memory_mb,
        versions=versions(entrant),
        machine=machine(),
    )


DISTRIBUTIONS = {
    "clingo": "clingo",
    "experiments.peers.downward": "up-fast-downward",
    "highspy": "highspy",
    "ortools": "ortools",
    "pysat": "python-sat",
    "pyscipopt": "pyscipopt",
}
"""Modules of entrants, and the packages whose versions belong to a result of theirs."""


def versions(entrant: Entrant) -> dict[str, str]:
    """The versions of Python, of this package and of what the entrant is made with."""
    modules = (*entrant.engines, entrant.function)
    made_with = (name for module, name in DISTRIBUTIONS.items() if any(each.startswith(module) for each in modules))
    return {"python": platform.python_version(), **{name: _version(name) for name in ("cfgplan", *made_with)}}


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"


@cache
def machine() -> dict[str, object]:
    """Return a description of the machine; times compare only within one machine."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count() or 1,
        "memory_gb": round(memory / 2**30, 1),
    }


def _key(instance: Instance, entrant: Entrant, limits: Limits) -> RunKey:
    return (instance.name, instance.digest, entrant.name, limits.time_limit_s, limits.memory_mb)
