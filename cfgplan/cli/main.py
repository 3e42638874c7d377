"""The entry point: one parser for all verbs, and every error turned into a message and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from cfgplan.cli import (
    check,
    compare,
    ctl,
    demo,
    explain,
    exporting,
    graph,
    importing,
    listen,
    match,
    query,
    run,
    sensitivity,
    solve,
)
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import CfgplanError, Fault, InputError

VERBS = (check, match, solve, explain, sensitivity, graph, run, ctl, listen, query, demo, compare, importing, exporting)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    options = _parser().parse_args(arguments)
    screen = Screen(json=getattr(options, "json", False))
    try:
        code = int(options.run(options, screen))
        sys.stdout.flush()
        return code
    except InputError as error:
        screen.faults(error.faults)
        return Exit.BAD_INPUT
    except CfgplanError as error:
        screen.faults([Fault(str(error), file=getattr(options, "env", None))])
        return Exit.BAD_INPUT
    except KeyboardInterrupt:
        screen.note("interrupted")
        return Exit.INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.OK
    except Exception as error:
        if os.environ.get("CFGPLAN_TRACEBACK"):
            raise
        screen.internal_error(error)
        return Exit.INTERNAL


class Parser(argparse.ArgumentParser):
    """A parser whose errors are bad input like any other."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(Exit.BAD_INPUT, f"error: {message}\n")


def _parser() -> Parser:
    from cfgplan import __version__

    parser = Parser(
        prog="cfgplan",
        description="Wire stream-processing components by meaning: the cheapest update of a running system, "
        "proven optimal.",
        epilog="Exit codes: 0 done, 1 check found a violation, 2 changes (--detailed-exitcode), 10 no plan, "
        "11 too expensive, 12 best effort with targets given up, "
        "20 stopped with an unproven plan, 21 stopped with none, 30 bad input, 31 internal error.",
    )
    parser.add_argument("--version", action="version", version=f"cfgplan {__version__}")
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for verb in VERBS:
        verb.add_to(verbs)
    return parser
