"""The hand-overs of an update: new units continue from the places of the units that they replace.

`children/handover.py` has the part of the units in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Set
from dataclasses import dataclass, field

from cfgplan.domain import ComputationUnit, Environment
from cfgplan.onward import grouped, reached
from cfgplan.ros.sources import NodeSource
from cfgplan_runtime.children.program_source import names_program
from cfgplan_runtime.supervision.commands import (
    AskPlaces,
    AskState,
    Command,
    Commands,
    GiveState,
    HoldUnit,
    TellOf,
    WaitUntil,
)
from cfgplan_runtime.supervision.events import PlacesTold, StateNotExact, StateTold
from cfgplan_runtime.supervision.progress import Progress

_PLACES_S, _STATE_S = 0.5, 1.0
"""Seconds that a new unit has to tell its places, and the unit that it replaces to tell its state. Otherwise the last
known state counts.
"""
_ANSWER_S = 0.05
"""Seconds that a unit without a state has for each answer, once _STATE_S were waited in vain for others."""


@dataclass(frozen=True, slots=True)
class Handovers:
    """The hand-overs of one update, by new unit: the unit whose place it takes. Upstream ones come first."""

    update: Progress
    before: dict[str, str] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    """The units that wait for a state."""
    asked: set[str] = field(default_factory=set)
    """The units that were asked for their state."""
    vain_s: list[float] = field(default_factory=list)
    """The seconds of each wait in vain in hand-overs to units without a state."""

    def hold(self) -> Commands:
        """Let the new units make no step before they have their state."""
        self.before.update(self.found())
        for unit in self.before:
            self.held.add(unit)
            yield HoldUnit(unit)

    def carry_out(self) -> Generator[Command, None, set[str]]:
        """Hand over one state after the other. Returns the sources that have told theirs, and pause."""
        update = self.update
        paused = set[str]()
        for unit, before in self.before.items():
            yield from self.await_others(before, unit)
            is_told = yield from self.hand_over_state(before, unit)
            if is_told and not update.after.transformation[update.after.unit[unit].transformation].inputs:
                paused.add(before)
        return paused

    def undo(self) -> Commands:
        """Let the units that were asked for their state continue with it."""
        for unit in sorted(self.update.actual.alive & self.asked):
            yield GiveState(unit)

    def release(self, kept: Set[str]) -> Commands:
        """Let the units of these continue that still wait for a state."""
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

    def state_name(self, unit: str) -> str | None:
        """The name of the state that a wanted unit keeps; None if it keeps none."""
        after = self.update.after
        return _state_name(after, after.unit[unit])

    def upstream(self, unit: str) -> list[str]:
        """A unit, and all that feed it after the update."""
        feeding = grouped((inlet.unit, stream.unit) for inlet, stream in self.update.wanted.items())
        return reached([unit], lambda one: feeding.get(one, ()))

    def await_handover(self, successor: str, holds: Callable[[], bool], patience_s: float) -> Commands:
        """Wait for a part of a hand-over. In all hand-overs to units without a state together, an update waits at most
        _STATE_S in vain, and then _ANSWER_S for each part: they are more exact, but nobody should notice them.
        """
        update = self.update
        has_state, began_s = self.state_name(successor) is not None, update.actual.now()
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
            yield from self.await_handover(successor, lambda: not any(map(update.is_switching, inlets)), _PLACES_S)

    def hand_over_state(self, before: str, successor: str) -> Generator[Command, None, bool]:
        """Let a new unit, which holds its steps, begin them with the state of the unit `before` it, at its place.

        It waits for no element of ending units that give none. Returns whether `before` has told its place, and pauses.
        Only units that keep a state report exceptions.
        """
        update = self.update
        actual, same = update.actual, self.same_inlets(before, successor)
        yield AskPlaces(successor, self.inlets_of_new_streams(before, successor))
        yield from self.await_handover(
            successor,
            lambda: actual.answer(successor) is not None or not {before, successor} <= actual.alive,
            _PLACES_S,
        )
        places = actual.answer(successor)
        known = places.moments if isinstance(places, PlacesTold) else {}
        idle = update.idle_units()
        fed = {
            inlet.port for inlet, wire in actual.feeds.items() if inlet.unit == before and wire.stream.unit not in idle
        }
        until = {same[name]: moment for name, moment in known.items() if same.get(name) in fed}
        self.asked.add(before)
        yield AskState(before, until, successor)
        yield from self.await_handover(
            successor, lambda: actual.answer(before) is not None or before not in actual.alive, _STATE_S
        )
        told = actual.answer(before)
        cause = None
        if not isinstance(told, StateTold):
            cause = f"{before} did not tell its state within {_STATE_S:g} s"
        elif not told.state:
            cause = f"the code of {before} gives no state"
        elif places is None:
            cause = f"an input of {successor} got nothing within {_PLACES_S:g} s"
        if cause is not None and self.state_name(successor) is not None:
            yield TellOf(StateNotExact(successor, before, cause))
        if not isinstance(told, StateTold) or told.state is None:
            if told is None and before in actual.alive:
                yield GiveState(before)  # it must not pause later: nobody else makes the steps that wait in it
            yield GiveState(successor)
            self.held.discard(successor)
            return False
        inputs = {name: told.inputs[old] for name, old in same.items() if old in told.inputs}
        outputs = {
            update.wanted[inlet].port: told.outputs[old.port]
            for inlet, old in update.rewired.items()
            if old is not None
            and old.unit == before
            and old.port in told.outputs
            and update.wanted[inlet].unit == successor
        }
        yield GiveState(successor, told.state or None, inputs, outputs)
        self.held.discard(successor)
        return True

    def same_inlets(self, before: str, successor: str) -> dict[str, str]:
        """The inlets of a new unit, each with the inlet of the unit before it that has the same stream or else the same
        name.
        """
        update = self.update
        old = {inlet.port: wire.stream for inlet, wire in update.actual.feeds.items() if inlet.unit == before}
        of_stream = {stream: port for port, stream in old.items()}
        new = {inlet.port: stream for inlet, stream in update.wanted.items() if inlet.unit == successor}
        found = {port: port if old.get(port) == stream else of_stream.get(stream, port) for port, stream in new.items()}
        return {port: at for port, at in found.items() if at in old}

    def inlets_of_new_streams(self, before: str, successor: str) -> tuple[str, ...]:
        """The inlets of a new unit whose streams begin with this update: those of new units, and those that come to it
        by another way than to the unit `before` it.
        """
        update = self.update
        old, new = update.actual.environment.unit[before], update.after.unit[successor]
        runs = [
            of.transformation[unit.transformation].run.blocks
            for of, unit in ((update.actual.environment, old), (update.after, new))
        ]
        is_elsewhere = old.host != new.host or runs[0] != runs[1]
        return tuple(
            inlet.port
            for inlet, stream in update.wanted.items()
            if inlet.unit == successor and (is_elsewhere or stream.unit in update.fresh)
        )


def _state_name(environment: Environment, unit: ComputationUnit) -> str | None:
    transformation = environment.transformation.get(unit.transformation)
    return None if transformation is None else transformation.state_name


def _hands_over_steps(environment: Environment, unit: str) -> bool:
    """Whether a unit is Python code without a state; programs and nodes can't tell which elements wait in them."""
    transformation = environment.transformation.get(environment.unit[unit].transformation)
    source = None if transformation is None or transformation.state_name else transformation.source
    return source is not None and not names_program(source) and NodeSource.read(source) is None
