"""Carrying out one change set, as a whole or not at all: start, rewire, then stop; or undo it in reverse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from cfgplan.domain import ChangeSet, Environment
from cfgplan.errors import InvalidValueError
from cfgplan_runtime.errors import (
    AbandonedError,
    ApplyError,
    NoSourceError,
    RuntimeFaultError,
    StaleChangeSetError,
)
from cfgplan_runtime.supervision.events import Applied
from cfgplan_runtime.supervision.wiring import (
    Wire,
    starved_units,
    wanted_feeds,
    wanted_topics,
    without_feed,
    without_unit,
)

if TYPE_CHECKING:
    from cfgplan_runtime.supervision.supervisor import Supervisor


@dataclass(frozen=True, slots=True)
class Patience:
    """How long the steps of an update may take, in seconds.

    An input whose new source gives nothing for `switch_s` goes over to it when the old one is taken away.
    """

    start_s: float = 30.0
    switch_s: float = 2.0
    stop_s: float = 2.0
    kill_s: float = 10.0


@dataclass
class Applying:
    """One change set on its way."""

    supervisor: Supervisor
    change_set: ChangeSet
    id: str
    patience: Patience
    keeps_new: bool = False
    """Whether new units that have not failed run on, unconnected, when the update is undone."""
    after: Environment = field(init=False)
    wires: list[Wire] = field(default_factory=list)
    opened: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def check(self) -> None:
        """Raises StaleChangeSetError if the change set does not fit what runs, NoSourceError if there is no code."""
        try:
            after = self.after = self.supervisor.environment.update(self.change_set)
        except InvalidValueError as error:
            raise StaleChangeSetError(f"the change set does not fit what runs now: {error}") from None
        labels = sorted({unit.transformation for unit in self.change_set.started})
        without = [
            label for label in labels if label in after.transformation and not after.transformation[label].source
        ]
        if without:
            mend = "add `source: package.module:Class` or `source: units.py:Class`"
            raise NoSourceError(
                f"{', '.join(map(repr, without))} can't be started without unit code: {mend}",
                without,
                f"it has no unit code: {mend}",
            )
        for fault in self._faults():
            raise StaleChangeSetError(f"the change set does not fit what runs now: {fault}")

    def carry_out(self) -> Applied:
        """Raises ApplyError when a step failed and all was undone."""
        try:
            self._timed("start", self._start)
            self._timed("rewire", self._rewire)
        except _StepFailedError as error:
            self._undo(failed=error.units)
            kind = AbandonedError if error.is_abandoned else ApplyError
            raise kind(f"the update was undone: {error}", error.units) from None
        late = self._unswitched()
        for wire in late:
            if wire.replaces is not None and wire.replaces.stream.unit not in self.change_set.stopped:
                self.supervisor.backend.switch_now(wire.inlet)
        self._timed("stop", lambda: self._stop(self.change_set.stopped))
        self._wait(lambda: not self._unswitched(), self.patience.stop_s)
        self._close_outlets(self.supervisor.outlets - wanted_topics(self.after))
        self.supervisor.wiring.settle()
        self.supervisor.environment = self._as_it_lives()
        return Applied(self.id, self.seconds, len(late))

    def _faults(self) -> list[str]:
        after, faults = self.after, []
        for unit in (*self.change_set.started, *self.change_set.rewired):
            transformation = after.transformation.get(unit.transformation)
            if transformation is None:
                faults.append(f"unit {unit.id!r} has no transformation {unit.transformation!r} in the library")
                continue
            faults += [
                f"{transformation.label!r} has no input {s.port!r}"
                for s in unit.subscriptions
                if s.port not in transformation.input
            ]
        for inlet, stream in wanted_feeds(after).items():
            unit_of_stream = after.unit.get(stream.unit)
            producer = after.transformation.get(unit_of_stream.transformation) if unit_of_stream else None
            if producer is None or stream.port not in producer.output:
                faults.append(f"{inlet} needs the stream {stream}, which nothing gives afterwards")
        return faults

    def _start(self) -> None:
        supervisor, started = self.supervisor, [unit.id for unit in self.change_set.started]
        for topic in sorted(wanted_topics(self.after) - supervisor.outlets):
            self.opened.append(topic)
            supervisor.outlets.add(topic)
            supervisor.backend.open_outlet(topic)
        for unit in self.change_set.started:
            supervisor.start(unit, self.after.transformation[unit.transformation])
        awaited = set(started).union(self._wired() & supervisor.alive - supervisor.ready)
        self._wait(
            lambda: self._dead(started) is not None or not self._loading(awaited) or supervisor.is_abandoned,
            self.patience.start_s,
        )
        self._fail_if_dead(started)
        slow = self._loading(awaited)
        if slow and supervisor.is_abandoned:
            raise _StepFailedError(f"it was given up while {', '.join(slow)} was starting", slow, is_abandoned=True)
        if slow:
            raise _StepFailedError(f"{', '.join(slow)} was not ready within {self.patience.start_s:g} s", slow)

    def _rewire(self) -> None:
        wiring, started = self.supervisor.wiring, [unit.id for unit in self.change_set.started]
        wanted = wanted_feeds(self.after)
        for inlet, stream in wanted.items():
            if not inlet.is_outlet and inlet.unit not in self.supervisor.alive:
                continue  # it has died meanwhile
            fed = wiring.feeds.get(inlet)
            if fed is None or fed.stream != stream:
                self.wires.append(wiring.connect(stream, inlet, self.after))
        idle = starved_units(self.supervisor.environment) | self.supervisor.dry_units()
        starved = idle.intersection(self.change_set.stopped)
        self._wait(
            lambda: self._dead(started) is not None or all(_waits_for(wire, starved) for wire in self._unswitched()),
            self.patience.switch_s,
        )
        self._fail_if_dead(started)
        for inlet in [inlet for inlet in wiring.feeds if inlet not in wanted]:
            if inlet.unit not in self.change_set.stopped:
                wiring.disconnect(inlet)

    def _stop(self, units: tuple[str, ...]) -> None:
        supervisor = self.supervisor
        for unit in units:
            supervisor.stop(unit)
            if unit not in supervisor.ready:
                supervisor.backend.kill(unit)  # it does not listen yet
        self._wait(lambda: supervisor.alive.isdisjoint(units), self.patience.stop_s)
        for unit in sorted(supervisor.alive.intersection(units)):
            supervisor.backend.kill(unit)
        self._wait(lambda: supervisor.alive.isdisjoint(units), self.patience.kill_s)

    def _undo(self, failed: list[str]) -> None:
        """Let the inputs that are to stay go back, and only then take the new units away: until then they are fed."""
        supervisor, started = self.supervisor, tuple(unit.id for unit in self.change_set.started)
        kept = supervisor.alive.intersection(started).difference(failed) if self.keeps_new else set()
        environment = supervisor.environment = self._with_unconnected(kept)
        staying = [wire for wire in reversed(self.wires) if wire.inlet.unit not in started]
        back = [supervisor.wiring.take_back(wire, environment, supervisor.alive) for wire in staying]
        self.wires = [wire for wire in back if wire is not None]
        self._wait(lambda: not self._unswitched(), self.patience.switch_s)
        for wire in self._unswitched():
            supervisor.backend.switch_now(wire.inlet)
        for inlet in [inlet for inlet in supervisor.wiring.feeds if inlet.unit in kept]:
            supervisor.wiring.disconnect(inlet)
        self._stop(tuple(sorted({*started, *failed}.difference(kept))))
        for unit in failed:
            supervisor.environment = without_unit(supervisor.environment, unit)
        self._close_outlets(set(self.opened))
        supervisor.wiring.settle()

    def _close_outlets(self, topics: set[str]) -> None:
        for topic in sorted(topics):
            self.supervisor.outlets.discard(topic)
            self.supervisor.backend.close_outlet(topic)

    def _unswitched(self) -> list[Wire]:
        alive = self.supervisor.alive
        return [
            wire
            for wire in self.wires
            if not wire.has_switched
            and self.supervisor.wiring.feeds.get(wire.inlet) is wire
            and (wire.inlet.is_outlet or wire.inlet.unit in alive)
        ]

    def _with_unconnected(self, kept: set[str]) -> Environment:
        """The environment that was, with some of the new units, which neither feed anything nor are fed."""
        before = self.supervisor.environment
        new = tuple(
            replace(unit, subscriptions=(), publications=()) for unit in self.change_set.started if unit.id in kept
        )
        labels = {unit.transformation for unit in new}.difference(before.transformation)
        library = tuple(self.after.transformation[label] for label in sorted(labels))
        return replace(before, units=(*before.units, *new), library=(*before.library, *library))

    def _wired(self) -> set[str]:
        """The units that feed something afterwards, or are fed."""
        wanted = wanted_feeds(self.after)
        return {stream.unit for stream in wanted.values()}.union(inlet.unit for inlet in wanted)

    def _loading(self, units: set[str]) -> list[str]:
        """Those of these units that are not ready yet."""
        return sorted(units & self.supervisor.alive - self.supervisor.ready)

    def _as_it_lives(self) -> Environment:
        """The environment that was wanted, less what has died or been lost meanwhile."""
        environment = self.after
        for unit in self.after.units:
            if unit.id not in self.supervisor.alive:
                environment = without_unit(environment, unit.id)
        for inlet in wanted_feeds(environment):
            if inlet not in self.supervisor.wiring.feeds:
                environment = without_feed(environment, inlet)
        return environment

    def _dead(self, units: list[str]) -> str | None:
        return next((unit for unit in units if unit not in self.supervisor.alive), None)

    def _fail_if_dead(self, units: list[str]) -> None:
        dead = self._dead(units)
        if dead is not None:
            all_dead = [unit for unit in units if unit not in self.supervisor.alive]
            raise _StepFailedError(f"{dead} {self.supervisor.cause_of_death.get(dead, 'died')}", all_dead)

    def _wait(self, is_done: Callable[[], bool], patience_s: float) -> None:
        deadline = self.supervisor.now() + patience_s
        while not is_done() and self.supervisor.now() < deadline:
            if self.supervisor.is_ending:
                raise RuntimeFaultError("the runtime is closed")
            self.supervisor.pump(deadline - self.supervisor.now())

    def _timed(self, phase: str, work: Callable[[], None]) -> None:
        start = self.supervisor.backend.now()
        work()
        self.seconds[phase] = self.supervisor.backend.now() - start


def _waits_for(wire: Wire, units: set[str]) -> bool:
    """Whether a wire has to wait for the end of what one of these units has to give."""
    return wire.replaces is not None and wire.replaces.stream.unit in units


class _StepFailedError(Exception):
    """A step of an update that failed, to be undone."""

    def __init__(self, message: str, units: list[str], *, is_abandoned: bool = False) -> None:
        super().__init__(message)
        self.units = units
        self.is_abandoned = is_abandoned
