"""Whether a configuration is valid, before it becomes the incumbent and cuts anything off.

Every rule is checked for each configuration, because an invalid incumbent makes proofs false. The judge checks the
answer again, and shares no code with this module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from cfgplan.domain import ComputationUnit
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.checked_units import CheckedUnits
from cfgplan.planners.exact.pruning import needed_in_all
from cfgplan.planners.exact.rules import RULES, host_loads
from cfgplan.planners.exact.survivors import can_do_without


def flaws(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[str]:
    """Yield each flaw of a configuration as text; a valid one yields none.

    The candidates may be a part of all: the rules about units that must run are checked against the problem.
    """
    problem, checked = candidates.problem, CheckedUnits(candidates, units)
    for rule in RULES:
        if rule.flaws is not None and rule.is_asked(problem):
            yield from rule.flaws(checked)
    loads = host_loads(problem)
    for unit in units if problem.features else ():
        if not loads.put(checked.kind(unit), unit.host):
            yield f"the host of unit {unit.id} has no room for it"
    if _has_needless_units(candidates, units):
        yield "nothing needs some unit"


def _has_needless_units(candidates: Candidates, units: Collection[ComputationUnit]) -> bool:
    """Whether some unit is needless: no target, pin, number, company or failure needs it."""
    needed = needed_in_all(candidates.problem, units, ())
    if len(needed) < len(units) and candidates.problem.survive is not None:
        left = [unit for unit in units if unit.id not in needed]
        spares = {unit.id for unit in left if not can_do_without(candidates, units, unit)}
        needed = needed_in_all(candidates.problem, units, spares)
    return len(needed) < len(units)
