"""A stream of a run that is on no topic, shown on one as long as a client looks."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from cfgplan_runtime.errors import ControlError, NoSuchRunError
from cfgplan_runtime.fleet.reached import ReachedFleet
from cfgplan_runtime.operating.control_client import Control, connect
from cfgplan_runtime.operating.protocol import RefusedError

_ANSWER_S = 60.0
_LOOKS_AGAIN_S = 0.2
_RENEWS_S = 2.0


@dataclass(frozen=True)
class KeptTap:
    """A `topic` of a `run` that has a stream. `has_ended` is set when no running unit gives the stream any more."""

    run: str
    topic: str
    has_ended: threading.Event


@contextmanager
def kept_tap(stream: str, run: str | None, fleet: ReachedFleet | None, wait_s: float) -> Iterator[KeptTap]:
    """Show a stream, such as `camera.1/image`, on a topic, until the block ends.

    `run` is the id or name of a run of this computer, or of a fleet. Waits up to `wait_s` seconds for the run and for
    a unit that gives the stream. Raises NoSuchRunError, ControlError and RefusedError.
    """
    control, topic = _tapped(stream, run, fleet, time.monotonic() + wait_s)
    with control:
        has_ended, is_over = threading.Event(), threading.Event()

        def renew() -> None:
            while not is_over.wait(_RENEWS_S):
                try:
                    control.call("tap", timeout_s=_ANSWER_S, stream=stream)
                except (RefusedError, ControlError):
                    has_ended.set()
                    return

        thread = threading.Thread(target=renew, name=f"cfgplan-tap {stream}", daemon=True)
        thread.start()
        try:
            yield KeptTap(control.system.run, topic, has_ended)
        finally:
            is_over.set()
            control.hang_up()
            thread.join()


def _tapped(stream: str, run: str | None, fleet: ReachedFleet | None, until_s: float) -> tuple[Control, str]:
    """Return a connection to the run, and the topic."""
    while True:
        with ExitStack() as kept:
            try:
                control = kept.enter_context(connect(run, fleet))
                topic: str = control.call("tap", timeout_s=_ANSWER_S, stream=stream)["topic"]
                kept.pop_all()
                return control, topic
            except (NoSuchRunError, RefusedError):
                if time.monotonic() >= until_s:
                    raise
        time.sleep(_LOOKS_AGAIN_S)
