"""Tunnels: connections to the sockets of a run on another computer of the fleet.

The client (a run's manager, or a command) has a connected socket at its end. The server (an agent or a manager)
connects to a socket in its run's folder: a topic's, or the run's control socket. Bytes written at one end are read at
the other once and in order. If the link is cut or full, the writer waits. A client needs the manager's certificate.
"""

from __future__ import annotations

import secrets
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from math import inf
from pathlib import Path

from cfgplan.domain import MANAGER
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.streams import crossing
from cfgplan_runtime.streams.ends import Waker
from cfgplan_runtime.streams.run_folder import RunFolder, address, control_address
from cfgplan_runtime.streams.zenoh_link import ZenohLink

CONTROL = ""
"""The name of the run's control socket, in place of a topic."""
_TUNNEL_IN, _TUNNEL_OUT = ("in", "in-credit"), ("out", "out-credit")
"""Kinds of keys, from the client and to it: for data, and for credits."""
_TUNNEL_CHUNK = 1 << 18
_MOST_TUNNEL_CHUNKS = 8
_MOST_UNREAD = 1 << 20
"""The most bytes that wait to be read at one end; beyond it the other end waits."""
_LINGER_S = 2.0
"""Seconds within which the remaining data must arrive after one end was closed."""


class _Tunnel:
    """One end of a tunnel: a thread that lives until either end is closed.

    `declare` returns the functions that put at its keys; `ended` is called at the end. On the server `find` connects to
    the socket that the client asks for; it returns None if that does not exist.
    """

    def __init__(
        self,
        declare: Callable[[], tuple[crossing.Put, crossing.Put]],
        ended: Callable[[], None],
        find: Callable[[str], socket.socket | None] = lambda _: None,
    ) -> None:
        self._declare, self._ended, self._find = declare, ended, find
        self._end: socket.socket | None = None
        self._both = crossing.DuplexChannel(
            crossing.Sending(blocks=True, most=_MOST_TUNNEL_CHUNKS, granted=crossing.FRAMES_UNDER_WAY)
        )
        self._arrived: deque[tuple[bool, bytes, bytes]] = deque()
        self._unread = bytearray()
        self._is_closing = False
        self._close_s = inf
        self._waker = Waker()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._waker.socket, selectors.EVENT_READ)

    def start(self, end: socket.socket | None = None, wanted: str | None = None) -> None:
        """Begin to carry data between `end` and the other end. With `wanted`, ask the other end to connect to that."""
        if end is not None:
            self._join(end)
        if wanted is not None:
            self._both.sending.offer(crossing.Segment(0, 0, wanted.encode()))
        threading.Thread(target=self._run, name="cfgplan-tunnel", daemon=True).start()

    def take(self, is_credit: bool, head: bytes, payload: bytes) -> None:
        """Queue data from the other end. Thread-safe."""
        self._arrived.append((is_credit, head, payload))
        self._waker.wake()

    def close(self) -> None:
        """End at once, since the other end is gone. Thread-safe."""
        self._is_closing = True
        self._waker.wake()

    def _run(self) -> None:
        try:
            with suppress(RuntimeFaultError):  # the link is closed
                self._carry()
        finally:
            if self._end is not None:
                self._end.close()
            self._waker.close()
            self._selector.close()
            self._ended()

    def _carry(self) -> None:
        put, put_credit = self._declare()
        while not self._is_closing and time.monotonic() < self._close_s:
            self._step(put, put_credit)
            if self._close_s < inf and not (self._both.sending.depth or self._unread):
                break
        last = self._both.receiving.credit(inf)
        if last is not None:
            put_credit(b"", last.packed())

    def _step(self, put: crossing.Put, put_credit: crossing.Put) -> None:
        """Send data that is due, wait for more, and process data that has come."""
        self._both.pump(put, put_credit, time.monotonic(), has_room=len(self._unread) < _MOST_UNREAD)
        self._watch()
        due_s = min(self._both.due_s, self._close_s)
        found = self._selector.select(None if due_s == inf else max(0.0, due_s - time.monotonic()))
        self._waker.hear()
        while self._arrived:
            self._understand(*self._arrived.popleft())
        if any(key.fileobj is self._end and events & selectors.EVENT_READ for key, events in found):
            self._read()
        self._write()

    def _watch(self) -> None:
        """Watch for reading, unless the other end is behind, and for writing, if data waits for room."""
        if self._end is None:
            return
        is_read = self._close_s == inf and not self._both.sending.is_full
        events = (selectors.EVENT_READ if is_read else 0) | (selectors.EVENT_WRITE if self._unread else 0)
        is_known = self._end in self._selector.get_map()
        if events and is_known:
            self._selector.modify(self._end, events)
        elif events:
            self._selector.register(self._end, events)
        elif is_known:
            self._selector.unregister(self._end)

    def _understand(self, is_credit: bool, head: bytes, payload: bytes) -> None:
        for segment in self._both.take(is_credit, head, payload, time.monotonic()):
            if segment.is_last:
                self._begin_close()
            elif self._end is not None:
                self._unread += segment.payload
            else:
                end = self._find(bytes(segment.payload).decode(errors="replace"))
                if end is None:
                    self._finish()
                else:
                    self._join(end)

    def _join(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end

    def _read(self) -> None:
        assert self._end is not None
        try:
            chunk = self._end.recv(_TUNNEL_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if chunk:
            self._both.sending.offer(crossing.Segment(0, 0, chunk))
        else:
            self._finish()

    def _write(self) -> None:
        if self._end is None or not self._unread:
            return
        try:
            del self._unread[: self._end.send(self._unread)]
        except BlockingIOError:
            pass
        except OSError:
            self._unread.clear()
            self._finish()

    def _finish(self) -> None:
        """Begin to close after the local end was closed. The other end is told after all data."""
        if self._close_s == inf:
            self._both.sending.offer(crossing.LAST_SEGMENT)
            self._begin_close()

    def _begin_close(self) -> None:
        self._close_s = min(self._close_s, time.monotonic() + _LINGER_S)


class _Tunnels:
    """Tunnels by name. Thread-safe."""

    def __init__(self) -> None:
        self._tunnels: dict[str, _Tunnel] = {}
        self._lock = threading.Lock()

    def find(self, name: str, make: Callable[[], _Tunnel | None] = lambda: None) -> _Tunnel | None:
        """The tunnel of a name; if it is unknown, the result of `make`, which may be None."""
        with self._lock:
            found = self._tunnels.get(name) or make()
            if found is not None:
                self._tunnels[name] = found
            return found

    def forget(self, name: str) -> None:
        """Forget a tunnel that has ended."""
        with self._lock:
            self._tunnels.pop(name, None)

    def close(self, beginning: str = "") -> None:
        """Close the tunnels whose names begin with `beginning`."""
        with self._lock:
            tunnels = [tunnel for name, tunnel in self._tunnels.items() if name.startswith(beginning)]
        for tunnel in tunnels:
            tunnel.close()


class TunnelServer:
    """Lets clients reach the sockets in the folder `run` of this computer.

    `life` is the id of this host's agent, or of this manager.
    """

    def __init__(self, link: ZenohLink, host: str, life: str, run: Path) -> None:
        self._link, self._host, self._life, self._run = link, host, life, run
        self._tunnels = _Tunnels()
        self._ended: set[str] = set()
        """Names of ended tunnels, until their client is gone: a repeated segment must not make a new tunnel."""
        for kind in _TUNNEL_IN:
            link.hear(crossing.crossing_key(MANAGER, kind, host, f"{life}/*/*"), self._take)
        link.watch(_client_key("*"), self._note_client)

    def close(self) -> None:
        """Close all tunnels."""
        self._tunnels.close()

    def _take(self, key: str, head: bytes, payload: bytes) -> None:
        _, _, kind, _, _, client, number = key.split("/")
        name, is_credit = f"{client}/{number}", kind == _TUNNEL_IN[1]

        def made() -> _Tunnel | None:
            frame = None if is_credit else crossing.read_frame(head, payload)
            is_first = frame is not None and frame.number == 0 and frame.segment is not None
            return self._made(name) if is_first and name not in self._ended else None

        tunnel = self._tunnels.find(name, made)
        if tunnel is not None:
            tunnel.take(is_credit, head, payload)

    def _made(self, name: str) -> _Tunnel:
        keys = [crossing.crossing_key(self._host, kind, MANAGER, f"{self._life}/{name}") for kind in _TUNNEL_OUT]
        tunnel = _Tunnel(lambda: _declared(self._link, *keys), lambda: self._forget(name), self._connected)
        tunnel.start()
        return tunnel

    def _connected(self, wanted: str) -> socket.socket | None:
        end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            end.connect(str(address(self._run, wanted) if wanted != CONTROL else control_address(self._run)))
        except OSError:
            end.close()
            return None
        return end

    def _forget(self, name: str) -> None:
        self._ended.add(name)
        self._tunnels.forget(name)

    def _note_client(self, key: str, is_alive: bool) -> None:
        if not is_alive:
            client = key.rpartition("/")[2]
            self._tunnels.close(f"{client}/")
            self._ended.difference_update(name for name in self._ended.copy() if name.startswith(f"{client}/"))


class TunnelClient:
    """Reaches sockets of runs elsewhere in the fleet."""

    def __init__(self, link: ZenohLink) -> None:
        self._link = link
        self._id = secrets.token_hex(4)
        self._tunnels = _Tunnels()
        """Their names begin with the id of the agent or manager at the other end."""
        self._numbers = count(1)
        for kind in _TUNNEL_OUT:
            link.hear(crossing.crossing_key(None, kind, MANAGER, f"*/{self._id}/*"), self._take)
        link.live(_client_key(self._id))

    def connect(self, host: str, life: str, wanted: str) -> socket.socket:
        """A socket that is connected to a topic of a host, or to CONTROL. If that does not exist, the socket ends at
        once.
        """
        ours, theirs = socket.socketpair()
        self.join(theirs, host, life, wanted)
        return ours

    def join(self, end: socket.socket, host: str, life: str, wanted: str) -> None:
        """Connect `end`, as `connect` does. The tunnel closes it."""
        number = next(self._numbers)
        name = f"{life}/{number}"
        keys = [crossing.crossing_key(MANAGER, kind, host, f"{life}/{self._id}/{number}") for kind in _TUNNEL_IN]
        tunnel = _Tunnel(lambda: _declared(self._link, *keys), lambda: self._tunnels.forget(name))
        self._tunnels.find(name, lambda: tunnel)
        tunnel.start(end, wanted)

    def lose(self, life: str) -> None:
        """Close the tunnels of an agent or manager that is gone."""
        self._tunnels.close(f"{life}/")

    def close(self) -> None:
        """Close all tunnels."""
        self._tunnels.close()

    def _take(self, key: str, head: bytes, payload: bytes) -> None:
        _, _, kind, _, life, _, number = key.split("/")
        tunnel = self._tunnels.find(f"{life}/{number}")
        if tunnel is not None:
            tunnel.take(kind == _TUNNEL_OUT[1], head, payload)


class RemoteTopics:
    """Shows topics of other computers in a run's folder, as if they were on this one. Each has a thread."""

    def __init__(self, client: TunnelClient, run: RunFolder) -> None:
        self._client, self._run = client, run
        self._listeners: dict[str, socket.socket] = {}

    def show(self, topic: str, host: str, life: str) -> None:
        """Show a topic of a host. Does nothing if no socket can be made for it."""
        self.hide(topic)
        with suppress(OSError):
            listener = self._listeners[topic] = self._run.listen(topic)
            arguments = (listener, topic, host, life)
            threading.Thread(target=self._accept, args=arguments, name="cfgplan-topic", daemon=True).start()

    def hide(self, topic: str) -> None:
        """Stop showing a topic."""
        self._run.forget(topic)
        if topic in self._listeners:
            listener = self._listeners.pop(topic)
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Hide all topics."""
        for topic in list(self._listeners):
            self.hide(topic)

    def _accept(self, listener: socket.socket, topic: str, host: str, life: str) -> None:
        with listener, suppress(OSError):
            while True:
                end, _ = listener.accept()
                self._client.join(end, host, life, topic)


def _declared(link: ZenohLink, data_key: str, credit_key: str) -> tuple[crossing.Put, crossing.Put]:
    """The publishers at the keys of a tunnel. The streams of the run overtake a tunnel's data."""
    return link.publisher(data_key, "large"), link.publisher(credit_key, "orders")


def _client_key(client: str) -> str:
    """The key under which a client is alive."""
    return f"{crossing.host_key(MANAGER)}/reaches/{client}"
