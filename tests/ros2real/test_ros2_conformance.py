"""Nodes of ROS 2 keep what a middleware promises."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil
from cfgplan_runtime import Runtime
from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
from cfgplan_runtime.testing import Bench, check_middleware
from ros2_words import NODES, Observer, observing
from unit_signals import signal_unit

from cfgplan.domain import InputPort, OutputPort, Transformation

STRING = "std_msgs/String"
TALKER = Transformation(
    "talker",
    (),
    (OutputPort("words", "Word", type=STRING, remap="chatter"),),
    source="node:./talking.py talker",
    params={"rate": 100},
)
SHOUTER = Transformation(
    "shouter",
    (InputPort("quiet", "Word"),),
    (OutputPort("loud", "LoudWord", remap="~loud"),),
    source="node:./talking.py shouter",
)
MUTE = Transformation("mute", SHOUTER.inputs, SHOUTER.outputs, source="node:./talking.py mute")


def living_units() -> set[str]:
    """The units whose processes there are, whatever the run believes."""
    found = set()
    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
            if child.status() != psutil.STATUS_ZOMBIE:
                found |= {word.removeprefix("__node:=") for word in child.cmdline() if word.startswith("__node:=")}
                found |= {child.name()} & {"talker_1", "talker_2", "shouter_1", "shouter_2"}  # it has waited before
    return {name.replace("_", ".") for name in found}


@contextmanager
def bench() -> Iterator[Bench]:
    with observing() as observer, Runtime(backend=lambda: Ros2Backend(folder=NODES.parent)) as runtime:

        def crash(unit: str) -> None:
            signal_unit(runtime, unit)

        def topics() -> list[str]:
            return published_topics(observer)

        yield Bench(runtime, TALKER, SHOUTER, MUTE, crash, living_units, topics, observer.gives)


def published_topics(observer: Observer) -> list[str]:
    """The topics that the graph has once it knows the run and tells the same twice: it hears of changes later."""
    before, now = None, observer.look()
    while now != before or not any("cfgplan_relay" in node for node in now["nodes"]):
        time.sleep(0.5)
        before, now = now, observer.look()
    return now["topics"]


def test_conformance() -> None:
    check_middleware(bench)
