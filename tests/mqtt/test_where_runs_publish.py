"""Which topics a run may publish at a broker where its sources subscribe. No broker."""

from __future__ import annotations

import pytest
from cfgplan_runtime.mqtt.connection import is_same_broker
from cfgplan_runtime.mqtt.targets import check_targets

from cfgplan.domain import Environment, OutputPort, Target, Transformation
from cfgplan.errors import InputError


@pytest.fixture(autouse=True)
def paho() -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")


def hearing(topic: str, broker: str = "localhost") -> Environment:
    """A target on the topic house/t, and a source that subscribes at a broker."""
    params = {"broker": broker, "topic": topic}
    sensor = Transformation(
        "sensor", outputs=(OutputPort("value", "Value"),), source="cfgplan_runtime.mqtt:Subscriber", params=params
    )
    return Environment(library=(sensor,), targets=(Target("value", "Value", "house/t"),))


@pytest.mark.parametrize("topic", ["house/t", "+/t", "house/#", "$share/group/house/#"])
def test_no_target_has_a_topic_that_a_source_hears(topic: str) -> None:
    with pytest.raises(InputError, match="the run would receive its own values"):
        check_targets(hearing(topic), "127.0.0.1:1883")


@pytest.mark.parametrize("topic", ["house/other", "$share/house/t", "/house/t", "#", "+/#", "$share/group/#"])
def test_other_topics_are_published_and_all_beside_a_source_that_hears_all(topic: str) -> None:
    check_targets(hearing(topic), "127.0.0.1:1883")


def test_addresses_of_one_broker_are_known() -> None:
    names = ["localhost", "127.0.0.1:1883", "mqtt://[::1]", "[::1]:1883"]
    assert all(is_same_broker(one, other) for one in names for other in names)
    others = ["mqtts://localhost", "[fe80::1]", "localhost:1884", "a:b:c"]
    assert not any(is_same_broker(one, other) for one in names for other in others)
