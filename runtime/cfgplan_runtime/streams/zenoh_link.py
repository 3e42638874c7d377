"""A computer's connection to the others of its fleet, over Zenoh.

What is put may be lost on the way: `crossing` sends it again.
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
"""What is put on an earlier lane overtakes what waits on a later one."""

_GIVE_UP: int | None = getattr(socket, "TCP_USER_TIMEOUT", None)
"""Linux has it; without it a link that is silently cut while data waits in it may be noticed late, or never."""
_WAITING = struct.Struct("@i")
_CAME, _CAME_AT = struct.Struct("@Q"), 128
"""How many bytes came, and where Linux has that number in what it tells of a TCP connection."""
_LOOKS = 4
"""It is looked after connections so often in a lease. A process that was stalled has looked once meanwhile."""
_LINK_CLOSE_S = 2.0
"""Zenoh may wait long for a peer that is gone when a session is closed."""
_OVERLAP_S = 0.5
"""Seconds until a session that has just been opened knows who hears it, and until what was put before has left."""


class _Declared:
    """The declarations in the present session."""

    def __init__(self, declare: Callable[[zenoh.Session], Any], session: zenoh.Session) -> None:
        self.declare, self.here = declare, declare(session)


class ZenohLink:
    """A session of its own, and at times a second one, through another computer, that is used in its place.

    Callbacks come from threads of Zenoh's. Raises InputError without Zenoh, or if it can't listen.
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
        """What stays declared until the link is closed; a publisher does until nobody has it any more."""
        self._is_closed = threading.Event()
        if _GIVE_UP is not None:
            lease_ms = config["transport"]["link"]["tx"]["lease"]
            threading.Thread(target=self._keep_sound, args=(lease_ms, _GIVE_UP), daemon=True).start()

    def _opened(self, config: Mapping[str, Any]) -> zenoh.Session:
        listen, connect = (config[way]["endpoints"] for way in ("listen", "connect"))
        self._ports |= _ports([*listen, *connect])
        try:
            return self._zenoh.open(self._zenoh.Config.from_json5(json.dumps(config)))
        except self._zenoh.ZError as error:
            if listen:
                raise InputError.of(f"can't listen on {', '.join(listen)}: {_first_line(error)}") from None
            mend = "see that one listens there, and that both have certificates of one authority, or none"
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
        """Declare everything in another session, then put there, and only then undeclare it in the one before."""
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

    def _keep_sound(self, lease_ms: int, option: int) -> None:
        """Have the connections given up of which nobody takes the data for a lease.

        At the other end it is the kernel that gives up: Zenoh closes a link only after what it has put into its socket.
        Of one that is silently cut, TLS would never be closed, and so nobody be told, and TCP would stop all other
        streams until it is mended.

        At this end we do: a session whose attempt to connect takes just as long as it may take (`open_timeout`) gives
        it up when the link is there already. The link then stays, but is never read: one computer hears nothing of the
        other, which hears it, and for good.
        """
        known: dict[tuple[object, object], Taken] = {}
        while not self._is_closed.wait(lease_ms / 1000 / _LOOKS):
            before, known = known, {}
            for connection in _connections(self._ports):
                with suppress(OSError):
                    connection.setsockopt(socket.IPPROTO_TCP, option, lease_ms)
                    ends = connection.getsockname(), connection.getpeername()
                    known[ends] = taken(connection, before.get(ends))
                    if known[ends].idle >= _LOOKS:
                        connection.shutdown(socket.SHUT_RDWR)

    def hear(self, keys: str, take: Callable[[str, bytes, bytes], None]) -> None:
        """Have everything that is put below `keys` told: its key, head and payload."""

        def tell(sample: zenoh.Sample) -> None:
            head = b"" if sample.attachment is None else sample.attachment.to_bytes()
            take(str(sample.key_expr), head, sample.payload.to_bytes())

        self._declare(lambda session: session.declare_subscriber(keys, tell))

    def watch(self, keys: str, tell: Callable[[str, bool], None]) -> None:
        """Have told which keys are, or become, alive (True) and which cease to be (False)."""
        put = self._zenoh.SampleKind.PUT

        def declare(session: zenoh.Session) -> object:
            def tell_used(sample: zenoh.Sample) -> None:
                if session is self._session:
                    tell(str(sample.key_expr), sample.kind == put)

            return session.liveliness().declare_subscriber(keys, tell_used, history=True)

        self._declare(declare)

    def live(self, key: str) -> None:
        """Be alive under a key until the link is closed or cut."""
        self._declare(lambda session: session.liveliness().declare_token(key))

    def give_signs(self, key: str, period_s: float, sign: Callable[[], bytes] = bytes) -> None:
        """Put a sign of life at a key again and again, until the link is closed."""
        put = self.publisher(key, "orders")

        def run() -> None:
            with suppress(RuntimeFaultError):  # it was closed
                while not self._is_closed.wait(period_s):
                    put(b"", sign())

        threading.Thread(target=run, daemon=True).start()

    def alive(self, keys: str, *, directly: bool = False) -> frozenset[str]:
        """The keys that are alive now; `directly`, as the session of its own knows them."""
        try:
            replies = (self._direct if directly else self._session).liveliness().get(keys)
        except self._zenoh.ZError:  # it was closed
            return frozenset()
        return frozenset(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def answer(self, key: str, give: Callable[[], bytes]) -> None:
        """Answer whoever asks at a key."""
        self._declare(lambda session: session.declare_queryable(key, lambda query: query.reply(key, give())))

    def ask(self, keys: str, timeout_s: float) -> Iterator[tuple[str, bytes]]:
        """What is answered at keys, until all have answered, the time is over, or the link is closed."""
        try:
            replies = self._session.get(keys, timeout=timeout_s)
        except self._zenoh.ZError:
            return
        for reply in replies:
            if reply.ok is not None:
                yield str(reply.ok.key_expr), reply.ok.payload.to_bytes()

    def publisher(self, key: str, lane: Lane) -> Callable[[bytes, bytes], None]:
        """A function that puts a head and a payload at a key.

        What has no room is dropped after 1 ms, if it is large after 50 ms. On the lane of small ones the function waits
        for room, which there is again after a lease at the latest.
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
    """Close a session; it is left to itself if it does not close in time."""
    thread = threading.Thread(target=session.close, daemon=True)
    thread.start()
    thread.join(_LINK_CLOSE_S)


class Taken(NamedTuple):
    """How many of the bytes that came to a connection were taken, and at how many looks in a row no more were though
    some wait.
    """

    bytes: int
    idle: int


def taken(connection: socket.socket, before: Taken | None) -> Taken:
    """What is taken of a TCP connection's data at this look, if that was so at the one before. Raises OSError."""
    (waiting,) = _WAITING.unpack(fcntl.ioctl(connection, termios.FIONREAD, bytes(_WAITING.size)))
    told = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _CAME_AT + _CAME.size)
    (came,) = _CAME.unpack_from(told, _CAME_AT)
    is_idle = before is not None and waiting and came - waiting == before.bytes
    return Taken(came - waiting, before.idle + 1 if before is not None and is_idle else 0)


def _ports(endpoints: Iterable[str]) -> frozenset[int]:
    """The TCP ports of endpoints such as tcp/192.168.1.5:7447."""
    found = (re.fullmatch(r"(?:tcp|tls)/.*:(\d+)", endpoint) for endpoint in endpoints)
    return frozenset(int(one[1]) for one in found if one is not None)


def _connections(ports: Collection[int]) -> Iterator[socket.socket]:
    """The TCP connections of this process to or from ports, each as a copy that is closed afterwards."""
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
    """Puts elements in a thread of its own, so that a full link stops nobody else."""

    def __init__(self, put: Callable[[bytes, bytes], None]) -> None:
        self._put = put
        self._waiting: SimpleQueue[tuple[bytes, bytes] | None] = SimpleQueue()
        threading.Thread(target=self._run, daemon=True).start()

    def give(self, head: bytes, payload: bytes) -> None:
        """Put it soon."""
        self._waiting.put((head, payload))

    def close(self) -> None:
        """End after the given elements."""
        self._waiting.put(None)

    def _run(self) -> None:
        while (given := self._waiting.get()) is not None:
            self._put(*given)
