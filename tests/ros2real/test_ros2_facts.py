"""Facts of the world that topics of ROS 2 nodes from outside of the run observe."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from operated_world import await_event, command, running
from ros2_venv import PYTHON
from ros2_words import NODES

ENVIRONMENT = """\
format: cfgplan/1
facts:
  left:
    declared: true
    topic: /diagnostics
    type: diagnostic_msgs/DiagnosticArray
    field: status.thrusters.values.left.value
    qos: best_effort
transformations:
  - {label: strong, source: "node:./talking.py talker", requires: left, labor: 0.1, upkeep: 0.01,
     outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter}}}
  - {label: weak, source: "node:./talking.py talker", labor: 0.1, upkeep: 0.1,
     outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter}}}
targets:
  - {label: words, topic: /words, tag: Word}
"""


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


def write(folder: Path, text: str = ENVIRONMENT) -> Path:
    shutil.copy(NODES, folder / "talking.py")
    path = folder / "env.yaml"
    path.write_text(text)
    return path


def test_diagnostics_say_which_nodes_may_run(tmp_path: Path, health: Path) -> None:
    env = write(tmp_path)
    with running("--middleware", "ros2", env) as process:
        run = await_event(process, "Running")["run"]
        first = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in first["change_set"]["started"]] == ["strong"]
        health.write_text("False")
        broken = await_event(process, "Reviewed", decision="applied")
        assert broken["perturbations"][0]["left_out"] == ["strong"]
        assert [unit["transformation"] for unit in broken["change_set"]["started"]] == ["weak"]
        state = subprocess.run(command("ctl", "--run", run, "state", "--json"), capture_output=True, check=True)
        assert json.loads(state.stdout)["facts"]["left"] == "false"
        health.write_text("True")
        mended = await_event(process, "Reviewed", decision="applied")
        assert [unit["transformation"] for unit in mended["change_set"]["started"]] == ["strong"]


def test_a_fact_of_an_unknown_message_type_is_refused_before_the_start(tmp_path: Path) -> None:
    env = write(tmp_path, ENVIRONMENT.replace("DiagnosticArray", "Diagnosis"))
    line = command("run", "--middleware", "ros2", "--for", "1s", env)
    found = subprocess.run(line, capture_output=True, text=True, check=False)
    assert found.returncode != 0
    assert "env.yaml: fact left: diagnostic_msgs/msg/Diagnosis is not known" in found.stderr
    assert "DiagnosticStatus" in found.stderr
    assert "Traceback" not in found.stderr


def test_a_fact_without_a_message_type_is_refused_with_the_mend(tmp_path: Path) -> None:
    text = ENVIRONMENT.replace("    type: diagnostic_msgs/DiagnosticArray\n", "").replace("    qos: best_effort\n", "")
    env = write(tmp_path, text.replace("/diagnostics", "/words"))
    line = command("run", "--middleware", "ros2", "--dry-run", env)
    found = subprocess.run(line, capture_output=True, text=True, check=False)
    assert "a run of ROS 2 nodes can't observe facts without a message type (left)" in found.stderr
    assert "name the message `type` of its `topic`" in found.stderr
