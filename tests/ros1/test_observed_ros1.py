"""ROS 1 nodes whose messages say how good they are."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from cfgplan_runtime.ros1.ros_master import RosMaster
from observed_nodes import (
    WITH_FACT,
    check_that_a_bad_node_is_replaced,
    check_that_a_fact_is_followed,
    check_that_a_slow_node_is_replaced,
    check_that_diagnostics_are_learned,
    unsaid,
    write_finders,
    write_with_fact,
)
from operated_world import await_event, running
from warm import command
from warm_nodes import NODES, start

pytestmark = pytest.mark.usefixtures("warm_cfgplan", "warm_nodes")


def test_a_node_that_says_it_is_worse_than_its_bound_is_replaced_and_solve_agrees(tmp_path: Path) -> None:
    check_that_a_bad_node_is_replaced(write_finders(tmp_path, NODES), "ros1", command)


def test_a_node_that_is_measured_to_be_slower_than_its_bound_is_replaced(tmp_path: Path) -> None:
    check_that_a_slow_node_is_replaced(tmp_path, NODES, "ros1", command)


def test_a_field_that_messages_do_not_have_is_reported_with_its_output_and_file(tmp_path: Path) -> None:
    env = write_finders(tmp_path, NODES, "pose.variance")
    told = unsaid(env, "ros1", command)
    assert (told["unit"], told["what"]) == ("sonar.1", "no quality")
    assert "output p does not say its error" in told["text"]
    assert "geometry_msgs/PoseWithCovariance has no field `variance`; it has pose, covariance" in told["text"]
    assert f"correct `observe` of that output in {env}" in told["text"]


def doctor(water: Path) -> AbstractContextManager[None]:
    """A master, and a node of nobody's run that says on `/diagnostics` what the file `water` says."""
    return outsider("doctor", f"_water:={water}")


@contextmanager
def outsider(node: str, *arguments: str) -> Iterator[None]:
    """A master, and a node of nobody's run."""
    master = RosMaster()
    try:
        process = start([str(NODES), node, *arguments], env=dict(master.environment))
        try:
            yield
        finally:
            process.kill()
            process.wait()
    finally:
        master.close()


def test_diagnostics_say_which_nodes_may_run(tmp_path: Path) -> None:
    health = tmp_path / "left"
    health.write_text("True")
    with doctor(health):
        check_that_a_fact_is_followed(write_with_fact(tmp_path, NODES), health, "ros1", command)


def test_diagnostics_tell_that_a_node_is_worse_than_its_bound(tmp_path: Path) -> None:
    env = write_finders(tmp_path, NODES, "diagnostics.thrusters.left")
    with doctor(tmp_path / "water"):
        check_that_diagnostics_are_learned(env, "ros1", command)


def test_a_fact_of_another_message_type_than_that_of_its_topic_is_reported(tmp_path: Path) -> None:
    health = tmp_path / "left"
    health.write_text("True")
    env = write_with_fact(tmp_path, NODES, WITH_FACT.replace("DiagnosticArray", "KeyValue"))
    with doctor(health), running("--middleware", "ros1", env, call=command) as process:
        told = await_event(process, "Warning")["text"]
    assert "diagnostic_msgs/DiagnosticArray, not diagnostic_msgs/KeyValue: correct the `type` of its fact" in told


def test_diagnostics_of_another_message_type_are_reported_and_no_fact_is_blamed(tmp_path: Path) -> None:
    env = write_finders(tmp_path, NODES, "diagnostics.thrusters.left")
    with (
        outsider("talker", "chatter:=/diagnostics", "_rate:=10"),
        running("--middleware", "ros1", env, call=command) as process,
    ):
        told = await_event(process, "Warning")["text"]
    assert "/diagnostics is of type std_msgs/String, not diagnostic_msgs/DiagnosticArray" in told
    assert "let its publisher use another topic" in told and "fact" not in told


def test_a_fact_without_a_message_type_is_refused(tmp_path: Path) -> None:
    text = WITH_FACT.replace("    type: diagnostic_msgs/DiagnosticArray\n", "").replace("    qos: best_effort\n", "")
    env = write_with_fact(tmp_path, NODES, text.replace("/diagnostics", "/words"))
    line = command("run", "--middleware", "ros1", "--dry-run", env)
    found = subprocess.run(line, capture_output=True, text=True, check=False)
    assert "a run of ROS 1 nodes can't observe facts without a message type (left)" in found.stderr


def test_topic_statistics_are_refused_in_ros_1(tmp_path: Path) -> None:
    env = write_finders(tmp_path, NODES, "statistics.mapper_1.age")
    env.write_text(env.read_text().replace("unit: m}", "unit: s}"))
    line = command("run", "--middleware", "ros1", "--dry-run", env)
    found = subprocess.run(line, capture_output=True, text=True, check=False)
    assert "ROS 1 nodes publish no topic statistics (sonar/p error)" in found.stderr
    assert "Traceback" not in found.stderr
