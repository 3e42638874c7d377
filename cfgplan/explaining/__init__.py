"""Answers that people can act on: why there is no plan, why this one, and what else there is.

Everything is asked of a planner (`planning.Planner`), of which nothing is known but that it is right.
"""

from cfgplan.explaining.alternatives import Alternatives, alternatives
from cfgplan.explaining.best_effort import BestEffort, best_effort
from cfgplan.explaining.front import Front, FrontPoint, front
from cfgplan.explaining.limits import Limit
from cfgplan.explaining.sensitivity import CostLine, Sensitivity, Span, horizon_sensitivity, upkeep_sensitivity
from cfgplan.explaining.unfed import Blocked, Unfed, Unreachable, unreachable
from cfgplan.explaining.what_if import running
from cfgplan.explaining.why_not import Clash, DemandSet, Unused, WhyNot, demanding, why_not
from cfgplan.explaining.why_this import Choice, Why, why_stream, why_transformation, why_unit
from cfgplan.explaining.wiring import NearStream, Suspicion, WiringFault, wiring_demands, wiring_faults

__all__ = [
    "Alternatives",
    "BestEffort",
    "Blocked",
    "Choice",
    "Clash",
    "CostLine",
    "DemandSet",
    "Front",
    "FrontPoint",
    "Limit",
    "NearStream",
    "Sensitivity",
    "Span",
    "Suspicion",
    "Unfed",
    "Unreachable",
    "Unused",
    "Why",
    "WhyNot",
    "WiringFault",
    "alternatives",
    "best_effort",
    "demanding",
    "front",
    "horizon_sensitivity",
    "running",
    "unreachable",
    "upkeep_sensitivity",
    "why_not",
    "why_stream",
    "why_transformation",
    "why_unit",
    "wiring_demands",
    "wiring_faults",
]
