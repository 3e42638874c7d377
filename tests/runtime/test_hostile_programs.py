"""Programs that break every promise: what each does is told, its unit ends or goes on, and nobody else notices."""

from __future__ import annotations

from contextlib import suppress
from typing import get_args

import psutil
import pytest
from cfgplan_runtime import ApplyError, Patience
from cfgplan_runtime.children.program import NOT_READY
from cfgplan_runtime.supervision.events import (
    Event,
    UnitCutShort,
    UnitDied,
    UnitFailed,
    UnitHung,
    UnitPrinted,
    UnitTooLarge,
)
from program_units import program
from watching import Listener, StartRuntime, seen
from world import eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, RunOptions
from cfgplan.transformations import ProgramFormat

QUICK = Patience(start_s=1.0, stop_s=0.5, kill_s=1.0)
HANG_US = 2_000_000
MOST_BYTES = 300 << 20
"""Far more than the unit and its program take; a flood that is kept would soon be more."""

pytestmark = pytest.mark.parametrize("form", get_args(ProgramFormat))


@pytest.mark.parametrize(
    ("deed", "kind", "part"),
    [
        ("floods with lines", UnitFailed, "y"),
        ("floods with a line", UnitHung, ""),
        ("floods with answers", UnitFailed, "not asked for"),
        ("floods its log", UnitPrinted, "at most 500 a second are shown"),
        ("promises", UnitHung, ""),
        ("hang", UnitHung, ""),
        ("memory", UnitDied, ""),  # by the limit of its process or by the watch: either may be first
        ("memory of two", UnitTooLarge, ""),
        ("closes its input", UnitDied, "closed its standard input"),
        ("closes its output", UnitDied, "closed its standard input"),
        ("exit", UnitDied, "exit status 3"),
        ("crash", UnitDied, "SIGSEGV"),
        ("writes into foreign descriptors", None, ""),
        ("ignores stops", None, ""),
    ],
)
def test_a_hostile_program_harms_no_other_unit_and_is_ended_with_all_its_processes(
    run_units: StartRuntime, form: ProgramFormat, deed: str, kind: type[Event] | None, part: str
) -> None:
    # A busy computer takes long to fill memory, which is no hanging.
    is_large = "memory" in deed
    run = RunOptions(hang_us=None if is_large else HANG_US, memory_mb=250 if is_large else None)
    runtime = run_units(source(), program(form, deed, label="bad", run=run), worker())
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    with suppress(ApplyError):  # it may end before the update does
        runtime.apply(start(unit("bad.1", x="count.1/n")))
    if kind is not None:
        eventually(lambda: any(part in str(event) for event in seen(runtime, kind) if event.unit == "bad.1"))
    if (pid := runtime.pid("bad.1")) is not None and kind in (UnitFailed, None):
        with suppress(psutil.Error):
            assert psutil.Process(pid).memory_info().rss < MOST_BYTES
    if deed in ("promises", "hang"):
        owed = "waited for an answer of the program"
        eventually(lambda: any(owed in event.line for event in seen(runtime, UnitPrinted) if event.unit == "bad.1"))
    got = len(listener.received)
    eventually(lambda: len(listener.received) > got + 20)
    assert {event.unit for event in seen(runtime, UnitDied)} <= {"bad.1"}
    if "bad.1" in runtime.environment.unit:
        runtime.apply(ChangeSet(stopped=("bad.1",)), patience=QUICK)
    assert "bad.1" not in runtime.environment.unit
    assert bool(seen(runtime, UnitCutShort)) or deed != "ignores stops"
    runtime.close()
    listener.join()
    values = listener.values
    assert values == list(range(values[0], values[0] + len(values)))


@pytest.mark.parametrize("deed", ["not ready", "floods before it is ready", "never ready"])
def test_a_program_that_is_not_ready_undoes_its_update_and_nothing_else(
    run_units: StartRuntime, form: ProgramFormat, deed: str
) -> None:
    runtime = run_units(source(), program(form, deed, label="bad"), worker())
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    with pytest.raises(ApplyError, match=r"bad\.1"):
        runtime.apply(start(unit("bad.1", x="count.1/n")), patience=QUICK)
    assert set(runtime.environment.unit) == {"count.1", "work.1"}
    log = [event.line for event in seen(runtime, UnitPrinted) if event.unit == "bad.1"]
    if deed == "not ready":
        assert NOT_READY in log
    assert not any("cfgplan_runtime" in line for line in log)
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    runtime.close()
    listener.join()
