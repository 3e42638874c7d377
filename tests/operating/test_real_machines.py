"""What real machines do to a run, as a user meets it: each case is an environment file with its unit code."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

from cfgplan_runtime.operating.control_client import connect
from operated_world import await_event, eventually, running

COUNT = """
def source():
    n = 0
    while True:
        n += 1
        yield n
"""


def write(folder: Path, units: str, *library: dict[str, Any], targets: dict[str, str], horizon: int = 600) -> Path:
    """An environment file; `targets` are tags by topic."""
    (folder / "units.py").write_text(units)
    path = folder / "env.yaml"
    wanted = [{"label": topic.strip("/"), "topic": topic, "tag": tag} for topic, tag in targets.items()]
    path.write_text(
        json.dumps({"format": "cfgplan/1", "horizon": horizon, "transformations": library, "targets": wanted})
    )
    return path


def state() -> Any:
    with connect() as control:
        return control.call("state")


def test_a_stalled_run_kills_nobody(tmp_path: Path) -> None:
    stall_s, run = 3.5, {"rate": 10, "hang": 2}
    library = [{"label": x, "source": "units.py:source", "run": run, "outputs": {"o": x.upper()}} for x in "abc"]
    env = write(tmp_path, COUNT, *library, targets={"/a": "A", "/b": "B", "/c": "C"})
    with running(env) as process:
        await_event(process, "Running", units=3)
        eventually(lambda: all(unit.get("steps") for unit in state()["units"]))
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(stall_s)
        os.kill(process.pid, signal.SIGCONT)
        eventually(lambda: [unit.get("steps", 0) > 10 * stall_s for unit in state()["units"]] == [True] * 3)
        assert len(state()["reviews"]) == 1
