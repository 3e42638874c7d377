"""What real machines do to a run, as a user meets it: each case is an environment file with its unit code."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.operating.control_client import connect
from operated_world import PATIENCE_S, await_event, eventually, running

from cfgplan.cli import main

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
    stall_s, run = 5.5, {"rate": 10, "hang": 4}
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


RAISES = """
def camera():
    for n in range(200):
        yield n
    raise OSError("camera: frame timeout")


def spare():
    yield from range(1_000_000)


class Filter:
    def __call__(self, x):
        return x
"""


def part(label: str, upkeep: float, source: str, **more: Any) -> dict[str, Any]:
    return {"label": label, "source": f"units.py:{source}", "labor": 0.05, "upkeep": upkeep, **more}


def test_a_source_that_raises_does_not_go_silent_for_ever(tmp_path: Path) -> None:
    library = [
        part("camera", 0.01, "camera", run={"rate": 100}, outputs={"o": "Image"}),
        part("spare", 0.02, "spare", run={"rate": 100}, outputs={"o": "Image"}),
        part("filter", 0.01, "Filter", inputs={"x": "Image"}, outputs={"o": "Filtered"}),
    ]
    env = write(tmp_path, RAISES, *library, targets={"/t": "Filtered"}, horizon=10)
    with running(env) as process:
        await_event(process, "Running", units=2)
        with subscribe("/t", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as subscription:
            for number, _ in enumerate(subscription):
                if number > 1000:
                    break
        await_event(process, "UnitDied", unit="camera.1")


def test_a_met_target_on_which_nothing_comes_is_shown_as_that(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    units = "def short():\n    yield 1\n"
    env = write(tmp_path, units, part("camera", 0.01, "short", outputs={"o": "Image"}), targets={"/t": "Image"})
    with running(env) as process:
        assert await_event(process, "Warning")["text"] == "t is met by camera.1/o, but nothing comes on /t"
        assert main(["ctl", "state"]) == 0
        shown = capsys.readouterr().out
        assert "silent for" in shown or "nothing came yet" in shown
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0


def test_a_target_that_is_silent_for_too_long_counts_as_unmet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    units = "def short():\n    yield 1\n"
    env = write(tmp_path, units, part("camera", 0.01, "short", outputs={"o": "Image"}), targets={"/t": "Image"})
    said = json.loads(env.read_text())
    said["targets"][0]["silent"] = "2500ms"
    env.write_text(json.dumps(said))
    with running(env) as process:
        await_event(process, "Running", units=1)
        eventually(lambda: not state()["targets"][0]["met"])
        assert main(["ctl", "state"]) == 12
        assert "nothing has come from camera.1/o for" in capsys.readouterr().out
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 12
