"""A ROS 1 master's address and run folders of the tests' own; without ROS 1 on this computer they are skipped."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from cfgplan_runtime.nodes import node_process
from cfgplan_runtime.processes import nursery_link
from cfgplan_runtime.ros1 import ros_master
from warm_nodes import PYTHON, SUBPROCESS, with_rospy
from warm_python import warm_subprocess

sys.path.append(str(Path(__file__).parents[1] / "operating"))
sys.path.append(str(Path(__file__).parents[2] / "models" / "nao"))


def _lacks_ros() -> str:
    """Why nodes of ROS 1 can't be run here; empty if they can."""
    if shutil.which("rosmaster") is None:
        return "ROS 1 is not installed here (Debian: apt install python3-rosmaster)"
    code = "import rospy, roscpp.srv, diagnostic_msgs.msg, geometry_msgs.msg, sensor_msgs.msg, std_msgs.msg"
    found = subprocess.run([PYTHON, "-c", code], env={}, capture_output=True, text=True, check=False)
    return f"rospy can't be used here: {found.stderr.strip().rpartition(chr(10))[2]}" if found.returncode else ""


@pytest.fixture(scope="session", autouse=True)
def ros() -> None:
    """Skip the tests of this room where nodes can't be run; asked once, by the first of them."""
    if reason := _lacks_ros():
        pytest.skip(reason)


@pytest.fixture(autouse=True)
def surroundings(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for name in [name for name in os.environ if name.startswith("ROS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{port}")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("log")))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))


@pytest.fixture
def warm_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes of `talking.py`, masters and relays of this process are forks of processes that have imported theirs."""
    with_rospy()
    for module in (node_process, ros_master):
        monkeypatch.setattr(module, "subprocess", SUBPROCESS)
    monkeypatch.setattr(nursery_link, "subprocess", warm_subprocess("cfgplan_runtime.ros1.topic_relay"))
