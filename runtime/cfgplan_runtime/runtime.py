"""The runtime for its users: a supervisor with a backend, and the thread in which it works."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Protocol, TypeVar

from cfgplan.domain import ChangeSet, Environment, Stream, Target, Transformation
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.supervision.backend import Backend, Failures
from cfgplan_runtime.supervision.events import SIGNS, Applied, Event
from cfgplan_runtime.supervision.listeners import Listeners
from cfgplan_runtime.supervision.observation import Observation
from cfgplan_runtime.supervision.run_log import RunLog
from cfgplan_runtime.supervision.simulated_backend import Behaviour, SimulatedBackend
from cfgplan_runtime.supervision.supervisor import Follower, Supervisor
from cfgplan_runtime.supervision.updates import Patience

T = TypeVar("T")

_MOST_EVENTS = 10_000
_LOOK_S = 0.5
"""The longest wait in seconds: Python handles a signal that comes just before a wait only after it."""


class Executor(Protocol):
    """The thread in which a supervisor works."""

    def begin(self, make: Callable[[], Supervisor]) -> Supervisor:
        """Make the supervisor in the executor's thread, and let it work from then on."""

    def call(self, work: Callable[[], T]) -> T:
        """Call `work` in the executor's thread; raises its exceptions, and RuntimeFaultError after the end."""

    def close(self) -> None:
        """End the supervisor's work and its backend, also during an update. A second call does nothing."""


class OwnThread:
    """A thread that makes the supervisor, and works until `close`."""

    def __init__(self) -> None:
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._made: Future[Supervisor] = Future()

    def begin(self, make: Callable[[], Supervisor]) -> Supervisor:
        self._thread = threading.Thread(target=self._run, args=(make,), name="cfgplan-supervisor", daemon=True)
        try:
            self._thread.start()
            self._supervisor = _result(self._made)
        except BaseException:
            if not self._made.cancel() and self._made.exception() is None:
                self._made.result().end()
            raise
        return self._supervisor

    def call(self, work: Callable[[], T]) -> T:
        future: Future[T] = Future()

        def do() -> None:
            if self._supervisor.is_ending:
                future.set_exception(RuntimeFaultError("the runtime is closed"))
                return
            try:
                future.set_result(work())
            except BaseException as error:
                future.set_exception(error)

        self._work.put(do)
        self._supervisor.backend.wake()
        if self._supervisor.is_ending:  # perhaps nobody looks any more
            self._thread.join()
            self._run_pending_calls()
        return _result(future)

    def close(self) -> None:
        self._supervisor.end()
        self._thread.join()

    def _run(self, make: Callable[[], Supervisor]) -> None:
        try:
            supervisor = make()
        except BaseException as error:
            if self._made.set_running_or_notify_cancel():
                self._made.set_exception(error)
            return
        if not self._made.set_running_or_notify_cancel():  # the call of `begin` was interrupted
            supervisor.backend.close()
            return
        self._made.set_result(supervisor)
        try:
            while not supervisor.is_ending:
                supervisor.pump(1.0)
                self._run_pending_calls()
        finally:
            supervisor.is_ending = True
            supervisor.backend.close()
            self._run_pending_calls()

    def _run_pending_calls(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                self._work.get_nowait()()


def _result(future: Future[T]) -> T:
    """Wait for a future, and return its result or raise its exception."""
    while not future.done():
        wait((future,), _LOOK_S)
    return future.result()


class Inline:
    """The calling thread, which is the clock too: time passes only in `wait`."""

    def begin(self, make: Callable[[], Supervisor]) -> Supervisor:
        self._supervisor = make()
        return self._supervisor

    def call(self, work: Callable[[], T]) -> T:
        if self._supervisor.is_ending:
            raise RuntimeFaultError("the runtime is closed")
        return work()

    def close(self) -> None:
        self._supervisor.end()
        self._supervisor.backend.close()

    def now(self) -> float:
        """Seconds on the backend's clock."""
        return self._supervisor.backend.now()

    def wait(self, waker: threading.Event, timeout_s: float) -> None:
        """Handle due events until `waker` is set, or `timeout_s` seconds have passed."""
        end = self.now() + timeout_s
        while not waker.is_set() and self.now() < end:
            self._supervisor.pump(end - self.now())


class Runtime(Closable):
    """Runs units of a `library` for `targets`, and changes them by change sets; a context manager that leaves nothing
    behind.

    `backend` makes the backend that runs the units, and `executor` gives the thread in which it works: by default
    processes of this computer and a thread of its own. For processes, sources such as `units.py:Class` are relative to
    `folder`, and `preload` names modules that units import, so that they start faster. Every event except signs of life
    goes to the file `log`, if any, and to `events`, a bounded queue from which the oldest are dropped.
    """

    def __init__(
        self,
        library: Iterable[Transformation] = (),
        targets: Iterable[Target] = (),
        *,
        folder: str | Path | None = None,
        preload: Sequence[str] = (),
        log: str | Path | None = None,
        backend: Callable[[], Backend] | None = None,
        executor: Executor | None = None,
    ) -> None:
        self.events: queue.Queue[Event] = queue.Queue(_MOST_EVENTS)
        self._log = None if log is None else RunLog(Path(log))
        self._listeners: Listeners[Event] = Listeners()
        self._abandons: list[threading.Event] = []
        """For each update that is not over: set if it is given up."""
        self._executor = executor or OwnThread()
        environment = Environment(library=tuple(library), targets=tuple(targets))
        make = backend or (lambda: _processes(None if folder is None else Path(folder), tuple(preload)))
        self.supervisor = self._executor.begin(lambda: Supervisor(make(), environment, self._report))

    @property
    def id(self) -> str:
        """The run's id, which distinguishes its topics from those of other runs."""
        return self.supervisor.backend.id

    @property
    def environment(self) -> Environment:
        """The running configuration, with the library and the targets."""
        return self.supervisor.environment

    def apply(
        self,
        change_set: ChangeSet,
        *,
        id: str | None = None,  # noqa: A002
        basis: Environment | None = None,
        patience: Patience | None = None,
        keeps_new: bool = False,
    ) -> Applied:
        """Carry out `change_set` as a whole or not at all; the same `id` is carried out once.

        `basis` is the environment that it was planned for; `patience` limits the steps. Raises StaleChangeSetError if
        the basis differs from the running configuration, or the change set names units that do not run; ApplyError if a
        step failed and all was undone. With `keeps_new`, new units that have not failed then stay, unconnected
        and paused.
        """
        is_abandoned = threading.Event()
        self._abandons.append(is_abandoned)
        more = {"basis": basis, "patience": patience, "keeps_new": keeps_new, "is_abandoned": is_abandoned.is_set}
        try:
            return self._executor.call(lambda: self.supervisor.apply(change_set, id=id, **more))  # type: ignore[arg-type]
        finally:
            self._abandons.remove(is_abandoned)

    def observe(self) -> tuple[Observation, ...]:
        """The present figures of every running unit; upkeep is measured since the last call."""
        return self._executor.call(self.supervisor.observe)

    def listen(self, listener: Callable[[Event], None]) -> None:
        """Call `listener` with every event, signs of life too, in order, from the supervisor's thread; returns at once.

        It first gets the last event of each host, whether the host is lost or has joined, one for each prepared cold
        spare, and those about the units and failures that an earlier manager has left.
        """

        def begin() -> None:
            supervisor = self.supervisor
            for last in (*supervisor.hosts.values(), *supervisor.spares.prepared, *supervisor.kept):
                listener(last)
            self._listeners.add(listener)

        self._executor.call(begin)

    def await_follower(self, follower: Follower) -> None:
        """Let updates wait for a follower of topics before they connect units to a topic that has no source.

        They wait up to `follow_s` of their patience. The follower is called with the topics, in the supervisor's
        thread.
        """

        def add() -> None:
            self.supervisor.followers = (*self.supervisor.followers, follower)

        self._executor.call(add)

    def abandon(self) -> None:
        """Give up the updates that still wait for new units; they are undone. Thread-safe."""
        for update in list(self._abandons):
            update.set()
        self.supervisor.backend.wake()

    def kill(self, unit: str) -> None:
        """End a unit at once; UnitDied follows. Does nothing if it does not run."""
        self._executor.call(lambda: self.supervisor.backend.kill(unit))

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Keep the `failures` of the transformation `label` on a `host` for the next manager, if units outlive this
        one; None: forget them.
        """
        self._executor.call(lambda: self.supervisor.remember(label, host, failures))

    def cut(self, unit: str | None, port: str) -> None:
        """Remove the stream of the input `port`, or of the topic `port` (`unit` is None), as if it had been lost.

        Raises KeyError if it has none.
        """
        self._executor.call(lambda: self.supervisor.cut(unit, port))

    def tap(self, stream: Stream) -> str:
        """Show a unit's stream on a topic of its own until `untap`, and return the topic.

        A call for an open tap connects it again: the unit may have been replaced by another of the same name.
        """
        return self._executor.call(lambda: self.supervisor.taps.open(stream))

    def untap(self, stream: Stream) -> None:
        """Remove the topic that `tap` has made. Does nothing without one."""
        self._executor.call(lambda: self.supervisor.taps.close(stream))

    def pid(self, unit: str) -> int | None:
        """The process id of a unit."""
        return self._executor.call(lambda: self.supervisor.backend.pid(unit))

    def stop(self) -> None:
        """Stop every unit; each first sends the results of the elements that it has received."""
        stopped = tuple(unit.id for unit in self.environment.units)
        if stopped:
            self.apply(ChangeSet(stopped=stopped))

    def close(self) -> None:
        """End every process of the run, and remove its folder, also during an update. A second call does nothing."""
        self._executor.close()
        if self._log is not None:
            self._log.close()

    def _report(self, event: Event) -> None:
        self._listeners.tell(event)
        if self._log is not None:
            self._log.write(event)
        while not isinstance(event, SIGNS):
            try:
                self.events.put_nowait(event)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self.events.get_nowait()


class SimulatedRuntime(Runtime):
    """A runtime of a `library` and `targets` with simulated units. Give its `clock` to the manager, without a thread.

    `behaviours` are by transformation, or by `TRANSFORMATION on HOST` for one host.
    """

    def __init__(
        self,
        library: Iterable[Transformation] = (),
        targets: Iterable[Target] = (),
        *,
        behaviours: Mapping[str, Behaviour] | None = None,
    ) -> None:
        self.backend = SimulatedBackend(dict(behaviours or {}))
        self.clock = Inline()
        super().__init__(library, targets, backend=lambda: self.backend, executor=self.clock)


def _processes(folder: Path | None, preload: Sequence[str]) -> Backend:
    from cfgplan_runtime.processes.process_backend import ProcessBackend  # not to be had on Windows

    return ProcessBackend(folder=folder, preload=preload)
