"""A computer's connection to the others of its fleet, over Zenoh.

Messages may be lost on the way: `crossing` sends them again.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import socket
import stat
import struct
import termios
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias
from weakref import WeakSet

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan_runtime.errors import RuntimeFaultError

if TYPE_CHECKING:
    import zenoh

Lane: TypeAlias = Literal["orders", "small", "large"]
"""The priorities of messages, highest first."""

_GIVE_UP: int | None = getattr(socket, "TCP_USER_TIMEOUT", None)
"""An option of Linux; without it a silent cut may be noticed late, or never, if data waits in the link."""
_PACING: int | None = getattr(socket, "TCP_CONGESTION", None)
_PACED_BY_RATE = b"bbr"
"""The congestion control of Linux that measures a link's rate. The usual ones slow down at each lost packet."""
_WAITING = struct.Struct("@i")
_CAME, _CAME_AT = struct.Struct("@Q"), 128
"""The number of received bytes, and its offset in Linux's `tcp_info` of a connection."""
_RATE, _RATE_AT = struct.Struct("@Q"), 160
"""The bytes per second at which data was acknowledged last while the connection was full, in `tcp_info`."""
_UNSENT: int | None = getattr(socket, "TCP_NOTSENT_LOWAT", None)
_UNSENT_S, _LEAST_UNSENT = 0.02, 16_384
"""The seconds of a connection's rate whose bytes may wait in the kernel, and the least number of bytes: messages of a
higher priority overtake no data there. Without a limit it was 0.4 s over 5 Mbit/s.
"""
_COUNT, _ROUND_TRIP_AT, _RESENT_AT, _STALLED_AT = struct.Struct("@I"), 68, 100, 2
"""A number in `tcp_info`; the offsets of the round-trip time in microseconds, of the number of packets that were sent
again, and of the number of attempts since the last answer (one byte).
"""
LOSSY = 10
"""A link that loses packets may be silent this many times as long as others before it is closed. With 20 % lost and a
delay of 100 ms, TCP was silent for 8.2 s at most in 400 s, and a new link takes some seconds too.
"""
_ROUND_TRIPS = 20
"""Any link may be silent for this many round trips, up to the time of lossy ones."""
_LOSSES, _LOSSES_S = 4, 60.0
"""A peer's links lose packets if so many checks within these seconds saw packets sent again that have arrived."""
_LOOKS = 4
"""Checks of connections per lease. A process that was stalled has made one check meanwhile."""
_LINK_CLOSE_S = 2.0
"""The most seconds for closing a session: Zenoh may wait long for a peer that is gone."""
_OVERLAP_S = 0.5
"""Seconds until a new session knows its subscribers, and until earlier messages have left."""


class _Declared:
    """The declarations in the present session."""

    def __init__(self, declare: Callable[[zenoh.Session], Any], session: zenoh.Session) -> None:
        self.declare, self.here = declare, declare(session)


class ZenohLink:
    """A session, and at times a second one through another computer that replaces it.

    Callbacks run in Zenoh's threads. Raises InputError without Zenoh, or if it can't listen.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        needed("several computers", "zenoh")
        import zenoh

        self._zenoh = zenoh
        priority = zenoh.Priority
        self._priorities: dict[Lane, zenoh.Priority] = {
            "orders": priority.INTERACTIVE_HIGH,
            "small": priority.DATA_HIGH,
            "large": priority.DATA_LOW,
        }
        self._ports: frozenset[int] = frozenset()
        self._direct = self._session = self._opened(config)
        self._changing = threading.Lock()
        self._declared: WeakSet[_Declared] = WeakSet()
        self._kept: list[_Declared] = []
        """The declarations that last until the link is closed; a publisher's lasts as long as the publisher
        is in use.
        """
        self._is_closed = threading.Event()
        if _GIVE_UP is not None:
            lease_ms = config["transport"]["link"]["tx"]["lease"]
            threading.Thread(target=self._keep_sound, args=(lease_ms // LOSSY, _GIVE_UP), daemon=True).start()

    def _opened(self, config: Mapping[str, Any]) -> zenoh.Session:
        listen, connect = (config[way]["endpoints"] for way in ("listen", "connect"))
        self._ports |= _ports([*listen, *connect])
        try:
            return self._zenoh.open(self._zenoh.Config.from_json5(json.dumps(config)))
        except self._zenoh.ZError as error:
            if listen:
                raise InputError.of(f"can't listen on {', '.join(listen)}: {_first_line(error)}") from None
            mend = "check that an agent listens there, and that both have certificates of one authority, or none"
            raise InputError.of(f"no agent can be reached at {', '.join(connect)}", mend=mend) from None

    @property
    def id(self) -> str:
        """Zenoh's name of the session."""
        return str(self._direct.info.zid())

    @property
    def linked(self) -> frozenset[str]:
        """Zenoh's names of the sessions that are linked with this one."""
        return frozenset(map(str, self._direct.info.peers_zid()))

    def go_through(self, config: Mapping[str, Any]) -> None:
        """Use a session of this configuration from now on. Raises InputError if it can't be opened."""
        self._use(self._opened(config))

    def go_directly(self) -> None:
        """Undo `go_through`."""
        through = self._session
        self._use(self._direct)
        _close(through)

    def _use(self, session: zenoh.Session) -> None:
        """Declare everything in another session, then use it for messages, and only then undeclare everything in the
        one before.
        """
        with self._changing:
            if self._is_closed.is_set():
                _close(session)
                return
            self._session = session
            moved = [(one, one.here, one.declare(session)) for one in self._declared]
        self._is_closed.wait(_OVERLAP_S)
        for one, _, there in moved:
            one.here = there
        self._is_closed.wait(_OVERLAP_S)
        for _, before, _ in moved:
            with suppress(self._zenoh.ZError):  # its session was closed meanwhile
                before.undeclare()

    def _declare(self, declare: Callable[[zenoh.Session], Any], *, is_kept: bool = True) -> _Declared:
        with self._changing:
            declared = _Declared(declare, self._session)
            self._declared.add(declared)
            if is_kept:
                self._kept.append(declared)
        return declared

    def _keep_sound(self, silence_ms: int, option: int) -> None:
        """Close connections that have passed no data for `silence_ms`, at both ends; the sending end waits up to LOSSY
        times as long if a connection loses packets or has a long round trip.

        At the sending end the kernel closes them: Zenoh closes a link only after its socket has accepted all data. On a
        silently cut link TLS would never end, the loss would not be reported, and TCP would block all other streams
        until the link works again.

        At the receiving end this link closes them. A session that connects just within `open_timeout` may give up the
        attempt after the link was made. The link then stays but is never read: one computer gets nothing from the other
        for good, while the other gets its messages.
        """
        known: dict[tuple[object, object], Taken] = {}
        losses = Losses()
        while not self._is_closed.wait(silence_ms / 1000 / _LOOKS):
            before, known = known, {}
            for connection in _connections(self._ports):
                with suppress(OSError):
                    ends = connection.getsockname(), connection.getpeername()
                    is_lossy, round_trip_ms = losses.look(connection, time.monotonic())
                    patience_ms = LOSSY * silence_ms if is_lossy else _ROUND_TRIPS * round_trip_ms
                    patience_ms = min(max(silence_ms, patience_ms), LOSSY * silence_ms)
                    connection.setsockopt(socket.IPPROTO_TCP, option, patience_ms)
                    limit_unsent(connection)
                    if is_lossy and _PACING is not None:
                        with suppress(OSError):  # this kernel does not have it, or not for everyone
                            connection.setsockopt(socket.IPPROTO_TCP, _PACING, _PACED_BY_RATE)
                    known[ends] = taken(connection, before.get(ends))
                    if known[ends].idle >= _LOOKS:
                        connection.shutdown(socket.SHUT_RDWR)

    def hear(self, keys: str, take: Callable[[str, bytes, bytes], None]) -> None:
        """Call `take` with key, head and payload of every message below `keys`."""

        def tell(sample: zenoh.Sample) -> None:
            head = b"" if sample.attachment is None else sample.attachment.to_bytes()
            take(str(sample.key_expr), head, sample.payload.to_bytes())

        self._declare(lambda session: session.declare_subscriber(keys, tell))

    def watch(self, keys: str, tell: Callable[[str, bool], None]) -> None:
        """Call `tell` with each key that is or becomes alive (True), and with each that ceases to be (False)."""
        put = self._zenoh.SampleKind.PUT

        def declare(session: zenoh.Session) -> object:
            def tell_used(sample: zenoh.Sample) -> None:
                if session is self._session:
                    tell(str(sample.key_expr), sample.kind == put)

            return session.liveliness().declare_subscriber(keys, tell_used, history=True)

        self._declare(declare)

    def live(self, key: str) -> None:
        """Show others that this link is alive, by a key, until it is closed or cut."""
        self._declare(lambda session: session.liveliness().declare_token(key))

    def give_signs(self, key: str, period_s: float, sign: Callable[[], bytes] = bytes) -> None:
        """Put a sign of life at a key every `period_s` seconds, until the link is closed."""
        put = self.publisher(key, "orders")

        def run() -> None:
            with suppress(RuntimeFaultError):  # it was closed
                while not self._is_closed.wait(period_s):
                    put(b"", sign())

        threading.Thread(target=run, daemon=True).start()

    def alive(self, keys: str, *, directly: bool = False) -> frozenset[str]:
        """The keys that are alive now; with `directly`, as this link's first session knows them."""
        try:
            replies = (self._direct if directly else self._session).liveliness().get(keys)
        except self._zenoh.ZError:  # it was closed
            return frozenset()
        return frozenset(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def answer(self, key: str, give: Callable[[], bytes]) -> None:
        """Answer queries at a key."""
        self._declare(lambda session: session.declare_queryable(key, lambda query: query.reply(key, give())))

    def ask(self, keys: str, timeout_s: float) -> Iterator[tuple[str, bytes]]:
        """Yield (key, answer) for queries at `keys`, until all have answered, `timeout_s` seconds are over, or the link
        is closed.
        """
        try:
            replies = self._session.get(keys, timeout=timeout_s)
        except self._zenoh.ZError:
            return
        for reply in replies:
            if reply.ok is not None:
                yield str(reply.ok.key_expr), reply.ok.payload.to_bytes()

    def publisher(self, key: str, lane: Lane) -> Callable[[bytes, bytes], None]:
        """A function that puts a head and a payload at a key.

        Without room in the link, a message is dropped after 1 ms, or after 50 ms if it is sent in fragments. On the
        lane `small` the function waits for room instead, at most a lease.
        """
        congestion = self._zenoh.CongestionControl

        def declare(session: zenoh.Session) -> zenoh.Publisher:
            return session.declare_publisher(
                key,
                congestion_control=congestion.BLOCK if lane == "small" else congestion.DROP,
                priority=self._priorities[lane],
                express=False,  # else each takes a batch of its own, of which a lane has few
                reliability=self._zenoh.Reliability.RELIABLE,
            )

        publisher = self._declare(declare, is_kept=False)

        def put(head: bytes, payload: bytes) -> None:
            try:
                publisher.here.put(payload, attachment=head)
            except self._zenoh.ZError as error:
                raise RuntimeFaultError(f"{key}: {_first_line(error)}") from None

        return put

    def close(self) -> None:
        """Close all sessions."""
        with self._changing:
            self._is_closed.set()
        for session in {self._session, self._direct}:
            _close(session)


def _close(session: zenoh.Session) -> None:
    """Close a session; after `_LINK_CLOSE_S` seconds it is left to close by itself."""
    thread = threading.Thread(target=session.close, daemon=True)
    thread.start()
    thread.join(_LINK_CLOSE_S)


class Losses:
    """The packets that peers' connections have lost, as far as they were sent again and arrived."""

    def __init__(self) -> None:
        self._resent: dict[tuple[object, object], int] = {}
        self._seen: dict[object, deque[float]] = {}
        """By a peer's address: the times of checks that saw losses. New connections of the peer know them."""

    def look(self, connection: socket.socket, now_s: float) -> tuple[bool, int]:
        """Check a TCP connection. Returns whether its peer's connections lose packets, and its round-trip time in
        milliseconds. Raises OSError.
        """
        ends = connection.getsockname(), connection.getpeername()
        told = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RESENT_AT + _COUNT.size)
        (round_trip_us,), (resent,) = (_COUNT.unpack_from(told, at) for at in (_ROUND_TRIP_AT, _RESENT_AT))
        return self.note(ends, resent, now_s, is_stalled=told[_STALLED_AT] > 0), round_trip_us // 1000

    def note(self, ends: tuple[object, object], resent: int, now_s: float, *, is_stalled: bool) -> bool:
        """Note a connection's count of packets sent again. While it is stalled, as in a cut, they do not count."""
        peer = ends[1][0] if isinstance(ends[1], tuple) else ends[1]
        seen = self._seen.setdefault(peer, deque(maxlen=_LOSSES))
        if not is_stalled:
            if resent > self._resent.get(ends, 0):
                seen.append(now_s)
            self._resent[ends] = resent
        return len(seen) == _LOSSES and now_s - seen[0] < _LOSSES_S


class Taken(NamedTuple):
    """The bytes of a connection that were read, and the checks in a row at which no more were read though
    some waited.
    """

    bytes: int
    idle: int


def taken(connection: socket.socket, before: Taken | None) -> Taken:
    """Check a TCP connection, after the check `before`. Raises OSError."""
    (waiting,) = _WAITING.unpack(fcntl.ioctl(connection, termios.FIONREAD, bytes(_WAITING.size)))
    told = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _CAME_AT + _CAME.size)
    (came,) = _CAME.unpack_from(told, _CAME_AT)
    is_idle = before is not None and waiting and came - waiting == before.bytes
    return Taken(came - waiting, before.idle + 1 if before is not None and is_idle else 0)


def limit_unsent(connection: socket.socket) -> None:
    """Limit the bytes of a TCP connection that wait in the kernel for the first sending. Raises OSError."""
    if _UNSENT is not None:
        told = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RATE_AT + _RATE.size)
        (rate,) = _RATE.unpack_from(told, _RATE_AT) if len(told) >= _RATE_AT + _RATE.size else (0,)
        connection.setsockopt(socket.IPPROTO_TCP, _UNSENT, max(_LEAST_UNSENT, min(round(rate * _UNSENT_S), 1 << 30)))


def _ports(endpoints: Iterable[str]) -> frozenset[int]:
    """The TCP ports of endpoints such as tcp/192.168.1.5:7447."""
    found = (re.fullmatch(r"(?:tcp|tls)/.*:(\d+)", endpoint) for endpoint in endpoints)
    return frozenset(int(one[1]) for one in found if one is not None)


def _connections(ports: Collection[int]) -> Iterator[socket.socket]:
    """Yield the TCP connections of this process to or from ports, each as a copy that is closed afterwards."""
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            number = int(entry.name)
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as one:
                    is_tcp = one.family in (socket.AF_INET, socket.AF_INET6) and one.type == socket.SOCK_STREAM
                    if is_tcp and (one.getsockname()[1] in ports or one.getpeername()[1] in ports):
                        yield one


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]


class PutThread:
    """Puts elements in a thread of its own, so that a full link does not block the caller."""

    def __init__(self, put: Callable[[bytes, bytes], None]) -> None:
        self._put = put
        self._waiting: SimpleQueue[tuple[bytes, bytes] | None] = SimpleQueue()
        threading.Thread(target=self._run, daemon=True).start()

    def give(self, head: bytes, payload: bytes) -> None:
        """Queue a message for putting."""
        self._waiting.put((head, payload))

    def close(self) -> None:
        """End after the queued messages."""
        self._waiting.put(None)

    def _run(self) -> None:
        while (given := self._waiting.get()) is not None:
            self._put(*given)
