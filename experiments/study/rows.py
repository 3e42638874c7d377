"""Results: one row for each run, kept as JSON lines in a plain file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from cfgplan.comparing import Run
from cfgplan.errors import Fault, InputError

SHORTEST_PROOF_S = 1e-4
"""Times below are taken for this when ratios are formed."""

RunKey = tuple[str, str, str, float, int | None]


@dataclass(frozen=True, kw_only=True)
class Row(Run):
    """A run with the instance, the limits, the versions and the machine that it was made with."""

    instance: str
    family: str
    parameters: Mapping[str, object]
    seed: int | None
    digest: str
    transformations: int
    time_limit_s: float
    memory_mb: int | None
    versions: Mapping[str, str]
    machine: Mapping[str, object]

    @property
    def key(self) -> RunKey:
        """The identity of a run: rows with equal keys are the same run."""
        return (self.instance, self.digest, self.planner, self.time_limit_s, self.memory_mb)


def planners(rows: Iterable[Row]) -> tuple[str, ...]:
    """The planners in the order of their first rows."""
    return tuple(dict.fromkeys(row.planner for row in rows))


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a file, the last one of equal runs; empty if the file does not exist.

    A last line that an interruption cut short is skipped. Raises InputError for any other line that is no row, and for
    a file that can't be read.
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
    """Append a row to a file, which is created if needed; a line cut short before it is removed.

    The row is written without its traceback, which names paths of this machine; the message has the exception and its
    place. Raises InputError if the file can't be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+b") as file:
            file.seek(0)
            whole = file.read().rfind(b"\n") + 1
            file.truncate(whole)
            file.write(json.dumps(asdict(replace(row, traceback="")), ensure_ascii=False).encode() + b"\n")
    except OSError as error:
        mend = "check that the folder may be written to"
        raise InputError.of(f"can't be written: {error.strerror}", file=str(path), mend=mend) from None


_FIELDS = frozenset(each.name for each in fields(Row))
_REQUIRED = frozenset(f.name for f in fields(Row) if f.default_factory is MISSING and f.default is MISSING)


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
