"""The two ways to ground the model, behind one name."""

from enum import Enum


class Grounding(Enum):
    """How the model makes sure that every unit's data comes from sources."""

    CUTS = "lazy cuts"
    LEVELS = "level variables"
