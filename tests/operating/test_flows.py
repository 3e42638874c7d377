"""What is measured of the targets' topics, on real processes."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from cfgplan_runtime import Runtime, subscribe
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.operating.flows import Flows, Following
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode
from cfgplan_runtime.supervision.events import TopicsStatus
from operated_world import PATIENCE_S, eventually

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    OutputPort,
    Publication,
    RunOptions,
    Target,
    Transformation,
)

CAMERA = Transformation("camera", outputs=(OutputPort("image", "I"),), source="camera_units.py:camera")
UNIT = ComputationUnit("camera.1", "camera", (), (Publication("image", "/result"),))


@pytest.fixture
def runtime(request: pytest.FixtureRequest) -> Iterator[Runtime]:
    """A camera that runs, with 100 images a second or as many as a test asks for."""
    camera = replace(CAMERA, run=RunOptions(rate_hz=getattr(request, "param", 100)))
    with Runtime([camera], [Target("result", "I", "/result")], folder=Path(__file__).parent) as running:
        running.apply(ChangeSet(started=(UNIT,)))
        yield running


def flows_of(runtime: Runtime) -> Flows:
    flows = Flows()
    runtime.listen(flows.hear)
    return flows


def test_rate_and_latency_of_a_topic_are_measured_though_nobody_fetches_its_elements(runtime: Runtime) -> None:
    flows = flows_of(runtime)
    seen = [Flow()]

    def is_measured() -> bool:
        seen.append(flows.now().get("/result", Flow()))
        return seen[-1].elements > 50 and seen[-1].rate_hz > 1  # a stalled computer gives none for a while

    eventually(is_measured)
    flow = seen[-1]
    assert flow.rate_hz < 150
    assert flow.latency_ms is not None
    assert 0 < flow.latency_ms < 1e3 * PATIENCE_S
    assert flow.dropped == 0
    threads = [thread.name for thread in threading.enumerate()]
    assert not [name for name in threads if "flow" in name]


def test_a_topic_that_falls_silent_and_comes_back_is_seen_as_that(runtime: Runtime) -> None:
    flows = flows_of(runtime)
    eventually(lambda: flows.now().get("/result", Flow()).elements)
    runtime.apply(ChangeSet(stopped=("camera.1",)))
    eventually(lambda: flows.now()["/result"].rate_hz == 0.0)
    assert (flows.now()["/result"].silent_s or 0) > 2
    before = flows.now()["/result"].elements
    runtime.apply(ChangeSet(started=(UNIT,)))
    eventually(lambda: flows.now()["/result"].elements > before)


def test_what_outlets_do_not_tell_does_not_come(monkeypatch: pytest.MonkeyPatch) -> None:
    flows, now = Flows(), time.monotonic()
    flows.hear(TopicsStatus({"/result": Flow(100.0, 1.0, 500, 0, 0.01)}))
    monkeypatch.setattr(time, "monotonic", lambda: now + 10)
    flow = flows.now()["/result"]
    assert (flow.rate_hz, flow.latency_ms, flow.elements) == (0.0, None, 500)
    assert flow.silent_s == pytest.approx(10, abs=1)


@pytest.mark.parametrize("runtime", [2000], indirect=True)
def test_what_subscribers_do_not_fetch_is_counted(runtime: Runtime) -> None:
    flows = flows_of(runtime)
    with subscribe("/result"):
        eventually(lambda: flows.now().get("/result", Flow()).dropped)


def test_whoever_listens_gets_every_element_in_order(runtime: Runtime) -> None:
    heard: list[int] = []

    def listen(topic: str, element: Element) -> None:
        assert topic == "/result"
        heard.append(int(decode(element.payload)[0, 0]))

    following = Following(runtime, lambda: ["/result"], listen, print, "heard")
    eventually(lambda: len(heard) > 50)
    following.close()
    assert heard == [(heard[0] + number) % 256 for number in range(len(heard))]


def test_a_topic_that_is_no_longer_followed_is_left(runtime: Runtime) -> None:
    heard: list[str] = []
    wanted = ["/result"]
    following = Following(runtime, lambda: wanted, lambda topic, _: heard.append(topic), print, "heard")
    eventually(lambda: heard)
    wanted.clear()
    following.look()
    eventually(lambda: not [thread for thread in threading.enumerate() if "cfgplan-flow" in thread.name])
    following.close()
