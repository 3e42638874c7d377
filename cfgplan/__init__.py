"""cfgplan wires stream-processing components by meaning, as cheaply as possible, and proves it.

import cfgplan

world = cfgplan.load("models/nao/2-segmenter-lost.yaml")
problem, plan = cfgplan.solve(world)
if plan.change_set is not None:
    after = problem.environment.update(plan.change_set)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cfgplan.exports import exports

if TYPE_CHECKING:
    from cfgplan.answers import alternatives as alternatives
    from cfgplan.answers import best_effort as best_effort
    from cfgplan.answers import front as front
    from cfgplan.answers import sensitivity as sensitivity
    from cfgplan.answers import why as why
    from cfgplan.answers import why_not as why_not
    from cfgplan.api import UntruthfulPlanError as UntruthfulPlanError
    from cfgplan.api import World as World
    from cfgplan.api import load as load
    from cfgplan.api import load_plan as load_plan
    from cfgplan.api import match as match
    from cfgplan.api import match_ports as match_ports
    from cfgplan.api import matches as matches
    from cfgplan.api import plan as plan
    from cfgplan.api import problem as problem
    from cfgplan.api import solve as solve
    from cfgplan.api import what_if as what_if
    from cfgplan.api import world as world
    from cfgplan.domain import ChangeSet as ChangeSet
    from cfgplan.domain import ComputationUnit as ComputationUnit
    from cfgplan.domain import Environment as Environment
    from cfgplan.domain import Host as Host
    from cfgplan.domain import InputPort as InputPort
    from cfgplan.domain import OutputPort as OutputPort
    from cfgplan.domain import Publication as Publication
    from cfgplan.domain import Similarity as Similarity
    from cfgplan.domain import Stream as Stream
    from cfgplan.domain import Subscription as Subscription
    from cfgplan.domain import Target as Target
    from cfgplan.domain import Transformation as Transformation
    from cfgplan.errors import CfgplanError as CfgplanError
    from cfgplan.errors import Fault as Fault
    from cfgplan.errors import InputError as InputError
    from cfgplan.errors import InvalidValueError as InvalidValueError
    from cfgplan.planning import Failures as Failures
    from cfgplan.planning import Feature as Feature
    from cfgplan.planning import OwnPlannerError as OwnPlannerError
    from cfgplan.planning import Plan as Plan
    from cfgplan.planning import Planner as Planner
    from cfgplan.planning import PlannerFaultError as PlannerFaultError
    from cfgplan.planning import Problem as Problem
    from cfgplan.planning import Progress as Progress
    from cfgplan.planning import Status as Status
    from cfgplan.planning import fresh_unit_ids as fresh_unit_ids
    from cfgplan.planning import refuse_features as refuse_features
    from cfgplan.qualities import Better as Better
    from cfgplan.qualities import Contribution as Contribution
    from cfgplan.qualities import Over as Over
    from cfgplan.qualities import QualityAttribute as QualityAttribute
    from cfgplan.qualities import QualityRule as QualityRule
    from cfgplan.qualities import Wish as Wish
    from cfgplan.validity import Rule as Rule
    from cfgplan.validity import Violation as Violation
    from cfgplan.validity import plan_violations as plan_violations
    from cfgplan.validity import violations as violations

__version__ = "0.1.0"

__all__, __getattr__, __dir__ = exports(
    __name__,
    {
        "answers": "alternatives best_effort front sensitivity why why_not",
        "api": "UntruthfulPlanError World load load_plan match match_ports matches plan problem solve what_if world",
        "domain": "ChangeSet ComputationUnit Environment Host InputPort OutputPort Publication Similarity Stream "
        "Subscription Target Transformation",
        "errors": "CfgplanError Fault InputError InvalidValueError",
        "planning": "Failures Feature OwnPlannerError Plan Planner PlannerFaultError Problem Progress Status "
        "fresh_unit_ids refuse_features",
        "qualities": "Better Contribution Over QualityAttribute QualityRule Wish",
        "validity": "Rule Violation plan_violations violations",
    },
)
