"""The time that is left, and what each phase took."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Event

from cfgplan.errors import CfgplanError
from cfgplan.planning import Plan, PlannerFaultError, Status

STOPPING_S = 0.5
"""So long after `stop` is set a first plan may still be looked for."""


class OutOfTimeError(Exception):
    """The time is over in the middle of something that is of no use unless it is finished."""


class ContradictionError(Exception):
    """The engine refuses a model, or says that it has no solution where one is known: a bug."""


class Clock:
    """Runs from construction; over at the time limit or when somebody sets `stop`."""

    def __init__(self, time_limit_s: float | None = None, stop: Event | None = None) -> None:
        self._began = self._phase_began = time.monotonic()
        self._limit_s = time_limit_s
        self._stopped: float | None = None
        self.stop = stop or Event()
        self.seconds: dict[str, float] = {}

    def elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def left_s(self) -> float | None:
        """Seconds until the limit, None without one."""
        return None if self._limit_s is None else max(0.0, self._limit_s - self.elapsed_s())

    def is_over(self) -> bool:
        return self.stop.is_set() or self.left_s() == 0.0

    def check(self) -> None:
        """Raise OutOfTimeError after the time limit, or some time after `stop` was seen to be set."""
        if self._limit_s is not None and time.monotonic() - self._began >= self._limit_s:
            raise OutOfTimeError
        if self.stop.is_set():
            if self._stopped is None:
                self._stopped = time.monotonic()
            if time.monotonic() - self._stopped >= STOPPING_S:
                raise OutOfTimeError

    def end(self, phase: str) -> dict[str, float]:
        """Note that a phase ends now; returns the seconds of all phases so far."""
        now = time.monotonic()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._phase_began
        self._phase_began = now
        return self.seconds

    @contextmanager
    def ending(self, so_far: Callable[[], Plan]) -> Iterator[None]:
        """Let the time limit and Ctrl-C end what is done quietly.

        Raises PlannerFaultError with the plan so far, if there is one, where a bug ends it; of that plan nothing counts
        as proven.
        """
        try:
            yield
        except OutOfTimeError:
            pass
        except KeyboardInterrupt:
            self.stop.set()
        except (CfgplanError, OSError, ImportError):
            raise
        except Exception as error:
            found = so_far()
            if found.change_set is None or found.cost_us is None:
                raise
            status = Status.of_plan(found.cost_us, 0)
            unproven = replace(found, status=status, bound_us=0, ties_proven=False, required_proven=False)
            raise PlannerFaultError(
                f"planner {found.planner} failed after it had found a plan: {error}", unproven
            ) from error
