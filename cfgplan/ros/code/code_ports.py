"""Ports as source text names them: each with the place of its call, and a name that may be a parameter's value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosNode, RosPort, node_port, resolved
from cfgplan.ros.types import MessageType, TypeKind

BROADCASTERS = {"TransformBroadcaster": "/tf", "StaticTransformBroadcaster": "/tf_static"}
"""Classes whose objects publish transforms, and their topics."""
MOST_STEPS = 25
"""The longest chain of names standing for each other; a longer one counts as computed."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A name that a parameter gives (`~topic` is a private one); the default is None where the code has none."""

    name: str
    default: str | None = None


CodeName: TypeAlias = tuple[str | Parameter, ...]
"""The parts of a name, which are put together."""


@dataclass(frozen=True, slots=True)
class Place:
    """A line of a source file; the file is written from the folder of the packages."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@dataclass(frozen=True, slots=True)
class CodePort:
    """A port that a call makes. `namespace` is that of the handle it is called on: "", `~`, `~sub` or `sub`."""

    role: Role
    name: CodeName
    type: MessageType | None
    place: Place
    namespace: str = ""


@dataclass(frozen=True)
class CodeReading:
    """The ports that source files name, and the calls (with places) whose names are computed."""

    ports: tuple[CodePort, ...] = ()
    unclear: tuple[str, ...] = ()


def action_ports(is_server: bool, port: CodePort) -> Iterator[CodePort]:
    """Yield the ports of a server or client of an action: one service in ROS 2, five topics in ROS 1.

    `port` has the action's name and its type. In ROS 2 the type has the kind `action`; in ROS 1 it is the message
    `NameAction`, or None.
    """
    if port.type is not None and port.type.kind == "action":
        yield replace(port, role=Role.SERVES if is_server else Role.CALLS)
        return
    kind = port.type
    inward, outward = (Role.SUBSCRIBES, Role.PUBLISHES) if is_server else (Role.PUBLISHES, Role.SUBSCRIBES)
    known = {
        "cancel": MessageType("actionlib_msgs", "GoalID"),
        "status": MessageType("actionlib_msgs", "GoalStatusArray"),
    }
    for word, role in (
        ("goal", inward),
        ("cancel", inward),
        ("status", outward),
        ("feedback", outward),
        ("result", outward),
    ):
        own = None if kind is None else replace(kind, name=f"{kind.name}{word.capitalize()}")
        yield replace(port, role=role, name=(*port.name, f"/{word}"), type=known.get(word, own))


def type_of(text: str, kind: TypeKind) -> MessageType | None:
    """The type that a text of code spells; None if it is none."""
    try:
        return MessageType.read(text, kind)
    except InputError:
        return None


def ports_of_code(
    reading: CodeReading, node: RosNode, shared: Mapping[str, object]
) -> tuple[dict[RosPort, Place], list[str]]:
    """Return the ports of a node that runs the code, each with its place, and notes on unclear parameters.

    `shared` are the parameters that were set outside of nodes, by full name.
    """
    found: dict[RosPort, Place] = {}
    unclear = list(reading.unclear)
    for port in reading.ports:
        own = _text(port.name, node, shared)
        if not own or own.endswith("/"):
            unclear.append(f"{port.role.value} `{_shown(port.name)}` at {port.place}")
            continue
        if port.namespace and not own.startswith(("/", "~")):
            own = f"~{own}" if port.namespace == "~" else f"{port.namespace}/{own}"
        found.setdefault(node_port(node, port.role, own, port.type), port.place)
    return found, unclear


def _text(name: CodeName, node: RosNode, shared: Mapping[str, object]) -> str | None:
    parts = [part if isinstance(part, str) else _value(part, node, shared) for part in name]
    return None if None in parts else "".join(part or "" for part in parts)


def _value(parameter: Parameter, node: RosNode, shared: Mapping[str, object]) -> str | None:
    full = resolved(parameter.name, node.name.rpartition("/")[0], node.name)
    private = full.removeprefix(f"{node.name}/")
    value = node.parameters.get(private) if private != full else shared.get(full)
    if value is None:
        return parameter.default
    return value if isinstance(value, str) else None


def _shown(name: CodeName) -> str:
    return "".join(part if isinstance(part, str) else f"{{{part.name}}}" for part in name)
