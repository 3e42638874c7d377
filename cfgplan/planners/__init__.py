"""The planners, each a function of a problem (`planning.Planner`), by the name the user writes.

* `cpsat`: exact, by constraint programming with lazily added groundedness.
* `exhaustive`: the oracle, which tries every set of units and every wiring; about ten transformations.
* `branch-and-bound`: the paper's Algorithms 1 and 2 with the merging of section IV-D; not optimal.

None of them looks at open pairs of tags: problems that have some come to them through `undecided`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType

from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Plan, Planner, Problem, Progress


def _imported_on_use(module: str) -> Planner:
    """The module's function `plan`, in a `Deciding` where pairs are open; the module is imported at the first call."""

    def planner(
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
    ) -> Plan:
        plan: Planner = import_module(module).plan
        if problem.similarity.open:
            plan = Deciding(plan)
        return plan(problem, time_limit_s=time_limit_s, report=report)

    return planner


IGNORING_REQUIRED = frozenset({"branch-and-bound"})
"""Planners that do not try to use required transformations."""
PLANNERS: Mapping[str, Planner] = MappingProxyType(
    {
        "cpsat": _imported_on_use("cfgplan.planners.cpsat"),
        "exhaustive": _imported_on_use("cfgplan.planners.exhaustive"),
        "branch-and-bound": _imported_on_use("cfgplan.planners.branch_and_bound"),
    }
)
