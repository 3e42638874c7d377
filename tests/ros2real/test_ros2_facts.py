"""Facts of the world that topics of ROS 2 nodes from outside of the run observe."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from observed_nodes import WITH_FACT, check_that_a_fact_is_followed, write_with_fact
from operated_world import command
from ros2_venv import PYTHON
from ros2_words import NODES


@pytest.fixture
def health(tmp_path: Path) -> Iterator[Path]:
    """The file by which a node tells whether the left thruster works."""
    file = tmp_path / "left"
    file.write_text("True")
    line = [str(PYTHON), str(NODES), "doctor", "--ros-args", "-p", f"water:={file}"]
    with subprocess.Popen(line, start_new_session=True) as process:
        try:
            yield file
        finally:
            process.kill()


def test_diagnostics_say_which_nodes_may_run(tmp_path: Path, health: Path) -> None:
    check_that_a_fact_is_followed(write_with_fact(tmp_path, NODES), health, "ros2")


def test_a_fact_of_an_unknown_message_type_is_refused_before_the_start(tmp_path: Path) -> None:
    env = write_with_fact(tmp_path, NODES, WITH_FACT.replace("DiagnosticArray", "Diagnosis"))
    line = command("run", "--middleware", "ros2", "--for", "1s", env)
    found = subprocess.run(line, capture_output=True, text=True, check=False)
    assert found.returncode != 0
    assert "env.yaml: fact left: diagnostic_msgs/msg/Diagnosis is not known" in found.stderr
    assert "DiagnosticStatus" in found.stderr
    assert "Traceback" not in found.stderr


def test_a_fact_without_a_message_type_is_refused_with_the_mend(tmp_path: Path) -> None:
    text = WITH_FACT.replace("    type: diagnostic_msgs/DiagnosticArray\n", "").replace("    qos: best_effort\n", "")
    env = write_with_fact(tmp_path, NODES, text.replace("/diagnostics", "/words"))
    line = command("run", "--middleware", "ros2", "--dry-run", env)
    found = subprocess.run(line, capture_output=True, text=True, check=False)
    assert "a run of ROS 2 nodes can't observe facts without a message type (left)" in found.stderr
    assert "name the message `type` of its `topic`" in found.stderr
