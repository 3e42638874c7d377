"""Kleene's three truth values, and the verdicts of a query."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, TypeAlias

Truth: TypeAlias = int
"""One of FALSE < UNKNOWN < TRUE: conjunction is the minimum, disjunction the maximum."""

FALSE: Final = 0
UNKNOWN: Final = 1
TRUE: Final = 2


def negation(truth: Truth) -> Truth:
    """Strong Kleene negation; the negation of UNKNOWN is UNKNOWN."""
    return 2 - truth


class Verdict(StrEnum):
    """The knowledge about a formula after the states so far. All verdicts but OPEN are final."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"
    """No further state can make it true or false, because a value that decides it was missing."""
    OPEN = "open"


VERDICT_OF: Final = {FALSE: Verdict.FALSE, UNKNOWN: Verdict.UNKNOWN, TRUE: Verdict.TRUE}
