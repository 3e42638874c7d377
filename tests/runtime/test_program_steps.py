"""How many steps a program is asked for before it has answered the first."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy
import pytest
from cfgplan_runtime.children.messages import UnitOrder
from cfgplan_runtime.children.program import MOST_IN_FLIGHT, ProgramCode

SILENT = """\
import sys, time
body = b"\\x81\\xa5ready\\xc3"
payload = len(body).to_bytes(4, "little") + body
sys.stdout.buffer.write(b"\\xc1CFG" + len(payload).to_bytes(4, "little") + payload)
sys.stdout.buffer.flush()
while sys.stdin.buffer.read1(1 << 20):
    pass
"""


@contextmanager
def program(folder: Path, queue: int) -> Iterator[ProgramCode]:
    """A program that reads everything and answers nothing."""
    (folder / "silent.py").write_text(SILENT)
    order = UnitOrder(
        unit="u.1", source=f"program:{sys.executable} silent.py", params={}, inputs=["x"], outputs=["y"], start="all",
        tolerance_ns=0, period_ns=None, queue=queue, blocks=False, state_name=None, state=None, memory_bytes=None,
        format="msgpack", folder=str(folder),
    )  # fmt: skip
    code = ProgramCode(order, lambda fault: pytest.fail(str(fault)))
    try:
        yield code
    finally:
        code.close()


@pytest.mark.parametrize(
    ("size", "queue", "most"),
    [(10, 256, MOST_IN_FLIGHT), (10, 8, 8), (460_800, 256, 3), (4_000_000, 256, 2), (460_800, 1, 1)],
)
def test_a_program_has_few_large_steps_at_once(tmp_path: Path, size: int, queue: int, most: int) -> None:
    with program(tmp_path, queue) as code:
        asked = 0
        while asked < most:
            while code.is_sending:
                code.flush()
            assert code.has_room
            code.ask({"x": numpy.zeros(size, numpy.uint8)}, asked, None)
            asked += 1
        while code.is_sending:
            code.flush()
        assert not code.has_room
