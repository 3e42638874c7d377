"""Unit code for MQTT: a source that subscribes to topics of a broker, and a sink that publishes its input."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from cfgplan.errors import InputError
from cfgplan_runtime.mqtt.connection import (
    MOST_WAITING,
    Connection,
    Outbox,
    check_broker,
    check_parameters,
    parameters,
)
from cfgplan_runtime.mqtt.topics import check_will, plain_topic, topic_filter
from cfgplan_runtime.outside.payload_forms import PayloadForm, PayloadReader, check_form, encoded
from cfgplan_runtime.outside.units import ORDERS_LOOK_S, check_call, only_value, say

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

_FIRST_S: Final = 2.0
"""Seconds that a publisher waits for its first connection."""


class Subscriber:
    """A source: gives the messages of `topic`, which may have the wildcards `+` and `#`.

    `payload` is the form of messages (json, text, number or bytes). An element is the value of a message, or of its
    `field`: a key of JSON, or a list of keys that lead further in. With wildcards, or if `with_topic` is true, an
    element is a mapping with `topic` and `value`. Messages that the broker has retained come first, unless `retained`
    is false. For the other parameters see `Connection`. Raises InputError, and MqttRefusedError when
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
        _check_qos(qos)
        check_parameters(connection)
        self._reader = PayloadReader(payload, field, say)
        self._topic, self._qos, self._retained = topic_filter(topic), qos, retained
        self._with_topic = any(mark in topic for mark in "+#") if with_topic is None else with_topic
        self._waiting: deque[MQTTMessage] = deque()
        self._connections = 0
        """Numbers of messages start again with each connection: what an earlier one brought is confirmed no more."""
        self._dropped = 0
        self._connection = Connection(broker, say, **connection)
        self._connection.on_begin = self._subscribe
        self._connection.on_message = self._hear

    @classmethod
    def check_params(cls, params: Mapping[str, Any]) -> None:
        """Raise InputError for params with which no unit can be constructed. Connects to nothing."""
        _check_params(cls, params)
        topic_filter(params["topic"])

    def __iter__(self) -> Iterator[Any]:
        connection = self._connection
        connection.open(keeps_session=self._qos > 0)
        try:
            while True:
                connections, message = self._next()
                if (
                    not connection.is_taken_over
                ):  # whoever has taken over gives the elements; this unit is to be stopped
                    connection.check()
                if message is None:
                    yield None
                    continue
                for value in self._reader.values(message.topic, bytes(message.payload)):
                    yield {"topic": message.topic, "value": value} if self._with_topic else value
                if connections == self._connections:
                    connection.client.ack(message.mid, message.qos)
        finally:
            connection.close()

    def _next(self) -> tuple[int, MQTTMessage | None]:
        changed, connection = self._connection.changed, self._connection
        with changed:
            changed.wait_for(
                lambda: self._waiting or (connection.refusal and not connection.is_taken_over), ORDERS_LOOK_S
            )
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
            if message.qos == 0 and len(self._waiting) > MOST_WAITING:
                self._waiting.popleft()
                self._dropped += 1
                if self._dropped == 1:
                    say(f"{self._topic}: messages come faster than they are taken, and the oldest are dropped")
            self._connection.changed.notify_all()


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
        _check_qos(qos)
        check_parameters(connection)
        check_form(payload)
        if will is not None:
            check_will(will)
        self._topic, self._qos, self._payload, self._retain = plain_topic(topic), qos, payload, retain
        self._connection = Connection(broker, say, will=will, **connection)
        self._outbox = Outbox(self._connection, say)
        self._connection.open(keeps_session=qos > 0)
        self._connection.wait(_FIRST_S)

    @classmethod
    def check_params(cls, params: Mapping[str, Any]) -> None:
        """Raise InputError for params with which no unit can be constructed. Connects to nothing."""
        _check_params(cls, params)
        plain_topic(params["topic"])

    def __call__(self, **inputs: object) -> None:
        self._outbox.put(self._topic, encoded(only_value(inputs), self._payload), self._qos, retain=self._retain)

    def close(self) -> None:
        """Wait up to 1.5 s for unconfirmed messages, then disconnect."""
        self._outbox.flush()
        self._connection.close()


def _check_params(kind: type[Subscriber | Publisher], params: Mapping[str, Any]) -> None:
    check_call(kind, "MQTT", parameters(), params)
    check_parameters({name: params[name] for name in parameters() if name in params})
    if params.get("will") is not None:
        check_will(params["will"])
    check_broker(params["broker"])
    _check_qos(params.get("qos", 1))


def _check_qos(qos: int) -> None:
    """Raise InputError."""
    if qos not in (0, 1, 2):
        raise InputError.of(f"`{qos}` is not a quality of service of MQTT", mend="write 0, 1 or 2")
