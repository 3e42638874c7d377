"""`cfgplan query`: answer a question about streams, as soon as the answer is certain."""

from __future__ import annotations

import argparse
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.durations import duration
from cfgplan.cli.exits import Exit
from cfgplan.cli.query_text import as_json, as_text
from cfgplan.cli.screen import Screen
from cfgplan.errors import Fault, InputError, InvalidValueError

if TYPE_CHECKING:
    from cfgplan_runtime.reasoning.features import Declared
    from cfgplan_runtime.reasoning.queries import Query
    from cfgplan_runtime.reasoning.subscriptions import Subscriptions

    from cfgplan.api import World

_EXITS = {"true": Exit.OK, "false": Exit.INVALID, "open": Exit.NOT_PROVEN, "unknown": Exit.NO_ANSWER}


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "query",
        "answer a temporal formula over the streams of semantic subscriptions",
        '  cfgplan query env.yaml "always (not in(ball, opponent_half) -> eventually[0,10s] in(ball, opponent_half))"\n'
        "  cfgplan query env.yaml 'eventually[0,1min] ball.x > 3' --feature ball='Position and hasSource some Ball'\n\n"
        "exit codes: 0 true, 1 false, 20 open still, 21 unknown (values were missing), 10 a feature can't be had",
    )
    parser.add_argument(
        "env",
        metavar="ENV",
        nargs="?",
        help="environment file: what can be started; without it, or with --run, a run is asked",
    )
    parser.add_argument(
        "formula",
        type=normal,
        metavar="FORMULA",
        help="not, and, or, ->, always[a,b], eventually[a,b], until[a,b] over comparisons, in(point, region), RCC8",
    )
    parser.add_argument("--features", metavar="FILE", help="names of features and regions (features.yaml beside ENV)")
    parser.add_argument(
        "--feature",
        type=normal,
        action="append",
        default=[],
        metavar="NAME=TAG",
        help="a name for a semantic subscription",
    )
    parser.add_argument(
        "--region",
        type=normal,
        action="append",
        default=[],
        metavar="NAME=REGION",
        help="such as goal='{circle: [4, 0], radius: 1}'",
    )
    parser.add_argument("--run", dest="run_id", metavar="ID", help="ask this run instead of starting units here")
    parser.add_argument("--for", dest="span", type=duration, metavar="TIME", help="stop after 30s, 5m, 1h")
    parser.add_argument("--rate", type=shared.positive, metavar="HZ", help="states a second (one at each sample)")
    parser.add_argument(
        "--delay", type=duration, default=0.2, metavar="TIME", help="wait so long for samples of a state's time (200ms)"
    )
    parser.add_argument(
        "--hold", type=duration, default=1.0, metavar="TIME", help="a value counts so long, then it is missing (1s)"
    )
    parser.add_argument(
        "--tolerance", type=duration, default=0.0, metavar="TIME", help="samples this near make one state (0)"
    )
    parser.add_argument(
        "--wait", type=duration, default=0.0, metavar="TIME", help="wait so long for features that can't be had yet (0)"
    )
    parser.add_argument("--verbose", action="store_true", help="say what happens to the units")
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime.reasoning import features

    if options.env is None and os.path.isfile(options.formula):  # noqa: PTH113 - a long formula is no path
        raise InputError.of("a file is given and no formula", file=options.formula, mend="write FORMULA after ENV")
    if options.env is None or options.run_id is not None:
        from cfgplan_runtime.operating.control_client import connect
        from cfgplan_runtime.reasoning.managed import RemoteSubscriptions

        with _interruptible(), connect(options.run_id) as control:
            remote = RemoteSubscriptions(control)
            return _answered(options, screen, _read(options, screen, remote.declared()), remote)
    world = shared.load(options, screen)
    asked = _read(options, screen, features.of_targets(world.environment))
    _check_tags(asked, world)
    with _own(options, screen, asked, world) as subscriptions:
        return _answered(options, screen, asked, subscriptions)


@contextmanager
def _own(options: argparse.Namespace, screen: Screen, asked: Query, world: World) -> Iterator[Subscriptions]:
    """Subscriptions in a life-cycle of our own, which begins with what the query needs and nothing else."""
    from cfgplan_runtime import Runtime
    from cfgplan_runtime.lifecycle.manager import Manager
    from cfgplan_runtime.reasoning.managed import ManagedSubscriptions

    from cfgplan.domain import Environment

    wanted = {feature.topic for feature in asked.features if feature.topic is not None}
    found = world.environment
    targets = tuple(target for target in found.targets if target.topic in wanted)
    empty = replace(world, environment=Environment((), found.library, targets), file=None)
    folder = Path(options.env).resolve()
    with (
        _interruptible(),
        Runtime(folder=folder if folder.is_dir() else folder.parent) as runtime,
        Manager(empty, runtime) as manager,
    ):
        with screen.phase("set up"):
            manager.settle(60.0)
        yield ManagedSubscriptions(manager, runtime.id)


def _read(options: argparse.Namespace, screen: Screen, known: Declared) -> Query:
    """The query that the options say, over the features that are known and those that they declare."""
    from cfgplan_runtime.reasoning import features
    from cfgplan_runtime.reasoning.parsing import FILE
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
            for fault in error.faults:
                if fault.file == FILE and fault.column is not None:
                    screen.note(f"  {options.formula}\n  {' ' * (fault.column - 1)}^", style="")
        raise


def _check_tags(asked: Query, world: World) -> None:
    """Raises InputError for a tag that does not parse, or that the ontology has no words for."""
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
    from cfgplan_runtime.reasoning.answers import UnmetTargetsError
    from cfgplan_runtime.reasoning.engine import Engine

    show = as_json(screen) if screen.json else as_text(screen, options.formula, verbose=options.verbose)
    try:
        answer = Engine(asked, subscriptions, show).run(for_s=options.span, wait_s=options.wait)
    except UnmetTargetsError as error:
        screen.faults(
            [Fault(reason, mend="--wait TIME waits until it can be had") for reason in error.reasons.values()]
        )
        return Exit.NO_PLAN
    return _EXITS[answer.verdict]


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let SIGINT and SIGTERM end a query cleanly; a solver may leave either with a handler of its own."""
    signals = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(one, signal.default_int_handler) for one in signals]
    try:
        yield
    finally:
        for one, handler in zip(signals, before, strict=True):
            signal.signal(one, handler)
