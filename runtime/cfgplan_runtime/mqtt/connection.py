"""A connection to an MQTT 5 broker that reconnects by itself, and the messages that wait for it."""

from __future__ import annotations

import hashlib
import inspect
import os
import ssl
import sys
import threading
import uuid
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from cfgplan.errors import CfgplanError, InputError
from cfgplan.extras import needed
from cfgplan_runtime.children.unit_code import UNIT_VARIABLE
from cfgplan_runtime.outside.credentials import check_names, read_password
from cfgplan_runtime.outside.units import words_of

if TYPE_CHECKING:
    from paho.mqtt.client import Client
    from paho.mqtt.reasoncodes import ReasonCode

MOST_WAITING: Final = 10_000
"""So many messages wait at most: at a subscriber of `qos` 0, and at a publisher whose broker is away."""
_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_HERE: Final = "localhost"
_NAMES_OF_HERE: Final = ("localhost", "127.0.0.1", "::1")
_LONGEST_S: Final = 65_535
"""The longest keepalive of MQTT, in seconds."""
_SESSION_S: Final = 300
"""Seconds for which the broker keeps a session whose connection is down."""
_MOST_UNTAKEN: Final = 100
"""The broker sends so many messages of `qos` 1 and 2 at most before the first is taken."""
_AGAIN_S: Final = (1, 5)
"""Seconds from a connection that failed to the next try: at first, and at most."""
_FLUSH_S: Final = 1.5
_TAKEN: Final = (0, 4)
"""Result codes of the library for a message that is sent, or waits for a connection."""
_REFUSED: Final = (134, 135, 138, 140)
"""Reason codes of MQTT 5 for a client that the broker does not let in, whatever it tries."""
_TAKEN_OVER: Final = 142
"""The reason code of MQTT 5 for a client whose session another one of its name has taken up."""


class MqttRefusedError(CfgplanError):
    """The broker refuses this name, password or certificate."""


class Connection:
    """A client of a broker, which connects again and again until it is closed.

    `broker` is `HOST`, `HOST:PORT`, `mqtt://HOST:PORT` or `mqtts://HOST:PORT` (TLS). `ca`, `certificate` and `key` are
    files of TLS; files are relative to the working folder. A connection on which nothing comes for one and a half times
    `keepalive` seconds counts as dead. The broker keeps messages of `qos` 1 and 2 for a session for 5 minutes. A unit
    that replaces one that died has its name, and so takes up its session; a session ends with a unit that is stopped.
    With a `client_id` the next unit of that id takes up the session in any case. Two clients of one id must not run at
    a time. `will` is published by the broker if this client is gone without a word. `say` is called with lines for the
    user. Raises InputError.
    """

    def __init__(
        self,
        broker: str,
        say: Callable[[str], None],
        *,
        will: Mapping[str, Any] | None = None,
        client_id: str | None = None,
        username: str | None = None,
        password_env: str | None = None,
        password_file: str | None = None,
        ca: str | None = None,
        certificate: str | None = None,
        key: str | None = None,
        keepalive: int = 10,
    ) -> None:
        needed("MQTT units", "paho")
        address = _address(broker)
        self.name = f"{address.hostname}:{address.port}"
        self.refusal = ""
        """Why the broker refuses this client; empty if it accepts it, or was not reached yet."""
        self.away = ""
        """Why the broker is away, and is tried again; empty if it is there, or was not tried yet."""
        self.is_taken_over = False
        """Whether another client of this id has taken up the session."""
        self.on_begin: Callable[[], None] = lambda: None
        """Called after each connection that begins."""
        self.on_refused: Callable[[], None] = lambda: None
        """Called when the broker refuses this client."""
        self.on_message: Any = None
        self.on_publish: Any = None
        self.on_subscribe: Any = None
        """Callbacks of the library."""
        self._host, self._port, self._keepalive = address.hostname or "", address.port or 0, keepalive
        self._say = say
        self.changed = threading.Condition()
        self._id, self._will = client_id, will
        self._login = None if username is None else (username, read_password(password_env, password_file))
        self._tls = _context(ca, certificate, key) if address.scheme == "mqtts" or ca is not None else None
        self._client: Client | None = None

    @property
    def client(self) -> Client:
        """The library's client, once the connection is open."""
        assert self._client is not None
        return self._client

    def open(self, *, keeps_session: bool) -> None:
        """Begin to connect, in a thread."""
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        self._client = self._made()
        properties: Any = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.ReceiveMaximum = _MOST_UNTAKEN
        if keeps_session:
            properties.SessionExpiryInterval = _SESSION_S
        self.client.connect_async(
            self._host, self._port, self._keepalive, clean_start=not keeps_session, properties=properties
        )
        self.client.loop_start()

    def _made(self) -> Client:
        from paho.mqtt.client import Client, MQTTv5
        from paho.mqtt.enums import CallbackAPIVersion

        client_id = self._id or _id_of_unit()
        client = Client(CallbackAPIVersion.VERSION2, client_id, protocol=MQTTv5, manual_ack=True)
        client.max_queued_messages_set(MOST_WAITING)
        client.reconnect_delay_set(*_AGAIN_S)
        if self._login is not None:
            client.username_pw_set(*self._login)
        if self._tls is not None:
            client.tls_set_context(self._tls)
        if (will := self._will) is not None:
            client.will_set(will["topic"], will.get("payload", ""), will.get("qos", 1), will.get("retain", False))
        client.on_connect = self._begun
        client.on_connect_fail = lambda *_: self._tell_away(f"does not answer ({words_of(sys.exception())})")
        client.on_disconnect = self._ended
        client.on_message, client.on_publish, client.on_subscribe = self.on_message, self.on_publish, self.on_subscribe
        return client

    def wait(self, timeout_s: float) -> None:
        """Wait for the first connection, at most so long. Raises MqttRefusedError."""
        with self.changed:
            self.changed.wait_for(lambda: self.client.is_connected() or self.refusal, timeout_s)
        self.check()

    def close(self, *, with_will: bool = False) -> None:
        """Take leave of the broker, once. The last will is published only `with_will`."""
        client = self._client
        if client is None:
            return
        client.disconnect(_with_will() if with_will else None, None if self._id is not None else _no_longer())
        client.loop_stop()
        # With its last reference the sockets go by which its thread was woken.
        client.on_connect = client.on_connect_fail = client.on_disconnect = None
        client.on_message = client.on_publish = client.on_subscribe = None
        self._client = None

    def check(self) -> None:
        """Raise MqttRefusedError if the broker refuses this client."""
        if self.refusal:
            raise MqttRefusedError(f"{self.name}: {self.refusal}")

    def _begun(self, client: Client, _data: object, _flags: object, code: Any, _properties: object) -> None:
        if code.is_failure:
            if code.value in _REFUSED:
                self._refuse(client, f"the broker refuses this client: {code}; see `username` and its password")
            else:
                self._tell_away(f"refuses the connection: {code}")
            return
        if self.away:
            self._say(f"{self.name} is connected again")
        self.away = ""
        self.on_begin()
        with self.changed:
            self.changed.notify_all()

    def _ended(self, client: Client, _data: object, _flags: object, code: Any, _properties: object) -> None:
        if code.value == _TAKEN_OVER:
            self.is_taken_over = True
            self._refuse(client, "another client of this id has taken up the session")
            self._say(f"{self.name}: {self.refusal}; this one is silent from now on")
        elif code.is_failure and not self.refusal:
            self._tell_away(f"is lost: {code}")

    def _refuse(self, client: Client, refusal: str) -> None:
        with self.changed:
            self.refusal = refusal
            self.changed.notify_all()
        client.disconnect()
        self.on_refused()

    def _tell_away(self, what: str) -> None:
        """Tell once that the broker is away."""
        was_away, self.away = self.away, what
        if not was_away:
            self._say(f"the broker {self.name} {what}; it is tried again")


class Outbox:
    """The messages on their way to a broker, those included that wait for a connection."""

    def __init__(self, connection: Connection, say: Callable[[str], None]) -> None:
        self._connection, self._say = connection, say
        self._unsent: set[int] = set()
        """The messages that the broker has not confirmed; of `qos` 0, that were not sent."""
        self._sent_early: set[int] = set()
        """Those that it has confirmed before `publish` has told their numbers."""
        self._lost = 0
        connection.on_publish = self._sent

    def put(self, topic: str, payload: bytes, qos: int, *, retain: bool) -> None:
        """Publish a message, without waiting. Raises MqttRefusedError."""
        self._connection.check()
        # The library calls `_sent` under a lock that `publish` takes too: no lock may be held here.
        info = self._connection.client.publish(topic, payload, qos, retain)
        if info.rc in _TAKEN:
            with self._connection.changed:
                if info.mid in self._sent_early:
                    self._sent_early.discard(info.mid)
                else:
                    self._unsent.add(info.mid)
            return
        self._lost += 1
        if self._lost == 1:
            self._say(f"{topic}: {MOST_WAITING} messages wait for {self._connection.name}; newer ones are lost")

    def flush(self) -> None:
        """Wait until all messages have left, a moment at most."""
        with self._connection.changed:
            self._connection.changed.wait_for(lambda: not self._unsent, _FLUSH_S)

    def _sent(self, _client: Client, _data: object, number: int, _code: object, _properties: object) -> None:
        with self._connection.changed:
            if number in self._unsent:
                self._unsent.discard(number)
            else:
                self._sent_early.add(number)
            self._connection.changed.notify_all()


def _id_of_unit() -> str:
    """A client id that the unit of a run has in each of its processes; a random one outside of units.

    23 letters and digits, as every broker has to take it.
    """
    unit = os.environ.get(UNIT_VARIABLE)
    word = uuid.uuid4().hex if unit is None else hashlib.sha256(unit.encode()).hexdigest()
    return f"cfgplan{word[:16]}"


def _with_will() -> ReasonCode:
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.reasoncodes import ReasonCode

    return ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message")


def _no_longer() -> Any:
    """Properties with which the broker forgets a session."""
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    properties: Any = Properties(PacketTypes.DISCONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = 0
    return properties


def parameters() -> list[str]:
    """Return the names of a connection's parameters, except for the broker and those that units set themselves."""
    return [name for name in inspect.signature(Connection).parameters if name not in ("broker", "say", "will")]


def check_broker(broker: str) -> None:
    """Raise InputError if this is not the address of a broker."""
    _address(broker)


def is_same_broker(one: str, other: str) -> bool:
    """Return whether two addresses have the same host and port; False if one of them is not an address."""
    try:
        first, second = _address(one), _address(other)
    except InputError:
        return False
    hosts = [_HERE if found.hostname in _NAMES_OF_HERE else found.hostname for found in (first, second)]
    return (hosts[0], first.port) == (hosts[1], second.port)


def _address(broker: str) -> Any:
    """A broker's address by its parts. Raises InputError."""
    mend = "write HOST, HOST:PORT, mqtt://HOST:PORT or mqtts://HOST:PORT"
    try:
        found = urlsplit(broker if "://" in broker else f"mqtt://{broker}")
        port = found.port
    except ValueError:
        raise InputError.of(f"`{broker}` is not the address of a broker", mend=mend) from None
    if found.scheme not in _PORTS or not found.hostname or found.path not in ("", "/"):
        raise InputError.of(f"`{broker}` is not the address of a broker", mend=mend)
    if found.password is not None or found.username is not None:
        mend = "remove it, and write `username` with `password_env` or `password_file`"
        raise InputError.of("the address of a broker can't hold the name and password", mend=mend)
    if port is not None:
        return found
    host = f"[{found.hostname}]" if ":" in found.hostname else found.hostname
    return found._replace(netloc=f"{host}:{_PORTS[found.scheme]}")


def _context(ca: str | None, certificate: str | None, key: str | None) -> ssl.SSLContext:
    """Return the context of TLS. Raises InputError."""
    try:
        context = ssl.create_default_context(cafile=ca)
        if certificate is not None:
            context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        what = "the files of TLS (`ca`, `certificate`, `key`) can't be used"
        raise InputError.of(f"{what}: {error}", mend="name files in PEM") from None
    return context


def check_parameters(connection: Mapping[str, Any]) -> None:
    """Raise InputError for parameters that no connection can have."""
    check_names("MQTT", parameters(), connection)
    keepalive = connection.get("keepalive", 1)
    if not isinstance(keepalive, int) or not 1 <= keepalive <= _LONGEST_S:
        raise InputError.of(f"`{keepalive}` can't be a keepalive", mend=f"it is from 1 to {_LONGEST_S} s")
