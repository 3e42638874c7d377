"""The exact planner: preprocessing, then CP-SAT with lazily added groundedness."""

from cfgplan.planners.cpsat.search import plan

__all__ = ["plan"]
