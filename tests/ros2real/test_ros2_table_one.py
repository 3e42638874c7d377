"""The paper's case (its Table I) on ROS 2: nodes find a ball, a lost one is replaced, and a fusion takes over."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from football import scenario
from operated_world import await_event, eventually, running
from ros2_venv import PYTHON
from ros2_words import command_of, observing, pid_of

NAO = Path(__file__).parents[2] / "models" / "nao"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PIFF = ("bottom_cam", "subsampler", "segmenter", "ball_detector", "self_localization", "ball_localization")


@pytest.fixture
def nao(tmp_path: Path) -> Path:
    """The world of the case, with an environment file to be edited; its nodes run by the Python that has rclpy."""
    tried = subprocess.run([PYTHON, "-c", "import cv2"], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"the ROS Python has no OpenCV (pip install opencv-python-headless): {tried.stderr.strip()[-80:]}")
    shutil.copytree(NAO, tmp_path / "nao")
    path = tmp_path / "nao" / "ros2" / "env.yaml"
    path.write_text((NAO / "ros2" / "1-piff-registered.yaml").read_text())
    return path


def test_table_one_runs_as_ros2_nodes_is_mended_and_goes_over_to_the_fusion(nao: Path) -> None:
    with observing() as observer, running("--middleware", "ros2", nao) as process:
        errors = errors_of(observer.listen("/result", POSE))
        await_event(process, "Running")
        eventually(lambda: next(errors) < 0.5)
        before = {label: pid_of(process, f"__node:={label}_piff_1") for label in PIFF}
        assert all(before.values())
        os.kill(before["segmenter"], signal.SIGKILL)
        await_event(process, "UnitDied", unit="segmenter(piff).1")
        eventually(lambda: pid_of(process, "__node:=segmenter_piff_1") not in (0, before["segmenter"]))
        after = {label: pid_of(process, f"__node:={label}_piff_1") for label in PIFF}
        assert {label for label in PIFF if before[label] != after[label]} == {"segmenter"}
        eventually(lambda: next(errors) < 0.5)

        nao.write_text((NAO / "ros2" / "5-fusion-required.yaml").read_text())
        both = [f"__node:={label}_{robot}_1" for label in PIFF for robot in ("piff", "puff")]
        eventually(lambda: all(pid_of(process, node) for node in ["__node:=fuse_ball_pos_1", *both]))
        eventually(lambda: next(errors) < 0.5)
        children = psutil.Process(process.pid).children(recursive=True)
        process.terminate()
        process.communicate()
    assert process.returncode == 0
    eventually(lambda: not any(command_of(child) for child in children))


def errors_of(positions: Iterator[str]) -> Iterator[float]:
    """How far each position is from where the ball was, in metres."""
    for position in positions:
        time_ns, x, y = position.split()
        yield math.dist((float(x), float(y)), scenario.ball(int(time_ns)))
