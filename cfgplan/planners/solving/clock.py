"""The remaining time, the tuning that divides it, and the time of each phase."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from math import inf
from threading import Event
from typing import TypeVar

from cfgplan.errors import CfgplanError
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planning import Plan, PlannerFaultError, Problem

STOPPING_S = 10.0
"""For so long after `stop` a first plan may still be looked for, if there is none yet."""
FIRST_PLAN_S, FIRST_PLAN_PART_S = 1.0, 0.0002
"""Seconds of CPU time for a first plan after the limit: in all, and for each transformation, unit and host."""
_SLOWEST = 20.0
"""A second of CPU time may take so many seconds on a busy computer."""

Item = TypeVar("Item")


class OutOfTimeError(Exception):
    """The time ran out in the middle of work that is of no use unless it is finished."""


class ContradictionError(Exception):
    """The engine refuses a model, or says that it has no solution where one is known: a bug."""


class Clock:
    """A clock that runs from construction. It is over at the time limit, or when `stop` is set."""

    def __init__(self, time_limit_s: float | None = None, stop: Event | None = None, tuning: Tuning = USUAL) -> None:
        self._began = self._phase_began = time.monotonic()
        self._limit_s = None if time_limit_s == inf else time_limit_s
        self._stopped: float | None = None
        self._cpu_end_s: float | None = None
        self.tuning = tuning
        self.stop = stop or Event()
        self.has_plan = False
        """Whether there is a plan already: if so, `stop` ends the search at once."""
        self.seconds: dict[str, float] = {}
        self.is_interrupted = False
        """Whether Ctrl-C was pressed: the next one ends the plan."""

    def with_limit(self, time_limit_s: float | None, tuning: Tuning) -> Clock:
        """A clock that began when this one did, for a plan that has another limit and has found nothing yet."""
        other = copy(self)
        other._limit_s = None if time_limit_s == inf else time_limit_s
        other._stopped, other.has_plan = None, False
        other.tuning, other.seconds = tuning, {**self.seconds}
        return other

    def for_a_first_plan(self, problem: Problem) -> Clock:
        """A clock with the start of this one, over once a plan is known or after the CPU time of a first plan.

        So the load of the computer does not decide whether a plan is found.
        """
        environment = problem.environment
        parts = len(environment.library) + len(environment.units) + len(environment.hosts)
        other = self.with_limit(None, self.tuning)
        other._cpu_end_s = time.process_time() + FIRST_PLAN_S + FIRST_PLAN_PART_S * parts
        return other

    def elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def left_s(self) -> float | None:
        """Seconds until the limit, None without one."""
        if self._cpu_end_s is not None:
            return 0.0 if self.has_plan else max(0.0, (self._cpu_end_s - time.process_time()) * _SLOWEST)
        return None if self._limit_s is None else max(0.0, self._limit_s - self.elapsed_s())

    def has_steps(self, steps: float) -> bool:
        """Whether there is time for so many steps."""
        left_s = self.left_s()
        return not self.is_over() and (left_s is None or steps * self.tuning.seconds_per_step < left_s)

    def is_over(self) -> bool:
        return self.stop.is_set() or self.left_s() == 0.0

    def each(self, items: Iterable[Item], at_once: int = 64) -> Iterator[Item]:
        """The items, with a look at the clock before the first and after every `at_once` of them.

        Raises OutOfTimeError after the time limit or `stop`, which leaves some time for a first plan.
        """
        for number, item in enumerate(items):
            if not number % at_once:
                self._check()
            yield item

    def _check(self) -> None:
        if self.left_s() == 0.0:
            raise OutOfTimeError
        if self.stop.is_set():
            if self._stopped is None:
                self._stopped = time.monotonic()
            if self.has_plan or time.monotonic() - self._stopped >= STOPPING_S:
                raise OutOfTimeError

    def interrupt(self) -> None:
        """Take note of Ctrl-C in the handler of a KeyboardInterrupt, which is raised again if it is the second one."""
        if self.is_interrupted:
            raise
        self.is_interrupted = True
        self.stop.set()

    def end(self, phase: str) -> dict[str, float]:
        """Note that a phase ends now; returns the seconds of all phases so far. A first Ctrl-C here loses no plan."""
        try:
            now = time.monotonic()
        except KeyboardInterrupt:
            self.interrupt()
            now = time.monotonic()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._phase_began
        self._phase_began = now
        return self.seconds

    def run(self, work: Callable[[], None], so_far: Callable[[], Plan]) -> None:
        """Work until that ends or the time is over. After Ctrl-C without a plan it begins again, to find one soon.

        A second Ctrl-C raises KeyboardInterrupt. If a bug ends the work, PlannerFaultError with the plan so far is
        raised, if there is one.
        """
        try:
            try:
                work()
            except KeyboardInterrupt:
                self.interrupt()
                if not self.has_plan:
                    work()
        except OutOfTimeError:
            pass
        except (CfgplanError, OSError, ImportError):
            raise
        except Exception as error:
            found = so_far()
            if found.change_set is None:
                raise
            raise PlannerFaultError(
                f"planner {found.planner} failed after it had found a plan: {error}", found
            ) from error
