"""A worker between two sources of 100 Hz and a topic, for figures of processes, ROS 1, nodelets and ROS 2."""

from __future__ import annotations

import os
import queue
import shutil
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from cfgplan_runtime import Runtime, subscribe
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.ros1.tcpros import MessageReader, subscribed
from cfgplan_runtime.ros2.fast_dds import FastDdsProfiles
from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
from cfgplan_runtime.ros2.ros_python import ros_python
from cfgplan_runtime.supervision.events import Event

from cfgplan.domain import (
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.ros.node_api import SilentError, asked, peer

PROCESSES, ROS1, NODELETS, ROS2 = "processes", "ROS 1", "nodelets", "ROS 2"
PATIENCE_S = 60.0
TOPIC = Target("result", "Y", "/result")
IMAGE = "sensor_msgs/Image"
LABOR_US, UPKEEP_US = 1_000_000, 10_000
SOURCES = (ComputationUnit("first.1", "first"), ComputationUnit("second.1", "second"))
HERE = Path(__file__).parent
_PACKAGE = """\
<package>
  <name>eyes</name><version>1.0.0</version><description>Eyes</description>
  <maintainer email="eyes@example.org">Eyes</maintainer><license>BSD</license>
  <buildtool_depend>catkin</buildtool_depend><run_depend>nodelet</run_depend>
  <export><nodelet plugin="${prefix}/nodelets.xml"/></export>
</package>
"""
_PLUGINS = """\
<library path="lib/libimage_proc">
  <class name="eyes/resize" type="image_proc::ResizeNodelet" base_class_type="nodelet::Nodelet"/>
</library>
"""


# Units.


def library(kind: str, size: int = 10, code: str = "worker", **more: object) -> tuple[Transformation, ...]:
    """Two sources, `first` and `second`, and the worker `work`, with the fields `more`. In ROS 1 a picture has `size`
    squared bytes.
    """
    is_process, typed = kind == PROCESSES, IMAGE if kind == ROS2 else None
    ports = {"first": OutputPort("n", "N", type=typed), "second": OutputPort("n", "M", type=typed)}
    sources = [
        Transformation(
            label,
            (),
            (port,),
            LABOR_US,
            UPKEEP_US,
            source="nodes.py:count" if is_process else "node:./nodes.py camera",
            params={} if is_process else {"rate": 100, "size": 100 if kind == ROS2 else size},
            run=RunOptions(rate_hz=100),
        )
        for label, port in ports.items()
    ]
    source = {PROCESSES: "nodes.py:work", NODELETS: "nodelet:eyes/resize"}.get(kind, f"node:./nodes.py {code}")
    is_nodelet = kind == NODELETS
    work = Transformation(
        "work",
        (InputPort("x", "N", type=typed, remap="image" if is_nodelet else None),),
        (OutputPort("y", "Y", type=typed, remap="~image" if is_nodelet else None),),
        LABOR_US,
        UPKEEP_US,
        source=source,
        params={"scale_height": 1.0, "scale_width": 1.0} if is_nodelet else {},
        run=RunOptions(lifecycle=code == "prepared"),
    )
    return (*sources, replace(work, **more))  # type: ignore[arg-type]


def worker(number: int = 1, source: str = "first.1", *, publishes: bool = True) -> ComputationUnit:
    published = (Publication("y", TOPIC.topic),) if publishes else ()
    return ComputationUnit(f"work.{number}", "work", (Subscription("x", Stream(source, "n")),), published)


def runtime_of(kind: str) -> Runtime:
    """A runtime of units of a kind. No process of ROS 2 waits for a crash, unless a spare is asked for."""
    if kind == PROCESSES:
        return Runtime(folder=HERE / "ros1")
    if kind == ROS2:
        return Runtime(backend=lambda: Ros2Backend(folder=HERE / "ros2", warm=False))
    return Runtime(backend=lambda: Ros1Backend(folder=HERE / "ros1"))


# Elements of the topic come here.


@contextmanager
def arrivals(kind: str, runtime: Runtime) -> Iterator[list[float]]:
    """When results come, by the monotonic clock in seconds; the list grows. ROS 1 has the topic once a worker runs."""
    came: list[float] = []
    if kind == PROCESSES:
        with subscribe(TOPIC.topic, run=runtime.id, wait_s=PATIENCE_S) as subscription:
            received = iter(subscription)
            threading.Thread(target=lambda: _collect(received, came), daemon=True).start()
            yield came
    elif kind == ROS2:
        with _listener() as lines:
            threading.Thread(target=lambda: _append(lines, came), daemon=True).start()
            time.sleep(1.0)  # until the run's nodes know it
            yield came
    else:
        end = _connected(TOPIC.topic)
        reader = MessageReader(end)
        end.settimeout(PATIENCE_S)
        threading.Thread(target=lambda: _collect(_messages(reader), came), daemon=True).start()
        yield came
        end.shutdown(socket.SHUT_RDWR)


@contextmanager
def _listener() -> Iterator[Iterator[float]]:
    """A node of ROS 2 that listens to the topic, outside of the run: yields when messages come, in seconds."""
    python = ros_python(is_known=True)
    command = [python.program, str(HERE / "ros2" / "nodes.py"), "listener", "--ros-args", "-r", f"x:={TOPIC.topic}"]
    with tempfile.TemporaryDirectory() as folder:
        profile = FastDdsProfiles(Path(folder), python.environment).environment("listener")
        environment = {**python.environment, **profile}
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as listener:
            assert listener.stdout is not None
            lines = listener.stdout
            lines.readline()  # it is up
            try:
                yield (int(line) / 1e9 for line in lines if line.strip().isdecimal())
            finally:
                listener.kill()


def _append(lines: Iterator[float], came: list[float]) -> None:
    with suppress(ValueError):  # the pipe is closed while the thread waits
        for at in lines:
            came.append(at)  # noqa: PERF402


def _collect(received: Iterator[object], came: list[float]) -> None:
    with suppress(OSError, ValueError):  # it is closed while the thread waits
        note = came.append
        for _ in received:
            note(time.monotonic())


def _messages(reader: MessageReader) -> Iterator[object]:
    while not reader.has_ended:
        yield from reader.read()


def _connected(topic: str) -> socket.socket:
    """Return a connection to the ROS 1 publisher of a topic."""
    ends = []

    def connects() -> bool:
        with suppress(SilentError, OSError, LookupError):
            master = peer(os.environ["ROS_MASTER_URI"])
            publishers, _, _ = asked(master, "/figures", "getSystemState")
            address = asked(master, "/figures", "lookupNode", dict(publishers)[topic][0])
            ends.append(subscribed(str(address), "/figures", topic)[0])
        return bool(ends)

    eventually(connects)
    return ends[0]


@contextmanager
def ros1_of_its_own() -> Iterator[bool]:
    """A master's port, logs, and a package that declares a nodelet of image_proc, as Debian's own does not.

    Yields whether ROS 1 is installed.
    """
    libraries = [*Path("/usr/lib").glob("*/libimage_proc.so.*")]
    if shutil.which("rosmaster") is None or not libraries:
        yield False
        return
    with tempfile.TemporaryDirectory() as name, socket.socket() as free:
        folder = Path(name)
        for made in ("eyes", "lib"):
            (folder / made).mkdir()
        (folder / "eyes" / "package.xml").write_text(_PACKAGE)
        (folder / "eyes" / "nodelets.xml").write_text(_PLUGINS)
        (folder / "lib" / "libimage_proc.so").symlink_to(libraries[0])
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        os.environ |= {
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
            "ROS_LOG_DIR": name,
            "ROS_PACKAGE_PATH": f"{name}:/usr/share",
            "CMAKE_PREFIX_PATH": name,
        }
        yield True


# Waiting.


def heard(events: queue.SimpleQueue[Event], kind: type[Event]) -> Event:
    """Return the next event of a kind."""
    return next(event for event in iter(lambda: events.get(timeout=PATIENCE_S), None) if isinstance(event, kind))


def eventually(is_so: Callable[[], object]) -> None:
    """Wait until something is so. Raises TimeoutError."""
    end_s = time.monotonic() + PATIENCE_S
    while not is_so():
        if time.monotonic() > end_s:
            raise TimeoutError("it never came to be")
        time.sleep(0.002)
