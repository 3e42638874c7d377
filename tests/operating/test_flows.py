"""What is measured of the targets' topics, on real processes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.operating.flows import Flow, Flows
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    OutputPort,
    Publication,
    RunOptions,
    Target,
    Transformation,
)

PATIENCE_S = 60.0
CAMERA = Transformation(
    "camera", outputs=(OutputPort("image", "I"),), source="camera_units.py:camera", run=RunOptions(rate_hz=100)
)
UNIT = ComputationUnit("camera.1", "camera", (), (Publication("image", "/result"),))


def eventually(is_so: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline, "it never came to be"
        time.sleep(0.01)


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    with Runtime([CAMERA], [Target("result", "I", "/result")], folder=Path(__file__).parent) as running:
        running.apply(ChangeSet(started=(UNIT,)))
        yield running


def test_rate_and_latency_of_a_topic_are_measured(runtime: Runtime) -> None:
    flows = Flows(runtime.id)
    flows.follow(["/result"])
    eventually(lambda: flows.now()["/result"].elements > 50)
    flow = flows.now()["/result"]
    assert 1 < flow.rate_hz < 150
    assert flow.latency_ms is not None
    assert 0 < flow.latency_ms < 1e3 * PATIENCE_S
    flows.close()
    assert flows.now() == {}


def test_a_topic_that_falls_silent_and_comes_back_is_seen_as_that(runtime: Runtime) -> None:
    flows = Flows(runtime.id)
    flows.follow(["/result", "/nowhere"])
    eventually(lambda: flows.now()["/result"].elements)
    runtime.apply(ChangeSet(stopped=("camera.1",)))
    eventually(lambda: flows.now()["/result"].rate_hz == 0.0)
    assert flows.now()["/nowhere"] == Flow()
    before = flows.now()["/result"].elements
    runtime.apply(ChangeSet(started=(UNIT,)))
    eventually(lambda: flows.now()["/result"].elements > before)
    flows.close()


def test_whoever_listens_gets_every_element_in_order(runtime: Runtime) -> None:
    heard: list[int] = []

    def listen(topic: str, element: Element) -> None:
        assert topic == "/result"
        heard.append(int(decode(element.payload)[0, 0]))

    flows = Flows(runtime.id, listen)
    flows.follow(["/result"])
    eventually(lambda: len(heard) > 50)
    flows.close()
    assert heard == [(heard[0] + number) % 256 for number in range(len(heard))]


def test_a_topic_that_is_no_longer_followed_is_left(runtime: Runtime) -> None:
    flows = Flows(runtime.id)
    flows.follow(["/result"])
    eventually(lambda: flows.now()["/result"].elements)
    flows.follow([])
    assert flows.now() == {}
    eventually(lambda: not [thread for thread in threading.enumerate() if "cfgplan-flow" in thread.name])
    flows.close()
