"""The solver alone: no bounds and no first plan, so that it has to find every plan itself."""

from __future__ import annotations

from math import inf

from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.search import Search as PlainSearch
from cfgplan.planners.cpsat.standing import Standing as PlainStanding
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.flat import Flat
from cfgplan.planners.fleet.flat_search import FlatSearch
from cfgplan.planners.fleet.flatness import is_flat
from cfgplan.planners.fleet.search import Search as FleetSearch
from cfgplan.planners.fleet.standing import Standing as FleetStanding
from cfgplan.planners.networks.site import Site, relevant
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Plan, Problem, Status
from cfgplan.reasons import Givers, startable, unmet_reasons


def plain_search(problem: Problem) -> PlainSearch:
    """A search over all relevant transformations of a plain problem, from nothing."""
    environment = problem.environment
    givers = Givers(environment.library, problem.similarity)
    labels = relevant(environment, givers, startable(environment, givers))
    prepared = Prepared(sorted(labels))
    standing = PlainStanding(Site(problem, givers, labels), prepared, Clock(), None)
    standing.counts = {"rounds": 0, "cuts": 0, "conflicts": 0}
    return PlainSearch(standing, prepared)


def fleet_search(problem: Problem, *, is_apart: bool = False) -> FleetSearch:
    """A search in the model of who feeds whom, from nothing; with `is_apart` every subscription has a boolean."""
    standing = FleetStanding(problem, Clock(), None)
    standing.counts = {"conflicts": 0}
    return FleetSearch(Candidates(problem), standing, is_apart=is_apart)


def flat_search(problem: Problem) -> FlatSearch:
    """A search in the model of what is where, from nothing; the problem has to be flat."""
    candidates, standing = Candidates(problem), FleetStanding(problem, Clock(), None)
    assert is_flat(candidates)
    standing.counts = {"conflicts": 0}
    return FlatSearch(Flat(candidates), standing, inf)


def plan_alone(problem: Problem) -> Plan:
    """The optimal update by the solver alone."""
    if reasons := unmet_reasons(problem):
        return Plan("cpsat", Status.INFEASIBLE, reasons=reasons)
    search = fleet_search(problem) if problem.notions else plain_search(problem)
    search.run()
    return search.standing.plan()


def flat_cost_alone(problem: Problem) -> int | None:
    """The least cost by the model of what is where alone; None if no plan is possible."""
    search = flat_search(problem)
    if search.flat.is_impossible:
        return None
    search.run()
    best = search.standing.best
    assert best is None or search.standing.is_cost_proven
    return None if best is None else best[0][1]
