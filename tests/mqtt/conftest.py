"""A broker, and what stands on it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mosquitto import Broker, running

Publish = Callable[..., None]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    folder = tmp_path / "broker"
    folder.mkdir()
    with running(folder) as broker:
        yield broker


@pytest.fixture
def keep(broker: Broker) -> Publish:
    """Publish a message that the broker keeps: a text as it is, all else as JSON."""
    from paho.mqtt.publish import single

    def keep(topic: str, said: Any) -> None:
        payload = said if isinstance(said, str | bytes) else json.dumps(said)
        single(topic, payload, qos=1, retain=True, hostname="127.0.0.1", port=broker.port)

    return keep
