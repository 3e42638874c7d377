"""Planners side by side on families of instances: generators, runner, result rows, tables and plots."""

from cfgplan.comparing.entrants import REGISTERED, Entrant, entrant
from cfgplan.comparing.instances import Instance, generated, given, named
from cfgplan.comparing.rows import Row, RunFailure, read_rows
from cfgplan.comparing.runner import Advance, Limits, require, run, run_one

__all__ = [
    "REGISTERED",
    "Advance",
    "Entrant",
    "Instance",
    "Limits",
    "Row",
    "RunFailure",
    "entrant",
    "generated",
    "given",
    "named",
    "read_rows",
    "require",
    "run",
    "run_one",
]
