"""ROS 1 nodes whose messages say how good they are."""

from __future__ import annotations

from pathlib import Path

from observed_nodes import check_that_a_bad_node_is_replaced, check_that_a_slow_node_is_replaced, unsaid, write_finders
from words import NODES


def test_a_node_that_says_it_is_worse_than_its_bound_is_replaced_and_solve_agrees(tmp_path: Path) -> None:
    check_that_a_bad_node_is_replaced(write_finders(tmp_path, NODES), "ros1")


def test_a_node_that_is_measured_to_be_slower_than_its_bound_is_replaced(tmp_path: Path) -> None:
    check_that_a_slow_node_is_replaced(tmp_path, NODES, "ros1")


def test_a_field_that_messages_do_not_have_is_reported_with_its_output_and_file(tmp_path: Path) -> None:
    env = write_finders(tmp_path, NODES, "pose.variance")
    told = unsaid(env, "ros1")
    assert (told["unit"], told["what"]) == ("sonar.1", "no quality")
    assert "output p does not say its error" in told["text"]
    assert "geometry_msgs/PoseWithCovariance has no field `variance`; it has pose, covariance" in told["text"]
    assert f"correct `observe` of that output in {env}" in told["text"]
