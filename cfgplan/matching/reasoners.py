"""The reasoners that can be chosen, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from cfgplan.matching.reference import Reference

REASONERS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "auto": "the fast engine, finite models for what it can't certify, and HermiT for what is open then",
        "el": "the fast engine and finite models alone; what they can't certify is unknown",
        "hermit": "HermiT for everything",
    }
)
"""What each reasoner that `match` accepts does."""


def reference_named(reasoner: str) -> tuple[str, Reference | None]:
    """The reference that a reasoner of REASONERS asks, with its name; None for one that asks none.

    Raises UnknownNameError.
    """
    from cfgplan.matching import hermit
    from cfgplan.matching.faults import UnknownNameError
    from cfgplan.matching.names import suggestion

    if reasoner not in REASONERS:
        known = ", ".join(REASONERS)
        raise UnknownNameError(
            f"there is no reasoner {reasoner!r}", suggestion(reasoner, REASONERS) or f"choose one of {known}"
        )
    if reasoner == "el":
        return "el", None
    return "hermit", hermit
