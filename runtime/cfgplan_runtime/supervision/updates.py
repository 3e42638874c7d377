"""Carrying out one change set as a whole or not at all: start, rewire, then stop; after a failure, undo.

A generator yields commands and conditions to wait for; its driver carries each out before it asks for the next.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Set
from dataclasses import dataclass, field, replace
from functools import partial

from cfgplan.domain import ALL, ChangeSet, Environment
from cfgplan.errors import InvalidValueError
from cfgplan_runtime.errors import AbandonedError, ApplyError, NoSourceError, StaleChangeSetError
from cfgplan_runtime.supervision import wiring
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.commands import (
    ActivateUnit,
    CloseTopic,
    Command,
    Commands,
    Commit,
    Connect,
    CutShort,
    DeactivateUnit,
    Disconnect,
    Dump,
    EndUnit,
    OpenTopic,
    SetEnvironment,
    StartUnit,
    StopAgain,
    StopUnit,
    SwitchNow,
    Undo,
    WaitUntil,
)
from cfgplan_runtime.supervision.handovers import Handovers
from cfgplan_runtime.supervision.progress import Actual, Progress, StepFailedError

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

    Until Commit or Undo, the driver throws the exceptions of commands into the generator.

    With `keeps_new`, new units that have not failed then stay, unconnected and paused.
    """
    wanted = wiring.wanted_feeds(after, {inlet: wire.stream for inlet, wire in actual.feeds.items()})
    progress = Progress(actual, change_set, after, wanted)
    update, seconds = _Update(progress, Handovers(progress), patience), dict[str, float]()
    try:
        yield from _timed("start", update.start(), actual, seconds)
        yield from _timed("rewire", update.rewire(), actual, seconds)
    except StepFailedError as error:
        yield from update.undo(error.units, keeps_new=keeps_new)
        kind = AbandonedError if error.is_abandoned else ApplyError
        raise kind(str(error), error.units) from None
    except Exception as error:  # thrown in: a command could not be carried out
        yield from update.undo([], keeps_new=keeps_new)
        raise ApplyError(f"{type(error).__name__}: {error}") from error
    yield Commit()
    yield from update.handovers.report()
    unswitched = len(progress.switching())
    yield from _timed("stop", update.stop(), actual, seconds)
    yield WaitUntil(progress.may_end, patience.stop_s)
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
    """The steps of an update, and the steps that undo it."""

    progress: Progress
    handovers: Handovers
    patience: Patience
    opened: list[str] = field(default_factory=list)
    """The topics that it has opened."""
    activated: set[str] = field(default_factory=set)
    """The units that began in the update: new ones, and those that an undone update has kept."""

    def start(self) -> Commands:
        progress = self.progress
        actual = progress.actual
        connected = {wire.stream.unit for wire in actual.feeds.values()} | {inlet.unit for inlet in actual.feeds}
        progress.fresh.update(progress.wired() & progress.after.unit.keys() - connected, progress.started)
        progress.needed.update(progress.fresh & actual.inactive, progress.started)
        for topic, host in sorted(wiring.wanted_topics(progress.after).items()):
            if topic in actual.topics and actual.topics[topic] != host:
                yield from self.close_topic_elsewhere(topic)
            if topic not in actual.topics:
                self.opened.append(topic)
                yield OpenTopic(topic, host)
        for unit in progress.change_set.started:
            if not unit.standby:
                yield StartUnit(unit, progress.after.transformation[unit.transformation])
        awaited = {*progress.started, *(progress.wired() & actual.alive - actual.ready)}
        slow = yield from self.await_none(lambda: progress.loading(awaited), "starting")
        if slow:
            for unit_id in slow:
                yield Dump(unit_id)
            yield WaitUntil(lambda: actual.is_abandoned, TIME_TO_DUMP_S)
            raise StepFailedError(f"{_were(slow)} not ready within {self.patience.start_s:g} s", slow)

    def await_none(self, late: Callable[[], list[str]], doing: str) -> Generator[Command, None, list[str]]:
        """Wait until no unit is late with its start or activation. Returns those that are late nevertheless."""
        progress, actual = self.progress, self.progress.actual
        yield WaitUntil(lambda: bool(progress.dead()) or not late() or actual.is_abandoned, self.patience.start_s)
        progress.fail_if_dead()
        slow = late()
        if slow and actual.is_abandoned:
            raise StepFailedError(f"it was given up while {_were(slow)} {doing}", slow, is_abandoned=True)
        return slow

    def rewire(self) -> Commands:
        progress = self.progress
        actual, wanted = progress.actual, progress.wanted
        yield from self.handovers.hold()
        yield from self.await_followers()
        for inlet, stream in wanted.items():
            if not progress.lives(inlet):
                continue  # its unit has died meanwhile
            fed = actual.feeds.get(inlet)
            if fed is None or fed.stream != stream:
                progress.rewired[inlet] = None if fed is None else fed.stream
                yield Connect(stream, inlet)
        # Elements that a unit gives before it is connected would be lost, such as messages that a broker has kept.
        yield from self.activate(progress.after.unit.keys(), waits=True)
        yield from self.handovers.carry_out()
        starved = progress.idle_units() | self.handovers.paused_sources
        yield WaitUntil(lambda: bool(progress.dead()) or progress.may_end(starved), self.patience.switch_s)
        progress.fail_if_dead()
        self.fail_if_only_failing(starved)
        for inlet in [inlet for inlet in actual.feeds if inlet not in wanted]:
            if inlet.unit not in progress.change_set.stopped:
                yield Disconnect(inlet)

    def await_followers(self) -> Commands:
        """Wait until no follower of a topic without a source would miss its first elements."""
        progress = self.progress
        actual = progress.actual
        outlets = {inlet for inlet in progress.wanted if inlet.is_outlet and progress.lives(inlet)}
        topics = {inlet.port for inlet in outlets - actual.feeds.keys()}
        if topics and not actual.is_followed(topics):
            yield WaitUntil(
                lambda: actual.is_followed(topics) or bool(progress.dead()) or actual.is_abandoned,
                self.patience.follow_s,
            )

    def activate(self, units: Set[str], *, waits: bool = False) -> Commands:
        """Activate the inactive ones of these units, sources last, since the others wait for elements.

        If it `waits`, sources begin once all others work: a lifecycle node takes a while, and elements that come before
        are lost.
        """
        progress = self.progress
        after = progress.after
        sources = {unit.id for unit in after.units if not after.transformation[unit.transformation].inputs}
        new = progress.actual.inactive & units
        for group in (new - sources, new & sources):
            for unit in sorted(group):
                self.activated.add(unit)
                yield ActivateUnit(unit)
            if waits and self.activating():
                slow = yield from self.await_none(self.activating, "being activated")
                if slow:
                    raise StepFailedError(f"{_were(slow)} not active within {self.patience.start_s:g} s", slow)

    def activating(self) -> list[str]:
        """The units that this update has told to begin, and that do not work yet."""
        return sorted(self.activated & self.progress.actual.activating)

    def stop(self) -> Commands:
        progress = self.progress
        stopped = set(progress.change_set.stopped)
        for inlet in progress.switching():
            if progress.rewired[inlet] is not None and not progress.replaces_one_of(stopped, inlet):
                yield SwitchNow(inlet)
        yield from self.stop_units(progress.change_set.stopped)

    def undo(self, failed: list[str], *, keeps_new: bool) -> Commands:
        """Switch the inputs of old units back, and only then stop the new units, which feed them until then.

        The old source is always reconnected: an inlet may just have switched, unnoticed, and elements in between would
        be lost.
        """
        yield Undo()
        progress = self.progress
        actual, wanted = progress.actual, progress.wanted
        kept = actual.alive & set(progress.started) - set(failed) if keeps_new else set[str]()
        yield SetEnvironment(self.with_unconnected(kept))
        unconnected = kept | (self.activated - set(progress.started))
        # These wait until the next update connects them.
        waiting = unconnected & progress.wired() - wiring.wanted_to_run(progress.after)
        yield from self.activate(kept - waiting)
        back = {inlet: old for inlet, old in reversed(progress.rewired.items()) if inlet.unit not in progress.started}
        progress.rewired.clear()
        for inlet, old in back.items():
            fed = actual.feeds.get(inlet)
            if old is not None and old.unit in actual.alive and progress.lives(inlet):
                progress.rewired[inlet] = None if fed is None else fed.stream
                yield Connect(old, inlet)
            elif fed is not None and fed.stream == wanted[inlet]:
                yield Disconnect(inlet)
        yield from self.handovers.undo()
        yield WaitUntil(progress.may_end, self.patience.switch_s)
        for inlet in progress.switching():
            yield SwitchNow(inlet)
        for unit in sorted(actual.alive & waiting - actual.inactive):
            yield DeactivateUnit(unit)
        for inlet in [inlet for inlet in actual.feeds if inlet.unit in kept]:
            yield Disconnect(inlet)
        ending = {*progress.started, *failed} - kept
        yield from self.handovers.release(actual.alive - ending)
        yield from self.stop_units(sorted(ending))
        for unit in failed:
            yield SetEnvironment(actual.environment.without_unit(unit))
        yield from self.close_topics(self.opened)

    def stop_units(self, units: Iterable[str]) -> Commands:
        actual = self.progress.actual
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
        progress = self.progress
        outlet = Inlet("", topic)
        if outlet in progress.actual.feeds:
            yield Disconnect(outlet)
            yield SetEnvironment(wiring.without_feed(progress.actual.environment, outlet))
        yield CloseTopic(topic)

    def close_topics(self, topics: Iterable[str]) -> Commands:
        for topic in sorted(topics):
            yield CloseTopic(topic)

    def with_unconnected(self, kept: Set[str]) -> Environment:
        """The present environment with the `kept` new units, unconnected."""
        progress = self.progress
        before = progress.actual.environment
        new = tuple(
            replace(unit, subscriptions=(), publications=()) for unit in progress.change_set.started if unit.id in kept
        )
        library, hosts = dict(before.transformation), dict(before.host)
        for unit in new:
            library.setdefault(unit.transformation, progress.after.transformation[unit.transformation])
            if unit.host is not None:
                hosts.setdefault(unit.host, progress.after.host[unit.host])
        units = (*before.units, *new)
        return replace(before, units=units, library=tuple(library.values()), hosts=tuple(hosts.values()))

    def as_it_lives(self) -> Environment:
        """The wanted environment without units that have died and wires that were lost meanwhile."""
        progress = self.progress
        environment = progress.after
        for unit in progress.after.units:
            if unit.host in progress.actual.lost_hosts if unit.standby else unit.id not in progress.actual.alive:
                environment = environment.without_unit(unit.id)
        for inlet, stream in progress.wanted.items():
            if inlet not in progress.actual.feeds:
                environment = wiring.without_feed(environment, inlet, stream)
        return environment

    def fail_if_only_failing(self, starved: Set[str]) -> None:
        """Raise if a new unit's code fails while an old unit still sends the stream that the new one should send."""
        progress = self.progress
        alive = progress.actual.alive
        if not any(
            (old := progress.rewired[inlet]) is not None and old.unit in alive - starved
            for inlet in progress.switching()
        ):
            return
        failures = {unit: text for unit in progress.started if (text := progress.actual.failure(unit)) is not None}
        for unit, text in failures.items():
            raise StepFailedError(f"{unit} gives nothing, since its code fails: {text}", list(failures))


def _were(units: list[str]) -> str:
    return f"{', '.join(units)} {'was' if len(units) == 1 else 'were'}"


def _either(said: float | None, usual: float) -> float:
    return usual if said is None else said
