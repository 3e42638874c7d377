"""`cfgplan listen`: the elements on a topic, or of a unit's output port."""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from cfgplan.amounts import exact_clock_time, span
from cfgplan.amounts import rate as often
from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.agent import add_links, reached
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError

if TYPE_CHECKING:
    from cfgplan_runtime import Received, SubscriptionToTopic
    from cfgplan_runtime.fleet.reached import ReachedFleet
    from cfgplan_runtime.operating.kept_tap import KeptTap

_RATE_OVER = 20
_LOOKS_S = 0.5
"""How often a listener looks whether the stream of a unit has ended, or its own time is over."""
_SHOWN_S = 10.0
"""How long a unit may take to show a stream on a topic."""
_LISTEN_EXAMPLE = """\
example:
  cfgplan listen /result
  cfgplan listen /result --json --count 10
  cfgplan listen camera.1/image
  cfgplan listen /map --connect tls/10.0.0.3:7447 --certificates /etc/cfgplan/manager"""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = _LISTEN_EXAMPLE
    topic = "the topic of a target, such as /result, or a unit and its output port, such as camera.1/image"
    parser.add_argument("topic", type=normal, metavar="TOPIC", help=topic)
    which = "id or name of the run; needed if several runs have the topic"
    shared.add_run(parser, which)
    parser.add_argument("--count", type=shared.count, metavar="N", help="stop after N elements (default: no limit)")
    shared.add_span(parser)
    shared.add_time(parser, "--wait", 0.0, "how long to wait until the topic exists, such as 10s (default: 0)")
    add_links(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan_runtime import subscribe

    times: deque[float] = deque(maxlen=_RATE_OVER + 1)
    end = None if options.span is None else time.monotonic() + options.span
    with reached(options) as fleet, _tap(options, fleet) as tap:
        asked: dict[str, Any] = {"run": options.run_id, "wait_s": options.wait, "timeout_s": options.span}
        if tap is not None:
            asked |= {"run": tap.run, "wait_s": max(options.wait, _SHOWN_S), "timeout_s": _LOOKS_S}
        topic = options.topic if tap is None else tap.topic
        with (subscribe if fleet is None else fleet.subscribe)(topic, **asked) as subscription:
            try:
                for number, received in enumerate(_received(subscription, tap, end), 1):
                    latency_ms = (subscription.now_ns() - received.time_ns) / 1e6
                    times.append(received.time_ns / 1e9)
                    rate = (len(times) - 1) / (times[-1] - times[0]) if times[-1] > times[0] else None
                    if screen.json:
                        line = {"topic": options.topic, "time_ns": received.time_ns, "value": plain(received.value)}
                        more = {"latency_ms": round(latency_ms, 3), "rate_hz": None if rate is None else round(rate, 2)}
                        screen.write_json({**line, **more, "dropped": subscription.dropped})
                    else:
                        at = exact_clock_time(received.time_ns)
                        pace = f"{often(rate)}, " if rate else ""
                        screen.write(f"{at}  {readable(received.value)}  ({pace}{span(latency_ms / 1e3)} old)\n")
                    screen.flush()
                    if number == options.count or (end is not None and time.monotonic() >= end):
                        break
                else:
                    if tap is not None:
                        screen.note(f"{options.topic} has ended")
            except TimeoutError:
                screen.note(f"nothing came on {options.topic}")
            except KeyboardInterrupt:
                screen.note("stopped")
            if subscription.dropped:
                screen.warn(f"{subscription.dropped} elements were dropped because this listener was slow")
    return Exit.OK


@contextmanager
def _tap(options: argparse.Namespace, fleet: ReachedFleet | None) -> Iterator[KeptTap | None]:
    """Publish the stream that the options name on a topic, also if it is that of a target that only ROS nodes receive.

    None if they name any other topic. Raises InputError.
    """
    from cfgplan_runtime.operating.kept_tap import kept_tap
    from cfgplan_runtime.operating.protocol import RefusedError

    with ExitStack() as kept:
        tap: KeptTap | None = None
        try:
            if options.topic.find("/") > 0 or (fleet is None and _is_in_ros_alone(options)):
                tap = kept.enter_context(kept_tap(options.topic, options.run_id, fleet, options.wait))
        except RefusedError as error:
            mend = error.mend or "`cfgplan ctl topics` lists topics and streams, such as a.1/port"
            raise InputError.of(error.message, mend=mend) from None
        yield tap


def _is_in_ros_alone(options: argparse.Namespace) -> bool:
    """Return whether a live run has the topic, but only nodes of ROS can subscribe to it."""
    from cfgplan_runtime.errors import RuntimeFaultError
    from cfgplan_runtime.operating.control_client import connect
    from cfgplan_runtime.operating.protocol import RefusedError

    try:
        with connect(options.run_id) as control:
            return bool(control.call("tap", timeout_s=_SHOWN_S, stream=options.topic)["topic"] != options.topic)
    except (RuntimeFaultError, RefusedError):
        return False


def _received(subscription: SubscriptionToTopic, tap: KeptTap | None, end: float | None) -> Iterator[Received]:
    """Yield what comes, until the run or the tapped stream ends. Raises TimeoutError if nothing comes."""
    while True:
        try:
            yield from subscription
            return
        except TimeoutError:
            if tap is None or (end is not None and time.monotonic() >= end):
                raise
            if tap.has_ended.is_set():
                return


_WIDEST_ELEMENT = 160
_MOST_NUMBERS = 1000


def readable(value: Any) -> str:
    """Return a value on one line; a large array becomes its type and shape, a long text its beginning."""
    text = repr(_summed_up(value))
    return text if len(text) <= _WIDEST_ELEMENT else f"{text[: _WIDEST_ELEMENT - 3]}..."


def plain(value: Any) -> Any:
    """A value as JSON can say it: bytes by their length, arrays with their numbers if these are not too many."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, bytes):
        return {"bytes": len(value)}
    if _is_array(value):
        array: dict[str, Any] = {"dtype": str(value.dtype), "shape": list(value.shape)}
        if value.size <= _MOST_NUMBERS and value.dtype.kind in "biuf":
            array["data"] = value.tolist()
        return array
    return value if isinstance(value, str | int | float | bool | None) else str(value)


class _Words:
    """Text that stands for itself inside of a printed value."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def _summed_up(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _summed_up(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_summed_up(item) for item in value]
    if isinstance(value, bytes) and len(value) > _WIDEST_ELEMENT:
        return _Words(f"<{len(value):,} bytes>")
    if _is_array(value):
        if value.size <= 8:
            return _Words(f"array({value.tolist()}, {value.dtype})")
        return _Words(f"<array of {' x '.join(map(str, value.shape))} {value.dtype}>")
    return value


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and hasattr(value, "shape")
