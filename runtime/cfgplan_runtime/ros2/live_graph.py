"""The graph of a running ROS 2 system, read from ROS itself by the helper, on any middleware."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import psutil

from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort, resolved
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType
from cfgplan.summary import some
from cfgplan_runtime.ros2.host_link import HostLink
from cfgplan_runtime.ros2.host_messages import FromHost, Listening
from cfgplan_runtime.ros2.ros_python import ros_python

_PATIENCE_S = 60.0
_MOST_LOOKS = 4
"""How often a graph is read that lacks a node of this computer. Each reading takes 2 to 10 s."""
_ROS_ARGUMENTS, _ROS_END = "--ros-args", "--"
_RENAMES = ("-r", "--remap")
_NO_PARAMETERS = ("qos_overrides.", "start_type_description_service")
"""Parameters that each node has by itself."""
_RMW_VARIABLE, _USUAL_RMW = "RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"
"""The variable that chooses the middleware, and the middleware that ROS uses if it is not set."""
_USUAL_TIME = ("use_sim_time", False)
_OF_ACTIONS = "/_action/"
Named: TypeAlias = list[tuple[str, list[str]]]
"""Topics, services or actions with their types."""


class DescribeGraph(msgspec.Struct, tag=True):
    """Report the graph once it no longer changes."""


class NodeTold(msgspec.Struct):
    """A node by its full name: its topics, services and actions by role, and its parameters."""

    name: str
    publishes: Named = []
    subscribes: Named = []
    serves: Named = []
    calls: Named = []
    acts: Named = []
    wants: Named = []
    parameters: dict[str, Any] = {}


class EndTold(msgspec.Struct):
    """A publisher or a subscription."""

    topic: str
    gives: bool
    node: str
    message: str
    definition: str
    reliable: bool
    transient_local: bool
    manual: bool
    deadline_s: float | None = None
    lease_s: float | None = None

    @property
    def qos(self) -> ServiceQuality:
        """The quality of service that it offers or requests."""
        return ServiceQuality(self.reliable, self.transient_local, self.deadline_s, self.lease_s, self.manual)


class Graph(msgspec.Struct, tag=True):
    """The whole graph as ROS reports it; `silent` nodes have not answered the question for their parameters."""

    nodes: list[NodeTold]
    ends: list[EndTold]
    silent: list[str]
    is_at_rest: bool


def live_graph(python: str | None = None) -> RosGraph:
    """The graph of the domain of ROS_DOMAIN_ID, as the Python that has rclpy sees it.

    Reads the graph again while it lacks a node that a process of this computer runs with the same middleware: nodes may
    be starting. Raises InputError if no such Python is found (see `ros_python`), if ROS does not answer, or if the
    graph is empty.
    """
    link: HostLink[FromHost | Graph] = HostLink(ros_python(python), f"_cfgplan_import_{os.getpid()}", FromHost | Graph)
    rmw = ""
    try:
        for _ in range(_MOST_LOOKS):
            told, named = _look(link)
            rmw, running = named or rmw, processes()
            if all(_is_foreign(running[node], rmw) for node in _unseen(told, running)):
                break
    finally:
        link.close()
    if not told.nodes:
        raise _nothing_seen(rmw, running)
    return graph_of(told, rmw, running)


def _look(link: HostLink[FromHost | Graph]) -> tuple[Graph, str]:
    """The graph, and the middleware if the helper names it meanwhile. Raises InputError if ROS does not answer."""
    rmw = ""
    link.send(DescribeGraph())
    for message in link.await_words(_PATIENCE_S):
        if isinstance(message, Graph):
            return message, rmw
        if isinstance(message, Listening):
            rmw = message.rmw
    raise InputError.of("ROS 2 has not answered", mend="try `ros2 node list` in the same surroundings")


def _unseen(told: Graph, running: Mapping[str, NodeProcess]) -> list[str]:
    """The nodes that processes of this computer run, but the graph lacks."""
    return sorted(running.keys() - {node.name for node in told.nodes})


def _is_foreign(process: NodeProcess, rmw: str) -> bool:
    """Whether a node was started with another middleware than `rmw`, and therefore may never appear in the graph."""
    usual = _USUAL_RMW if os.environ.get(_RMW_VARIABLE) else rmw
    return rmw not in ("", process.rmw or usual)


def _nothing_seen(rmw: str, running: Mapping[str, NodeProcess]) -> InputError:
    place = f"the ROS 2 domain {_domain()} ({rmw})"
    if running:
        mend = "import again in some seconds; if they are still missing, compare RMW_IMPLEMENTATION with theirs"
        return InputError.of(f"{place} shows no node yet, though {some(sorted(running))} run here", mend=mend)
    mend = "start the nodes first, with the same ROS_DOMAIN_ID and RMW_IMPLEMENTATION"
    return InputError.of(f"there is no node in {place}", mend=mend)


def _domain() -> str:
    return os.environ.get("ROS_DOMAIN_ID", "0") or "0"


def graph_of(told: Graph, rmw: str, running: Mapping[str, NodeProcess]) -> RosGraph:
    """The answers of the helper as a graph. `running` has the processes of nodes on this computer, by full name."""
    ends = {(end.node, end.gives, end.topic): end for end in told.ends}
    names = Counter(node.name for node in told.nodes)
    notes = [
        f"which of the {number} nodes called {name} has which ports" for name, number in names.items() if number > 1
    ]
    if told.silent:
        notes.append(f"the parameters of {some(sorted(told.silent))}, which do not answer")
    away = sorted(name for name in names if name not in running)
    if away:
        notes.append(f"what starts {some(away)}: no process on this computer says that it is that node")
    unseen = _unseen(told, running)
    foreign = [name for name in unseen if _is_foreign(running[name], rmw)]
    if late := [name for name in unseen if name not in foreign]:
        notes.append(f"the ports of {some(late)}: a process here is that node, but the graph lacks it; import again")
    if foreign:
        notes.append(
            f"the ports of {some(foreign)}: a process here is that node, but was started with another "
            f"{_RMW_VARIABLE} than {rmw}"
        )
    if not told.is_at_rest:
        notes.append("whether the graph is complete: it has not come to rest")
    nodes = [_node(node, ends, running.get(node.name)) for node in told.nodes]
    return RosGraph(tuple(nodes), (f"the ROS 2 domain {_domain()} ({rmw})",), tuple(notes))


def _node(told: NodeTold, ends: Mapping[tuple[str, bool, str], EndTold], process: NodeProcess | None) -> RosNode:
    kept = {
        name: value
        for name, value in told.parameters.items()
        if not name.startswith(_NO_PARAMETERS) and (name, value) != _USUAL_TIME
    }
    seen = RosNode(
        told.name,
        tuple(_ports(told, ends)),
        parameters={name: value for name, value in kept.items() if value not in (None, [])},
        runs=True,
    )
    if process is None:
        return seen
    return replace(
        seen,
        package=process.package,
        executable=process.executable,
        arguments=process.arguments,
        remappings=process.remappings(told.name),
    )


def _ports(told: NodeTold, ends: Mapping[tuple[str, bool, str], EndTold]) -> Iterator[RosPort]:
    for role, named in ((Role.PUBLISHES, told.publishes), (Role.SUBSCRIBES, told.subscribes)):
        for topic, kinds in named:
            if _OF_ACTIONS not in topic:
                end = ends.get((told.name, role.gives, topic))
                kind, hash_ = (end.message, end.definition) if end else (kinds[0], "")
                qos = end.qos if end else None
                yield RosPort(role, topic, MessageType.read(kind), definition=hash_ or None, qos=qos)
    for role, named in (
        (Role.SERVES, [*told.serves, *told.acts]),
        (Role.CALLS, [*told.calls, *told.wants]),
    ):
        for service, kinds in named:
            if _OF_ACTIONS not in service:
                yield RosPort(role, service, MessageType.read(kinds[0]))


@dataclass(frozen=True)
class NodeProcess:
    """A process on this computer that is a node: how it was started."""

    package: str
    executable: str
    arguments: tuple[str, ...] = ()
    renames: tuple[tuple[str, str], ...] = ()
    rmw: str = ""
    """The middleware that its environment chooses; empty if it chooses none."""

    def remappings(self, node: str) -> tuple[tuple[str, str], ...]:
        """Its remappings by full names."""
        space = node.rpartition("/")[0]
        full = {resolved(a, space, node): resolved(b, space, node) for a, b in self.renames}
        return tuple((a, b) for a, b in full.items() if a != b)


def processes() -> dict[str, NodeProcess]:
    """The processes of this domain whose command lines have the name of their node, by the nodes' full names.

    If several have the same name, the last counts: `ros2 run` and other wrappers have the same words as the node that
    they start.
    """
    found: dict[str, NodeProcess] = {}
    for process in sorted(psutil.process_iter(), key=psutil.Process.create_time):
        with suppress(psutil.Error):
            command = process.cmdline()
            if (
                _ROS_ARGUMENTS in command
                and ((variables := process.environ()).get("ROS_DOMAIN_ID") or "0") == _domain()
            ):
                named = node_process(command, Path(process.cwd()))
                if named is not None:
                    found[named[0]] = replace(named[1], rmw=variables.get(_RMW_VARIABLE, ""))
    return found


def node_process(command: list[str], folder: Path) -> tuple[str, NodeProcess] | None:
    """The full name and the start of a command line's node; None if the command line does not have the name.

    `folder` is the process's working directory.
    """
    at = command.index(_ROS_ARGUMENTS)
    end = command.index(_ROS_END, at) if _ROS_END in command[at:] else len(command)
    before, ros, after = command[:at], command[at + 1 : end], command[end + 1 :]
    pairs = [word.split(":=", 1) for word, flag in zip(ros[1:], ros, strict=False) if flag in _RENAMES and ":=" in word]
    renames = {own.rpartition(":")[2] if own.endswith(("__node", "__ns")) else own: name for own, name in pairs}
    program, *arguments = before[1:] if _is_interpreter(before) else before
    own = renames.pop("__node", renames.pop("__name", None))
    space = renames.pop("__ns", "")
    if own is None:
        return None
    package, executable = _executable(folder / program)
    arguments += after
    return resolved(own, space, ""), NodeProcess(package, executable, tuple(arguments), tuple(renames.items()))


def _is_interpreter(words: list[str]) -> bool:
    """Whether a command line is that of a Python that runs a file."""
    return len(words) > 1 and Path(words[0]).name.startswith("python") and not words[1].startswith("-")


def _executable(path: Path) -> tuple[str, str]:
    """The package and the executable of a file; the package is "" for a file that no package has installed."""
    parts = path.parts
    if len(parts) > 2 and parts[-3] == "lib":
        return parts[-2], parts[-1]
    return "", str(path)
