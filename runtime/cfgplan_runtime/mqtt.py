"""Unit code for MQTT: a source that subscribes to topics of a broker, and a sink that publishes what comes to it.

`source: cfgplan_runtime.mqtt:Subscriber` and `cfgplan_runtime.mqtt:Publisher`; the parameters are those of the classes.
Sessions are of MQTT 5. At `qos` 1 and 2 the broker keeps what comes while a connection is down, and a message counts as
taken only once its element was handed on; at `qos` 1 one may come twice. No password stands in an environment file:
`password_env` and `password_file` say where it is.
"""

from __future__ import annotations

import inspect
import json
import math
import os
import ssl
import sys
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args
from urllib.parse import urlsplit

from cfgplan.errors import CfgplanError, InputError, did_you_mean
from cfgplan.extras import needed
from cfgplan_runtime.errors import WrongPortsError

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

PayloadForm = Literal["json", "text", "number", "bytes"]
_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_LONGEST_S: Final = 65_535
"""The longest keepalive of MQTT, in seconds."""
_SESSION_S: Final = 300
"""Seconds for which the broker keeps a session whose connection is down."""
_MOST_UNTAKEN: Final = 100
"""The broker sends so many messages of `qos` 1 and 2 at most before the first is taken."""
_MOST_WAITING: Final = 10_000
"""So many messages wait at most: at a subscriber of `qos` 0, and at a publisher whose broker is away."""
_ORDERS_LOOK_S: Final = 0.05
"""A source that gets no messages looks for orders so often."""
_AGAIN_S: Final = (1, 5)
"""Seconds from a connection that failed to the next try: at first, and at most."""
_FIRST_S: Final = 2.0
"""Seconds that a publisher waits for its first connection."""
_FLUSH_S: Final = 1.5
_TAKEN: Final = (0, 4)
"""What the library says of a message that is sent, or waits for a connection."""
_REFUSED: Final = (134, 135, 138, 140)
"""Reason codes of MQTT 5 for a client that the broker does not let in, whatever it tries."""


class MqttRefusedError(CfgplanError):
    """A broker that lets nobody in with this name, password or certificate."""


class Connection:
    """A client of a broker, which connects again and again until it is closed.

    `broker` is `HOST`, `HOST:PORT`, `mqtt://HOST:PORT` or `mqtts://HOST:PORT` (TLS). `ca`, `certificate` and `key` are
    files of TLS; files are relative to the working folder. A connection on which nothing comes for one and a half times
    `keepalive` seconds counts as dead. With a `client_id` of its own a unit takes up the session of the one before, for
    which the broker keeps messages of `qos` 1 and 2 for 5 minutes; two must not run at a time. `say` is
    called with lines for the user. Raises InputError.
    """

    def __init__(
        self,
        broker: str,
        say: Callable[[str], None],
        *,
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
        from paho.mqtt.client import Client, MQTTv5
        from paho.mqtt.enums import CallbackAPIVersion

        address = _address(broker)
        self.name = f"{address.hostname}:{address.port}"
        self.refusal = ""
        """Why the broker lets nobody in; empty if it does, or was not reached yet."""
        self.away = ""
        """Why the broker is away, and is tried again; empty if it is there, or was not tried yet."""
        self.on_begin: Callable[[], None] = lambda: None
        """Called after each connection that begins."""
        self._host, self._port, self._keepalive = address.hostname or "", address.port or 0, keepalive
        self._say = say
        self.changed = threading.Condition()
        self.client: Client = Client(
            CallbackAPIVersion.VERSION2,
            client_id or f"cfgplan-{uuid.uuid4().hex[:16]}",
            protocol=MQTTv5,
            manual_ack=True,
        )
        self.client.max_queued_messages_set(_MOST_WAITING)
        self.client.reconnect_delay_set(*_AGAIN_S)
        if username is not None:
            self.client.username_pw_set(username, _password(password_env, password_file))
        if address.scheme == "mqtts" or ca is not None:
            self.client.tls_set_context(_context(ca, certificate, key))
        self.client.on_connect = self._begun
        self.client.on_connect_fail = lambda *_: self._tell_away(f"does not answer ({sys.exception()})")
        self.client.on_disconnect = self._ended

    def open(self, *, keeps_session: bool) -> None:
        """Begin to connect, in a thread."""
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        properties: Any = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.ReceiveMaximum = _MOST_UNTAKEN
        if keeps_session:
            properties.SessionExpiryInterval = _SESSION_S
        self.client.connect_async(
            self._host, self._port, self._keepalive, clean_start=not keeps_session, properties=properties
        )
        self.client.loop_start()

    def wait(self) -> None:
        """Wait for the first connection, for a moment. Raises MqttRefusedError."""
        with self.changed:
            self.changed.wait_for(lambda: self.client.is_connected() or self.refusal, _FIRST_S)
        self.check()

    def close(self) -> None:
        """Take leave of the broker, once: no last will is published."""
        client: Client | None = self.__dict__.pop("client", None)
        if client is None:
            return
        client.disconnect()
        client.loop_stop()
        # With its last reference the sockets go by which its thread was woken.
        client.on_connect = client.on_connect_fail = client.on_disconnect = None
        client.on_message = client.on_publish = None

    def check(self) -> None:
        """Raises MqttRefusedError if the broker lets nobody in."""
        if self.refusal:
            raise MqttRefusedError(f"{self.name}: {self.refusal}")

    def _begun(self, client: Client, _data: object, _flags: object, code: Any, _properties: object) -> None:
        if code.is_failure:
            if code.value in _REFUSED:
                with self.changed:
                    self.refusal = f"the broker refuses this client: {code}; see `username` and its password"
                    self.changed.notify_all()
                client.disconnect()
            else:
                self._tell_away(f"refuses the connection: {code}")
            return
        if self.away:
            self._say(f"{self.name} is there again")
        self.away = ""
        self.on_begin()
        with self.changed:
            self.changed.notify_all()

    def _ended(self, _client: Client, _data: object, _flags: object, code: Any, _properties: object) -> None:
        if code.is_failure and not self.refusal:
            self._tell_away(f"is lost: {code}")

    def _tell_away(self, what: str) -> None:
        """Tell once that the broker is away."""
        was_away, self.away = self.away, what
        if not was_away:
            self._say(f"the broker {self.name} {what}; it is tried again")


class Subscriber:
    """A source: gives the messages of `topic`, which may have the wildcards `+` and `#`.

    An element is the value that a message holds by `payload` (json, text, number or bytes), or what is in it at
    `field`: a key, or a list of those that lead to it. With wildcards, or if
    `with_topic` is true, a mapping with its `topic` and `value`. Messages that the broker has retained come first,
    unless `retained` is false. For the other parameters see `Connection`. Raises InputError, and MqttRefusedError when
    it runs.
    """

    def __init__(
        self,
        broker: str,
        topic: str,
        qos: int = 1,
        payload: PayloadForm = "json",
        retained: bool = True,
        with_topic: bool | None = None,
        field: str | list[str | int] | None = None,
        **connection: Any,
    ) -> None:
        check_parameters(qos, payload, connection)
        self._field = _path(field, payload)
        self._topic, self._qos, self._payload, self._retained = topic_filter(topic), qos, payload, retained
        self._with_topic = any(mark in topic for mark in "+#") if with_topic is None else with_topic
        self._waiting: deque[MQTTMessage] = deque()
        self._connections = 0
        """Numbers of messages begin anew with each connection: what an earlier one brought is confirmed no more."""
        self._dropped = 0
        self._told: set[str] = set()
        self._connection = Connection(broker, _say, **connection)
        self._connection.on_begin = self._subscribe
        self._connection.client.on_message = self._hear

    def __iter__(self) -> Iterator[Any]:
        connection = self._connection
        connection.open(keeps_session=self._qos > 0)
        try:
            while True:
                connections, message = self._next()
                connection.check()
                if message is None:
                    yield None
                    continue
                try:
                    value = _within(_decoded(bytes(message.payload), self._payload), self._field)
                except (ValueError, LookupError, RecursionError) as error:
                    self._tell_once(message.topic, error)
                else:
                    yield {"topic": message.topic, "value": value} if self._with_topic else value
                if connections == self._connections:
                    connection.client.ack(message.mid, message.qos)
        finally:
            connection.close()

    def _next(self) -> tuple[int, MQTTMessage | None]:
        changed = self._connection.changed
        with changed:
            changed.wait_for(lambda: self._waiting or self._connection.refusal, _ORDERS_LOOK_S)
            return self._connections, self._waiting.popleft() if self._waiting else None

    def _subscribe(self) -> None:
        from paho.mqtt.subscribeoptions import SubscribeOptions

        with self._connection.changed:
            self._connections += 1
            self._waiting = deque(message for message in self._waiting if message.qos == 0)  # the others come again
        handling = SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE if self._retained else SubscribeOptions.RETAIN_DO_NOT_SEND
        self._connection.client.subscribe(
            self._topic, options=SubscribeOptions(self._qos, retainAsPublished=True, retainHandling=handling)
        )

    def _hear(self, _client: Client, _data: object, message: MQTTMessage) -> None:
        with self._connection.changed:
            self._waiting.append(message)
            if message.qos == 0 and len(self._waiting) > _MOST_WAITING:
                self._waiting.popleft()
                self._dropped += 1
                if self._dropped == 1:
                    _say(f"{self._topic}: messages come faster than they are taken, and the oldest are dropped")
            self._connection.changed.notify_all()

    def _tell_once(self, topic: str, error: Exception) -> None:
        if topic not in self._told:
            self._told.add(topic)
            fault = "has no such field" if isinstance(error, LookupError) else f"is no {self._payload}"
            _say(f"{topic}: a message {fault}, and is left out: {error}")


class Publisher:
    """A sink: publishes each value that comes at its one input on `topic`, in the form that `payload` says.

    With `retain` the broker keeps the last one. `will` is published by the broker once this client is gone without a
    word: a mapping with `topic`, `payload` (a text) and, if wanted, `qos` and `retain`. While the broker is away 10,000
    messages wait. For the other parameters see `Connection`. Raises InputError, and MqttRefusedError when it runs.
    """

    def __init__(
        self,
        broker: str,
        topic: str,
        qos: int = 1,
        payload: PayloadForm = "json",
        retain: bool = False,
        will: Mapping[str, Any] | None = None,
        **connection: Any,
    ) -> None:
        check_parameters(qos, payload, connection)
        if not _is_plain(topic):
            raise InputError.of(f"`{topic}` is no topic to publish on", mend="it has no wildcards, and is not empty")
        if will is not None:
            _check_will(will)
        self._topic, self._qos, self._payload, self._retain = topic, qos, payload, retain
        self._lost = 0
        self._connection = Connection(broker, _say, **connection)
        if will is not None:
            client, kept = self._connection.client, will.get("retain", False)
            client.will_set(will["topic"], will.get("payload", ""), will.get("qos", 1), kept)
        self._unsent: set[int] = set()
        """The messages that the broker has not confirmed; of `qos` 0, that were not sent."""
        self._sent_early: set[int] = set()
        """Those that it has confirmed before `publish` has told their numbers."""
        self._connection.client.on_publish = self._sent
        self._connection.open(keeps_session=qos > 0)
        self._connection.wait()

    def __call__(self, **inputs: object) -> None:
        if len(inputs) != 1:
            raise WrongPortsError(f"a publisher has one input, not {len(inputs)}")
        (value,) = inputs.values()
        self._connection.check()
        payload = _encoded(value, self._payload)
        # The library calls `_sent` under a lock that `publish` takes too: no lock may be held here.
        info = self._connection.client.publish(self._topic, payload, self._qos, self._retain)
        if info.rc in _TAKEN:
            with self._connection.changed:
                if info.mid in self._sent_early:
                    self._sent_early.discard(info.mid)
                else:
                    self._unsent.add(info.mid)
            return
        self._lost += 1
        if self._lost == 1:
            _say(f"{self._topic}: {_MOST_WAITING} messages wait for {self._connection.name}; newer ones are lost")

    def close(self) -> None:
        """Wait a moment for what is under way, then take leave of the broker."""
        with self._connection.changed:
            self._connection.changed.wait_for(lambda: not self._unsent, _FLUSH_S)
        self._connection.close()

    def _sent(self, _client: Client, _data: object, number: int, _code: object, _properties: object) -> None:
        with self._connection.changed:
            if number in self._unsent:
                self._unsent.discard(number)
            else:
                self._sent_early.add(number)
            self._connection.changed.notify_all()


def _address(broker: str) -> Any:
    """A broker's address by its parts. Raises InputError."""
    mend = "write HOST, HOST:PORT, mqtt://HOST:PORT or mqtts://HOST:PORT"
    try:
        found = urlsplit(broker if "://" in broker else f"mqtt://{broker}")
        port = found.port
    except ValueError:
        raise InputError.of(f"`{broker}` is no broker", mend=mend) from None
    if found.scheme not in _PORTS or not found.hostname or found.path not in ("", "/"):
        raise InputError.of(f"`{broker}` is no broker", mend=mend)
    if found.password is not None or found.username is not None:
        mend = "remove it, and write `username` with `password_env` or `password_file`"
        raise InputError.of("the name and password of a broker do not belong into its address", mend=mend)
    if port is not None:
        return found
    return found._replace(netloc=f"{found.hostname}:{_PORTS[found.scheme]}")


def _password(variable: str | None, file: str | None) -> str | None:
    """The password that a variable of the environment or a file holds. Raises InputError."""
    if variable is not None:
        if variable not in os.environ:
            raise InputError.of(f"the variable {variable} is not set", mend="export it before the run")
        return os.environ[variable]
    if file is None:
        return None
    try:
        return Path(file).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError.of(f"the password can't be read: {error}", file=file) from None


def _context(ca: str | None, certificate: str | None, key: str | None) -> ssl.SSLContext:
    """What TLS is spoken by. Raises InputError."""
    try:
        context = ssl.create_default_context(cafile=ca)
        if certificate is not None:
            context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        what = "the files of TLS (`ca`, `certificate`, `key`) can't be used"
        raise InputError.of(f"{what}: {error}", mend="name files in PEM") from None
    return context


def check_parameters(qos: int, payload: str, connection: Mapping[str, Any]) -> None:
    """Raises InputError for parameters that no unit of MQTT can have."""
    if "password" in connection:
        mend = "write `password_env: VARIABLE` or `password_file: FILE`"
        raise InputError.of("a password does not belong into an environment file", mend=mend)
    known = [name for name in inspect.signature(Connection).parameters if name not in ("broker", "say")]
    for name in connection:
        if name not in known:
            there = did_you_mean(name, known, f"there are {', '.join(known)}")
            raise InputError.of(f"MQTT has no parameter `{name}`", mend=there)
    if connection.get("username") is None and {"password_env", "password_file"} & connection.keys():
        raise InputError.of("there is a password without a name", mend="write `username` too")
    if "keepalive" in connection and not 1 <= connection["keepalive"] <= _LONGEST_S:
        raise InputError.of(f"`{connection['keepalive']}` is no keepalive", mend=f"it is from 1 to {_LONGEST_S} s")
    if qos not in (0, 1, 2):
        raise InputError.of(f"`{qos}` is no quality of service of MQTT", mend="write 0, 1 or 2")
    if payload not in get_args(PayloadForm):
        raise InputError.of(
            f"`{payload}` is no form of a payload", mend=f"write one of {', '.join(get_args(PayloadForm))}"
        )


def topic_filter(topic: str) -> str:
    """A topic filter. Raises InputError."""
    levels = topic.split("/")
    is_right = bool(topic) and "\0" not in topic and all("+" not in level or level == "+" for level in levels)
    if not is_right or any("#" in level and (level != "#" or at < len(levels) - 1) for at, level in enumerate(levels)):
        mend = "`+` stands for one level, `#` for all levels that follow, each between slashes"
        raise InputError.of(f"`{topic}` is no filter of topics", mend=mend)
    return topic


def _is_plain(topic: object) -> bool:
    """Whether a message can be published on a topic."""
    return isinstance(topic, str) and topic != "" and not any(mark in topic for mark in "+#\0")


def _check_will(will: Mapping[str, Any]) -> None:
    """Raises InputError."""
    if not isinstance(will, Mapping) or set(will) - {"topic", "payload", "qos", "retain"}:
        raise InputError.of("`will` is a mapping with a topic", mend="it has topic, payload, qos and retain")
    if not _is_plain(will.get("topic")) or will.get("qos", 1) not in (0, 1, 2):
        mend = "write a topic without wildcards, and a qos of 0, 1 or 2"
        raise InputError.of("`will` has no topic to publish on, or no qos of MQTT", mend=mend)
    if not isinstance(will.get("payload", ""), str):
        raise InputError.of("the payload of `will` is a text", mend="write it in quotes")


def _decoded(payload: bytes, form: str) -> object:
    """The value that a payload holds. Raises ValueError."""
    match form:
        case "json":
            return json.loads(payload, parse_constant=_finite)
        case "number":
            return _finite(payload.decode())
        case "text":
            return payload.decode()
        case _:
            return payload


def _finite(text: str) -> float:
    """The number that a text is. Raises ValueError, also for NaN and infinite ones, which JSON does not have."""
    number = float(text)
    if not math.isfinite(number) or "_" in text:
        raise ValueError(f"{text} is no number")
    return number


def _path(field: object, payload: str) -> tuple[str | int, ...]:
    """The keys that lead to a field. Raises InputError."""
    if field is None:
        return ()
    keys = tuple(field) if isinstance(field, list) else (field,)
    if not keys or not all(isinstance(key, str | int) for key in keys):
        raise InputError.of(f"`{field}` is no field", mend="write a key, or a list of those that lead to it")
    if payload != "json":
        raise InputError.of(f"a message that is a {payload} has no fields", mend="write `payload: json`")
    return keys


def _within(value: Any, keys: tuple[str | int, ...]) -> object:
    """What is in a value where keys lead to. Raises LookupError."""
    for key in keys:
        try:
            value = value[key]
        except (LookupError, TypeError):
            raise LookupError(key) from None
    return value


def _encoded(value: object, form: str) -> bytes:
    match form:
        case "json":
            return json.dumps(value, default=_plain, allow_nan=False).encode()
        case "number" if isinstance(value, Real) and not math.isfinite(value):
            raise ValueError(f"{value} is no number, and is not published")
        case "bytes" if isinstance(value, bytes | bytearray | memoryview):
            return bytes(value)
        case _:
            return str(value).encode()


def _plain(value: Any) -> object:
    """What JSON takes in place of an array or a number of numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON: write `payload: text`")


def _say(text: str) -> None:
    """Report a line: the run shows each line that a unit prints."""
    print(text, flush=True)  # noqa: T201
