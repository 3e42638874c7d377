"""The solver's rounds: what is not grounded is forbidden, and when."""

from __future__ import annotations

from typing import Any
from unittest import mock

import pytest
from ortools.sat.python.cp_model import FEASIBLE, OPTIMAL

from cfgplan.comparing.families.random_library import random_library
from cfgplan.planners.cpsat import PlannerSession, search
from cfgplan.planners.cpsat.grounding import Grounding
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.standing import Standing
from cfgplan.planners.networks.site import Site, relevant
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Status
from cfgplan.reasons import Givers, startable


@pytest.mark.parametrize("seed", [0, 2, 6])
def test_a_solution_that_is_not_grounded_is_forbidden_before_anything_is_proven_of_it(seed: int) -> None:
    problem = random_library(seed, transformations=30, targets=3, back=0.4)
    givers = Givers(problem.environment.library, problem.similarity)
    labels = relevant(problem.environment, givers, startable(problem.environment, givers))
    prepared = Prepared(sorted(labels))
    standing = Standing(Site(problem, givers, labels), prepared, Clock(), None)
    solve, statuses = search.solve, []

    def watched(*of: Any) -> Any:
        statuses.append(solve(*of))
        return statuses[-1]

    with mock.patch.object(search, "solve", watched):
        search.Search(standing, prepared, Grounding.CUTS).run()
    assert statuses[0] == FEASIBLE
    assert statuses[-1] == OPTIMAL
    found, other = standing.plan(), PlannerSession().plan(problem)
    assert found.status is other.status is Status.OPTIMAL
    assert found.cost_us == other.cost_us
