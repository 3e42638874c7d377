"""No first element is missed by those that follow topics, though they connect slowly.

Each source gives one element, at once when it is told to begin.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.operating.flows import Following
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.operating.published import PublishedTargets
from cfgplan_runtime.operating.recorded import recorded
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode
from cfgplan_runtime.streams.subscription import RunPlace
from cfgplan_runtime.supervision import updates
from operated_world import PATIENCE_S, eventually

from cfgplan import api
from cfgplan.costs import MICRO
from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    OutputPort,
    Publication,
    Target,
    Transformation,
)

UNITS = """\
import time

def once(value):
    yield value
    while True:
        time.sleep(0.1)
"""
FIRST = """\
format: cfgplan/1
transformations:
  - {label: first, source: 'units.py:once', params: {value: 7}, outputs: {out: First}}
  - {label: second, source: 'units.py:once', params: {value: 8}, outputs: {out: Second}}
facts:
  seen: {declared: 0, topic: /first}
targets:
  - {label: first, topic: /first, tag: First}
"""
BOTH = f"{FIRST}  - {{label: second, topic: /second, tag: Second}}\n"
HOSTS = "hosts: [{name: r1}, {name: r2}]\n"


class Kept:
    """Where targets are published."""

    def __init__(self) -> None:
        self.put_in: list[tuple[str, object]] = []

    def wanted(self, environment: Environment) -> tuple[Target, ...]:
        return environment.stream_targets

    def begin(self, target: Target) -> bool:
        return bool(target.topic)

    def end(self, target: Target) -> None:
        pass

    def put(self, topic: str, element: Element) -> None:
        self.put_in.append((topic, decode(element.payload)))

    def close(self) -> None:
        pass


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Followers that connect only some time after they have found a topic."""
    delay_connections(monkeypatch, lambda: time.sleep(0.2))
    monkeypatch.setattr(updates, "Patience", partial(updates.Patience, follow_s=PATIENCE_S))


def delay_connections(monkeypatch: pytest.MonkeyPatch, wait: Callable[[], object]) -> None:
    """Let followers `wait` before they connect to a topic that they have found."""
    connect = RunPlace.connect

    def late(place: RunPlace, topic: str) -> socket.socket | None:
        wait()
        return connect(place, topic)

    monkeypatch.setattr(RunPlace, "connect", late)


@contextmanager
def operated(folder: Path, text: str, **settings: Any) -> Iterator[Operation]:
    (folder / "units.py").write_text(UNITS)
    env = folder / "env.yaml"
    env.write_text(text)
    with Operation(api.load(env), env, Settings(**settings)) as operation:
        assert operation.begun.wait(PATIENCE_S)
        yield operation


def on_hosts(environment: Environment, folder: Path) -> AbstractContextManager[Runtime]:
    from cfgplan_runtime.fleet.fleet_runtime import Fleet, fleet_runtime

    return fleet_runtime(Fleet(is_local=True), environment, folder)


@pytest.mark.parametrize("hosts", [False, True], ids=["one computer", "hosts"])
@pytest.mark.usefixtures("slow")
def test_a_first_value_is_recorded_published_and_observed(tmp_path: Path, hosts: bool) -> None:
    if hosts:
        pytest.importorskip("zenoh", reason="zenoh is not installed (extra fleet)")
    more = HOSTS if hosts else ""
    kept, record, runtime = Kept(), tmp_path / "run.mcap", on_hosts if hosts else None
    settings = {"record": record, "runtime": runtime, "beside": lambda of: PublishedTargets(of, kept)}
    with operated(tmp_path, FIRST + more, **settings) as operation:
        eventually(lambda: [fact.value for fact in operation.manager.snapshot().facts] == [7 * MICRO])
        eventually(lambda: kept.put_in == [("/first", 7)])
        (tmp_path / "env.yaml").write_text(BOTH + more)
        eventually(lambda: kept.put_in == [("/first", 7), ("/second", 8)])
        assert operation.dropped == 0
    counts = {topic.name: topic.count for topic in recorded(record).topics.values()}
    assert (counts["/first"], counts["/second"]) == (1, 1)


def test_a_topic_that_closes_and_opens_again_is_followed_from_its_first_element(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A follower does not notice that the topic has closed before the next update asks for it."""
    is_asked = threading.Event()

    def ask(_: object) -> bool:
        is_asked.set()
        return True

    delay_connections(monkeypatch, lambda: is_asked.wait(PATIENCE_S) and time.sleep(0.2))
    monkeypatch.setattr(updates, "Patience", partial(updates.Patience, follow_s=PATIENCE_S))
    (tmp_path / "units.py").write_text(UNITS)
    outputs = (OutputPort("out", "Out"),)
    library = [Transformation(f"{n}", outputs=outputs, source="units.py:once", params={"value": n}) for n in range(3)]
    heard = list[object]()
    with Runtime(library, folder=tmp_path) as runtime:
        following = Following(
            runtime, lambda: ["/out"], lambda _, element: heard.append(decode(element.payload)), print, "heard"
        )
        runtime.await_follower(ask)
        for n in range(3):
            one = ComputationUnit(f"unit.{n}", f"{n}", publications=(Publication("out", "/out"),))
            runtime.apply(ChangeSet(started=(one,)))
            eventually(lambda n=n: heard == [*range(n + 1)])  # type: ignore[misc]
            is_asked.clear()
            runtime.apply(ChangeSet(stopped=(one.id,)))
        is_asked.set()  # otherwise the thread of the topic outlives the test
        following.close()


def test_elements_before_a_follower_that_an_update_did_not_await_are_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    is_late = threading.Event()
    delay_connections(monkeypatch, lambda: is_late.wait(PATIENCE_S))
    warnings = list[str]()
    with operated(tmp_path, FIRST, record=tmp_path / "run.mcap") as operation:
        eventually(lambda: operation.flows.now().get("/first", Flow()).elements == 1)
        is_late.set()
        why = "the update did not wait longer for the connection to the topic"
        for done in ("recorded", "observed"):
            told = f"the first element on /first is not {done}: {why}"
            eventually(lambda told=told: told in news(operation, warnings))  # type: ignore[misc]
        assert operation.dropped == 1


def news(operation: Operation, seen: list[str]) -> list[str]:
    """Take all news of a run, and return them with those that were `seen` before."""
    with suppress(queue.Empty):
        while True:
            seen.append(str(operation.news.get_nowait()))
    return seen
