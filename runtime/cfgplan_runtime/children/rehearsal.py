"""A rehearsal of a unit, in the process that forks units.

Python changes its own memory while code runs for the first times: it specializes the code, and fills caches. A child
that is forked afterwards shares these pages, instead of having its own copy of each. A child also copies each page in
which it takes a free block beside other objects, so the nursery takes these blocks before it forks.
"""

from __future__ import annotations

import gc
import socket
import sys
from collections.abc import Callable
from pathlib import Path

from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import Activate, Feed, Finish, FromChild, Serve, ToChild, UnitOrder
from cfgplan_runtime.children.unit_child import UnitChild
from cfgplan_runtime.streams.channel import Sender, socket_pair
from cfgplan_runtime.streams.element import Outgoing
from cfgplan_runtime.streams.payload import PayloadEncoder

_TIMES = 20
"""Python 3.11 specializes code after 8 calls."""
_POOL, _POOL_HEAD, _LARGEST_BLOCK = 16_384, 48, 512
"""Bytes of a pool of Python's allocator, of its head, and of its largest blocks. All blocks of a pool have one size."""
_MOST_TAKEN = 1 << 20
"""At most this many bytes are taken in blocks of one size."""


def unchanged(x: object) -> object:
    """The unit code of the rehearsal."""
    return x


def rehearse(begin: Callable[[], None]) -> None:
    """Let units in this process start, take an element, send it on, and end. `begin` is called before each."""
    file = Path(__file__)
    order = UnitOrder(
        unit="rehearsal",
        source=f"{file.name}:{unchanged.__name__}",
        params={},
        inputs=["x"],
        outputs=["y"],
        start="all",
        tolerance_ns=0,
        period_ns=None,
        queue=10,
        blocks=False,
        state_name=None,
        state=None,
        memory_bytes=None,
        folder=str(file.parent),
    )
    modules, path = {*sys.modules}, list(sys.path)
    for _ in range(_TIMES):
        begin()
        _run(order)
        sys.path[:] = path
        for name in sys.modules.keys() - modules:
            del sys.modules[name]


def fill_gaps() -> list[bytes]:
    """Take the free blocks of pools that are in use. Returns them in a list; they are free again once it is deleted.

    Returns an empty list if Python uses an allocator without pools (`PYTHONMALLOC=malloc`).
    """
    if not sys.getallocatedblocks():
        return []
    gc.collect()  # empties Python's lists of free objects
    taken = list[bytes]()
    head = sys.getsizeof(b"")
    for size in range(_POOL_HEAD, _LARGEST_BLOCK + 1, 16):
        in_a_row = last = 0
        for _ in range(_MOST_TAKEN // size):
            block = bytes(size - head)
            taken.append(block)
            in_a_row, last = in_a_row + 1 if id(block) == last + size else 0, id(block)
            if in_a_row >= (_POOL - _POOL_HEAD) // size - 2:  # it is the only one in its pool
                break
    return taken


def _run(order: UnitOrder) -> None:
    ours, theirs = socket.socketpair()
    supervisor: ControlConnection[FromChild] = ControlConnection(ours, FromChild)
    unit = UnitChild(order, ControlConnection(theirs, ToChild))
    (producer, taken), (given, consumer) = socket_pair(), socket_pair()
    supervisor.send(Serve("y", 1, queue=10, blocks=False), [given])
    supervisor.send(Feed("x", 0), [taken])
    supervisor.send(Activate())
    Sender(producer, queue=10, blocks=False).offer(Outgoing(0, 0, PayloadEncoder().encode(1)))
    supervisor.send(Finish())
    unit.run()
    supervisor.close()
    unit.close()
    for end in (producer, consumer, theirs):
        end.close()
