"""The reasoners that can be chosen, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

REASONERS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "auto": "the fast engine, and for what it can't certify Konclude (if installed) or HermiT",
        "el": "the fast engine alone; what it can't certify is unknown",
        "hermit": "HermiT for everything",
        "konclude": "Konclude for everything; it must be installed",
    }
)
"""What each reasoner that `match` accepts does."""
