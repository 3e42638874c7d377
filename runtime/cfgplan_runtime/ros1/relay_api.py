"""The XML-RPC interface of a ROS 1 node for masters and other nodes, as the relay offers it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from socketserver import ThreadingMixIn
from typing import Any, Protocol, TypeAlias
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

from cfgplan.ros.node_api import FAILURE, SUCCESS

_Answer: TypeAlias = "tuple[int, str, Any]"


class ApiOwner(Protocol):
    """The node behind the interface; its methods are called in the interface's threads. Message types are by topic."""

    def published(self) -> Mapping[str, str]: ...
    def subscribed(self) -> Mapping[str, str]: ...
    def note_publishers(self, topic: str, addresses: list[str]) -> None: ...
    def finish(self) -> None: ...


class _ApiHandler(SimpleXMLRPCRequestHandler):
    rpc_paths = ()  # nodes are called at any path
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True


class _ApiServer(ThreadingMixIn, SimpleXMLRPCServer):
    daemon_threads = True


class RelayApi:
    """Serves the interface from now on. Subscribers are sent to `port` of `host` for messages."""

    def __init__(self, owner: ApiOwner, master: str, host: str, port: int) -> None:
        self._owner, self._master, self._host, self._port = owner, master, host, port
        server = _ApiServer((host, 0), _ApiHandler, logRequests=False)
        self.address = f"http://{host}:{server.server_address[1]}/"
        methods: dict[str, Callable[..., _Answer]] = {
            "getBusInfo": lambda _: (SUCCESS, "", []),
            "getBusStats": lambda _: (SUCCESS, "", [[], [], []]),
            "getMasterUri": lambda _: (SUCCESS, "", self._master),
            "getPid": lambda _: (SUCCESS, "", os.getpid()),
            "getPublications": lambda _: _pairs(self._owner.published()),
            "getSubscriptions": lambda _: _pairs(self._owner.subscribed()),
            "paramUpdate": lambda *_: (SUCCESS, "", 0),
            "publisherUpdate": self._note_publishers,
            "requestTopic": self._give_topic,
            "shutdown": self._shut_down,
        }
        for name, method in methods.items():
            server.register_function(method, name)
        threading.Thread(target=server.serve_forever, name="relay-api", daemon=True).start()

    def _note_publishers(self, _: str, topic: str, addresses: list[str]) -> _Answer:
        self._owner.note_publishers(topic, addresses)
        return SUCCESS, "", 0

    def _give_topic(self, _: str, topic: str, protocols: list[list[Any]]) -> _Answer:
        if topic not in self._owner.published() or not any(one[:1] == ["TCPROS"] for one in protocols):
            return FAILURE, f"{topic} is not available here by TCPROS", []
        return SUCCESS, "", ["TCPROS", self._host, self._port]

    def _shut_down(self, *_: str) -> _Answer:
        self._owner.finish()
        return SUCCESS, "", 0


def _pairs(types: Mapping[str, str]) -> _Answer:
    return SUCCESS, "", [[topic, kind] for topic, kind in sorted(types.items())]
