"""Units as nodes of ROS 2 on this computer, connected by a relay at each input, in a helper that speaks ROS 2."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cfgplan.domain import Stream, Transformation
from cfgplan.errors import InputError
from cfgplan.ros.topic_names import word
from cfgplan_runtime.children import messages
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.nodes.relay_messages import Lead, Tap
from cfgplan_runtime.nodes.relayed_wires import ENVIRONMENT_FILE, RelayedWires
from cfgplan_runtime.nodes.watched_processes import NOT_OURS, WatchedProcesses
from cfgplan_runtime.processes.child_process import cpu_us, memory_bytes
from cfgplan_runtime.ros2.containers import Containers
from cfgplan_runtime.ros2.fast_dds import FastDdsProfiles, clean_memory
from cfgplan_runtime.ros2.host_link import HostLink
from cfgplan_runtime.ros2.host_messages import (
    Answered,
    Attend,
    Attended,
    Begin,
    ChangeState,
    Configured,
    ContainerFound,
    Failed,
    FromHost,
    Gone,
    Loaded,
    StateChanged,
    Tapped,
    Told,
    Unloaded,
)
from cfgplan_runtime.ros2.quality_warnings import QualityWarnings
from cfgplan_runtime.ros2.ros2_unit import SIM_TIME, Ros2Unit, message_of, node_source
from cfgplan_runtime.ros2.ros_python import RosPython, ros_python
from cfgplan_runtime.ros2.tapped_values import TappedValues
from cfgplan_runtime.ros2.warm_nodes import WarmNode, WarmNodes
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.ends import Ends, Waker
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Failures, Inlet, Usage

_ALIVE_S = 1.0
"""Seconds from one sign of life of a node to the next."""


@dataclass(slots=True, eq=False)
class _UnitNode:
    """A unit's node: a process, a component in a container, or a foreign node."""

    unit: str
    ros: Ros2Unit
    process: NodeProcess | None = None
    is_ready: bool = False
    is_stopping: bool = False
    is_spare: bool = False
    """Whether it is a configured cold spare."""
    is_configured: bool = False
    was_warm: bool = False
    """Whether it was started in a waiting process."""
    has_answered: bool = False
    """Whether it has answered the present helper's calls: a node that never spins does not."""
    has_life: bool = False
    is_active: bool = False
    """Whether it was told to begin. A lifecycle node then is active, or `is_activating`."""
    is_activating: bool = False
    is_deactivating: bool = False
    """Whether it is deactivated before it ends."""
    verdict: tuple[str, events.End] | None = None
    """The cause for which the run kills it, and the verb of the report."""


class Ros2Backend:
    """A backend of ROS 2 nodes. Call all its methods from one thread, which must outlive it.

    The helper runs in the Python that has rclpy: `python`, or the one that is found. Sources `node:./FILE` are relative
    to `folder`. With `warm`, a process waits to replace any node in Python that dies. `file` is how messages name the
    environment file. Raises InputError.
    """

    def __init__(
        self,
        *,
        folder: Path | None = None,
        python: RosPython | None = None,
        warm: bool = True,
        file: str = ENVIRONMENT_FILE,
    ) -> None:
        self._python = python or ros_python()
        self.run_folder = RunFolder()
        self._folder = (folder or Path.cwd()).resolve()
        self._profiles = FastDdsProfiles(self.run_folder.path, self._python.environment)
        self._ends, self._waker = Ends(), Waker()
        self._ends.watch(self._waker.socket, self._waker.hear)
        self._events: list[events.Event] = []
        self._nodes: dict[str, _UnitNode] = {}
        self._warm = WarmNodes(self._start_warm, self._events, self.now(), keeps_one=warm)
        self._messages: set[str] = set()
        """The message types of nodes that were started."""
        self._warnings = QualityWarnings()
        self._processes = WatchedProcesses(self._ends, self._events, self._shown)
        self._unnumbered: set[str] = set()
        """Transformations whose nodes fail to start with a participant number of their own."""
        self._wires = RelayedWires(
            self._ends, self._events, self._start_host, self._attend_all, self._hear, self.run_folder, file
        )
        self._values = TappedValues(self._folder)
        self._containers = Containers(self._wires.tell, self._start_container, self._processes, self._lose)
        self._sign_due_s = self.now()
        self._wires.start()

    @property
    def id(self) -> str:
        return self.run_folder.id

    @property
    def has_warm(self) -> bool:
        """Whether a process waits for any node."""
        return self._warm.is_ready("")

    def found(self) -> None:
        return None

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._waker.wake()

    def wait(self, timeout_s: float | None) -> Sequence[events.Event]:
        left_s = max(0.0, self._sign_due_s - self.now())
        timeout_s = self._wires.left_s(left_s if timeout_s is None else min(timeout_s, left_s))
        self._ends.wait(0.0 if self._events else timeout_s)
        self._wires.start_if_due()
        if self._sign_due_s <= self.now():
            self._sign_due_s = self.now() + _ALIVE_S
            self._warm.keep_one(self._messages, self.now())
            for node in self._nodes.values():
                is_silent = node.is_activating or not node.has_answered
                if node.is_ready and is_silent and _is_going(self._process_of(node.unit)):
                    self._events.append(self._status(node))
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
        spare: str | None = None,
    ) -> None:
        waiting = self._nodes.get(spare or "")
        if spare is not None and waiting is not None and waiting.is_configured:
            self._begin_spare(unit, waiting)
            return
        if spare is not None and not self._warm.is_ready(spare):
            self.discard(spare)
            spare = None
        try:
            source = node_source(transformation)
            name = source.name if source.kind == "external" else self._free_name(unit)
            self._begin(_UnitNode(unit, Ros2Unit(name, source, transformation)), spare or "")
        except (InputError, OSError) as error:
            self._wires.close_inlets(unit)
            self._events.append(events.UnitDied(unit, str(error), "could not start"))

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:  # noqa: ARG002
        """Configure a lifecycle node; for any other node in Python start a waiting process. Do nothing for
        other nodes.
        """
        self.discard(spare)
        try:
            source = node_source(transformation)
            ros = Ros2Unit(self._free_name(spare), source, transformation)
            if source.kind in ("external", "component"):
                return
            if transformation.run.lifecycle:
                self._begin(_UnitNode(spare, ros, is_spare=True), None)
            elif self._warm.fits(transformation.label, ros.program(self._folder)):
                self._warm.begin(spare, {port.message for port in (*ros.heard, *ros.published) if port.message})
        except (InputError, OSError) as error:
            self._events.append(events.SpareLost(spare, f"can't be prepared: {error}"))

    def discard(self, spare: str) -> None:
        node = self._nodes.get(spare)
        if node is not None and node.is_spare:
            del self._nodes[spare]
            self._wires.close_inlets(spare)
            if node.process is not None:
                self._processes.last_words(node.process, spare)
        if spare in self._warm:
            self._processes.last_words(self._warm.take(spare), spare)

    def stop(self, unit: str) -> None:
        """Deactivate a lifecycle node, then end it; a second call does not wait until it is deactivated."""
        node = self._nodes.get(unit)
        if node is None:
            return
        if not node.is_stopping and node.has_life and node.is_active:
            node.is_deactivating = True
            self._change_state(node, is_active=False)
        elif node.is_deactivating or not node.is_stopping:
            self._stop_now(node)
        node.is_stopping = True

    def kill(self, unit: str, *, dump: bool = False) -> None:
        node = self._nodes.get(unit)
        if node is not None and not dump and unit in self._containers:
            self._containers.kill(unit)
        elif node is not None and not dump:
            self._end(node, NodeProcess.kill)

    def activate(self, unit: str) -> bool:
        """Activate a lifecycle node: UnitActive follows. Other nodes work as soon as they run."""
        node = self._nodes.get(unit)
        if node is None:
            return False
        self._change_state(node, is_active=True)
        return node.has_life

    def deactivate(self, unit: str) -> None:
        """Deactivate a lifecycle node. Other nodes work as long as they run."""
        if unit in self._nodes:
            self._change_state(self._nodes[unit], is_active=False)

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
        source = producer.ros.publishes_at(stream.port)
        is_service = consumer is not None and consumer.ros.transformation.input[inlet.input].service
        message = message_of(producer.ros.transformation.output[stream.port])
        publisher = producer.ros.name if producer.ros.is_foreign else None
        if inlet.is_tap:
            self._wires.tell(Tap(inlet.port, source, publisher, message))
            return
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
        """The CPU time and memory of a node; zero for a foreign one."""
        if unit in self._containers:
            return self._containers.usage(unit)
        node = self._nodes.get(unit)
        process = self._warm.process(unit) or (None if node is None else node.process)
        if process is None:
            return None if node is None else Usage(0, 0)
        cpu, memory = cpu_us(process.pid), memory_bytes(process.pid)
        return None if cpu is None or memory is None else Usage(cpu, memory, process.pid)

    def pid(self, unit: str) -> int | None:
        process = self._process_of(unit)
        return None if process is None else process.pid

    def close(self) -> None:
        for spare, process in self._warm.take_all().items():
            self._processes.last_words(process, spare)
        self._containers.close()
        for node in list(self._nodes.values()):
            if node.process is not None:
                self._processes.last_words(node.process, node.unit)
            self._remove_dead(node, "")
        self._wires.close()
        clean_memory()
        self._ends.close()
        self._waker.close()
        self.run_folder.close()

    # The helper.

    def _start_host(self) -> HostLink[FromHost]:
        environment = {**self._python.environment, **self._profiles.environment("relay")}
        python = RosPython(self._python.program, environment)
        return HostLink(python, f"cfgplan_relay_{word(self.id)}", FromHost)

    def _attend_all(self) -> None:
        for node in self._nodes.values():
            node.has_answered = node.is_configured = False
            self._attend(node)
            if node.unit in self._containers:
                self._containers.tell_again(node.unit)

    def _attend(self, node: _UnitNode) -> None:
        ros, run = node.ros, node.ros.transformation.run
        self._wires.tell(
            Attend(
                node.unit,
                ros.name,
                ros.heard,
                ros.published,
                run.queue,
                is_foreign=ros.is_foreign,
                asks=run.hang_us is not None and not node.is_spare,
                waits=node.is_spare,
                is_watched=ros.source.kind == "component",
                has_clock=SIM_TIME in ros.parameters,
                is_active=node.is_active,
            )
        )

    def _hear(self, message: object) -> None:
        match message:
            case Attended(unit, has_life) if unit in self._nodes:
                self._nodes[unit].has_life |= has_life
                self._note_ready(self._nodes[unit])
            case StateChanged(unit, is_active) if unit in self._nodes:
                self._note_state(self._nodes[unit], is_active=is_active)
            case Configured(unit) if unit in self._nodes:
                self._nodes[unit].is_configured = True
                usage = self.usage(unit)
                self._events.append(events.SparePrepared(unit, 0 if usage is None else usage.cpu_us))
            case ContainerFound(name, is_there):
                self._containers.note_found(name, is_there=is_there)
            case Loaded(unit, number):
                self._containers.note_loaded(unit, number)
            case Unloaded(unit, is_done):
                self._containers.note_unloaded(unit, is_done=is_done)
            case Failed(unit, cause) if unit in self._nodes:
                self._note_failure(self._nodes[unit], cause)
            case Answered(unit) if unit in self._nodes:
                self._nodes[unit].has_answered = True
                if self._nodes[unit].is_ready:
                    self._events.append(self._status(self._nodes[unit]))
            case Gone(unit) if unit in self._nodes:
                node = self._nodes[unit]
                if node.is_ready:
                    self._remove_dead(node, f"{node.ros.name} is not there any more", "was given up")
                else:
                    self._remove_dead(node, f"no node {node.ros.name} is there", "could not start")
            case Tapped(data=data, topic=topic, message=kind, time_ns=time_ns, skipped=skipped):
                self._wires.taps.show(topic, time_ns, self._values.of(kind, data), skipped)
            case Told(unit, text) if unit in self._nodes:
                self._events.append(events.UnitPrinted(unit, f"cfgplan: {text}"))

    def _note_ready(self, node: _UnitNode) -> None:
        if not node.is_ready:
            node.is_ready = True
            usage = self.usage(node.unit)
            self._events.append(events.UnitReady(node.unit, 0 if usage is None else usage.cpu_us))

    def _change_state(self, node: _UnitNode, *, is_active: bool) -> None:
        node.is_active = is_active
        node.is_activating = is_active and node.has_life
        self._wires.tell(ChangeState(node.unit, is_active))

    def _note_state(self, node: _UnitNode, *, is_active: bool) -> None:
        if is_active and node.is_activating:
            node.is_activating = False
            self._events.append(events.UnitActive(node.unit))
        elif not is_active and node.is_deactivating:
            self._stop_now(node)

    def _note_failure(self, node: _UnitNode, cause: str) -> None:
        """Give up a node that refuses to change its state, or can't be loaded; a stopping one is ended as usual."""
        if node.is_deactivating:
            self._events.append(events.UnitPrinted(node.unit, f"cfgplan: {cause}"))
            self._stop_now(node)
            return
        if node.unit in self._containers and not self._containers.is_loaded(node.unit):
            self._remove_dead(node, cause, "could not start")
        else:
            node.verdict = cause, "refused a transition"
            self.kill(node.unit)

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

    # Nodes.

    def _process_of(self, unit: str) -> NodeProcess | None:
        """The process of a unit or of its container; None for a foreign node."""
        if unit in self._containers:
            return self._containers.process(unit)
        node = self._nodes.get(unit)
        return None if node is None else node.process

    def _free_name(self, unit: str) -> str:
        """A name for a unit's node that no other node of this run has."""
        taken = {node.ros.name for node in self._nodes.values()}
        first = f"/{word(unit)}"
        names = (first, *(f"{first}_{number}" for number in range(2, len(taken) + 3)))
        return next(name for name in names if name not in taken)

    def _begin(self, node: _UnitNode, spare: str | None) -> None:
        """Let the helper listen for a node, and start the node, in the process that waits for `spare` if possible."""
        ros = node.ros
        self._nodes[node.unit] = node
        try:
            self._attend(node)
            if not node.is_spare:
                self._wires.observe(node.unit, ros)
            if ros.source.kind == "component":
                self._containers.add(node.unit, ros)
            elif not ros.is_foreign:
                self._messages |= {port.message for port in (*ros.heard, *ros.published) if port.message}
                command = ros.command(self._folder, self.run_folder.path / f"{word(node.unit)}.yaml")
                node.process = self._process(node, command, spare)
        except (InputError, OSError):
            del self._nodes[node.unit]
            raise

    def _process(self, node: _UnitNode, command: list[str], spare: str | None) -> NodeProcess:
        label = node.ros.transformation.label
        if spare is not None and self._warm.is_ready(spare) and self._warm.fits(label, command[0]):
            node.was_warm = True
            return self._warm.become(spare, node.unit, command, self.now())
        process = self._new_process(word(node.unit), command, has_number=label not in self._unnumbered)
        self._watch(process)
        return process

    def _new_process(self, name: str, command: list[str], *, has_number: bool = True) -> NodeProcess:
        profile = self._profiles.environment(name, has_number=has_number)
        return NodeProcess(command, {**self._python.environment, **profile}, self._folder)

    def _start_container(self, name: str, command: list[str]) -> NodeProcess:
        return self._new_process(word(name), command)

    def _lose(self, unit: str, cause: str, how: events.End) -> None:
        """Forget a unit whose component is gone."""
        clean_memory()
        self._remove_dead(self._nodes[unit], cause, how)

    def _begin_spare(self, unit: str, node: _UnitNode) -> None:
        """Turn a configured spare into a unit. It keeps its name and its topics."""
        del self._nodes[node.unit]
        self._events.append(events.SpareUsed(unit, node.unit))
        self._wires.tell(Begin(node.unit, unit))
        node.unit, node.is_spare = unit, False
        self._nodes[unit] = node
        self._wires.observe(unit, node.ros)

    def _watch(self, process: NodeProcess) -> None:
        self._processes.attend(process, lambda: self._end_of(process), lambda: self._unit_of(process))

    def _unit_of(self, process: NodeProcess) -> str:
        """The unit or cold spare that a process is for."""
        units = (node.unit for node in self._nodes.values() if node.process is process)
        return next(units, self._warm.spare_of(process))

    def _end_of(self, process: NodeProcess) -> None:
        """Read the last lines of a process that has ended, then report its end."""
        owner = self._unit_of(process)
        cause = self._processes.last_words(process, owner)
        clean_memory()
        node = self._nodes.get(owner)
        if node is None or node.process is not process:
            self._warm.lose(owner, cause)
            return
        if not (node.is_ready or node.is_stopping or node.is_spare or node.verdict):
            (self._warm.refuse if node.was_warm else self._unnumbered.add)(node.ros.transformation.label)
        self._remove_dead(node, cause)

    def _start_warm(self, spare: str, messages: Iterable[str], tell_ready: Callable[[], None]) -> WarmNode:
        environment = {**self._python.environment, **self._profiles.environment(f"warm_{word(spare or 'run')}")}
        python = RosPython(self._python.program, environment)
        warm = WarmNode(self._ends, python, self._folder, messages, tell_ready)
        self._watch(warm.process)
        return warm

    def _shown(self, unit: str, line: str) -> str | None:
        """Return the line to report for one that a unit's node has printed; None for none."""
        if self._profiles.causes(line):
            return None
        node = self._nodes.get(unit)
        return line if node is None else self._warnings.line(unit, line, node.ros.remappings)

    def _remove_dead(self, node: _UnitNode, cause: str, how: events.End = "died") -> None:
        """Forget a node that has ended or was given up."""
        if node.verdict is not None:
            cause, how = node.verdict
        del self._nodes[node.unit]
        self._warnings.forget(node.unit)
        self._wires.close_inlets(node.unit)
        if node.unit in self._containers:
            self._containers.remove(node.unit)
        if node.is_spare:
            self._events.append(events.SpareLost(node.unit, cause))
        elif node.is_stopping:
            self._events.append(events.UnitStopped(node.unit))
        else:
            self._events.append(events.UnitDied(node.unit, cause, how))

    def _stop_now(self, node: _UnitNode) -> None:
        """Let a node end."""
        node.is_deactivating = False
        if node.unit in self._containers:
            self._containers.stop(node.unit)
        else:
            self._end(node, NodeProcess.interrupt)

    def _end(self, node: _UnitNode, end: Callable[[NodeProcess], None]) -> None:
        """Call `end` with a node's process, or forget a foreign node."""
        if node.process is None:
            self._remove_dead(node, NOT_OURS, "was given up")
        else:
            end(node.process)


def _is_going(process: NodeProcess | None) -> bool:
    """Whether the system reports a process as not stopped (SIGSTOP). The helper watches foreign nodes."""
    if process is None:
        return True
    try:
        return Path(f"/proc/{process.pid}/stat").read_text().rpartition(") ")[2][:1] != "T"
    except OSError:
        return False
