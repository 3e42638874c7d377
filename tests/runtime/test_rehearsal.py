"""A rehearsal of a unit in the process that forks units, and what that process may not share with its children."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cfgplan_runtime.children.rehearsal import fill_gaps, rehearse
from cfgplan_runtime.supervision.events import UnitPrinted
from watching import StartRuntime, seen
from world import eventually, source, start, unit

DESCRIPTORS = Path("/dev/fd")


def test_a_rehearsal_leaves_nothing_behind() -> None:
    begun: list[bool] = []
    modules, path, descriptors = {*sys.modules}, list(sys.path), len(list(DESCRIPTORS.iterdir()))
    rehearse(lambda: begun.append(True))
    assert begun
    assert {*sys.modules} == modules
    assert sys.path == path
    assert len(list(DESCRIPTORS.iterdir())) == descriptors


def test_blocks_that_are_taken_after_gaps_were_filled_lie_in_few_pages() -> None:
    def pages() -> int:
        return len({id(block) >> 12 for block in [bytes(64) for _ in range(100)]})

    blocks = [bytes(64) for _ in range(20_000)]
    del blocks[::50]
    assert pages() > 50, "there are gaps"
    taken = fill_gaps()
    assert pages() < 10
    assert len(taken) > 400


def test_no_memory_is_taken_from_an_allocator_that_has_no_pools() -> None:
    code = "from cfgplan_runtime.children.rehearsal import fill_gaps; print(len(fill_gaps()))"
    took = subprocess.check_output(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONMALLOC": "malloc"}, text=True
    )
    assert took == "0\n"


def test_each_unit_has_random_numbers_of_its_own(run_units: StartRuntime) -> None:
    runtime = run_units(source("draw", "image_units.py:draw"))
    runtime.apply(start(*(unit(f"draw.{number}") for number in range(4))))
    eventually(lambda: len(seen(runtime, UnitPrinted)) == 4)
    numbers = [number for event in seen(runtime, UnitPrinted) for number in event.line.split()]
    assert len({*numbers}) == 8


SHARED_LOG = """
import logging, multiprocessing
class Shared(logging.Handler):
    def createLock(self):
        super().createLock()
        self.lock = multiprocessing.RLock()
shared = Shared()
"""


def test_units_start_although_a_preloaded_module_has_a_log_handler_that_python_can_not_renew_after_a_fork(
    run_units: StartRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "shared_log.py").write_text(SHARED_LOG)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    runtime = run_units(source("draw", "image_units.py:draw"), preload=["shared_log"])
    runtime.apply(start(unit("draw.1")))
    eventually(lambda: len(seen(runtime, UnitPrinted)) > 0)
