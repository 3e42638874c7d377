"""Actions of ROS 2 are led: goals go to the server that the plan has chosen, and stay with it."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

from cfgplan_runtime import Runtime
from ros2_words import Observer

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)

FIBONACCI = "test_msgs/action/Fibonacci"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def counter(label: str, first: int) -> Transformation:
    count = OutputPort("count", "Count", remap="~count", type=FIBONACCI)
    return Transformation(label, (), (count,), source="node:./talking.py counter", params={"first": first})


def client(server: str) -> ComputationUnit:
    asks = Subscription("counting", Stream(server, "count"))
    return ComputationUnit("client.1", "client", (asks,), (Publication("heard", "/heard"),))


def begin(runtime: Runtime, observer: Observer, **params: int) -> Iterator[str]:
    """What a client hears of its goals, with the counter `a` as its server; `b` is known too."""
    asking = Transformation(
        "client",
        (InputPort("counting", "Count", service=True, remap="count", type=FIBONACCI),),
        (OutputPort("heard", "Heard"),),
        source="node:./talking.py client",
        params=params,
    )
    heard = observer.listen("/heard")
    started = (ComputationUnit("a.1", "a"), client("a.1"))
    library = (counter("a", 100), counter("b", 200), asking)
    runtime.apply(ChangeSet(started, added_transformations=library, added_targets=(Target("h", "Heard", "/heard"),)))
    return heard


def switch(runtime: Runtime, stopped: tuple[str, ...] = ()) -> None:
    runtime.apply(ChangeSet((ComputationUnit("b.1", "b"),), rewired=(client("b.1"),), stopped=stopped))


def test_a_goal_gives_feedback_and_a_result(runtime: Runtime, observer: Observer) -> None:
    """Topics and services have no order among each other, so that a feedback may come before the goal's answer."""
    heard = begin(runtime, observer, order=4)
    result = f"result {SUCCEEDED} 100 4"
    told = [text for _ in range(3) for text in iter(heard.__next__, result)]
    assert set(told) == {"goal True", *(f"feedback 100 {number}" for number in range(1, 5))}


def test_a_goal_that_is_cancelled_ends_so(runtime: Runtime, observer: Observer) -> None:
    heard = begin(runtime, observer, order=0, patience=5)
    result = next(text for text in heard if text.startswith("result"))
    assert result.startswith(f"result {CANCELED} 100")


def test_a_goal_stays_with_its_server_and_the_next_goes_to_the_new_one(runtime: Runtime, observer: Observer) -> None:
    """A goal may begin while the update is under way: it ends at the old server all the same."""
    heard = begin(runtime, observer, order=50)
    assert any(text.startswith("feedback 100") for text in heard)
    switch(runtime)
    results = [text for text in iter(heard.__next__, f"result {SUCCEEDED} 200 50") if text.startswith("result")]
    assert set(results) == {f"result {SUCCEEDED} 100 50"}


def test_goals_of_a_server_that_has_died_are_aborted_and_the_next_goes_to_its_replacement(
    runtime: Runtime, observer: Observer
) -> None:
    heard = begin(runtime, observer, order=0)
    assert any(text.startswith("feedback 100") for text in heard)
    pid = runtime.pid("a.1")
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    switch(runtime)
    assert next(text for text in heard if text.startswith("result")) == f"result {ABORTED}"
    assert next(text for text in heard if text.startswith("feedback")) == "feedback 200 1"
