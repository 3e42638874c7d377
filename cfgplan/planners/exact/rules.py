"""The rules of an update, each a `Rule` in the file of its subject, and the flaws of a configuration.

`RULES` lists each `Rule`, or the tuple that has it. A rule that a problem does not ask for adds nothing. Each
configuration is checked before it becomes the incumbent, because an invalid incumbent makes proofs false. The judge
checks the answer again, and shares no code with this room.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import cache
from typing import Final

from cfgplan.domain import ComputationUnit
from cfgplan.planners.exact import company, hosts, idle_inputs, inputs, quality, survivors, targets, units
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.pruning import needed_in_all
from cfgplan.planners.exact.rule import CheckedUnits, HostLoads, Lacks, Rule
from cfgplan.planners.exact.survivors import survive_without
from cfgplan.planning import Feature, Problem

RULES: Final[tuple[Rule, ...]] = (
    *units.STATES,
    *inputs.FEEDING,
    *targets.MET,
    *hosts.CARRYING,
    units.PINNED,
    targets.REQUIRED,
    *idle_inputs.IDLE,
    targets.NEEDED,
    *hosts.ROOM,
    *company.COMPANY,
    hosts.SYMMETRY,
    *units.ORDER,
    quality.ASKED,
    survivors.SURVIVED,
)
"""What a configuration must be, in the order in which the booleans are made."""
PLACED: Final = tuple(rule for rule in RULES if rule.is_placed)
"""The rules of units on hosts, which hold whatever the wiring."""
MAY_RUN_FOR_NOBODY: Final = frozenset(rule.feature for rule in RULES if rule.keeps_units)
"""With these features, units may be needed that feed nobody and meet no target."""


@cache
def _flaws_of(features: frozenset[Feature]) -> tuple[Callable[[CheckedUnits], Iterator[str]], ...]:
    """The checks of the rules that problems with these features ask for."""
    return tuple(rule.flaws for rule in RULES if rule.flaws is not None and rule.is_asked_by(features))


@cache
def _lacks_of(features: frozenset[Feature]) -> tuple[Lacks, ...]:
    """What hosts may lack by the rules that problems with these features ask for."""
    return tuple(rule.lacks for rule in RULES if rule.lacks is not None and rule.is_asked_by(features))


def host_loads(problem: Problem) -> HostLoads:
    """Return empty hosts, on which units can be put as the rules that a problem asks for let them."""
    return HostLoads(problem, _lacks_of(problem.features))


def flaws(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[str]:
    """Yield each flaw of a configuration as text; a valid one yields none.

    The candidates may be a part of all: the rules about units that must run are checked against the problem.
    """
    problem, checked = candidates.problem, CheckedUnits(candidates, units)
    for flaws_of_rule in _flaws_of(problem.features):
        yield from flaws_of_rule(checked)
    if problem.features:
        yield from _overloads(checked)
    if _has_needless_units(candidates, units):
        yield "nothing needs some unit"


def _overloads(checked: CheckedUnits) -> Iterator[str]:
    """Yield units for which their hosts lack something, beside the units before them."""
    loads = host_loads(checked.problem)
    for unit in checked.units:
        if not loads.put(checked.kind(unit), unit.host):
            yield f"the host of unit {unit.id} has no room for it"


def _has_needless_units(candidates: Candidates, units: Collection[ComputationUnit]) -> bool:
    """Whether some unit is needless: no target, pin, number, company or failure needs it."""
    needed = needed_in_all(candidates.problem, units, ())
    if len(needed) < len(units) and candidates.problem.survive is not None:
        left = [unit for unit in units if unit.id not in needed]
        spares = {unit.id for unit in left if not survive_without(candidates, units, unit)}
        needed = needed_in_all(candidates.problem, units, spares)
    return len(needed) < len(units)
