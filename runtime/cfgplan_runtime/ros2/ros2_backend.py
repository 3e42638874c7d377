"""Units as nodes of ROS 2 on this computer, connected by a relay at each input, in a helper that speaks ROS 2."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cfgplan.domain import Stream, Transformation
from cfgplan.errors import InputError
from cfgplan.ros.topic_names import word
from cfgplan_runtime.children import messages
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.nodes.relay_messages import Lead
from cfgplan_runtime.nodes.relayed_wires import RelayedWires
from cfgplan_runtime.nodes.watched_processes import WatchedProcesses
from cfgplan_runtime.processes.child_process import cpu_us, memory_bytes
from cfgplan_runtime.ros2.fast_dds import FastDdsProfiles, clean_memory
from cfgplan_runtime.ros2.host_link import HostLink
from cfgplan_runtime.ros2.host_messages import Answered, Attend, Attended, FromHost, Gone, Told
from cfgplan_runtime.ros2.ros2_unit import Ros2Unit, message_of, node_source
from cfgplan_runtime.ros2.ros_python import RosPython, ros_python
from cfgplan_runtime.streams.ends import Bell, Ends
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Inlet, Usage

_ALIVE_S = 1.0
"""Seconds from one sign of life of a node to the next."""


@dataclass(slots=True, eq=False)
class _UnitNode:
    """A unit's node: a process, or somebody else's."""

    unit: str
    ros: Ros2Unit
    process: NodeProcess | None = None
    is_ready: bool = False
    is_stopping: bool = False
    has_answered: bool = False
    """Whether it has answered when the present helper asked: a node that never spins does not."""


class Ros2Backend:
    """A backend of ROS 2 nodes. All its methods are called from one thread, which must outlive it.

    The helper runs in the Python that has rclpy: `python`, or the one that is found. `folder` is what `node:./FILE` is
    relative to. Raises InputError.
    """

    def __init__(self, *, folder: Path | None = None, python: RosPython | None = None) -> None:
        self._python = python or ros_python()
        self.run_folder = RunFolder()
        self._folder = (folder or Path.cwd()).resolve()
        self._profiles = FastDdsProfiles(self.run_folder.path, self._python.environment)
        self._ends, self._bell = Ends(), Bell()
        self._ends.watch(self._bell.socket, self._bell.hear)
        self._events: list[events.Event] = []
        self._nodes: dict[str, _UnitNode] = {}
        self._names: set[str] = set()
        """The nodes that the present helper has been told of: some may have died, and still be in its graph."""
        self._processes = WatchedProcesses(self._ends, self._events)
        self._unnumbered: set[str] = set()
        """Transformations whose nodes fail to start with a participant number of their own."""
        self._wires = RelayedWires(self._ends, self._events, self._start_host, self._attend_all, self._hear)
        self._sign_due_s = self.now()
        self._wires.start()

    @property
    def id(self) -> str:
        return self.run_folder.id

    def found(self) -> None:
        return None

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._bell.ring()

    def wait(self, timeout_s: float | None) -> Sequence[events.Event]:
        left_s = max(0.0, self._sign_due_s - self.now())
        timeout_s = self._wires.left_s(left_s if timeout_s is None else min(timeout_s, left_s))
        self._ends.wait(0.0 if self._events else timeout_s)
        self._wires.start_if_due()
        if self._sign_due_s <= self.now():
            self._sign_due_s = self.now() + _ALIVE_S
            for node in self._nodes.values():
                if node.is_ready and not node.has_answered and _is_going(node.process):
                    self._events.append(self._status(node))
        happened = list(self._events)
        self._events.clear()
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
            self._begin(_UnitNode(unit, Ros2Unit(name, source, transformation)))
        except (InputError, OSError) as error:
            self._wires.close_inlets(unit)
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
        source = producer.ros.publishes_at(stream.port)
        is_service = consumer is not None and consumer.ros.transformation.input[inlet.input].service
        message = message_of(producer.ros.transformation.output[stream.port])
        publisher = producer.ros.name if producer.ros.is_foreign else None
        lead = Lead(wire, inlet.unit, str(inlet), source, target, queue, publisher, is_service, message)
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

    def renew(self, helper: str) -> None:  # noqa: ARG002
        self._wires.lose()

    def usage(self, unit: str) -> Usage | None:
        """What a node has used; zero if somebody else runs it."""
        node = self._nodes.get(unit)
        if node is None:
            return None
        if node.process is None:
            return Usage(0, 0)
        cpu, memory = cpu_us(node.process.pid), memory_bytes(node.process.pid)
        return None if cpu is None or memory is None else Usage(cpu, memory, node.process.pid)

    def pid(self, unit: str) -> int | None:
        node = self._nodes.get(unit)
        return None if node is None or node.process is None else node.process.pid

    def close(self) -> None:
        for node in list(self._nodes.values()):
            if node.process is not None:
                self._processes.last_words(node.process, node.unit)
            self._bury(node, "")
        self._wires.close()
        clean_memory()
        self._ends.close()
        self._bell.close()
        self.run_folder.close()

    # The helper.

    def _start_host(self) -> HostLink[FromHost]:
        environment = {**self._python.environment, **self._profiles.environment("relay")}
        python = RosPython(self._python.program, environment)
        return HostLink(python, f"cfgplan_relay_{word(self.id)}", FromHost)

    def _attend_all(self) -> None:
        self._names.clear()
        for node in self._nodes.values():
            node.has_answered = False
            self._attend(node)

    def _attend(self, node: _UnitNode) -> None:
        ros = node.ros
        run = ros.transformation.run
        is_again = ros.name in self._names
        self._names.add(ros.name)
        is_asked = run.hang_us is not None
        self._wires.tell(
            Attend(node.unit, ros.name, ros.heard, ros.published, run.queue, ros.is_foreign, is_again, is_asked)
        )

    def _hear(self, message: object) -> None:
        match message:
            case Attended(unit) if unit in self._nodes:
                self._note_ready(self._nodes[unit])
            case Answered(unit) if unit in self._nodes:
                self._nodes[unit].has_answered = True
                if self._nodes[unit].is_ready:
                    self._events.append(self._status(self._nodes[unit]))
            case Gone(unit) if unit in self._nodes:
                node = self._nodes[unit]
                gone = "is not there any more" if node.is_ready else "can't be started: no such node is there"
                self._bury(node, f"{node.ros.name} {gone}")
            case Told(unit, text) if unit in self._nodes:
                self._events.append(events.UnitPrinted(unit, f"cfgplan: {text}"))

    def _note_ready(self, node: _UnitNode) -> None:
        if not node.is_ready:
            node.is_ready = True
            usage = self.usage(node.unit)
            self._events.append(events.UnitReady(node.unit, 0 if usage is None else usage.cpu_us))

    def _status(self, node: _UnitNode) -> events.UnitStatus:
        """A sign of life, with what the relay has seen of a unit's streams."""
        outputs = {
            port.name: messages.PortCounts(self._wires.passed_from(node.ros.publishes_at(port.name)))
            for port in node.ros.transformation.outputs
        }
        inputs = self._wires.taken_by(node.unit)
        return events.UnitStatus(node.unit, sum(counts.elements for counts in outputs.values()), 0, inputs, outputs)

    # Nodes.

    def _free_name(self, unit: str) -> str:
        """A name for a unit's node that no other node of this run has."""
        taken = {node.ros.name for node in self._nodes.values()}
        first = f"/{word(unit)}"
        names = (first, *(f"{first}_{number}" for number in range(2, len(taken) + 3)))
        return next(name for name in names if name not in taken)

    def _begin(self, node: _UnitNode) -> None:
        """Have the helper listen for a node, and start it."""
        ros = node.ros
        self._nodes[node.unit] = node
        try:
            self._attend(node)
            if not ros.is_foreign:
                command = ros.command(self._folder, self.run_folder.path / f"{word(node.unit)}.yaml")
                process = node.process = NodeProcess(command, self._environment(node), self._folder)
                self._processes.attend(process, lambda: self._end_of(node, process), lambda: node.unit)
        except (InputError, OSError):
            del self._nodes[node.unit]
            raise

    def _environment(self, node: _UnitNode) -> Mapping[str, str]:
        has_number = node.ros.transformation.label not in self._unnumbered
        profile = self._profiles.environment(word(node.unit), has_number=has_number)
        return {**self._python.environment, **profile}

    def _end_of(self, node: _UnitNode, process: NodeProcess) -> None:
        """Read the last lines of a process that has ended, then report its end."""
        if not node.is_ready and not node.is_stopping:
            self._unnumbered.add(node.ros.transformation.label)
        self._bury(node, self._processes.last_words(process, node.unit))
        clean_memory()

    def _bury(self, node: _UnitNode, cause: str) -> None:
        """Forget a node that is gone, or given up."""
        del self._nodes[node.unit]
        self._wires.close_inlets(node.unit)
        self._events.append(events.UnitStopped(node.unit) if node.is_stopping else events.UnitDied(node.unit, cause))

    def _end(self, node: _UnitNode, end: Callable[[NodeProcess], None]) -> None:
        """Call `end` with a node's process, or give up a node that somebody else runs."""
        if node.process is None:
            self._bury(node, "is given up")
        else:
            end(node.process)


def _is_going(process: NodeProcess | None) -> bool:
    """Whether a process is not stopped (SIGSTOP), by what the system says; other's nodes are watched by the helper."""
    if process is None:
        return True
    try:
        return Path(f"/proc/{process.pid}/stat").read_text().rpartition(") ")[2][:1] != "T"
    except OSError:
        return False
