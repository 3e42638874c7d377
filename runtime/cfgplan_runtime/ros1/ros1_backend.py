"""Units as nodes of ROS 1 on this computer, connected by a relay at each input."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from cfgplan.domain import Stream, Transformation
from cfgplan.errors import InputError
from cfgplan.ros.node_api import SilentError
from cfgplan.ros.topic_names import word
from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.exit_status import clause_of
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.nodes.relay_messages import Lead, Tap
from cfgplan_runtime.nodes.relayed_wires import ENVIRONMENT_FILE, RelayedWires
from cfgplan_runtime.nodes.watched_processes import NOT_OURS, WatchedProcesses
from cfgplan_runtime.processes.child_process import cpu_us, memory_bytes
from cfgplan_runtime.processes.nursery_link import start_helper
from cfgplan_runtime.ros1.node_watch import NodeWatch
from cfgplan_runtime.ros1.nodelet_group import NodeletGroup
from cfgplan_runtime.ros1.relay_messages import FromTopicRelay, Listening, RelayOrder, TappedMessage
from cfgplan_runtime.ros1.ros_master import RosMaster, forget_node
from cfgplan_runtime.ros1.ros_unit import RosUnit, executable, node_source
from cfgplan_runtime.ros1.tapped_values import MessageDecoders
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.ends import Ends, Posted
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Failures, Inlet, Usage

_RELAY_CODE = "from cfgplan_runtime.ros1.topic_relay import main; main()"
_RELAY_END_S = 5.0
"""Seconds that the relay's end may take."""


@dataclass(slots=True, eq=False)
class _UnitNode:
    """A unit's node: a process, a nodelet in a group, or an external node. Its `address` is known once it is ready.

    A nodelet runs once it `is_loaded`, and will be unloaded once it `is_leaving`.
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
        self._process, self.socket = start_helper(_RELAY_CODE, msgspec.json.encode(order).decode(), in_own_session=True)
        self._control: ControlConnection[FromTopicRelay] = ControlConnection(self.socket, FromTopicRelay)
        self.has_ended = False
        self.last_words = ""

    @property
    def is_waiting(self) -> bool:
        return self._control.is_waiting

    def send(self, message: msgspec.Struct) -> None:
        self._control.send(message)

    def hear(self) -> Iterator[FromTopicRelay]:
        self._control.flush()
        for message, _ in self._control.receive():
            yield message
        self.has_ended = self._control.has_ended

    def close(self) -> int:
        self._process.kill()
        status = self._process.wait(_RELAY_END_S)
        self._control.close()
        return status


class Ros1Backend:
    """A backend of ROS 1 nodes. Call all its methods from one thread, which must outlive it.

    Its master is that of ROS_MASTER_URI, or one of its own if none answers there. Sources `node:./FILE` are relative to
    `folder`; `file` is how messages name the environment file. Raises InputError.
    """

    def __init__(self, *, folder: Path | None = None, file: str = ENVIRONMENT_FILE) -> None:
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
        self._processes = WatchedProcesses(self._ends, self._events)
        self._relay_node = f"/cfgplan_relay_{self.id}"
        self._relay_address = ""
        order = RelayOrder(self._relay_node, self.master.address, self.master.host)
        self._wires = RelayedWires(
            self._ends, self._events, lambda: _Relay(order), lambda: None, self._hear_relay, self.run_folder, file
        )
        self._values = MessageDecoders()
        self._to_master = ThreadPoolExecutor(1, "to-master")
        self._watch_master()
        self._wires.start()

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
        self._ends.wait(0.0 if self._events or self._posted else self._wires.left_s(timeout_s))
        self._posted.do()
        self._wires.start_if_due()
        happened = list(self._events)
        self._events.clear()
        return happened

    def take_hosts(self, hosts: Collection[str]) -> Collection[str]:  # noqa: ARG002
        return ()

    def leave_hosts(self, hosts: Collection[str]) -> None:
        """Do nothing: the only host is this computer."""

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Do nothing: all units end with this process."""

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
            self._events.append(events.UnitDied(unit, str(error), "could not start"))

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        """Do nothing: a waiting node would already run."""

    def discard(self, spare: str) -> None:
        """Do nothing: no spares are prepared."""

    def stop(self, unit: str) -> None:
        node = self._nodes.get(unit)
        if node is not None and not node.is_stopping:
            node.is_stopping = True
            self._end(node, NodeProcess.interrupt)

    def kill(self, unit: str, *, dump: bool = False) -> None:
        node = self._nodes.get(unit)
        if node is not None and not dump:
            self._end(node, NodeProcess.kill)

    def activate(self, unit: str) -> bool:  # noqa: ARG002
        """Do nothing: nodes work as soon as they run."""
        return False

    def deactivate(self, unit: str) -> None:
        """Do nothing: nodes work as long as they run."""

    def hold(self, unit: str) -> None:
        """Do nothing: nodes do not take a state."""

    def ask_places(self, unit: str, inlets: Mapping[str, bool]) -> None:  # noqa: ARG002
        self._events.append(events.PlacesTold(unit, {}))

    def ask_state(self, unit: str, until: Mapping[str, Moment], successor: str) -> None:  # noqa: ARG002
        self._events.append(events.StateTold(unit, None, {}, {}))

    def give_state(
        self, unit: str, state: bytes | None, inputs: Mapping[str, messages.GivenInput], outputs: Mapping[str, Moment]
    ) -> None:
        """Do nothing: nodes do not take a state."""

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:  # noqa: ARG002
        producer, consumer = self._nodes.get(stream.unit), self._nodes.get(inlet.unit)
        if producer is None or (consumer is None and not inlet.is_outlet):
            self._events.append(events.InputLost(inlet.unit or None, inlet.port, wire))
            return
        target = inlet.port if consumer is None else consumer.ros.listens_at(inlet.input)
        publisher = producer.ros.name if producer.ros.is_foreign else None
        source = producer.ros.publishes_at(stream.port)
        if inlet.is_tap:
            self._wires.tell(Tap(inlet.port, source, publisher))
            return
        is_service = consumer is not None and consumer.ros.transformation.input[inlet.input].service
        lead = Lead(wire, inlet.unit, str(inlet), source, target, queue, publisher, is_service)
        self._wires.lead(inlet, lead)

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._wires.disconnect(wire, inlet)

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:  # noqa: ARG002
        self._wires.end_wire(wire, inlet)

    def switch_now(self, inlet: Inlet) -> None:
        self._wires.switch_now(inlet)

    def open_outlet(self, topic: str, host: str | None) -> None:  # noqa: ARG002
        self._wires.open_outlet(topic)

    def close_outlet(self, topic: str) -> None:
        self._wires.close_outlet(topic)
        with suppress(SilentError):  # who asks for topics from now on does not find it
            self.master.unpublish(self._relay_node, topic, self._relay_address)

    def renew(self, helper: str) -> None:  # noqa: ARG002
        self._wires.lose()

    def usage(self, unit: str) -> Usage | None:
        """The usage of a unit's node; zero if the run has not started it."""
        node = self._nodes.get(unit)
        if node is None:
            return None
        if node.group is not None:
            return node.group.units.usage(unit)
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
                self._processes.last_words(node.process, node.unit)
            self._remove_dead(node, "")
        self._wires.close()
        is_own = self.master.ended is not None
        if not is_own and self._relay_address:
            self._to_master.submit(forget_node, self.master.address, self._relay_node, self._relay_address)
        self._to_master.shutdown(cancel_futures=is_own)
        self.master.close()
        self._ends.close()
        self._posted.close()
        self.run_folder.close()

    # Watches report by these, from their threads.

    def note_ready(self, node: str, address: str) -> None:
        if node in self._groups:
            self._groups[node].address = address
        else:
            self._post(node, lambda of: self._tell_ready(of, address))

    def note_alive(self, node: str) -> None:
        self._post(node, lambda of: self._events.append(self._status(of)))

    def note_late(self, node: str, topics: list[str]) -> None:
        line = f"cfgplan: {node} does not publish {', '.join(topics)}: what is it called in its code (`remap`)?"

        def tell(of: _UnitNode) -> None:
            if not of.is_stopping:  # a node that ends withdraws its topics first
                self._events.append(events.UnitPrinted(of.unit, line))

        self._post(node, tell)

    def note_silence(self, node: str) -> None:
        self._post(node, self._note_silence)

    def _post(self, node: str, call: Callable[[_UnitNode], None]) -> None:
        def do() -> None:
            """Call it for the node; for a nodelet manager, for each of its nodelets that is loaded."""
            units = self._groups[node].units if node in self._groups else (self._units.get(node, ""),)
            for known in [self._nodes[unit] for unit in units if unit in self._nodes]:
                if known.group is None or known.is_loaded:
                    call(known)

        self._posted.post(do)

    def _tell_ready(self, node: _UnitNode, address: str) -> None:
        node.address = address
        usage = self.usage(node.unit)
        self._events.append(events.UnitReady(node.unit, 0 if usage is None else usage.cpu_us))

    def _status(self, node: _UnitNode) -> events.UnitStatus:
        """A sign of life, with the relay's counts of a unit's streams."""
        outputs = {
            port.name: messages.PortCounts(self._wires.passed_from(node.ros.publishes_at(port.name)))
            for port in node.ros.transformation.outputs
        }
        inputs = self._wires.taken_by(node.unit)
        steps = sum(counts.elements for counts in outputs.values())
        said = self._wires.said_by(node.unit)
        return events.UnitStatus(node.unit, steps, 0, inputs, outputs, qualities=said)

    def _note_silence(self, node: _UnitNode) -> None:
        if node.process is None and (node.group is None or node.group.process is None):
            self._remove_dead(node, f"{node.ros.name} does not answer any more", "was given up")

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
            self._wires.observe(node.unit, ros)
            return
        if ros.is_foreign:
            self.master.ask_node(ros.name)
        else:
            self.master.set_parameters(ros.name, ros.parameters)
            process = node.process = NodeProcess(ros.command(self._folder), self.master.environment, self._folder)
            self._processes.attend(process, lambda: self._end_of(node, process), lambda: node.unit)
        self._nodes[node.unit] = node
        self._units[ros.name] = node.unit
        self._wires.observe(node.unit, ros)
        node.watch = NodeWatch(
            self,
            self.master.address,
            ros.name,
            (lambda _: True) if node.process is None else node.process.has,
            [ros.publishes_at(port.name) for port in transformation.outputs],
            [ros.listens_at(port.name) for port in transformation.inputs if not port.service],
        )

    def _end_of(self, node: _UnitNode, process: NodeProcess) -> None:
        """Read the last lines of a process that has ended, then report its end."""
        self._remove_dead(node, self._processes.last_words(process, node.unit))

    def _remove_dead(self, node: _UnitNode, cause: str, how: events.End = "died") -> None:
        """Forget a node that has ended or was given up."""
        del self._nodes[node.unit], self._units[node.ros.name]
        if node.watch is not None:
            node.watch.end()
        if node.group is not None:
            node.group.units.remove(node.unit)
        if node.process is not None and node.address is not None:
            self._to_master.submit(forget_node, self.master.address, node.ros.name, node.address)
        self._wires.close_inlets(node.unit)
        gone = events.UnitStopped(node.unit) if node.is_stopping else events.UnitDied(node.unit, cause, how)
        self._events.append(gone)

    def _end(self, node: _UnitNode, end: Callable[[NodeProcess], None]) -> None:
        """Unload a nodelet, forget an external node, or call `end` with the process of any other node."""
        if node.group is not None:
            self._unload(node, node.group)
        elif node.process is None:
            self._remove_dead(node, NOT_OURS, "was given up")
        else:
            end(node.process)

    # Nodelets.

    def _group(self, name: str) -> NodeletGroup:
        """The nodelet manager of this name, or the run's own for "". Starts it unless it runs."""
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
            self._processes.attend(process, lambda: self._lose_group(group), lambda: group.units.last)
        group.watch = NodeWatch(self, self.master.address, full, process.has if process else lambda _: True, (), ())
        return group

    def _note_load(self, node: _UnitNode, cause: str, labor_us: int) -> None:
        group = node.group
        assert group is not None

        def do(known: _UnitNode) -> None:
            if known is node and cause:
                self._remove_dead(node, cause, "could not start")
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
                self._remove_dead(node, "it was unloaded")
            else:
                self._end_group(group)

        group.unload(node.ros, lambda is_done: self._post_of(node.unit, lambda known: do(known, is_done=is_done)))

    def _post_of(self, unit: str, call: Callable[[_UnitNode], None]) -> None:
        self._posted.post(lambda: call(self._nodes[unit]) if unit in self._nodes else None)

    def _end_group(self, group: NodeletGroup) -> None:
        """End a manager with all its nodelets; one that the run has not started is only forgotten."""
        if group.process is not None:
            group.process.kill()
        if self._groups.get(group.name) is group:
            self._lose_group(group)

    def _lose_group(self, group: NodeletGroup) -> None:
        """Report the end of a manager and of all its nodelets."""
        del self._groups[group.name]
        if group.watch is not None:
            group.watch.end()
        how: events.End = "was given up"
        cause = f"the nodelet manager {group.name} is given up: {NOT_OURS}"
        if group.process is not None:
            end, how = self._processes.last_words(group.process, group.units.last), "died"
            cause = f"it was in the nodelet manager {group.name}, which {clause_of(end)}"
            if group.address is not None:
                self._to_master.submit(forget_node, self.master.address, group.name, group.address)
        for node in [self._nodes[unit] for unit in list(group.units) if unit in self._nodes]:
            if group.process is None:
                group.unloads(node.ros)
            self._remove_dead(node, cause, how)

    def _watch_master(self) -> None:
        if self.master.ended is not None:
            self._ends.watch(self.master.ended, self._lose_master)

    def _lose_master(self) -> None:
        """End all nodes and restart this run's own master: nodes register with a master only once."""
        assert self.master.ended is not None
        self._ends.unwatch(self.master.ended)
        for group in list(self._groups.values()):
            self._end_group(group)
        for node in list(self._nodes.values()):
            if node.process is not None:
                self._processes.last_words(node.process, node.unit)
            self._remove_dead(node, "the ROS master has died, and nodes register there only once", "was given up")
        self._wires.lose()
        self.master.restart()
        self._watch_master()

    def _hear_relay(self, message: object) -> None:
        match message:
            case Listening(address):
                self._relay_address = address
            case TappedMessage(topic, kind, definition, time_ns, skipped, data):
                self._wires.taps.show(topic, time_ns, self._values.shown(kind, definition, data), skipped)
