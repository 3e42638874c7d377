"""A unit's Zenoh session with routers and peers at endpoints; lost links are tried again."""

from __future__ import annotations

import inspect
import json
import os
import re
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from cfgplan.errors import Fault, InputError
from cfgplan.extras import is_there, needed
from cfgplan_runtime.outside.credentials import check_names, read_password

if TYPE_CHECKING:
    import zenoh

FIRST_S: Final = 2.0
"""Seconds for the first link: then its absence is reported, and publishers wait no longer."""
_RETRY_MS: Final = (500, 2000)
"""Milliseconds from a failed link to the next try: at first, and at most."""
_ENDPOINT: Final = re.compile(r"(tcp|tls|udp|quic|ws|serial|vsock|unixpipe|unixsock-stream)/\S+")


class ZenohUnitSession:
    """A session that connects to the endpoints of `connect` and accepts links at the endpoints of `listen`.

    An endpoint is `tcp/HOST:PORT`, `tls/HOST:PORT`, or of another protocol of Zenoh; one or a list. A session that only
    connects uses the first of its endpoints that answers, and another one if that one dies. `ca`,
    `certificate` and `key` are files of TLS, relative to the working folder. `say` is called with lines for the user:
    once if a session that connects has no link, and once if it has one again. Raises InputError.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        *,
        connect: str | list[str] | None = None,
        listen: str | list[str] | None = None,
        username: str | None = None,
        password_env: str | None = None,
        password_file: str | None = None,
        ca: str | None = None,
        certificate: str | None = None,
        key: str | None = None,
    ) -> None:
        needed("Zenoh units", "zenoh")
        self._connect, self._listen = _ways(connect, listen)
        self._say = say
        self._config = _config(self._connect, self._listen)
        if username is not None:
            password = read_password(password_env, password_file)
            self._config["transport"]["auth"] = {"usrpwd": {"user": username, "password": password}}
        if ca is not None or certificate is not None:
            self._config["transport"]["link"] = {"tls": _tls(ca, certificate, key)}
        self.on_open: Callable[[zenoh.Session], None] = lambda _: None
        """Called with the open session, to declare subscribers and publishers."""
        self._where = ", ".join(self._connect or self._listen)
        self._linked: set[str] = set()
        self._is_away = self._is_closed = False
        self._fault: InputError | None = None
        self._changed = threading.Condition()
        self._first = threading.Timer(FIRST_S, self._tell_first)
        self._first.daemon = True
        self._listener: object = None
        self._session: zenoh.Session | None = None

    def open(self) -> None:
        """Begin to open the session, in a thread: one that only connects is opened once it is linked."""
        threading.Thread(target=self._open, name="cfgplan-zenoh", daemon=True).start()
        if self._connect:
            self._first.start()

    def wait(self, timeout_s: float) -> None:
        """Wait for a link, at most `timeout_s` seconds. Raises InputError if the endpoints can't be used."""
        with self._changed:
            self._changed.wait_for(lambda: self._linked or self._fault, timeout_s)
        self.check()

    def check(self) -> None:
        """Raise InputError if the endpoints can't be used."""
        if self._fault is not None:
            raise self._fault

    def close(self) -> None:
        """End the session, once everything that was put has left."""
        self._first.cancel()
        with self._changed:
            self._is_closed = True
            session, self._session = self._session, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _open(self) -> None:
        import zenoh

        try:
            session = zenoh.open(zenoh.Config.from_json5(json.dumps(self._config)))
        except zenoh.ZError as error:
            self._refuse(error)
            return
        with self._changed:
            is_late = self._is_closed
            self._session = None if is_late else session
        if is_late:
            session.close()  # type: ignore[no-untyped-call]
            return
        put = zenoh.SampleKind.PUT
        with suppress(zenoh.ZError):  # it was closed meanwhile
            self.on_open(session)
            self._listener = session.info.declare_transport_events_listener(
                lambda event: self._note(str(event.transport.zid), is_linked=event.kind == put), history=True
            )

    def _refuse(self, error: Exception) -> None:
        mend = "see that the endpoints are right, that nothing else listens there, and that files of TLS are in PEM"
        with self._changed:
            what = f"no session of Zenoh can be opened with {self._where}: {plain(error)}"
            self._fault = InputError([Fault(what, mend=mend)])
            self._changed.notify_all()
        self._first.cancel()

    def _note(self, peer: str, *, is_linked: bool) -> None:
        with self._changed:
            (self._linked.add if is_linked else self._linked.discard)(peer)
            self._changed.notify_all()
        if is_linked:
            if self._is_away:
                self._say(f"the Zenoh peer at {self._where} is linked again")
            self._is_away = False
        elif not self._linked:
            self._tell_away("is lost")

    def _tell_first(self) -> None:
        if not self._linked:
            self._tell_away("does not answer, or does not let this session in")

    def _tell_away(self, what: str) -> None:
        """Report once that the session has no link."""
        if not self._connect or self._is_away or self._is_closed:
            return
        self._is_away = True
        self._say(f"the Zenoh peer at {self._where} {what}; it is tried again")


def check_parameters(session: Mapping[str, Any]) -> None:
    """Raise InputError for parameters that no session can have."""
    check_names("Zenoh", parameters(), session)


def check_endpoints(params: Mapping[str, Any]) -> None:
    """Raise InputError if `connect` and `listen` name no endpoint, or one that Zenoh does not know."""
    _ways(params.get("connect"), params.get("listen"))


def parameters() -> list[str]:
    """Return the names of a session's parameters."""
    return list(inspect.signature(ZenohUnitSession).parameters)[1:]


def key_expression(text: str, *, is_plain: bool = False) -> str:
    """A key expression in its canonical form; if it has to be plain, one without wildcards. Raises InputError.

    Where Zenoh is not installed, nothing but wildcards is checked, and the text is returned.
    """
    if is_plain and isinstance(text, str) and "*" in text:
        raise InputError.of(f"`{text}` can't be published to", mend="write a key without wildcards")
    if not is_there("zenoh"):
        return text
    import zenoh

    try:
        return str(zenoh.KeyExpr.autocanonize(text))
    except (zenoh.ZError, TypeError) as error:
        mend = "write chunks with slashes between; `*` stands for one chunk, `**` for any number of them"
        raise InputError.of(f"`{text}` is not a key expression: {plain(error)}", mend=mend) from None


def plain(error: Exception) -> str:
    """Return an error's text without the place in Zenoh's source."""
    with suppress(ValueError):
        return str(error)[: str(error).index(" at /")]
    return str(error).strip().partition("\n")[0].rstrip(".")


def _ways(connect: str | list[str] | None, listen: str | list[str] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the endpoints to connect to, and those to listen at. Raises InputError if there are none."""
    found = _endpoints(connect), _endpoints(listen)
    if not any(found):
        mend = "write `connect: tcp/HOST:7447` for a router or peer, or `listen`"
        raise InputError.of("a Zenoh session needs an endpoint", mend=mend)
    return found


def _endpoints(said: str | list[str] | None) -> tuple[str, ...]:
    """Endpoints as they are said. Raises InputError."""
    found = () if said is None else tuple(said) if isinstance(said, list) else (said,)
    for each in found:
        if not isinstance(each, str) or _ENDPOINT.fullmatch(each) is None:
            raise InputError.of(f"`{each}` is not an endpoint of Zenoh", mend="write tcp/HOST:PORT or tls/HOST:PORT")
    return found


def _config(connect: tuple[str, ...], listen: tuple[str, ...]) -> dict[str, Any]:
    first_ms, longest_ms = _RETRY_MS
    return {
        "mode": "peer" if listen else "client",  # of two peers a router thinks that they are linked with one another
        "connect": {
            "endpoints": connect,
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": first_ms, "period_max_ms": longest_ms},
        },
        "listen": {"endpoints": listen},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {},
    }


def _tls(ca: str | None, certificate: str | None, key: str | None) -> dict[str, object]:
    """Zenoh's `transport/link/tls`. Raises InputError."""
    for file in (ca, certificate, key):
        if file is not None and not os.access(file, os.R_OK):
            raise InputError.of("the file of TLS can't be read", file=file, mend="name a file in PEM")
    found: dict[str, object] = {} if ca is None else {"root_ca_certificate": ca}
    if certificate is not None:
        for way in ("connect", "listen"):
            found |= {f"{way}_certificate": certificate, f"{way}_private_key": key}
    return found
