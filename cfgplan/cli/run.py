"""`cfgplan run`: start what the cheapest update says, as processes, and hold it."""

from __future__ import annotations

import argparse
import json
import queue
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfgplan.cli import options as shared
from cfgplan.cli.durations import duration
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.screen import FORMAT_VERSION, Screen, counted
from cfgplan.domain import Environment
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from cfgplan_runtime.runtime import Runtime
    from cfgplan_runtime.supervision.events import Event
    from cfgplan_runtime.supervision.observation import Observation

_LOOK_S = 0.2


def add_to(verbs: shared.Subparsers) -> None:
    parser = shared.add_verb(
        verbs,
        "run",
        "start what meets the targets, as processes, and hold it until Ctrl-C",
        "  cfgplan run env.yaml --for 30s\n  cfgplan listen /result      (in another terminal)",
    )
    shared.add_environment(parser)
    parser.add_argument("--for", dest="span", type=duration, metavar="TIME", help="stop after 30s, 5m, 1h")
    parser.add_argument("--log", metavar="FILE", help="add every event to FILE, one JSON line each")
    parser.add_argument("--preload", action="append", default=[], metavar="MODULE", help="import it before units start")
    shared.add_planning(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import api

    loaded = shared.load(options, screen)
    found = loaded.environment
    world = replace(loaded, environment=Environment((), found.library, found.targets), file=None)
    problem = shared.problem(options, screen, world)
    with screen.phase("plan"):
        plan = api.plan(problem, planner=options.planner, time_limit_s=options.timeout)
    if plan.change_set is None:
        from cfgplan.cli.update_text import update_text

        screen.show(update_text(problem, plan))
        return OF_STATUS[plan.status]
    folder = Path(options.env).resolve()
    runtime = _started(options, world.environment, folder if folder.is_dir() else folder.parent)
    try:
        with _interruptible(), runtime:
            applied = runtime.apply(plan.change_set, basis=problem.environment)
            _say(screen, "Running", run=runtime.id, units=len(plan.change_set.started), seconds=applied.seconds)
            _hold(runtime, options.span, screen)
            _sum_up(runtime.observe(), screen)
            runtime.stop()
    except KeyboardInterrupt:
        screen.note("stopped")
    return Exit.OK


def _started(options: argparse.Namespace, environment: Environment, folder: Path) -> Runtime:
    from cfgplan_runtime import Runtime

    try:
        return Runtime(
            environment.library, environment.targets, folder=folder, preload=options.preload, log=options.log
        )
    except OSError as error:
        raise InputError.of(f"can't be written: {error.strerror}", file=options.log) from None


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let SIGINT and SIGTERM end a run cleanly; a solver may have left either with a handler of its own."""
    signals = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(one, signal.default_int_handler) for one in signals]
    try:
        yield
    finally:
        for one, handler in zip(signals, before, strict=True):
            signal.signal(one, handler)


def _hold(runtime: Runtime, span_s: float | None, screen: Screen) -> None:
    """Show what happens until the time is over or the user interrupts."""
    end = None if span_s is None else time.monotonic() + span_s
    runtime.observe()
    try:
        while end is None or time.monotonic() < end:
            with suppress(queue.Empty):
                _show(runtime.events.get(timeout=_LOOK_S), screen)
    except KeyboardInterrupt:
        screen.note("stopping ...")


def _show(event: Event, screen: Screen) -> None:
    from cfgplan_runtime.supervision import events as kinds

    match event:
        case kinds.UnitDied(unit, cause):
            _say(screen, "UnitDied", unit=unit, cause=cause)
        case kinds.UnitFailed(unit, kind, step, text, suppressed):
            _say(screen, "UnitFailed", unit=unit, kind=kind, step=step, text=text, suppressed=suppressed)
        case kinds.UnitHung(unit, silent_s):
            _say(screen, "UnitHung", unit=unit, silent_s=round(silent_s, 1))
        case kinds.UnitTooLarge(unit, memory_bytes):
            _say(screen, "UnitTooLarge", unit=unit, memory_mb=memory_bytes >> 20)
        case kinds.UnitPrinted(unit, line):
            _say(screen, "UnitPrinted", unit=unit, line=line)
        case kinds.InputLost(unit, port, _):
            _say(screen, "InputLost", unit=unit or "a topic", port=port)
        case kinds.SourceExhausted(unit):
            _say(screen, "SourceExhausted", unit=unit)
        case kinds.OutletsLost(cause):
            _say(screen, "OutletsLost", cause=cause)


_SENTENCES = {
    "Running": "Running {units_counted} as run {run}; Ctrl-C stops.",
    "UnitDied": "{unit} died: {cause}",
    "UnitFailed": "{unit} failed in step {step} ({kind}): {text}",
    "UnitHung": "{unit} gave no sign of life for {silent_s} s and is killed",
    "UnitTooLarge": "{unit} takes {memory_mb} MB and is killed",
    "UnitPrinted": "{unit} | {line}",
    "InputLost": "{unit} lost its input {port}",
    "SourceExhausted": "{unit} has no more to give",
    "OutletsLost": "the topics' addresses were lost and are made anew: {cause}",
}


def _say(screen: Screen, event: str, **facts: Any) -> None:
    if screen.json:
        screen.write(json.dumps({"format_version": FORMAT_VERSION, "event": event, **facts}) + "\n")
    else:
        more = {"units_counted": counted(facts["units"], "unit")} if "units" in facts else {}
        screen.show(_SENTENCES[event].format(**facts, **more))


def _sum_up(observations: tuple[Observation, ...], screen: Screen) -> None:
    """What each unit did and cost."""
    if screen.json:
        for seen in observations:
            facts = {"unit": seen.unit, "labor_us": seen.labor_us, "upkeep_us": seen.upkeep_us, "steps": seen.steps}
            more = {"memory_bytes": seen.memory_bytes, "dropped": seen.dropped, "errors": seen.errors}
            _say(screen, "Observed", **facts, **more)
        return
    from rich.table import Table

    table = Table("unit", "labor", "upkeep", "memory", "steps", "dropped", "errors", box=None)
    for seen in observations:
        upkeep = "" if seen.upkeep_us is None else f"{seen.upkeep_us / 1e6:.4f} s/s"
        counts = [str(count) for count in (seen.steps, seen.dropped, seen.errors)]
        table.add_row(seen.unit, f"{seen.labor_us / 1e6:.3f} s", upkeep, f"{seen.memory_bytes >> 20} MB", *counts)
    screen.show(table)
