"""ROS 2 nodes whose messages say how good they are."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.operating.told_qualities import told_in
from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
from cfgplan_runtime.supervision.events import Event, OutletsOpened, SparePrepared, SpareUsed, UnitFailed, UnitStatus
from observed_nodes import (
    check_that_a_bad_node_is_replaced,
    check_that_a_look_brings_a_node_back,
    check_that_a_slow_node_is_replaced,
    check_that_diagnostics_are_learned,
    unsaid,
    write_finders,
)
from operated_world import PATIENCE_S, running
from ros2_venv import PYTHON
from ros2_words import NODES

from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, RunOptions, Transformation
from cfgplan.qualities import Contribution, QualityRule, Teller, Told

FINDER = Transformation(
    "finder",
    (),
    (
        OutputPort(
            "pose",
            "Position",
            type="geometry_msgs/PoseWithCovarianceStamped",
            quality=(Contribution("error", QualityRule.SET, 200_000, observe="pose.covariance.0"),),
        ),
    ),
    source="node:./talking.py finder",
)
UNIT = ComputationUnit("finder.1", "finder")


@pytest.fixture
def backends() -> list[Ros2Backend]:
    return []


@pytest.fixture
def runtime(backends: list[Ros2Backend]) -> Iterator[Runtime]:
    def make() -> Ros2Backend:
        backends.append(Ros2Backend(folder=NODES.parent))
        return backends[0]

    with Runtime(backend=make) as runtime:
        yield runtime


@pytest.fixture
def heard(runtime: Runtime) -> Callable[[Callable[[Event], object]], Event]:
    """The next event for which something is true."""
    events: queue.SimpleQueue[Event] = queue.SimpleQueue()
    runtime.listen(events.put)

    def next_of(is_it: Callable[[Event], object]) -> Event:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            event = events.get(timeout=max(0.0, deadline - time.monotonic()))
            if is_it(event):
                return event

    return next_of


def says(event: Event) -> bool:
    return isinstance(event, UnitStatus) and "error" in event.qualities.get("pose", {})


def test_a_node_that_says_it_is_worse_than_its_bound_is_replaced_and_solve_agrees(tmp_path: Path) -> None:
    check_that_a_bad_node_is_replaced(write_finders(tmp_path, NODES), "ros2")


def test_a_node_that_was_too_bad_is_looked_at_beside_the_other_and_taken_once_it_is_good_again(tmp_path: Path) -> None:
    check_that_a_look_brings_a_node_back(write_finders(tmp_path, NODES), Ros2Backend)


def test_a_node_that_is_measured_to_be_slower_than_its_bound_is_replaced(tmp_path: Path) -> None:
    check_that_a_slow_node_is_replaced(tmp_path, NODES, "ros2")


def test_diagnostics_tell_that_a_node_is_worse_than_its_bound(tmp_path: Path) -> None:
    env = write_finders(tmp_path, NODES, "diagnostics.thrusters.left")
    line = [str(PYTHON), str(NODES), "doctor", "--ros-args", "-p", f"water:={tmp_path / 'water'}"]
    with subprocess.Popen(line, start_new_session=True) as doctor:
        try:
            check_that_diagnostics_are_learned(env, "ros2")
        finally:
            doctor.kill()


def test_messages_of_diagnostics_and_statistics_tell_numbers() -> None:
    values = [{"key": "error", "value": "0.25"}, {"key": "mode", "value": "fine"}]
    found = dict(told_in(Teller.DIAGNOSTICS, {"status": [{"name": "arm: left", "values": values}]}))
    assert found[Told(Teller.DIAGNOSTICS, "arm: left", "error")] == 0.25
    assert found[Told(Teller.DIAGNOSTICS, "arm: left", "mode")] is None
    points = [{"data_type": 2, "data": 9.0}, {"data_type": 1, "data": 40.0}]
    message = {"measurement_source_name": "map_1", "metrics_source": "message_age", "unit": "ms", "statistics": points}
    assert list(told_in(Teller.STATISTICS, message)) == [(Told(Teller.STATISTICS, "map_1", "age"), 0.04)]
    assert list(told_in(Teller.STATISTICS, {**message, "unit": "px"})) == []


@pytest.mark.parametrize(
    ("field", "cause"),
    [
        ("pose.variance", "geometry_msgs/PoseWithCovariance has no field `variance`; it has pose, covariance"),
        ("pose.covariance.36", "`pose.covariance` has several values: name one by its number, from 0 to 35"),
        ("pose.pose", "`pose.pose` is not a number; name one of its fields: position, orientation"),
        ("header.frame_id", "`header.frame_id` is not a number"),
    ],
)
def test_a_field_that_messages_do_not_have_is_reported_with_its_output_and_file(
    tmp_path: Path, field: str, cause: str
) -> None:
    env = write_finders(tmp_path, NODES, field)
    told = unsaid(env, "ros2")
    assert (told["unit"], told["what"]) == ("sonar.1", "no quality")
    assert f"output p does not say its error: {cause}: correct `observe` of that output in {env}" in told["text"]


def test_a_wrong_field_is_reported_once(tmp_path: Path) -> None:
    with running("--middleware", "ros2", write_finders(tmp_path, NODES, "variance"), "--for", "6s") as process:
        said, _ = process.communicate()
    assert "Running" in said
    assert said.count("UnitFailed") == 1


def test_a_stream_that_nobody_uses_is_observed_and_all_its_messages_are_in_the_sums(
    runtime: Runtime, heard: Callable[[Callable[[Event], object]], Event]
) -> None:
    runtime.apply(ChangeSet(added_transformations=(FINDER,), started=(UNIT,)))
    heard(says)
    first, second = heard(says), heard(says)
    assert isinstance(first, UnitStatus)
    assert isinstance(second, UnitStatus)
    passed = second.outputs["pose"].elements - first.outputs["pose"].elements
    elements, mean, squares = second.qualities["pose"]["error"]
    assert (elements, mean, squares) == (passed, pytest.approx(0.3), pytest.approx(0.0, abs=1e-9))


def test_streams_are_observed_again_after_the_helper_has_died(
    runtime: Runtime,
    backends: list[Ros2Backend],
    heard: Callable[[Callable[[Event], object]], Event],
) -> None:
    runtime.apply(ChangeSet(added_transformations=(FINDER,), started=(UNIT,)))
    heard(says)
    relay = backends[0]._wires._relay
    assert relay is not None
    os.kill(relay.pid, signal.SIGKILL)  # type: ignore[attr-defined]
    heard(lambda event: isinstance(event, OutletsOpened))
    heard(says)


@pytest.mark.parametrize("node", ["finder", "diver"], ids=["warm", "lifecycle"])
def test_a_node_that_begins_in_a_spare_is_observed(
    node: str, runtime: Runtime, heard: Callable[[Callable[[Event], object]], Event]
) -> None:
    life = RunOptions(lifecycle=node == "diver")
    spared = replace(FINDER, source=f"node:./talking.py {node}", run=life, standby_us=1)
    spare = ComputationUnit("finder.2", "finder", standby=True)
    runtime.apply(ChangeSet(added_transformations=(spared,), started=(UNIT, spare)))
    heard(lambda event: isinstance(event, SparePrepared))
    runtime.apply(ChangeSet(started=(ComputationUnit("finder.3", "finder"),), stopped=("finder.1",)))
    heard(lambda event: event == SpareUsed("finder.3", "finder.2"))
    heard(lambda event: says(event) and event.unit == "finder.3")  # type: ignore[attr-defined]


def test_a_message_without_numbers_is_told(
    runtime: Runtime, heard: Callable[[Callable[[Event], object]], Event]
) -> None:
    quality = (Contribution("error", QualityRule.SET, 1, observe="data"),)
    words = OutputPort("words", "Word", remap="chatter", type="std_msgs/String", quality=quality)
    talker = Transformation("talker", (), (words,), source="node:./talking.py talker")
    runtime.apply(ChangeSet(added_transformations=(talker,), started=(ComputationUnit("talker.1", "talker"),)))
    event = heard(lambda event: isinstance(event, UnitFailed))
    assert isinstance(event, UnitFailed)
    assert event.text == (
        "output words does not say its error: `data` is not a number: "
        "correct `observe` of that output in the environment file"
    )
