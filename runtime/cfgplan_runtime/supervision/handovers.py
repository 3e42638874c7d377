"""The hand-overs of an update: new units continue from the places of the units that they replace.

`children/handover.py` has the part of the units in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field

from cfgplan.domain import ComputationUnit, Environment
from cfgplan.onward import grouped, reached
from cfgplan.ros.sources import NodeSource
from cfgplan_runtime.children.program_source import names_program
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.supervision.commands import (
    AskPlaces,
    AskState,
    Commands,
    Doubt,
    GiveState,
    HoldUnit,
    TellOf,
    WaitUntil,
)
from cfgplan_runtime.supervision.events import StateNotExact, StateTold
from cfgplan_runtime.supervision.progress import Progress

_PLACES_S, _STATE_S = 0.5, 1.0
"""Seconds that a new unit has to tell its places, and the unit that it replaces to tell its state. Otherwise the last
known state counts.
"""
_ANSWER_S = 0.05
"""Seconds that a unit without a state has for each answer, once _STATE_S were waited in vain for others."""


@dataclass(frozen=True, slots=True)
class _Handover:
    """A new unit, the `successor`, continues from the place of the unit `before` it."""

    before: str
    successor: str
    inlets: Mapping[str, str]
    """The inlets of the successor, each with the inlet of the unit before it that has the same stream or else the same
    name.
    """
    begun: Set[str]
    """The inlets of the successor whose streams begin with this update: those of new units, and those that come to it
    by another way than to the unit before it.
    """

    @classmethod
    def of(cls, update: Progress, before: str, successor: str) -> _Handover:
        """The hand-over between a running unit and a new one."""
        old = {inlet.port: wire.stream for inlet, wire in update.actual.feeds.items() if inlet.unit == before}
        of_stream = {stream: port for port, stream in old.items()}
        new = {inlet.port: stream for inlet, stream in update.wanted.items() if inlet.unit == successor}
        same = {port: port if old.get(port) == stream else of_stream.get(stream, port) for port, stream in new.items()}
        places = (update.actual.environment, before), (update.after, successor)
        ways = {(of.unit[unit].host, of.transformation[of.unit[unit].transformation].run.blocks) for of, unit in places}
        return cls(
            before,
            successor,
            {port: at for port, at in same.items() if at in old},
            {port for port, stream in new.items() if len(ways) > 1 or stream.unit in update.fresh},
        )


@dataclass(frozen=True, slots=True)
class Handovers:
    """The hand-overs of one update, by new unit: the unit whose place it takes. Upstream ones come first."""

    update: Progress
    before: dict[str, str] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    """The units that wait for a state."""
    asked: set[str] = field(default_factory=set)
    """The units that were asked for their state."""
    paused: dict[str, Mapping[str, Moment]] = field(default_factory=dict)
    """The units that have told their state and pause, with the moment of each output's last element."""
    exceptions: list[TellOf | Doubt] = field(default_factory=list)
    """The states that are not exact, and those that later answers may show to be inexact."""
    vain_s: list[float] = field(default_factory=list)
    """The seconds of each wait in vain in hand-overs to units without a state."""

    def hold(self) -> Commands:
        """Let the new units make no step before they have their state."""
        self.before.update(self.found())
        for unit in self.before:
            self.held.add(unit)
            yield HoldUnit(unit)

    def carry_out(self) -> Commands:
        """Hand over one state after the other."""
        for successor, before in self.before.items():
            yield from self.await_others(before, successor)
            if before in self.update.actual.alive:
                yield from self.hand_over(_Handover.of(self.update, before, successor))
            else:
                self.note_exception(before, successor, f"{before} died")
            if before not in self.paused:
                yield GiveState(successor)
            self.held.discard(successor)

    @property
    def paused_sources(self) -> set[str]:
        """The sources that have told their state, and pause."""
        after = self.update.after
        inputs = {unit.id: after.transformation[unit.transformation].inputs for unit in after.units}
        return {before for unit, before in self.before.items() if before in self.paused and not inputs[unit]}

    def report(self) -> Commands:
        """Report the states that may not be exact. If the update is undone, no unit continues from them."""
        yield from self.exceptions

    def undo(self) -> Commands:
        """Let the units that were asked for their state continue with it."""
        for unit in sorted(self.update.actual.alive & self.asked):
            yield GiveState(unit)

    def release(self, kept: Set[str]) -> Commands:
        """Let the kept units that still wait for a state continue without one."""
        for unit in sorted(kept & self.held):
            yield GiveState(unit)

    def found(self) -> dict[str, str]:
        """Return the new units that continue from the place of an ending unit, each with that unit, the upstream
        ones first. They get its state if they keep one, else the elements that wait in it.

        An active unit counts before an inactive one: the state of a unit that an undone update has kept is older.
        """
        update, actual, after = self.update, self.update.actual, self.update.after
        ending = actual.alive & set(update.change_set.stopped)
        old = {
            name: unit.id
            for unit in sorted(actual.environment.units, key=lambda unit: unit.id not in actual.inactive)
            if unit.id in ending and (name := _state_name(actual.environment, unit)) is not None
        }
        before = {
            unit.id: old[name]
            for unit in after.units
            if unit.id in update.fresh and (name := _state_name(after, unit)) in old and name is not None
        } | self.found_without_state(ending)
        upstream = {unit: before.keys() & self.upstream(unit) for unit in before}
        return {unit: before[unit] for unit in sorted(before, key=lambda unit: len(upstream[unit]))}

    def found_without_state(self, ending: Set[str]) -> dict[str, str]:
        """Return the new units without a state, each with the ending one without a state whose streams it takes over.
        Both are Python code with several inlets: elements of one may wait in the ending unit for those of another.
        """
        update = self.update
        actual, wanted = update.actual, update.wanted
        old, new = Counter(inlet.unit for inlet in actual.feeds), Counter(inlet.unit for inlet in wanted)
        found = dict[str, str]()
        for inlet, stream in wanted.items():
            fed = actual.feeds.get(inlet)
            before = None if fed is None else fed.stream.unit
            if before is None or before not in ending or stream.unit not in update.fresh:
                continue
            units = (actual.environment, before), (update.after, stream.unit)
            if min(old[before], new[stream.unit]) > 1 and all(_hands_over_steps(*each) for each in units):
                found.setdefault(stream.unit, before)
        return found

    def upstream(self, unit: str) -> list[str]:
        """A unit, and all that feed it after the update."""
        feeding = grouped((inlet.unit, stream.unit) for inlet, stream in self.update.wanted.items())
        return reached([unit], lambda one: feeding.get(one, ()))

    def has_state(self, successor: str) -> bool:
        """Whether a new unit keeps a state."""
        after = self.update.after
        return _state_name(after, after.unit[successor]) is not None

    def note_exception(
        self, before: str, successor: str, cause: str, unless: Mapping[str, Moment] | None = None
    ) -> None:
        """Note that a new unit may not have the exact state; only units that keep one report this."""
        if self.has_state(successor):
            event = StateNotExact(successor, before, cause)
            self.exceptions.append(TellOf(event) if unless is None else Doubt(event, unless))

    def await_part(self, successor: str, holds: Callable[[], bool], patience_s: float) -> Commands:
        """Wait for a part of a hand-over. In all hand-overs to units without a state together, an update waits at most
        _STATE_S in vain, and then _ANSWER_S for each part: they only make streams more exact, and must not delay
        an update noticeably.
        """
        update, has_state = self.update, self.has_state(successor)
        began_s = update.actual.now()
        if not has_state:
            patience_s = max(_ANSWER_S, min(patience_s, _STATE_S - sum(self.vain_s)))
        yield WaitUntil(lambda: holds() or bool(update.dead()), patience_s)
        update.fail_if_dead()
        if not has_state and not holds():
            self.vain_s.append(update.actual.now() - began_s)

    def await_others(self, before: str, successor: str) -> Commands:
        """Wait until the inlets that `before` fed have switched, except for those that a new unit of a hand-over feeds,
        directly or through other units: they need elements of `before` up to the first one of their new source.
        """
        update = self.update
        others = {
            inlet: stream.unit
            for inlet, stream in update.wanted.items()
            if (old := update.rewired.get(inlet)) is not None and old.unit == before
        }
        inlets = [inlet for inlet, unit in others.items() if self.before.keys().isdisjoint(self.upstream(unit))]
        if inlets:
            yield from self.await_part(successor, lambda: not any(map(update.is_switching, inlets)), _PLACES_S)

    def hand_over(self, one: _Handover) -> Commands:
        """Let the successor, which holds its steps, begin them with the state of the unit before it, at its place.

        If that unit does not tell its place, the successor is given nothing.
        """
        actual, answers, (before, successor) = (
            self.update.actual,
            self.update.actual.answers,
            (one.before, one.successor),
        )
        asked = self.needed(one)
        if asked:
            yield AskPlaces(successor, {inlet: inlet in one.begun for inlet in asked})
            yield from self.await_part(
                successor,
                lambda: answers.places(successor) is not None or not {before, successor} <= actual.alive,
                _PLACES_S,
            )
        places = (answers.places(successor) or {}) if asked else {}
        needed = [name for name in self.needed(one) if name in asked]
        self.asked.add(before)
        until = self.ends(one) | {one.inlets[name]: places[name] for name in needed if name in places}
        yield AskState(before, until, successor)
        yield from self.await_part(
            successor, lambda: answers.state(before) is not None or before not in actual.alive, _STATE_S
        )
        told = answers.state(before)
        if told is None:
            is_alive = before in actual.alive
            cause = f"did not tell its state within {_STATE_S:g} s" if is_alive else "died before it told its state"
            self.note_exception(before, successor, f"{before} {cause}")
            if is_alive:
                yield GiveState(before)  # it must not pause later: no other unit makes the steps that wait in it
            return
        if not told.state:
            self.note_exception(before, successor, f"the code of {before} gives no state")
            if told.state is None:
                return
        elif unknown := set(needed) - places.keys():
            cause = f"an input of {successor} got nothing within {_PLACES_S:g} s"
            covered = {name: told.inputs[one.inlets[name]].last for name in unknown if one.inlets[name] in told.inputs}
            self.note_exception(before, successor, cause, covered if unknown.isdisjoint(one.begun) else None)
        self.paused[before] = told.outputs
        yield self.given(one, told)

    def needed(self, one: _Handover) -> list[str]:
        """The inlets of the successor whose places count, since elements come to those of the unit before it. None
        comes from ending units that give none, and from units that pause.
        """
        still, feeds = self.update.idle_units() | self.paused.keys(), self.update.actual.feeds
        fed = {
            inlet.port for inlet, wire in feeds.items() if inlet.unit == one.before and wire.stream.unit not in still
        }
        return [name for name, old in one.inlets.items() if old in fed]

    def ends(self, one: _Handover) -> dict[str, Moment]:
        """The last element that comes to each inlet of the unit before, if its source pauses."""
        return {
            inlet.port: self.paused[wire.stream.unit][wire.stream.port]
            for inlet, wire in self.update.actual.feeds.items()
            if inlet.unit == one.before and wire.stream.port in self.paused.get(wire.stream.unit, {})
        }

    def given(self, one: _Handover, told: StateTold) -> GiveState:
        """The told state, with the places of the successor's inlets and outputs."""
        update = self.update
        outputs = {
            update.wanted[inlet].port: told.outputs[old.port]
            for inlet, old in update.rewired.items()
            if old is not None
            and (old.unit, update.wanted[inlet].unit) == (one.before, one.successor)
            and old.port in told.outputs
        }
        inputs = {name: told.inputs[old] for name, old in one.inlets.items() if old in told.inputs}
        return GiveState(one.successor, told.state or None, inputs, outputs)


def _state_name(environment: Environment, unit: ComputationUnit) -> str | None:
    transformation = environment.transformation.get(unit.transformation)
    return None if transformation is None else transformation.state_name


def _hands_over_steps(environment: Environment, unit: str) -> bool:
    """Whether a unit is Python code without a state; programs and nodes can't tell which elements wait in them."""
    transformation = environment.transformation.get(environment.unit[unit].transformation)
    source = None if transformation is None or transformation.state_name else transformation.source
    return source is not None and not names_program(source) and NodeSource.read(source) is None
