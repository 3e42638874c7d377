"""The targets of a run as topics of a broker, in JSON, and a topic with the status of the run."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

from cfgplan.domain import Environment, Target
from cfgplan.errors import Fault, InputError
from cfgplan_runtime.mqtt.connection import (
    Connection,
    MqttRefusedError,
    Outbox,
    check_parameters,
    is_same_broker,
)
from cfgplan_runtime.mqtt.topics import plain_topic
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.outside.payload_forms import encoded
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode

_QOS: Final = 1
_ONLINE, _OFFLINE = b"online", "offline"
_SHARED: Final = re.compile(r"^\$share/[^/]+/")
"""Begins the filter of a subscription that several clients share."""
_ALL: Final = ("#", "+/#")
"""The filters of all topics."""
_SUBSCRIBERS: Final = ("cfgplan_runtime.mqtt:Subscriber", "cfgplan_runtime.mqtt.units:Subscriber")


class MqttTargets:
    """Publishes the stream of each target under the target's topic; with `retain` the broker keeps each last value.

    The topic `status` holds `online` during the run and `offline` after it, by the last will too; the broker keeps it.
    For the other parameters see `Connection`. Raises InputError; `tell` is called with later faults, such as a broker
    that is away.
    """

    def __init__(
        self, broker: str, tell: Callable[[str], None], *, status: str, retain: bool = False, **connection: Any
    ) -> None:
        check_parameters(connection)
        self._broker, self._status, self._retain = broker, plain_topic(status), retain
        self._once = Once(tell)
        will = {"topic": status, "payload": _OFFLINE, "qos": _QOS, "retain": True}
        self._connection = Connection(broker, tell, will=will, **connection)
        self._connection.on_begin = self._say_online
        self._connection.on_refused = self._tell_refused
        self._outbox = Outbox(self._connection, tell)

    def open(self) -> None:
        """Begin to connect. Nothing waits for the broker."""
        self._connection.open(keeps_session=True)

    def wanted(self, environment: Environment) -> tuple[Target, ...]:
        """All targets with a topic to which no source of the run subscribes; the others are reported."""
        wanted = []
        for target in environment.stream_targets:
            try:
                _check_unheard(target, environment, self._broker)
            except InputError as error:
                self._refuse(target, error)
            else:
                wanted.append(target)
        return tuple(wanted)

    def begin(self, target: Target) -> bool:
        """Report a target that can't be published. Returns whether it can."""
        try:
            plain_topic(target.topic)
        except InputError as error:
            self._refuse(target, error)
            return False
        return True

    def end(self, target: Target) -> None:
        """Do nothing: MQTT's topics are not announced."""

    def put(self, topic: str, element: Element) -> None:
        """Publish an element."""
        try:
            self._outbox.put(topic, encoded(decode(element.payload)), _QOS, retain=self._retain)
        except MqttRefusedError:
            pass  # it is told when it happens
        except (TypeError, ValueError, RecursionError) as error:
            self._once.tell(topic, f"{topic}: a value is not published at the broker: {error}")

    def close(self) -> None:
        """Wait up to 1.5 s for unconfirmed messages, then disconnect; the broker publishes the last will."""
        if not (self._connection.away or self._connection.refusal):
            self._outbox.flush()
        self._connection.close(with_will=True)

    def _say_online(self) -> None:
        # Quality 0 goes out before all that has waited.
        self._outbox.put(self._status, _ONLINE, 0, retain=True)

    def _refuse(self, target: Target, error: InputError) -> None:
        said = f"{target.label} is not published at the broker: {error.faults[0].message}"
        self._once.tell(f"{target.topic} is refused", said)

    def _tell_refused(self) -> None:
        name, refusal = self._connection.name, self._connection.refusal
        self._once.tell("refused", f"{name}: {refusal}; targets are not published there")


def check_targets(environment: Environment, broker: str) -> None:
    """Raise InputError for targets that can't be published at a broker."""
    faults = list[Fault]()
    for target in environment.stream_targets:
        try:
            plain_topic(target.topic)
            _check_unheard(target, environment, broker)
        except InputError as error:
            faults += (Fault(f"target {target.label}: {fault.message}", mend=fault.mend) for fault in error.faults)
    if faults:
        raise InputError(faults)


def _check_unheard(target: Target, environment: Environment, broker: str) -> None:
    """Raise InputError if a source of the run subscribes to a target's topic at the broker."""
    from paho.mqtt.client import topic_matches_sub

    topic = target.topic
    for label, heard in _heard(environment, broker):
        if topic_matches_sub(heard, topic):
            echo = f"{label} subscribes to {heard} there: the run would receive its own values, and publish them again"
            mend = f"choose another topic, such as `topic: cfgplan/{topic.strip('/') or target.label}`"
            raise InputError.of(f"the topic {topic} can't be published at {broker}, since {echo}", mend=mend)


def _heard(environment: Environment, broker: str) -> Iterator[tuple[str, str]]:
    """Yield the label and the topic filter of each source that subscribes at a broker."""
    for transformation in environment.library:
        params = transformation.params
        topic, there = params.get("topic"), params.get("broker")
        if transformation.source not in _SUBSCRIBERS or not isinstance(topic, str) or not isinstance(there, str):
            continue
        heard = _SHARED.sub("", topic)
        if heard not in _ALL and is_same_broker(there, broker):  # no topic is out of their reach
            yield transformation.label, heard
