"""The real `launch` and `launch_ros` read what `cfgplan export launch` writes, and start what it says.

No wheel has them. They are taken from the Python that has rclpy, or from the folder CFGPLAN_TEST_LAUNCH.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import psutil
import pytest
from operated_world import PATIENCE_S, eventually
from ros2_venv import PYTHON
from ros2_words import ENVIRONMENT, Observer, command_of, running_nodes, write_words

from cfgplan.cli import main

HERE = Path(__file__).parent
DRIVERS = """\
<launch>
  <arg name="beginning" default="0"/>
  <node pkg="talking" exec="talking.py" args="talker" name="driver">
    <param name="first" value="$(var beginning)"/>
    <remap from="chatter" to="/driven"/>
  </node>
</launch>
"""
COMPONENTS = ENVIRONMENT.replace("node:./talking.py talker", "component:talking/talking::Talker@both").replace(
    "node:./talking.py shouter", "component:talking/talking::Shouter@both"
)


@pytest.fixture
def workspace(container_package: Path) -> Path:
    """The workspace of `container_package` as `ament_index_python` finds packages, with one of the tests' nodes."""
    folder = container_package.parents[2]
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (folder / "lib" / "talking").mkdir()
    shutil.copy(HERE / "talking.py", folder / "lib" / "talking")
    for package in ("talking", "rclcpp_components"):
        (index / package).touch()
    return folder


@pytest.fixture(autouse=True)
def real_launch(composition: Path, workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The packages of launch where Python and ament look for them, and the ROS Python first in PATH."""
    folder = os.environ.get("CFGPLAN_TEST_LAUNCH", "")
    packages = [folder, str(composition), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, packages)))
    prefixes = [str(workspace), folder, os.environ.get("AMENT_PREFIX_PATH", "")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(filter(None, prefixes)))
    monkeypatch.setenv("PATH", f"{PYTHON.parent}{os.pathsep}{os.environ['PATH']}")
    tried = subprocess.run([PYTHON, "-c", "import launch_xml, launch_ros.actions"], capture_output=True, check=False)
    if tried.returncode:
        pytest.skip("launch of ROS 2 is not installed: no wheel has it (CFGPLAN_TEST_LAUNCH)")


@contextmanager
def launching(file: Path) -> Iterator[psutil.Process]:
    """A launched file; SIGINT ends it well."""
    log = file.with_suffix(".log")
    command = [str(PYTHON), str(HERE / "launching.py"), str(file)]
    with log.open("w") as said, subprocess.Popen(command, stdout=said, stderr=said, start_new_session=True) as process:
        try:
            yield psutil.Process(process.pid)
            process.send_signal(signal.SIGINT)
            status = process.wait(PATIENCE_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert status == 0, log.read_text()


def remaps_of(process: psutil.Process) -> Mapping[str, Mapping[str, str]]:
    """By the names of the nodes that a process has started: their remappings, from the command lines."""
    found = {}
    for child in process.children(recursive=True):
        words = command_of(child)
        rules = (word.split(":=", 1) for flag, word in pairwise(words) if flag == "-r")
        remaps = {own.removeprefix("~/"): other for own, other in rules}
        name = remaps.pop("__node", None)
        remaps.pop("__ns", None)
        if name is not None:
            found[name] = remaps
    return found


def test_an_exported_file_and_the_one_that_it_includes_are_launched(tmp_path: Path, observer: Observer) -> None:
    env, out = write_words(tmp_path), tmp_path / "launches" / "robot.launch.py"
    out.parent.mkdir()
    drivers = tmp_path / "drivers.launch.xml"
    drivers.write_text(DRIVERS)
    said = f"{drivers} beginning:=5000"
    assert main(["export", "launch", str(env), "--include", said, "--out", str(out)]) == 0
    with launching(out) as launch:
        assert next(observer.listen("/shout")).endswith("!")
        assert int(next(observer.listen("/driven"))) >= 5000
        eventually(lambda: {"/talker_1", "/shouter_1", "/driver"} <= {*observer.look()["nodes"]})
        launched = dict(remaps_of(launch))
        children = launch.children(recursive=True)
    assert launched.pop("driver") == {"chatter": "/driven"}
    assert not any(child.is_running() for child in children)
    with running_nodes(env) as run:
        started = remaps_of(psutil.Process(run.pid))
    assert {name: {*remaps} for name, remaps in launched.items()} == {
        name: {*remaps} for name, remaps in started.items()
    }
    assert launched["talker_1"]["chatter"] == started["talker_1"]["chatter"] == "/talker_1/out/words"


def test_containers_of_an_exported_file_are_loaded_with_its_components(tmp_path: Path, observer: Observer) -> None:
    """The container is the tests' own; no rclcpp is to be had."""
    env, out = tmp_path / "env.yaml", tmp_path / "robot.launch.py"
    env.write_text(COMPONENTS)
    assert main(["export", "launch", str(env), "--out", str(out)]) == 0
    with launching(out):
        assert int(next(observer.listen("/shout")).removesuffix("!")) >= 1000
        eventually(lambda: {"/talker_1", "/shouter_1", "/both"} <= {*observer.look()["nodes"]})
