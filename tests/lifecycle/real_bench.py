"""The runtime of real processes on the bench of the conformance kit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from cfgplan_runtime import NoSuchTopicError, Runtime, subscribe
from cfgplan_runtime.streams.run_folder import base_folder, topics_of
from cfgplan_runtime.testing import FIRST, LAST, Bench, Endings
from real_run import PROGRAM, UNITS
from simulated_life import source, worker
from unit_signals import signal_unit

from cfgplan.domain import RunOptions, Transformation

NAMES = ("count.1", "count.2", "work.1", "work.2", FIRST, LAST)
STOP_US, SHORT_STOP_US = 30_000_000, 400_000
WAYS = {"closed": "Closed", "managed": "Managed", "at_exit": "AtExit", "flushed": "Flushed"}


def gives(topic: str, run: str) -> bool:
    """Whether an element of a run comes on a topic within a second."""
    with suppress(NoSuchTopicError, TimeoutError), subscribe(topic, run=run, timeout_s=1.0) as subscription:
        return next(iter(subscription), None) is not None
    return False


@contextmanager
def real_bench(folder: Path, code: str, run: RunOptions, **more: Any) -> Iterator[Bench]:
    """A runtime; its worker has this source and these options. The folder gets the unit code."""
    (folder / "units.py").write_text(UNITS)
    (folder / "worker_program.py").write_text(PROGRAM)
    (folder / "kit_units.py").write_text((Path(__file__).parent / "kit_units.py").read_text())
    params, endings = {"name": "x"}, endings_in(folder)
    labels = [one.label for one in (*endings.ways, endings.slow, endings.late, endings.stubborn)]
    names = (*NAMES, *(f"{label}.{number}" for label in labels for number in (1, 2)))
    with Runtime(folder=folder, **more) as runtime:
        yield Bench(
            runtime,
            source(source="units.py:count", run=RunOptions(rate_hz=40)),
            worker(source=code, params=params, run=run),
            worker("broken", source=code, params={**params, "deed": "die at start"}, run=run),
            lambda unit: signal_unit(runtime, unit),
            lambda: [name for name in names if runtime.pid(name) is not None],
            lambda: topics_of(base_folder() / runtime.id),
            lambda topic: gives(topic, runtime.id),
            endings=endings,
        )


def endings_in(folder: Path) -> Endings:
    """Unit code whose marks are in a new folder, as the number of characters of a file."""
    notes = Path(mkdtemp(dir=folder))

    def of(label: str, code: str, stop_us: int = STOP_US, **params: Any) -> Transformation:
        run = RunOptions(stop_us=stop_us, queue=40)
        params = {"notes": str(notes), **params}
        return worker(label, source=f"kit_units.py:{code}", params=params, run=run)

    def marks(label: str) -> int:
        file = notes / label
        return len(file.read_text()) if file.exists() else 0

    run = RunOptions(stop_us=STOP_US, rate_hz=40)
    generator = source("generator", source="kit_units.py:generator", params={"notes": str(notes)}, run=run)
    return Endings(
        (generator, *(of(label, code) for label, code in WAYS.items())),
        marks,
        of("slow", "Slow", name="slow", moment=0.05),
        of("late", "Slow", SHORT_STOP_US, name="late", moment=0.1),
        of("stubborn", "Stubborn", SHORT_STOP_US),
        marks,
    )
