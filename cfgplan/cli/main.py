"""The entry point: one parser for all commands, and every error turned into a message and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shlex
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn, TextIO, cast

from cfgplan.cli.exits import Exit
from cfgplan.cli.interrupts import Ending, end_below_threads, ended_cleanly
from cfgplan.cli.screen import Screen
from cfgplan.errors import FULL_DISK, CfgplanError, Fault, InputError, did_you_mean, mend_of_write
from cfgplan.extras import install
from cfgplan.summary import some

VERBS: Mapping[str, str] = MappingProxyType(
    {
        "check": "check the running configuration of an environment file, and list what is wrong with it",
        "match": "show which outputs match which inputs and targets, or explain why one pair does or does not match",
        "suggest": "propose tags for ports by their names, message types and units, and show what each would match",
        "ontology": "write a first ontology, with the names that an environment's tags use as classes",
        "solve": "find the cheapest update that meets every target, and prove that none is cheaper",
        "explain": "say why no plan exists, or why the plan uses a unit and how much more a plan without it costs",
        "sensitivity": "show at which horizon, or which upkeep of a transformation, the optimal plan changes",
        "graph": "draw the configuration with the changes of the optimal update in colour",
        "run": "start the units that meet the targets, and replan when something fails or changes",
        "agent": "let a run on another computer start units on this one",
        "ctl": "show and change a live run",
        "page": "serve a web page that shows and changes a live run",
        "listen": "print the elements of a topic, or of a unit's output port, of a live run",
        "replay": "play the topics of a recording, alone or as inputs of an environment's units",
        "query": "tell whether a temporal formula over streams becomes true or false",
        "certificates": "make a certificate authority for a fleet, and a certificate for each of its hosts",
        "demo": "play the paper's case study: two robots track a ball, a unit fails, two estimates are fused",
        "compare": "run several planners on the same files, and check that their answers agree",
        "import": "make an environment file from ROS, MQTT, Thing Descriptions, the paper's XML or a WSC test set",
        "export": "write an environment file as YAML, the paper's XML or a ROS 2 launch file, or its JSON Schema",
        "init": "write a small example to start from: an environment with its ontology and unit code",
        "completion": "print a script that makes bash or zsh complete cfgplan's commands",
        "help": "show a page of the manual, or search all pages for words",
    }
)
"""The commands and their help. A command's module, or its function of `_OTHER_HOMES`, is imported only when it is
called.
"""
_OTHER_HOMES = {
    "certificates": "agent:add_certificates",
    "import": "exchange:add_import",
    "export": "exchange:add_export",
    "help": "manual:add_to",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code. Without `arguments`, those of the process, which ends with it."""
    code = Exit.INTERRUPTED.value
    try:
        with ended_cleanly(for_good=arguments is None) as ending:
            _stand_in_for_closed_streams()
            if arguments is None:
                sys.stderr = cast("TextIO", LossyStream(sys.stderr))
            code = _main(sys.argv[1:] if arguments is None else arguments, ending)
    except KeyboardInterrupt:  # before or after all there is to do
        pass
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else Exit.OK
        if arguments is not None:
            raise
    if arguments is None:
        end_below_threads(code)
    return code


def _main(arguments: Sequence[str], ending: Ending) -> int:
    screen, options, code = Screen(json="--json" in arguments, command=arguments), argparse.Namespace(), Exit.OK
    try:
        try:
            _say_every_character(screen)
            parser = parser_of(arguments)
            options = parser.parse_args(arguments)
            if not hasattr(options, "run"):
                parser.print_help(sys.stderr)
                return Exit.BAD_INPUT
            screen = Screen(json=getattr(options, "json", False), command=arguments)
            _say_every_character(screen)
            refuse_overwriting(options)
            code = Exit(options.run(options, screen))
        except (CfgplanError, ModuleNotFoundError) as error:
            from cfgplan.planning import OwnPlannerError, PlannerFaultError

            missing = error.name or "" if isinstance(error, ModuleNotFoundError) else ""
            if isinstance(error, PlannerFaultError) or missing.startswith("cfgplan"):
                raise
            if isinstance(error, OwnPlannerError) and os.environ.get("CFGPLAN_TRACEBACK"):
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
            message = f"the output can't be written: {error.strerror}"
            fault = Fault(message, file="standard output", mend=mend_of_write(error))
            Screen(json=False).faults([fault])
            return Exit.BAD_INPUT
        screen.internal_error(error)
        return Exit.INTERNAL


def _tell(error: CfgplanError | ModuleNotFoundError, screen: Screen, env: str | None) -> None:
    """Show a fault of the input, the command line or the installation."""
    from cfgplan_runtime.errors import RuntimeFaultError

    from cfgplan.planning import OwnPlannerError

    match error:
        case InputError(faults=faults):
            screen.faults(faults)
        case ModuleNotFoundError():
            screen.faults([Fault(f"the package {error.name} is not installed", mend=install(error.name or ""))])
        case OwnPlannerError(mend=mend):
            screen.faults([Fault(str(error), mend=mend)])
        case RuntimeFaultError():  # of the run's surroundings, not of its file
            screen.faults([Fault(str(error))])
        case _:
            screen.faults([Fault(str(error), file=env)])


def _interrupted(ending: Ending) -> Exit:
    """Report the interruption by plain `sys.stderr`, since it may have interrupted rich's import."""
    ending.over()
    with contextlib.suppress(OSError):
        sys.stderr.write("interrupted\n")
    return Exit.INTERRUPTED


def _stand_in_for_closed_streams() -> None:
    """Open /dev/null for every standard stream that is closed, so that no file or socket gets its number."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8")
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8")


def _say_every_character(screen: Screen) -> None:
    """Escape what the terminal's encoding can't show; write JSON as UTF-8."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(encoding="utf-8" if screen.json else None, errors="backslashreplace")


def _say_no_more() -> None:
    """Send all further output, the final flush included, to /dev/null."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Parser(argparse.ArgumentParser):
    """A parser that raises its errors as InputError. A command's parser refuses unknown arguments itself, so that its
    own help is named. A word that begins like a negative number is a value, so that the option's type refuses it.
    No value may be an empty word: commands would take it for one that was not given.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            option = unknown[0].partition("=")[0]
            mend = did_you_mean(option, self._option_string_actions) if option.startswith("-") else None
            self.error(f"unrecognized arguments: {' '.join(unknown)}", mend or _mend_of_span(args, option))
        return known, unknown

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        # A command's own arguments are read by its parser.
        if "" in (arg_strings[:1] if action.nargs == argparse.PARSER else arg_strings):
            raise argparse.ArgumentError(action, _EMPTY)
        return super()._get_values(action, arg_strings)

    def error(self, message: str, mend: str | None = None) -> NoReturn:
        if joined := re.fullmatch(r"argument (-\w)/\S*: ignored explicit argument '(.*)'", message):
            word = f"{joined[1]}{joined[2]}"
            message, mend = f"unrecognized arguments: {word}", did_you_mean(f"-{word}", self._option_string_actions)
        mend = mend or _mend_of_arguments(message)
        if (many := _CHOICE.search(message)) is not None and many[2].count(",") >= _MOST_CHOICES:
            message = message[: many.start(2)].removesuffix(" (choose from ")
        more = f"{self.prog} --help tells more"
        raise InputError.of(message, mend=f"{mend} {more}" if mend else more)


def _mend_of_span(words: Sequence[str], unit: str) -> str | None:
    """The mend of a span of time that was written as two words, such as `5 secs`; None if it is none."""
    found = re.fullmatch(r"(s|m|h)(ecs?|econds?|ins?|inutes?|ours?)?", unit)
    number = words[words.index(unit) - 1] if unit in words[1:] else ""
    if found is None or not re.fullmatch(r"[\d.]+", number):
        return None
    return f"write `{number}{found[1]}` as one word;"


def _mend_of_arguments(message: str) -> str | None:
    """Return the mend for an error of argparse; None if its message has it, or none is known."""
    _, is_missing, names = message.partition("the following arguments are required: ")
    if is_missing:
        return f"write {names} here;"
    if message.endswith("expected one argument"):
        return "write a value after it;"
    if message.endswith(_EMPTY):
        return "write a value (a shell's variable that is not set gives an empty word);"
    if message.startswith("unrecognized arguments: "):
        return "leave it out, or put quotes around a value with a space in it;"
    found = _CHOICE.search(message)
    if found is None:
        return None
    choices = [each.strip("' ") for each in found[2].split(",")]
    if (meant := _MEANT.get(found[1])) in choices:
        return f"did you mean `{meant}`?"
    return did_you_mean(found[1], choices, f"write one of {some(choices, _MOST_CHOICES)};")


class _Version(argparse.Action):
    """Prints versions and exits."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version
        from platform import python_version

        from cfgplan import __version__

        solver, reasoner = version("ortools"), version("owlready2")
        python = f"Python {python_version()}"
        print(f"cfgplan {__version__} (OR-Tools {solver}, HermiT of owlready2 {reasoner}, {python})")
        parser.exit()


def parser_of(arguments: Sequence[str]) -> Parser:
    """The parser of a command line: only the command that it names knows its options. Raises InputError."""
    asked = next((each for each in arguments if not each.startswith("-")), None)
    if asked is None:
        return parser_with(())
    if not asked:
        raise InputError.of(f"argument COMMAND: {_EMPTY}", mend=_mend_of_arguments(_EMPTY))
    if asked not in VERBS:
        raise InputError.of(f"there is no command `{asked}`", mend=_mend_of_command(asked))
    return parser_with((asked,), (asked,) if asked == arguments[0] else VERBS)


def _mend_of_command(asked: str) -> str | None:
    from cfgplan.cli.ctl import NAMES
    from cfgplan.formats.files import SUFFIXES

    if Path(asked).suffix in SUFFIXES:
        return f"write a command before the file, such as `cfgplan solve {shlex.quote(asked)}`"
    if (meant := next((verb for verb, words in _SYNONYMS.items() if asked in words), None)) is not None:
        live = f", or `cfgplan ctl {asked}` for a live run" if asked in NAMES else ""
        return f"write `cfgplan {meant}`{live}"
    if (live := _MEANT.get(asked, asked)) in NAMES:
        return f"write `cfgplan ctl {live}`: it is a command for a live run"
    return did_you_mean(asked, VERBS, "cfgplan --help lists the commands")


def parser_with(filled: Collection[str], verbs: Iterable[str] = VERBS) -> Parser:
    """Return a parser of some commands; only those in `filled` have their options, since these need their modules."""
    width = _columns() - 2
    parser = Parser(
        prog="cfgplan",
        formatter_class=partial(argparse.HelpFormatter, width=width),
        description="Wire stream-processing components by meaning: the cheapest update of a running system, "
        "proven optimal.",
        epilog="Exit codes: 0 done, 1 check found something wrong, 2 the plan changes something (--detailed-exitcode), "
        "10 no plan exists, 11 every plan costs more than allowed, 12 some targets are given up, "
        "20 the plan is not proven optimal, 21 time ran out without a plan, 30 bad input, 31 internal error.",
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show the versions of cfgplan, its solver, its reasoner and Python"
    )
    commands = parser.add_subparsers(metavar="COMMAND", prog=parser.prog)
    for name in verbs:
        summary = VERBS[name]
        sentence = f"{summary[0].upper()}{summary[1:]}."
        verb = commands.add_parser(
            name,
            help=summary,
            description=sentence,
            formatter_class=partial(argparse.RawDescriptionHelpFormatter, width=width),
        )
        if name in filled:
            module, _, add_to = _OTHER_HOMES.get(name, f"{name}:add_to").partition(":")
            getattr(import_module(f"cfgplan.cli.{module}"), add_to)(verb)
    return parser


def _columns() -> int:
    """The width of the terminal; argparse would import the modules that compress files to find it."""
    try:
        return int(os.environ.get("COLUMNS", 0)) or os.get_terminal_size().columns or 80
    except (ValueError, OSError):
        return 80


class LossyStream:
    """A stream that becomes /dev/null once a write fails: its reader has gone, or its disk is full."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _try(self, action: Callable[[], object]) -> None:
        try:
            action()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


_EMPTY = "it is an empty word"
_MOST_CHOICES = 8
_CHOICE = re.compile(r"invalid choice: '(.*)' \(choose from (.*)\)")
_MEANT = {"explain": "why", "ps": "state", "quit": "stop", "status": "state"}
"""Words of other programs for commands of `cfgplan ctl`."""
_SYNONYMS = MappingProxyType(
    {
        "solve": ("plan", "optimise", "optimize", "compose"),
        "check": ("validate", "verify", "lint", "test", "doctor"),
        "graph": ("draw", "show", "picture", "dot", "visualise", "visualize"),
        "run": ("start", "up", "launch", "execute", "exec"),
        "listen": ("echo", "subscribe", "sub"),
        "replay": ("play", "bag"),
        "init": ("new", "create", "template", "templates", "example"),
        "help": ("manual", "man", "doc", "docs"),
        "export": ("convert", "dump", "schema"),
        "compare": ("bench", "benchmark"),
    }
)
"""Words of other programs for commands."""
_READ = ("env", "envs", "also", "path", "plan", "guesses", "features")
_WRITTEN = ("out", "plot", "log", "record")


def refuse_overwriting(options: argparse.Namespace) -> None:
    """Raise InputError if a file to write is one of those to read."""
    read = list(_files(options, _READ))
    for written in _files(options, _WRITTEN):
        if any(_is_same(written, each) for each in read):
            raise InputError.of(
                "this file is read, so it can't be written too", file=written, mend="name another file to write"
            )


def _files(options: argparse.Namespace, names: tuple[str, ...]) -> Iterator[str]:
    for name in names:
        value = getattr(options, name, None)
        yield from [value] if isinstance(value, str) else value or ()


def _is_same(one: str, other: str) -> bool:
    try:
        return Path(one).is_file() and Path(one).samefile(other)
    except OSError:
        return False
