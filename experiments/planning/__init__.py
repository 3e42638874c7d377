"""The planner at scale, against itself without its parts and against the peers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cfgplan.comparing import REGISTERED, Entrant


def _variant(name: str, function: str) -> Entrant:
    cpsat = REGISTERED["cpsat"]
    return Entrant(name, f"{__name__}.variants:{function}", cpsat.engines, cpsat.distributions)


VARIANTS: Mapping[str, Entrant] = MappingProxyType(
    {
        entrant.name: entrant
        for entrant in (
            _variant("levels-prepared", "levels_prepared"),
            _variant("cuts-alone", "cuts_alone"),
            _variant("levels-alone", "levels_alone"),
            _variant("cpsat-defaults", "defaults_alone"),
        )
    }
)
"""`cpsat` with level variables for its lazy cuts; each of the two models alone; levels with CP-SAT's defaults."""
