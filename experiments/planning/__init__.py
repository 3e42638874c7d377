"""The planner at scale, compared with variants that lack a part, and with the peers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cfgplan.comparing import REGISTERED, Entrant
from experiments.peers import LED
from experiments.planning.scale_suite import SCALE_SEEDS
from experiments.planning.scale_tables import PARTS
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
ONE_SEED = frozenset({*PARTS, *LED, "clingo-bb"})
MODELS, LARGE = frozenset({"levels-alone", "cpsat-defaults"}), 5_000


def takes_part(instance: Instance, entrant: Entrant) -> bool:
    """Return whether a planner runs on an instance.

    cpsat and its closest peers run on all seeds, every planner runs on the first seed.

    The others run on the first three seeds of most families. Variants without preprocessing are left out from `LARGE`
    transformations on, since they find no plan within the limit.
    """
    if instance.seed == SCALE_SEEDS[0] or entrant.name in ALL_SEEDS:
        return True
    if entrant.name in ONE_SEED or instance.seed not in SCALE_SEEDS[:3]:
        return False
    size = instance.parameters.get("transformations", 0)
    assert isinstance(size, int)
    return entrant.name not in MODELS or size < LARGE
