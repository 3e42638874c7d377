"""A domain of each worker's own on this computer, and the Python that has rclpy; without one the tests are skipped.

CFGPLAN_TEST_ROS2 is a venv with the Jazzy wheels; `.ci/run` makes one in the cache folder, where it is looked for too.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from ros2_venv import PYTHON, VENV, lacks_ros

if TYPE_CHECKING:
    from cfgplan_runtime import Runtime
    from ros2_words import Observer

sys.path.append(str(Path(__file__).parents[1] / "operating"))
sys.path.append(str(Path(__file__).parents[2] / "models" / "nao"))
_DOMAINS = range(20, 100)


@pytest.fixture(scope="session", autouse=True)
def domain() -> Iterator[int]:
    """A domain that no other process of tests on this computer uses meanwhile; skips where nodes can't be run."""
    if reason := lacks_ros():
        pytest.skip(reason)
    for domain in _DOMAINS:
        with (Path(tempfile.gettempdir()) / f"cfgplan-test-domain-{domain}").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    raise RuntimeError("every domain is in use")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run these tests one after the other: starts of several systems of ROS side by side take each other's time."""
    here = Path(__file__).parent
    for item in items:
        if item.path.parent == here:
            item.add_marker(pytest.mark.xdist_group("ros2real"))


@pytest.fixture(autouse=True)
def surroundings(domain: int, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith(("ROS_", "FASTRTPS_", "FASTDDS_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("log")))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    monkeypatch.setenv("CFGPLAN_ROS_PYTHON", str(PYTHON))


@pytest.fixture(scope="session")
def composition(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the package `composition_interfaces`."""
    return _made("composition_interfaces", tmp_path_factory)


@pytest.fixture
def statistics(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package `statistics_msgs` for all processes of the test."""
    folder = _made("statistics_msgs", tmp_path_factory)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))


def _made(package: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a package that no wheel has; it is made once for a venv."""
    if shutil.which("g++") is None:
        pytest.skip(f"there is no g++ to compile {package}")
    script = Path(__file__).with_name("making_package.py")
    folder = VENV / "cfgplan-tests" / hashlib.sha256(script.read_bytes()).hexdigest()[:12] / package
    if not folder.exists():
        made = tmp_path_factory.mktemp("made")
        subprocess.run([PYTHON, script, package, made], check=True, capture_output=True, text=True)
        folder.parent.mkdir(exist_ok=True, parents=True)
        shutil.move(made, folder)
    return folder


@pytest.fixture
def container_package(composition: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace whose package `rclcpp_components` has the tests' container."""
    folder = tmp_path / "workspace" / "lib" / "rclcpp_components"
    folder.mkdir(parents=True)
    for name in ("talking.py", "containing.py"):
        shutil.copy(Path(__file__).with_name(name), folder)
    container = folder / "component_container"
    text = (folder / "containing.py").read_text().replace("#!/usr/bin/env python3", f"#!{PYTHON}", 1)
    container.write_text(text)
    container.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "workspace"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(composition), os.environ.get("PYTHONPATH", "")]))
    return container


@pytest.fixture
def observer() -> Iterator[Observer]:
    """A node of another process that listens, and looks at the graph."""
    from ros2_words import observing

    with observing() as observer:
        yield observer


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    """A runtime of the nodes of talking.py."""
    from cfgplan_runtime import Runtime
    from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
    from ros2_words import NODES

    with Runtime(backend=lambda: Ros2Backend(folder=NODES.parent)) as runtime:
        yield runtime
