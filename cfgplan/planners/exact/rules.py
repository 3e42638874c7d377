"""The rules of an update, each a function named by its content in the file of its subject.

Adding a rule is a row in one of these files. A rule that a problem does not ask for adds nothing.
"""

from __future__ import annotations

from typing import Final

from cfgplan.planners.exact import company, hosts, idle_inputs, inputs, quality, survivors, targets, units
from cfgplan.planners.exact.host_loads import HostLoads
from cfgplan.planners.exact.rule import Rule
from cfgplan.planning import Problem

RULES: Final[tuple[Rule, ...]] = (
    *units.STATES,
    *inputs.RULES,
    *targets.MET,
    *hosts.CARRYING,
    units.PINNED,
    targets.REQUIRED,
    *idle_inputs.RULES,
    targets.NEEDED,
    *hosts.ROOM,
    *company.RULES,
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


def host_loads(problem: Problem) -> HostLoads:
    """Return empty hosts, on which units can be put as the rules that a problem asks for let them."""
    return HostLoads(problem, [rule.lacks for rule in RULES if rule.lacks is not None and rule.is_asked(problem)])
