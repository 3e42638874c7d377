"""The entry point: one parser for all verbs, and every error turned into a message and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn, TextIO, cast

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
from cfgplan.cli.chatter import Chatter
from cfgplan.cli.exits import Exit
from cfgplan.cli.interrupts import Ending, ended_cleanly
from cfgplan.cli.overwriting import refuse_overwriting
from cfgplan.cli.screen import FULL_DISK, Screen
from cfgplan.errors import CfgplanError, Fault, InputError
from cfgplan.planning import PlannerFaultError

_EXTRA_OF = {"cv2": "demo", "jinja2": "demo", "matplotlib": "plots", "prometheus_client": "metrics"}
VERBS = (check, match, solve, explain, sensitivity, graph, run, ctl, listen, query, demo, compare, importing, exporting)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    try:
        with ended_cleanly(for_good=arguments is None) as ending:
            _stand_in_for_closed_streams()
            if arguments is None:
                sys.stderr = cast("TextIO", Chatter(sys.stderr))
            return _main(sys.argv[1:] if arguments is None else arguments, ending)
    except KeyboardInterrupt:  # before or after all there is to do
        return Exit.INTERRUPTED


def _main(arguments: Sequence[str], ending: Ending) -> int:
    screen, options, code = Screen(json="--json" in arguments), argparse.Namespace(), Exit.OK
    try:
        try:
            _say_every_character(screen)
            parser = _parser()
            options = parser.parse_args(arguments)
            if not hasattr(options, "run"):
                parser.print_help(sys.stderr)
                return Exit.BAD_INPUT
            screen = Screen(json=getattr(options, "json", False))
            _say_every_character(screen)
            refuse_overwriting(options)
            code = Exit(options.run(options, screen))
        except (CfgplanError, ModuleNotFoundError) as error:
            missing = error.name or "" if isinstance(error, ModuleNotFoundError) else ""
            if isinstance(error, PlannerFaultError) or missing.startswith("cfgplan"):
                raise
            code = Exit.BAD_INPUT
            _tell(error, screen, getattr(options, "env", None))
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return _interrupted(ending)
    except BrokenPipeError:
        _say_no_more()
        return code
    except Exception as error:
        if ending.interrupted:  # the libraries make other errors of a Ctrl-C while they are imported
            return _interrupted(ending)
        if os.environ.get("CFGPLAN_TRACEBACK"):
            raise
        if isinstance(error, OSError) and error.errno in FULL_DISK and not error.filename:
            _say_no_more()
            fault = Fault(f"what was found can't be written: {error.strerror}", file="standard output")
            Screen(json=False).faults([fault])
            return Exit.BAD_INPUT
        screen.internal_error(error)
        return Exit.INTERNAL


def _tell(error: CfgplanError | ModuleNotFoundError, screen: Screen, env: str | None) -> None:
    """Show what is wrong with the input, the command line or the installation."""
    match error:
        case InputError(faults=faults):
            if isinstance(error, _UsageError) and not screen.json:
                screen.note(error.usage, style="")
            screen.faults(faults)
        case ModuleNotFoundError():
            screen.faults([Fault(f"the package {error.name} is not installed", mend=_install(error.name or ""))])
        case _:
            screen.faults([Fault(str(error), file=env)])


def _interrupted(ending: Ending) -> Exit:
    """Say so by nothing that may have been interrupted itself, while it was imported."""
    ending.over()
    with contextlib.suppress(OSError):
        sys.stderr.write("interrupted\n")
    return Exit.INTERRUPTED


def _stand_in_for_closed_streams() -> None:
    """A command may be started with stdout or stderr closed; no file or socket must get their numbers."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8")
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8")


def _say_every_character(screen: Screen) -> None:
    """What a terminal without Unicode can't show is escaped; JSON is UTF-8 everywhere."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(encoding="utf-8" if screen.json else None, errors="backslashreplace")


def _say_no_more() -> None:
    """Nothing more can be written: not even what is flushed at the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _install(package: str) -> str:
    extra = _EXTRA_OF.get(package.partition(".")[0])
    return f"pip install 'cfgplan[{extra}]'" if extra else "install cfgplan again, with all that it needs"


class _UsageError(InputError):
    """A command line that can't be parsed, with the usage of its verb."""

    def __init__(self, message: str, parser: argparse.ArgumentParser) -> None:
        super().__init__([Fault(message, mend=f"{parser.prog} --help tells more")])
        self.usage = parser.format_usage().rstrip()


class Parser(argparse.ArgumentParser):
    """A parser whose errors are bad input like any other; a verb's parser itself refuses what it does not know."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return known, unknown

    def error(self, message: str) -> NoReturn:
        raise _UsageError(message, self)


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
    verbs = parser.add_subparsers(metavar="VERB")
    for verb in VERBS:
        verb.add_to(verbs)
    return parser
