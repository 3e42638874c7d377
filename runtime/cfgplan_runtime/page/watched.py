"""The messages for viewers of a run, fetched once for all viewers, and only while a page is open."""

from __future__ import annotations

import json
import secrets
import threading
import time
from asyncio import AbstractEventLoop, Queue
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from cfgplan.unmet import SharedReason
from cfgplan_runtime.errors import ControlError
from cfgplan_runtime.lifecycle.kinds import Shown, kind_named
from cfgplan_runtime.lifecycle.review_sentences import in_display_order, reasons_by_target, target_reason, waiting
from cfgplan_runtime.operating.control_client import Control
from cfgplan_runtime.operating.protocol import Record, RefusedError
from cfgplan_runtime.page.health import health
from cfgplan_runtime.page.peeks import Peek, Subscribe
from cfgplan_runtime.page.source_lines import error_record, fault_record

FRAME_S = 0.1
"""Seconds from one state message to the next, at least."""
REFRESH_S = 0.5
"""Seconds from one state message to the next, at most. A message comes sooner if something happens."""
_MOST_NEWS = 300
_MOST_WAITING = 200
"""The most messages that wait for a viewer; older ones are dropped."""
_RUN_S = 10.0
_REVIEWED_S = 80.0
"""Seconds that a change may take: it is answered when its review is over."""

ToViewer = tuple[str, str]
"""A kind and its data as JSON."""


@dataclass(eq=False)
class Viewer:
    """An open page: its messages, and the stream that it peeks into. Its `name` is secret."""

    loop: AbstractEventLoop
    messages: Queue[ToViewer] = field(default_factory=Queue)
    name: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    peek: Peek | None = None

    def tell(self, message: ToViewer) -> None:
        """Send a message. Thread-safe."""
        with suppress(RuntimeError):  # its loop has just been closed
            self.loop.call_soon_threadsafe(_put, self.messages, message)


class Watched:
    """Fetches the state of a run for its viewers. `reach` connects to the run's control socket."""

    def __init__(self, reach: Callable[[], Control], subscribe: Subscribe) -> None:
        self._reach = reach
        self._subscribe = subscribe
        self._lock = threading.Lock()
        self._viewers: dict[str, Viewer] = {}
        self._somebody_looks = threading.Event()
        self._is_due = threading.Event()
        """Set when the next state message need not wait any longer."""
        self._events: deque[ToViewer] = deque(maxlen=_MOST_NEWS)
        self._reviews: ToViewer | None = None
        self._end: ToViewer | None = None
        self.has_ended = threading.Event()
        self._controls: tuple[Control, ...] = ()

    def start(self) -> None:
        """Connect to the run, and start the threads. Raises ControlError if no run can be reached."""
        events = self._reach()
        try:
            events.subscribe()
            states = self._reach()
        except BaseException:
            events.close()
            raise
        self.system = events.system
        self._controls = events, states
        self._keep_past(states)
        for work in (lambda: self._hear(events), lambda: self._look(states)):
            threading.Thread(target=self._until_the_end, args=(work,), daemon=True).start()

    def close(self) -> None:
        """Tell all threads to end."""
        self.has_ended.set()
        self._somebody_looks.set()
        self._is_due.set()
        for control in self._controls:
            control.hang_up()

    @contextmanager
    def viewer(self, loop: AbstractEventLoop) -> Iterator[Viewer]:
        """Add a viewer. It first gets the reviews, the last events, and the end if the run is over, then news."""
        viewer = Viewer(loop)
        with self._lock:
            for message in (self._reviews, *self._events, self._end):
                if message is not None:
                    viewer.messages.put_nowait(message)
            self._viewers[viewer.name] = viewer
            self._somebody_looks.set()
            self._is_due.set()
        try:
            yield viewer
        finally:
            with self._lock:
                del self._viewers[viewer.name]
                peek, viewer.peek = viewer.peek, None
                if not self._viewers:
                    self._somebody_looks.clear()
            if peek is not None:
                threading.Thread(target=peek.close, daemon=True).start()

    def peek(self, name: str, stream: str | None) -> bool:
        """Let a viewer peek into a stream, and into no other; None: into none. Returns False for an unknown viewer."""
        with self._lock:
            viewer = self._viewers.get(name)
            if viewer is None:
                return False
            before, viewer.peek = viewer.peek, None
        if before is not None:
            before.close()
        if stream is not None:
            give = viewer.tell
            subscribe = partial(self._subscribe, run=self.system.run)
            peek = Peek(stream, self._topic_of, subscribe, lambda told: give(("peek", json.dumps(told))))
            with self._lock:
                is_there = self._viewers.get(name) is viewer and viewer.peek is None
                if is_there:
                    viewer.peek = peek
            if not is_there:
                peek.close()
        return True

    def call(self, method: str, params: dict[str, Any]) -> Any:
        """Call a method of the run's control socket. Raises RefusedError and ControlError."""
        with self._reach() as control:
            return control.call(method, timeout_s=_REVIEWED_S, **params)

    def moment(self, review: int) -> Record:
        """Return the state right after a review, as viewers get it. Raises RefusedError and ControlError."""
        with self._reach() as control:
            return as_seen(control.call("state", timeout_s=_RUN_S, review=review))

    def _topic_of(self, stream: str) -> str:
        """Return a topic that shows a stream, or a target's topic, to observers. Raises RefusedError, ControlError."""
        with self._reach() as control:
            topic: str = control.call("tap", timeout_s=_RUN_S, stream=stream)["topic"]
        return topic

    def _until_the_end(self, work: Callable[[], None]) -> None:
        try:
            work()
        finally:
            if not self.has_ended.is_set():
                self.has_ended.set()
                self._tell(("ended", "null"))

    def _keep_past(self, control: Control) -> None:
        """Keep the events that happened before the page was served."""
        with suppress(RefusedError):
            for event in control.call("events", timeout_s=_RUN_S, last=_MOST_NEWS)["events"]:
                self._take(event)

    def _hear(self, control: Control) -> None:
        with control:
            for event in control.events():
                if Shown.LATER in kind_named(event["kind"]).shown:
                    self._is_due.set()
                self._take(event)

    def _take(self, event: Record) -> None:
        """Tell of an event that has a sentence and is shown on the page."""
        if event.get("says") is not None and Shown.ON_PAGE in kind_named(event["kind"]).shown:
            told = {key: event.get(key) for key in ("kind", "level", "says", "unit", "number")}
            self._tell(("event", json.dumps({"time_s": time.time(), **told} | _time(event))))

    def _look(self, control: Control) -> None:
        with control, suppress(ControlError):
            while not self.has_ended.is_set():
                self._somebody_looks.wait()
                self._is_due.clear()
                state = control.call("state", timeout_s=_RUN_S)
                reviews = ("reviews", json.dumps(state["reviews"]))
                if reviews != self._reviews:
                    self._tell(reviews)
                self._tell(("state", json.dumps(as_seen(state))))
                if not self.has_ended.wait(FRAME_S):
                    self._is_due.wait(REFRESH_S - FRAME_S)

    def _tell(self, message: ToViewer) -> None:
        """Send a message to all viewers, once each, and keep it if later viewers need it too."""
        with self._lock:
            if message[0] == "event":
                self._events.append(message)
            elif message[0] == "reviews":
                self._reviews = message
            elif message[0] == "ended":
                self._end = message
            viewers = list(self._viewers.values())
        for viewer in viewers:
            viewer.tell(message)


def _put(messages: Queue[ToViewer], message: ToViewer) -> None:
    while messages.qsize() >= _MOST_WAITING + _MOST_NEWS:
        messages.get_nowait()
    messages.put_nowait(message)


def _time(event: Record) -> Record:
    return {"time_s": event["time_s"]} if "time_s" in event else {}


def as_seen(state: Record) -> Record:
    """A state as viewers get it: with its health, each reason and cause once, and the source lines of faults."""
    del state["transformations"], state["reviews"]
    units = [
        {**unit, "last_error": error_record(unit["last_error"])} if unit.get("last_error") else unit
        for unit in state["units"]
    ]
    targets = in_display_order(state["targets"])
    reasons = reasons_by_target(targets)
    return {
        **state,
        "targets": [_target(target, reasons.get(target["label"])) for target in targets],
        "units": units,
        "waiting": [{"names": each.names, "says": each.says} for each in waiting(state["backing_off"])],
        "faults": list(map(fault_record, state["faults"])),
        "health": health(state),
    }


def _target(target: Mapping[str, Any], reason: SharedReason | None) -> Record:
    """Add two values to the record of an unmet target: `told`, its reason for a row that names the target already, and
    `as`, the first target that has this reason.
    """
    return {**target} if reason is None else {**target, "told": target_reason(target).rest, "as": reason.labels[0]}
