"""The protocols of a manager's parts: the middleware that runs units, the estimator of costs, and the clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

from cfgplan import costs
from cfgplan.domain import ChangeSet, Environment, Host, Transformation
from cfgplan_runtime.supervision.backend import Failures
from cfgplan_runtime.supervision.events import Applied, Event
from cfgplan_runtime.supervision.observation import Observation


class Middleware(Protocol):
    """A system that runs units: `cfgplan_runtime.Runtime`, a simulation, or a robot's own middleware.

    All methods but `listen` and `abandon` are called from the manager's thread only.
    """

    @property
    def environment(self) -> Environment:
        """The running configuration, with gaps at inputs that lost their source; its library and targets are those last
        applied.
        """

    def apply(self, change_set: ChangeSet, *, basis: Environment | None = None, keeps_new: bool = False) -> Applied:
        """Carry out a change set as a whole or not at all; it holds the changes of library and targets too.

        Raises StaleChangeSetError if `basis` differs from the running configuration, ApplyError if a step failed and
        all was undone, NoSourceError for a transformation that can't be started at all. With `keeps_new`, new units
        that have not failed may stay, unconnected, when the rest is undone: the next update need not start them again.
        """

    def abandon(self) -> None:
        """Give up the update under way, if it still waits for new units: `apply` then raises AbandonedError.

        Called from any thread, so that no slow start delays a repair. An update that does not wait is completed, and
        the next one is not affected.
        """

    def observe(self) -> Sequence[Observation]:
        """The present figures of every running unit; upkeep is measured since the last call."""

    def kill(self, unit: str) -> None:
        """End a unit at once; the event UnitDied follows."""

    def listen(self, listener: Callable[[Event], None]) -> None:
        """Call `listener` with every event, in order, from any thread; it returns at once.

        A middleware with hosts reports each at once, by HostJoined or HostLost. At HostLost, the host's units are
        already removed from `environment`, and their ends are not reported.
        """

    def stop(self) -> None:
        """Stop every unit once it has given the results of its input."""


@runtime_checkable
class FailureStore(Protocol):
    """A middleware that keeps failures for the next manager, since its units may outlive the present one."""

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Keep the failures of a transformation on a host for the next manager, which gets them as FailuresKept; None:
        forget them. Called from the manager's thread.
        """


class Estimator(Protocol):
    """The expected cost of starting and running a unit of a transformation.

    `now_s` is on the manager's clock. All methods are called from the manager's thread.
    """

    def observe(self, observations: Sequence[Observation], now_s: float) -> None:
        """Learn from running units; called about once a second and at the beginning of each review."""

    def failed(self, transformation: str, now_s: float, host: str | None = None) -> None:
        """Learn that a unit of a transformation could not start, died, hung or kept failing. `host` is None if it is
        not known where, or if the world has no hosts.
        """

    def labor_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
        """CPU time of one start and of failures, in microseconds. `host` is None if the world has no hosts."""

    def upkeep_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
        """CPU time per second, in microseconds, as the mean over the horizon from now."""


class TimeSource(Protocol):
    """A clock that one can wait on."""

    def now(self) -> float:
        """Seconds on a monotonic clock."""

    def wait(self, waker: threading.Event, timeout_s: float) -> None:
        """Return when `waker` is set, or after `timeout_s`."""


class SystemClock:
    """The computer's clock."""

    def now(self) -> float:
        return time.monotonic()

    def wait(self, waker: threading.Event, timeout_s: float) -> None:
        waker.wait(timeout_s)


class DeclaredCosts:
    """Estimates costs as the environment declares them, whatever is observed.

    Each failure on a host within the last `forget_s` seconds, except the first, adds `failure_us` to the labor there.
    """

    def __init__(self, *, failure_us: int = 1_000_000, forget_s: float = 600.0) -> None:
        self._failure_us = failure_us
        self._forget_s = forget_s
        self._failures: dict[tuple[str, str | None], list[float]] = {}
        """The times of failures by transformation and host."""
        self._now_s = 0.0

    def observe(self, observations: Sequence[Observation], now_s: float) -> None:  # noqa: ARG002
        self._now_s = now_s

    def failed(self, transformation: str, now_s: float, host: str | None = None) -> None:
        self._now_s = now_s
        recent = [at for at in self._failures.get((transformation, host), ()) if now_s - at < self._forget_s]
        self._failures[transformation, host] = [*recent, now_s]

    def labor_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:  # noqa: ARG002
        places = {None, None if host is None else host.name}
        failures = (at for place in places for at in self._failures.get((transformation.label, place), ()))
        recent = sum(1 for at in failures if self._now_s - at < self._forget_s)
        return costs.labor_us(transformation, host) + self._failure_us * max(0, recent - 1)

    def upkeep_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:  # noqa: ARG002
        return costs.upkeep_us(transformation, host)
