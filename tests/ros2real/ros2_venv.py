"""The venv with the Jazzy wheels that tests run nodes in: CFGPLAN_TEST_ROS2, or what `.ci/run` makes."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from cfgplan.cache_folder import cache_folder

VENV = Path(os.environ.get("CFGPLAN_TEST_ROS2") or (cache_folder() or Path()) / "ros2-jazzy")
PYTHON = VENV / "bin" / "python"


def lacks_ros() -> str:
    """Why nodes of ROS 2 can't be run here; empty if they can."""
    if not PYTHON.exists():
        return f"ROS 2 is not installed at {VENV} (CFGPLAN_TEST_ROS2; .ci/run makes it)"
    code = (
        "import rclpy, diagnostic_msgs.msg, std_msgs.msg, sensor_msgs.msg, std_srvs.srv, nav_msgs.msg, test_msgs.action"
    )
    found = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True, check=False)
    return f"rclpy can't be used here: {found.stderr.strip().rpartition(chr(10))[2]}" if found.returncode else ""
