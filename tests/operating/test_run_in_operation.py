"""`cfgplan run` and `cfgplan ctl` on real processes, as a user calls them."""

from __future__ import annotations

import json
import os
import re
import resource
import select
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import pytest
from cfgplan_runtime import subscribe
from living import living
from operated_world import ENVIRONMENT, PATIENCE_S, ROBOT, UNITS, await_event, eventually, write_world
from operated_world import running as running_cold
from warm import command

from cfgplan.cli import main

DISPLAY = """
transformations:
  - {label: display, source: displays.py:show, labor: 0.1, inputs: {balls: {tag: Ball, count: all}}}
targets:
  - {label: shown, run: display}
  - {label: piffs ball, topic: /piff, tag: Ball and of value piff}
"""
SHOW = """
def show(balls):
    print("seen by", *(ball["robot"] for ball in balls))
"""


pytestmark = pytest.mark.usefixtures("warm_cfgplan")
running = partial(running_cold, call=command)


@pytest.fixture
def env(tmp_path: Path) -> Path:
    return write_world(tmp_path)


@pytest.fixture
def run(env: Path) -> Iterator[subprocess.Popen[str]]:
    """A run of the world, under way."""
    with running(env) as process:
        await_event(process, "Running", units=2)
        yield process


def ctl(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> Any:
    """What `cfgplan ctl --json` prints."""
    capsys.readouterr()
    assert main(["ctl", "--json", *map(str, arguments)]) == code
    return json.loads(capsys.readouterr().out)


def state_now(capsys: pytest.CaptureFixture[str]) -> Any:
    """The state at any moment, perhaps between a change and its review."""
    capsys.readouterr()
    assert main(["ctl", "--json", "state"]) in (0, 12)
    return json.loads(capsys.readouterr().out)


@pytest.mark.usefixtures("run")
def test_a_robot_registers_itself_is_used_and_leaves_again(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (env.parent / "robot2.yaml").write_text(ROBOT)
    added = ctl(capsys, "add", env.parent / "robot2.yaml")
    assert added["name"] == "robot2"
    assert {unit["id"] for unit in added["review"]["change_set"]["started"]} == {"camera(paff).1", "detector(paff).1"}
    with subscribe("/paff", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as subscription:
        assert next(iter(subscription)).value["robot"] == "paff"
    state = ctl(capsys, "state")
    assert state["declared"] == ["robot2"]
    assert [(target["label"], target["met"]) for target in state["targets"]] == [("ball", True), ("paffs ball", True)]
    # Additions stay when the file changes.
    env.write_text(ENVIRONMENT.replace("horizon: 600", "horizon: 500"))
    eventually(lambda: state_now(capsys)["horizon_s"] == 500)
    assert len(ctl(capsys, "state")["targets"]) == 2
    withdrawn = ctl(capsys, "withdraw", "robot2")
    assert set(withdrawn["review"]["change_set"]["stopped"]) >= {"camera(paff).1", "detector(paff).1"}
    assert ctl(capsys, "state")["declared"] == []


def test_a_display_of_all_streams_is_wanted_shows_those_that_come_and_is_not_wanted_any_more(
    env: Path, run: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (env.parent / "displays.py").write_text(SHOW)
    (env.parent / "display.yaml").write_text(DISPLAY)
    (env.parent / "robot2.yaml").write_text(ROBOT)
    ctl(capsys, "add", env.parent / "display.yaml")
    await_event(run, "UnitPrinted", unit="display.1", line="seen by piff")
    (shown,) = (target for target in ctl(capsys, "state")["targets"] if target["label"] == "shown")
    assert (shown["met"], shown["unit"], shown["topic"], shown["stream"]) == (True, "display.1", None, None)
    ctl(capsys, "add", env.parent / "robot2.yaml")
    await_event(run, "UnitPrinted", unit="display.1", line="seen by paff")
    units = {unit["id"]: unit for unit in ctl(capsys, "state")["units"]}
    assert units["display.1"]["inputs"] == {"balls": ["detector(paff).1/ball", "detector(piff).1/ball"]}
    withdrawn = ctl(capsys, "withdraw", "robot2")
    assert "display.1" in {unit["id"] for unit in withdrawn["review"]["change_set"]["rewired"]}
    assert ctl(capsys, "remove-target", "shown")["review"]["change_set"]["stopped"] == ["display.1"]


def test_unit_code_that_changes_is_told_and_counts_from_the_next_start(
    env: Path, run: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (env.parent / "units.py").write_text(UNITS.replace("self.robot = robot", "self.robot = robot.upper()"))
    told = await_event(run, "OldCodeRuns")
    assert (Path(told["file"]).name, told["units"]) == ("units.py", ["camera(piff).1", "detector(piff).1"])
    ctl(capsys, "kill", "detector(piff).1")
    with subscribe("/result", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as subscription:
        assert next(iter(subscription)).value["robot"] == "PIFF"


@pytest.mark.usefixtures("run")
def test_targets_and_transformations_can_be_removed_and_restored(capsys: pytest.CaptureFixture[str]) -> None:
    removed = ctl(capsys, "remove-transformation", "camera(piff)", code=12)
    assert list(removed["review"]["unmet"]) == ["ball"]
    removed = ctl(capsys, "remove-target", "ball")
    assert removed["review"]["unmet"] == {}
    state = ctl(capsys, "state")
    assert (state["units"], state["removed"]) == ([], ["ball", "camera(piff)"])
    ctl(capsys, "restore", "camera(piff)")
    assert ctl(capsys, "restore", "ball")["review"]["met"] == ["ball"]


@pytest.mark.usefixtures("run")
def test_a_unit_that_is_killed_is_replaced(capsys: pytest.CaptureFixture[str]) -> None:
    killed = ctl(capsys, "kill", "detector(piff).1")
    # The loss of its topic's source may be noticed before its end.
    assert [each["how"] for each in killed["review"]["perturbations"] if "how" in each] == ["killed"]
    assert [unit["transformation"] for unit in killed["review"]["change_set"]["started"]] == ["detector(piff)"]
    with subscribe("/result", timeout_s=PATIENCE_S) as subscription:
        assert next(iter(subscription)).value["robot"] == "piff"


def test_a_review_can_be_forced_and_the_run_be_stopped(
    run: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert ctl(capsys, "review")["review"]["decision"] == "kept"
    assert "stopped" in ctl(capsys, "stop")
    assert run.wait(PATIENCE_S) == 0


@pytest.mark.usefixtures("run")
def test_people_are_shown_the_state(capsys: pytest.CaptureFixture[str]) -> None:
    eventually(lambda: all("upkeep_us" in unit for unit in state_now(capsys)["units"]))
    assert main(["ctl", "state"]) == 0
    out = capsys.readouterr().out
    for part in ("Run ", "env.yaml", "ball", "/result", " Hz", "image ← camera(piff).1/image", "Review 1: started"):
        assert part in out
    assert main(["ctl", "kill", "camera(piff).1"]) == 0
    assert "started camera(piff)." in capsys.readouterr().out


@pytest.mark.usefixtures("run")
def test_what_is_refused_says_where_and_why(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = env.parent / "robot3.yaml"
    bad.write_text(
        "transformations:\n  - label: camera(${Robt})\n    outputs:\n      image: Imag\ntargets:\n  - {label: x}\n"
    )
    faults = ctl(capsys, "add", bad, code=30)["errors"]
    assert {(fault["file"], fault["line"]) for fault in faults} == {(str(bad), line) for line in (2, 4, 6)}
    assert main(["ctl", "kill", "ghost"]) == 30
    assert "no unit 'ghost' runs" in capsys.readouterr().err
    assert main(["ctl", "add", str(env.parent / "nowhere.yaml")]) == 30
    assert "there is no such file" in capsys.readouterr().err


def test_what_happens_can_be_followed(run: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]) -> None:
    following = [
        subprocess.Popen(command("ctl", "events", *more), stdout=subprocess.PIPE, text=True)
        for more in ((), ("--json",))
    ]
    with following[0] as people, following[1] as program:
        assert people.stdout is not None and program.stdout is not None
        # Both have subscribed when they have heard of something.
        while not select.select([people.stdout], [], [], 0)[0] or not select.select([program.stdout], [], [], 0)[0]:
            assert ctl(capsys, "review")
        assert ctl(capsys, "review")  # They may have heard the end of the last one.
        ctl(capsys, "stop")
        told = [json.loads(line) for line in program.stdout]
        assert any(" Review " in line for line in people.stdout)
    assert told[-1]["kind"] == "Ended"
    assert {"ReviewBegan", "Reviewed", "UnitStopped"} <= {event["kind"] for event in told}
    assert run.wait(PATIENCE_S) == 0


LIT = """\
format: cfgplan/1
facts: {brightness: {declared: 900, unit: lx, by: Brightness, field: lux}}
transformations:
  - {label: photometer, source: "units.py:light", run: {rate: 50}, labor: 0.1, upkeep: 0.01, outputs: {b: Brightness}}
  - {label: camera, source: "units.py:see", run: {rate: 10}, requires: brightness >= 10, outputs: {b: Ball}}
  - {label: sonar, source: "units.py:see", run: {rate: 10}, upkeep: 0.5, outputs: {b: Ball}}
targets: [{label: ball, topic: /ball, tag: Ball}]
"""
LIT_UNITS = """\
from pathlib import Path

def light():
    while True:
        text = Path(__file__).with_name("light").read_text()
        if text:
            yield {"lux": None if text == "none" else float(text)}

def see():
    while True:
        yield "a ball"
"""


def test_without_a_run_ctl_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ctl", "state"]) == 30
    assert "no run is live" in capsys.readouterr().err


def test_the_run_must_be_named_if_there_are_two(
    run: subprocess.Popen[str], env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(env) as other:
        run_id = await_event(other, "Running")["run"]
        assert main(["ctl", "stop"]) == 30
        assert "several runs are live: name one by --name" in capsys.readouterr().err
        assert main(["ctl", "--run", run_id, "state"]) == 0
        assert main(["ctl", "stop", "--run", run_id]) == 0
        assert other.wait(PATIENCE_S) == 0
    assert run.poll() is None


def test_a_run_is_found_by_its_name_which_no_other_live_run_has(
    run: subprocess.Popen[str], env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(env, "--name", "robot") as named:
        run_id = await_event(named, "Running")["run"]
        assert main(["ctl", "state"]) == 30
        assert f"name one by --name: robot ({run_id}, env.yaml, pid " in re.sub(
            "[0-9a-f]{8} [(]env.yaml, pid [0-9]+[)], ", "", capsys.readouterr().err
        )
        for which in (["--name", "robot"], ["-n", "robot"], ["--run", run_id]):
            assert ctl(capsys, *which, "state")["run"] == run_id
        assert ctl(capsys, "state", "--name", "robot")["name"] == "robot"
        assert main(["ctl", "state", "--name", "robo"]) == 30
        assert "no run 'robo' is live (did you mean `robot`?); live runs: " in capsys.readouterr().err
        assert main(["listen", "/result", "--name", "robo"]) == 30
        assert "no run 'robo' is live (did you mean `robot`?); live runs: " in capsys.readouterr().err
        assert main(["listen", "/result", "--run", "robot", "--count", "1", "--wait", "60s"]) == 0
        assert main(["listen", "/result"]) == 30
        assert f"robot ({run_id})" in capsys.readouterr().err
        with running(env, "--name", "robot") as refused:
            assert refused.wait(PATIENCE_S) == 30
        assert main(["ctl", "stop", "-n", "robot"]) == 0
        assert named.wait(PATIENCE_S) == 0
    with running(env, "--name", "robot") as again:
        await_event(again, "Running")
        assert main(["ctl", "stop", "-n", "robot"]) == 0
        assert again.wait(PATIENCE_S) == 0
    assert run.poll() is None


@pytest.mark.parametrize("name", ["a b", "", "x/y", "0123abcd", "n" * 41])
def test_a_name_that_is_none_is_refused(env: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(env), "--name", name]) == 30
    assert "--name" in capsys.readouterr().err


@pytest.mark.usefixtures("run")
def test_topics_and_streams_are_listed_with_their_givers_and_rates(capsys: pytest.CaptureFixture[str]) -> None:
    def told() -> Any:
        return ctl(capsys, "topics")

    eventually(lambda: len(told()["streams"]) == 2 and all(one["rate_hz"] for one in told()["streams"]))
    (topic,) = told()["topics"]
    assert (topic["topic"], topic["target"], topic["stream"]) == ("/result", "ball", "detector(piff).1/ball")
    assert topic["rate_hz"] > 0 and topic["silent_s"] is not None
    assert [one["stream"] for one in told()["streams"]] == ["camera(piff).1/image", "detector(piff).1/ball"]
    assert main(["ctl", "topics"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"/result +detector\(piff\)\.1/ball +\d+ Hz +.* ago", out)


@pytest.mark.usefixtures("run")
def test_the_rate_of_a_topic_and_of_a_unit_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ctl", "hz", "/result", "--for", "2500ms", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines and all(one["least_s"] <= 1 / one["rate_hz"] <= one["most_s"] for one in lines)
    assert lines[-1]["intervals"] > lines[0]["intervals"] > 0 or len(lines) == 1
    eventually(lambda: any("steps" in unit for unit in state_now(capsys)["units"]))
    assert main(["ctl", "hz", "camera(piff).1", "--for", "2500ms"]) == 0
    assert re.search(r"Hz: \d+ steps in ", capsys.readouterr().out)
    assert main(["ctl", "hz", "camera(piff).1/image", "--for", "2500ms", "--json"]) == 0
    counted = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert counted["rate_hz"] == pytest.approx(counted["elements"] / counted["seconds"], rel=0.01)
    assert main(["ctl", "hz", "/resul"]) == 30
    assert "did you mean `/result`" in capsys.readouterr().err


def test_what_has_happened_can_be_asked_for_later(
    run: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    def past(*arguments: str) -> list[dict[str, Any]]:
        capsys.readouterr()
        assert main(["ctl", "events", "--json", *arguments]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    ctl(capsys, "kill", "camera(piff).1")
    whole = past("--since", "1h")
    assert [event["number"] for event in whole] == sorted({event["number"] for event in whole})
    assert {"ReviewBegan", "Reviewed", "UnitDied"} <= {event["kind"] for event in whole}
    assert "Observed" not in {event["kind"] for event in whole}
    assert past("--last", "2")[-1]["number"] >= whole[-1]["number"]
    assert len(past("--last", "2")) == 2
    following = command("ctl", "events", "--json", "--last", "1", "--follow")
    with subprocess.Popen(following, stdout=subprocess.PIPE, text=True) as follower:
        assert follower.stdout is not None
        first = json.loads(follower.stdout.readline())
        ctl(capsys, "stop")
        rest = [json.loads(line)["number"] for line in follower.stdout]
        assert rest == list(range(first["number"] + 1, first["number"] + 1 + len(rest)))
    assert run.wait(PATIENCE_S) == 0


@pytest.mark.usefixtures("run")
def test_events_show_the_last_ones_and_say_that_they_wait(capsys: pytest.CaptureFixture[str]) -> None:
    id_ = state_now(capsys)["run"]
    earlier = " (`--last N` or `--since 10m` shows earlier ones)"
    for arguments, shown in (((), True), (("--json",), False), (("--last", "1", "--follow"), True)):
        following = command("ctl", "events", *arguments)
        with subprocess.Popen(following, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as follower:
            assert follower.stdout is not None and follower.stderr is not None
            note = follower.stderr.readline()
            assert f"waiting for new events of run {id_}{'' if '--last' in arguments else earlier}" in note
            assert "Ctrl-C ends this" in note
            follower.send_signal(signal.SIGINT)
            assert follower.wait(PATIENCE_S) == 0
            assert (" Review 1: started " in follower.stdout.read()) is shown
            assert follower.stderr.read() == "stopped\n"


def test_editing_the_file_changes_what_runs(run: subprocess.Popen[str], env: Path) -> None:
    env.write_text(ENVIRONMENT.replace("/result", "/elsewhere"))
    with subscribe("/elsewhere", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as subscription:
        assert next(iter(subscription)).value["robot"] == "piff"
    env.write_text(ENVIRONMENT + "  - {label: broken\n")
    assert await_event(run, "WorldRefused")["faults"][0]["file"] == str(env)


def test_a_run_observes_a_fact_and_follows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env, light = tmp_path / "env.yaml", tmp_path / "light"
    env.write_text(LIT)
    (tmp_path / "units.py").write_text(LIT_UNITS)
    light.write_text("900")
    with running(env) as process:
        assert await_event(process, "Reviewed")["decision"] == "applied"
        light.write_text("0.2500001")
        assert await_event(process, "Reviewed")["avoided"] == {"camera": "brightness is 0.25 lx"}
        assert state_now(capsys)["facts"] == {"brightness": "0.25"}
        light.write_text("none")
        assert "does not observe its fact" in await_event(process, "Warning")["text"]
        light.write_text("100")
        assert await_event(process, "Reviewed")["avoided"] == {}
        assert {unit["transformation"] for unit in state_now(capsys)["units"]} == {"camera", "photometer"}


def test_a_run_goes_from_the_camera_to_the_beacon_at_night_and_back_at_dawn(tmp_path: Path) -> None:
    nao = Path(__file__).parents[2] / "models" / "nao"
    shutil.copytree(nao, tmp_path / "nao")
    env = tmp_path / "nao" / "8-night.yaml"
    env.write_text(env.read_text().replace("day_s: 120", "day_s: 12").replace("noise: 5 %, ", ""))
    with running(env) as process:
        seen = list[str]()
        while len(seen) < 3:
            changes = await_event(process, "Reviewed")["change_set"]
            if changes is not None:
                started = {unit["transformation"] for unit in changes["started"]}
                seen += ["beacon"] if "beacon" in started else ["camera"] if "bottom_cam(piff)" in started else []
        assert seen == ["camera", "beacon", "camera"]


def test_a_horizon_that_was_given_holds_whatever_the_file_says(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with running(env, "--horizon", "50") as process:
        await_event(process, "Running")
        env.write_text(ENVIRONMENT.replace("/result", "/elsewhere").replace("600", "700"))
        eventually(lambda: state_now(capsys)["targets"][0]["topic"] == "/elsewhere")
        assert state_now(capsys)["horizon_s"] == 50


def test_a_killed_run_takes_its_units_along_and_the_next_begins_anew(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running_cold(env) as run:
        await_event(run, "Running", units=2)
        units = psutil.Process(run.pid).children(recursive=True)
        assert len(units) > 2
        run.kill()
    eventually(lambda: not living(units))
    with running(env) as again:
        await_event(again, "Running", units=2)
        assert main(["listen", "/result", "--count", "1", "--json", "--for", "60s"]) == 0
        assert json.loads(capsys.readouterr().out)["value"]["robot"] == "piff"


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGHUP])
def test_the_first_interrupt_lets_units_finish_and_the_second_does_not_wait(env: Path, end: signal.Signals) -> None:
    slow = (
        UNITS
        + "\n    def set_state(self, state): pass\n    def get_state(self):\n        import time; time.sleep(3600)\n"
    )
    (env.parent / "units.py").write_text(slow)
    env.write_text(ENVIRONMENT.replace("    params:", "    run: {state: true, hang: 0}\n    params:"))
    with running(env) as process:
        await_event(process, "Running", units=2)
        process.send_signal(end)
        assert process.stderr is not None
        while "stopping" not in process.stderr.readline():
            pass
        process.send_signal(end)
        assert process.wait(PATIENCE_S) == 130
    assert not list(Path(os.environ["XDG_RUNTIME_DIR"], "cfgplan").iterdir())


def test_an_interrupt_does_not_wait_for_a_unit_that_never_loads(env: Path, tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    loading = f"from pathlib import Path\nPath({str(begun)!r}).touch()\ndef loads(x):\n    return x\nwhile True: pass\n"
    (tmp_path / "loads.py").write_text(loading)
    (tmp_path / "counts.py").write_text("def count():\n    yield from range(10**9)\n")
    env.write_text(
        "format: cfgplan/1\ntransformations:\n"
        "  - {label: count, source: 'counts.py:count', run: {rate: 10}, outputs: {n: N}}\n"
        "  - {label: loads, source: 'loads.py:loads', inputs: {x: N}, outputs: {y: Y}}\n"
        "targets: [{label: y, topic: /y, tag: Y}]\n"
    )
    with running(env) as process:
        eventually(begun.exists)
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate(timeout=PATIENCE_S)
    assert "was not ready within" not in told


def test_a_dry_run_says_what_it_would_start_and_starts_nothing(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (env.parent / "units.py").write_text(UNITS + "raise SystemError('was started')\n")
    assert main(["run", str(env), "--dry-run", "--no-estimates"]) == 0
    out = capsys.readouterr().out
    assert "+ start   detector(piff).1" in out
    assert "Update: 2 to start" in out
    assert main(["run", str(env), "--dry-run", "--json", "--no-estimates"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "optimal"


def test_a_dry_run_tells_what_it_can_not_meet(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env.write_text(ENVIRONMENT + "  - {label: goal, topic: /goal, tag: Goal}\n")
    assert main(["run", str(env), "--dry-run", "--no-estimates"]) == 12
    out = capsys.readouterr().out
    assert "Update: 2 to start" in out
    assert "goal" in out


def test_what_if_is_for_dry_runs(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    what_if = ["--set", "horizon=60", "--no-estimates"]
    assert main(["run", str(env), "--dry-run", *what_if]) == 0
    assert "over the horizon of 60 s" in capsys.readouterr().out
    assert main(["run", str(env), *what_if]) == 30
    assert "are allowed only with --dry-run" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "what if:\n  only with --dry-run" in capsys.readouterr().out


def test_units_that_the_file_says_run_are_not_believed(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env.write_text(ENVIRONMENT + "units:\n  - {id: camera(piff).7, transformation: camera(piff)}\n")
    assert main(["run", str(env), "--dry-run", "--no-estimates"]) == 0
    captured = capsys.readouterr()
    assert "names 1 running unit, but `cfgplan run` ignores them" in captured.err
    assert "Update: 2 to start, 0 to rewire, 0 to stop" in captured.out


def test_what_was_learned_is_kept_from_run_to_run(
    env: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    estimates = tmp_path / "estimates.json"
    for _ in range(2):
        with running(env, "--estimates", estimates) as process:
            await_event(process, "Running")
            eventually(lambda: all("upkeep_us" in unit for unit in state_now(capsys)["units"]))
            ctl(capsys, "stop")
            assert process.wait(PATIENCE_S) == 0
        assert "camera(piff)" in estimates.read_text()
        estimates.write_text("damaged")
    assert list(tmp_path.glob("*.damaged"))


@pytest.mark.parametrize("content", ['{"name": "app", "version": 1}', "[]", '{"format": "cfgplan/1"}'])
def test_a_json_file_of_another_kind_is_not_replaced_by_estimates(
    env: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    """It was taken for a damaged file of estimates, renamed, and written anew."""
    (file := tmp_path / "package.json").write_text(content)
    assert main(["run", str(env), "--estimates", str(file)]) == 30
    assert f"{file}: this file has other content than estimates" in capsys.readouterr().err
    assert file.read_text() == content


def test_a_recorded_run_is_read_back_with_streams_and_reviews(env: Path, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    file = tmp_path / "run.mcap"
    with running(env, "--record", file) as process:
        await_event(process, "Running")
        with subscribe("/result", timeout_s=PATIENCE_S) as subscription:
            for number, _ in enumerate(subscription):
                if number == 50:
                    break
        process.send_signal(signal.SIGINT)
        recorded = await_event(process, "Recorded")
        assert process.wait(PATIENCE_S) == 0
    assert (recorded["lost"], recorded["failure"]) == (0, None)
    numbers, topics = [], set()
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        (metadata,) = reader.iter_metadata()
        for _, channel, message in reader.iter_messages():
            topics.add(channel.topic)
            if channel.topic == "/result":
                numbers.append(json.loads(message.data)["number"])
    assert metadata.metadata["environment"] == str(env)
    assert topics >= {"/result", "/result/image", "/cfgplan/reviews", "/cfgplan/events", "/cfgplan/log"}
    assert len(numbers) > 30
    assert numbers == [(numbers[0] + count) % 200 for count in range(len(numbers))]


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="this system has no /dev/full")
def test_a_log_that_takes_no_more_is_told_once_and_counted(env: Path, tmp_path: Path) -> None:
    line = command("run", env, "--no-estimates", "--log", "/dev/full", "--for", "2s")
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr.count("warning: /dev/full can't be written any more: No space left on device") == 1
    assert "Wrote /dev/full: 0 lines." in done.stderr
    assert re.search(r"warning: /dev/full: [1-9]\d* lines could not be written: No space left", done.stderr)
    with running(env, "--log", tmp_path / "log", "--for", "1s") as process:
        logged = await_event(process, "Logged", lost=0, failure=None)
    assert logged["written"] == len((tmp_path / "log").read_text().splitlines())


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="this system has no /dev/full")
@pytest.mark.parametrize("form", ["--json", "--plain"])
def test_a_full_disk_for_what_it_prints_does_not_end_a_run(env: Path, tmp_path: Path, form: str) -> None:
    line = command("run", env, form, "--no-estimates", "--log", tmp_path / "log", "--for", "2s")
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.stderr.count("warning: standard output can't be written any more: No space left on device") == 1
    logged = [json.loads(told) for told in (tmp_path / "log").read_text().splitlines()]
    applied, *_ = [told["time"] for told in logged if told["event"] == "Reviewed"]
    assert logged[-1]["event"] == "Ended"
    assert logged[-1]["time"] - applied > 1.9


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="only Linux limits another process")
def test_a_recording_that_takes_no_more_is_told_while_it_runs(env: Path, tmp_path: Path) -> None:
    with running_cold(env, "--record", tmp_path / "run.mcap") as process:
        await_event(process, "Running")
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
        warning = await_event(process, "Warning")
        process.send_signal(signal.SIGINT)
        recorded = await_event(process, "Recorded", failure="File too large")
    assert (
        warning["text"] == f"{tmp_path / 'run.mcap'} can't be written any more: File too large; lost lines are counted"
    )
    assert recorded["lost"] > 0


def test_metrics_are_served_while_it_runs(env: Path) -> None:
    from urllib.request import urlopen

    with running(env, "--metrics-port", "0") as process:
        port = await_event(process, "Running")["metrics_port"]
        page = urlopen(f"http://127.0.0.1:{port}/metrics").read()
    assert b'cfgplan_reviews_total{decision="applied"} 1.0' in page


def test_places_that_a_run_can_not_have_are_told_before_it_plans(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        run, demo = ["run", str(env)], ["demo"]
        metrics, page = ("--metrics-port", "metrics"), ("--page", "the page")
        for command, (option, who) in ((run, metrics), (run, page), (demo, page)):
            assert main([*command, option, str(port)]) == 30
            told = capsys.readouterr()
            assert f"{option} {port}: {who} can't be served there: Address already in use" in told.err
            assert "name another port; 0 takes any that is free" in told.err
            assert told.out == ""
    assert main(["run", str(env), "--record", str(env.parent / "none" / "x.mcap")]) == 30
    told_too = capsys.readouterr()
    assert "its folder does not exist" in told_too.err
    assert told_too.out == ""


def test_what_fails_at_each_step_says_where_only_once(env: Path) -> None:
    code = "        return {"
    assert code in UNITS
    (env.parent / "units.py").write_text(
        UNITS.replace(code, "        if int(image[0, 0]) % 2: raise ValueError('blind')\n" + code)
    )
    process = subprocess.Popen(command("run", env, "--no-estimates"), stdout=subprocess.PIPE, text=True)
    lines: list[str] = []
    with process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if sum("ValueError: blind" in line for line in lines) == 3:
                process.send_signal(signal.SIGINT)
    text = "".join(lines)
    assert text.count("if int(image[0, 0]) % 2: raise ValueError('blind')") == 1
    assert "unit_code.py" not in text


def test_lines_are_printed_where_no_terminal_is(env: Path) -> None:
    arguments = command("run", env, "--for", "200ms", "--no-estimates")
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    lines = done.stdout.splitlines()
    assert any(line.startswith("Running 2 units as run ") for line in lines)
    assert any(line.startswith("Review 1: started camera(piff).1, detector(piff).1; ") for line in lines)
    assert "\x1b" not in done.stdout


PLANNER = """
from cfgplan.planners import PLANNERS

def plan(problem, **more):
    with open("plans", "a") as file:
        file.write("planned\\n")
    return PLANNERS["cpsat"](problem, **more)
"""


def test_a_run_shows_what_solve_shows_before_anything_starts_and_carries_that_out(env: Path) -> None:
    (env.parent / "own.py").write_text(PLANNER)
    arguments = command("run", env, "--for", "200ms", "--no-estimates", "--planner", "own:plan")
    ran = subprocess.run(
        arguments, capture_output=True, text=True, timeout=PATIENCE_S, check=True, cwd=env.parent
    ).stdout
    assert (env.parent / "plans").read_text() == "planned\n"
    solved = subprocess.run(command("solve", env), capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    assert ran.startswith(solved.stdout.replace("cpsat", "own:plan").partition("Optimal")[0])
    assert ran.index("Optimal: ") < ran.index("Running 2 units")


def test_the_plan_of_a_run_is_an_event_of_its_own_before_all_others(env: Path) -> None:
    with running(env, "--for", "200ms") as process:
        assert process.stdout is not None
        told = [json.loads(line) for line in process.stdout]
    assert [one["event"] for one in told[:2]] == ["Planned", "Running"]
    assert [unit["id"] for unit in told[0]["plan"]["change_set"]["started"]] == ["camera(piff).1", "detector(piff).1"]
    assert told[0]["ended"] == []


@pytest.mark.usefixtures("run")
def test_a_plan_is_written_read_and_carried_out_unless_it_is_stale(
    env: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "plan.json"
    env.write_text(
        ENVIRONMENT.replace("labor: 0.1\n    upkeep: 0.01\n    inputs", "labor: 0.1\n    upkeep: 9\n    inputs")
    )
    cheaper = ENVIRONMENT[ENVIRONMENT.index("  - label: detector") : ENVIRONMENT.index("targets:")]
    (tmp_path / "cheaper.yaml").write_text(f"transformations:\n{cheaper.replace('detector(', 'cheaper(')}")
    ctl(capsys, "add", tmp_path / "cheaper.yaml")
    eventually(lambda: state_now(capsys)["saving_us"])

    assert main(["ctl", "plan", "--out", str(file)]) == 0
    said = capsys.readouterr()
    assert "+ start   cheaper(piff).1" in said.out
    assert "image <- camera(piff).1/image" in said.out
    assert "- stop    detector(piff).1" in said.out
    assert "A review would now start cheaper(piff).1, stop detector(piff).1; " in said.out
    assert f"Wrote {file}." in said.err
    assert ctl(capsys, "plan")["change_set"] == json.loads(file.read_text())["change_set"]

    assert ctl(capsys, "why", "camera(piff).1")["says"][0].startswith("camera(piff).1 serves target ball, feeds ")
    applied = ctl(capsys, "apply", file)
    assert applied["review"]["decision"] == "applied"
    assert {unit["id"] for unit in state_now(capsys)["units"]} == {"camera(piff).1", "cheaper(piff).1"}
    assert main(["ctl", "apply", str(file)]) == 30
    refused = capsys.readouterr().err
    assert "the plan is stale: unit cheaper(piff).1 runs now" in refused
    assert "the plan is stale: unit detector(piff).1 does not run any more" in refused
    assert "cfgplan ctl plan --out" in refused


def test_what_a_run_starts_is_held_against_the_units_of_the_file(env: Path) -> None:
    said = "units:\n  - {id: eye, transformation: camera(piff)}\n  - {id: old, transformation: detector(piff)}\n"
    env.write_text(ENVIRONMENT + said)
    for arguments in (["--for", "200ms"], ["--dry-run"]):
        line = command("run", env, "--no-estimates", "--from", "units", *arguments)
        done = subprocess.run(line, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
        assert "Changes from `units:` to the running units:\n  ~ rewire  old" in done.stderr
        assert "image <- eye/image   (was not connected)" in done.stderr
        assert "ball -> topic /result" in done.stderr
        assert "= keep    eye" in done.stderr
