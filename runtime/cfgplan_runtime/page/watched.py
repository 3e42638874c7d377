"""The messages for viewers of a run, fetched once for all viewers, and only while a page is open."""

from __future__ import annotations

import json
import threading
import time
from asyncio import AbstractEventLoop, Queue
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

from cfgplan.domain import (
    A_UNIT_OF,
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    Target,
)
from cfgplan.drawing import picture
from cfgplan.formats.dump import unit_of
from cfgplan_runtime.errors import ControlError
from cfgplan_runtime.operating.control_client import Control
from cfgplan_runtime.operating.protocol import Record

FRAME_S = 0.1
"""Seconds from one state message to the next."""
MARKED_S = 5.0
"""Seconds for which the picture marks what an update has changed."""
_MOST_NEWS = 100
_MOST_WAITING = 200
"""The most messages that wait for a viewer; older ones are dropped."""
_RUN_S = 10.0
_REVIEWED_S = 80.0
"""Seconds that a change may take: it is answered when its review is over."""

ToViewer = tuple[str, str]
"""A kind and its data as JSON."""


class Watched:
    """Fetches the state of a run for its viewers. `reach` connects to the run's control socket."""

    def __init__(self, reach: Callable[[], Control]) -> None:
        self._reach = reach
        self._lock = threading.Lock()
        self._viewers: dict[Queue[ToViewer], AbstractEventLoop] = {}
        self._somebody_looks = threading.Event()
        self._events: deque[ToViewer] = deque(maxlen=_MOST_NEWS)
        self._picture: ToViewer | None = None
        self._end: ToViewer | None = None
        self._wanted: tuple[Environment, Environment] | None = None
        self._is_wanted = threading.Condition(self._lock)
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
        for work in (lambda: self._hear(events), lambda: self._look(states), self._draw):
            threading.Thread(target=self._until_the_end, args=(work,), daemon=True).start()

    def close(self) -> None:
        """Tell all threads to end."""
        self.has_ended.set()
        self._somebody_looks.set()
        for control in self._controls:
            control.hang_up()

    @contextmanager
    def viewer(self, loop: AbstractEventLoop) -> Iterator[Queue[ToViewer]]:
        """Give a queue of messages for one viewer: the picture, the last events, the end if the run is over, news."""
        messages: Queue[ToViewer] = Queue()
        with self._lock:
            for message in (self._picture, *self._events, self._end):
                if message is not None:
                    messages.put_nowait(message)
            self._viewers[messages] = loop
            self._somebody_looks.set()
        try:
            yield messages
        finally:
            with self._lock:
                del self._viewers[messages]
                if not self._viewers:
                    self._somebody_looks.clear()

    def call(self, method: str, params: dict[str, Any]) -> Any:
        """Call a method of the run's control socket. Raises RefusedError and ControlError."""
        with self._reach() as control:
            return control.call(method, timeout_s=_REVIEWED_S, **params)

    def _until_the_end(self, work: Callable[[], None]) -> None:
        try:
            work()
        finally:
            if not self.has_ended.is_set():
                self.has_ended.set()
                self._tell(("ended", "null"))

    def _hear(self, control: Control) -> None:
        with control:
            for event in control.events():
                message = ("event", json.dumps({"at": time.time(), **event}))
                if event.get("says") is not None:
                    self._tell(message)

    def _look(self, control: Control) -> None:
        shown: Environment | None = None
        reviewed, marked_s = None, 0.0
        with control, suppress(ControlError):
            while not self.has_ended.is_set():
                self._somebody_looks.wait()
                began_s = time.monotonic()
                state = control.call("state", timeout_s=_RUN_S)
                now = configuration(state)
                last = state["reviews"][-1] if state["reviews"] else None
                if shown is None or now != shown or (last and last["number"] != reviewed):
                    # A unit that died and is there again may be the same at both looks.
                    fresh = anew(last) if shown and last and last["number"] != reviewed else ()
                    self._want(without(shown or now, fresh), now)
                    marked_s, shown = began_s + MARKED_S, now
                    reviewed = last and last["number"]
                elif marked_s and began_s > marked_s:
                    self._want(now, now)
                    marked_s = 0.0
                self._tell(("state", json.dumps(state)))
                time.sleep(max(0.0, FRAME_S - (time.monotonic() - began_s)))

    def _want(self, before: Environment, now: Environment) -> None:
        with self._is_wanted:
            self._wanted = (before, now)
            self._is_wanted.notify()

    def _draw(self) -> None:
        """Draw the latest wanted picture, again and again: a large one takes longer than a frame."""
        while not self.has_ended.is_set():
            with self._is_wanted:
                self._is_wanted.wait_for(lambda: self._wanted is not None, timeout=1.0)
                wanted, self._wanted = self._wanted, None
            if wanted is not None:
                self._tell(("picture", json.dumps(svg(*wanted))))

    def _tell(self, message: ToViewer) -> None:
        """Send a message to all viewers, once each, and keep it if later viewers need it too."""
        with self._lock:
            if message[0] == "event":
                self._events.append(message)
            elif message[0] == "picture":
                self._picture = message
            elif message[0] == "ended":
                self._end = message
            viewers = list(self._viewers.items())
        for messages, loop in viewers:
            with suppress(RuntimeError):  # its loop has just been closed
                loop.call_soon_threadsafe(_put, messages, message)


def _put(messages: Queue[ToViewer], message: ToViewer) -> None:
    while messages.qsize() >= _MOST_WAITING:
        messages.get_nowait()
    messages.put_nowait(message)


def configuration(state: Record) -> Environment:
    """The units and targets of a run's state (`cfgplan/manual/control.md`), without any library."""
    units = tuple(map(unit_of, state["units"]))
    return Environment(units, targets=tuple(map(_target, state["targets"])), hosts=_hosts(units))


def anew(review: Record) -> tuple[str, ...]:
    """The ids of the units that a review has started."""
    return tuple(unit["id"] for unit in (review["change_set"] or {"started": ()})["started"])


def without(environment: Environment, units: Collection[str]) -> Environment:
    """The environment without some units. Inputs that they fed still name them."""
    return replace(environment, units=tuple(unit for unit in environment.units if unit.id not in units))


def svg(before: Environment, now: Environment) -> str:
    """The running configuration as SVG, with the units started, rewired and stopped since `before` marked."""
    there, was = now.unit, before.unit
    changes = ChangeSet(
        started=tuple(unit for unit in now.units if unit.id not in was),
        rewired=tuple(unit for unit in now.units if unit.id in was and was[unit.id] != unit),
        stopped=tuple(unit.id for unit in before.units if unit.id not in there),
    )
    hosts = _hosts((*before.units, *now.units))
    text = picture(Environment(before.units, targets=now.targets, hosts=hosts), changes).render("svg").decode()
    return text[text.index("<svg") :]


def _hosts(units: Iterable[ComputationUnit]) -> tuple[Host, ...]:
    return tuple(map(Host, sorted({unit.host for unit in units if unit.host is not None})))


def _target(target: Record) -> Target:
    if not target["topic"]:
        return Target(target["label"], run=target["tag"].removeprefix(A_UNIT_OF))
    return Target(target["label"], target["tag"], target["topic"], target["priority"])
