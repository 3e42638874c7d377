"""Nodes of ROS 1 keep what a middleware promises."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.testing import Bench, check_middleware
from unit_signals import signal_unit
from words import NODES, gives, published_topics

from cfgplan.domain import InputPort, OutputPort, Transformation
from cfgplan.ros.node_api import SilentError, asked, peer

TALKER = Transformation(
    "talker",
    (),
    (OutputPort("words", "Word", remap="chatter"),),
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
pytestmark = pytest.mark.usefixtures("warm_nodes")


def answering_units() -> set[str]:
    """The units whose nodes answer, whatever the run believes."""
    master, found = peer(os.environ["ROS_MASTER_URI"]), set()
    for label in ("talker", "shouter", "mute"):
        for number in (1, 2):
            with suppress(SilentError):
                node = peer(str(asked(master, "/test", "lookupNode", f"/{label}_{number}")))
                asked(node, "/test", "getPid")
                found.add(f"{label}.{number}")
    return found


@contextmanager
def bench() -> Iterator[Bench]:
    with Runtime(backend=lambda: Ros1Backend(folder=NODES.parent)) as runtime:

        def crash(unit: str) -> None:
            signal_unit(runtime, unit)

        yield Bench(runtime, TALKER, SHOUTER, MUTE, crash, answering_units, published_topics, gives)


def test_conformance() -> None:
    check_middleware(bench)
