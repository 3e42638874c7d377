"""The commands of an update to its supervisor, which carries each out before it asks for the next."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from typing import TypeAlias

import msgspec

from cfgplan.domain import ComputationUnit, Environment, Stream, Transformation
from cfgplan_runtime.children.messages import GivenInput
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.events import StateNotExact


class Command(msgspec.Struct, frozen=True):
    """A command of an update to its supervisor; each kind is a class of its own."""


class OpenTopic(Command, frozen=True):
    """Give a topic its address on the host of its target."""

    topic: str
    host: str | None = None


class CloseTopic(Command, frozen=True):
    """Remove a topic's address."""

    topic: str


class StartUnit(Command, frozen=True):
    """Start a unit on its host, without any wire. It makes no step."""

    unit: ComputationUnit
    transformation: Transformation


class ActivateUnit(Command, frozen=True):
    """Let a started unit begin to work."""

    unit: str


class DeactivateUnit(Command, frozen=True):
    """Let a unit give nothing until it is activated."""

    unit: str


class HoldUnit(Command, frozen=True):
    """Let a started unit make no step before it is given a state."""

    unit: str


class AskPlaces(Command, frozen=True):
    """Ask a unit from which moment on these inlets get every element. If an inlet is true, that is its first one."""

    unit: str
    inlets: Mapping[str, bool]


class AskState(Command, frozen=True):
    """Ask a unit for its state, once its inlets have received the elements of these moments."""

    unit: str
    until: Mapping[str, Moment]
    successor: str
    """The unit that continues with the state."""


class GiveState(Command, frozen=True):
    """Give a waiting unit a state, its place in each input, and the moment after which each output's elements come;
    without a state, the last known one of its name.

    A unit that was asked for its state continues with its own instead.
    """

    unit: str
    state: bytes | None = None
    inputs: Mapping[str, GivenInput] = {}
    outputs: Mapping[str, Moment] = {}


class TellOf(Command, frozen=True):
    """Report an event of the update."""

    event: StateNotExact


class Doubt(Command, frozen=True):
    """Report an event once its unit has told its places, if one is later than the moment `unless` has for its inlet."""

    event: StateNotExact
    unless: Mapping[str, Moment]


class StopUnit(Command, frozen=True):
    """Tell a unit to end."""

    unit: str


class EndUnit(Command, frozen=True):
    """End a unit at once."""

    unit: str


class StopAgain(Command, frozen=True):
    """Interrupt the code of a unit that was told to end and still blocks."""

    unit: str


class CutShort(Command, frozen=True):
    """End a unit that has not ended `after_s` after it was told to."""

    unit: str
    after_s: float


class Dump(Command, frozen=True):
    """Let a unit print its stack."""

    unit: str


class Connect(Command, frozen=True):
    """Let a stream feed an inlet, as the successor of its present source, if any."""

    stream: Stream
    inlet: Inlet


class Disconnect(Command, frozen=True):
    """Leave an inlet without a source."""

    inlet: Inlet


class SwitchNow(Command, frozen=True):
    """Switch an inlet to its new source without waiting for the old one."""

    inlet: Inlet


class SetEnvironment(Command, frozen=True):
    """Take this environment as the running configuration."""

    environment: Environment


class Commit(Command, frozen=True):
    """Note that all new units are ready and connected: from here on nothing is undone."""


class Undo(Command, frozen=True):
    """Note that the update is undone from here on."""


class WaitUntil(Command, frozen=True):
    """Wait until the running configuration fulfils a condition, at most `patience_s`."""

    holds: Callable[[], bool]
    patience_s: float


Commands: TypeAlias = Generator[Command, None, None]
