"""The solver alone: no bounds and no first plan, so that it has to find every plan itself."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.flat import Flat
from cfgplan.planners.exact.flat_search import FlatSearch
from cfgplan.planners.exact.flatness import is_flat
from cfgplan.planners.exact.model import ModelRule
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exact.search import Search
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Tuning
from cfgplan.planning import Plan, Problem


def search_alone(problem: Problem, *, is_apart: bool = False, rules: Sequence[ModelRule] = RULES) -> Search:
    """A search in the one model, from nothing; with `is_apart` every subscription has a boolean."""
    return Search(Candidates(problem), Standing(problem, Clock(), None), is_apart=is_apart, rules=rules)


def flat_search(problem: Problem) -> FlatSearch:
    """A search in the model of what is where, from nothing; the problem has to be flat."""
    candidates, standing = Candidates(problem), Standing(problem, Clock(), None)
    assert is_flat(candidates)
    standing.counts = {"conflicts": 0}
    return FlatSearch(Flat(candidates), standing, inf)


def plan_alone(problem: Problem) -> Plan:
    """The optimal update by the solver alone."""
    return PlannerSession(Tuning.solver_only()).plan(problem)


def flat_cost_alone(problem: Problem) -> int | None:
    """The least cost by the model of what is where alone; None if no plan is possible."""
    search = flat_search(problem)
    if search.flat.is_impossible:
        return None
    search.run()
    best = search.standing.best
    assert best is None or search.standing.is_cost_proven
    return None if best is None else best.key.cost_us
