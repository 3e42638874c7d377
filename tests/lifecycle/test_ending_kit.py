"""The conformance kit catches a runtime that breaks a promise about the end of unit code. Real processes.

`test_embedding.py` has the runtime that keeps them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime.processes.process_backend import ProcessBackend
from cfgplan_runtime.supervision.events import UnitCutShort
from cfgplan_runtime.supervision.supervisor import Supervisor
from cfgplan_runtime.testing import ENDING_CHECKS
from kit_mutants import BROKEN
from real_bench import real_bench

from cfgplan.domain import RunOptions

IN_THE_CHILD = {
    "closes no generator": "the code of generator is not let end",
    "calls no close()": "the code of closed is not let end",
    "calls no __exit__": "the code of managed is not let end",
    "runs nothing of atexit": "the code of at_exit is not let end",
    "flushes no file": "the code of flushed is not let end",
    "discards what waits": "elements was stopped after",
}
"""Runtimes whose units end in a wrong way, by `kit_mutants.py`, and the promise that each breaks."""
FIRST_BROKEN = {"discards what waits": 1, "does not count": 2, "does not tell": 2, "tells another time": 2}
"""By broken promise: the number of the first check that fails, unless it is check 0."""


def kill_at_once(backend: ProcessBackend, unit: str) -> None:
    child = backend._by_name.get(unit)
    if child is not None:
        child.is_stopping = True
        backend.kill(unit)


def cut_without_count(supervisor: Supervisor, unit: str, after_s: float) -> None:
    supervisor._report(UnitCutShort(unit, after_s, 0))
    supervisor.backend.kill(unit)


def cut_untold(supervisor: Supervisor, unit: str, after_s: float) -> None:  # noqa: ARG001
    supervisor.backend.kill(unit)


def cut_too_early(supervisor: Supervisor, unit: str, after_s: float) -> None:
    supervisor._report(UnitCutShort(unit, after_s / 2, supervisor._records[unit].waiting))
    supervisor.backend.kill(unit)


IN_THE_RUN: dict[str, tuple[str, type, str, Any]] = {
    "kills at once": ("the code of generator is not let end", ProcessBackend, "stop", kill_at_once),
    "does not count": ("0 elements are told as lost", Supervisor, "_cut_short", cut_without_count),
    "does not tell": ("is told 0 times", Supervisor, "_cut_short", cut_untold),
    "tells another time": ("before its `stop` is over", Supervisor, "_cut_short", cut_too_early),
}


@pytest.fixture
def check(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], None]:
    """Return a check of a broken runtime from the first promise that it breaks, each promise in its own runtime."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))

    def run(broken: str) -> None:
        for number, one in enumerate(ENDING_CHECKS[FIRST_BROKEN.get(broken, 0) :]):
            folder = tmp_path / str(number)
            folder.mkdir()
            with real_bench(folder, "units.py:Worker", RunOptions(), preload=["kit_mutants"]) as bench:
                bench.patience_s = 10.0
                one(bench)

    return run


@pytest.mark.parametrize("name", IN_THE_CHILD)
def test_the_kit_catches_units_that_are_not_let_end(
    name: str, check: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(BROKEN, name)
    with pytest.raises(AssertionError, match=IN_THE_CHILD[name]):
        check(name)


@pytest.mark.parametrize("name", IN_THE_RUN)
def test_the_kit_catches_a_runtime_that_ends_units_in_a_wrong_way(
    name: str, check: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    promise, whole, method, broken = IN_THE_RUN[name]
    monkeypatch.setattr(whole, method, broken)
    with pytest.raises(AssertionError, match=promise):
        check(name)
