"""A fleet's backend: agents run units on their hosts, and streams between hosts go through the hosts' relays."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from types import MappingProxyType

import msgspec

from cfgplan.domain import MANAGER, Stream, Transformation
from cfgplan.errors import InputError
from cfgplan_runtime.children.messages import Flow, GivenInput, ImportUnused
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.fleet import orders, presence
from cfgplan_runtime.fleet.adoption import adopt, code_digest, failures_kept
from cfgplan_runtime.fleet.certificates import Validity
from cfgplan_runtime.fleet.routes import Counts, OrderTo, Routes
from cfgplan_runtime.fleet.tunnels import RemoteTopics, TunnelClient, TunnelServer
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Failures, Found, Inlet, Usage

WAIT_S = 3.0
"""Seconds that a run waits for its hosts when it begins."""
_NO_AGENT = "it has no agent"


@dataclass(slots=True)
class _Told:
    """The last messages of an agent about its host."""

    usage: dict[str, Usage] = field(default_factory=dict)
    flows: dict[str, Flow] = field(default_factory=dict)
    helpers: set[str] = field(default_factory=set)


class FleetBackend:
    """The backend of a manager. It reports those of `hosts` as lost that have not joined after `wait_s` seconds.

    `link` connects to the agents; the caller opens and closes it. Sources such as `units.py:Class` are relative to
    `folder` on this computer; each host needs the same files. A unit or topic without a host goes to the first host
    that has joined. `found` has the running units of the hosts that are in `library`; all others are ended. Raises
    InputError, also if another manager has a host and this one does not take over (`takes_over`), or reaches fewer than
    half of the hosts.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        run_folder: RunFolder,
        link: ZenohLink,
        *,
        folder: Path | None = None,
        library: Mapping[str, Transformation] = MappingProxyType({}),
        wait_s: float = WAIT_S,
        takes_over: bool = False,
        certificates: Path | None = None,
    ) -> None:
        self._validity = None if certificates is None else Validity(certificates, MANAGER)
        self._folder = folder or Path.cwd()
        self._events: list[events.Event] = []
        self._told: dict[str, _Told] = {}
        self._units: dict[str, str] = {}
        self._spares: dict[str, str] = {}
        self._anywhere: set[str] = set()
        """Units and spares without a required host. The supervisor does not know their host, so this backend reports
        their deaths with it.
        """
        self._awaited: set[str] = set()
        """Hosts that were greeted and have not answered yet."""
        self._topics: dict[str, tuple[str | None, str]] = {}
        """For each topic the host that was asked for, and the host where it is."""
        self._unplaced: set[str] = set()
        """Topics without a required host, while no host has joined."""
        self._failures: dict[str, dict[str, orders.HeldFailures]] = {}
        """By host and label: the failures that hosts keep for later managers, with the time on this backend's clock."""
        self._settled: set[str] = set()
        """The hosts whose failures, kept for this manager, have been reported."""
        self._routes = Routes(run_folder.id)
        self._counts = Counts()
        self._library = library
        self.run_folder = run_folder
        self._tunnels = TunnelServer(link, MANAGER, self.id, run_folder.path)
        self._reaching = TunnelClient(link)
        self._topics_elsewhere = RemoteTopics(self._reaching, run_folder)
        self._presence = presence.Presence(link, self.id, run_folder.tell_clock)
        try:
            happened = self._presence.await_all(hosts, wait_s, takes_over=takes_over)
        except InputError:
            self.close()
            raise
        for one in happened:
            self._take(one)
        gone = {one.host.name: one.cause for one in happened if isinstance(one, presence.AgentGone)}
        told = {event.host for event in self._events if isinstance(event, events.HostLost)}
        absent = [host for host in hosts if host not in self._presence.there and host not in told]
        self._events += [events.HostLost(host, gone.get(host, _NO_AGENT)) for host in absent]

    @property
    def id(self) -> str:
        return self.run_folder.id

    def found(self) -> Found | None:
        there = self._presence.there
        held = {name: host.held for name, host in there.items()}
        adopted = adopt(self.id, held, self._library, {name: host.states for name, host in there.items()})
        self._units, self._spares = dict(adopted.units), dict(adopted.spares)
        self._topics, self._routes = dict(adopted.topics), adopted.routes
        self._give(adopted.orders)
        for topic, (_, host) in self._topics.items():
            self._show(topic, host)
        return adopted.found

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._presence.wake()

    def wait(self, timeout_s: float | None) -> Sequence[events.Event]:
        end_s = inf if timeout_s is None else self.now() + timeout_s
        is_awake = False
        while True:
            happened, is_awake = self._presence.wait(self.now() if self._events else end_s)
            for one in happened:
                self._take(one)
            self._watch_certificate()
            if is_awake or self._events or self.now() >= end_s:
                break
        told, self._events = self._events, []
        return told

    def _watch_certificate(self) -> None:
        """Report once a day that the manager's certificate ends soon. At its end, other hosts close the links."""
        with suppress(InputError):
            if self._validity is not None and (ends := self._validity.warning()) is not None:
                self._events.append(ends)

    def take_hosts(self, hosts: Collection[str]) -> Collection[str]:
        greeted, absent = self._presence.take(hosts)
        self._awaited |= set(greeted)
        self._events += [events.HostLost(host, _NO_AGENT) for host in absent]
        return [*greeted, *absent]

    def leave_hosts(self, hosts: Collection[str]) -> None:
        self._presence.leave(hosts)
        for host in hosts:
            self._told.pop(host, None)
            self._give(self._routes.forget_host(host))

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        if host is None:
            return
        if failures is None:
            self._failures.get(host, {}).pop(label, None)
            self._presence.say(host, orders.KeepFailuresOrder(label, None))
            return
        source = failures.transformation.source or ""
        code = code_digest(source, self._folder)
        kept = orders.HeldFailures(
            failures.number, failures.left_s, failures.cause, failures.digest, source, code, self.now()
        )
        self._failures.setdefault(host, {})[label] = kept
        self._presence.say(host, orders.KeepFailuresOrder(label, kept))

    def start(
        self, unit: str, transformation: Transformation, state: bytes | None, host: str | None, spare: str | None = None
    ) -> None:
        there = self._place(host)
        if spare is not None and self._spares.get(spare) != there:
            self.discard(spare)
            spare = None
        self._spares.pop(spare or "", None)
        if there is None:
            return
        self._units[unit] = there
        self._note_place(unit, host)
        order = unit_order(unit, transformation, state)
        self._presence.say(
            there,
            orders.StartOrder(transformation.label, order, code_digest(transformation.source, self._folder), spare),
        )

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        there = self._place(host)
        if there is None:
            return
        self._spares[spare] = there
        self._note_place(spare, host)
        order = unit_order(spare, transformation, None)
        self._presence.say(
            there, orders.PrepareOrder(transformation.label, order, code_digest(transformation.source, self._folder))
        )

    def discard(self, spare: str) -> None:
        self._presence.say(self._spares.pop(spare, None), orders.DiscardOrder(spare))

    def stop(self, unit: str) -> None:
        if unit in self._units:
            self._give(self._routes.stop(unit, self._units[unit]))

    def kill(self, unit: str, *, dump: bool = False) -> None:
        self._presence.say(self._units.get(unit), orders.KillOrder(unit, dump))

    def activate(self, unit: str) -> bool:
        self._presence.say(self._units.get(unit), orders.ActivateOrder(unit, is_active=True))
        return False

    def deactivate(self, unit: str) -> None:
        self._presence.say(self._units.get(unit), orders.ActivateOrder(unit, is_active=False))

    def hold(self, unit: str) -> None:
        self._presence.say(self._units.get(unit), orders.HoldOrder(unit))

    def ask_places(self, unit: str, inlets: Mapping[str, bool]) -> None:
        self._presence.say(self._units.get(unit), orders.AskPlacesOrder(unit, dict(inlets)))

    def ask_state(self, unit: str, until: Mapping[str, Moment], successor: str) -> None:
        self._presence.say(self._units.get(unit), orders.AskStateOrder(unit, dict(until), successor))

    def give_state(
        self, unit: str, state: bytes | None, inputs: Mapping[str, GivenInput], outputs: Mapping[str, Moment]
    ) -> None:
        order = orders.GiveStateOrder(unit, state, dict(inputs), dict(outputs))
        self._presence.say(self._units.get(unit), order)

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        source, target = self._units.get(stream.unit), self._host_of(inlet)
        if target is None:
            return
        if source is None:
            self._events.append(events.InputLost(inlet.unit or None, inlet.port, wire))
            return
        self._give(self._routes.connect(wire, stream, inlet, source, target, queue=queue, blocks=blocks))

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._give(self._routes.disconnect(wire, inlet, self._host_of(inlet)))

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:  # noqa: ARG002
        source = self._routes.source_of(wire)
        has_consumer = inlet.is_outlet or inlet.unit in self._units
        has_source = source is not None and self._presence.find(source) is not None
        self._give(self._routes.end(wire, has_both_ends=has_consumer and has_source))

    def switch_now(self, inlet: Inlet) -> None:
        self._presence.say(self._host_of(inlet), orders.SwitchOrder(inlet))

    def open_outlet(self, topic: str, host: str | None) -> None:
        there = self._place(host)
        if there is not None:
            self._topics[topic] = (host, there)
            self._presence.say(there, orders.OpenTopicOrder(topic, host))
            self._show(topic, there)
        elif host is None:
            self._unplaced.add(topic)

    def close_outlet(self, topic: str) -> None:
        _, there = self._topics.pop(topic, (None, ""))
        self._unplaced.discard(topic)
        self._topics_elsewhere.hide(topic)
        self._presence.say(there, orders.CloseTopicOrder(topic))

    def renew(self, helper: str) -> None:
        host, _, name = helper.partition(": ")
        self._presence.say(host, orders.RenewOrder(name))

    def usage(self, unit: str) -> Usage | None:
        told = self._told.get(self._units.get(unit) or self._spares.get(unit, ""))
        return None if told is None else told.usage.get(unit)

    def pid(self, unit: str) -> int | None:
        usage = self.usage(unit)
        return None if usage is None else usage.pid

    def close(self) -> None:
        self._presence.leave()
        for end in (self._topics_elsewhere, self._reaching, self._tunnels):
            end.close()

    def _take(self, news: presence.AgentNews) -> None:
        match news:
            case presence.AgentJoined(host, day_ahead_ns):
                self._awaited.discard(host.name)
                self._events.append(events.HostJoined(host.name, day_ahead_ns // 1000))
                self._settle_failures(host)
                if self._unplaced:
                    unplaced, self._unplaced = self._unplaced, set()
                    for topic in unplaced:
                        self.open_outlet(topic, None)
                    self._events.append(events.OutletsOpened())
            case presence.AgentClockSet(host, day_ahead_ns):
                self._events.append(events.ClockMoved(host.name, day_ahead_ns // 1000))
            case presence.AgentGone(host, cause):
                self._lose(host, cause)
            case presence.AgentMessage(host, message):
                try:
                    self._understand(host.name, message)
                except msgspec.MsgspecError as error:
                    self._presence.leave_alone(host, orders.other_version(host.channel.theirs or "", error))

    def _lose(self, host: presence.HostState, cause: str) -> None:
        self._reaching.lose(host.life)
        helpers = self._told.pop(host.name, _Told()).helpers
        self._events += [events.HelperAlive(f"{host.name}: {helper}", inf) for helper in helpers]
        if not host.is_there:
            if host.name in self._awaited and not self._presence.greets(host.name):
                self._awaited.discard(host.name)
                self._events.append(events.HostLost(host.name, cause))
            return
        self._events.append(events.HostLost(host.name, cause))
        told = f"host {host.name} is gone: {cause}"
        for unit in sorted(self._anywhere):
            if self._units.get(unit) == host.name:
                self._events.append(events.UnitDied(unit, told, "was given up"))
            elif self._spares.get(unit) == host.name:
                self._events.append(events.SpareLost(unit, told))
        self._units = {unit: at for unit, at in self._units.items() if at != host.name}
        self._spares = {spare: at for spare, at in self._spares.items() if at != host.name}
        self._give(self._routes.forget_host(host.name))
        moved = [topic for topic, (asked, at) in self._topics.items() if at == host.name and asked is None]
        for topic in [topic for topic, (_, at) in self._topics.items() if at == host.name]:
            self._topics_elsewhere.hide(topic)
            del self._topics[topic]
        for topic in moved:
            self.open_outlet(topic, None)
        if moved:
            self._events += [events.OutletsLost(f"{host.name} is gone"), events.OutletsOpened()]

    def _understand(self, host: str, message: orders.FromAgent) -> None:
        match message:
            case orders.EventReport():
                self._note(host, orders.event_of(message))
            case orders.UsageReport(usage, crossings):
                self._told.setdefault(host, _Told()).usage.update(usage)
                counts = self._counts.after(crossings, self._routes)
                if counts:
                    self._events.append(events.CrossingsStatus(counts))
            case ImportUnused(crossing, served):
                self._give(self._routes.note_unused(crossing, served))

    def _note(self, host: str, event: events.Event) -> None:
        told = self._told.setdefault(host, _Told())
        match event:
            case events.UnitDied(unit) | events.UnitStopped(unit) if self._units.get(unit, host) != host:
                return  # a unit of that id on another host was kept
            case events.UnitDied(unit) | events.UnitStopped(unit):
                self._units.pop(unit, None)
                told.usage.pop(unit, None)
                self._routes.forget_unit(unit)
            case events.SpareLost(spare):
                self._spares.pop(spare, None)
                told.usage.pop(spare, None)
            case events.WireSwitched(wire):
                self._routes.note_switch(wire)
            case events.InputLost(_, _, wire):
                self._routes.forget(wire)
            case events.HelperAlive(helper, patience_s):
                told.helpers.add(helper)
                event = events.HelperAlive(f"{host}: {helper}", patience_s)
            case events.TopicsStatus(flows):
                told.flows = dict(flows)
                event = events.TopicsStatus(
                    {topic: flow for one in self._told.values() for topic, flow in one.flows.items()}
                )
            case events.OutOfDescriptors(cause):
                event = events.OutOfDescriptors(f"{host}: {cause}")
        self._events.append(event)

    def _give(self, given: Iterable[OrderTo]) -> None:
        for host, order in given:
            self._presence.say(host, order)

    def _settle_failures(self, host: presence.HostState) -> None:
        """When a host joins, report the failures that it has kept for this manager; when it is back, send it the
        present ones.

        The host forgets all others: those of changed code, and those that this manager forgot while it was away.
        """
        known = self._failures.get(host.name, {})
        kept = [] if host.name in self._settled else failures_kept(host.name, host.held, self._folder)
        self._settled.add(host.name)
        self._events += [one for one in kept if one.transformation not in known]
        for label in host.held.failures.keys() - {one.transformation for one in kept} - known.keys():
            self._presence.say(host.name, orders.KeepFailuresOrder(label, None))
        for label, failures in known.items():
            self._presence.say(host.name, orders.KeepFailuresOrder(label, failures.at(self.now())))

    def _note_place(self, unit: str, host: str | None) -> None:
        (self._anywhere.add if host is None else self._anywhere.discard)(unit)

    def _place(self, host: str | None) -> str | None:
        """The host, or the first one if None is given. None if it has not joined."""
        found = self._presence.find(host)
        return None if found is None else found.name

    def _show(self, topic: str, host: str) -> None:
        """Show a topic of a host in this run's folder."""
        there = self._presence.there[host]
        if there.run is None:
            self._topics_elsewhere.show(topic, host, there.life)
        else:
            self.run_folder.show(topic, there.run)

    def _host_of(self, inlet: Inlet) -> str | None:
        if inlet.is_outlet:
            return self._topics[inlet.port][1] if inlet.port in self._topics else None
        return self._units.get(inlet.unit)
