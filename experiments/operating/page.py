"""The page in headless Chromium: the CPU time of an update at 3, 31 and 151 units, and the delay until it shows a kill.

`python experiments/operating/page.py [--seconds 10] [--kills 5] [--busy 1]` prints a table and a line. The units of the
table are those of a fake manager, whose figures change each second. The line is about units of a real run that are
killed from outside, beside `--busy` busy loops. `--seconds 0` leaves the table out.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.page.server import PageServer
from cfgplan_runtime.streams.run_folder import RunFolder

from cfgplan import api

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "operating"))

from browsed import CHROMIUM, await_so, browser
from fake_manager import FakeManager
from operated_world import eventually, write_world
from page_world import building

SIZES = (3, 31, 151)
KILLED = "camera(piff).1"
WATCH = f"""() => {{
  window.shown = [];
  new MutationObserver((changes) => {{
    for (const change of changes) for (const row of change.addedNodes)
      if (row.classList.contains("bad") && row.textContent.includes("{KILLED} ")) window.shown.push(Date.now());
  }}).observe(document.getElementById("timeline"), {{ childList: true }});
}}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=10)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--busy", type=int, default=0)
    options = parser.parse_args()
    if not CHROMIUM.exists():
        sys.exit(f"Chromium is needed at {CHROMIUM}")
    if options.seconds:
        print("| units | first picture | updates per s | server, CPU per update | server | browser, CPU per update |")
        print("|---|---|---|---|---|---|")
        for units in SIZES:
            print(f"| {units} | {update_costs(units, options.seconds)} |", flush=True)
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.busy)]
    try:
        took = sorted(kills_shown_ms(options.kills))
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    print(f"\n{len(took)} kills shown after {statistics.median(took):.0f} ms (median), {took[-1]:.0f} ms at most")


@contextmanager
def own_runs() -> Iterator[Path]:
    """Yield a folder for the runs of this command only."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        yield Path(folder)


def update_costs(units: int, seconds: int) -> str:
    manager = FakeManager(building(units))
    with own_runs():
        folder = RunFolder()
        with (
            ControlServer(folder.path, Methods(manager).by_name(), "/building.yaml"),
            PageServer(connect) as page,
            browser(page, viewport={"width": 1400, "height": 900}) as (tab, _),
        ):
            first_s = tab.evaluate("performance.now()") / 1e3
            row = _watched(tab, manager, units, seconds)
        folder.close()
    return f"{first_s:.1f} s | {row}"


def _watched(tab: Any, manager: FakeManager, units: int, seconds: int) -> str:
    session = tab.context.new_cdp_session(tab)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})  # CPU time, not wall time

    def busy_s() -> float:
        metrics = session.send("Performance.getMetrics")["metrics"]
        return next(float(one["value"]) for one in metrics if one["name"] == "TaskDuration")

    def frames() -> int:
        return int(tab.get_attribute("body", "data-frames"))

    time.sleep(2.0)
    before_s, shown, idle_s = busy_s(), frames(), 0.0
    for second in range(1, seconds + 1):
        manager.shows(building(units, second))
        cpu_s = time.process_time()
        time.sleep(1.0)
        idle_s += time.process_time() - cpu_s
    shown = frames() - shown
    browser_s = busy_s() - before_s
    server = f"{idle_s / shown * 1e3:.1f} ms | {idle_s / seconds:.1%} of a core"
    return f"{shown / seconds:.1f} | {server} | {browser_s / shown * 1e3:.1f} ms"


def kills_shown_ms(kills: int) -> list[float]:
    took = []
    with own_runs(), tempfile.TemporaryDirectory() as folder:
        env = write_world(Path(folder))
        with Operation(api.load(env), env, Settings()) as operation, PageServer(connect) as page:
            operation.begun.wait()
            with browser(page) as (tab, _):
                tab.evaluate(WATCH)
                for number in range(kills):
                    await_so(tab, "document.getElementById('health').dataset.level === 'well'")
                    time.sleep(1.5)
                    eventually(lambda: operation.runtime.pid(KILLED))
                    pid = operation.runtime.pid(KILLED)
                    assert pid is not None
                    killed_ms = time.time() * 1e3
                    os.kill(pid, signal.SIGKILL)
                    await_so(tab, f"shown.length > {number}")
                    took.append(tab.evaluate("shown")[number] - killed_ms)
    return took


if __name__ == "__main__":
    main()
