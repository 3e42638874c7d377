"""The exit codes of the command line."""

from collections.abc import Mapping
from enum import IntEnum


class Exit(IntEnum):
    """The exit codes, as a script reads them from `$?`."""

    OK = 0
    INVALID = 1
    """`check`: the running configuration violates a rule."""
    CHANGES = 2
    """`solve --detailed-exitcode`: solved, and the update changes something."""
    NO_PLAN = 10
    TOO_EXPENSIVE = 11
    UNMET = 12
    """`solve --best-effort`, `run`, `ctl`: done, but some targets are given up."""
    NOT_PROVEN = 20
    NO_ANSWER = 21
    BAD_INPUT = 30
    INTERNAL = 31
    INTERRUPTED = 130


OF_STATUS: Mapping[str, Exit] = {
    "optimal": Exit.OK,
    "feasible": Exit.NOT_PROVEN,
    "infeasible": Exit.NO_PLAN,
    "too expensive": Exit.TOO_EXPENSIVE,
    "unknown": Exit.NO_ANSWER,
}
"""By a plan's `Status`, which is a text: to import it takes longer than to show the help."""


def exit_of(status: str, *, is_exact: bool, is_unmet: bool) -> Exit:
    """The exit code of a plan that may give targets up: how it was proven comes first."""
    code = OF_STATUS[status]
    if code is Exit.OK and not is_exact:
        return Exit.NOT_PROVEN
    return Exit.UNMET if code is Exit.OK and is_unmet else code
