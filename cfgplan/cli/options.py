"""Options that several commands share, and the loading of environments by these options."""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import socket
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cfgplan.amounts import MICROSECONDS
from cfgplan.canonical import normal
from cfgplan.cli.screen import Screen, ShownWork, decided_by
from cfgplan.errors import Fault, InputError, InvalidValueError
from cfgplan.extras import is_there, needed
from cfgplan.formats.places import Place
from cfgplan.onward import grouped

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cfgplan import api
    from cfgplan.formats.environment_file import EnvironmentFile
    from cfgplan.matching import Matches
    from cfgplan.planning import Failures, Problem, Progress


_LARGEST_NUMBER = 9_007_199_254
"""The largest number: as seconds it is the largest cost, and within the range of clocks."""


def add_environment(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("env", metavar="ENV", help="environment file in YAML or JSON, or in the paper's XML")


def add_page(parser: argparse.ArgumentParser, about: str) -> None:
    """`--page`: serve a page while the command works; None if it is not asked for."""
    means = f"serve a web page about {about} on port N of 127.0.0.1 (default: any free port)"
    parser.add_argument("--page", type=port, nargs="?", const=0, metavar="N", help=means)


def check_port(option: str, number: int | None, who: str) -> None:
    """Raise InputError if a port of 127.0.0.1, given by an option, is in use; 0 and None take any that is free."""
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind(("127.0.0.1", number or 0))
            tried.listen()  # two may be bound to an address while neither listens
        except OSError as error:
            told = f"{option} {number}: {who} can't be served there: {error.strerror}"
            raise InputError.of(told, mend="name another port; 0 takes any that is free") from None


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """`--allow-code`: the page may add unit code."""
    means = (
        "allow the page to add transformations with a `source`: whoever has the page's token can then run code as you"
    )
    parser.add_argument("--allow-code", action="store_true", help=means)


def needed_for_pages() -> None:
    """Raise InputError if what pages need is not installed."""
    needed("pages", "starlette", "uvicorn")


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON for programs instead of text")


def add_matching(parser: argparse.ArgumentParser) -> None:
    """Options of every command that matches tags."""
    from cfgplan.api import REASONER_NAMES

    parser.add_argument(
        "--reasoner",
        choices=REASONER_NAMES,
        default="auto",
        help="reasoner that decides which tags match; el: a fast one that may leave pairs open; hermit: HermiT, "
        "which is slow and complete; auto: HermiT for what the fast one leaves open (default: auto)",
    )
    parser.add_argument(
        "--reasoner-timeout",
        type=positive,
        default=60.0,
        metavar="S",
        help="seconds for HermiT; pairs of tags that it has not decided by then stay undecided (default: 60)",
    )
    parser.add_argument(
        "--no-cache",
        action="store_true",
        help="do not read or write the cache of ontologies and decided pairs of tags",
    )


def add_planning(parser: argparse.ArgumentParser, what_if: str | None = None) -> None:
    """Add the options of every command that plans; `what_if` is the `restriction` of `add_what_if`."""
    from cfgplan.api import PLANNER_NAMES

    names = f"the planner: {', '.join(PLANNER_NAMES)}, or your own as module:function (default: cpsat)"
    parser.add_argument("--planner", type=planner, default="cpsat", metavar="NAME", help=names)
    parser.add_argument(
        "--horizon",
        type=horizon,
        metavar="TIME",
        help="how far ahead to plan: seconds, or 10m, 1h (default: the file's)",
    )
    parser.add_argument(
        "--max-cost", type=cost, metavar="S", help="the most CPU seconds that a plan may cost (default: the file's)"
    )
    parser.add_argument(
        "--timeout",
        type=not_negative,
        metavar="S",
        help="stop planning after S seconds, once there is a plan; 0: stop at the first plan (default: no limit)",
    )
    add_what_if(parser, what_if)


def add_what_if(parser: argparse.ArgumentParser, restriction: str | None = None) -> None:
    """Add the options that change a command's environment. `restriction` says when they are allowed, if not always."""
    supposing = parser.add_argument_group("what if", restriction)
    gone = "plan without this transformation, running unit or target; may be repeated"
    also = "plan with the transformations and targets of this file too; may be repeated"
    others = (
        "plan with another value; KEY is horizon, max_cost, facts.NAME, facts.HOST.NAME, T.labor, T.upkeep, T.pinned "
        "or T.required for a transformation T, or T.priority for a target T; may be repeated"
    )
    observed = "replace declared facts and qualities by those in FILE, written by `cfgplan ctl observed --out FILE`"
    add_several(supposing, "--without", "NAME", gone, kind=normal)
    add_several(supposing, "--with", "FILE", also, dest="also")
    add_several(supposing, "--set", "KEY=VALUE", others, kind=setting, dest="settings")
    supposing.add_argument("--observed", metavar="FILE", help=observed)


def refuse_beside(other: str, given: Mapping[str, object]) -> None:
    """Raise InputError for each option that is `given` (its value by its name) but has no effect beside `other`."""
    if idle := [name for name, value in given.items() if value]:
        raise InputError.of(
            f"{' and '.join(idle)} would have no effect with {other}", mend="leave out one or the other"
        )


def asks_what_if(options: argparse.Namespace) -> bool:
    """Whether an option of `add_what_if` is used."""
    return bool(options.without or options.also or options.settings or options.observed)


def problem_words(options: argparse.Namespace) -> str:
    """Return the file and the options that change the problem, quoted for a shell; messages advise commands with it."""
    words = [options.env]
    words += (f"--without={name}" for name in options.without)
    words += (f"--with={file}" for file in options.also)
    words += (f"--set={key}={value}" for key, value in options.settings)
    max_cost_us = getattr(options, "max_cost", None)
    values = {
        "observed": options.observed,
        "survive": getattr(options, "survive", None),
        "horizon": getattr(options, "horizon", None),
        "max-cost": None if max_cost_us is None else f"{Decimal(max_cost_us) / MICROSECONDS:f}",
    }
    words += (f"--{name}={value}" for name, value in values.items() if value is not None)
    return " ".join(map(shlex.quote, words))


def add_several(
    parser: argparse._ActionsContainer,
    name: str,
    metavar: str,
    means: str,
    *,
    kind: Callable[[str], Any] = str,
    dest: str | None = None,
) -> None:
    """An option that may be repeated; its values are a list, empty without any."""
    dest = dest or name.lstrip("-").replace("-", "_")
    parser.add_argument(name, action="append", default=[], type=kind, dest=dest, metavar=metavar, help=means)


def add_time(parser: argparse.ArgumentParser, name: str, default_s: float, means: str) -> None:
    """An option whose value is a span of time, in seconds."""
    parser.add_argument(name, type=duration, default=default_s, metavar="TIME", help=means)


def add_run(parser: argparse.ArgumentParser, means: str) -> None:
    """Add `--name`, also `-n` and `--run`: the name or id of a live run; None for the only one."""
    parser.add_argument("--name", "-n", "--run", dest="run_id", metavar="NAME", help=means)


def add_span(
    parser: argparse._ActionsContainer, means: str = "stop after this time, such as 30s, 5m or 1h (default: no limit)"
) -> None:
    """Add `--for`: how long a command runs; None for no limit."""
    parser.add_argument("--for", dest="span", type=duration, metavar="TIME", help=means)


def add_survive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--survive",
        choices=("0", "1", "units", "hosts"),
        help="keep every target met if any one unit or host fails; 1: hosts if the file has any, else units; "
        "0: neither (default: the file's)",
    )


def load(options: argparse.Namespace, screen: Screen, env: str | None = None) -> api.World:
    """Return the world of the file `env` (by default the file of the options), with the changes of the options."""
    from cfgplan import api

    with screen.phase("load"):
        use_cache = not getattr(options, "no_cache", False)
        world = api.load(options.env if env is None else env, also=getattr(options, "also", ()), use_cache=use_cache)
        if not hasattr(options, "also") or not asks_what_if(options):
            return world
        return api.what_if(world, without=options.without, settings=dict(options.settings), observed=options.observed)


def matches(options: argparse.Namespace, screen: Screen, world: api.World, most: int | None = None) -> Matches:
    """Return the similarity of a world's tags as far as known; with more than `most` open pairs none is asked about
    yet.
    """
    from cfgplan import api

    with screen.phase("match"):
        found = api.matches(
            world,
            reasoner=options.reasoner,
            time_limit_s=options.reasoner_timeout,
            use_cache=not options.no_cache,
            most=most,
        )
    for warning in found.matching.warnings:
        screen.warn(warning)
    return found


def problem(options: argparse.Namespace, screen: Screen, world: api.World, known: Matches | None = None) -> Problem:
    """The planning problem of a world, with the horizon and the largest cost of the options."""
    from cfgplan import api

    found = known or matches(options, screen, world)
    return api.problem(
        world,
        found.similarity,
        horizon_s=getattr(options, "horizon", None),
        max_cost_us=getattr(options, "max_cost", None),
        survive=_failures(getattr(options, "survive", None), world),
    )


@dataclass(frozen=True)
class Task:
    """The task of a command that plans: its world, problem, planner and reasoner."""

    world: api.World
    problem: Problem
    matches: Matches
    planning: Mapping[str, Any]
    """The planner, its time limit and the decider of open pairs, as the API takes them."""
    reasoning: Mapping[str, Any]
    """The reasoner and its time limit, likewise."""

    @contextmanager
    def planned(self, screen: Screen) -> Iterator[ShownWork]:
        """The phase of planning; its progress shows how many pairs of tags each reasoner decided."""
        with screen.phase("plan") as work:
            work.knows = lambda: decided_by(self.matches.counts)
            yield work


def task(options: argparse.Namespace, screen: Screen, world: api.World | None = None) -> Task:
    """Load the world that the options name, if none is given, and match it as far as planning needs to start."""
    from cfgplan.api import FEW_PAIRS

    world = world or load(options, screen)
    found = matches(options, screen, world, FEW_PAIRS)
    planning = {"planner": options.planner, "time_limit_s": options.timeout, "decider": found}
    reasoning = {"reasoner": options.reasoner, "reasoner_limit_s": options.reasoner_timeout}
    return Task(world, problem(options, screen, world, found), found, planning, reasoning)


def _failures(asked: str | None, world: api.World) -> Failures | Literal[0] | None:
    from cfgplan.planning import Failures

    if asked is None or asked == "0":
        return None if asked is None else 0
    if asked == "1":
        return Failures.HOSTS if world.environment.hosts else Failures.UNITS
    return Failures(asked)


def planner(name: str) -> str:
    """Return the name of an existing planner; a user's own may be in the current folder."""
    from cfgplan.planners import planner_of

    if ":" in name and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    planner_of(name)
    return name


def setting(text: str, form: str = "KEY=VALUE", example: str = "horizon=60") -> tuple[str, str]:
    """`KEY=VALUE`, where the key may hold `=` itself."""
    key, equals, value = normal(text).rpartition("=")
    if not (key and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not {form}: write one, such as {example}")
    return key.strip(), value.strip()


def run_name(text: str) -> str:
    """The name of a run: letters, digits, `.`, `-` and `_`, and no id."""
    if not re.fullmatch(r"[\w.-]{1,40}", text):
        raise argparse.ArgumentTypeError(f"{text!r} can't name a run: write 1 to 40 letters, digits, ., - or _")
    if re.fullmatch(r"[0-9a-f]{8}", text):
        raise argparse.ArgumentTypeError(f"{text!r} looks like a run's id: choose another name, such as robot")
    return text


def count(text: str) -> int:
    value = _decimal(text, "a whole number of at least 1, such as 3", guesses=False)
    if value != value.to_integral_value() or value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1: write one, such as 3")
    return int(value)


def horizon(text: str) -> int:
    """Whole seconds of `60`, `10m` or `1h`."""
    from cfgplan.costs import horizon_s

    try:
        return horizon_s(text)
    except InvalidValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port: write a number from 0 to 65535")
    return int(text)


def not_negative(text: str) -> float:
    value = _decimal(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is negative: write a number of 0 or more")
    return float(value)


def positive(text: str) -> float:
    value = _decimal(text, "a number above 0, such as 10")
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number: write one above 0")
    return float(value)


def cost(text: str) -> int:
    from cfgplan.costs import microseconds

    try:
        return microseconds(_decimal(text))
    except InvalidValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _decimal(text: str, allowed: str = "a number of 0 or more, such as 10", *, guesses: bool = True) -> Decimal:
    """Return the number of a text. Errors name the `allowed` numbers; if it `guesses`, the number that was meant."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        from cfgplan.costs import guessed_s, is_negative

        meant = guessed_s(text) if guesses else None
        such = allowed if meant is None else f"a plain one, {meant.normalize():f}"
        what = "negative" if is_negative(text) else "not a number"
        raise argparse.ArgumentTypeError(f"{text!r} is {what}: write {such}") from None
    if not value.is_finite():
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number: write {allowed}")
    return _not_too_large(text, value)


def _not_too_large(text: str, value: Decimal) -> Decimal:
    """Return the value of a text if no clock or cost overflows by it."""
    if value > _LARGEST_NUMBER:
        raise argparse.ArgumentTypeError(f"{text!r} is too large: the limit is {_LARGEST_NUMBER}")
    return value


def progress_report(screen: Screen) -> Callable[[Progress], None]:
    """A reporter that says each better cost or bound as a JSON line on stderr."""

    def report(progress: Progress) -> None:
        screen.note(json.dumps(asdict(progress)), style="")

    return report


def add_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=out_file, metavar="FILE", help="file to write (default: standard output)")


def out_file(text: str) -> str:
    """The name of a file to write, checked before any work is done. Raises ArgumentTypeError."""
    path = Path(text)
    try:
        if path.is_dir():
            raise argparse.ArgumentTypeError(f"{text!r} is a folder: name a file")
        if not path.parent.is_dir():
            raise argparse.ArgumentTypeError(
                f"{text!r} can't be written: there is no folder {str(path.parent)!r}; make it"
            )
        if not path.exists() and not os.access(path.parent, os.W_OK):
            raise argparse.ArgumentTypeError(f"{text!r} can't be written: the folder is read-only")
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r} can't be written: {error.strerror}") from None
    return text


def put(text: str, out: str | None, screen: Screen) -> None:
    """Write text to the file that `--out` names, or to stdout."""
    from cfgplan import api

    if out is None:
        screen.write_bytes(text.encode())
    else:
        api.write_file(Path(out), text.encode())
        screen.note(f"Wrote {out}.")


_PLOTS = {".svg": {"Date": None}, ".png": {"Software": None}, ".pdf": {"CreationDate": None}}
"""The endings of plots, and the metadata removed from each, so that the same plot gives the same bytes."""


def plot_file(text: str) -> str:
    """The name of a plot to write, checked before any work is done. Raises ArgumentTypeError."""
    if Path(out_file(text)).suffix.lower() not in _PLOTS:
        raise argparse.ArgumentTypeError(f"{text!r} does not end as a plot does: end it in one of {', '.join(_PLOTS)}")
    needed("plots", "matplotlib")
    return text


def write_plot(file: str, size: tuple[float, float], draw: Callable[[Axes], None], screen: Screen) -> None:
    """Write a plot of `size` in inches; `draw` fills its axes."""
    write_plots(file, size, 1, lambda rows: draw(rows[0]), screen)


def write_plots(
    file: str, size: tuple[float, float], count: int, draw: Callable[[Sequence[Axes]], None], screen: Screen
) -> None:
    """Write `count` plots below each other, together of `size` in inches; `draw` fills their axes."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from cfgplan import api

    ending, content = Path(file).suffix.lower(), BytesIO()
    with rc_context({"svg.hashsalt": "cfgplan", "text.parse_math": False}):
        figure = Figure(figsize=size, layout="constrained")
        draw(list(figure.subplots(count, squeeze=False)[:, 0]))
        figure.savefig(content, format=ending[1:], metadata=_PLOTS[ending])
    api.write_file(Path(file), content.getvalue())
    screen.note(f"Wrote {file}.")


def duration(text: str) -> float:
    """Seconds of `30s`, `1.5m`, `200ms`, `2h` or plain `30`."""
    from cfgplan.costs import guessed_s, is_negative, span_s

    seconds = Decimal(text) if re.fullmatch(r"\d+(\.\d+)?", text) else span_s(text)
    if seconds is None and is_negative(text):
        raise argparse.ArgumentTypeError(f"{text!r} is negative: write 0 or more, such as 30s, 5m or 1h")
    if seconds is None:
        meant = None if "%" in text else guessed_s(text)
        such = "30s, 5m or 1h" if meant is None else f"{meant.normalize():f}s"
        raise argparse.ArgumentTypeError(f"{text!r} is not a span of time: write {such}")
    return float(_not_too_large(text, seconds))


def field_faults(world: api.World) -> Iterator[Fault]:
    """The fields of `observe` that messages of ROS do not have, each with its place in the environment file."""
    if world.file is None or not is_there("rosbags"):
        return
    from cfgplan_runtime.ros2.observed_fields import field_faults as faults_of

    path = world.file.path
    for one in faults_of(world.environment, path if path.is_dir() else path.parent):
        label, port, attribute, _ = one.statement
        at = world.file.place(transformation=label, port=port) or Place(str(path), 1, 1)
        message = f"{label}/{port} can't report its {attribute} in field `{one.field}`: {one.cause}"
        yield Fault(message, at.file, at.line, at.column, mend="correct `observe`")


def code_faults(world: api.World, labels: Iterable[str]) -> Iterator[Fault]:
    """The faults of transformations' code, each with its place in the code, or else in the environment file."""
    if world.file is None or world.environment.hosts:  # the hosts have their own code
        return
    from cfgplan_runtime.children.source_faults import source_fault

    folder = world.file.folder
    library = world.environment.transformation
    for fault, of_fault in grouped((source_fault(library[label], folder), label) for label in labels).items():
        if fault is not None:
            yield placed_fault(world.file, fault, of_fault, partial(unstartable, of_fault))


def unstartable(labels: Sequence[str], why: str) -> str:
    """Return the message of a fault for which transformations can't be started."""
    return f"{', '.join(labels)} can't be started: {why}"


def placed_fault(env: EnvironmentFile, fault: Fault, labels: Sequence[str], told: Callable[[str], str]) -> Fault:
    """Return a fault of transformations' code with its place in the code, or else in the environment file.

    `told` makes the message of a cause.
    """
    place = env.place(transformation=labels[0], key="source")
    if fault.file is not None and fault.line is not None:
        by = f", as {place.file}:{place.line} names it" if place and len(labels) == 1 else ""
        return replace(fault, file=str(env.folder / fault.file), message=f"{told(fault.message)}{by}")
    at = place or Place(str(env.path), 1, 1)
    why = f"{fault.file}: {fault.message}" if fault.file else fault.message
    return Fault(told(why), at.file, at.line, at.column, mend=fault.mend)
