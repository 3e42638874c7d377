"""Nodes of ROS 1 keep what a middleware promises."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.ros1.ros1_backend import Ros1Backend
from cfgplan_runtime.testing import Bench, check_middleware
from unit_signals import signal_unit
from words import NODES, gives, node_names, pid_of, published_topics

from cfgplan.domain import InputPort, OutputPort, Transformation

TALKER = Transformation(
    "talker",
    (),
    (OutputPort("words", "Word", remap="chatter"),),
    source="node:./talking.py talker",
    params={"rate": 20},
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
    labels = {one.label for one in (TALKER, SHOUTER, MUTE)}
    named = [(name, *name[1:].rpartition("_")) for name in node_names()]
    return {f"{label}.{number}" for name, label, _, number in named if label in labels and pid_of(name)}


@contextmanager
def bench() -> Iterator[Bench]:
    with Runtime(backend=lambda: Ros1Backend(folder=NODES.parent)) as runtime:

        def crash(unit: str) -> None:
            signal_unit(runtime, unit)

        yield Bench(runtime, TALKER, SHOUTER, MUTE, crash, answering_units, published_topics, gives)


def test_conformance() -> None:
    check_middleware(bench)
