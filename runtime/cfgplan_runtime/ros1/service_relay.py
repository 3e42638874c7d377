"""The relay's part for services of ROS 1: it forwards calls to the node that offers the service now."""

from __future__ import annotations

import socket
import threading
from collections import defaultdict
from contextlib import suppress

from cfgplan.ros.node_api import SilentError, header_of
from cfgplan_runtime.ros1.tcpros import Header, service_end

_PIECE_BYTES = 1 << 16


class ServiceRelay:
    """Connects each service that the relay offers to the service of a node. Thread-safe."""

    def __init__(self, master: str) -> None:
        self._master = master
        self._led: dict[str, tuple[int, str]] = {}
        self._open: dict[str, set[socket.socket]] = defaultdict(set)

    def lead(self, wire: int, source: str, target: str) -> None:
        """Forward calls of `target` to `source` from now on. Open connections are closed."""
        self._led[target] = wire, source
        self._hang_up(target)

    def end(self, wire: int) -> str | None:
        """Stop forwarding over a wire. Returns the service that is no longer offered, or None."""
        for target, (led, _) in self._led.items():
            if led == wire:
                self.close(target)
                return target
        return None

    def close(self, target: str) -> None:
        """Stop offering a service."""
        self._led.pop(target, None)
        self._hang_up(target)

    def forward(self, caller: socket.socket, asks: Header) -> None:
        """Forward the calls of a connection until it ends. Raises SilentError or OSError if no node answers them."""
        target = asks["service"]
        if target not in self._led:
            raise SilentError(f"{target} is not offered now")
        _, source = self._led[target]
        with service_end(self._master, source) as server:
            server.sendall(header_of({**asks, "service": source}))
            ends = {caller, server}
            self._open[target] |= ends
            for end in ends:
                end.settimeout(None)
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            back = threading.Thread(target=_pass_on, args=(server, caller), daemon=True)
            back.start()
            _pass_on(caller, server)
            back.join()
            self._open[target] -= ends

    def _hang_up(self, target: str) -> None:
        for end in list(self._open[target]):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def _pass_on(source: socket.socket, target: socket.socket) -> None:
    """Forward all data, then the end of it."""
    with suppress(OSError):
        while segment := source.recv(_PIECE_BYTES):
            target.sendall(segment)
    for end in (source, target):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
