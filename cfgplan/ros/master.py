"""The graph of a running ROS 1 system, from its master and its nodes' answers about their own topics."""

from __future__ import annotations

import os
import socket
import struct
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlparse
from xmlrpc.client import ServerProxy

import psutil

from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort, resolved
from cfgplan.ros.node_api import ANSWER_LIMIT_S, LARGEST_HEADER, SilentError, asked, fields_of_header, header_of, peer
from cfgplan.ros.types import MessageType

MASTER_VARIABLE = "ROS_MASTER_URI"
USUAL_MASTER = "http://localhost:11311"
_CALLER = "/cfgplan_import"


def master_graph(address: str | None = None) -> RosGraph:
    """The nodes that a master knows, `address` or else that of ROS_MASTER_URI. Raises InputError if it is not there.

    A node that does not answer has the types that the master tells, and does not run. A master knows no clients of
    services.
    """
    address = address or os.environ.get(MASTER_VARIABLE) or USUAL_MASTER
    master = peer(address)
    try:
        publishers, subscribers, servers = asked(master, _CALLER, "getSystemState")
        topics = dict(asked(master, _CALLER, "getTopicTypes"))
        roles = {Role.PUBLISHES: publishers, Role.SUBSCRIBES: subscribers, Role.SERVES: servers}
        ends: dict[str, list[tuple[Role, str]]] = defaultdict(list)
        for role, rows in roles.items():
            for name, nodes in rows:
                for node in nodes:
                    ends[node].append((role, name))
        types = {name: _service_type(asked(master, _CALLER, "lookupService", name), name) for name, _ in servers}
        addresses = {node: _address(master, node) for node in ends}
    except (SilentError, TypeError, ValueError) as error:
        mend = f"start it by `roscore`, or name its address: `live`, that is ${MASTER_VARIABLE}, or http://host:11311"
        raise InputError.of(f"no ROS 1 master answers at {address}: {error}", mend=mend) from None
    notes = ["the callers of services, since a ROS 1 master does not know them"]
    nodes = [_node(name, own, addresses[name], topics, types, notes) for name, own in sorted(ends.items())]
    return RosGraph(tuple(nodes), (f"the ROS 1 master at {address}",), tuple(notes))


def _node(
    name: str,
    ends: list[tuple[Role, str]],
    address: str | None,
    topics: Mapping[str, str],
    types: Mapping[str, MessageType | None],
    notes: list[str],
) -> RosNode:
    at = None if address is None else peer(address)
    own: dict[Role, dict[str, str]] = {}
    try:
        if at is None:
            raise SilentError
        own = {
            Role.PUBLISHES: dict(asked(at, _CALLER, "getPublications")),
            Role.SUBSCRIBES: dict(asked(at, _CALLER, "getSubscriptions")),
        }
    except (SilentError, TypeError, ValueError):
        notes.append(f"whether {name} is alive, since it does not answer: it counts as not running")
    ports = [
        RosPort(
            role, topic, types[topic] if role.is_service else _type(own.get(role, {}).get(topic) or topics.get(topic))
        )
        for role, topic in ends
    ]
    command = _command(at, address) if own and at is not None and address is not None else ()
    return _started_by(RosNode(name, tuple(ports), runs=bool(own)), command)


def _type(text: str | None) -> MessageType | None:
    """Return the type that a node names for a topic; None if it names none or `*`."""
    return None if not text or text == "*" else MessageType.read(text)


def _address(master: ServerProxy, node: str) -> str | None:
    try:
        return str(asked(master, _CALLER, "lookupNode", node))
    except SilentError:
        return None


def _service_type(address: str, name: str) -> MessageType | None:
    """The type of a service, which only its server knows: asked as a client that hangs up (`probe`)."""
    place = urlparse(address)
    fields = {"probe": "1", "md5sum": "*", "callerid": _CALLER, "service": name}
    try:
        with socket.create_connection((place.hostname or "", place.port or 0), ANSWER_LIMIT_S) as connection:
            connection.sendall(header_of(fields))
            with connection.makefile("rb") as stream:
                (size,) = struct.unpack("<I", stream.read(4))
                told = dict(fields_of_header(stream.read(min(size, LARGEST_HEADER))))
    except (OSError, struct.error):
        return None
    return MessageType.read(told["type"], "srv") if "type" in told else None


def _command(node: ServerProxy, address: str) -> tuple[str, ...]:
    """The command line of a node that runs on this computer; empty if it does not, or hides it."""
    try:
        if not _is_here(urlparse(address).hostname or ""):
            return ()
        return tuple(psutil.Process(int(asked(node, _CALLER, "getPid"))).cmdline())
    except (SilentError, psutil.Error, OSError, TypeError, ValueError):
        return ()


def _is_here(host: str) -> bool:
    own = {address.address for addresses in psutil.net_if_addrs().values() for address in addresses}
    return bool(own & {str(place[4][0]) for place in socket.getaddrinfo(host, None)})


def _started_by(node: RosNode, command: tuple[str, ...]) -> RosNode:
    """Return a node with the values of its command line: `.../lib/PACKAGE/EXECUTABLE`, arguments and remappings."""
    at = next((index for index, word in enumerate(command[:2]) if _package(Path(word)) is not None), None)
    if at is None:
        return node
    program = Path(command[at])
    words = command[at + 1 :]
    namespace = node.name.rpartition("/")[0]
    remappings = [word.split(":=", 1) for word in words if ":=" in word and not word.startswith("_")]
    return replace(
        node,
        package=_package(program),
        executable=program.name,
        arguments=tuple(word for word in words if ":=" not in word),
        remappings=tuple((resolved(a, namespace, node.name), resolved(b, namespace, node.name)) for a, b in remappings),
    )


def _package(program: Path) -> str | None:
    """The package that a program belongs to: its folder's name below `lib`, or the nearest with a package.xml."""
    if not program.is_absolute():
        return None
    if program.parent.parent.name == "lib":
        return program.parent.name
    return next((folder.name for folder in program.parents if (folder / "package.xml").is_file()), None)
