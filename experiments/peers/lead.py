"""A head start for peers: the results of `cpsat` on a plain problem before it calls its solver.

The results are a plan, a bound, landmarks, and the candidates that no better plan uses.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection

from cfgplan.planning import Problem
from experiments.peers.selection import Selection


@dataclass(frozen=True)
class Lead:
    """Results about a selection's candidates, which are given by index.

    A landmark is a least total, and the weight of each of its candidates: every plan reaches the total.
    """

    plan: list[int] | None
    bound_us: int
    landmarks: list[tuple[int, dict[int, int]]]
    dropped: list[int]


def lead_apart(problem: Problem, who: str, time_limit_s: float | None) -> Lead:
    """Return the lead, computed in another process, since ortools can't share a process with the peers' solvers."""
    ours, theirs = (context := get_context("fork")).Pipe(duplex=False)
    process = context.Process(target=_send, args=(theirs, problem, who, time_limit_s))
    process.start()
    theirs.close()
    try:
        found: Lead = ours.recv()
    finally:
        process.join()
    return found


def _send(to: Connection, problem: Problem, who: str, time_limit_s: float | None) -> None:
    to.send(lead_of(problem, who, time_limit_s))


def lead_of(problem: Problem, who: str, time_limit_s: float | None) -> Lead:
    """Return the results of the bounds and of closing the gap, without the planner's search of small problems."""
    from cfgplan.planners.exact.memory import Memory
    from cfgplan.planners.exact.session import offer_running_units
    from cfgplan.planners.exact.solve_run import SolveRun
    from cfgplan.planners.exact.solve_state import SolveState
    from cfgplan.planners.exact.stages import check_reachable_targets, close_gap, raise_bound
    from cfgplan.planners.solving.clock import Clock

    selection, clock = Selection(problem, who), Clock(time_limit_s)
    state = SolveState(problem, clock, None)
    offer_running_units(state)
    work = SolveRun(state, Memory.of(problem, None, clock))
    if check_reachable_targets(work):
        return Lead(None, 0, [], [])
    raise_bound(work)
    close_gap(work)
    by_id = {candidate.id: i for i, candidate in enumerate(selection.candidates)}
    by_label: dict[str, list[int]] = defaultdict(list)
    for i, candidate in enumerate(selection.candidates):
        by_label[candidate.transformation.label].append(i)
    left = set(work.remaining.names(work.network))
    landmarks = [(least, Counter(i for label in labels for i in by_label[label])) for labels, least in work.landmarks()]
    return Lead(
        None if state.best is None else sorted(by_id[unit.id] for unit in state.best.units),
        state.bound_us,
        [(least, dict(members)) for least, members in landmarks],
        [i for label, numbers in by_label.items() if label not in left for i in numbers if i not in selection.kept],
    )
