"""The paper's case (its Table I) on ROS 1: nodes find a ball, a lost one is replaced, and a fusion takes over."""

from __future__ import annotations

import math
import os
import shutil
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from football import scenario
from operated_world import await_event, eventually, running
from warm import command
from words import await_pid, messages, node_names, pid_of

NAO = Path(__file__).parents[2] / "models" / "nao"
ROSPY = "import sys; sys.path.append('/usr/lib/python3/dist-packages'); import rospy, cv2"
PIFF = ("bottom_cam", "subsampler", "segmenter", "ball_detector", "self_localization", "ball_localization")


@pytest.fixture
def nao(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The world of the case, with an environment file to be edited; its nodes run by this Python."""
    tried = subprocess.run([sys.executable, "-c", ROSPY], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"rospy can't be used by the Python that runs the tests: {tried.stderr.strip().splitlines()[-1]}")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    shutil.copytree(NAO, tmp_path / "nao")
    path = tmp_path / "nao" / "ros1" / "env.yaml"
    path.write_text((NAO / "ros1" / "1-piff-registered.yaml").read_text())
    return path


@pytest.mark.usefixtures("warm_cfgplan")
def test_table_one_runs_as_nodes_is_mended_and_goes_over_to_the_fusion(nao: Path) -> None:
    with running("--middleware", "ros1", nao, call=command) as process:
        await_event(process, "Running")
        with messages("/result") as received:
            errors = errors_of(received)
            eventually(lambda: next(errors) < 0.5)
            before = {label: await_pid(f"/{label}_piff_1") for label in PIFF}
            os.kill(before["segmenter"], signal.SIGKILL)
            await_event(process, "UnitDied", unit="segmenter(piff).1")
            eventually(lambda: pid_of("/segmenter_piff_1") not in (0, before["segmenter"]))
            after = {label: await_pid(f"/{label}_piff_1") for label in PIFF}
            assert {label for label in PIFF if before[label] != after[label]} == {"segmenter"}
            eventually(lambda: next(errors) < 0.5)

            nao.write_text((NAO / "ros1" / "5-fusion-required.yaml").read_text())
            both = {f"/{label}_{robot}_1" for label in PIFF for robot in ("piff", "puff")}
            eventually(lambda: {"/fuse_ball_pos_1", *both} <= node_names())
            eventually(lambda: next(errors) < 0.5)
        process.terminate()
        process.communicate()
    assert process.returncode == 0


def errors_of(received: Iterator[bytes]) -> Iterator[float]:
    """How far each position of a PoseWithCovarianceStamped is from where the ball was, in metres."""
    for message in received:
        _, seconds, nanoseconds, frame = struct.unpack_from("<4I", message)
        x, y = struct.unpack_from("<2d", message, 16 + frame)
        yield math.dist((x, y), scenario.ball(seconds * 10**9 + nanoseconds))
