"""The graph of a running ROS 1 system: what its master knows, and what its nodes say of their own topics."""

from __future__ import annotations

import os
import socket
import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from xmlrpc.client import Error, ServerProxy, Transport

import psutil

from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort, resolved
from cfgplan.ros.types import MessageType

MASTER_VARIABLE = "ROS_MASTER_URI"
USUAL_MASTER = "http://localhost:11311"
ANSWER_LIMIT_S = 3.0
"""How long a master or node may take to answer."""
_CALLER = "/cfgplan_import"
_LARGEST_HEADER = 2**20


class _SilentError(Exception):
    """A master or node that gives no answer, or an unusable one."""


def master_graph(address: str | None = None) -> RosGraph:
    """The nodes that a master knows, `address` or else that of ROS_MASTER_URI. Raises InputError if it is not there.

    A node that does not answer has the types that the master tells. A master knows no clients of services.
    """
    address = address or os.environ.get(MASTER_VARIABLE) or USUAL_MASTER
    master = _peer(address)
    try:
        publishers, subscribers, servers = _asked(master, "getSystemState")
        topics = dict(_asked(master, "getTopicTypes"))
        roles = {Role.PUBLISHES: publishers, Role.SUBSCRIBES: subscribers, Role.SERVES: servers}
        ends: dict[str, list[tuple[Role, str]]] = defaultdict(list)
        for role, rows in roles.items():
            for name, nodes in rows:
                for node in nodes:
                    ends[node].append((role, name))
        types = {name: _service_type(_asked(master, "lookupService", name), name) for name, _ in servers}
        addresses = {node: _address(master, node) for node in ends}
    except (_SilentError, TypeError, ValueError) as error:
        mend = f"start it by `roscore`, or name its address: `live`, that is ${MASTER_VARIABLE}, or http://host:11311"
        raise InputError.of(f"no ROS 1 master answers at {address}: {error}", mend=mend) from None
    notes = ["who calls services, since a ROS 1 master is not told"]
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
    peer = None if address is None else _peer(address)
    own: dict[Role, dict[str, str]] = {}
    try:
        if peer is None:
            raise _SilentError
        own = {
            Role.PUBLISHES: dict(_asked(peer, "getPublications")),
            Role.SUBSCRIBES: dict(_asked(peer, "getSubscriptions")),
        }
    except (_SilentError, TypeError, ValueError):
        notes.append(f"whether {name} is alive, since it does not answer: the types of its topics are the master's")
    ports = [
        RosPort(
            role, topic, types[topic] if role.is_service else _type(own.get(role, {}).get(topic) or topics.get(topic))
        )
        for role, topic in ends
    ]
    command = _command(peer, address) if own and peer is not None and address is not None else ()
    return _started_by(RosNode(name, tuple(ports)), command)


def _type(text: str | None) -> MessageType | None:
    """What a node says a topic's type is; `*` is any."""
    return None if not text or text == "*" else MessageType.read(text)


class _Limited(Transport):
    """Calls that end after ANSWER_LIMIT_S."""

    def make_connection(self, host: Any) -> HTTPConnection:
        connection: HTTPConnection = super().make_connection(host)
        connection.timeout = ANSWER_LIMIT_S
        return connection


def _peer(address: str) -> ServerProxy:
    try:
        return ServerProxy(address, transport=_Limited())
    except OSError:
        mend = "write it as http://host:11311"
        raise InputError.of(f"`{address}` is no address of a ROS 1 master", mend=mend) from None


def _asked(peer: ServerProxy, method: str, *arguments: str) -> Any:
    """The value of a call of the master's or a node's interface. Raises _SilentError."""
    try:
        code, message, value = getattr(peer, method)(_CALLER, *arguments)
    except (OSError, Error, HTTPException) as error:
        raise _SilentError(getattr(error, "strerror", None) or str(error) or type(error).__name__) from None
    if code != 1:
        raise _SilentError(message)
    return value


def _address(master: ServerProxy, node: str) -> str | None:
    try:
        return str(_asked(master, "lookupNode", node))
    except _SilentError:
        return None


def _service_type(address: str, name: str) -> MessageType | None:
    """The type of a service, which only its server knows: asked as a client that hangs up (`probe`)."""
    place = urlparse(address)
    fields = {"probe": "1", "md5sum": "*", "callerid": _CALLER, "service": name}
    lines = [f"{key}={value}".encode() for key, value in fields.items()]
    header = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    try:
        with socket.create_connection((place.hostname or "", place.port or 0), ANSWER_LIMIT_S) as connection:
            connection.sendall(struct.pack("<I", len(header)) + header)
            with connection.makefile("rb") as stream:
                (size,) = struct.unpack("<I", stream.read(4))
                told = dict(_fields(stream.read(min(size, _LARGEST_HEADER))))
    except (OSError, struct.error):
        return None
    return MessageType.read(told["type"], "srv") if "type" in told else None


def _fields(header: bytes) -> Iterator[tuple[str, str]]:
    """The fields of a connection header: lengths, and `key=value` of each."""
    while header:
        (size,) = struct.unpack_from("<I", header)
        key, _, value = header[4 : 4 + size].decode(errors="replace").partition("=")
        yield key, value
        header = header[4 + size :]


def _command(peer: ServerProxy, address: str) -> tuple[str, ...]:
    """The command line of a node that runs on this computer; empty if it does not, or hides it."""
    try:
        if not _is_here(urlparse(address).hostname or ""):
            return ()
        return tuple(psutil.Process(int(_asked(peer, "getPid"))).cmdline())
    except (_SilentError, psutil.Error, OSError, TypeError, ValueError):
        return ()


def _is_here(host: str) -> bool:
    own = {address.address for addresses in psutil.net_if_addrs().values() for address in addresses}
    return bool(own & {str(place[4][0]) for place in socket.getaddrinfo(host, None)})


def _started_by(node: RosNode, command: tuple[str, ...]) -> RosNode:
    """A node with what its command line says of it: `.../lib/PACKAGE/EXECUTABLE`, arguments and remappings."""
    at = next((index for index, word in enumerate(command[:2]) if _package(Path(word)) is not None), None)
    if at is None:
        return node
    program = Path(command[at])
    words = command[at + 1 :]
    namespace = node.name.rpartition("/")[0]
    remappings = [word.split(":=", 1) for word in words if ":=" in word and not word.startswith("_")]
    return RosNode(
        node.name,
        node.ports,
        _package(program),
        program.name,
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
