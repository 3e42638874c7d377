"""Unit code is let end: at a stop, when something else takes its place, and at the end of a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from cfgplan_runtime import ApplyError, Runtime
from cfgplan_runtime.supervision.events import UnitCutShort, UnitDied, UnitFailed, UnitStopped
from watching import seen
from world import RESULT, eventually, unit

from cfgplan.domain import ChangeSet, InputPort, OutputPort, RunOptions, Transformation

FOLDER = Path(__file__).parent


def source(code: str, notes: Path, *, stop_us: int | None = None, rate_hz: float | None = 100) -> Transformation:
    run = RunOptions(rate_hz=rate_hz, stop_us=stop_us)
    params = {"notes": str(notes)}
    return Transformation(
        code, outputs=(OutputPort("n", "N"),), source=f"ending_units.py:{code}", params=params, run=run
    )


def worker(code: str, notes: Path, **run: int) -> Transformation:
    ports = (InputPort("x", "N"),), (OutputPort("y", "Y"),)
    params = {"notes": str(notes)}
    return Transformation(code, *ports, source=f"ending_units.py:{code}", params=params, run=RunOptions(**run))  # type: ignore[arg-type]


def waiting(runtime: Runtime) -> int:
    """How many elements wait at Steady.1, as it has told."""
    return sum(counts.waiting for one in runtime.observe() if one.unit == "Steady.1" for counts in one.inputs.values())


@pytest.fixture
def runtime(nothing_is_left_behind: Path) -> Iterator[Runtime]:
    assert nothing_is_left_behind
    with Runtime(targets=[RESULT], folder=FOLDER) as made:
        yield made


def run(runtime: Runtime, *library: Transformation, fed: bool = True) -> None:
    """Start a unit of each; the first, a source, feeds the others."""
    first, *others = library
    units = [unit(f"{first.label}.1")]
    units += [unit(f"{one.label}.1", x=f"{first.label}.1/n") if fed else unit(f"{one.label}.1") for one in others]
    runtime.apply(ChangeSet(tuple(units), added_transformations=library))


def test_a_generator_is_closed_and_files_are_written_at_the_end_of_a_run(runtime: Runtime, tmp_path: Path) -> None:
    run(runtime, source("motor", tmp_path), worker("Writer", tmp_path), worker("Managed", tmp_path))
    eventually(lambda: any(o.unit == "Writer.1" and o.steps > 20 for o in runtime.observe()))
    assert (tmp_path / "motor").read_text() == "on"
    runtime.stop()
    assert (tmp_path / "motor").read_text() == "off"
    assert {"close", "atexit", "thread", "exit"} <= {path.name for path in tmp_path.iterdir()}
    rows = [int(row) for row in (tmp_path / "rows").read_text().splitlines()]
    assert rows == list(range(rows[0], rows[0] + len(rows)))
    assert len(rows) > 20
    assert seen(runtime, UnitDied) == seen(runtime, UnitCutShort) == []


def test_a_unit_that_another_takes_the_place_of_is_let_end(runtime: Runtime, tmp_path: Path) -> None:
    run(runtime, source("motor", tmp_path), worker("Managed", tmp_path))
    first, second = unit("motor.1"), unit("motor.2")
    rewired = unit("Managed.1", x="motor.2/n")
    runtime.apply(ChangeSet(started=(second,), rewired=(rewired,), stopped=(first.id,)))
    eventually(lambda: (tmp_path / "motor").read_text() in ("on", "off"))
    assert [event.unit for event in seen(runtime, UnitStopped)] == ["motor.1"]
    runtime.stop()
    assert (tmp_path / "motor").read_text() == "off"


def test_code_that_blocks_is_interrupted_and_its_generator_ends(runtime: Runtime, tmp_path: Path) -> None:
    run(runtime, source("blocks", tmp_path, rate_hz=None))
    eventually((tmp_path / "blocks").exists)
    runtime.stop()
    assert (tmp_path / "motor").read_text() == "off"
    assert seen(runtime, UnitDied) == seen(runtime, UnitCutShort) == []


def test_code_that_never_ends_is_killed_after_its_own_limit_and_that_is_told(runtime: Runtime, tmp_path: Path) -> None:
    run(runtime, source("stubborn", tmp_path, stop_us=1_200_000, rate_hz=None))
    eventually((tmp_path / "blocks").exists)
    runtime.stop()
    assert (tmp_path / "interrupted").exists()
    assert seen(runtime, UnitCutShort) == [UnitCutShort("stubborn.1", 1.2, 0)]
    assert [event.unit for event in seen(runtime, UnitStopped)] == ["stubborn.1"]


def test_what_a_unit_has_taken_in_is_worked_off_within_its_limit_and_is_not_interrupted(
    runtime: Runtime, tmp_path: Path
) -> None:
    steady = worker("Steady", tmp_path, stop_us=60_000_000, queue=40)
    run(runtime, source("motor", tmp_path), steady)
    eventually(lambda: waiting(runtime) >= 20)
    before = len((tmp_path / "done").read_text().splitlines())
    runtime.stop()
    assert len((tmp_path / "done").read_text().splitlines()) >= before + 20
    assert seen(runtime, UnitCutShort) == []


def test_what_waited_at_a_unit_that_is_killed_is_counted(runtime: Runtime, tmp_path: Path) -> None:
    steady = worker("Steady", tmp_path, stop_us=300_000, queue=100)
    run(runtime, source("motor", tmp_path), steady)
    eventually(lambda: waiting(runtime) >= 20)
    runtime.stop()
    (cut,) = [event for event in seen(runtime, UnitCutShort) if event.unit == "Steady.1"]
    assert cut.after_s == 0.3
    assert cut.waiting >= 20


def test_a_unit_that_exits_waits_for_no_thread(runtime: Runtime, tmp_path: Path) -> None:
    failing = worker("FailsBesideAThread", tmp_path, hang_us=0)
    with suppress(ApplyError):  # on a slow machine it dies before the update is over
        run(runtime, source("motor", tmp_path), failing)
    eventually(lambda: [event.unit for event in seen(runtime, UnitDied)] == ["FailsBesideAThread.1"])


def test_code_that_fails_to_close_is_told_of_and_its_unit_has_stopped_as_asked(
    runtime: Runtime, tmp_path: Path
) -> None:
    run(runtime, source("motor", tmp_path), worker("FailsToClose", tmp_path))
    runtime.stop()
    assert any("the motor does not answer" in event.text for event in seen(runtime, UnitFailed))
    assert {event.unit for event in seen(runtime, UnitStopped)} == {"motor.1", "FailsToClose.1"}
