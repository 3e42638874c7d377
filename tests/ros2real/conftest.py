"""A domain of each worker's own on this computer, and the Python that has rclpy; without one the tests are skipped.

CFGPLAN_TEST_ROS2 is a venv with the Jazzy wheels; `.ci/run` makes one in the cache folder, where it is looked for too.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from ros2_venv import PYTHON, lacks_ros

sys.path.append(str(Path(__file__).parents[1] / "operating"))
sys.path.append(str(Path(__file__).parents[2] / "models" / "nao"))
_FIRST_DOMAIN = 40


LACKS_ROS = lacks_ros()


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
