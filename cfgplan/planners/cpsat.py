"""The exact planner by the name the user writes; see the room `exact`."""

from cfgplan.planners.exact.session import PlannerSession, plan

__all__ = ["PlannerSession", "plan"]
