"""The supervisor: holds the running configuration, carries out change sets, and notices faults. It never handles
processes itself.

Everything happens in the thread that calls it; the backend's events are its only input.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Collection, Generator, Mapping, Set
from dataclasses import dataclass, replace
from math import inf
from types import FunctionType
from typing import TypeAlias

import msgspec

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan_runtime.errors import ApplyError, RuntimeFaultError, StaleChangeSetError
from cfgplan_runtime.supervision import commands, events, updates
from cfgplan_runtime.supervision.backend import Backend, Failures, Found, Inlet
from cfgplan_runtime.supervision.handover_answers import HandoverAnswers
from cfgplan_runtime.supervision.listeners import LOG
from cfgplan_runtime.supervision.observation import Observation, UnitRecord
from cfgplan_runtime.supervision.spares import MEGABYTE, Spares
from cfgplan_runtime.supervision.taps import Taps
from cfgplan_runtime.supervision.wiring import Wire, Wiring, wanted_to_run, without_feed

HANG_S = 10.0
"""Seconds that a unit may be silent if its transformation has no `hang`. A source without a rate may be silent for
ever.
"""

WATCH_PERIOD_S = 0.25
_HOSTS_S = 5.0
"""Seconds that an update waits until the backend has told of each host that it adds."""
_LONGEST_ROUND_S = 1.0
"""After a longer round, this process was suspended, and has noticed nothing meanwhile."""
_DRY_S = 2.5
_MOST_REMEMBERED = 1000
"""The number of change sets that are remembered by the ids that their callers gave."""

Follower: TypeAlias = Callable[[Collection[str]], bool]
"""Follows the topics that it wants among the given ones, and returns at once whether it gets every element from now on.

If it does not yet, it wakes the backend as soon as it does.
"""


class Supervisor:
    """Holds the running configuration in `environment`, which `backend` runs; `report` gets every event, in order.

    Raises InvalidValueError if the backend lacks a method. The update under way reads it as `progress.Actual`; only the
    supervisor changes it.
    """

    def __init__(self, backend: Backend, environment: Environment, report: Callable[[events.Event], None]) -> None:
        _check_backend(backend)
        self.backend = backend
        self.environment = environment
        self.wiring = Wiring(backend)
        self.spares = Spares(backend)
        self.taps = Taps(backend, self.wiring.fresh_id, self._host_of)
        self.alive: set[str] = set()
        self.ready: set[str] = set()
        self.inactive: set[str] = set()
        """The units that give nothing, since they are not connected yet."""
        self.activating: set[str] = set()
        self.topics: dict[str, str | None] = {}
        self.hosts: dict[str, events.HostJoined | events.HostLost] = {}
        """The last event of each host that the backend reports."""
        self.ends: dict[str, str] = {}
        """By unit that has ended without being told to: its end, as the predicate of a sentence."""
        self.is_ending = False
        self.followers: tuple[Follower, ...] = ()
        self._is_abandoned: Callable[[], bool] = lambda: False
        """Whether the update under way was given up by its caller."""
        self._report = report
        self._applied: dict[str, events.Applied] = {}
        self._update_patience = updates.Patience()
        """That of the last update."""
        self._records: dict[str, UnitRecord] = {}
        self._states: dict[str, bytes] = {}
        """The last state of the units of a transformation, by the state's name."""
        self.answers = HandoverAnswers()
        self._library: dict[str, Transformation] = {}
        self._stopping: dict[str, _Stopping] = {}
        """Units that were told to stop before this supervisor began."""
        self._beginning: Set[str] = frozenset()
        self._begin_s = 0.0
        """Units of an earlier supervisor that are connected but not active yet, and when they begin: followers of their
        topics need time to connect.
        """
        self._found_s: dict[str, float] = {}
        """When each running unit of an earlier supervisor was started."""
        self._failures: dict[tuple[str, str], tuple[events.FailuresKept, float]] = {}
        """By label and host: the failures that are kept for the next manager, and when they were told."""
        self._patience: dict[str, tuple[float, float]] = {}
        """By helper process of the backend: when it gave its last sign of life, and how long it may be silent."""
        self._round_s = backend.now()
        self._suspended_s = 0.0
        self._watched_s = self.now()
        found = backend.found()
        if found is not None:
            self._adopt(found)

    def now(self) -> float:
        """The backend's clock without the times in which this process was suspended, so that they make no unit late."""
        return self.backend.now() - self._suspended_s

    def apply(
        self,
        change_set: ChangeSet,
        *,
        id: str | None = None,  # noqa: A002
        basis: Environment | None = None,
        patience: updates.Patience | None = None,
        keeps_new: bool = False,
        is_abandoned: Callable[[], bool] = lambda: False,
    ) -> events.Applied:
        """Carry out `change_set` as a whole or not at all; the same `id` is carried out once. `patience` limits its
        steps.

        `basis` is the environment that it was planned for. Raises StaleChangeSetError if it differs from the running
        configuration, or the change set names units that do not run; ApplyError if a step failed, or the update
        `is_abandoned` while it waits for new units, and all was undone. With `keeps_new`, new units that have not
        failed then stay in the environment, unconnected and paused.
        """
        if id is not None and id in self._applied:
            return self._applied[id]
        if basis is not None and basis.units != self.environment.units:
            raise StaleChangeSetError("the change set was planned for other running units than there are now")
        self._take_hosts(change_set)
        after = updates.environment_after(self.environment, change_set, self.lost_hosts)
        name = id or uuid.uuid4().hex[:12]
        self.ends.clear()
        self._update_patience = patience or updates.Patience()
        again = self._stopping.keys() & {unit.id for unit in change_set.started}
        ends_s = max((self._stopping[unit].end_s for unit in again), default=self.now()) - self.now()
        patience_s = max(0.0, ends_s) + self._update_patience.kill_s
        self._wait(commands.WaitUntil(lambda: self._stopping.keys().isdisjoint(again), patience_s))
        self._is_abandoned = is_abandoned
        try:
            update = updates.carry_out(self, change_set, after, self._update_patience, keeps_new=keeps_new)
            carried = self._drive(update)
        except ApplyError as error:
            self.spares.keep(self.environment, self.now())
            self._report(events.RolledBack(name, error.cause))
            raise
        finally:
            self._is_abandoned = lambda: False
            self.wiring.settle()
        self.backend.leave_hosts([host for host in change_set.removed_hosts if host not in carried.environment.host])
        self.environment = carried.environment
        self.spares.keep(self.environment, self.now())
        applied = events.Applied(name, dict(carried.seconds), carried.unswitched)
        if id is not None:
            self._applied[id] = applied
            if len(self._applied) > _MOST_REMEMBERED:
                del self._applied[next(iter(self._applied))]
        self._report(applied)
        return applied

    def _take_hosts(self, change_set: ChangeSet) -> None:
        """Let the backend use the hosts that a change set adds, and wait until it has reported each."""
        told_of = self.backend.take_hosts([host.name for host in change_set.added_hosts])
        for host in told_of:
            self.hosts.pop(host, None)
        self._wait(commands.WaitUntil(lambda: self.hosts.keys() >= set(told_of), _HOSTS_S))

    def pump(self, timeout_s: float) -> None:
        """Handle events; waits up to `timeout_s` seconds for the first one, but never longer than WATCH_PERIOD_S."""
        self._hear(min(max(0.0, timeout_s), WATCH_PERIOD_S))
        if self.now() - self._watched_s >= WATCH_PERIOD_S:
            self._hear(0.0)  # signs of life that wait are read before silence is judged
            self._watched_s = self.now()
            self._watch()

    def observe(self) -> tuple[Observation, ...]:
        """The present figures of every running unit."""
        observations = []
        for unit in sorted(self.alive & self.ready):
            usage = self.backend.usage(unit)
            if usage is not None:
                observations.append(self._records[unit].observe(unit, usage, self.backend.now()))
        return tuple(observations)

    @property
    def is_abandoned(self) -> bool:
        """Whether the update under way has to give up its wait for new units."""
        return self._is_abandoned()

    def end(self) -> None:
        """Make the update under way fail with RuntimeFaultError; for any thread."""
        self.is_ending = True
        self.backend.wake()

    def cut(self, unit: str | None, port: str) -> None:
        """Disconnect the inlet `port` of a unit, or the topic `port` (`unit` is None), as if it had lost its source.

        Raises KeyError if nothing feeds it.
        """
        inlet = Inlet(unit or "", port)
        wire = self.wiring.feeds[inlet]
        self.wiring.disconnect(inlet)
        self.environment = without_feed(self.environment, inlet, wire.stream)
        self._report(events.InputLost(unit, port, wire.id))

    @property
    def lost_hosts(self) -> set[str]:
        """The hosts that are lost, by the backend's last report."""
        return {host for host, last in self.hosts.items() if isinstance(last, events.HostLost)}

    @property
    def feeds(self) -> Mapping[Inlet, Wire]:
        """The wires of inlets, by inlet."""
        return self.wiring.feeds

    def failure(self, unit: str) -> str | None:
        """The error of a unit's last failed step; None if none has failed."""
        record = self._records.get(unit)
        return None if record is None or record.failure is None else record.failure.text

    def dry_units(self) -> set[str]:
        """Units with outputs that have sent nothing for a while: no switch waits for them."""
        now = self.backend.now()
        return {
            unit
            for unit, record in self._records.items()
            if record.status is not None and record.status.outputs and now - record.gave_s >= _DRY_S
        }

    def is_followed(self, topics: Set[str]) -> bool:
        """Whether all followers of these topics are connected to them. One that fails is not waited for."""
        waiting = [follower for follower in self.followers if not _is_connected(follower, topics)]  # each is asked
        return not waiting

    def _adopt(self, found: Found) -> None:
        """Continue with the units of an earlier supervisor. Their silence so far makes no unit late."""
        self.environment = replace(self.environment, units=found.units, library=found.library, hosts=found.hosts)
        self.topics.update(found.topics)
        self.wiring.adopt(found.wires, found.stopping, found.last_wire)
        self.spares.adopt(self.environment, found.labor_us, self.now())
        self._states.update(found.states)
        self._found_s = {unit: self.backend.now() - age_s for unit, age_s in found.ages_s.items()}
        for unit_id, stopping in found.stopping.items():
            limit_s = self._update_patience.stop_s if stopping.stop_s is None else stopping.stop_s
            told_s = self.now() - stopping.told_s
            self._stopping[unit_id] = _Stopping(told_s + updates.STOP_AGAIN * limit_s, told_s + limit_s, limit_s)
            self._records[unit_id] = UnitRecord(stopping.label, stopping.host, state_name=stopping.state_name)
        for unit in found.units:
            if unit.standby:
                continue
            self.alive.add(unit.id)
            transformation = self._library[unit.id] = self.environment.transformation[unit.transformation]
            record = self._records[unit.id] = self._new_record(unit, transformation)
            if unit.id in found.labor_us:
                self.ready.add(unit.id)
                record.labor_us = found.labor_us[unit.id]
        self.inactive |= found.inactive
        connected = {end for wire in found.wires for end in (wire.stream.unit, wire.inlet.unit)}
        self._beginning = found.inactive & (connected | wanted_to_run(self.environment))
        self._begin_s = self.now() + self._update_patience.follow_s

    def _drive(self, update: Generator[commands.Command, None, updates.CarriedOut]) -> updates.CarriedOut:
        """Carry out an update. The first command that fails is thrown into it, so that all is undone.

        Failures during the undoing, or after Commit, are logged, and the other commands are carried out.
        """
        fault: Exception | None = None
        may_be_undone = True
        try:
            while True:
                command = update.throw(fault) if fault is not None and may_be_undone else next(update)
                may_be_undone = may_be_undone and not isinstance(command, commands.Commit | commands.Undo)
                fault = self._fault_of(command, may_be_undone=may_be_undone)
        except StopIteration as end:
            carried: updates.CarriedOut = end.value
            return carried

    def _fault_of(self, command: commands.Command, *, may_be_undone: bool) -> Exception | None:
        """Carry out a command of an update. Returns its exception; only the end of the runtime is raised."""
        try:
            self._obey(command)
        except Exception as error:
            if self.is_ending:
                raise
            if not may_be_undone:
                LOG.exception("%s has failed, and the update continues", type(command).__name__)
            return error
        return None

    def _obey(self, command: commands.Command) -> None:
        match command:
            case commands.OpenTopic(topic, host):
                self.topics[topic] = host
                self.backend.open_outlet(topic, host)
            case commands.CloseTopic(topic):
                self.topics.pop(topic, None)
                self.backend.close_outlet(topic)
            case commands.StartUnit(unit, transformation):
                self._start(unit, transformation)
            case commands.ActivateUnit(unit_id):
                self._activate(unit_id)
            case commands.DeactivateUnit(unit_id):
                self.inactive.add(unit_id)
                self.activating.discard(unit_id)
                self.backend.deactivate(unit_id)
            case commands.HoldUnit(unit_id):
                self.backend.hold(unit_id)
            case commands.AskPlaces(unit_id, inlets):
                self.answers.ask(command)
                self.backend.ask_places(unit_id, inlets)
            case commands.AskState(unit_id, until, successor):
                self.answers.ask(command)
                self.backend.ask_state(unit_id, until, successor)
            case commands.GiveState(unit_id, state, inputs, outputs):
                if state is None and unit_id in self._library:  # it has not died meanwhile
                    state = self._states.get(self._library[unit_id].state_name or "")
                self.backend.give_state(unit_id, state, inputs, outputs)
            case commands.TellOf(event):
                self._report(event)
            case commands.Doubt(event):
                self.answers.doubt(command)
                self._report_settled(event.unit)
            case commands.StopUnit(unit_id):
                self.wiring.forget_inputs(unit_id)
                self.backend.stop(unit_id)
            case commands.EndUnit(unit_id):
                self.backend.kill(unit_id)
            case commands.StopAgain(unit_id):
                self.backend.stop(unit_id)
            case commands.CutShort(unit_id, after_s):
                self._cut_short(unit_id, after_s)
            case commands.Dump(unit_id):
                self.backend.kill(unit_id, dump=True)
            case commands.Connect(stream, inlet):
                self.wiring.connect(stream, inlet, self._library.get(inlet.unit))
            case commands.Disconnect(inlet):
                self.wiring.disconnect(inlet)
            case commands.SwitchNow(inlet):
                self.backend.switch_now(inlet)
            case commands.SetEnvironment(environment):
                self.environment = environment
            case commands.WaitUntil():
                self._wait(command)

    @property
    def kept(self) -> list[events.UnitFound | events.FailuresKept]:
        """The present reports for a new manager: UnitFound for each unit of an earlier one, and FailuresKept."""
        now = self.backend.now()
        failures = [
            msgspec.structs.replace(one, left_s=max(0.0, one.left_s - (now - told_s)))
            for one, told_s in self._failures.values()
        ]
        return [*(events.UnitFound(unit, now - since_s) for unit, since_s in self._found_s.items()), *failures]

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Keep the `failures` of the transformation `label` on a `host` for the next manager, here and in the backend;
        None: forget them.
        """
        if host is not None and failures is not None:
            kept = events.FailuresKept(label, host, failures.number, failures.left_s, failures.cause, failures.digest)
            self._failures[label, host] = kept, self.backend.now()
        elif host is not None:
            self._failures.pop((label, host), None)
        self.backend.remember(label, host, failures)

    def stop_s(self, unit: str) -> float | None:
        """The seconds that a unit may take to end, by its transformation; None if that has no `stop`."""
        stop_us = self._library[unit].run.stop_us if unit in self._library else None
        return None if stop_us is None else stop_us / 1e6

    def _cut_short(self, unit: str, after_s: float) -> None:
        """Kill a unit that takes too long to end, and report how much of its input waited at its last sign of life."""
        if unit in self._records:
            self._report(events.UnitCutShort(unit, after_s, self._records[unit].waiting))
        self.backend.kill(unit)

    def _wait(self, until: commands.WaitUntil) -> None:
        deadline = self.now() + until.patience_s
        while not until.holds() and self.now() < deadline:
            if self.is_ending:
                raise RuntimeFaultError("the runtime is closed")
            self.pump(deadline - self.now())

    @property
    def _patience_to_start_s(self) -> float:
        """How long a unit may take to be ready that no update waits for: an update has ended it before."""
        return self._update_patience.start_s + self._update_patience.kill_s

    def _start(self, unit: ComputationUnit, transformation: Transformation) -> None:
        self.alive.add(unit.id)
        self.inactive.add(unit.id)
        self.ready.discard(unit.id)
        self.ends.pop(unit.id, None)
        self._library[unit.id] = transformation
        self._records[unit.id] = self._new_record(unit, transformation)
        spare = self.spares.take(transformation, unit.host)
        try:
            self.backend.start(
                unit.id, transformation, self._states.get(transformation.state_name or ""), unit.host, spare
            )
        except Exception:
            self._remove_dead(unit.id)
            raise

    def _activate(self, unit: str) -> None:
        if self.backend.activate(unit):
            self.activating.add(unit)
        self.inactive.discard(unit)

    def _new_record(self, unit: ComputationUnit, transformation: Transformation) -> UnitRecord:
        return UnitRecord(transformation.label, unit.host, sign_s=self.now(), state_name=transformation.state_name)

    def _hear(self, timeout_s: float) -> None:
        happened = self.backend.wait(timeout_s)
        now = self.backend.now()
        if now - self._round_s > _LONGEST_ROUND_S:
            self._suspended_s += now - self._round_s
        self._round_s = now
        for event in happened:
            if self._understand(event):
                self._report(event)

    def _understand(self, event: events.Event) -> bool:
        """Update the state by an event. Returns whether to report it to listeners."""
        match event:
            case events.UnitReady(unit, labor_us) if unit in self._records:
                self.ready.add(unit)
                record = self._records[unit]
                record.labor_us, record.sign_s = labor_us, self.now()
            case events.UnitActive(unit):
                self.activating.discard(unit)
                return False
            case events.UnitDied(unit):
                self.ends[unit] = event.end
                self._remove_dead(unit)
                self.environment = self.environment.without_unit(unit)
            case events.UnitStopped(unit):
                self._remove_dead(unit)
            case events.SparePrepared():
                return self.spares.note_prepared(event, self.now())
            case events.SpareLost(unit):
                return self.spares.note_loss(unit, self.now())
            case events.WireSwitched(wire):
                self.wiring.note_switch(wire)
            case events.InputLost(_, _, wire):
                lost = self.wiring.note_loss(wire)
                if lost is None:
                    self.taps.note_loss(wire)
                    return False
                self.environment = without_feed(self.environment, lost.inlet, lost.stream)
            case events.UnitStatus(unit):
                self._note_status(unit, event)
            case events.PlacesTold(unit) | events.StateTold(unit) if unit in self._records:
                self.answers.note(event)
                self._report_settled(unit)
                if isinstance(event, events.StateTold):
                    self._keep_state(unit, event.state)
                return False
            case events.PlacesTold() | events.StateTold():
                return False
            case events.UnitFailed(unit):
                if unit in self._records and event.text:
                    self._records[unit].failure = event
            case events.HelperAlive(helper, patience_s):
                self._patience[helper] = self.now(), patience_s
                return False
            case events.OutletsOpened():
                self._restore_outlets()
                self.taps.note_new_outlets()
            case events.FailuresKept():
                self._failures[event.transformation, event.host] = event, self.backend.now()
            case events.HostLost(host, cause):
                self.hosts[host] = event
                self._lose(host, cause)
            case events.HostJoined(host):
                self.hosts[host] = event
                for topic in [topic for topic, at in self.topics.items() if at == host]:
                    self.backend.open_outlet(topic, host)
        return True

    def _note_status(self, unit: str, status: events.UnitStatus) -> None:
        record = self._records.get(unit)
        if record is None:
            return
        record.sign_s = self.now()
        record.note_status(status, self.backend.now())
        self._keep_state(unit, status.state)

    def _report_settled(self, unit: str) -> None:
        settled = self.answers.settled(unit)
        if settled is not None:
            self._report(settled)

    def _keep_state(self, unit: str, state: bytes | None) -> None:
        name = self._records[unit].state_name
        if state and name is not None:
            self._states[name] = state

    def _remove_dead(self, unit: str) -> None:
        self.alive.discard(unit)
        self.ready.discard(unit)
        self.inactive.discard(unit)
        self.activating.discard(unit)
        self._stopping.pop(unit, None)
        self.wiring.forget_unit(unit)
        self.taps.lose_unit(unit)
        self._records.pop(unit, None)
        self.answers.forget(unit)
        self._library.pop(unit, None)
        self._found_s.pop(unit, None)

    def _host_of(self, unit: str) -> str | None:
        """Return the host of a running unit; None if it has none, or does not run."""
        return self._records[unit].host if unit in self._records else None

    def _lose(self, host: str, cause: str) -> None:
        """Forget the units and cold spares on a lost host, and close the wires to its topics."""
        for unit in [unit for unit, record in self._records.items() if record.host == host]:
            self.ends[unit] = f"was given up: host {host} is gone: {cause}"
            self._remove_dead(unit)
        self.spares.lose_host(host)
        self.taps.lose_host(host)
        for unit_there in [unit for unit in self.environment.units if unit.host == host]:
            self.environment = self.environment.without_unit(unit_there.id)
        for topic in [topic for topic, at in self.topics.items() if at == host]:
            outlet = Inlet("", topic)
            self.wiring.forget_inlet(outlet)
            self.environment = without_feed(self.environment, outlet)

    def _restore_outlets(self) -> None:
        """Feed the topics again, after the backend has replaced their addresses."""
        for inlet, wire in list(self.wiring.feeds.items()):
            if inlet.is_outlet:
                del self.wiring.feeds[inlet]
                self.wiring.connect(wire.stream, inlet, None)

    def _watch(self) -> None:
        """Renew helpers that hang, and kill units that hang or have grown too large."""
        now = self.now()
        for lost in self.spares.watch(now):
            self._report(lost)
        for helper, (sign_s, silence_s) in list(self._patience.items()):
            if now - sign_s > silence_s:
                del self._patience[helper]
                self._report(events.HelperHung(helper, now - sign_s))
                self.backend.renew(helper)
        if self._beginning and now >= self._begin_s:
            beginning, self._beginning = self._beginning & self.inactive, frozenset()
            for unit in sorted(beginning):
                self._activate(unit)
        for unit, stopping in self._stopping.items():
            if now >= stopping.end_s:
                if not stopping.is_cut_short:
                    stopping.is_cut_short = True
                    self._cut_short(unit, stopping.limit_s)
            elif now >= stopping.again_s:
                stopping.again_s = inf
                self.backend.stop(unit)
        for unit in sorted(self.alive):
            record, run = self._records[unit], self._library[unit].run
            if record.killed_s is not None:
                if now - record.killed_s >= updates.TIME_TO_DUMP_S:
                    self.backend.kill(unit)
                continue
            patience_s = _patience_s(self._library[unit]) if unit in self.ready else self._patience_to_start_s
            if patience_s is not None and now - record.sign_s > patience_s:
                record.killed_s = now
                self._report(events.UnitHung(unit, now - record.sign_s))
                self.backend.kill(unit, dump=True)
            elif run.memory_mb is not None:
                usage = self.backend.usage(unit)
                if usage is not None and usage.memory_bytes > run.memory_mb * MEGABYTE:
                    record.killed_s = now
                    self._report(events.UnitTooLarge(unit, usage.memory_bytes))
                    self.backend.kill(unit)


@dataclass(slots=True)
class _Stopping:
    """A unit that was told to stop: it is told again at `again_s`, and killed at `end_s`, after `limit_s` seconds."""

    again_s: float
    end_s: float
    limit_s: float
    is_cut_short: bool = False


def _check_backend(backend: Backend) -> None:
    """Raise InvalidValueError if a backend lacks methods. Without this check, only the update that needs them fails."""
    methods = (name for name, member in vars(Backend).items() if isinstance(member, FunctionType) and name[0] != "_")
    lacking = sorted(name for name in methods if not callable(getattr(backend, name, None)))
    if lacking:
        name = type(backend).__name__
        raise InvalidValueError(f"the backend {name} lacks {', '.join(lacking)}; see Backend in {Backend.__module__}")


def _is_connected(follower: Follower, topics: Collection[str]) -> bool:
    try:
        return follower(topics)
    except Exception:
        LOG.exception("a follower of %s has failed", ", ".join(sorted(topics)))
        return True


def _patience_s(transformation: Transformation) -> float | None:
    run = transformation.run
    if run.hang_us is not None:
        return run.hang_us / 1e6 or None
    is_free_source = not transformation.inputs and run.rate_hz is None
    return None if is_free_source else HANG_S
