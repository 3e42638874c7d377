"""The process that rewires ROS 1 nodes: a node itself, which forwards topics that nodes publish to the topics of their
inputs.

Each input of a node listens to a topic of its own, on which only the relay publishes. Wires tell the relay which output
it forwards there, one at a time; the nodes do not notice a change.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial

import msgspec

from cfgplan.ros.node_api import SilentError, header_of
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import (
    CloseOutlet,
    Cut,
    End,
    Finish,
    Flow,
    Lost,
    OpenOutlet,
    PortCounts,
    Switched,
    SwitchNow,
)
from cfgplan_runtime.nodes.message_layout import UnreadableError, ros1_layout
from cfgplan_runtime.nodes.observed_outputs import ObservedOutputs
from cfgplan_runtime.nodes.passed_taps import PassedTaps
from cfgplan_runtime.nodes.relay_messages import CloseInlets, Lead, Observe, Passed, Refused, Tap, Unsaid, Untap
from cfgplan_runtime.processes.nursery import die_with_parent
from cfgplan_runtime.ros1.master_calls import MasterCalls
from cfgplan_runtime.ros1.relay_api import RelayApi
from cfgplan_runtime.ros1.relay_messages import FromTopicRelay, Listening, RelayOrder, TappedMessage, ToTopicRelay
from cfgplan_runtime.ros1.service_relay import ServiceRelay
from cfgplan_runtime.ros1.tcpros import (
    LENGTH_BYTES,
    Framed,
    Header,
    MessageReader,
    MessageWriter,
    read_header,
    subscribed,
)
from cfgplan_runtime.ros1.topic_ends import RelayedInlet, RelayedPublication, SourceTopic, begins_with_header
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.ends import Ends, Posted
from cfgplan_runtime.streams.inlet import InputQueue
from cfgplan_runtime.streams.meter import Meter

SIGN_S = 1.0
"""Seconds from one sign of life to the next."""
_CONNECT_AGAIN_S, _MOST_CONNECT_AGAIN_S = 0.05, 2.0
"""Seconds until a publisher that does not answer is tried again, doubled up to the second value."""


class TopicRelay:
    """The relay of a run. All state belongs to the thread of `run`; other threads wait for other nodes."""

    def __init__(self, order: RelayOrder, control: ControlConnection[ToTopicRelay]) -> None:
        self._node = order.node
        self._control = control
        self._sources: dict[tuple[str, str | None], SourceTopic] = {}
        self._inlets: dict[str, RelayedInlet] = {}
        self._publications: dict[str, RelayedPublication] = {}
        self._meters: dict[str, Meter] = {}
        self._observed = ObservedOutputs(lambda unit, text: self._say(Unsaid(unit, text)), is_aligned=False)
        self._taps = PassedTaps()
        self._is_finishing = False
        self._ends = Ends()
        self._posted = Posted(self._ends)
        self._services: dict[str, Lead] = {}
        """The first order for each service that the relay offers."""
        self._service_relay = ServiceRelay(order.master)
        self._listener = socket.create_server((order.host, 0), backlog=64)
        self._listener.setblocking(False)
        port = self._listener.getsockname()[1]
        self._service_place = f"rosrpc://{order.host}:{port}"
        self._api = RelayApi(self, order.master, order.host, port)
        self._to_master = MasterCalls(order.master, order.node)
        self._ends.watch(control.socket, self._hear)
        self._ends.watch(self._listener, self._accept)

    def run(self) -> None:
        """Forward messages until told to finish, or until the run is gone."""
        self._say(Listening(self._api.address))
        due = time.monotonic()
        while not self._control.has_ended and not self._is_finishing:
            self._ends.wait(max(0.0, due - time.monotonic()))
            self._posted.do()
            if time.monotonic() >= due:
                due = time.monotonic() + SIGN_S
                self._say(self._sign())

    # Other threads call these.

    def published(self) -> Mapping[str, str]:
        known = list(self._publications.values())
        return {one.topic: one.header["type"] for one in known if one.header is not None}

    def subscribed(self) -> Mapping[str, str]:
        known = list(self._sources.values())
        return {one.topic: "*" if one.header is None else one.header["type"] for one in known}

    def note_publishers(self, topic: str, addresses: list[str]) -> None:
        """Connect to these publishers of a topic, and to no others. Waits for the master."""
        self._note_publishers(topic, addresses, adds=False)

    def _note_publishers(self, topic: str, addresses: list[str], *, adds: bool) -> None:
        for source in [source for source in list(self._sources.values()) if source.topic == topic]:
            wanted = set(addresses)
            if source.publisher is not None:
                with suppress(SilentError):
                    wanted &= {self._to_master.address_of(source.publisher)}
            self._posted.post(partial(self._want, source, wanted, adds=adds))

    def finish(self) -> None:
        self._is_finishing = True
        self._posted.wake()

    # The run calls these.

    def _hear(self) -> None:
        self._control.flush()
        for message, _ in self._control.receive():
            match message:
                case Lead():
                    self._lead(message)
                case Cut(_, wire):
                    self._end(wire, drains=False)
                case End(_, wire):
                    self._end(wire, drains=True)
                case SwitchNow(name) if name in self._inlets:
                    self._hand_on(self._inlets[name], self._inlets[name].queue.switch((time.time_ns(), 0)))
                case OpenOutlet(topic):
                    self._meters[topic] = Meter(time.monotonic())
                case CloseOutlet(topic):
                    self._meters.pop(topic, None)
                    self._close_inlet(topic)
                case Observe(unit, port, topic, fields, publisher):
                    self._observed.observe(unit, port, topic, fields)
                    self._source(topic, publisher)
                case Tap(topic, tapped, publisher):
                    self._taps.open(topic, tapped)
                    source = self._source(tapped, publisher)
                    if source.latched is not None:
                        self._pass_on(source, source.latched, time.time_ns())
                case Untap(topic):
                    tapped_topic = self._taps.close(topic)
                    for source in [source for source in self._sources.values() if source.topic == tapped_topic]:
                        self._drop_unused(source)
                case CloseInlets(unit):
                    gone = self._observed.forget(unit)
                    for source in [source for source in self._sources.values() if source.topic in gone]:
                        self._drop_unused(source)
                    for name in [name for name, inlet in self._inlets.items() if inlet.unit == unit]:
                        self._close_inlet(name)
                    for target in [target for target, order in self._services.items() if order.unit == unit]:
                        self._close_service(target)
                case Finish():
                    self._is_finishing = True
        self._watch_control()

    def _lead_service(self, order: Lead) -> None:
        inlet = self._services.setdefault(order.target, order)
        if inlet is order:
            self._offer(order)
        self._service_relay.lead(order.wire, order.source, order.target)
        self._say(Switched(order.inlet, order.wire))

    def _close_service(self, target: str) -> None:
        del self._services[target]
        self._service_relay.close(target)
        self._to_master.tell("unregisterService", target, self._service_place)

    def _lead(self, order: Lead) -> None:
        if order.is_service:
            self._lead_service(order)
            return
        if order.inlet not in self._inlets:
            publication = self._publications.setdefault(order.target, RelayedPublication(order.target, order.queue))
            queue = InputQueue(order.queue)
            self._inlets[order.inlet] = RelayedInlet(order.unit, order.inlet, queue, publication)
        inlet, source = self._inlets[order.inlet], self._source(order.source, order.publisher)
        source.wires[order.wire], source.offered[order.wire] = inlet, 0
        inlet.queue.attach(order.wire)
        self._tell_switch(inlet)
        if source.latched is not None:
            source.offered[order.wire] = 1
            latched = Element(time.time_ns(), 0, 0, source.latched)
            self._hand_on(inlet, inlet.queue.accept(order.wire, latched))

    def _source(self, topic: str, publisher: str | None) -> SourceTopic:
        """Return the source of a topic, or of one publisher there. Subscribe if it is new."""
        at = topic, publisher
        if at not in self._sources:
            self._sources[at] = SourceTopic(*at)
            self._subscribe(topic)
        return self._sources[at]

    def _end(self, wire: int, *, drains: bool) -> None:
        found = next((source for source in self._sources.values() if wire in source.wires), None)
        if found is None:
            unserved = self._service_relay.end(wire)
            if unserved is not None and drains:
                self._say(Lost(self._services[unserved].inlet, wire))
            return
        if drains:
            for address, reader in list(found.readers.items()):
                self._read(found, address, reader)
        inlet = found.wires.pop(wire)
        del found.offered[wire]
        was_active = wire == inlet.queue.active
        self._hand_on(inlet, inlet.queue.end(wire))
        if was_active and inlet.queue.active is None and drains:
            inlet.reported = None
            self._say(Lost(inlet.name, wire))
        self._drop_unused(found)

    def _drop_unused(self, source: SourceTopic) -> None:
        if source.wires or source.topic in self._observed or source.topic in self._taps:
            return
        del self._sources[source.topic, source.publisher]
        for address, reader in list(source.readers.items()):
            self._forget_reader(source, address, reader)
        source.wanted.clear()
        if not any(one.topic == source.topic for one in self._sources.values()):
            self._to_master.tell("unregisterSubscriber", source.topic, self._api.address)

    def _close_inlet(self, name: str) -> None:
        inlet = self._inlets.pop(name, None)
        if inlet is None:
            return
        for source in list(self._sources.values()):
            for wire in [wire for wire, to in source.wires.items() if to is inlet]:
                del source.wires[wire], source.offered[wire]
            self._drop_unused(source)
        publication = inlet.publication
        if not any(one.publication is publication for one in self._inlets.values()):
            self._publications.pop(publication.topic, None)
            for writer in publication.writers:
                self._forget_writer(writer)
            if publication.header is not None:
                self._to_master.tell("unregisterPublisher", publication.topic, self._api.address)

    # Nodes' messages come here.

    def _want(self, source: SourceTopic, addresses: set[str], *, adds: bool) -> None:
        """Connect to these publishers of a source. With `adds`, connections to other publishers are kept, since the
        news is older.
        """
        if self._sources.get((source.topic, source.publisher)) is not source:
            return
        if adds:
            addresses |= source.wanted
        source.wanted, new = addresses, addresses - source.wanted
        for address in [address for address in source.readers if address not in addresses]:
            self._read(source, address, source.readers[address])
            if address in source.readers:
                self._forget_reader(source, address, source.readers[address])
        for address in sorted(new):
            self._begin_connecting(source, address)

    def _begin_connecting(self, source: SourceTopic, address: str) -> None:
        threading.Thread(target=self._connect, args=(source, address), daemon=True).start()

    def _connect(self, source: SourceTopic, address: str) -> None:
        """Try to subscribe at a publisher until it succeeds. Runs in a thread of its own."""
        again_s = _CONNECT_AGAIN_S
        while address in source.wanted:
            with suppress(SilentError, OSError):
                connection = subscribed(address, self._node, source.topic)
                self._posted.post(partial(self._connected, source, address, *connection))
                return
            time.sleep(again_s)
            again_s = min(2 * again_s, _MOST_CONNECT_AGAIN_S)

    def _connected(self, source: SourceTopic, address: str, end: socket.socket, header: Header) -> None:
        if address not in source.wanted or address in source.readers:
            end.close()
            return
        source.header, source.latched = header, None
        definition = header.get("message_definition", "")
        source.has_stamp, source.layout = begins_with_header(definition), None
        with suppress(UnreadableError):
            source.layout = ros1_layout(header["type"], definition)
        reader = source.readers[address] = MessageReader(end)
        self._ends.watch(end, lambda: self._read(source, address, reader))
        for inlet in set(source.wires.values()):
            self._tell_switch(inlet)

    def _read(self, source: SourceTopic, address: str, reader: MessageReader) -> None:
        for message in reader.read():
            source.messages += 1
            if source.header is not None and source.header.get("latching") == "1":
                source.latched = message
            now_ns = time.time_ns()
            time_ns, turn = source.moment(message, now_ns)
            if source.topic in self._observed:
                self._observed.note(source.topic, (now_ns - time_ns) / 1e9)
                if source.layout is not None:
                    self._observed.take(source.topic, message, source.layout)
            if source.topic in self._taps:
                self._pass_on(source, message, time_ns)
            for wire, inlet in list(source.wires.items()):
                number = source.offered[wire]
                source.offered[wire] += 1
                self._hand_on(inlet, inlet.queue.accept(wire, Element(time_ns, turn, number, message)))
        if reader.has_ended and source.readers.get(address) is reader:
            self._forget_reader(source, address, reader)
            if address in source.wanted:
                self._begin_connecting(source, address)

    def _pass_on(self, source: SourceTopic, message: Framed, time_ns: int) -> None:
        """Show a message to those who look."""
        if source.header is None:
            return
        kind, definition = source.header["type"], source.header.get("message_definition", "")
        for topic, skipped in self._taps.due(source.topic, time.monotonic()):
            self._say(TappedMessage(topic, kind, definition, time_ns, skipped, bytes(message[LENGTH_BYTES:])))

    def _forget_reader(self, source: SourceTopic, address: str, reader: MessageReader) -> None:
        del source.readers[address]
        self._ends.unwatch(reader.socket)
        reader.socket.close()

    def _hand_on(self, inlet: RelayedInlet, elements: list[Element]) -> None:
        self._tell_switch(inlet)
        publication = inlet.publication
        for element in elements:
            inlet.elements += 1
            message: Framed = element.payload  # type: ignore[assignment]
            if publication.header is not None and publication.header["latching"] == "1":
                publication.latched = message
            for writer in publication.writers:
                writer.offer(message)
            meter = None if inlet.unit else self._meters.get(inlet.name)
            if meter is not None:
                meter.note((time.time_ns() - element.time_ns) / 1e9, time.monotonic())
        if elements:
            self._watch_writers(publication)

    def _tell_switch(self, inlet: RelayedInlet) -> None:
        """Report that an inlet has switched to another wire, once the wire's type is known."""
        active = inlet.queue.active
        if active is None or active == inlet.reported:
            return
        source = next(one for one in self._sources.values() if active in one.wires)
        if source.header is not None:
            inlet.reported = active
            self._advertise(inlet.publication, source.header, partial(self._say, Switched(inlet.name, active)))

    # Messages go to nodes from here.

    def _advertise(self, publication: RelayedPublication, of: Header, then: Callable[[], None]) -> None:
        """Publish with the type of a source, and call `then` once the master knows of the topic."""
        before = publication.header
        publication.header = {
            "callerid": self._node,
            "topic": publication.topic,
            "type": of["type"],
            "md5sum": of["md5sum"],
            "message_definition": of.get("message_definition", ""),
            "latching": of.get("latching", "0"),
        }
        if publication.is_known:
            then()
        else:
            self._register(publication, of["type"], then)
        if publication.header["latching"] == "0":
            publication.latched = None
        if before is not None and before["md5sum"] != of["md5sum"]:
            publication.latched = None
            for writer in publication.writers:  # who can take the other type comes back
                self._forget_writer(writer)
            publication.writers.clear()

    def _accept(self) -> None:
        with suppress(OSError):
            end, _ = self._listener.accept()
            threading.Thread(target=self._greet, args=(end,), daemon=True).start()

    def _greet(self, end: socket.socket) -> None:
        """Agree with a subscriber on a topic and its type, or forward calls of a service. Runs in a thread
        of its own.
        """
        try:
            asks = read_header(end)
            if "service" in asks:
                self._service_relay.forward(end, asks)
                end.close()
                return
            publication = self._publications.get(asks.get("topic", ""))
            header = None if publication is None else publication.header
            if publication is None or header is None:
                raise SilentError(f"{asks.get('topic')} is not published here")
            if asks.get("md5sum") not in ("*", header["md5sum"]) and header["md5sum"] != "*":
                cause = f"{asks.get('callerid')} expects {asks.get('type')}, but the topic has {header['type']}"
                self._posted.post(lambda: self._say(Refused(publication.topic, cause)))
                raise SilentError(cause)
            end.sendall(header_of(header))
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (SilentError, OSError) as error:
            with suppress(OSError):
                end.sendall(header_of({"error": str(error)}))
            end.close()
        else:
            self._posted.post(lambda: self._add_writer(publication, end, header["md5sum"]))

    def _add_writer(self, publication: RelayedPublication, end: socket.socket, md5sum: str) -> None:
        """Begin to send to a subscriber, unless its topic has ended, or changed its type since they agreed on it."""
        is_current = self._publications.get(publication.topic) is publication
        if not is_current or publication.header is None or publication.header["md5sum"] != md5sum:
            end.close()
            return
        writer = MessageWriter(end, publication.queue)
        publication.writers.append(writer)
        self._ends.watch(end, lambda: self._hear_subscriber(publication, writer))
        if publication.latched is not None:
            writer.offer(publication.latched)
            self._watch_writers(publication)

    def _hear_subscriber(self, publication: RelayedPublication, writer: MessageWriter) -> None:
        """Continue sending. A subscriber sends nothing, so a readable socket has ended."""
        writer.flush()
        try:
            writer.has_ended = not writer.socket.recv(1 << 12)
        except BlockingIOError:
            pass
        except OSError:
            writer.has_ended = True
        self._watch_writers(publication)

    def _watch_writers(self, publication: RelayedPublication) -> None:
        for writer in list(publication.writers):
            if writer.has_ended:
                publication.writers.remove(writer)
                publication.dropped += writer.dropped
                self._forget_writer(writer)
                continue
            self._ends.write(writer.socket, is_waiting=writer.is_waiting)

    def _forget_writer(self, writer: MessageWriter) -> None:
        self._ends.unwatch(writer.socket)
        writer.socket.close()

    # Calls of the master. Its answers come in the thread of the calls.

    def _offer(self, service: Lead) -> None:
        self._to_master.ask(
            "registerService",
            service.target,
            self._service_place,
            self._api.address,
            is_wanted=lambda: self._services.get(service.target) is service,
            then=lambda _: None,
        )

    def _subscribe(self, topic: str) -> None:
        self._to_master.ask(
            "registerSubscriber",
            topic,
            "*",
            self._api.address,
            is_wanted=lambda: any(one.topic == topic for one in list(self._sources.values())),
            then=lambda publishers: self._note_publishers(topic, publishers, adds=True),
        )

    def _register(self, publication: RelayedPublication, kind: str, then: Callable[[], None]) -> None:
        def registered(_: list[str]) -> None:
            publication.is_known = True
            self._posted.post(then)

        self._to_master.ask(
            "registerPublisher",
            publication.topic,
            kind,
            self._api.address,
            is_wanted=lambda: self._publications.get(publication.topic) is publication,
            then=registered,
        )

    # Reports to the run.

    def _sign(self) -> Passed:
        now_s = time.monotonic()
        sources = dict[str, int]()
        for source in self._sources.values():
            sources[source.topic] = sources.get(source.topic, 0) + source.messages
        inlets = {name: self._counts(inlet) for name, inlet in self._inlets.items()}
        flows = {}
        for topic, meter in self._meters.items():
            flows[topic] = Flow(**meter.figures(inlets[topic].dropped if topic in inlets else 0, now_s))
        return Passed(sources, inlets, flows, self._observed.taken())

    def _counts(self, inlet: RelayedInlet) -> PortCounts:
        publication = inlet.publication
        dropped = publication.dropped + sum(writer.dropped for writer in publication.writers)
        return PortCounts(inlet.elements, dropped + inlet.queue.dropped, inlet.queue.stale)

    def _say(self, message: FromTopicRelay) -> None:
        self._control.send(message)
        self._watch_control()

    def _watch_control(self) -> None:
        self._ends.write(self._control.socket, is_waiting=self._control.is_waiting)


def main() -> None:
    """Run as a relay. Arguments: control socket's number, the run's process id, the order."""
    number, parent, order = sys.argv[1:]
    die_with_parent(int(parent))
    control: ControlConnection[ToTopicRelay] = ControlConnection(socket.socket(fileno=int(number)), ToTopicRelay)
    TopicRelay(msgspec.json.decode(order, type=RelayOrder), control).run()
    os._exit(0)  # threads that wait for other nodes are not waited for
