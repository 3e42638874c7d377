"""The runtime as its users see it: a supervisor of processes in a thread of its own."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from cfgplan.domain import ChangeSet, Environment, Target, Transformation
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.processes.process_backend import ProcessBackend
from cfgplan_runtime.supervision.applying import Patience
from cfgplan_runtime.supervision.events import SIGNS, Applied, Event
from cfgplan_runtime.supervision.observation import Observation
from cfgplan_runtime.supervision.run_log import RunLog
from cfgplan_runtime.supervision.supervisor import Supervisor

T = TypeVar("T")

_MOST_EVENTS = 10_000


class Runtime:
    """Runs units of a library and changes them by change sets; a context manager that leaves nothing behind.

    `folder` is what `units.py:Class` is relative to; `preload` names modules that units import, so that
    they start faster. Every event but signs of life goes to the log, if any, and to `events`, which is bounded:
    what nobody fetches is thrown away, oldest first.
    """

    def __init__(
        self,
        library: Iterable[Transformation] = (),
        targets: Iterable[Target] = (),
        *,
        folder: str | Path | None = None,
        preload: Sequence[str] = (),
        log: str | Path | None = None,
    ) -> None:
        self.events: queue.Queue[Event] = queue.Queue(_MOST_EVENTS)
        self._environment = Environment(library=tuple(library), targets=tuple(targets))
        self._folder = None if folder is None else Path(folder)
        self._preload = tuple(preload)
        self._log = None if log is None else RunLog(Path(log))
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._listeners: tuple[Callable[[Event], None], ...] = ()
        self._is_closing = False
        self._started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, name="cfgplan-supervisor", daemon=True)
        self._thread.start()
        self._started.result()

    @property
    def id(self) -> str:
        """The run's id, which tells its topics from those of other runs."""
        return self._backend.run_folder.id

    @property
    def environment(self) -> Environment:
        """What runs now."""
        return self._supervisor.environment

    def apply(
        self,
        change_set: ChangeSet,
        *,
        id: str | None = None,  # noqa: A002
        basis: Environment | None = None,
        patience: Patience | None = None,
    ) -> Applied:
        """Carry out a change set as a whole or not at all; see `Supervisor.apply`."""
        return self._call(lambda: self._supervisor.apply(change_set, id=id, basis=basis, patience=patience))

    def attempt(self, change_set: ChangeSet, *, basis: Environment | None = None) -> Applied:
        """As `apply`, but new units that have not failed stay when the update is undone, unconnected."""
        return self._call(lambda: self._supervisor.apply(change_set, basis=basis, keeps_new=True))

    def observe(self) -> tuple[Observation, ...]:
        """Every running unit as it is now; upkeep is over the time since the last call."""
        return self._call(self._supervisor.observe)

    def listen(self, listener: Callable[[Event], None]) -> None:
        """Have every event told, signs of life too, in order, from the supervisor's thread; it returns at once."""
        self._listeners = (*self._listeners, listener)

    def abandon(self) -> None:
        """Give up the update under way if it still waits for new units: it is undone. For any thread."""
        self._supervisor.abandon()
        self._backend.wake()

    def kill(self, unit: str) -> None:
        """End a unit at once; UnitDied follows. Does nothing if it does not run."""
        self._call(lambda: self._backend.kill(unit))

    def cut(self, unit: str | None, port: str) -> None:
        """Take away what feeds an input, or a topic (`unit` is None), as if it had been lost. Raises KeyError."""
        self._call(lambda: self._supervisor.cut(unit, port))

    def pid(self, unit: str) -> int | None:
        """The process id of a unit."""
        return self._call(lambda: self._backend.pid(unit))

    def stop(self) -> None:
        """Stop every unit, letting each give what it has taken in."""
        stopped = tuple(unit.id for unit in self.environment.units)
        if stopped:
            self.apply(ChangeSet(stopped=stopped))

    def close(self) -> None:
        """End every process of the run, and remove its folder, whatever is under way. Does nothing the second time."""
        self._is_closing = self._supervisor.is_ending = True
        self._backend.wake()
        self._thread.join()
        if self._log is not None:
            self._log.close()

    def __enter__(self) -> Runtime:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        try:
            self._backend = ProcessBackend(folder=self._folder, preload=self._preload)
            self._supervisor = Supervisor(self._backend, self._environment, self._report)
        except BaseException as error:
            self._started.set_exception(error)
            return
        self._started.set_result(None)
        try:
            while not self._is_closing:
                self._supervisor.pump(1.0)
                with contextlib.suppress(queue.Empty):
                    while True:
                        self._work.get_nowait()()
        finally:
            self._backend.close()
            self._is_closing = True
            with contextlib.suppress(queue.Empty):
                while True:
                    self._work.get_nowait()()

    def _call(self, work: Callable[[], T]) -> T:
        """Have the supervisor's thread do something, and give back what it returns or raises."""
        future: Future[T] = Future()

        def do() -> None:
            if self._is_closing:
                future.set_exception(RuntimeFaultError("the runtime is closed"))
                return
            try:
                future.set_result(work())
            except BaseException as error:
                future.set_exception(error)

        if not self._thread.is_alive():
            raise RuntimeFaultError("the runtime is closed")
        self._work.put(do)
        self._backend.wake()
        return future.result()

    def _report(self, event: Event) -> None:
        for listener in self._listeners:
            listener(event)
        if self._log is not None:
            self._log.write(event)
        while not isinstance(event, SIGNS):
            try:
                self.events.put_nowait(event)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self.events.get_nowait()
