"""The cost of changes with units as processes of cfgplan, nodes of ROS 1 or nodelets, side by side in one run.

    python experiments/ros1/figures.py [--times 10]

A worker between a source of 100 Hz and a topic is loaded, connected to another source, unloaded, and killed under the
life-cycle. Then the relay's share of a core is measured. Needs ROS 1 (see `.ci/run`).
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import psutil
from cfgplan_runtime import Manager, Policy, Runtime, subscribe
from cfgplan_runtime.lifecycle.back_off import BackOffRules
from cfgplan_runtime.processes.child_process import cpu_us
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.ros1.tcpros import MessageReader, subscribed

from cfgplan import api
from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
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

HERE = Path(__file__).parent
PATIENCE_S = 60.0
TOPIC = Target("result", "Y", "/result")
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
  <class name="eyes/resize" type="image_proc::ResizeNodelet" base_class_type="nodelet::Nodelet"/>
</library>
"""
LABOR_US, UPKEEP_US = 1_000_000, 10_000


def library(kind: str, size: int = 10) -> tuple[Transformation, ...]:
    """Two sources and a worker: processes, nodes or nodelets."""
    ports = {"first": OutputPort("n", "N"), "second": OutputPort("n", "M")}
    sources = [
        Transformation(
            label,
            (),
            (port,),
            LABOR_US,
            UPKEEP_US,
            source="nodes.py:count" if kind == "processes" else "node:./nodes.py camera",
            params={} if kind == "processes" else {"rate": 100, "size": size},
            run=RunOptions(rate_hz=100),
        )
        for label, port in ports.items()
    ]
    code = {"processes": "nodes.py:work", "nodes": "node:./nodes.py worker", "nodelets": "nodelet:eyes/resize"}[kind]
    is_nodelet = kind == "nodelets"
    x = InputPort("x", "N", remap="image" if is_nodelet else None)
    y = OutputPort("y", "Y", remap="~image" if is_nodelet else None)
    params = {"scale_height": 1.0, "scale_width": 1.0} if is_nodelet else {}
    return (*sources, Transformation("work", (x,), (y,), LABOR_US, UPKEEP_US, source=code, params=params))


def runtime_of(kind: str) -> Runtime:
    return Runtime(folder=HERE) if kind == "processes" else Runtime(backend=lambda: Ros1Backend(folder=HERE))


def worker(source: str) -> ComputationUnit:
    return ComputationUnit(
        "work.1", "work", (Subscription("x", Stream(source, "n")),), (Publication("y", TOPIC.topic),)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=10)
    times = parser.parse_args().times
    kinds = ("processes", "nodes", "nodelets")
    with ros_of_its_own():
        changed = {kind: changes(kind, times) for kind in kinds}
        silent = {kind: silences(kind, times) for kind in kinds}
        relay = {size: relay_cost(size) for size in (10, 800)}
    print(f"\nload {os.getloadavg()[0]:.0f}; ms, medians of {times} (worst)")
    print("| what | processes | nodes (rospy) | nodelets |\n|---|---|---|---|")
    for what in ("load", "rewire", "unload"):
        print(f"| {what} | {' | '.join(shown(changed[kind][what]) for kind in kinds)} |")
    print(f"| `kill -9`: time without results | {' | '.join(shown(silent[kind]) for kind in kinds)} |")
    for size, us in relay.items():
        print(f"the relay takes {us:.0f} us of CPU for a picture of {size * size} B, read once and written once")


def shown(seconds: list[float]) -> str:
    return f"{statistics.median(seconds) * 1e3:.0f} ({max(seconds) * 1e3:.0f})"


def changes(kind: str, times: int) -> dict[str, list[float]]:
    """The seconds that each change took, until it was carried out."""
    taken: dict[str, list[float]] = {"load": [], "rewire": [], "unload": []}
    with runtime_of(kind) as runtime:
        sources = (ComputationUnit("first.1", "first"), ComputationUnit("second.1", "second"))
        runtime.apply(ChangeSet(sources, added_transformations=library(kind), added_targets=(TOPIC,)))
        for _ in range(times):
            for what, change_set in (
                ("load", ChangeSet((worker("first.1"),))),
                ("rewire", ChangeSet(rewired=(worker("second.1"),))),
                ("unload", ChangeSet(stopped=("work.1",))),
            ):
                began_s = time.monotonic()
                runtime.apply(change_set)
                taken[what].append(time.monotonic() - began_s)
    return taken


def silences(kind: str, times: int) -> list[float]:
    """The seconds without results after each kill of the worker, with the life-cycle."""
    first, _, work = library(kind)
    world = api.world(Environment((), (first, work), (TOPIC,)), horizon_s=600)
    policy = Policy(back_off=BackOffRules(alone_s=0.0))
    seen = []
    with runtime_of(kind) as runtime, Manager(world, runtime, policy=policy) as manager:
        manager.settle(PATIENCE_S)
        with arrivals(kind, runtime) as came:
            for _ in range(times):
                start = len(came)
                eventually(lambda start=start: len(came) > start + 50)
                old, start = runtime.pid("work.1") or 0, len(came) - 1
                os.kill(old, 9)
                eventually(lambda old=old: runtime.pid("work.1") not in (None, old))
                before = len(came)
                eventually(lambda before=before: len(came) > before + 20)
                seen.append(max(b - a for a, b in pairwise(came[start:])))
    return seen


def relay_cost(size: int) -> float:
    """The CPU time of the relay in microseconds for a message of this size, led to one listener."""
    first, _, _ = library("nodes", size)
    unit = ComputationUnit("first.1", "first", (), (Publication("n", TOPIC.topic),))
    with runtime_of("nodes") as runtime:
        runtime.apply(ChangeSet((unit,), added_transformations=(first,), added_targets=(TOPIC,)))
        relays = [child for child in psutil.Process().children() if "topic_relay" in " ".join(child.cmdline())]
        with arrivals("nodes", runtime) as came:
            eventually(lambda: len(came) > 50)
            before_us, count = cpu_us(relays[0].pid) or 0, len(came)
            eventually(lambda: len(came) > count + 300)
            return ((cpu_us(relays[0].pid) or 0) - before_us) / (len(came) - count)


@contextmanager
def arrivals(kind: str, runtime: Runtime) -> Iterator[list[float]]:
    """When elements come on the topic; the list grows."""
    came: list[float] = []
    if kind == "processes":
        with subscribe(TOPIC.topic, run=runtime.id, wait_s=PATIENCE_S) as subscription:
            received = iter(subscription)
            threading.Thread(target=lambda: collect(received, came), daemon=True).start()
            yield came
        return
    end = connected(TOPIC.topic)
    reader = MessageReader(end)
    end.settimeout(PATIENCE_S)
    threading.Thread(target=lambda: collect(messages(reader), came), daemon=True).start()
    yield came
    end.shutdown(socket.SHUT_RDWR)


def collect(received: Iterator[object], came: list[float]) -> None:
    with suppress(OSError, ValueError):  # it is closed while the thread waits
        note = came.append
        for _ in received:
            note(time.monotonic())


def messages(reader: MessageReader) -> Iterator[object]:
    while not reader.has_ended:
        yield from reader.read()


def connected(topic: str) -> socket.socket:
    """Return a connection to the publisher of a topic."""
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
def ros_of_its_own() -> Iterator[None]:
    """A master's port, logs, and a package that declares a nodelet of image_proc, as Debian's own does not."""
    with tempfile.TemporaryDirectory() as name, socket.socket() as free:
        folder = Path(name)
        for made in ("eyes", "lib"):
            (folder / made).mkdir()
        (folder / "eyes" / "package.xml").write_text(PACKAGE)
        (folder / "eyes" / "nodelets.xml").write_text(PLUGINS)
        (folder / "lib" / "libimage_proc.so").symlink_to(next(Path("/usr/lib").glob("*/libimage_proc.so.*")))
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        os.environ |= {
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
            "ROS_LOG_DIR": name,
            "ROS_PACKAGE_PATH": f"{name}:/usr/share",
            "CMAKE_PREFIX_PATH": name,
        }
        yield


def eventually(is_so: Callable[[], object]) -> None:
    """Wait until something is so. Raises TimeoutError."""
    end_s = time.monotonic() + PATIENCE_S
    while not is_so():
        if time.monotonic() > end_s:
            raise TimeoutError("it never came to be")
        time.sleep(0.002)


if __name__ == "__main__":
    main()
