"""Small environments with open pairs of tags, drawn by Hypothesis, and what is wrong about answers to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hypothesis import strategies as st
from worlds import TAGS, oracle_of

from cfgplan.domain import Similarity
from cfgplan.planners import PLANNERS
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Pair, Plan, Problem, Status
from cfgplan.validity import plan_violations

REFUSED = (Status.INFEASIBLE, Status.TOO_EXPENSIVE)


@dataclass
class Truthful:
    """A decider that knows the true relation, and answers `most` pairs at a time."""

    similarity: Similarity
    truth: Similarity
    most: int = 1
    asked: int = 0

    @property
    def counts(self) -> dict[str, int]:
        return {"pairs asked": self.asked}

    def decide(self, pairs: Sequence[Pair]) -> int:
        told = pairs[: self.most]
        still: dict[str, frozenset[str]] = dict(self.similarity.open)
        offers: dict[str, frozenset[str]] = dict(self.similarity.offers)
        for offered, demanded in told:
            assert self.similarity.is_open(offered, demanded)
            still[demanded] -= {offered}
            if self.truth.holds(offered, demanded):
                offers[demanded] = offers.get(demanded, frozenset()) | {offered}
        self.similarity = Similarity(offers, {demanded: row for demanded, row in still.items() if row})
        self.asked += len(told)
        return len(told)


@st.composite
def undecided(draw: st.DrawFn, problems: st.SearchStrategy[Problem]) -> tuple[Problem, Similarity]:
    """A problem with open pairs, and the true relation."""
    problem = draw(problems)
    truth = problem.similarity
    pairs = draw(st.sets(st.tuples(st.sampled_from(TAGS), st.sampled_from(TAGS)), min_size=1, max_size=4))
    rows = {tag: frozenset(offered for offered, demanded in pairs if demanded == tag) for tag in TAGS}
    decided = {tag: row - rows[tag] for tag, row in truth.offers.items()}
    return replace(problem, similarity=Similarity(decided, {tag: row for tag, row in rows.items() if row})), truth


def differences(problem: Problem, truth: Similarity, planner: str = "cpsat") -> list[str]:
    """What is wrong about the answers of an exact planner with a truthful decider, and with none."""
    deciding = Deciding(PLANNERS[planner], Truthful(problem.similarity, truth))
    asked = deciding(problem)
    found = [f"asked: {each}" for each in plan_violations(deciding.known(problem), asked)]
    true = oracle_of(replace(problem, similarity=truth))
    if _key(asked) != _key(true) and not (asked.status is Status.TOO_EXPENSIVE and true.status is Status.INFEASIBLE):
        found.append(f"asked: {_key(asked)}, but the truth is {_key(true)}")
    silent = PLANNERS[planner](problem)
    found += [f"silent: {each}" for each in plan_violations(problem, silent)]
    found += _false_claims(problem, silent, true)
    for completion in (problem.similarity.decided, problem.similarity.optimistic):
        # The oracle would try all wirings of a dense relation here.
        found += _false_claims(problem, silent, PLANNERS[planner](replace(problem, similarity=completion)))
    return found


def _false_claims(problem: Problem, silent: Plan, true: Plan) -> list[str]:
    """What an answer for a problem with open pairs claims that is not so in one of its completions."""
    said = f"silent: {silent.status} {silent.bound_us} {silent.cost_us}, but {true.status} {true.cost_us} may be"
    if silent.status in REFUSED and true.status not in REFUSED:
        return [said]
    if silent.status is Status.OPTIMAL and _key(silent)[:3] != _key(true)[:3]:
        return [said]
    if silent.ties_proven and _key(silent) != _key(true):
        return [f"{said}, with other changes"]
    if true.status is Status.OPTIMAL:
        assert true.cost_us is not None
        is_monotone = not any(t.required or t.pinned for t in problem.environment.library)
        if silent.bound_us > true.cost_us:
            return [f"{said}: the bound is above the optimum"]
        if is_monotone and silent.cost_us is not None and silent.cost_us < true.cost_us:
            return [f"{said}: the plan is not valid"]
    return []


def _key(plan: Plan) -> tuple[object, ...]:
    changes = plan.change_set
    counts = changes and (len(changes.rewired), len(changes.started))
    cost_us = plan.cost_us if changes is not None else None
    return plan.status, len(plan.unused_required), cost_us, counts
