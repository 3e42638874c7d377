"""The helper that speaks ROS 2 is found, started in another Python, and ends with whoever has started it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import cfgplan_runtime.ros2.host
import msgspec
import psutil
import pytest
from cfgplan_runtime.ros2.host_link import HostLink
from cfgplan_runtime.ros2.ros_python import environment_for, ros_python
from living import lives
from operated_world import eventually

from cfgplan.errors import InputError


class Listening(msgspec.Struct, tag=True):
    rmw: str
    distribution: str
    python: str


def test_the_helper_tells_what_it_speaks_and_takes_leave() -> None:
    link: HostLink[Listening] = HostLink(ros_python(), "cfgplan_test", Listening)
    said = next(link.await_words(60))
    assert said.rmw == "rmw_fastrtps_cpp"
    assert link.close() == 0


def test_the_helper_ends_with_the_process_that_has_started_it() -> None:
    code = (
        "import msgspec, time\n"
        "from cfgplan_runtime.ros2.host_link import HostLink\n"
        "from cfgplan_runtime.ros2.ros_python import ros_python\n"
        "class Listening(msgspec.Struct, tag=True):\n"
        "    rmw: str\n"
        "link = HostLink(ros_python(), 'cfgplan_test', Listening)\n"
        "next(link.await_words(60))\n"
        "print(link.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        helper = psutil.Process(int(owner.stdout.readline()))
        os.kill(owner.pid, signal.SIGKILL)
    eventually(lambda: not lives(helper))


def test_a_named_python_without_rclpy_is_told_with_its_own_words() -> None:
    with pytest.raises(InputError, match=r"--ros-python: .*No module named 'rclpy'"):
        ros_python(sys.executable)


def test_without_any_the_error_names_three_ways(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CFGPLAN_ROS_PYTHON")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError) as caught:
        ros_python()
    told = str(caught.value)
    assert all(way in told for way in ("setup.bash", "RoboStack", "pip install ros-jazzy-rclpy"))


def test_the_version_that_rclpy_is_built_for_is_tried_before_the_python_of_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("CFGPLAN_ROS_PYTHON")
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "_rclpy_pybind11.cpython-399-x86_64-linux-gnu.so").touch()
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"/usr/bin/python3\.99: No such file"):
        ros_python()


def test_children_find_no_python_of_cfgplans_own_venv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VIRTUAL_ENV", sys.prefix)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}/usr/bin")
    found = environment_for("/opt/venv/bin/python")
    assert found["PATH"] == f"/opt/venv/bin{os.pathsep}/usr/bin"
    assert "VIRTUAL_ENV" not in found


def test_what_runs_in_the_users_python_is_read_by_python_3_10() -> None:
    import ast

    room = Path(cfgplan_runtime.ros2.host.__file__).parent
    others = {
        "streams": ("inlet", "element", "meter", "said_qualities"),
        "nodes": ("message_layout", "observed_outputs"),
    }
    beside = [room.parents[1] / folder / f"{name}.py" for folder, names in others.items() for name in names]
    for file in (*room.glob("*.py"), *beside):
        ast.parse(file.read_text(), feature_version=(3, 10))
