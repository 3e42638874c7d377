"""Results: one row for each run, kept as JSON lines in a plain file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

from cfgplan.errors import Fault, InputError
from cfgplan.planning import REFUSED, Status


class RunFailure(StrEnum):
    """How a run ended that gave no answer; the other outcomes are those of `planning.Status`."""

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

RunKey = tuple[str, str, str, float, int | None]


@dataclass(frozen=True)
class Row:
    """One run of one planner on one instance; times are in seconds since the planner was called.

    `outcome` is a `Status` or a `RunFailure`. `violations` is what the judge found, None where there
    was no answer to judge. `peak_mb` is the largest resident memory of the process, the solver's own if it is
    a process apart. `trace` tells the best cost and the bound over time. `proof_s` is when the planner had proven
    its answer, that there is no plan or that none costs less; None if it has not. To break ties between equal costs
    may take until `total_s`. `seconds` are the planner's phases; older files lack them.
    """

    instance: str
    family: str
    parameters: Mapping[str, object]
    seed: int | None
    digest: str
    transformations: int
    planner: str
    time_limit_s: float
    memory_mb: int | None
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
    versions: Mapping[str, str]
    machine: Mapping[str, object]
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> RunKey:
        """What must be equal for a run to be the same one."""
        return (self.instance, self.digest, self.planner, self.time_limit_s, self.memory_mb)

    @property
    def proven(self) -> bool:
        return self.proof_s is not None

    @property
    def has_plan(self) -> bool:
        return self.outcome in (Status.OPTIMAL, Status.FEASIBLE)


def read_rows(path: Path) -> list[Row]:
    """The rows of a file, of equal runs the last; none if there is no file.

    A last line that an interruption cut short is passed over. Raises InputError for any other that is no row, and
    for a file that can't be read.
    """
    if not path.exists():
        return []
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except UnicodeDecodeError:
        raise InputError.of("this is no results file", file=str(path), mend="use another results file") from None
    except OSError as error:
        raise InputError.of(f"can't be read: {error.strerror}", file=str(path), mend="use another file") from None
    rows = {row.key: row for number, line in enumerate(lines[:-1], 1) if line for row in [_row(path, number, line)]}
    return list(rows.values())


def append_row(path: Path, row: Row) -> None:
    """Add a row at the end of the file, which is made if need be; a line cut short before it is removed.

    Raises InputError if it can't be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+b") as file:
            file.seek(0)
            whole = file.read().rfind(b"\n") + 1
            file.truncate(whole)
            file.write(json.dumps(asdict(row), ensure_ascii=False).encode() + b"\n")
    except OSError as error:
        mend = "check that the folder may be written to"
        raise InputError.of(f"can't be written: {error.strerror}", file=str(path), mend=mend) from None


def thinned(trace: Iterable[Point], most: int = 40) -> tuple[Point, ...]:
    """At most about `most` points of a trace, evenly chosen, the first and the last among them."""
    points = list(trace)
    if len(points) <= most:
        return tuple(points)
    step = (len(points) - 1) / (most - 1)
    return tuple(points[round(i * step)] for i in range(most))


_FIELDS = frozenset(each.name for each in fields(Row))
_REQUIRED = frozenset(each.name for each in fields(Row) if each.default_factory is MISSING)


def _row(path: Path, number: int, line: str) -> Row:
    try:
        data: dict[str, Any] = json.loads(line)
    except ValueError:
        raise InputError([Fault("this line is no JSON", str(path), number, mend="use another results file")]) from None
    if not isinstance(data, dict) or not _REQUIRED <= data.keys() <= _FIELDS:
        raise InputError([Fault("this line is no result of a run", str(path), number, mend="use another results file")])
    trace = tuple((point[0], point[1], point[2]) for point in data["trace"])
    violations = None if data["violations"] is None else tuple(data["violations"])
    return Row(**{**data, "trace": trace, "violations": violations})
