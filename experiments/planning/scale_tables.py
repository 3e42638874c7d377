"""The tables of the comparison at scale: proofs and times per family and planner, and the lead of `cpsat`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, log

from cfgplan.comparing import RunFailure
from cfgplan.planning import Status
from experiments.peers import LED
from experiments.planning import scale_suite
from experiments.planning.leads import Lead, lead, matched, seconds, took_part
from experiments.study.invariants import gap, references
from experiments.study.report import Table, head
from experiments.study.rows import Row, planners

BASE = "cpsat"
PARTS = ("cuts-alone",)
"""The same planner with a part left out; all the others are peers."""
QUOTED = (BASE, "highs", "scip", "levels-alone", "clingo-usc", "rc2-stratified", "fast-downward")
"""The planners in the manual's table, in order."""
GAPS_S = 10.0
"""So long after the start bounds and plans are compared."""


def scale_text(rows: Sequence[Row], loads: Mapping[str, float]) -> str:
    """Return the tables in Markdown; `loads` has the seconds to load the environment file of an instance, by name."""
    tables = (summary(rows), quoted(rows), peer_by_peer(rows), behind(rows), building(rows, loads), everyone(rows))
    parts = ["# The planner at scale, and its peers", head(rows), *(table.markdown() for table in tables)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def families(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows by the name of their family, in the suite's order."""
    known = scale_suite.families().items()
    found = {name: [row for row in rows if row.parameters == parameters] for name, (_, parameters) in known}
    return {name: group for name, group in found.items() if group}


def summary(rows: Sequence[Row]) -> Table:
    """Return a table of each family's closest peer among those that ran on all of it, and means over the families."""
    peers = _peers(rows)
    lines, closest, fastest = [], [], []
    for name, group in families(rows).items():
        own = [row for row in group if row.planner == BASE]
        ran = Counter(row.planner for row in group)
        leads = {peer: lead(matched(group, BASE, [peer])) for peer in peers if ran[peer] == len(own)}
        if not leads:
            continue
        best = min(leads, key=lambda peer: _closeness(leads[peer]))
        each = lead(matched(group, BASE, peers))
        closest.append(leads[best])
        fastest.append(each)
        lines.append((name, _proven(own), _mean_s(own), best, leads[best].text(), each.text()))
    lines.append(("geometric mean", "", "", "", _mean(closest), _mean(fastest)))
    heads = (
        "family",
        "cpsat proves",
        "s to proof",
        "closest peer",
        "lead over it",
        "lead over the fastest peer each time",
    )
    return Table(f"How far {BASE} is ahead of {', '.join(peers)}", heads, tuple(lines))


def quoted(rows: Sequence[Row]) -> Table:
    """Return the manual's table: what each planner proves, how long it takes, and the same for families with hosts."""
    groups = families(rows)
    hosted = [name for name, group in groups.items() if any("hosts" in row.parameters for row in group)]
    proven = (_proven([row for row in rows if row.planner == name and took_part(row)]) for name in QUOTED)
    means = [
        _mean([lead(matched(group, BASE, [name])) for group in groups.values()]).split(" (")[0] for name in QUOTED[1:]
    ]
    lines = [("proven", *proven), (f"time to proof, in multiples of {BASE}'s", "1", *means)]
    for family in hosted:
        group = groups[family]
        cells = [_proven([row for row in group if row.planner == BASE])]
        for name in QUOTED[1:]:
            own = _proven([row for row in group if row.planner == name and took_part(row)])
            cells.append(f"{own} ({lead(matched(group, BASE, [name])).text()})" if own else "does not support hosts")
        lines.append((family, *cells))
    return Table("The table of the manual", ("", *QUOTED), tuple(lines))


def peer_by_peer(rows: Sequence[Row]) -> Table:
    """Return a table of each peer on all families that it ran on; peers with a head start from `cpsat` come last."""
    lines = []
    for peer in (*_peers(rows), *(name for name in planners(rows) if name in LED)):
        leads = {name: lead(matched(group, BASE, [peer])) for name, group in families(rows).items()}
        least = min(leads, key=lambda name: _closeness(leads[name]))
        own = _proven([row for row in rows if row.planner == peer])
        lines.append((peer, own, _mean(list(leads.values())), f"{leads[least].text()} ({least})"))
    heads = ("peer", "proves", f"lead of {BASE}: geometric mean over families", "least lead")
    return Table(f"How far {BASE} is ahead of each of them", heads, tuple(lines))


def behind(rows: Sequence[Row]) -> Table:
    """Return a table of the instances on which another planner is faster, or has a better bound or plan without a
    proof.
    """
    lines = []
    for name in planners(rows):
        for base, other in matched(rows, BASE, [name]) if name != BASE else ():
            found = lead([(base, other)])
            if (found.ratio or 1.0) < 1.0 or found.bounds == (0, 1) or found.plans == (0, 1):
                lines.append((base.instance, name, _time(base), _time(other), found.text()))
    lines.sort(key=lambda line: list(dict.fromkeys(row.instance for row in rows)).index(line[0]))
    heads = ("instance", "planner", f"{BASE}, s", "its s", "lead")
    return Table(f"Where another is ahead of {BASE}", heads, tuple(lines))


def building(rows: Sequence[Row], loads: Mapping[str, float]) -> Table:
    """Return a table of loading times, the shares of the planner's phases, and the model building times of
    the others.
    """
    others = [name for name in planners(rows) if any("build" in row.seconds for row in rows if row.planner == name)]
    lines = []
    for name, group in families(rows).items():
        own = [row for row in group if row.planner == BASE and row.total_s is not None]
        loaded = [loads[row.instance] for row in own if row.instance in loads]
        longest = max((row.total_s or 0.0 for row in own), default=0.0)
        total = {phase: sum(row.seconds.get(phase, 0.0) for row in own) for phase in ("closure", "bounds", "search")}
        whole = sum(total.values()) or 1.0
        shares = (f"{seconds / whole:.0%}" for seconds in total.values())
        ratio = f"{longest / max(loaded):.2g}" if loaded else "-"
        builds = (
            [row.seconds["build"] for row in group if row.planner == o and "build" in row.seconds] for o in others
        )
        lines.append(
            (
                name,
                f"{max(loaded):.2g}" if loaded else "-",
                f"{longest:.2g}",
                ratio,
                *shares,
                *(f"{_geometric(values):.2g}" if values else "-" for values in builds),
            )
        )
    heads = ("family", "load, s", "longest plan, s", "plan / load", "closure", "bounds", "search")
    title = f"Loading the file of an instance; {BASE}'s phases; seconds that the others take to build their models"
    return Table(title, (*heads, *others), tuple(lines))


def everyone(rows: Sequence[Row]) -> Table:
    """Return a table of every planner on every family; gaps to the best known cost are the worst of unproven
    instances.
    """
    reference = references(rows)
    lines = []
    for name, group in families(rows).items():
        for planner in planners(group):
            own = [row for row in group if row.planner == planner]
            left = [row for row in (known_after(run, GAPS_S) for run in own if took_part(run)) if not row.proven]
            known = [(row, best.cost_us) for row in left if (best := reference.get((row.instance, row.digest)))]
            below = [1 - row.bound_us / cost_us for row, cost_us in known if cost_us]
            above = [found for row in left if (found := gap(row, reference)) is not None]
            without = len(left) - len(above)
            plans = [f"+{max(above):.1%}"] if above else []
            plans += [f"{without} without"] if without else []
            peaks = [row.peak_mb for row in own if row.peak_mb is not None]
            lines.append(
                (
                    name,
                    planner,
                    _proven(own),
                    _mean_s(own),
                    f"-{max(below):.1%}" if below else "",
                    ", ".join(plans),
                    f"{max(peaks):.0f}" if peaks else "-",
                    lead(matched(group, BASE, [planner])).text() if planner != BASE else "",
                )
            )
    gaps = (f"bound at {GAPS_S:.0f} s", f"plan at {GAPS_S:.0f} s")
    heads = ("family", "planner", "proven", "s to proof", *gaps, "peak MB", f"lead of {BASE}")
    title = "Every planner: mean and range of its times to proof, worst gaps of bound and plan where it had none yet"
    return Table(title, heads, tuple(lines))


def known_after(row: Row, seconds: float) -> Row:
    """Return the row as if the run had ended `seconds` after its start."""
    if row.time_limit_s <= seconds or (row.proof_s is not None and row.proof_s <= seconds):
        return row
    known = [point for point in row.trace if point[0] <= seconds]
    _, cost_us, bound_us = known[-1] if known else (0.0, None, 0)
    outcome = Status.UNKNOWN if cost_us is None else Status.FEASIBLE
    return replace(row, outcome=outcome, cost_us=cost_us, bound_us=bound_us, proof_s=None)


def _peers(rows: Sequence[Row]) -> list[str]:
    return [name for name in planners(rows) if name not in (BASE, *PARTS, *LED)]


def _closeness(found: Lead) -> tuple[float, int]:
    """Orders peers: the smaller the lead over one, the closer; where nothing is proven, the better its bounds."""
    return (found.ratio if found.ratio is not None else float("inf"), found.bounds[0] - found.bounds[1])


def _mean(leads: Sequence[Lead]) -> str:
    """The mean over families in which anything is proven."""
    decided = [each for each in leads if each.ratio is not None]
    if not decided:
        return "-"
    both = (any(each.at_least for each in decided), any(each.at_most for each in decided))
    mean = Lead(_geometric([each.ratio or 1.0 for each in decided]), len(decided), *both, 0, (0, 0), (0, 0))
    return f"{mean.text()} (families: {len(decided)})"


def _geometric(values: Sequence[float]) -> float:
    return exp(sum(map(log, values)) / len(values))


def _proven(rows: Sequence[Row]) -> str:
    """How many of the runs that it did not refuse a planner proved, and how the others failed that did."""
    failed = Counter(str(row.outcome) for row in rows if row.outcome in frozenset(RunFailure))
    tried = sum(map(took_part, rows))
    proven = [f"{sum(row.proven for row in rows)} of {tried}"] if tried else []
    return ", ".join([*proven, *(f"{count} {name}" for name, count in failed.items())])


def _mean_s(rows: Sequence[Row]) -> str:
    times = [seconds(row) for row in rows if row.proven]
    if len(times) < 2:
        return f"{times[0]:.2g}" if times else "-"
    return f"{_geometric(times):.2g} ({min(times):.2g} to {max(times):.2g})"


def _time(row: Row) -> str:
    return f"{seconds(row):.2g}" if row.proven else "-"
