"""Listening to a broker for a while, retained messages included."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from cfgplan.errors import InputError
from cfgplan.mqtt.discovery import DISCOVERY
from cfgplan.mqtt.traffic import Traffic, TrafficCollector
from cfgplan.summary import some
from cfgplan_runtime.mqtt.connection import Connection, check_parameters
from cfgplan_runtime.mqtt.topics import topic_filter

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

_ANSWER_S: Final = 10.0
"""Seconds in which a broker has to accept the client."""
_LOOK_S: Final = 0.05


class Listening:
    """Collects the messages on topics of a broker, and the discovery messages that it keeps.

    It neither publishes nor confirms, so that other subscribers miss nothing. For the other parameters see
    `Connection`. Raises InputError.
    """

    def __init__(self, broker: str, topics: Sequence[str] = ("#",), **connection: Any) -> None:
        check_parameters(connection)
        self._asked = tuple(map(topic_filter, topics))
        self._topics = self._asked if "#" in self._asked else (*self._asked, f"{DISCOVERY}#")
        self._heard = TrafficCollector()
        self._refused: list[str] = []
        self._is_subscribed = self._was_there = False
        self._woken = threading.Event()
        """Set once something is known: the broker is away, or has answered."""
        self._connection = Connection(broker, lambda _: self._woken.set(), **connection)
        self._connection.on_begin = self._subscribe
        self._connection.on_message, self._connection.on_subscribe = self._hear, self._subscribed

    def traffic(self, span_s: float) -> Traffic:
        """Listen for `span_s` seconds. Raises InputError if the broker can't be reached, or sends nothing."""
        name = self._connection.name
        self._connection.open(keeps_session=False)
        try:
            deadline_s = time.monotonic() + _ANSWER_S
            while not self._connection.refusal and time.monotonic() < deadline_s:
                if self._woken.wait(_LOOK_S):
                    break
            self._refuse()
            time.sleep(span_s)
            with self._connection.changed:
                away, refused = self._connection.away, tuple(self._refused)
                notes = [f"what came after the broker {away}"] if away else []
                if refused:
                    notes.append(f"{some(refused)}: the broker lets this client read nothing of it")
                found = self._heard.traffic(name, span_s, self._is_asked, tuple(notes))
        finally:
            self._connection.close()
        if found.is_empty:
            of = "" if self._asked == ("#",) else f" on {some(self._asked)}"
            mend = "listen longer (--for 60s), or name other topics (--topic)"
            mend += "; `house/#` and `/house/#` are different topics in MQTT" if of else ""
            raise InputError.of(f"nothing came from {name}{of} in {span_s:g} s", mend=mend)
        return found

    def _is_asked(self, topic: str) -> bool:
        from paho.mqtt.client import topic_matches_sub

        return any(topic_matches_sub(asked, topic) for asked in self._asked)

    def _refuse(self) -> None:
        """Raise InputError if this client can't listen."""
        name, away, refusal = self._connection.name, self._connection.away, self._connection.refusal
        if refusal:
            mend = "name it by --username, with --password-env or --password-file; certificates by --certificate, --key"
            raise InputError.of(f"{name}: {refusal.partition(';')[0]}", mend=mend)
        mend = "start it, or name the address of one that runs: HOST:PORT, or mqtts://HOST:PORT for TLS"
        if away and not self._was_there:
            ended = f"the program at {name} is not a broker of MQTT 5, or speaks TLS: it ended the connection"
            raise InputError.of(ended if away.startswith("is lost") else f"the broker {name} {away}", mend=mend)
        if not self._is_subscribed:
            raise InputError.of(f"the program at {name} does not answer like a broker of MQTT 5", mend=mend)
        if len(self._refused) == len(self._topics):
            mend = "name what it may read: --topic house/#"
            raise InputError.of(f"{name} lets this client read nothing of {some(self._refused)}", mend=mend)

    def _subscribe(self) -> None:
        from paho.mqtt.subscribeoptions import SubscribeOptions

        self._was_there = True
        options = SubscribeOptions(0, retainAsPublished=True)
        self._connection.client.subscribe([(topic, options) for topic in self._topics])

    def _subscribed(self, _client: Client, _data: object, _number: int, codes: Sequence[Any], _properties: Any) -> None:
        self._refused = [topic for topic, code in zip(self._topics, codes, strict=False) if code.is_failure]
        self._is_subscribed = True
        self._woken.set()

    def _hear(self, _client: Client, _data: object, message: MQTTMessage) -> None:
        with self._connection.changed:
            self._heard.take(
                message.topic, bytes(message.payload), is_retained=message.retain, time_s=message.timestamp
            )
