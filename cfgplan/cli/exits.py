"""The exit codes of the command line."""

from enum import IntEnum

from cfgplan.planning import Status


class Exit(IntEnum):
    """What a script learns from `$?`."""

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


OF_STATUS = {
    Status.OPTIMAL: Exit.OK,
    Status.FEASIBLE: Exit.NOT_PROVEN,
    Status.INFEASIBLE: Exit.NO_PLAN,
    Status.TOO_EXPENSIVE: Exit.TOO_EXPENSIVE,
    Status.UNKNOWN: Exit.NO_ANSWER,
}
