"""The live view: what is on it, at any size of the terminal."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import struct
import termios
import time
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.lifecycle.kinds import Level
from cfgplan_runtime.lifecycle.perturbations import SubscriptionLost, UnitGone
from cfgplan_runtime.lifecycle.reports import BackingOff, Decision, Snapshot, TargetView, UnitView
from cfgplan_runtime.operating.records import snapshot_record
from fake_manager import CAMERA, DETECTOR, REVIEW, SNAPSHOT, observation
from operated_world import PATIENCE_S, command, write_world
from rich.console import Console

from cfgplan.cli.run_picture import LogLine, RunPicture, state_text
from cfgplan.domain import ComputationUnit, Environment, Host, InputPort, Stream, Subscription, Transformation
from cfgplan.errors import Fault
from cfgplan.unmet import Lack, NeededBy, Reason

FLOWS = {"/result": Flow(29.97, 12.4, 300, 0, 0.01)}


def drawn(snapshot: Snapshot = SNAPSHOT, *, width: int = 140, height: int = 40, **more: Any) -> list[str]:
    console = Console(file=StringIO(), width=width, height=height, record=True)
    flows = {topic: msgspec.structs.asdict(flow) for topic, flow in more.pop("flows", FLOWS).items()}
    picture = RunPicture("ab12cd34", "env.yaml", 75.0, snapshot_record(snapshot, flows), **more)
    console.print(picture, end="")
    return console.export_text().splitlines()


def large() -> Snapshot:
    """Forty units and twenty targets."""
    units = [ComputationUnit(f"stage{number:02}.1", f"stage{number:02}") for number in range(40)]
    views = [UnitView(unit, None, observation(unit.id)) for unit in units]
    seen = views[30].observation
    assert seen is not None
    views[30] = replace(views[30], observation=replace(seen, errors=3, last_error="Traceback ...\nValueError: five\n"))
    targets = [
        TargetView(f"t{number}", "T", f"/t/{number}", 0, Stream("stage00.1", "y"), unit="stage00.1")
        for number in range(20)
    ]
    targets[13] = replace(targets[13], stream=None, unit=None, reason="nothing gives T")
    return replace(
        SNAPSHOT,
        units=tuple(views),
        targets=tuple(targets),
        environment=Environment(tuple(units)),
        reviews=(REVIEW,) * 9,
    )


def test_it_shows_targets_units_reviews_and_the_log() -> None:
    text = "\n".join(
        drawn(
            lines=[
                LogLine(0.0, Level.ERROR, "camera.1 coughs"),
                LogLine(0.0, Level.INFORMATION, "a review", is_review=True),
            ]
        )
    )
    for part in (
        "Run ab12cd34 of env.yaml", "00:01:15", "stable", "1 of 2 met", "30 Hz", "12 ms", "detector.1/ball",
        "nothing gives Goal", "2 %", "25 MB", "nao1", "image ← camera.1/image", "segmenter",
        "not started for 4 s, failed 3 times: exited with 3", "cause: detector.1 died, asked for",
        "started detector.1; goal is not met", "13 ms", "camera.1 coughs", "Ctrl-C stops",
    ):  # fmt: skip
        assert part in text
    assert "a review" not in text


def test_a_reason_that_several_targets_share_is_told_once() -> None:
    lack = Lack("no output matches", "U", NeededBy("x", "i"))
    reasons = {label: Reason(lack, label, "T") for label in "ab"}
    targets = [TargetView(label, "T", f"/{label}", 0, None, why) for label, why in reasons.items()]
    text = "\n".join(drawn(replace(SNAPSHOT, targets=tuple(targets)), width=200))
    assert re.search(
        r"a +/a +targets a and 1 more want T, but input i of x needs U, and no output matches +$", text, re.MULTILINE
    )
    assert re.search(r"b +/b +as a +$", text, re.MULTILINE)


def test_what_waits_for_one_cause_has_one_row() -> None:
    """Two rows differed only in the time: `for 4 s` and `for 3 s`."""
    waiting = (
        BackingOff("a", 2, 4.0, "exited with 3"),
        BackingOff("b", 3, 3.0, "exited with 3", "r1"),
        BackingOff("b", 3, 2.0, "exited with 3", "r2"),
        BackingOff("c", 1, float("inf"), "exited with 3"),
    )
    lines = drawn(replace(SNAPSHOT, backing_off=waiting), width=200)
    told = [" ".join(line.split()) for line in lines if "exited with 3" in line]
    assert told == [
        "a, b on r1, r2 not started for up to 4 s, failed 2 to 3 times: exited with 3",
        "c not started until it changes, failed once: exited with 3",
    ]


def test_the_cause_of_many_targets_is_on_the_line() -> None:
    """All of the targets were named before it, and the line was cut."""
    labels = [f"target{number}" for number in range(40)]
    targets = [TargetView(label, "T", f"/{label}", 0, None, Reason(Lack("no one"), label, "T")) for label in labels]
    text = "\n".join(drawn(replace(SNAPSHOT, targets=tuple(targets)), width=140))
    assert "target0 and 39 more want T, but no one" in text


@pytest.mark.parametrize("width", [60, 80, 120, 300])
@pytest.mark.parametrize("height", [16, 24, 40, 100])
@pytest.mark.parametrize("faults", [(), (Fault("this is not YAML", "env.yaml", 3),)])
def test_it_fills_the_terminal_and_no_more(width: int, height: int, faults: tuple[Fault, ...]) -> None:
    for snapshot in (SNAPSHOT, large(), replace(SNAPSHOT, targets=(), units=(), reviews=(), backing_off=())):
        lines = drawn(
            replace(snapshot, faults=faults),
            width=width,
            height=height,
            lines=[LogLine(0.0, Level.INFORMATION, "x" * 500)] * 99,
        )
        assert len(lines) == height
        assert max(map(len, lines)) <= width


def test_hosts_that_are_gone_stand_in_the_first_line() -> None:
    assert "gone: r1, r2" in drawn(replace(SNAPSHOT, lost_hosts=("r1", "r2")))[0]


def test_the_state_names_the_hosts_without_a_unit() -> None:
    hosts = tuple(map(Host, ("attic", "nao1", "shed")))
    environment = replace(SNAPSHOT.environment, hosts=hosts)
    with_hosts = replace(SNAPSHOT, environment=environment, lost_hosts=("attic",))
    console = Console(file=StringIO(), width=100)
    console.print(state_text("run", "env.yaml", 1, {**snapshot_record(with_hosts), "crossings": []}))
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "Hosts that are gone: attic." in shown and "No unit on shed." in shown


def test_where_not_all_fits_what_is_wrong_comes_first() -> None:
    lines = drawn(large(), height=24)
    text = "\n".join(lines)
    assert "t13" in text
    assert "nothing gives T" in text
    assert "ValueError: five" in text
    assert "units more" in text
    assert "targets more" in text


def test_a_gap_and_a_silent_stream_stand_out() -> None:
    library = (Transformation("detector", (InputPort("image", "I"), InputPort("pose", "P"))),)
    snapshot = replace(SNAPSHOT, environment=Environment((CAMERA, DETECTOR), library))
    text = "\n".join(drawn(snapshot, flows={"/result": Flow(0.0, None, 300, 0, 75.0)}))
    assert "nothing feeds pose" in text
    assert "silent for 75 s" in text
    assert "nothing came yet" in "\n".join(drawn(flows={}))


def test_a_target_that_wants_no_stream_has_its_unit_and_an_input_of_several_streams_has_them_all() -> None:
    more = (*DETECTOR.subscriptions, Subscription("image", Stream("camera.2", "image")))
    units = (UnitView(replace(DETECTOR, subscriptions=more), None, observation("detector.1")),)
    shown = TargetView("shown", "a unit of display", "", 0, unit="display.1")
    text = "\n".join(drawn(replace(SNAPSHOT, units=units, targets=(shown,))))
    assert re.search(r"shown +display\.1", text)
    assert "nothing came yet" not in text
    assert "image ← camera.1/image, image ← camera.2/image" in text
    library = (Transformation("detector", (InputPort("image", "I", count=3),)),)
    fewer = replace(SNAPSHOT, units=units, environment=Environment((), library))
    assert "too little feeds image" in "\n".join(drawn(fewer))


def test_a_cold_spare_is_told_from_what_runs() -> None:
    spare = replace(DETECTOR, id="detector.2", subscriptions=(), publications=(), host="nao2", standby=True)
    units = (*SNAPSHOT.environment.units, spare)
    snapshot = replace(SNAPSHOT, environment=replace(SNAPSHOT.environment, units=units, hosts=(Host("nao2"),)))
    for is_prepared, says in ((False, "a cold spare$"), (True, "a cold spare, prepared$")):
        view = UnitView(spare, "nao2", is_prepared=is_prepared)
        text = "\n".join(line.rstrip() for line in drawn(replace(snapshot, units=(*SNAPSHOT.units, view))))
        assert re.search(rf"detector.2 +nao2 .* {says}", text, re.MULTILINE)
    assert "nothing feeds" not in text


def test_what_is_lost_by_a_death_is_not_told_as_another_reason() -> None:
    review = replace(REVIEW, perturbations=(SubscriptionLost("b.1", "x"), UnitGone("a.1", "a", "died", "")))
    assert "cause: a.1 died; " in "\n".join(drawn(replace(SNAPSHOT, reviews=(review,))))
    failed = replace(
        REVIEW, decision=Decision.FAILED, cause="camera.1 Traceback (most recent call last):\n x\nOSError: no"
    )
    assert "the update failed: camera.1 OSError: no" in "\n".join(drawn(replace(SNAPSHOT, reviews=(failed,))))
    undone = replace(failed, cause="a.1 died", is_undone=True)
    assert ": the update was undone: a.1 died; " in "\n".join(drawn(replace(SNAPSHOT, reviews=(undone,))))


def test_what_units_print_does_nothing_to_the_terminal() -> None:
    line = LogLine(0.0, Level.INFORMATION, "a | \x1b[31mred\x1b[0m\x1b]0;title\x07\tand\x08 \r\x1bc\x9bx")
    (shown,) = [line for line in drawn(lines=[line]) if "red" in line]
    assert shown.split()[1:] == ["a", "|", "red", "and", "x"]
    assert shown.isprintable()


def test_in_a_terminal_a_run_shows_it_and_leaves_the_terminal_as_it_was(tmp_path: Path) -> None:
    env = write_world(tmp_path)
    process, terminal = pty.fork()
    if process == 0:
        arguments = command("run", env, "--no-estimates")
        os.execve(arguments[0], arguments, {**os.environ, "TERM": "xterm-256color"})
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 110, 0, 0))
    shown = b""
    deadline = time.monotonic() + PATIENCE_S
    is_interrupted = False
    while time.monotonic() < deadline:
        if not select.select([terminal], [], [], 0.2)[0]:
            continue
        try:
            shown += os.read(terminal, 1 << 16)
        except OSError:
            break
        if b" Hz" in shown and not is_interrupted:
            is_interrupted = True
            os.write(terminal, b"\x03")
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
    on, off = shown.index(b"\x1b[?1049h"), shown.rindex(b"\x1b[?1049l")
    assert b"1 of 1 met" in shown[on:off]
    assert b"detector(piff).1" in shown[off:]
    assert shown.rindex(b"\x1b[?25h") > shown.rindex(b"\x1b[?25l"), "the cursor is shown again"


@pytest.mark.parametrize("width", [60, 79])
def test_a_narrow_terminal_keeps_the_names_of_units(width: int) -> None:
    unit = ComputationUnit("ball_detector.1", "ball_detector")
    seen = observation(unit.id)
    snapshot = replace(SNAPSHOT, units=(*SNAPSHOT.units, UnitView(unit, "nao1", seen)))
    text = "\n".join(drawn(snapshot, width=width))
    for name in ("camera.1 ", "detector.1 ", "ball_detector.1 ", "segmenter ", "2 %", "30"):
        assert name in text
    for figure in ("memory", "dropped", "errors"):
        assert figure not in text
    failing = replace(SNAPSHOT, units=(UnitView(unit, None, replace(seen, errors=3)),))
    assert "errors" in "\n".join(drawn(failing, width=width)), "what is wrong is shown"
