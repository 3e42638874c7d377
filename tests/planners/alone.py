"""The solver alone: no bounds and no first plan, so that it has to find every plan itself."""

from __future__ import annotations

from collections.abc import Sequence

from cfgplan.domain import Similarity
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.fleet import plan_fleet
from cfgplan.planners.exact.model import ModelRule
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exact.search import Search
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.networks.core import Core
from cfgplan.planners.networks.network import Network
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planning import Plan, Problem
from cfgplan.reasons import Providers


def search_alone(
    problem: Problem, *, is_apart: bool = False, rules: Sequence[ModelRule] = RULES, tuning: Tuning = USUAL
) -> Search:
    """A search in the one model, from nothing; with `is_apart` every subscription has a boolean."""
    candidates = Candidates(problem, clock=Clock(tuning=tuning))
    state = SolveState(problem, candidates.clock, None)
    state.min_unused = sum(not candidates.of(label) for label in problem.environment.required)
    return Search(candidates, state, is_apart=is_apart, rules=rules)


def plan_alone(problem: Problem) -> Plan:
    """The optimal update by the solver alone."""
    return PlannerSession(Tuning.solver_only()).plan(problem)


def plan_apart(problem: Problem) -> Plan:
    """The same in the model in which every possible subscription has a boolean."""
    search = search_alone(problem, is_apart=True)
    required = problem.environment.required
    search.state.min_unused = sum(not search.model.candidates.of(label) for label in required)
    search.run()
    return search.state.plan()


def plan_as_fleet(problem: Problem) -> Plan:
    """The optimal update by the stages of fleets, even if nothing is asked beyond the paper."""
    state = SolveState(problem, Clock(), None)
    plan_fleet(Candidates(problem), state, ())
    return state.plan()


def network_of(core: Core) -> Network:
    """A core by itself: its labels have no names, none has to run, and no input is distinct or fed back."""
    network = Network((), (), (), Providers((), Similarity({})))
    network.core = core
    return network
