"""The judge: every rule that an environment or a plan breaks, in words (Definitions 8-10).

It shares no code with any planner and recomputes feasibility and cost from the definitions alone.
"""

from cfgplan.arguments import checked
from cfgplan.validity import environments, plans
from cfgplan.validity.plans import kept_us, silent_stops, unused_required, values_of
from cfgplan.validity.rules import Rule, Violation

violations = checked(environments.violations)
plan_violations = checked(plans.plan_violations)

__all__ = [
    "Rule",
    "Violation",
    "kept_us",
    "plan_violations",
    "silent_stops",
    "unused_required",
    "values_of",
    "violations",
]
