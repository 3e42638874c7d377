"""Units in this process that hand over states, in an order of events that a test draws."""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import FromChild, ToChild
from cfgplan_runtime.children.ports import Ports, UnitInput, UnitOutput
from cfgplan_runtime.children.unit_child import UnitChild
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.streams.channel import socket_pair
from cfgplan_runtime.streams.element import Element, Outgoing
from cfgplan_runtime.streams.inlet import InputQueue
from cfgplan_runtime.streams.payload import PayloadEncoder, decode
from cfgplan_runtime.supervision import commands, events, updates, wiring
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.handover_answers import HandoverAnswers

from cfgplan.domain import ChangeSet, Environment, Stream, Transformation

TURNS = 3000
"""The turns after which a wait of an update counts as timed out."""


class _Child:
    """The end of a process's connection with its supervisor, and what the process does in a turn."""

    def __init__(self) -> None:
        ours, self.end = socket.socketpair()
        self.control = ControlConnection[FromChild](ours, FromChild)


class Unit(_Child):
    def __init__(self, name: str, transformation: Transformation, state: bytes | None) -> None:
        super().__init__()
        order = msgspec.structs.replace(unit_order(name, transformation, state), folder=str(Path(__file__).parent))
        self.child = UnitChild(order, ControlConnection(self.end, ToChild))
        self.ports = self.child._ports
        self.has_ended = False

    def turn(self) -> None:
        child = self.child
        self.ports.ends.wait(0.0)
        child._work()
        if child._is_finishing and not child._has_work and self.ports.is_flushed:
            child._close_code()
            self.close()

    def close(self) -> None:
        self.has_ended = True
        self.child.close()
        self.control.close()
        self.end.close()


class Camera(_Child):
    """Gives 0, 1, 2, ... at the times of a common clock."""

    def __init__(self, now: Callable[[], int]) -> None:
        super().__init__()
        self.ports = Ports(ControlConnection(self.end, ToChild), lambda *_: None)
        self.ports.outputs["y"] = UnitOutput()
        self.number = 0
        self.size = 0
        self._now, self._encoder = now, PayloadEncoder()

    def turn(self) -> None:
        self.ports.ends.wait(0.0)

    def give(self) -> None:
        if not self.ports.must_wait:
            self.ports.emit("y", Outgoing(self._now(), 0, self._encoder.encode([self.number, {}, bytes(self.size)])))
            self.number += 1


class Topics(_Child):
    """Keeps the values of each topic."""

    def __init__(self) -> None:
        super().__init__()
        self.ports = Ports(ControlConnection(self.end, ToChild), lambda *_: None)
        self.came: dict[str, list[Any]] = {}

    def open(self, topic: str) -> None:
        values = self.came.setdefault(topic, [])

        def take(element: Element) -> None:
            values.append(decode(element.payload))

        self.ports.inputs[topic] = UnitInput(topic, InputQueue(1024), take, lambda: True)

    def turn(self) -> None:
        self.ports.ends.wait(0.0)


class House:
    """The `progress.Actual` of units in this process. `draw(n)` returns a number below n."""

    def __init__(self, library: Sequence[Transformation], cameras: Sequence[str], draw: Callable[[int], int]) -> None:
        self.environment = Environment(library=tuple(library))
        self.alive: set[str] = set()
        self.ready: Set[str] = self.alive
        self.inactive: set[str] = set()
        self.activating: set[str] = set()
        self.topics: dict[str, str | None] = {}
        self.lost_hosts: set[str] = set()
        self.ends: dict[str, str] = {}
        self.is_abandoned = False
        self.inexact: list[events.StateNotExact] = []
        self.timed_out: list[float] = []
        """The patience of each wait in vain, in seconds."""
        self.wiring = wiring.Wiring(self)  # type: ignore[arg-type]
        self.units: dict[str, Unit] = {}
        self.doomed: dict[str, type[commands.Command]] = {}
        """Units that die when they get such a command."""
        self.blocked: set[str] = set()
        """Cameras whose code blocks: they hear nothing."""
        self.time_ns = 0
        self.cameras = {f"{label}.1": Camera(self._tick) for label in cameras}
        self.outlets = Topics()
        self.answers = HandoverAnswers()
        self._states: dict[str, bytes] = {}
        self._draw = draw
        self._is_quiet = False

    def _tick(self) -> int:
        self.time_ns += 1
        return self.time_ns

    # The questions of an update.

    @property
    def feeds(self) -> Mapping[Inlet, wiring.Wire]:
        return self.wiring.feeds

    def stop_s(self, unit: str) -> float | None:  # noqa: ARG002
        return None

    def failure(self, unit: str) -> str | None:  # noqa: ARG002
        return None

    def dry_units(self) -> Set[str]:
        return set()

    def is_followed(self, topics: Set[str]) -> bool:  # noqa: ARG002
        return True

    def now(self) -> float:
        return 0.0

    # The commands of an update.

    def apply(self, change_set: ChangeSet) -> updates.CarriedOut:
        """Raises ApplyError if it was undone."""
        after = updates.environment_after(self.environment, change_set)
        update = updates.carry_out(self, change_set, after, updates.Patience())  # type: ignore[arg-type]
        try:
            while True:
                self._obey(next(update))
        except StopIteration as end:
            self.environment = end.value.environment
            carried: updates.CarriedOut = end.value
            return carried
        finally:
            self.wiring.settle()

    def _obey(self, command: commands.Command) -> None:
        tell = self._tell
        unit_id = getattr(command, "unit", "")
        if isinstance(unit_id, str) and isinstance(command, self.doomed.get(unit_id, ())):
            self.kill(unit_id)
        match command:
            case commands.OpenTopic(topic):
                self.topics[topic] = None
                self.outlets.open(topic)
            case commands.StartUnit(unit, transformation):
                self.alive.add(unit.id)
                self.inactive.add(unit.id)
                if unit.id not in self.cameras:
                    self.units[unit.id] = Unit(
                        unit.id, transformation, self._states.get(transformation.state_name or "")
                    )
            case commands.ActivateUnit(unit):
                self.inactive.discard(unit)
                tell(unit, messages.Activate())
            case commands.DeactivateUnit(unit):
                self.inactive.add(unit)
                tell(unit, messages.Deactivate())
            case commands.HoldUnit(unit):
                tell(unit, messages.HoldSteps())
            case commands.AskPlaces(unit, inlets):
                self.answers.ask(command)
                tell(unit, messages.TellPlaces(dict(inlets)))
            case commands.AskState(unit, until):
                self.answers.ask(command)
                tell(unit, messages.TellState(dict(until)))
            case commands.GiveState(unit):
                self.go_on(self._draw(30))
                given = msgspec.structs.asdict(command)
                del given["unit"]
                tell(unit, messages.TakeState(**given))
            case commands.TellOf(event):
                self.inexact.append(event)
            case commands.Doubt():
                self.answers.doubt(command)
            case commands.StopUnit(unit):
                self.wiring.forget_inputs(unit)
                tell(unit, messages.Finish())
            case commands.EndUnit(unit) | commands.CutShort(unit):
                self.kill(unit)
            case commands.Connect(stream, inlet):
                self.wiring.connect(stream, inlet, self.environment.transformation.get(inlet.unit.partition(".")[0]))
            case commands.Disconnect(inlet):
                self.wiring.disconnect(inlet)
            case commands.SwitchNow(inlet):
                self._tell(inlet.unit, messages.SwitchNow(inlet.port))
            case commands.SetEnvironment(environment):
                self.environment = environment
            case commands.WaitUntil(holds):
                if command.patience_s > 0 and not self.wait(holds):
                    self.timed_out.append(command.patience_s)
            case commands.Commit() | commands.Undo() | commands.StopAgain() | commands.Dump() | commands.CloseTopic():
                pass

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        sender, receiver = socket_pair()
        self._tell(inlet.unit, messages.Feed(inlet.port, wire), [receiver])
        self._tell(stream.unit, messages.Serve(stream.port, wire, queue, blocks), [sender])

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._tell(inlet.unit, messages.Cut(inlet.port, wire))

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:
        self._tell(inlet.unit, messages.End(inlet.port, wire))
        self._tell(stream.unit, messages.Unserve(stream.port, wire))

    def _process(self, unit: str) -> Any:
        return self.units.get(unit) or self.cameras.get(unit) or (None if unit else self.outlets)

    def _tell(self, unit: str, message: Any, sockets: Sequence[socket.socket] = ()) -> None:
        process = self._process(unit)
        if process is None:
            for end in sockets:
                end.close()
        else:
            process.control.send(message, sockets)

    # The turns of the processes.

    def wait(self, holds: Callable[[], bool]) -> bool:
        """Returns whether it holds in time."""
        for _ in range(TURNS):
            if holds():
                return True
            self._turn()
        return holds()

    def go_on(self, turns: int) -> None:
        for _ in range(turns):
            self._turn()

    def settle(self) -> None:
        """Let all elements come to the topics."""
        self._is_quiet = True
        self.go_on(TURNS)

    def _turn(self) -> None:
        """Let one process go on."""
        processes = [*self.units.items(), *self.cameras.items(), ("", self.outlets)]
        name, process = processes[self._draw(len(processes))]
        if name in self.blocked:
            return
        if isinstance(process, Camera) and not self._is_quiet and self._draw(4) == 0:
            process.give()
        process.turn()
        if isinstance(process, Unit) and process.has_ended:
            self._forget(name)
        else:
            self._hear(name, process)

    def _hear(self, name: str, process: _Child) -> None:
        process.control.flush()
        for message, _ in process.control.receive():
            match message:
                case messages.Places(moments):
                    self.answers.note(events.PlacesTold(name, moments))
                    settled = self.answers.settled(name)
                    self.inexact += [] if settled is None else [settled]
                case messages.StateTold():
                    self.answers.note(events.StateTold(name, **msgspec.structs.asdict(message)))
                case messages.Switched(_, wire):
                    self.wiring.note_switch(wire)
                case messages.Lost(_, wire):
                    self.wiring.note_loss(wire)
                case messages.Trouble():
                    raise AssertionError(message)

    def kill(self, name: str) -> None:
        if name in self.units:
            self._hear(name, self.units[name])
            self.units[name].close()
            self._forget(name)

    def _forget(self, name: str) -> None:
        del self.units[name]
        self.alive.discard(name)
        self.inactive.discard(name)
        self.wiring.forget_unit(name)

    def close(self) -> None:
        for name in list(self.units):
            self.kill(name)
        for process in (*self.cameras.values(), self.outlets):
            process.ports.close()
            process.control.close()
            process.end.close()


def slow_clock() -> SimpleNamespace:
    """A clock by which a unit makes one step in each turn."""
    now_ns = 0

    def monotonic_ns() -> int:
        nonlocal now_ns
        now_ns += 600_000
        return now_ns

    return SimpleNamespace(monotonic_ns=monotonic_ns, process_time_ns=lambda: 0)
