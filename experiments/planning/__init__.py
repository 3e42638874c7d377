"""The planner at scale, compared with variants that lack a part, and with the peers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cfgplan.comparing import REGISTERED, Entrant
from experiments.planning.scale_suite import SCALE_SEEDS
from experiments.study.instances import Instance


def _variant(name: str, function: str) -> Entrant:
    cpsat = REGISTERED["cpsat"]
    return Entrant(name, f"{__name__}.variants:{function}", cpsat.engines)


VARIANTS: Mapping[str, Entrant] = MappingProxyType(
    {
        entrant.name: entrant
        for entrant in (
            _variant("cuts-alone", "cuts_alone"),
            _variant("levels-alone", "levels_alone"),
            _variant("cpsat-defaults", "defaults_alone"),
        )
    }
)
"""The model with lazy cuts alone, with level variables in place of these, and that with CP-SAT's defaults."""

ALL_SEEDS = frozenset({"cpsat", "highs", "scip", "clingo-usc"})
THREE_SEEDS = frozenset({"rc2-stratified"})


def takes_part(instance: Instance, entrant: Entrant) -> bool:
    """Return whether a planner runs on an instance.

    cpsat and its closest peers run on all seeds, RC2 by strata on the first three, every planner on the first.
    """
    is_early = instance.seed in SCALE_SEEDS[:3]
    return instance.seed == SCALE_SEEDS[0] or entrant.name in ALL_SEEDS or (is_early and entrant.name in THREE_SEEDS)
