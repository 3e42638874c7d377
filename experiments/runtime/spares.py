"""The time that a prepared cold spare saves: from a kill to the first element of the replacement.

    python experiments/runtime/spares.py [--times 3] [--seconds 0.5 ...]

A unit that takes that many seconds to construct is killed, first on this computer, then in a fleet of three agents on
this computer; there an agent is killed as well. A life-cycle (`survive`) has a cold spare of it all the time.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import psutil
from cfgplan_runtime import Manager, Policy, Runtime, subscribe
from cfgplan_runtime.fleet.fleet_runtime import Fleet, fleet_runtime
from cfgplan_runtime.lifecycle.changes import ReviewNow
from cfgplan_runtime.supervision.spares import Spares

from cfgplan import api

HERE = Path(__file__).parent
SECONDS = (0.0, 0.5, 2.0)
PATIENCE_S = 60.0
T = TypeVar("T")
_WORLD = """
format: cfgplan/1
horizon: 600
survive: 1
{hosts}
transformations:
  - {{label: count, source: "measured_units.py:count", run: {{rate: 200}}, outputs: {{n: N}}, {base} standby: 0}}
  - {{label: work, source: "measured_units.py:Constructed", params: {{seconds: {seconds}}}, inputs: {{x: N}},
     outputs: {{y: Y}}, {workers} labor: 1, upkeep: 0.01, standby: 0.001}}
targets: [{{label: result, topic: /result, tag: Y{at_base}}}]
"""


class Run:
    """A run of the world, and the elements on its topic."""

    def __init__(self, runtime: Runtime, manager: Manager, *, is_prepared: bool) -> None:
        self._manager, self._is_prepared = manager, is_prepared
        self._subscription = subscribe("/result", run=runtime.id, wait_s=PATIENCE_S)
        self.came: list[tuple[float, int]] = []
        """When each element came, and from which process."""
        threading.Thread(target=self._collect, daemon=True).start()

    def killed(self, pid: int, *, is_unit: bool) -> float:
        """Kill a process. Returns the seconds until the first element of another unit's process."""
        old, before, start_s = self.pid, len(self.came), time.monotonic()
        os.kill(pid, 9)
        first_s = _eventually(lambda: next((at_s for at_s, provider in self.came[before:] if provider != old), None))
        if is_unit:
            self.settle()
        return first_s - start_s

    def settle(self) -> None:
        """Wait until all spares are in the wanted state, prepared or not, and until no failure counts any more."""
        self._manager.request(ReviewNow("the experiment")).result(PATIENCE_S)
        _eventually(lambda: self._prepared() == {self._is_prepared} or None)
        time.sleep(1.0)

    def _prepared(self) -> set[bool]:
        return {view.is_prepared for view in self._manager.snapshot().units if view.unit.standby}

    @property
    def pid(self) -> int:
        """The process of the unit whose stream comes."""
        return self.came[-1][1]

    def _collect(self) -> None:
        with suppress(OSError):
            for received in self._subscription:
                self.came.append((time.monotonic(), received.value[0]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--seconds", type=float, nargs="+", default=SECONDS, help="that constructing takes")
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.0f}; ms from the kill to the first element, medians of {options.times} (worst)")
    print("| killed | constructing takes | prepared | not prepared |")
    print("|---|---|---|---|")
    for seconds in options.seconds:
        taken = [measured(seconds, options.times, is_prepared=is_prepared) for is_prepared in (True, False)]
        for what in taken[0]:
            cells = [f"{statistics.median(one[what]) * 1e3:.0f} ({max(one[what]) * 1e3:.0f})" for one in taken]
            print(f"| {what} | {seconds:g} s | {' | '.join(cells)} |", flush=True)


def measured(seconds: float, times: int, *, is_prepared: bool) -> dict[str, list[float]]:
    """The seconds that each kill cost."""
    seen: dict[str, list[float]] = {"a unit": [], "a unit of a fleet": [], "an agent with its unit": []}
    prepare = Spares._prepare
    if not is_prepared:
        Spares._prepare = lambda *_: None  # type: ignore[method-assign]
    try:
        with running(seconds, is_fleet=False, is_prepared=is_prepared) as run:
            seen["a unit"] += [run.killed(run.pid, is_unit=True) for _ in range(times)]
        for _ in range(times):
            with running(seconds, is_fleet=True, is_prepared=is_prepared) as run:
                seen["a unit of a fleet"].append(run.killed(run.pid, is_unit=True))
                agent = psutil.Process(run.pid).parents()[1].pid
                seen["an agent with its unit"].append(run.killed(agent, is_unit=False))
    finally:
        Spares._prepare = prepare  # type: ignore[method-assign]
    return seen


@contextmanager
def running(seconds: float, *, is_fleet: bool, is_prepared: bool) -> Iterator[Run]:
    """The world as it runs, its spares prepared."""
    hosts = "hosts: [{name: base}, {name: r1}, {name: r2}]" if is_fleet else ""
    base, workers, at_base = ("host: base,", "host: [r1, r2],", ", host: base") if is_fleet else ("", "", "")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "env.yaml"
        path.write_text(_WORLD.format(hosts=hosts, base=base, workers=workers, at_base=at_base, seconds=seconds))
        world = api.load(path)
        fleet = Fleet(is_local=True)
        made = fleet_runtime(fleet, world.environment, HERE) if is_fleet else Runtime(folder=HERE)
        policy = Policy(hosts_s=30.0 if is_fleet else None)
        with made as runtime, Manager(world, runtime, policy=policy) as manager:
            run = Run(runtime, manager, is_prepared=is_prepared)
            _eventually(lambda: len(run.came) > 10 or None)
            run.settle()
            yield run


def _eventually(look: Callable[[], T | None]) -> T:
    """Return the first result of `look` that is not None. Raises TimeoutError."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        found = look()
        if found is not None:
            return found
        time.sleep(0.002)
    raise TimeoutError("it never came to be")


if __name__ == "__main__":
    main()
