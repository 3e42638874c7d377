"""`cfgplan query`: answer a question about streams, as soon as the answer is certain."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.amounts import exact_clock_time, span
from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.agent import add_links, reached
from cfgplan.cli.exits import Exit
from cfgplan.cli.interrupts import Interrupts
from cfgplan.cli.screen import Screen, counted
from cfgplan.errors import Fault, InputError, InvalidValueError

if TYPE_CHECKING:
    from cfgplan_runtime.reasoning.features import DeclaredFeatures
    from cfgplan_runtime.reasoning.monitor import Waiting
    from cfgplan_runtime.reasoning.queries import Answer, Progressed, Query, QueryReport, Subscriptions

    from cfgplan.api import World

_SET_UP_S = 60.0
"""The longest wait for the first review."""
_ASKS_S = 0.1
"""The interval at which unmet targets are looked at again."""
_EXITS = {"true": Exit.OK, "false": Exit.INVALID, "open": Exit.NOT_PROVEN, "unknown": Exit.NO_ANSWER}


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        '  cfgplan query env.yaml "always (not in(ball, opponent_half) -> eventually[0,10s] in(ball, opponent_half))"\n'
        "  cfgplan query env.yaml 'eventually[0,1min] ball.x > 3' --feature ball='Position and hasSource some Ball'\n\n"
        "Exit codes: 0 true, 1 false, 10 a feature has no stream, 20 still open, 21 values were missing, 30 bad input."
    )
    parser.add_argument(
        "env",
        metavar="ENV",
        nargs="?",
        help="environment file whose units to start; without ENV, or with --run or --connect, a live run answers",
    )
    parser.add_argument(
        "formula",
        type=normal,
        metavar="FORMULA",
        help="comparisons, in(point, region) and RCC8 relations, joined by not, and, or, ->, always[a,b], "
        "eventually[a,b] and until[a,b]; see `cfgplan help queries`",
    )
    parser.add_argument(
        "--features", metavar="FILE", help="file that declares features and regions (default: features.yaml beside ENV)"
    )
    named = "declare a feature: the stream that matches TAG; may be repeated"
    shared.add_several(parser, "--feature", "NAME=TAG", named, kind=normal)
    region = "declare a region, such as goal='{circle: [4, 0], radius: 1}'; may be repeated"
    shared.add_several(parser, "--region", "NAME=REGION", region, kind=normal)
    parser.add_argument(
        "--run", dest="run_id", metavar="ID", help="ask the run of this id or name; start no units here"
    )
    shared.add_span(parser)
    parser.add_argument(
        "--rate",
        type=shared.positive,
        metavar="HZ",
        help="evaluate HZ states per second (default: one state for each sample)",
    )
    shared.add_time(parser, "--delay", 0.2, "how long a state waits for samples that arrive late (default: 200ms)")
    shared.add_time(parser, "--hold", 1.0, "age at which a feature's last value counts as missing (default: 1s)")
    shared.add_time(parser, "--tolerance", 0.0, "put samples within this time into one state (default: 0)")
    shared.add_time(parser, "--wait", 0.0, "how long to wait for features that have no stream yet (default: 0)")
    add_links(parser)
    parser.add_argument("--verbose", action="store_true", help="show the events of the units in yellow, not dimmed")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.reasoning.queries import UnmetTargetsError

    from cfgplan.unmet import shared_reasons

    try:
        return _run(options, screen)
    except UnmetTargetsError as error:
        told = shared_reasons(error.reasons)
        screen.faults([Fault(one.text, mend="--wait TIME waits for it") for one in told])
        return Exit.NO_PLAN


def _run(options: argparse.Namespace, screen: Screen) -> Exit:
    """Answer the query. Raises UnmetTargetsError."""
    from cfgplan_runtime.reasoning import features

    if options.env is None and os.path.isfile(options.formula):  # noqa: PTH113 - a long formula is no path
        raise InputError.of(
            "the formula is missing: only a file is given", file=options.formula, mend="write FORMULA after ENV"
        )
    if options.env is None or options.run_id is not None or options.connect:
        from cfgplan_runtime.operating.control_client import connect
        from cfgplan_runtime.reasoning.managed import RemoteSubscriptions

        with Interrupts(), reached(options) as fleet, connect(options.run_id, fleet) as control:
            remote = RemoteSubscriptions(control) if fleet is None else RemoteSubscriptions(control, fleet.subscribe)
            return _answered(options, screen, _read(options, screen, remote.declared()), remote)
    world = shared.load(options, screen)
    asked = _read(options, screen, features.of_targets(world.environment))
    _check_tags(asked, world)
    with _own(options, screen, asked, world) as subscriptions:
        return _answered(options, screen, asked, subscriptions)


@contextmanager
def _own(options: argparse.Namespace, screen: Screen, asked: Query, world: World) -> Iterator[Subscriptions]:
    """Yield subscriptions in a life-cycle of our own, which starts only the units that the query needs.

    Raises UnmetTargetsError if a target of the file that the query names is not met within `--wait`.
    """
    from cfgplan_runtime import Runtime
    from cfgplan_runtime.lifecycle.manager import Manager
    from cfgplan_runtime.reasoning.managed import ManagedSubscriptions
    from cfgplan_runtime.reasoning.queries import UnmetTargetsError

    from cfgplan.domain import Environment

    wanted = {feature.topic for feature in asked.features if feature.topic is not None}
    found = world.environment
    targets = tuple(target for target in found.targets if target.topic in wanted)
    empty = replace(world, environment=Environment((), found.library, targets), file=None)
    folder = Path(options.env).resolve()
    with (
        Interrupts(),
        Runtime(folder=folder if folder.is_dir() else folder.parent) as runtime,
        Manager(empty, runtime) as manager,
    ):
        subscriptions = ManagedSubscriptions(manager, runtime.id)
        with screen.phase("set up"):
            manager.settle(_SET_UP_S)
            end_s = time.monotonic() + options.wait
            while (unmet := subscriptions.unmet([target.label for target in targets])) and time.monotonic() < end_s:
                time.sleep(_ASKS_S)
        if unmet:
            for fault in shared.code_faults(world, [one.label for one in found.library if one.source]):
                screen.warn_of(fault)
            raise UnmetTargetsError(unmet)
        yield subscriptions


def _read(options: argparse.Namespace, screen: Screen, known: DeclaredFeatures) -> Query:
    """Return the query of the options, over the known features and those that the options declare."""
    from cfgplan_runtime.reasoning import features
    from cfgplan_runtime.reasoning.parser import FILE
    from cfgplan_runtime.reasoning.queries import query
    from cfgplan_runtime.reasoning.states import Timing

    beside = None if options.env is None else Path(options.env).with_name(features.FILE_BESIDE)
    if options.features is not None:
        known = known.with_more(features.of_file(options.features))
    elif beside is not None and beside.is_file():
        known = known.with_more(features.of_file(beside))
    known = known.with_more(features.of_options(options.feature, options.region))
    try:
        timing = Timing(
            hold_ns=round(options.hold * 1e9),
            delay_ns=round(options.delay * 1e9),
            tolerance_ns=round(options.tolerance * 1e9),
            rate_hz=options.rate,
        )
    except InvalidValueError as error:
        raise InputError.of(str(error), file="--rate", mend="write a number up to 1000000") from None
    try:
        return query(options.formula, known, timing)
    except InputError as error:
        if not screen.json and "\n" not in options.formula:
            marked = {fault.column for fault in error.faults if fault.file == FILE and fault.column is not None}
            if marked:
                marks = "".join("^" if column in marked else " " for column in range(1, max(marked) + 1))
                screen.note(f"  {options.formula}\n  {marks}", style="")
        raise


def _check_tags(asked: Query, world: World) -> None:
    """Raise InputError for a tag that does not parse, or that the ontology has no words for."""
    from cfgplan.matching import TagError, check_tag

    faults = []
    for feature in asked.features:
        try:
            check_tag(feature.tag, world.ontology)
        except TagError as error:
            place = feature.origin or Fault("", "ENV")
            column = error.column if place.line is None else place.column
            faults.append(Fault(error.message, place.file, place.line, column, feature.name, error.mend))
    if faults:
        raise InputError(faults)


def _answered(options: argparse.Namespace, screen: Screen, asked: Query, subscriptions: Subscriptions) -> Exit:
    from cfgplan_runtime.reasoning.engine import Engine

    show = as_json(screen) if screen.json else as_text(screen, options.formula, verbose=options.verbose)
    return _EXITS[Engine(asked, subscriptions, show).run(for_s=options.span, wait_s=options.wait).verdict]


def as_json(screen: Screen) -> Callable[[QueryReport], None]:
    def show(report: QueryReport) -> None:
        screen.write_json({"event": type(report).__name__, **asdict(report)})
        screen.flush()

    return show


def as_text(screen: Screen, formula: str, *, verbose: bool) -> Callable[[QueryReport], None]:
    from cfgplan_runtime.reasoning import queries

    last: list[object] = [None]

    def show(report: QueryReport) -> None:
        match report:
            case queries.SetUp(topics, seconds):
                streams = ", ".join(f"{name} on {topic}" for name, topic in topics.items())
                since = span(screen.seconds.get("set up", 0.0) + seconds)
                screen.note(f"Set up in {since}: {streams or 'no streams are needed'}.")
            case queries.Noted(text, is_unknown):
                screen.note(text, style="yellow" if verbose or is_unknown else "dim")
            case queries.Progressed():
                situation = (report.waiting, report.possible, report.missing)
                if situation != last[0]:
                    last[0] = situation
                    screen.show(f"{_clock(report.time_ns)}  open   {_open_text(report)}")
            case queries.Answer():
                screen.show(_answer_text(report, formula))
        screen.flush()

    return show


def _open_text(report: Progressed) -> str:
    parts = [f"waits for {_waiting_text(each)}" for each in report.waiting if each.until_ns is not None][:2]
    if len(report.possible) < 3:
        parts.append(f"can still become {' or '.join(sorted(report.possible))}")
    if report.missing:
        parts.append(f"no value of {', '.join(report.missing)}")
    return "; ".join(parts) or f"after {counted(report.states, 'state')}"


def _answer_text(answer: Answer, formula: str) -> str:
    lines = []
    at = "" if answer.time_ns is None else f"{_clock(answer.time_ns)}  "
    lines.append(f"{at}{answer.verdict.value}   {formula}")
    if answer.time_ns is None or answer.first_ns is None:
        lines.append("  no state came")
    else:
        span = f"{(answer.time_ns - answer.first_ns) / 1e9:.3f} s after the first"
        if answer.delay_s is None:
            lines.append(f"  after {counted(answer.states, 'state')}; the last is {span}")
        else:
            late = f"known {1000 * answer.delay_s:.0f} ms after its time"
            lines.append(f"  decided by state {answer.states}, {span}; {late}")
            lines += [
                f"  {each.text} of {_clock(each.since_ns)} had ended" for each in answer.expired[:3] if each.since_ns
            ]
            lines += [f"  in it {text} is {verdict.value}" for text, verdict in list(answer.last.items())[:6]]
    lines += [f"  waits for {_waiting_text(each)}" for each in answer.waiting[:3] if answer.delay_s is None]
    if answer.delay_s is None and len(answer.possible) < 3:
        lines.append(f"  it can still become {' or '.join(sorted(answer.possible))}")
    lines += _losses(answer.missing, answer)
    return "\n".join(lines)


def _losses(missing: Mapping[str, int], answer: Answer) -> Sequence[str]:
    found = [f"{name} had no value in {counted(count, 'state')}" for name, count in missing.items() if count]
    if answer.late:
        found.append(f"{counted(answer.late, 'sample')} came too late (--delay)")
    if answer.dropped:
        found.append(f"{counted(answer.dropped, 'sample')} dropped because the query was slow")
    return [f"  {text}" for text in found]


def _waiting_text(waiting: Waiting) -> str:
    since = "" if waiting.since_ns is None else f" of {_clock(waiting.since_ns)}"
    until = "" if waiting.until_ns is None else f", until {_clock(waiting.until_ns)}"
    return f"{waiting.text}{since}{until}"


def _clock(time_ns: Any) -> str:
    """Return a time on the clock, or in seconds for a stream with a clock of its own."""
    if time_ns < 1_000_000_000 * 86_400 * 365:
        return f"{time_ns / 1e9:.3f}s"
    return exact_clock_time(time_ns)
