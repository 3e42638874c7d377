"""A graph of ROS nodes with their topics and services; the value between sources and files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from operator import attrgetter
from pathlib import Path

from cfgplan.canonical import store_sorted
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType
from cfgplan.transformations import ContainerKind


class Role(StrEnum):
    """The role of a node at a topic or a service; an action counts as a service."""

    PUBLISHES = "publishes"
    SUBSCRIBES = "subscribes"
    SERVES = "serves"
    CALLS = "calls"

    @property
    def gives(self) -> bool:
        """Whether others get something from it."""
        return self in (Role.PUBLISHES, Role.SERVES)

    @property
    def is_service(self) -> bool:
        """Whether it is about requests and replies."""
        return self in (Role.SERVES, Role.CALLS)


@dataclass(frozen=True, slots=True, order=True)
class RosPort:
    """An end of a topic, service or action at a node.

    `name` is the full name after remapping, `own` the name in the node's code, where that is known. The type is None
    where no source tells it. `rate_hz` is what a recording says of a topic, and `definition` the digest of the type's
    definition: ends with different ones do not understand each other. `qos` is what a publisher offers or a
    subscription asks for, in ROS 2.
    """

    role: Role
    name: str
    type: MessageType | None = None
    own: str | None = None
    rate_hz: float | None = None
    definition: str | None = None
    qos: ServiceQuality | None = None


def _port_key(port: RosPort) -> tuple[str, ...]:
    return port.role, port.name, str(port.type), port.definition or ""


@dataclass(frozen=True)
class RosNode:
    """A node by its full name, such as `/robot1/amcl`.

    `package` and `executable` start it (without a package, the executable is a file); `plugin` is the class that the
    container or nodelet manager `container` loads, in ROS 2 a container of this kind; each is None if no source names
    it. `remappings` map the node's own
    names to those used, both in full; `parameters` are as a launch file writes them. A `player` stands for the unknown
    publishers of recorded topics. `runs` is None if no source looked whether the node runs. `machine` is the computer
    that it runs on; None: the one that starts the graph. `shared` are the own names in `remappings` that a launch file
    renames for all nodes of a group, even those that do not use the name. `file` is the launch file that starts the
    node: its package is searched near it.
    """

    name: str
    ports: tuple[RosPort, ...] = ()
    package: str | None = None
    executable: str | None = None
    plugin: str | None = None
    container: str | None = None
    container_kind: ContainerKind | None = None
    arguments: tuple[str, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    parameters: Mapping[str, object] = field(default_factory=dict, hash=False)
    player: bool = False
    runs: bool | None = None
    machine: str | None = None
    shared: frozenset[str] = frozenset()
    file: Path | None = None

    def __post_init__(self) -> None:
        unique = {_port_key(port): port for port in reversed(self.ports)}
        store_sorted(self, "ports", unique.values(), _port_key)

    def names(self, role: Role) -> list[str]:
        """The topics or services that it has this role at, sorted."""
        return sorted({port.name for port in self.ports if port.role is role})


@dataclass(frozen=True)
class RosGraph:
    """The nodes of one or several sources.

    `notes` name facts that the sources do not tell, `dropped` statements of theirs that an environment can't express.
    `parameters` are those that launch files set outside nodes, by their full names.
    """

    nodes: tuple[RosNode, ...] = ()
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    parameters: Mapping[str, object] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        store_sorted(self, "nodes", self.nodes, attrgetter("name"))

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that nodes publish or subscribe to."""
        return tuple(sorted({p.name for node in self.nodes for p in node.ports if not p.role.is_service}))

    @property
    def services(self) -> tuple[str, ...]:
        """The services and actions that nodes serve or call."""
        return tuple(sorted({p.name for node in self.nodes for p in node.ports if p.role.is_service}))

    def types_of(self, name: str, *, is_service: bool) -> tuple[MessageType, ...]:
        """The types that its ends say a topic or service has."""
        ends = (port for node in self.nodes for port in node.ports if port.name == name)
        return tuple(sorted({end.type for end in ends if end.type and end.role.is_service == is_service}))


def merged(graphs: Iterable[RosGraph]) -> RosGraph:
    """Merge graphs: nodes of one name become one node, started as the first source that says so does.

    A player keeps the topics that no other node publishes. For the other topics the recording gives the rate, and the
    type if no other source does. If a source looked at the running nodes, nodes that it has not seen do not run, and
    players are removed.
    """
    graphs = list(graphs)
    nodes: dict[str, RosNode] = {}
    for node in [node for graph in graphs for node in graph.nodes]:
        nodes[node.name] = _joined(nodes[node.name], node) if node.name in nodes else node
    if any(node.runs is not None for node in nodes.values()):
        nodes = {name: replace(node, runs=bool(node.runs)) for name, node in nodes.items()}
    return RosGraph(
        tuple(_with_recorded([*nodes.values()])),
        tuple(source for graph in graphs for source in graph.sources),
        tuple(dict.fromkeys(note for graph in graphs for note in graph.notes)),
        tuple(each for graph in graphs for each in graph.dropped),
        {name: value for graph in reversed(graphs) for name, value in graph.parameters.items()},
    )


def _joined(one: RosNode, other: RosNode) -> RosNode:
    ports = [*one.ports]
    for port in other.ports:
        same = next((at for at, own in enumerate(ports) if _is_same(own, port)), None)
        if same is None:
            ports.append(port)
        else:
            ports[same] = _filled(ports[same], port)
    names = ("package", "executable", "plugin", "container", "container_kind", "machine", "file")
    known = {name: getattr(one, name) or getattr(other, name) for name in names}
    return replace(
        one,
        ports=tuple(ports),
        arguments=one.arguments or other.arguments,
        remappings=one.remappings or other.remappings,
        shared=one.shared if one.remappings else other.shared,
        parameters={**other.parameters, **one.parameters},
        player=one.player and other.player,
        runs=one.runs if one.runs or other.runs is None else other.runs,
        **known,
    )


def _is_same(one: RosPort, other: RosPort) -> bool:
    """Return whether two sources describe the same port; an unknown type or definition equals any."""
    known = ((one.type, other.type), (one.definition, other.definition))
    return (one.role, one.name) == (other.role, other.name) and all(a == b for a, b in known if a and b)


def _filled(one: RosPort, other: RosPort) -> RosPort:
    """Return a port completed by another source's values."""
    names = ("type", "own", "rate_hz", "definition", "qos")
    return replace(one, **{name: getattr(one, name) or getattr(other, name) for name in names})


def _with_recorded(nodes: Sequence[RosNode]) -> Iterator[RosNode]:
    """Yield the nodes with the rates and types that players know, and the players with their remaining topics."""
    recorded = {port.name: port for node in nodes if node.player for port in node.ports}
    publishers = Counter(port.name for node in nodes if not node.player for port in node.ports if _publishes(port))
    for node in nodes:
        if not node.player:
            ports = []
            for port in node.ports:
                known = recorded.get(port.name) if _publishes(port) else None
                if known is not None and _is_same(port, known):
                    rate_hz = known.rate_hz and known.rate_hz / publishers[port.name]
                    port = _filled(port, replace(known, rate_hz=rate_hz, own=None))
                ports.append(port)
            yield replace(node, ports=tuple(ports))
        elif node.runs is None and (left := tuple(port for port in node.ports if port.name not in publishers)):
            yield replace(node, ports=left)


def _publishes(port: RosPort) -> bool:
    return port.role is Role.PUBLISHES


def resolved(name: str, namespace: str, node: str) -> str:
    """The full name that a node means: `/global`, relative to its namespace, or private to it (`~private`).

    `node` is the node's full name.
    """
    if name.startswith("~"):
        name = f"{node}/{name[1:].lstrip('/')}"
    elif not name.startswith("/"):
        name = f"{namespace}/{name}"
    return "/" + "/".join(part for part in name.split("/") if part)


def node_port(node: RosNode, role: Role, own: str, kind: MessageType | None) -> RosPort:
    """A port that a node's code calls `own`, by its full name after the node's remappings."""
    full = resolved(own, node.name.rpartition("/")[0], node.name)
    return RosPort(role, dict(node.remappings).get(full, full), kind, own)
