"""Messages between a run and its ROS 2 helper, as lines of JSON."""

from __future__ import annotations

from typing import Any, TypeAlias

import msgspec

from cfgplan_runtime.children.messages import Lost, Switched
from cfgplan_runtime.nodes.relay_messages import Passed, Refused, Unsaid
from cfgplan_runtime.ros2.host_link import WithData


class PortTopic(msgspec.Struct, frozen=True):
    """A port of a node: the topic or service that it was remapped to, and its message type if the file has one.

    `key` identifies the port's remembered qualities of service; `outside` is the topic for nodes outside of the run.
    """

    topic: str
    key: str
    message: str | None = None
    outside: str | None = None


class Attend(msgspec.Struct, tag=True):
    """Report when the ports of a unit's node have appeared. At most `queue` messages wait at each input.

    With `waits` it is a cold spare of a lifecycle node, which is only configured. With `asks` the helper calls the node
    each second and reports its answers. With `is_watched` the helper reports when the node has left the graph. With
    `has_clock` the node's parameters say which clock it goes by. A lifecycle node is configured; with `is_active` it
    was activated before, and becomes active again.
    """

    unit: str
    node: str
    inputs: list[PortTopic]
    outputs: list[PortTopic]
    queue: int
    is_foreign: bool = False
    asks: bool = False
    waits: bool = False
    is_watched: bool = False
    has_clock: bool = False
    is_active: bool = False


class Load(msgspec.Struct, tag=True):
    """Load a unit's component into a container, once that answers; a component that is already loaded stays."""

    unit: str
    container: str
    package: str
    plugin: str
    node: str
    namespace: str
    remaps: list[str]
    parameters: dict[str, Any]


class Unload(msgspec.Struct, tag=True):
    """Unload a unit's component, by the number that the container gave it."""

    unit: str
    container: str
    number: int


class LookForContainer(msgspec.Struct, tag=True):
    """Tell whether a foreign container has this name."""

    container: str


class EndContainer(msgspec.Struct, tag=True):
    """A container has ended: forget it, with the orders under way there."""

    container: str


class Begin(msgspec.Struct, tag=True):
    """A cold spare is a unit from now on."""

    spare: str
    unit: str


class ChangeState(msgspec.Struct, tag=True):
    """Activate a unit's node, or deactivate it, if it has a lifecycle."""

    unit: str
    is_active: bool


class Listening(msgspec.Struct, tag=True):
    """The helper is ready, on this middleware."""

    rmw: str = ""


class Attended(msgspec.Struct, tag=True):
    """A unit's node has appeared; some of its ports may be late. One that `has_life` is configured.

    It comes again for a node whose lifecycle is found late.
    """

    unit: str
    has_life: bool


class StateChanged(msgspec.Struct, tag=True):
    """A unit's lifecycle node was activated, or deactivated, as told."""

    unit: str
    is_active: bool


class Configured(msgspec.Struct, tag=True):
    """A cold spare is configured, and waits."""

    unit: str


class Failed(msgspec.Struct, tag=True):
    """A lifecycle node refuses to change its state, or a component can't be loaded."""

    unit: str
    cause: str


class ContainerFound(msgspec.Struct, tag=True):
    """Whether a foreign container has this name."""

    container: str
    is_there: bool


class Loaded(msgspec.Struct, tag=True):
    """A unit's component is loaded, under this number of its container."""

    unit: str
    number: int


class Unloaded(msgspec.Struct, tag=True):
    """A unit's component was unloaded, or the container failed to."""

    unit: str
    is_done: bool


class Gone(msgspec.Struct, tag=True):
    """A watched or foreign node is not in the graph."""

    unit: str


class Answered(msgspec.Struct, tag=True):
    """A node has answered the helper's call."""

    unit: str


class Told(msgspec.Struct, tag=True):
    """A message for the user about a unit."""

    unit: str
    text: str


class Tapped(WithData, tag=True, kw_only=True):
    """A message in CDR for the tap on `topic`, of the type `message`; `skipped` before it were not passed on.

    `time_ns` is its time in nanoseconds since 1970.
    """

    topic: str
    message: str
    time_ns: int
    skipped: int


FromHost: TypeAlias = (
    Listening
    | Attended
    | StateChanged
    | Configured
    | Failed
    | ContainerFound
    | Loaded
    | Unloaded
    | Gone
    | Answered
    | Told
    | Switched
    | Lost
    | Passed
    | Refused
    | Tapped
    | Unsaid
)
