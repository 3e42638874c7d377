"""The report of a comparison: tables and plots from result rows, in a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cfgplan.comparing.invariants import breaches
from cfgplan.comparing.plots import write_plots
from cfgplan.comparing.rows import Row
from cfgplan.comparing.tables import by_family, detail, effort, overview


def write_report(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write `tables.md` and the plots into the folder; returns the files. Raises ImportError without matplotlib."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = folder / "tables.md"
    tables.write_text(tables_text(rows), encoding="utf-8")
    return [tables, *write_plots(rows, folder)]


def tables_text(rows: Sequence[Row]) -> str:
    """What was run on what, whether the planners contradict each other, then the tables, in Markdown."""
    parts = [
        "# Results of the comparison",
        head(rows),
        overview(rows).markdown(),
        by_family(rows).markdown(),
        detail(rows).markdown(),
        effort(rows).markdown(),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def head(rows: Sequence[Row]) -> str:
    """What was run on what, and whether the planners contradict each other."""
    machines = dict.fromkeys(", ".join(f"{name} {value}" for name, value in row.machine.items()) for row in rows)
    versions = dict.fromkeys(f"{name} {version}" for row in rows for name, version in sorted(row.versions.items()))
    limits = dict.fromkeys(f"{row.time_limit_s:g} s" for row in rows)
    found = breaches(rows)
    agree = "all proofs agree, every plan passes the judge" if any(row.proven for row in rows) else "nothing is proven"
    verdict = "\n".join(f"* {text}" for text in found) or f"None: {agree}."
    runs = f"{len(rows)} runs, at most {', '.join(limits)} each, one at a time."
    return (
        f"{runs} Machine: {'; '.join(machines)}. Versions: {', '.join(versions)}.\n\n"
        "Written by `cfgplan compare`; do not edit. Trust ratios of times, not the times.\n\n"
        f"### Contradictions\n\n{verdict}"
    )
