"""`cfgplan run` and `cfgplan listen` as a user calls them."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from warm import command
from world import PATIENCE_S

from cfgplan.cli import main

ENVIRONMENT = """
format: cfgplan/1
horizon: 60
transformations:
  - label: camera
    source: units.py:camera
    run: {rate: 100}
    outputs: {image: Image}
  - label: detector
    source: units.py:Detector
    params: {threshold: 3}
    inputs: {image: Image}
    outputs: {ball: Ball}
targets:
  - {label: ball, topic: /result, tag: Ball}
"""
UNITS = """
import numpy

def camera():
    while True:
        yield numpy.full((4, 4), 7, numpy.uint8)

class Detector:
    def __init__(self, threshold):
        self.threshold = threshold

    def __call__(self, image):
        if int(image.sum()) > self.threshold:
            return {"x": 1, "pixels": image}
"""


pytestmark = pytest.mark.usefixtures("warm_cfgplan")
ALARMS = Path(__file__).parents[2] / "models" / "building" / "alarms-1-start.yaml"


@pytest.fixture
def env(tmp_path: Path) -> Path:
    (tmp_path / "units.py").write_text(UNITS)
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


def cfgplan(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_what_is_planned_runs_until_it_is_interrupted(env: Path, end: signal.Signals, capsys: Any) -> None:
    with cfgplan("run", env, "--json", "--log", env.parent / "log") as running:
        assert running.stdout is not None
        plan, begin = (json.loads(running.stdout.readline()) for _ in range(2))
        assert plan["event"] == "Planned"
        assert (begin["event"], begin["units"]) == ("Running", 2)
        assert main(["listen", "/result", "--count", "3", "--json", "--run", begin["run"], "--wait", "30s"]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert [line["value"]["x"] for line in lines] == [1, 1, 1]
        assert [line["rate_hz"] is None for line in lines] == [True, False, False]
        assert lines[0]["value"]["pixels"] == {"dtype": "uint8", "shape": [4, 4], "data": [[7] * 4] * 4}
        assert main(["listen", "/result", "--count", "2"]) == 0
        assert "<array of 4 x 4 uint8>" in capsys.readouterr().out
        running.send_signal(end)
        out, err = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, err
    observed = [json.loads(line) for line in out.splitlines() if '"Observed"' in line]
    assert [line["unit"] for line in observed] == ["camera.1", "detector.1"]
    assert all(line["labor_us"] > 0 and line["upkeep_us"] > 0 for line in observed)
    assert "Applied" in (env.parent / "log").read_text()


def test_a_stream_that_is_on_no_topic_is_listened_to_by_its_unit_and_port(env: Path, capsys: Any) -> None:
    with cfgplan("run", env, "--json", "--name", "eyes") as running:
        assert running.stdout is not None
        running.stdout.readline()
        try:
            asked = ["listen", "camera.1/image", "--name", "eyes", "--json"]
            assert main([*asked, "--count", "3", "--wait", "30s"]) == 0
            lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
            assert [line["topic"] for line in lines] == ["camera.1/image"] * 3
            assert all(line["value"]["data"] == [[7] * 4] * 4 for line in lines)
            assert main(["listen", "detector.1/ball", "--count", "1"]) == 0  # a target's stream
            assert "'x': 1" in capsys.readouterr().out
            assert main(["listen", "camera.1/imag"]) == 30
            err = capsys.readouterr().err
            assert "no unit that runs gives 'camera.1/imag'" in err and "did you mean `camera.1/image`?" in err
            listening = cfgplan(*asked)
            assert listening.stdout is not None
            assert listening.stdout.readline()
            assert main(["listen", "/nowhere"]) == 30
            assert "nothing publishes topic '/nowhere'; there is /result" in capsys.readouterr().err.splitlines()[0]
            assert main(["listen", "/reslt"]) == 30
            assert "nothing publishes topic '/reslt'; did you mean `/result`?" in capsys.readouterr().err
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=PATIENCE_S)
        _, err = listening.communicate(timeout=PATIENCE_S)
        assert listening.returncode == 0
        assert "camera.1/image has ended" in err


def test_a_run_ends_when_its_time_is_over(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(env), "--for", "500ms"]) == 0
    out = capsys.readouterr().out
    assert "Running 2 units" in out
    assert "detector.1" in out


def test_what_unit_code_prints_and_raises_is_shown(env: Path) -> None:
    (env.parent / "units.py").write_text(
        UNITS.replace("        if int", "        print('looking')\n        raise ValueError('blind')\n        if int")
    )
    out, awaited = "", {"detector.1 | looking", "ValueError: blind"}
    with cfgplan("run", env, "--for", f"{PATIENCE_S}s") as running:
        assert running.stdout is not None
        while line := running.stdout.readline():
            out += line
            if all(part in out for part in awaited):
                running.send_signal(signal.SIGINT)
                awaited = {"never"}
        assert running.wait(PATIENCE_S) == 0
    assert awaited == {"never"}
    assert "): \n" not in out


def test_a_unit_without_source_is_told_and_not_started(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env.write_text(ENVIRONMENT.replace("    source: units.py:camera\n", ""))
    assert main(["run", str(env), "--for", "1s"]) == 12
    out = capsys.readouterr().out
    assert "'camera' can't be started without unit code" in out
    assert "camera is not started until it changes: it has no unit code" in out


def test_code_that_does_not_exist_is_told(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env.write_text(ENVIRONMENT.replace("units.py:camera", "units.py:kamera"))
    assert main(["run", str(env), "--for", "1s"]) == 12
    assert "units.py: the file has no kamera" in capsys.readouterr().out


def test_where_everything_must_be_met_nothing_is_started_otherwise(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace("outputs: {ball: Ball}", "outputs: {ball: Foot}"))
    assert main(["run", str(env), "--strict"]) == 12
    assert "Running" not in capsys.readouterr().out


def test_a_target_that_can_not_be_met_starts_nothing(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env.write_text(ENVIRONMENT.replace("outputs: {ball: Ball}", "outputs: {ball: Foot}"))
    assert main(["run", str(env), "--for", "200ms"]) == 12
    assert "Running 0 units" in capsys.readouterr().out


def test_a_topic_that_is_not_there_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["listen", "/nowhere"]) == 30
    assert "nothing publishes topic '/nowhere'" in capsys.readouterr().err


def test_a_module_to_preload_that_is_not_there_is_refused(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(env), "--preload", "nosuchmodule"]) == 30
    assert "there is no module 'nosuchmodule'" in capsys.readouterr().err


def test_a_run_that_is_not_live_is_what_is_told_not_its_topic(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def live(_: Path) -> list[Path]:
        return [tmp_path / "abc"]

    monkeypatch.setattr("cfgplan_runtime.streams.subscription.live_runs", live)
    assert main(["listen", "/result", "--run", "zzz"]) == 30
    assert "no run 'zzz' is live; live runs: abc" in capsys.readouterr().err


@pytest.mark.parametrize("span", ["soon", "-1s", "3 days"])
def test_a_span_of_time_that_is_none_is_refused(env: Path, span: str) -> None:
    assert main(["run", str(env), f"--for={span}"]) == 30


def test_a_step_gets_a_list_where_an_input_takes_several_streams(env: Path, capsys: Any) -> None:
    firsts = "def firsts(image, threshold):\n    return [int(one[0, 0]) for one in image]\n"
    (env.parent / "units.py").write_text(UNITS + firsts)
    several = ENVIRONMENT.replace("inputs: {image: Image}", "inputs: {image: {tag: Image, count: 2}}")
    env.write_text(several.replace("units.py:Detector", "units.py:firsts"))
    with cfgplan("run", env, "--json") as running:
        assert running.stdout is not None
        plan, begin = (json.loads(running.stdout.readline()) for _ in range(2))
        assert plan["event"] == "Planned"
        assert (begin["event"], begin["units"]) == ("Running", 3)
        assert main(["listen", "/result", "--count", "2", "--json", "--run", begin["run"], "--wait", "30s"]) == 0
        assert [json.loads(line)["value"] for line in capsys.readouterr().out.splitlines()] == [[7, 7], [7, 7]]
        assert main(["ctl", "state", "--json"]) == 0
        units = {one["id"]: one for one in json.loads(capsys.readouterr().out)["units"]}
        assert units["detector.1"]["inputs"] == {"image": ["camera.1/image", "camera.2/image"]}
        assert units["detector.1"]["unfed"] == []
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, err


def test_a_buildings_alarms_are_logged_without_a_people_counter_and_by_another_logger() -> None:
    with cfgplan("run", ALARMS, "--plain", "--no-estimates", "--for", "60s") as running:
        lines = iter(running.stdout or ())

        def comes(end: str) -> bool:
            """Whether such a line comes before the run is over."""
            return any(line.rstrip().endswith(end) for line in lines)

        assert comes("logger.1 | fire room102 4")
        assert comes("logger.1 | fire room101 37.0 3")
        assert main(["ctl", "kill", "people_counter(room101).1"]) == 0
        assert comes("logger.1 | fire room101 37.0")
        assert main(["ctl", "kill", "logger.1"]) == 0
        assert any("logger.1 died" in line for line in lines)
        assert comes("logger.1 | fire room102 4")
        running.send_signal(signal.SIGINT)
        running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0
