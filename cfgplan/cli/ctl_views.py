"""The commands of `cfgplan ctl` that only read: events, printed lines, topics, and rates."""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from statistics import fmean, pstdev
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cfgplan.amounts import clock_time, rate, span
from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen, counted, json_line, printable
from cfgplan.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from cfgplan_runtime.operating.control_client import Control

_FOLLOWS_S = 0.3
"""Seconds between two looks at what a unit has printed."""
_WINDOW = 1000
"""Rates are over so many of the last intervals at most."""
_TELLS_S = 1.0
_LAST_EVENTS = 10
"""The number of past events that are printed before the new ones."""


def _add_logs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--follow", action="store_true", help="keep printing new lines until the run ends")
    parser.add_argument(
        "--last",
        type=shared.count,
        metavar="N",
        help="print only the last N lines (default: all; 1,000 are kept of a unit)",
    )


def _add_events(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--last", type=shared.count, metavar="N", help="print the last N events (1,000 are kept)")
    since = "print the events of the last 30s, 10m or 2h (1,000 are kept)"
    parser.add_argument("--since", type=shared.duration, metavar="TIME", help=since)
    parser.add_argument("--follow", action="store_true", help="with --last or --since: continue with new events")
    parser.epilog = (
        f"Without --last and --since: the last {_LAST_EVENTS} events (with --json none), then new ones until Ctrl-C."
    )


def _add_hz(parser: argparse.ArgumentParser) -> None:
    shared.add_span(parser)


OPTIONS: Mapping[str, Callable[[argparse.ArgumentParser], None]] = MappingProxyType(
    {"logs": _add_logs, "events": _add_events, "hz": _add_hz}
)
"""Adds a command's options."""


def _events(control: Control, screen: Screen, options: argparse.Namespace) -> Exit:
    """Print the past events that the options ask for, then new ones.

    Without options, the text for people begins with the last events; JSON has only new ones.
    """
    has_past = options.last is not None or options.since is not None
    follows, told = options.follow or not has_past, 0
    try:
        if follows:
            control.subscribe()
        if has_past or not screen.json:
            past = control.call("events", timeout_s=60, since_s=options.since)["events"]
            shown = [event for event in past if screen.json or event["says"] is not None]
            for event in _last(shown, options.last if has_past else _LAST_EVENTS):
                _tell_event(event, screen)
            told = past[-1]["number"] if past else 0
            if not past and not follows:
                screen.note("nothing has happened in that time" if options.since else "nothing has happened yet")
        if follows:
            earlier = "" if has_past else " (`--last N` or `--since 10m` shows earlier ones)"
            screen.note(f"waiting for new events of run {control.system.run}{earlier}; Ctrl-C ends this")
            for event in control.events():
                if event["number"] > told:
                    _tell_event(event, screen)
            screen.note(f"run {control.system.run} has ended")
    except KeyboardInterrupt:
        screen.note("stopped")
    return Exit.OK


def _last(records: Sequence[Mapping[str, Any]], number: int | None) -> Sequence[Mapping[str, Any]]:
    """Return the last records, so many at most; None stands for all."""
    return records if number is None else records[max(0, len(records) - number) :]


def _tell_event(event: Mapping[str, Any], screen: Screen) -> None:
    if screen.json:
        screen.write_json(event)
    elif event["says"] is not None:
        screen.write(f"{clock_time(event['time_s'])}  {printable(event['says'])}\n")
    screen.flush()


def _logs(control: Control, screen: Screen, options: argparse.Namespace) -> Exit:
    """Print lines of a unit, or of all units of a label, which then stand before each line."""
    from cfgplan_runtime.errors import ControlError

    name, after = options.operand, 0
    lines = control.call("logs", timeout_s=60, unit=name)["lines"]
    lines = _last(lines, options.last)
    if not lines and not options.follow:
        screen.note(f"{name} has printed nothing")
    try:
        while True:
            for line in lines:
                after = line["number"]
                if screen.json:
                    screen.write_json(line)
                else:
                    unit = "" if line["unit"] == name else f"{line['unit']}  "
                    screen.write(f"{clock_time(line['time_s'])}  {unit}{printable(line['line'])}\n")
            screen.flush()
            if not options.follow:
                return Exit.OK
            time.sleep(_FOLLOWS_S)
            lines = control.call("logs", timeout_s=60, unit=name, after=after)["lines"]
    except ControlError:
        screen.note(f"run {control.system.run} has ended")
    except KeyboardInterrupt:
        screen.note("stopped")
    return Exit.OK


def _topics(control: Control, screen: Screen, _: argparse.Namespace) -> Exit:
    told = control.call("topics", timeout_s=60)
    if screen.json:
        screen.show_json({"run": control.system.run, **told})
        return Exit.OK
    from rich.table import Table

    topics = Table("topic", "from", "rate", "last", "age", "dropped", box=None, pad_edge=False)
    for one in told["topics"]:
        age = "" if one["latency_ms"] is None else span(one["latency_ms"] / 1e3)
        dropped = str(one["dropped"]) if one["dropped"] else ""
        topics.add_row(one["topic"], one["stream"] or "nothing", *_pace(one), age, dropped)
    streams = Table("stream", "rate", "last", "elements", box=None, pad_edge=False)
    for one in told["streams"]:
        streams.add_row(one["stream"], *_pace(one), f"{one['elements']}")
    for table in (topics, streams):
        if table.row_count:
            screen.show(table)
    if not (topics.row_count or streams.row_count):
        screen.note("there is no topic, and no unit that gives a stream")
    return Exit.OK


def _pace(one: Mapping[str, Any]) -> tuple[str, str]:
    """How often something comes, and when it came last."""
    silent_s = one["silent_s"]
    last = "nothing came yet" if silent_s is None else f"{span(silent_s)} ago"
    return rate(one["rate_hz"]) if one["rate_hz"] else "", last


def _hz(control: Control, screen: Screen, options: argparse.Namespace) -> Exit:
    """Print, once a second, the rate and the jitter of a topic, or the rate of a stream or of a unit's steps."""
    told, state = control.call("topics", timeout_s=60), control.call("state", timeout_s=60)
    topics = [one["topic"] for one in told["topics"]]
    streams = [one["stream"] for one in told["streams"]]
    units = [unit["id"] for unit in state["units"] if "steps" in unit]
    end_s = None if options.span is None else time.monotonic() + options.span
    name = options.operand
    if name not in {*topics, *streams, *units}:
        known = [*topics, *units, *streams]
        mend = did_you_mean(name, known, f"write one of {', '.join(known)}" if known else "nothing runs yet")
        raise InputError.of(f"{name!r} is not a topic, a running unit or a stream", mend=mend)
    try:
        if name in topics and _is_shown(control, name):
            _measure_topic(control, screen, options, end_s)
        else:
            _measure_counts(control, screen, name, end_s, "step" if name in units else "element")
    except KeyboardInterrupt:
        screen.note("stopped")
    return Exit.OK


def _is_shown(control: Control, topic: str) -> bool:
    """Whether the elements of a target's topic can be subscribed to; topics of ROS nodes are in ROS alone."""
    from cfgplan_runtime.operating.protocol import RefusedError

    try:
        return bool(control.call("tap", timeout_s=60, stream=topic)["topic"] == topic)
    except RefusedError:
        return False


def _measure_topic(control: Control, screen: Screen, options: argparse.Namespace, end_s: float | None) -> None:
    """Subscribe to a topic, and tell of the times between its elements as they arrive here."""
    from cfgplan_runtime import subscribe
    from cfgplan_runtime.errors import NoSuchTopicError

    asked: dict[str, Any] = {"run": control.system.run, "timeout_s": _TELLS_S}
    arrived: deque[float] = deque(maxlen=_WINDOW + 1)
    topic, tell_s = options.operand, time.monotonic() + _TELLS_S
    try:
        subscription = (subscribe if options.fleet is None else options.fleet.subscribe)(topic, **asked)
    except NoSuchTopicError as error:
        raise InputError.of(str(error)) from None
    with subscription:
        while subscription.is_connected and (end_s is None or time.monotonic() < end_s):
            try:
                for _ in subscription.elements():
                    arrived.append(time.monotonic())
                    if arrived[-1] >= tell_s or (end_s is not None and arrived[-1] >= end_s):
                        break
            except TimeoutError:
                screen.note(f"nothing came on {topic} for {span(_TELLS_S)}")
                continue
            if time.monotonic() >= tell_s:
                tell_s = time.monotonic() + _TELLS_S
                _tell_pace(screen, topic, [after - before for before, after in pairwise(arrived)])
        if subscription.dropped:
            screen.warn(f"{subscription.dropped} elements came too fast for this measurement, and are not in it")
    if end_s is None or time.monotonic() < end_s:
        screen.note(f"{topic} has ended")


def _measure_counts(control: Control, screen: Screen, name: str, end_s: float | None, noun: str) -> None:
    """Tell of the mean rate of a unit's steps, or of a stream's elements, since the measurement began, as the run
    counts them each second.
    """
    from cfgplan_runtime.errors import ControlError

    first: tuple[int, float] | None = None
    try:
        while end_s is None or time.monotonic() < end_s:
            count, now_s = _count(control, name, noun), time.monotonic()
            if count is None:
                screen.note(f"{name} has ended")
                return
            if first is None or count < first[0]:  # another unit of the name counts from 0
                first = count, now_s
            else:
                _tell_count(screen, name, noun, count - first[0], now_s - first[1])
            time.sleep(_TELLS_S if end_s is None else max(0.0, min(_TELLS_S, end_s - now_s)))
    except ControlError:
        screen.note(f"run {control.system.run} has ended")


def _count(control: Control, name: str, noun: str) -> int | None:
    """Return the number of a unit's steps, or of a stream's or topic's elements; None if it has ended."""
    if noun == "step":
        units = control.call("state", timeout_s=60)["units"]
        return next((one["steps"] for one in units if one["id"] == name and "steps" in one), None)
    told = control.call("topics", timeout_s=60)
    elements = {one["stream"]: one["elements"] for one in told["streams"]}
    elements |= {one["topic"]: one["elements"] for one in told["topics"]}
    return elements.get(name)


def _tell_count(screen: Screen, name: str, noun: str, count: int, seconds: float) -> None:
    if screen.json:
        figures = {"rate_hz": round(count / seconds, 6), f"{noun}s": count, "seconds": round(seconds, 3)}
        screen.tell(json_line({"name": name, **figures}))
    else:
        often = f"{rate(count / seconds)}: {counted(count, noun)}" if count else f"no {noun}"
        screen.tell(f"{often} in {span(seconds)}")


def _tell_pace(screen: Screen, name: str, periods_s: Sequence[float]) -> None:
    if not periods_s:
        return
    mean_s, jitter_s = fmean(periods_s), pstdev(periods_s)
    if screen.json:
        figures = {"rate_hz": 1 / mean_s if mean_s else None, "least_s": min(periods_s), "most_s": max(periods_s)}
        rounded = {key: None if value is None else round(value, 6) for key, value in figures.items()}
        line = {"name": name, **rounded, "jitter_s": round(jitter_s, 6), "intervals": len(periods_s)}
        screen.tell(json_line(line))
        return
    often = rate(1 / mean_s) if mean_s else "all at once"
    apart = f"{span(min(periods_s))} to {span(max(periods_s))} apart, jitter {span(jitter_s)}"
    screen.tell(f"{often}: {apart} (standard deviation of {len(periods_s)})")


VIEWS: Mapping[str, Callable[[Control, Screen, argparse.Namespace], Exit]] = MappingProxyType(
    {"events": _events, "logs": _logs, "topics": _topics, "hz": _hz}
)
"""Carries a command out."""
