"""Programs on several hosts: they are started, moved, limited, prepared as spares, and told where they are missing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import psutil
import pytest
from cfgplan_runtime import ApplyError
from cfgplan_runtime.supervision.events import SpareLost, SparePrepared, SpareUsed, UnitDied, UnitTooLarge
from small_fleet import Listener, cold, eventually, moved, seen, small_fleet, source, swap, unit, worker

from cfgplan.domain import ChangeSet, RunOptions, Transformation
from cfgplan.transformations import ProgramFormat

PROGRAM = Path(__file__).parents[1] / "runtime" / "running_program.py"
COUNT = unit("count.1", "r1")
WORK = unit("work.1", "r2", topic="/result", x="count.1/n")

BOTH = pytest.mark.parametrize("form", get_args(ProgramFormat))


def program(form: ProgramFormat, deed: str = "same", *, memory_mb: int | None = None) -> Transformation:
    run = RunOptions(format=form, memory_mb=memory_mb)
    return replace(worker(run=run), source=f"program:{sys.executable} {PROGRAM} {deed} {form}")


@BOTH
def test_programs_on_other_hosts_are_swapped_without_loss(form: ProgramFormat) -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), program(form)) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        listener = Listener(runtime)
        listener.await_more(20)
        old = WORK
        for number in range(4):
            new = moved(WORK, f"work.{number + 2}", ("r1", "r2")[number % 2])
            runtime.apply(swap(old, new))
            old = new
        listener.await_more(20)
        assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


@BOTH
def test_a_killed_program_on_another_host_is_a_dead_unit(form: ProgramFormat) -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), program(form)) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        Listener(runtime).await_more(5)
        (hosted,) = psutil.Process(runtime.pid("work.1")).children()
        hosted.kill()
        eventually(lambda: bool(seen(runtime, UnitDied)))
        (died,) = seen(runtime, UnitDied)
        assert (died.unit, died.cause.split(" (")[0]) == ("work.1", "the program: killed by SIGKILL")


@pytest.mark.parametrize(
    ("command", "cause"),
    [
        ("./absent", "there is no file ./absent"),
        ("no-such-command-1 --fast", "there is no program no-such-command-1 in the search path"),
        ("./small_fleet.py", "chmod [+]x small_fleet.py"),
    ],
)
def test_a_program_that_a_host_lacks_is_told_with_the_host_and_the_mend(command: str, cause: str) -> None:
    absent = replace(worker(), source=f"program:{command}")
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), absent) as runtime:
        with pytest.raises(ApplyError, match=f"could not start: on r2: .*{cause}"):
            runtime.apply(ChangeSet(started=(COUNT, WORK)))
        runtime.apply(ChangeSet(started=(COUNT, cold("work.9", "r2"))))
        eventually(lambda: bool(seen(runtime, SpareLost)))
        assert "on r2: " in seen(runtime, SpareLost)[0].cause


@BOTH
def test_a_program_begins_where_its_spare_is_prepared_on_another_host(form: ProgramFormat) -> None:
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), program(form)) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, cold("work.9", "r2"))))
        eventually(lambda: bool(seen(runtime, SparePrepared)))
        (prepared,) = psutil.Process(fleet.spares()["work.9"]).children()
        runtime.apply(ChangeSet(started=(WORK,), stopped=("work.9",)))
        assert seen(runtime, SpareUsed) == [SpareUsed("work.1", "work.9")]
        Listener(runtime).await_more(10)
        assert psutil.Process(runtime.pid("work.1")).children() == [prepared]


@BOTH
def test_a_program_that_takes_more_memory_than_its_limit_is_killed_on_its_host(form: ProgramFormat) -> None:
    large = program(form, "'memory of two'", memory_mb=250)
    with small_fleet("r1", "r2") as fleet, fleet.runtime(source(), large) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, unit("work.1", "r2", x="count.1/n"))))
        eventually(lambda: bool(seen(runtime, UnitTooLarge)) and bool(seen(runtime, UnitDied)))
        (told,) = seen(runtime, UnitTooLarge)
        assert told.unit == "work.1"
        assert told.memory_bytes > 250 << 20
