"""Units as nodes of ROS 1 on this computer, connected by a relay at each input."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path

import msgspec

from cfgplan.domain import Stream, Transformation
from cfgplan.errors import InputError
from cfgplan.ros.node_api import SilentError
from cfgplan.ros.topic_names import word
from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.processes.child_process import cpu_us, end_of_process, memory_bytes
from cfgplan_runtime.processes.nursery_link import start_helper
from cfgplan_runtime.ros1.node_process import NodeProcess
from cfgplan_runtime.ros1.node_watch import NodeWatch
from cfgplan_runtime.ros1.nodelet_group import NodeletGroup
from cfgplan_runtime.ros1.relay_messages import (
    CloseInlets,
    FromTopicRelay,
    Lead,
    Listening,
    Passed,
    Refused,
    RelayOrder,
    ToTopicRelay,
)
from cfgplan_runtime.ros1.ros_master import RosMaster, forget_node
from cfgplan_runtime.ros1.ros_unit import RosUnit, executable, node_source
from cfgplan_runtime.streams.ends import Ends, Posted
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Inlet, Usage
from cfgplan_runtime.supervision.delays import doubling_s

_RELAY_CODE = "from cfgplan_runtime.ros1.topic_relay import main; main()"
_RELAY_HELPER = "relay of topics"
_RELAY_S, _RELAY_START_S, _RELAY_END_S = 10.0, 60.0, 5.0
"""Seconds that the relay may be silent, and that its start and its end may take."""
_RELAY_AGAIN_S, _MOST_RELAY_AGAIN_S = 0.05, 5.0
"""Seconds until a relay that was lost twice in a row is made anew, doubled for each further loss."""


@dataclass(slots=True, eq=False)
class _UnitNode:
    """A unit's node: a process, a nodelet in a group, or somebody else's. Its `address` is known once it is ready.

    A nodelet is there once it `is_loaded`. Once it `is_leaving` it is to be unloaded.
    """

    unit: str
    ros: RosUnit
    process: NodeProcess | None = None
    group: NodeletGroup | None = None
    is_loaded: bool = False
    is_leaving: bool = False
    watch: NodeWatch | None = None
    address: str | None = None
    is_stopping: bool = False


class _Relay:
    """The process of the relay, and the connection to it. It ends with the thread that made it. Raises OSError."""

    def __init__(self, order: RelayOrder) -> None:
        self._process, ours = start_helper(_RELAY_CODE, msgspec.json.encode(order).decode(), in_own_session=True)
        self.control: ControlConnection[FromTopicRelay] = ControlConnection(ours, FromTopicRelay)

    def hear(self) -> Iterator[FromTopicRelay]:
        """What it has said."""
        self.control.flush()
        for message, _ in self.control.receive():
            yield message

    def close(self) -> int:
        """End it. Returns its exit status."""
        self._process.kill()
        status = self._process.wait(_RELAY_END_S)
        self.control.close()
        return status


class Ros1Backend:
    """A backend of ROS 1 nodes. All its methods are called from one thread, which must outlive it.

    Its master is that of ROS_MASTER_URI, or one of its own if none answers there. `folder` is what `node:./FILE` is
    relative to. Raises InputError.
    """

    def __init__(self, *, folder: Path | None = None) -> None:
        self.master = RosMaster()
        self.run_folder = RunFolder()
        self._folder = (folder or Path.cwd()).resolve()
        self._ends = Ends()
        self._posted = Posted(self._ends)
        self._events: list[events.Event] = []
        self._nodes: dict[str, _UnitNode] = {}
        self._units: dict[str, str] = {}
        """The unit of each node by the node's name."""
        self._groups: dict[str, NodeletGroup] = {}
        self._leads: dict[int, tuple[Inlet, Lead]] = {}
        """The wires that the relay leads, or will once it is there."""
        self._topics: list[str] = []
        self._passed = Passed({}, {}, {})
        self._relay: _Relay | None = None
        self._relay_node = f"/cfgplan_relay_{self.id}"
        self._relay_address = ""
        self._relay_losses = 0
        self._relay_due_s: float | None = None
        """When the relay is to be made anew; None if there is one."""
        self._to_master = ThreadPoolExecutor(1, "to-master")
        self._watch_master()
        self._start_relay()

    @property
    def id(self) -> str:
        return self.run_folder.id

    def found(self) -> None:
        return None

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._posted.wake()

    def wait(self, timeout_s: float | None) -> Sequence[events.Event]:
        if self._relay_due_s is not None:
            left_s = max(0.0, self._relay_due_s - self.now())
            timeout_s = left_s if timeout_s is None else min(timeout_s, left_s)
        self._ends.wait(0.0 if self._events or self._posted else timeout_s)
        self._posted.do()
        if self._relay_due_s is not None and self._relay_due_s <= self.now():
            self._start_relay()
        happened, self._events = self._events, []
        return happened

    def start(
        self,
        unit: str,
        transformation: Transformation,
        state: bytes | None,  # noqa: ARG002
        host: str | None,  # noqa: ARG002
        spare: str | None = None,  # noqa: ARG002
    ) -> None:
        try:
            source = node_source(transformation)
            name = source.name if source.kind == "external" else self._free_name(unit)
            self._begin(_UnitNode(unit, RosUnit(name, source, transformation)))
        except (InputError, SilentError, OSError) as error:
            self._events.append(events.UnitDied(unit, f"can't be started: {error}"))

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        """Do nothing: a node that waits would run."""

    def discard(self, spare: str) -> None:
        """Do nothing: nothing is prepared."""

    def stop(self, unit: str) -> None:
        node = self._nodes.get(unit)
        if node is not None:
            node.is_stopping = True
            self._end(node, NodeProcess.interrupt)

    def kill(self, unit: str, *, dump: bool = False) -> None:
        node = self._nodes.get(unit)
        if node is not None and not dump:
            self._end(node, NodeProcess.kill)

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:  # noqa: ARG002
        producer, consumer = self._nodes.get(stream.unit), self._nodes.get(inlet.unit)
        if producer is None or (consumer is None and not inlet.is_outlet):
            self._events.append(events.InputLost(inlet.unit or None, inlet.port, wire))
            return
        target = inlet.port if consumer is None else consumer.ros.listens_at(inlet.input)
        publisher = producer.ros.name if producer.ros.is_foreign else None
        source = producer.ros.publishes_at(stream.port)
        is_service = consumer is not None and consumer.ros.transformation.input[inlet.input].service
        lead = Lead(wire, inlet.unit, str(inlet), source, target, queue, publisher, is_service)
        self._leads[wire] = inlet, lead
        self._tell(lead)

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._leads.pop(wire, None)
        self._tell(messages.Cut(str(inlet), wire))

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:  # noqa: ARG002
        self._leads.pop(wire, None)
        self._tell(messages.End(str(inlet), wire))

    def switch_now(self, inlet: Inlet) -> None:
        self._tell(messages.SwitchNow(str(inlet)))

    def open_outlet(self, topic: str, host: str | None) -> None:  # noqa: ARG002
        self._topics.append(topic)
        self._tell(messages.OpenOutlet(topic))

    def close_outlet(self, topic: str) -> None:
        self._topics.remove(topic)
        self._tell(messages.CloseOutlet(topic))
        with suppress(SilentError):  # who asks for topics from now on does not find it
            self.master.unpublish(self._relay_node, topic, self._relay_address)

    def renew(self, helper: str) -> None:  # noqa: ARG002
        self._lose_relay()

    def usage(self, unit: str) -> Usage | None:
        """What a node has used; zero if somebody else runs it."""
        node = self._nodes.get(unit)
        if node is None:
            return None
        if node.group is not None:
            return node.group.usage(unit)
        if node.process is None:
            return Usage(0, 0)
        cpu, memory = cpu_us(node.process.pid), memory_bytes(node.process.pid)
        return None if cpu is None or memory is None else Usage(cpu, memory, node.process.pid)

    def pid(self, unit: str) -> int | None:
        node = self._nodes.get(unit)
        process = None if node is None else node.process or (node.group and node.group.process)
        return process.pid if process else None

    def close(self) -> None:
        for group in list(self._groups.values()):
            self._end_group(group)
        for node in list(self._nodes.values()):
            if node.process is not None:
                self._last_words(node.process, node.unit)
            self._bury(node, "")
        if self._relay is not None:
            self._relay.close()
        is_own = self.master.ended is not None
        if not is_own and self._relay_address:
            self._to_master.submit(forget_node, self.master.address, self._relay_node, self._relay_address)
        self._to_master.shutdown(cancel_futures=is_own)
        self.master.close()
        self._ends.close()
        self._posted.close()
        self.run_folder.close()

    # What watches tell, from their threads.

    def note_ready(self, node: str, address: str) -> None:
        if node in self._groups:
            self._groups[node].address = address
        else:
            self._post(node, lambda of: self._tell_ready(of, address))

    def note_alive(self, node: str) -> None:
        self._post(node, lambda of: self._events.append(self._status(of)))

    def note_late(self, node: str, topics: list[str]) -> None:
        line = f"cfgplan: {node} does not publish {', '.join(topics)}: what is it called in its code (`remap`)?"
        self._post(node, lambda of: self._events.append(events.UnitPrinted(of.unit, line)))

    def note_silence(self, node: str) -> None:
        self._post(node, self._note_silence)

    def _post(self, node: str, call: Callable[[_UnitNode], None]) -> None:
        def do() -> None:
            """Call it for the node; for a nodelet manager, for each of its nodelets that is loaded."""
            units = self._groups[node].used_us if node in self._groups else (self._units.get(node, ""),)
            for known in [self._nodes[unit] for unit in units if unit in self._nodes]:
                if known.group is None or known.is_loaded:
                    call(known)

        self._posted.post(do)

    def _tell_ready(self, node: _UnitNode, address: str) -> None:
        node.address = address
        usage = self.usage(node.unit)
        self._events.append(events.UnitReady(node.unit, 0 if usage is None else usage.cpu_us))

    def _status(self, node: _UnitNode) -> events.UnitStatus:
        """A sign of life, with what the relay has seen of a unit's streams."""
        outputs = {
            port.name: messages.PortCounts(self._passed.sources.get(node.ros.publishes_at(port.name), 0))
            for port in node.ros.transformation.outputs
        }
        inputs = {}
        for inlet, lead in self._leads.values():
            if inlet.unit == node.unit and lead.inlet in self._passed.inlets:
                inputs[inlet.port] = self._passed.inlets[lead.inlet]
        return events.UnitStatus(node.unit, sum(counts.elements for counts in outputs.values()), 0, inputs, outputs)

    def _note_silence(self, node: _UnitNode) -> None:
        if node.process is None and (node.group is None or node.group.process is None):
            self._bury(node, f"{node.ros.name} does not answer any more")

    # Nodes.

    def _free_name(self, unit: str) -> str:
        """A name for a unit's node. Raises InputError if another node has that name."""
        first = f"/{word(unit)}"
        names = (first, *(f"{first}_{number}" for number in range(2, len(self._units) + 3)))
        name = next(name for name in names if name not in self._units)
        with suppress(SilentError):
            self.master.ask_node(name)
            raise InputError.of(f"a node {name} is there already, which is not this run's", mend="end it")
        return name

    def _begin(self, node: _UnitNode) -> None:
        ros, transformation = node.ros, node.ros.transformation
        if ros.source.kind == "nodelet":
            self.master.set_parameters(ros.name, ros.parameters)
            node.group = self._group(ros.source.group)
            self._nodes[node.unit], self._units[ros.name] = node, node.unit
            node.group.load(node.unit, ros, lambda cause, labor_us: self._note_load(node, cause, labor_us))
            return
        if ros.is_foreign:
            self.master.ask_node(ros.name)
        else:
            self.master.set_parameters(ros.name, ros.parameters)
            process = node.process = NodeProcess(ros.command(self._folder), self.master.environment, self._folder)
            self._attend(process, lambda: self._end_of(node, process), lambda: node.unit)
        self._nodes[node.unit] = node
        self._units[ros.name] = node.unit
        node.watch = NodeWatch(
            self,
            self.master.address,
            ros.name,
            (lambda _: True) if node.process is None else node.process.has,
            [ros.publishes_at(port.name) for port in transformation.outputs],
            [ros.listens_at(port.name) for port in transformation.inputs if not port.service],
        )

    def _attend(self, process: NodeProcess, end: Callable[[], None], unit: Callable[[], str]) -> None:
        """Report what a process prints as printed by a unit, and call `end` when it has ended."""
        self._ends.watch(process.ended, end)
        self._ends.watch(process.printed.socket, lambda: self._hear_print(process, unit()))

    def _hear_print(self, process: NodeProcess, unit: str) -> bool:
        lines, is_open = process.printed.read()
        self._events.extend(events.UnitPrinted(unit, line) for line in lines)
        if not is_open:
            self._ends.unwatch(process.printed.socket)
        return bool(lines) and is_open

    def _end_of(self, node: _UnitNode, process: NodeProcess) -> None:
        """Read the last lines of a process that has ended, then report its end."""
        self._bury(node, self._last_words(process, node.unit))

    def _last_words(self, process: NodeProcess, unit: str) -> str:
        """Read what a process that has ended has still printed. Returns how it has ended."""
        process.kill()
        while self._hear_print(process, unit):
            pass
        self._ends.unwatch(process.ended)
        self._ends.unwatch(process.printed.socket)
        return end_of_process(process.reap())

    def _bury(self, node: _UnitNode, cause: str) -> None:
        """Forget a node that is gone, or given up."""
        del self._nodes[node.unit], self._units[node.ros.name]
        if node.watch is not None:
            node.watch.end()
        if node.group is not None:
            node.group.forget(node.unit)
        if node.process is not None and node.address is not None:
            self._to_master.submit(forget_node, self.master.address, node.ros.name, node.address)
        self._tell(CloseInlets(node.unit))
        self._events.append(events.UnitStopped(node.unit) if node.is_stopping else events.UnitDied(node.unit, cause))

    def _end(self, node: _UnitNode, end: Callable[[NodeProcess], None]) -> None:
        """Unload a nodelet, give up a node that somebody else runs, or call `end` with the process of any other."""
        if node.group is not None:
            self._unload(node, node.group)
        elif node.process is None:
            self._bury(node, "is given up")
        else:
            end(node.process)

    # Nodelets.

    def _group(self, name: str) -> NodeletGroup:
        """The nodelet manager of a name, or the run's own for "". Starts it, unless it is there already."""
        full = f"/{name.lstrip('/')}" if name else f"/cfgplan_nodelets_{self.id}"
        if full in self._groups:
            return self._groups[full]
        process = None
        try:
            self.master.ask_node(full)
        except SilentError:
            command = [str(executable("nodelet", "nodelet")), "manager", f"__name:={full.lstrip('/')}"]
            process = NodeProcess(command, self.master.environment, self._folder)
        group = self._groups[full] = NodeletGroup(full, self.master.address, process)
        if process is not None:
            self._attend(process, lambda: self._lose_group(group), lambda: next(reversed(group.used_us), ""))
        group.watch = NodeWatch(self, self.master.address, full, process.has if process else lambda _: True, (), ())
        return group

    def _note_load(self, node: _UnitNode, cause: str, labor_us: int) -> None:
        group = node.group
        assert group is not None

        def do(known: _UnitNode) -> None:
            if known is node and cause:
                self._bury(node, cause)
            elif known is node:
                node.is_loaded = True
                self._events.append(events.UnitReady(node.unit, labor_us))
                if node.is_leaving:
                    self._unload_now(node, group)

        self._post_of(node.unit, do)

    def _unload(self, node: _UnitNode, group: NodeletGroup) -> None:
        """Unload a nodelet once it is loaded. If its manager fails to, the manager is ended with all its nodelets."""
        if node.is_loaded and not node.is_leaving:
            self._unload_now(node, group)
        node.is_leaving = True

    def _unload_now(self, node: _UnitNode, group: NodeletGroup) -> None:

        def do(known: _UnitNode, *, is_done: bool) -> None:
            if known is not node:
                return
            if is_done:
                self._bury(node, "was unloaded")
            else:
                self._end_group(group)

        group.unload(node.ros, lambda is_done: self._post_of(node.unit, lambda known: do(known, is_done=is_done)))

    def _post_of(self, unit: str, call: Callable[[_UnitNode], None]) -> None:
        self._posted.post(lambda: call(self._nodes[unit]) if unit in self._nodes else None)

    def _end_group(self, group: NodeletGroup) -> None:
        """End a manager with all its nodelets; one that somebody else runs is given up."""
        if group.process is not None:
            group.process.kill()
        if self._groups.get(group.name) is group:
            self._lose_group(group)

    def _lose_group(self, group: NodeletGroup) -> None:
        """Report the end of a manager and of all that was in it."""
        del self._groups[group.name]
        if group.watch is not None:
            group.watch.end()
        end = "is given up"
        if group.process is not None:
            end = self._last_words(group.process, next(reversed(group.used_us), ""))
            if group.address is not None:
                self._to_master.submit(forget_node, self.master.address, group.name, group.address)
        for node in [self._nodes[unit] for unit in list(group.used_us) if unit in self._nodes]:
            if group.process is None:
                group.unloads(node.ros)
            self._bury(node, f"was in the nodelet manager {group.name}, which {end}")

    def _watch_master(self) -> None:
        if self.master.ended is not None:
            self._ends.watch(self.master.ended, self._lose_master)

    def _lose_master(self) -> None:
        """End all nodes and start this run's own master anew: nodes tell a master of themselves only once."""
        assert self.master.ended is not None
        self._ends.unwatch(self.master.ended)
        for group in list(self._groups.values()):
            self._end_group(group)
        for node in list(self._nodes.values()):
            if node.process is not None:
                self._last_words(node.process, node.unit)
            self._bury(node, "is ended, since the ROS master has died, to which it tells of itself only once")
        self._lose_relay()
        self.master.restart()
        self._watch_master()

    # The relay.

    def _tell(self, message: ToTopicRelay) -> None:
        if self._relay is not None:
            self._relay.control.send(message)
            self._wait_to_tell(self._relay)

    def _start_relay(self) -> None:
        self._relay_due_s = None
        order = RelayOrder(self._relay_node, self.master.address, self.master.host)
        try:
            relay = self._relay = _Relay(order)
        except OSError as error:
            self._events.append(events.OutOfDescriptors(f"the relay of topics can't be started: {error.strerror}"))
            self._plan_relay()
            return
        self._ends.watch(relay.control.socket, lambda: self._hear_relay(relay))
        self._events.append(events.HelperAlive(_RELAY_HELPER, _RELAY_START_S))
        for topic in self._topics:
            self._tell(messages.OpenOutlet(topic))
        if self._relay_losses:
            self._leads = {wire: one for wire, one in self._leads.items() if not one[0].is_outlet}
            for _, lead in self._leads.values():
                self._tell(lead)
            self._events.append(events.OutletsOpened())

    def _hear_relay(self, relay: _Relay) -> None:
        for message in relay.hear():
            match message:
                case Listening(address):
                    self._relay_address = address
                case messages.Switched(_, wire):
                    self._note_switch(wire)
                case messages.Lost(_, wire) if wire in self._leads:
                    inlet, _ = self._leads.pop(wire)
                    self._events.append(events.InputLost(inlet.unit or None, inlet.port, wire))
                case Passed(_, _, flows):
                    self._passed = message
                    self._events += [events.HelperAlive(_RELAY_HELPER, _RELAY_S), events.TopicsStatus(flows)]
                    self._relay_losses = 0
                case Refused(topic, cause):
                    self._tell_refusal(topic, cause)
        if relay.control.has_ended:
            self._lose_relay()
        else:
            self._wait_to_tell(relay)

    def _wait_to_tell(self, relay: _Relay) -> None:
        self._ends.write(relay.control.socket, is_waiting=relay.control.is_waiting)

    def _note_switch(self, wire: int) -> None:
        if wire in self._leads:
            inlet, _ = self._leads[wire]
            self._leads = {
                other: one for other, one in self._leads.items() if other >= wire or one[0] != inlet
            }  # those that it has replaced are gone
        self._events.append(events.WireSwitched(wire))

    def _tell_refusal(self, topic: str, cause: str) -> None:
        unit = next((inlet.unit for inlet, lead in self._leads.values() if lead.target == topic), "")
        if unit:
            self._events.append(events.UnitPrinted(unit, f"cfgplan: {topic}: {cause}"))

    def _lose_relay(self) -> None:
        """End the relay and report that. It is made anew at once the first time, later after losses in a row."""
        if self._relay is None:
            return
        self._ends.unwatch(self._relay.control.socket)
        status = self._relay.close()
        self._relay = None
        self._plan_relay()
        self._events += [
            events.HelperAlive(_RELAY_HELPER, inf),
            events.OutletsLost(f"the relay was {end_of_process(status)}"),
        ]

    def _plan_relay(self) -> None:
        self._relay_losses += 1
        self._relay_due_s = self.now() + doubling_s(self._relay_losses, _RELAY_AGAIN_S, _MOST_RELAY_AGAIN_S)
