"""Answers that people can act on: why there is no plan, why this one, and what else there is.

Everything is asked of a planner (`planning.Planner`), of which nothing is known but that it is right.
"""

from cfgplan.explaining.best_effort import BestEffort, best_effort

__all__ = ["BestEffort", "best_effort"]
