"""Carrying out one change set as a whole or not at all: start, rewire, then stop; after a failure, undo.

A generator yields commands and conditions to wait for; its driver carries each out before it asks for the next.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Mapping, Set
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol, TypeAlias

from cfgplan.domain import ALL, ChangeSet, ComputationUnit, Environment, Stream
from cfgplan.errors import InvalidValueError
from cfgplan.onward import grouped, reached
from cfgplan.ros.sources import NodeSource
from cfgplan_runtime.children.program_source import names_program
from cfgplan_runtime.errors import AbandonedError, ApplyError, NoSourceError, StaleChangeSetError
from cfgplan_runtime.supervision import wiring
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.commands import (
    ActivateUnit,
    AskPlaces,
    AskState,
    CloseTopic,
    Command,
    Commit,
    Connect,
    CutShort,
    DeactivateUnit,
    Disconnect,
    Dump,
    EndUnit,
    GiveState,
    HoldUnit,
    OpenTopic,
    SetEnvironment,
    StartUnit,
    StopAgain,
    StopUnit,
    SwitchNow,
    TellOf,
    WaitUntil,
)
from cfgplan_runtime.supervision.events import PlacesTold, StateNotExact, StateTold

_PLACES_S, _STATE_S = 0.5, 1.0
"""Seconds that a new unit has to tell its places, and the unit that it replaces to tell its state. Otherwise the last
known state counts.
"""
_ANSWER_S = 0.05
"""Seconds that a unit without a state has for each answer, once _STATE_S were waited in vain for others."""
STOP_AGAIN = 0.5
"""The share of its time to end after which a unit is told to stop again, which interrupts code that blocks."""
TIME_TO_DUMP_S = 0.2
"""Seconds that a unit has to print its stack before it is killed."""


@dataclass(frozen=True, slots=True)
class Patience:
    """The times that the steps of an update may take, in seconds: a start `start_s`, as the activation of a lifecycle
    node of ROS 2, a stop `stop_s`, then the end of a process `kill_s`. Followers of topics, such as a recording, may
    take `follow_s` until they are connected.

    If the new source of an input sends nothing for `switch_s`, the input switches to it when the old source is stopped.
    """

    start_s: float = 30.0
    switch_s: float = 2.0
    stop_s: float = 2.0
    kill_s: float = 10.0
    follow_s: float = 2.0


class Actual(Protocol):
    """The running configuration, at the moment of asking.

    `feeds` has each inlet's newest wire, which may not have switched yet.
    """

    @property
    def environment(self) -> Environment: ...
    @property
    def alive(self) -> Set[str]: ...
    @property
    def ready(self) -> Set[str]: ...
    @property
    def inactive(self) -> Set[str]:
        """The units that give nothing, since they are not connected yet."""

    @property
    def activating(self) -> Set[str]:
        """The units that were told to begin, and do not work yet."""

    @property
    def topics(self) -> Mapping[str, str | None]:
        """By topic that has an address: the host of its target."""

    @property
    def lost_hosts(self) -> Set[str]: ...
    @property
    def feeds(self) -> Mapping[Inlet, wiring.Wire]: ...
    @property
    def cause_of_death(self) -> Mapping[str, str]: ...
    @property
    def is_abandoned(self) -> bool: ...
    def stop_s(self, unit: str) -> float | None:
        """The seconds that a unit may take to end, by its transformation; None if that has no `stop`."""

    def answer(self, unit: str) -> PlacesTold | StateTold | None:
        """The answer of a unit to the last question of a hand-over; None if none has come yet."""

    def failure(self, unit: str) -> str | None:
        """The error of a unit's last failed step; None if none has failed."""

    def dry_units(self) -> Set[str]:
        """Units with outputs that have sent nothing for a while."""

    def is_followed(self, topics: Set[str]) -> bool:
        """Whether all followers of these topics are connected to them."""

    def now(self) -> float:
        """Seconds on a monotonic clock."""


Commands: TypeAlias = Generator[Command, None, None]


@dataclass(frozen=True, slots=True)
class CarriedOut:
    """The result of an update: the running configuration, the seconds of each phase, and the number of inputs that
    switched late.
    """

    environment: Environment
    seconds: Mapping[str, float]
    unswitched: int


def environment_after(
    environment: Environment, change_set: ChangeSet, lost_hosts: Set[str] = frozenset()
) -> Environment:
    """The configuration after an update.

    Raises StaleChangeSetError if the change set does not fit the running configuration, NoSourceError without code.
    """
    try:
        after = environment.update(change_set)
    except InvalidValueError as error:
        raise StaleChangeSetError(f"the change set does not fit the running configuration: {error}") from None
    labels = sorted({unit.transformation for unit in change_set.started})
    without = [label for label in labels if label in after.transformation and not after.transformation[label].source]
    if without:
        mend = "add `source: package.module:Class` or `source: units.py:Class`"
        raise NoSourceError(
            f"{', '.join(map(repr, without))} can't be started without unit code: {mend}",
            without,
            f"it has no unit code: {mend}",
        )
    for fault in _faults(after, change_set, lost_hosts):
        raise StaleChangeSetError(f"the change set does not fit the running configuration: {fault}")
    return after


def carry_out(
    actual: Actual, change_set: ChangeSet, after: Environment, patience: Patience, *, keeps_new: bool = False
) -> Generator[Command, None, CarriedOut]:
    """Yield the commands that lead to `after`. Raises ApplyError when a step failed and all was undone.

    Until Commit, the driver throws the exceptions of commands into the generator.

    With `keeps_new`, new units that have not failed then stay, unconnected and paused.
    """
    wanted = wiring.wanted_feeds(after, {inlet: wire.stream for inlet, wire in actual.feeds.items()})
    update, seconds = _Update(actual, change_set, after, wanted, patience), dict[str, float]()
    try:
        yield from _timed("start", update.start(), actual, seconds)
        yield from _timed("rewire", update.rewire(), actual, seconds)
    except _StepFailedError as error:
        yield from update.undo(error.units, keeps_new=keeps_new)
        kind = AbandonedError if error.is_abandoned else ApplyError
        raise kind(f"the update was undone: {error}", error.units) from None
    except Exception as error:  # thrown in: a command could not be carried out
        yield from update.undo([], keeps_new=keeps_new)
        raise ApplyError(f"the update was undone: {type(error).__name__}: {error}") from error
    yield Commit()
    unswitched = len(update.switching())
    yield from _timed("stop", update.stop(), actual, seconds)
    yield WaitUntil(update.may_end, patience.stop_s)
    yield from update.close_topics(actual.topics.keys() - wiring.wanted_topics(after).keys())
    return CarriedOut(update.as_it_lives(), seconds, unswitched)


def _timed(phase: str, commands: Commands, actual: Actual, seconds: dict[str, float]) -> Commands:
    began_s = actual.now()
    yield from commands
    seconds[phase] = actual.now() - began_s


def _faults(after: Environment, change_set: ChangeSet, lost_hosts: Set[str]) -> Iterable[str]:
    for unit in (*change_set.started, *change_set.rewired):
        if unit.host in lost_hosts:
            yield f"unit {unit.id!r} is to run on {unit.host}, which is gone"
        transformation = after.transformation.get(unit.transformation)
        if transformation is None:
            yield f"unit {unit.id!r} has no transformation {unit.transformation!r} in the library"
            continue
        for port, streams in unit.feeds.items():
            if port not in transformation.input:
                yield f"{transformation.label!r} has no input {port!r}"
            elif ALL != transformation.input[port].count < len(streams):
                yield f"input {port} of {unit.id} takes {transformation.input[port].count} streams, not {len(streams)}"
    for inlet, stream in wiring.wanted_feeds(after).items():
        unit_of_stream = after.unit.get(stream.unit)
        producer = after.transformation.get(unit_of_stream.transformation) if unit_of_stream else None
        if producer is None or stream.port not in producer.output:
            yield f"{inlet} needs the stream {stream}, which nothing gives afterwards"


@dataclass(frozen=True, slots=True)
class _Update:
    """One change set under way: the topics that it has opened, and the former stream of each rewired inlet.

    `wanted` has the stream that should feed each inlet.
    """

    actual: Actual
    change_set: ChangeSet
    after: Environment
    wanted: Mapping[Inlet, Stream]
    patience: Patience
    opened: list[str] = field(default_factory=list)
    rewired: dict[Inlet, Stream | None] = field(default_factory=dict)
    fresh: set[str] = field(default_factory=set)
    """The units that the update connects for the first time: new ones, and those that an undone update has kept."""
    needed: set[str] = field(default_factory=set)
    """The units without which the update is undone: those of the fresh ones that have not begun yet."""
    held: set[str] = field(default_factory=set)
    """The units that wait for a state."""
    asked: set[str] = field(default_factory=set)
    """The units that were asked for their state."""
    vain_s: list[float] = field(default_factory=list)
    """The seconds of each wait in vain in hand-overs to units without a state."""
    activated: set[str] = field(default_factory=set)
    """The units that began in the update: new ones, and those that an undone update has kept."""

    @property
    def started(self) -> list[str]:
        """The new units that run; cold spares are only recorded."""
        return [unit.id for unit in self.change_set.started if not unit.standby]

    def start(self) -> Commands:
        actual = self.actual
        connected = {wire.stream.unit for wire in actual.feeds.values()} | {inlet.unit for inlet in actual.feeds}
        self.fresh.update(self.wired() & self.after.unit.keys() - connected, self.started)
        self.needed.update(self.fresh & actual.inactive, self.started)
        for topic, host in sorted(wiring.wanted_topics(self.after).items()):
            if topic in actual.topics and actual.topics[topic] != host:
                yield from self.close_topic_elsewhere(topic)
            if topic not in actual.topics:
                self.opened.append(topic)
                yield OpenTopic(topic, host)
        for unit in self.change_set.started:
            if not unit.standby:
                yield StartUnit(unit, self.after.transformation[unit.transformation])
        awaited = {*self.started, *(self.wired() & actual.alive - actual.ready)}
        slow = yield from self.await_none(lambda: self.loading(awaited), "starting")
        if slow:
            for unit_id in slow:
                yield Dump(unit_id)
            yield WaitUntil(lambda: actual.is_abandoned, TIME_TO_DUMP_S)
            raise _StepFailedError(f"{_were(slow)} not ready within {self.patience.start_s:g} s", slow)

    def await_none(self, late: Callable[[], list[str]], doing: str) -> Generator[Command, None, list[str]]:
        """Wait until no unit is late with its start or activation. Returns those that are late nevertheless."""
        actual = self.actual
        yield WaitUntil(lambda: bool(self.dead()) or not late() or actual.is_abandoned, self.patience.start_s)
        self.fail_if_dead()
        slow = late()
        if slow and actual.is_abandoned:
            raise _StepFailedError(f"it was given up while {_were(slow)} {doing}", slow, is_abandoned=True)
        return slow

    def rewire(self) -> Commands:
        actual, wanted = self.actual, self.wanted
        heirs = self.heirs()
        for unit in heirs:
            self.held.add(unit)
            yield HoldUnit(unit)
        yield from self.await_followers()
        for inlet, stream in wanted.items():
            if not self.lives(inlet):
                continue  # its unit has died meanwhile
            fed = actual.feeds.get(inlet)
            if fed is None or fed.stream != stream:
                self.rewired[inlet] = None if fed is None else fed.stream
                yield Connect(stream, inlet)
        # Elements that a unit gives before it is connected would be lost, such as messages that a broker has kept.
        yield from self.begin()
        paused = set[str]()
        for unit, before in heirs.items():
            yield from self.await_others(before, unit, heirs)
            is_told = yield from self.hand_over_state(before, unit)
            if is_told and not self.after.transformation[self.after.unit[unit].transformation].inputs:
                paused.add(before)
        starved = self.idle_units() | paused.intersection(self.change_set.stopped)
        yield WaitUntil(
            lambda: bool(self.dead()) or self.may_end(starved),
            self.patience.switch_s,
        )
        self.fail_if_dead()
        self.fail_if_only_failing(starved)
        for inlet in [inlet for inlet in actual.feeds if inlet not in wanted]:
            if inlet.unit not in self.change_set.stopped:
                yield Disconnect(inlet)

    def await_followers(self) -> Commands:
        """Wait until no follower of a topic without a source would miss its first elements."""
        actual, outlets = self.actual, {inlet for inlet in self.wanted if inlet.is_outlet and self.lives(inlet)}
        topics = {inlet.port for inlet in outlets - actual.feeds.keys()}
        if topics and not actual.is_followed(topics):
            yield WaitUntil(
                lambda: actual.is_followed(topics) or bool(self.dead()) or actual.is_abandoned, self.patience.follow_s
            )

    def activate(self, units: Iterable[str]) -> Commands:
        """Activate the inactive ones of these units, sources last, since the others wait for elements."""
        new = self.actual.inactive & set(units)
        inputs = {unit.id: bool(self.after.transformation[unit.transformation].inputs) for unit in self.after.units}
        for unit in sorted(new, key=lambda unit: (not inputs[unit], unit)):
            self.activated.add(unit)
            yield ActivateUnit(unit)

    def begin(self) -> Commands:
        """Activate all inactive units. Sources begin once all others work: a lifecycle node takes a while, and elements
        that come before are lost.
        """
        units, library = self.after.units, self.after.transformation
        inner = [unit.id for unit in units if library[unit.transformation].inputs]
        for group in (inner, [unit.id for unit in units]):
            yield from self.activate(group)
            if self.activating():
                slow = yield from self.await_none(self.activating, "being activated")
                if slow:
                    raise _StepFailedError(f"{_were(slow)} not active within {self.patience.start_s:g} s", slow)

    def activating(self) -> list[str]:
        """The units that this update has told to begin, and that do not work yet."""
        return sorted(self.activated & self.actual.activating)

    def heirs(self) -> dict[str, str]:
        """Return the new units that continue from the place of an ending unit, each with that unit, the upstream
        ones first. They get its state if they keep one, else the elements that wait in it.

        An active unit counts before an inactive one: the state of a unit that an undone update has kept is older.
        """
        actual, ending = self.actual, self.actual.alive & set(self.change_set.stopped)
        old = {
            name: unit.id
            for unit in sorted(actual.environment.units, key=lambda unit: unit.id not in actual.inactive)
            if unit.id in ending and (name := _state_name(actual.environment, unit)) is not None
        }
        heirs = {
            unit.id: old[name]
            for unit in self.after.units
            if unit.id in self.fresh and (name := _state_name(self.after, unit)) in old and name is not None
        } | self.heirs_of_steps(ending)
        upstream = {unit: heirs.keys() & self.upstream(unit) for unit in heirs}
        return {unit: heirs[unit] for unit in sorted(heirs, key=lambda unit: len(upstream[unit]))}

    def heirs_of_steps(self, ending: Set[str]) -> dict[str, str]:
        """Return the new units without a state, each with the ending one without a state whose streams it takes over.
        Both are Python code with several inlets: elements of one may wait in the ending unit for those of another.
        """
        actual = self.actual
        old, new = Counter(inlet.unit for inlet in actual.feeds), Counter(inlet.unit for inlet in self.wanted)
        found = dict[str, str]()
        for inlet, stream in self.wanted.items():
            fed = actual.feeds.get(inlet)
            before = None if fed is None else fed.stream.unit
            if before is None or before not in ending or stream.unit not in self.fresh:
                continue
            units = (actual.environment, before), (self.after, stream.unit)
            if min(old[before], new[stream.unit]) > 1 and all(_hands_over_steps(*each) for each in units):
                found.setdefault(stream.unit, before)
        return found

    def idle_units(self) -> set[str]:
        """The ending units that give no elements."""
        idle = wiring.starved_units(self.actual.environment) | self.actual.dry_units()
        return idle.intersection(self.change_set.stopped)

    def state_name(self, unit: str) -> str | None:
        """The name of the state that a wanted unit keeps; None if it keeps none."""
        return _state_name(self.after, self.after.unit[unit])

    def upstream(self, unit: str) -> list[str]:
        """A unit, and all that feed it after the update."""
        feeding = grouped((inlet.unit, stream.unit) for inlet, stream in self.wanted.items())
        return reached([unit], lambda one: feeding.get(one, ()))

    def await_handover(self, heir: str, holds: Callable[[], bool], patience_s: float) -> Commands:
        """Wait for a part of a hand-over. In all hand-overs to units without a state together, an update waits at most
        _STATE_S in vain, and then _ANSWER_S for each part: they are more exact, but nobody should notice them.
        """
        has_state, began_s = self.state_name(heir) is not None, self.actual.now()
        if not has_state:
            patience_s = max(_ANSWER_S, min(patience_s, _STATE_S - sum(self.vain_s)))
        yield WaitUntil(lambda: holds() or bool(self.dead()), patience_s)
        self.fail_if_dead()
        if not has_state and not holds():
            self.vain_s.append(self.actual.now() - began_s)

    def await_others(self, before: str, heir: str, heirs: Mapping[str, str]) -> Commands:
        """Wait until the inlets that `before` fed have switched, except for those that an heir will feed, directly or
        through other units: they need its elements up to the first one of their new source.
        """
        others = {
            inlet: stream.unit
            for inlet, stream in self.wanted.items()
            if (old := self.rewired.get(inlet)) is not None and old.unit == before
        }
        inlets = [inlet for inlet, unit in others.items() if heirs.keys().isdisjoint(self.upstream(unit))]
        if inlets:
            yield from self.await_handover(heir, lambda: not any(map(self.is_switching, inlets)), _PLACES_S)

    def hand_over_state(self, before: str, heir: str) -> Generator[Command, None, bool]:
        """Let a new unit, which holds its steps, begin them with the state of the unit `before` it, at its place.

        It waits for no element of ending units that give none. Returns whether `before` has told its place, and pauses.
        Only units that keep a state report exceptions.
        """
        actual, same = self.actual, self.same_inlets(before, heir)
        yield AskPlaces(heir, self.inlets_of_new_streams(before, heir))
        yield from self.await_handover(
            heir, lambda: actual.answer(heir) is not None or not {before, heir} <= actual.alive, _PLACES_S
        )
        places = actual.answer(heir)
        known = places.moments if isinstance(places, PlacesTold) else {}
        idle = self.idle_units()
        fed = {
            inlet.port for inlet, wire in actual.feeds.items() if inlet.unit == before and wire.stream.unit not in idle
        }
        until = {same[name]: moment for name, moment in known.items() if same.get(name) in fed}
        self.asked.add(before)
        yield AskState(before, until, heir)
        yield from self.await_handover(
            heir, lambda: actual.answer(before) is not None or before not in actual.alive, _STATE_S
        )
        told = actual.answer(before)
        cause = None
        if not isinstance(told, StateTold):
            cause = f"{before} did not tell its state within {_STATE_S:g} s"
        elif not told.state:
            cause = f"the code of {before} gives no state"
        elif places is None:
            cause = f"an input of {heir} got nothing within {_PLACES_S:g} s"
        if cause is not None and self.state_name(heir) is not None:
            yield TellOf(StateNotExact(heir, before, cause))
        if not isinstance(told, StateTold) or told.state is None:
            if told is None and before in actual.alive:
                yield GiveState(before)  # it must not pause later: nobody else makes the steps that wait in it
            yield GiveState(heir)
            self.held.discard(heir)
            return False
        inputs = {name: told.inputs[old] for name, old in same.items() if old in told.inputs}
        outputs = {
            self.wanted[inlet].port: told.outputs[old.port]
            for inlet, old in self.rewired.items()
            if old is not None and old.unit == before and old.port in told.outputs and self.wanted[inlet].unit == heir
        }
        yield GiveState(heir, told.state or None, inputs, outputs)
        self.held.discard(heir)
        return True

    def same_inlets(self, before: str, heir: str) -> dict[str, str]:
        """The inlets of a new unit, each with the inlet of the unit before it that has the same stream or else the same
        name.
        """
        old = {inlet.port: wire.stream for inlet, wire in self.actual.feeds.items() if inlet.unit == before}
        of_stream = {stream: port for port, stream in old.items()}
        new = {inlet.port: stream for inlet, stream in self.wanted.items() if inlet.unit == heir}
        found = {port: port if old.get(port) == stream else of_stream.get(stream, port) for port, stream in new.items()}
        return {port: at for port, at in found.items() if at in old}

    def inlets_of_new_streams(self, before: str, heir: str) -> tuple[str, ...]:
        """The inlets of a new unit whose streams begin with this update: those of new units, and those that come to it
        by another way than to the unit `before` it.
        """
        old, new = self.actual.environment.unit[before], self.after.unit[heir]
        runs = [
            of.transformation[unit.transformation].run.blocks
            for of, unit in ((self.actual.environment, old), (self.after, new))
        ]
        is_elsewhere = old.host != new.host or runs[0] != runs[1]
        return tuple(
            inlet.port
            for inlet, stream in self.wanted.items()
            if inlet.unit == heir and (is_elsewhere or stream.unit in self.fresh)
        )

    def stop(self) -> Commands:
        stopped = set(self.change_set.stopped)
        for inlet in self.switching():
            if self.rewired[inlet] is not None and not self.replaces_one_of(stopped, inlet):
                yield SwitchNow(inlet)
        yield from self.stop_units(self.change_set.stopped)

    def undo(self, failed: list[str], *, keeps_new: bool) -> Commands:
        """Switch the inputs of old units back, and only then stop the new units, which feed them until then.

        The old source is always reconnected: an inlet may just have switched, unnoticed, and elements in between would
        be lost.
        """
        actual, wanted = self.actual, self.wanted
        kept = actual.alive & set(self.started) - set(failed) if keeps_new else set[str]()
        yield SetEnvironment(self.with_unconnected(kept))
        unconnected = kept | (self.activated - set(self.started))
        waiting = unconnected & self.wired() - wiring.wanted_to_run(self.after)  # until the next update connects them
        yield from self.activate(kept - waiting)
        back = {inlet: old for inlet, old in reversed(self.rewired.items()) if inlet.unit not in self.started}
        self.rewired.clear()
        for inlet, old in back.items():
            fed = actual.feeds.get(inlet)
            if old is not None and old.unit in actual.alive and self.lives(inlet):
                self.rewired[inlet] = None if fed is None else fed.stream
                yield Connect(old, inlet)
            elif fed is not None and fed.stream == wanted[inlet]:
                yield Disconnect(inlet)
        for unit in sorted(actual.alive & self.asked):
            yield GiveState(unit)
        yield WaitUntil(self.may_end, self.patience.switch_s)
        for inlet in self.switching():
            yield SwitchNow(inlet)
        for unit in sorted(actual.alive & waiting - actual.inactive):
            yield DeactivateUnit(unit)
        for inlet in [inlet for inlet in actual.feeds if inlet.unit in kept]:
            yield Disconnect(inlet)
        ending = {*self.started, *failed} - kept
        for unit in sorted(actual.alive & self.held - ending):
            yield GiveState(unit)
        yield from self.stop_units(sorted(ending))
        for unit in failed:
            yield SetEnvironment(actual.environment.without_unit(unit))
        yield from self.close_topics(self.opened)

    def stop_units(self, units: Iterable[str]) -> Commands:
        actual = self.actual
        spares = {unit.id for unit in actual.environment.units if unit.standby}
        stopped = tuple(unit for unit in units if unit not in spares)
        for unit in stopped:
            yield StopUnit(unit)
            if unit not in actual.ready:
                yield EndUnit(unit)  # it does not listen yet
        began_s = actual.now()
        limits = {unit: _either(actual.stop_s(unit), self.patience.stop_s) for unit in stopped}
        for limit_s in sorted(set(limits.values())):
            due = {unit for unit, its_s in limits.items() if its_s == limit_s}
            for share, command in ((STOP_AGAIN, StopAgain), (1.0, partial(CutShort, after_s=limit_s))):
                end_s = began_s + share * limit_s
                yield WaitUntil(lambda due=due: actual.alive.isdisjoint(due), end_s - actual.now())  # type: ignore[misc]
                if actual.alive.isdisjoint(due):
                    break
                for unit in sorted(actual.alive & due):
                    yield command(unit)
        yield WaitUntil(lambda: actual.alive.isdisjoint(stopped), self.patience.kill_s)

    def close_topic_elsewhere(self, topic: str) -> Commands:
        """Close a topic that moves to another host. It then has no source, whether or not the update succeeds."""
        outlet = Inlet("", topic)
        if outlet in self.actual.feeds:
            yield Disconnect(outlet)
            yield SetEnvironment(wiring.without_feed(self.actual.environment, outlet))
        yield CloseTopic(topic)

    def close_topics(self, topics: Iterable[str]) -> Commands:
        for topic in sorted(topics):
            yield CloseTopic(topic)

    def switching(self) -> list[Inlet]:
        """The rewired inlets that have not switched yet."""
        return [inlet for inlet in self.rewired if self.is_switching(inlet)]

    def may_end(self, starved: Set[str] = frozenset()) -> bool:
        """Whether all rewired inlets have switched, except those that one of the `starved` units fed.

        The last inlet is checked first, because it switches last.
        """
        return all(self.replaces_one_of(starved, inlet) for inlet in reversed(self.rewired) if self.is_switching(inlet))

    def is_switching(self, inlet: Inlet) -> bool:
        feed = self.actual.feeds.get(inlet)
        return feed is not None and not feed.has_switched and self.lives(inlet)

    def lives(self, inlet: Inlet) -> bool:
        """Whether an inlet can be fed: its unit is alive, or its topic's host has joined."""
        if inlet.is_outlet:
            return self.actual.topics.get(inlet.port) not in self.actual.lost_hosts
        return inlet.unit in self.actual.alive

    def replaces_one_of(self, units: Set[str], inlet: Inlet) -> bool:
        """Whether one of these units fed a rewired inlet before."""
        old = self.rewired[inlet]
        return old is not None and old.unit in units

    def with_unconnected(self, kept: Set[str]) -> Environment:
        """The present environment with the `kept` new units, unconnected."""
        before = self.actual.environment
        new = tuple(
            replace(unit, subscriptions=(), publications=()) for unit in self.change_set.started if unit.id in kept
        )
        library, hosts = dict(before.transformation), dict(before.host)
        for unit in new:
            library.setdefault(unit.transformation, self.after.transformation[unit.transformation])
            if unit.host is not None:
                hosts.setdefault(unit.host, self.after.host[unit.host])
        units = (*before.units, *new)
        return replace(before, units=units, library=tuple(library.values()), hosts=tuple(hosts.values()))

    def wired(self) -> Set[str]:
        """The units that are connected after the update."""
        return {stream.unit for stream in self.wanted.values()} | {inlet.unit for inlet in self.wanted}

    def as_it_lives(self) -> Environment:
        """The wanted environment without units that have died and wires that were lost meanwhile."""
        environment = self.after
        for unit in self.after.units:
            if unit.host in self.actual.lost_hosts if unit.standby else unit.id not in self.actual.alive:
                environment = environment.without_unit(unit.id)
        for inlet, stream in self.wanted.items():
            if inlet not in self.actual.feeds:
                environment = wiring.without_feed(environment, inlet, stream)
        return environment

    def loading(self, units: Set[str]) -> list[str]:
        """The units of these that are not ready yet."""
        return sorted(units & self.actual.alive - self.actual.ready)

    def dead(self) -> list[str]:
        return sorted(self.needed - self.actual.alive)

    def fail_if_dead(self) -> None:
        dead = self.dead()
        if dead:
            cause = self.actual.cause_of_death.get(dead[0])
            raise _StepFailedError(f"{dead[0]} died" + (f": {cause}" if cause else ""), dead)

    def fail_if_only_failing(self, starved: Set[str]) -> None:
        """Raise if a new unit's code fails while an old unit still sends the stream that the new one should send."""
        alive = self.actual.alive
        if not any(
            (old := self.rewired[inlet]) is not None and old.unit in alive - starved for inlet in self.switching()
        ):
            return
        failures = {unit: text for unit in self.started if (text := self.actual.failure(unit)) is not None}
        for unit, text in failures.items():
            raise _StepFailedError(f"{unit} gives nothing, since its code fails: {text}", list(failures))


def _state_name(environment: Environment, unit: ComputationUnit) -> str | None:
    transformation = environment.transformation.get(unit.transformation)
    return None if transformation is None else transformation.state_name


def _hands_over_steps(environment: Environment, unit: str) -> bool:
    """Whether a unit is Python code without a state; programs and nodes can't tell which elements wait in them."""
    transformation = environment.transformation.get(environment.unit[unit].transformation)
    source = None if transformation is None or transformation.state_name else transformation.source
    return source is not None and not names_program(source) and NodeSource.read(source) is None


def _were(units: list[str]) -> str:
    return f"{', '.join(units)} {'was' if len(units) == 1 else 'were'}"


def _either(said: float | None, usual: float) -> float:
    return usual if said is None else said


class _StepFailedError(Exception):
    """A step of an update that failed, to be undone."""

    def __init__(self, message: str, units: list[str], *, is_abandoned: bool = False) -> None:
        super().__init__(message)
        self.units = units
        self.is_abandoned = is_abandoned
