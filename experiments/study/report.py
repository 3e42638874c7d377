"""The report of a comparison: tables as plain cells and as Markdown, and a folder with them and the plots."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log
from pathlib import Path
from statistics import median

from cfgplan.comparing.runs import PROVEN, RunFailure
from cfgplan.planning import Status
from experiments.study.invariants import LeastCost, breaches, by_instance, gap, references
from experiments.study.rows import SHORTEST_PROOF_S, Row, planners


@dataclass(frozen=True)
class Table:
    """A title, the heads of the columns, and a row of texts for each line."""

    title: str
    heads: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        lines = [self.heads, ("---",) * len(self.heads), *self.lines]
        body = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        return f"### {self.title}\n\n{body}\n"


def write_report(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write `tables.md` and the plots into the folder; returns the files. Raises ImportError without matplotlib."""
    from experiments.study.plots import write_plots

    folder.mkdir(parents=True, exist_ok=True)
    tables = folder / "tables.md"
    tables.write_text(tables_text(rows), encoding="utf-8")
    return [tables, *write_plots(rows, folder)]


def tables_text(rows: Sequence[Row]) -> str:
    """Return the report in Markdown: machines and runs, contradictions between planners, then the tables."""
    parts = [
        "# Results of the comparison",
        head(rows),
        overview(rows).markdown(),
        by_group(rows).markdown(),
        by_family(rows).markdown(),
        detail(rows).markdown(),
        effort(rows).markdown(),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def head(rows: Sequence[Row]) -> str:
    """Return the report's head: machines and runs, and contradictions between planners."""
    machines = dict.fromkeys(", ".join(f"{name} {value}" for name, value in row.machine.items()) for row in rows)
    versions = dict.fromkeys(f"{name} {version}" for row in rows for name, version in sorted(row.versions.items()))
    limits = dict.fromkeys(f"{row.time_limit_s:g} s" for row in rows)
    found = breaches(rows)
    agree = "all proofs agree, every plan passes the judge" if any(row.proven for row in rows) else "nothing is proven"
    verdict = "\n".join(f"* {text}" for text in found) or f"None: {agree}."
    runs = f"{len(rows)} runs, at most {', '.join(limits)} each, one at a time."
    return (
        f"{runs} Machine: {'; '.join(machines)}. Versions: {', '.join(versions)}.\n\n"
        "Written by `python -m experiments.compare`; do not edit. Trust ratios of times, not the times.\n\n"
        f"### Contradictions\n\n{verdict}"
    )


def overview(rows: Sequence[Row], *, base: str = "cpsat") -> Table:
    """Return a table with a column for each planner over all instances: proofs, plans, costs, and speed
    against `base`.
    """
    reference = references(rows)
    names = planners(rows)
    measures = (
        "runs",
        "proven",
        "plan, cost not proven",
        "no answer in time",
        "refused",
        "failed",
        "judged false",
        "median gap",
        "worst gap",
        "median s to first plan",
        "median s to best plan",
        "median s to proof",
        f"time to proof / {base}'s (instances)",
        "peak MB",
    )
    columns = [_column(rows, planner, base, reference) for planner in names]
    return Table("All instances", ("", *names), tuple(zip(measures, *columns, strict=True)))


def by_group(rows: Sequence[Row], *, base: str = "cpsat") -> Table:
    """For each group of families and each planner: proven, out of those not refused, and how fast against `base`."""
    names = planners(rows)
    lines = []
    for group in GROUPS:
        these = [row for row in rows if _group(row) == group]
        size = len(by_instance(these))
        cells = []
        for name in names:
            tried = [row for row in these if row.planner == name and _class(row) != "refused"]
            number, (ratio, _) = sum(row.proven for row in tried), ratio_to(these, name, base)
            of = "" if len(tried) == size else f" of {len(tried)}"
            speed = "" if ratio is None or name == base else f" ({ratio:.2g})"
            cells.append(f"{number}{of}{speed}" if tried else "-")
        if size:
            lines.append((group, str(size), *cells))
    title = f"Proven by group of families, and the time to proof as a multiple of {base}'s, over what both proved"
    return Table(title, ("group", "instances", *names), tuple(lines))


def by_family(rows: Sequence[Row], *, base: str = "cpsat") -> Table:
    """For each family and planner: proven out of those not refused, how fast against `base`, and the worst gap."""
    names = planners(rows)
    reference = references(rows)
    lines = []
    for kind in dict.fromkeys(_kind(row) for row in rows):
        group = [row for row in rows if _kind(row) == kind]
        cells = []
        for name in names:
            tried = [
                r for r in group if r.planner == name and r.outcome not in (RunFailure.REFUSED, RunFailure.UNAVAILABLE)
            ]
            ratio, _ = ratio_to(group, name, base)
            speed = f", x{ratio:.2g}" if ratio is not None and name != base else ""
            gaps = [g for row in tried if (g := gap(row, reference)) is not None]
            worst = f", gap to {max(gaps):.0%}" if gaps and max(gaps) >= 0.005 else ""
            cells.append(f"{sum(row.proven for row in tried)} of {len(tried)}{speed}{worst}" if tried else "-")
        lines.append((kind, str(len(by_instance(group))), *cells))
    title = (
        f"Proven by family; time to proof as a multiple of {base}'s, over what both proved; worst gap of what was found"
    )
    return Table(title, ("family", "instances", *names), tuple(lines))


def detail(rows: Sequence[Row]) -> Table:
    """Return a table of every run: its time to proof, or the gap of its plan, or how it failed."""
    names = planners(rows)
    reference = references(rows)
    lines = []
    for instance, group in by_instance(rows).items():
        cell = {row.planner: _cell(row, reference) for row in group}
        best = reference.get(instance)
        cost = f"{best.cost_us / 1e6:g}{'' if best.proven else ' ?'}" if best else "none"
        lines.append((instance[0], cost, *(cell.get(name, "") for name in names)))
    return Table(
        "Every run: seconds to proof, or the gap of an unproven plan", ("instance", "least cost", *names), tuple(lines)
    )


LARGE = 200
"""From so many transformations on, instances of one family make a line of their own."""
GROUPS = (
    "NAO case",
    f"random, replanning: under {LARGE} transformations",
    f"random, replanning: {LARGE} to 2,000",
    "hand-made",
    "WSC 2008",
)
"""The groups that texts quote."""
EFFORT = ("nodes", "conflicts", "expanded", "wirings")


def effort(rows: Sequence[Row]) -> Table:
    """Every run: how many nodes, conflicts, expanded states or tried wirings it took, whatever the planner counts."""
    names = planners(rows)
    lines = []
    for instance, group in by_instance(rows).items():
        counted = {row.planner: next((row.counts[key] for key in EFFORT if key in row.counts), None) for row in group}
        cells = ("" if counted.get(name) is None else f"{counted[name]:,}" for name in names)
        lines.append((instance[0], *cells))
    title = "Every run: nodes (branch-and-bound, HiGHS), conflicts (cpsat, clingo), expanded states, or wirings tried"
    return Table(title, ("instance", *names), tuple(lines))


def ratio_to(rows: Sequence[Row], planner: str, base: str) -> tuple[float | None, int]:
    """Geometric mean of time to proof against `base`'s, over the instances that both proved, and their number."""
    proof: dict[str, dict[tuple[str, str], float]] = defaultdict(dict)
    for row in rows:
        if row.proof_s is not None:
            proof[row.planner][row.instance, row.digest] = max(SHORTEST_PROOF_S, row.proof_s)
    both = proof[planner].keys() & proof[base].keys()
    if not both:
        return None, 0
    return exp(sum(log(proof[planner][key] / proof[base][key]) for key in both) / len(both)), len(both)


def _column(
    rows: Sequence[Row], planner: str, base: str, reference: Mapping[tuple[str, str], LeastCost]
) -> tuple[str, ...]:
    own = [row for row in rows if row.planner == planner]
    count = Counter(_class(row) for row in own)
    gaps = [g for row in own if (g := gap(row, reference)) is not None]
    peaks = [row.peak_mb for row in own if row.peak_mb is not None]
    ratio, number = ratio_to(rows, planner, base)
    return (
        str(len(own)),
        *(str(count[name]) for name in ("proven", "plan", "nothing", "refused", "failed")),
        str(sum(bool(row.violations) for row in own)),
        f"{median(gaps):.1%}" if gaps else "-",
        f"{max(gaps):.0%}" if gaps else "-",
        *(_median_s(own, name) for name in ("first_s", "best_s", "proof_s")),
        f"{ratio:.2g} ({number})" if ratio is not None else "-",
        f"{max(peaks):.0f}" if peaks else "-",
    )


def _median_s(rows: Sequence[Row], name: str) -> str:
    times = [getattr(row, name) for row in rows if getattr(row, name) is not None]
    return f"{median(times):.2g}" if times else "-"


def _class(row: Row) -> str:
    if row.proven:
        return "proven"
    if row.has_plan:
        return "plan"
    if row.outcome in (RunFailure.REFUSED, RunFailure.UNAVAILABLE):
        return "refused"
    return "nothing" if row.outcome in (Status.UNKNOWN, RunFailure.KILLED) else "failed"


def _cell(row: Row, reference: Mapping[tuple[str, str], LeastCost]) -> str:
    if row.violations:
        return "judged false"
    if row.proof_s is not None:
        word = f" ({row.outcome})" if row.outcome in PROVEN and not row.has_plan else ""
        return f"{row.proof_s:.3g}{word}"
    found = gap(row, reference)
    if found is not None:
        return f"+{found:.1%}"
    if row.has_plan:
        return "leaves a required one unused"
    return "no plan" if row.outcome == Status.UNKNOWN else str(row.outcome)


def _group(row: Row) -> str:
    if row.family in ("random_library", "replanning"):
        return GROUPS[2 if row.transformations >= LARGE else 1]
    return {"nao": GROUPS[0], "wsc": GROUPS[4]}.get(row.family, GROUPS[3])


def _kind(row: Row) -> str:
    kind = row.parameters.get("kind") or row.parameters.get("event")
    if kind:
        return f"{row.family}: {kind}"
    if "transformations" in row.parameters:
        return f"{row.family}, {'from' if row.transformations >= LARGE else 'under'} {LARGE} transformations"
    return row.family
