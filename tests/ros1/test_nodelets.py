"""Nodelets of ROS 1: C++ classes that are loaded into a manager, led to other sources, unloaded, and made anew."""

from __future__ import annotations

import os
import signal
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path

import psutil
import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.ros1.tcpros import answered
from cfgplan_runtime.testing import Bench, check_middleware
from operated_world import eventually
from unit_signals import signal_unit, unit_pid
from words import NODES, await_pid, gives, messages, pid_of, published_topics

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.ros.node_api import SilentError

LIBRARIES = sorted(Path("/usr/lib").glob("*/libimage_proc.so.*"))
HAS_NODELETS = Path("/usr/lib/nodelet/nodelet").exists() and LIBRARIES
pytestmark = [
    pytest.mark.skipif(
        not HAS_NODELETS, reason="no nodelets here (Debian: apt install libnodeletlib-tools ros-image-proc)"
    ),
    pytest.mark.usefixtures("warm_nodes"),
]
PACKAGE = """\
<package>
  <name>eyes</name><version>1.0.0</version><description>Eyes</description>
  <maintainer email="eyes@example.org">Eyes</maintainer><license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend><run_depend>nodelet</run_depend>
  <export><nodelet plugin="${prefix}/nodelets.xml"/></export>
</package>
"""
PLUGINS = """\
<library path="lib/libimage_proc">
  <class name="eyes/resize" type="image_proc::ResizeNodelet" base_class_type="nodelet::Nodelet">
    <description>Makes pictures smaller.</description>
  </class>
</library>
"""
HALVER = Transformation(
    "halver",
    (InputPort("raw", "Picture", type="sensor_msgs/Image", remap="image"),),
    (OutputPort("half", "Half", type="sensor_msgs/Image", remap="~image"),),
    source="nodelet:eyes/resize",
    params={"scale_height": 0.5, "scale_width": 0.5},
)
BLIND = replace(HALVER, label="blind", source="nodelet:eyes/nothing")


def camera(size: int) -> Transformation:
    raw = OutputPort("raw", "Picture", remap="image_raw")
    source, params = "node:./talking.py camera", {"size": size}
    return Transformation(f"camera{size}", (), (raw,), source=source, params=params)


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that offers a class of image_proc: Debian's own leaves out the file that says so."""
    (tmp_path / "eyes").mkdir()
    (tmp_path / "lib").mkdir()
    (tmp_path / "eyes" / "package.xml").write_text(PACKAGE)
    (tmp_path / "eyes" / "nodelets.xml").write_text(PLUGINS)
    (tmp_path / "lib" / "libimage_proc.so").symlink_to(LIBRARIES[0])
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}:/usr/share")
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path))


def made() -> Runtime:
    return Runtime(backend=lambda: Ros1Backend(folder=NODES.parent))


def loaded(runtime: Runtime) -> set[str]:
    """The nodelets that the run's own manager says it has."""
    with suppress(SilentError, OSError):
        answer = answered(os.environ["ROS_MASTER_URI"], f"/cfgplan_nodelets_{runtime.id}/list", b"")
        return {text.decode() for text in _texts(answer)}
    return set()


def _texts(answer: bytes) -> Iterator[bytes]:
    at = 4
    while at < len(answer):
        (size,) = struct.unpack_from("<I", answer, at)
        yield answer[at + 4 : at + 4 + size]
        at += 4 + size


def width_of(message: bytes) -> int:
    """The width of an Image, behind its header and height."""
    (frame,) = struct.unpack_from("<I", message, 12)
    return int(struct.unpack_from("<I", message, 20 + frame)[0])


def halver(source: str) -> ComputationUnit:
    feed = Subscription("raw", Stream(source, "raw"))
    return ComputationUnit("halver.1", "halver", (feed,), (Publication("half", "/half"),))


def test_a_nodelet_is_loaded_rewired_lost_with_its_manager_loaded_again_and_unloaded() -> None:
    small, large = camera(100), camera(140)
    target = Target("half", "Half", "/half")
    with made() as runtime:
        started = (ComputationUnit("small.1", small.label), halver("small.1"))
        runtime.apply(ChangeSet(started, added_transformations=(small, large, HALVER), added_targets=(target,)))
        manager = unit_pid(runtime, "halver.1")
        with messages("/half") as pictures:
            assert width_of(next(pictures)) == 50
            another = (ComputationUnit("large.1", large.label),)
            runtime.apply(ChangeSet(another, rewired=(halver("large.1"),), stopped=("small.1",)))
            assert 70 in map(width_of, islice(pictures, 500))
            assert (runtime.pid("halver.1"), loaded(runtime)) == (manager, {"/halver_1"})

            os.kill(manager, signal.SIGKILL)
            eventually(lambda: "halver.1" not in runtime.environment.unit)
            runtime.apply(ChangeSet((halver("large.1"),)))
            assert runtime.pid("halver.1") != manager
            assert width_of(next(pictures)) == 70
        (seen,) = (one for one in runtime.observe() if one.unit == "halver.1")
        assert seen.labor_us > 0
        runtime.apply(ChangeSet(stopped=("halver.1",), removed_targets=("half",)))
        assert loaded(runtime) == set()
        assert await_pid(f"/cfgplan_nodelets_{runtime.id}"), "the manager stays for the next one"
        processes = psutil.Process().children(recursive=True)
    eventually(lambda: not any("nodelet" in one.name() for one in processes if one.is_running()))


@contextmanager
def bench() -> Iterator[Bench]:
    with made() as runtime:

        def running() -> set[str]:
            nodelets = {name.removeprefix("/").replace("_", ".") for name in loaded(runtime)}
            return nodelets | {f"camera100.{n}" for n in (1, 2) if pid_of(f"/camera100_{n}")}

        def crash(unit: str) -> None:
            signal_unit(runtime, unit)

        yield Bench(runtime, camera(100), HALVER, BLIND, crash, running, published_topics, gives)


def test_nodelets_conform() -> None:
    check_middleware(bench)
