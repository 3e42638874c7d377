"""Small libraries and the units of them, for the tests of the runtime."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import ToChild
from cfgplan_runtime.children.unit_child import UnitChild
from cfgplan_runtime.children.unit_order import unit_order

from cfgplan.domain import (
    ChangeSet,
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

RESULT = Target("result", "Y", "/result")
PATIENCE_S = 60.0
"""Far longer than anything takes on the slowest machine."""


def source(label: str = "count", code: str = "count", *, rate_hz: float = 200) -> Transformation:
    return Transformation(label, outputs=(OutputPort("n", "N"),), source=code_of(code), run=RunOptions(rate_hz=rate_hz))


def worker(
    label: str = "work",
    code: str = "same",
    *,
    inputs: tuple[str, ...] = ("x",),
    outputs: tuple[str, ...] = ("y",),
    run: RunOptions | None = None,
    **params: object,
) -> Transformation:
    return Transformation(
        label,
        tuple(InputPort(name, "N") for name in inputs),
        tuple(OutputPort(name, "Y") for name in outputs),
        source=code_of(code),
        params=params,
        run=run or RunOptions(),
    )


def code_of(code: str) -> str:
    """The source of unit code that is in `running_units.py`, if `code` names no other file."""
    return code if ":" in code else f"running_units.py:{code}"


def unit(unit_id: str, *, topic: str | None = None, port: str = "y", **feeds: str) -> ComputationUnit:
    """A unit `label.N`; `x="count.1/n"` feeds its input x."""
    return ComputationUnit(
        unit_id,
        unit_id.rpartition(".")[0],
        tuple(Subscription(name, Stream.parse(stream)) for name, stream in feeds.items()),
        () if topic is None else (Publication(port, topic),),
    )


def start(*units: ComputationUnit) -> ChangeSet:
    return ChangeSet(started=units)


def eventually(is_so: Callable[[], bool]) -> None:
    """Wait until something is so; fails if it never is."""
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline, "it never came to be"
        time.sleep(0.01)


@contextmanager
def child_of(transformation: Transformation) -> Iterator[UnitChild]:
    """A unit in this process."""
    ours, theirs = socket.socketpair()
    order = unit_order(f"{transformation.label}.1", transformation, None)
    order = msgspec.structs.replace(order, folder=str(Path(__file__).parent))
    child = UnitChild(order, ControlConnection(theirs, ToChild))
    try:
        yield child
    finally:
        child.close()
        for end in (ours, theirs):
            end.close()
