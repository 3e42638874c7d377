"""A domain of each worker's own on this computer, and the Python that has rclpy; without one the tests are skipped.

CFGPLAN_TEST_ROS2 is a venv with the Jazzy wheels; `.ci/run` makes one in the cache folder, where it is looked for too.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "operating"))
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
VENV = Path(os.environ.get("CFGPLAN_TEST_ROS2") or _CACHE / "cfgplan" / "ros2-jazzy")
PYTHON = VENV / "bin" / "python"
_FIRST_DOMAIN = 40


def _lacks_ros() -> str:
    """Why nodes of ROS 2 can't be run here; empty if they can."""
    if not PYTHON.exists():
        return f"ROS 2 is not installed at {VENV} (CFGPLAN_TEST_ROS2; .ci/run makes it)"
    code = "import rclpy, std_msgs.msg, sensor_msgs.msg, std_srvs.srv, nav_msgs.msg"
    found = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True, check=False)
    return f"rclpy can't be used here: {found.stderr.strip().rpartition(chr(10))[2]}" if found.returncode else ""


LACKS_ROS = _lacks_ros()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if LACKS_ROS and here in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=LACKS_ROS))


@pytest.fixture(autouse=True)
def surroundings(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith(("ROS_", "FASTRTPS_", "FASTDDS_"))]:
        monkeypatch.delenv(name)
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(_FIRST_DOMAIN + int(worker)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("log")))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    monkeypatch.setenv("CFGPLAN_ROS_PYTHON", str(PYTHON))
