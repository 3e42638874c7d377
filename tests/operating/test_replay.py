"""`cfgplan replay`: what was recorded comes again, and the recorded run is planned and run again."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy
import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.children.unit_code import At
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.operating.messages import messages
from cfgplan_runtime.operating.recorded import recorded, values
from cfgplan_runtime.operating.recording import Recording
from cfgplan_runtime.replay import Source
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from operated_world import ONTOLOGY, PATIENCE_S, await_event, command, running, write_world

from cfgplan import api
from cfgplan.cli import main, replay
from cfgplan.errors import InputError

SECOND_NS = 1_000_000_000
BEGUN_NS = 1_700_000_000 * SECOND_NS
PLAIN = [
    3,
    2.5,
    "text",
    b"bytes",
    True,
    [1, 2, 3],
    {"a": 1, "b": {"c": "d", "e": b"f"}},
    {"list": [{"x": 1}, {"x": 2}]},
]
JPEG = b"\xff\xd8\xff\xe0 a picture"


def write(path: Path, *given: tuple[str, int, Any]) -> Path:
    """A recording of values: topic, time in nanoseconds, value."""
    recording = Recording(path)
    for topic, time_ns, value in given:
        for message in messages(topic, value, time_ns):
            recording.write(message, time_ns)
    recording.close()
    return path


@pytest.mark.parametrize("value", PLAIN, ids=repr)
def test_a_value_is_read_as_it_was_recorded(tmp_path: Path, value: Any) -> None:
    path = write(tmp_path / "a.mcap", ("/t", BEGUN_NS, value))
    assert list(values(path, "/t")) == [(BEGUN_NS, value)]


@pytest.mark.parametrize(
    "array",
    [
        numpy.arange(256, dtype=numpy.uint8).reshape(16, 16),
        numpy.arange(16 * 20 * 3, dtype=numpy.uint8).reshape(16, 20, 3) % 251,
        numpy.linspace(0, 1, 400, dtype=numpy.float32).reshape(20, 20),
        numpy.array([[1.5, 2.5]]),
        numpy.arange(5000, dtype=numpy.int64),
        numpy.array([True, False]),
    ],
    ids=lambda array: f"{array.dtype}{array.shape}",
)
def test_arrays_and_images_are_read_as_they_were_alone_and_in_mappings(tmp_path: Path, array: Any) -> None:
    mapping = {"robot": "piff", "image": array, "jpeg": JPEG}
    path = write(tmp_path / "a.mcap", ("/alone", BEGUN_NS, array), ("/mapping", BEGUN_NS + 1, mapping))
    assert list(recorded(path).topics) == ["/alone", "/mapping"]
    ((_, alone),) = values(path, "/alone")
    ((_, inside),) = values(path, "/mapping")
    for read in (alone, inside["image"]):
        assert read.dtype == array.dtype and (read == array).all() and read.shape == array.shape
    assert (inside["robot"], inside["jpeg"]) == ("piff", JPEG)


class Time:
    """A clock that only sleeping moves."""

    def __init__(self) -> None:
        self.now_ns = BEGUN_NS

    def __call__(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


def source(path: Path, clock: Time, **more: Any) -> Iterator[At]:
    return (one for one in Source(str(path), "/b", now_ns=clock, sleep=clock.sleep, **more) if one is not None)


@pytest.fixture
def ticks(tmp_path: Path) -> Path:
    """/a has something at 0 s, /b a number at 1, 2 and 3 s."""
    numbers = [("/b", 77 + second * SECOND_NS, second) for second in (1, 2, 3)]
    return write(tmp_path / "a.mcap", ("/a", 77, "begin"), *numbers)


@pytest.mark.parametrize("speed", [1.0, 4.0, 0.5])
def test_values_come_as_far_apart_as_they_were_or_faster(ticks: Path, speed: float) -> None:
    clock = Time()
    given = list(source(ticks, clock, speed=speed))
    assert [one.value for one in given] == [1, 2, 3]
    assert [(one.time_ns - BEGUN_NS) * speed / SECOND_NS for one in given] == [1, 2, 3]
    assert clock.now_ns == pytest.approx(BEGUN_NS + 3 / speed * SECOND_NS, abs=1000)


def test_a_source_that_is_started_again_goes_on_where_the_others_are(ticks: Path) -> None:
    clock = Time()
    clock.now_ns += round(1.5 * SECOND_NS)
    assert [one.value for one in source(ticks, clock, begin_ns=BEGUN_NS)] == [2, 3]
    clock.now_ns = BEGUN_NS + 100 * SECOND_NS
    assert list(source(ticks, clock, begin_ns=BEGUN_NS)) == []


def test_a_loop_begins_again_a_second_after_the_end(ticks: Path) -> None:
    clock = Time()
    given = list(islice(source(ticks, clock, loop=True), 7))
    assert [one.value for one in given] == [1, 2, 3, 1, 2, 3, 1]
    assert [(one.time_ns - BEGUN_NS) // SECOND_NS for one in given] == [1, 2, 3, 5, 6, 7, 9]
    clock.now_ns = BEGUN_NS + round(5.5 * SECOND_NS)
    assert [one.value for one in islice(source(ticks, clock, loop=True, begin_ns=BEGUN_NS), 3)] == [2, 3, 1]


def test_what_can_not_be_played_is_refused(ticks: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no topic '/c'"):
        Source(str(ticks), "/c")
    with pytest.raises(InputError, match="0 times as fast"):
        Source(str(ticks), "/b", speed=0)
    (tmp_path / "text").write_text("no recording at all")
    with pytest.raises(InputError, match="this is not a recording \\(a recording of"):
        recorded(tmp_path / "text")
    (tmp_path / "cut").write_bytes(ticks.read_bytes()[:100])
    with pytest.raises(InputError, match=r"this recording has no end: .*wait for the end of the run.*mcap recover"):
        recorded(tmp_path / "cut")
    whole = ticks.read_bytes()
    (tmp_path / "damaged").write_bytes(whole[:100] + bytes(len(whole) - 120) + whole[-20:])
    with pytest.raises(InputError, match=r"this recording is damaged .*another copy.*mcap recover"):
        recorded(tmp_path / "damaged")
    with pytest.raises(InputError, match="no such file"):
        recorded(tmp_path / "nothing")


def damages(whole: bytes) -> st.SearchStrategy[bytes]:
    """A file that was cut, or in which some bytes have changed, or anything else of a few bytes."""
    place = st.integers(0, len(whole) - 1)

    def changed(bytes_at: dict[int, int]) -> bytes:
        return bytes(bytes_at.get(at, byte) for at, byte in enumerate(whole))

    some = st.dictionaries(place, st.integers(0, 255), min_size=1, max_size=3)
    return place.map(lambda length: whole[:length]) | some.map(changed) | st.binary(max_size=40)


@settings(max_examples=600, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_recording_is_read_or_refused(ticks: Path, data: st.DataObject) -> None:
    damaged = ticks.with_name("damaged")
    damaged.write_bytes(data.draw(damages(ticks.read_bytes())))
    with suppress(InputError):
        recorded(damaged)


def test_messages_of_other_programs_are_refused_by_name(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/scan", "cdr", writer.register_schema("Scan", "ros2msg", b""))
        writer.add_message(channel, 1, b"", 1)
        writer.finish()
    with pytest.raises(InputError, match="/scan has messages in cdr, not in JSON"):
        recorded(path)


@pytest.fixture
def run_recorded(tmp_path: Path) -> Path:
    """A recording of the world of `operated_world`."""
    env, path = write_world(tmp_path), tmp_path / "run.mcap"
    with running(env, "--record", path) as process, subscribe("/result", wait_s=PATIENCE_S) as results:
        assert len(list(islice(results, 60))) == 60
        assert main(["ctl", "stop"]) == 0
        await_event(process, "Recorded")
        assert process.wait(PATIENCE_S) == 0
    return path


def test_a_recorded_run_is_planned_and_run_again(
    run_recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "again"
    assert main(["replay", str(run_recorded), "--extract", str(again)]) == 0
    assert f"Next: `cfgplan solve {again / 'environment.yaml'}`" in capsys.readouterr().err
    assert main(["solve", str(again / "environment.yaml"), "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    assert main(["solve", str(tmp_path / "env.yaml"), "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert (planned["change_set"], planned["cost_us"]) == (first["change_set"], first["cost_us"])
    with running(again / "environment.yaml"), subscribe("/result", wait_s=PATIENCE_S) as results:
        assert next(iter(results)).value["robot"] == "piff"
    assert main(["replay", str(run_recorded), "--extract", str(again)]) == 30
    assert "exists already" in capsys.readouterr().err


def test_what_was_recorded_comes_again_on_its_topics(run_recorded: Path) -> None:
    line = command("replay", run_recorded, "--speed", "2", "--loop", "--plain")
    with subprocess.Popen(line, stdout=subprocess.PIPE) as player:
        with subscribe("/result", wait_s=PATIENCE_S) as results:
            values = [one.value for one in islice(results, 20)]
        assert main(["ctl", "stop"]) == 0
        assert player.wait(PATIENCE_S) == 0
    assert {value["robot"] for value in values} == {"piff"}
    assert all(value["image"].shape == (32, 32) and value["image"][0, 0] == value["number"] for value in values)


FED = """\
format: cfgplan/1
ontology: field.ttl
transformations:
  - {label: counter, source: "count.py:count", inputs: {ball: Ball}, outputs: {number: Goal}}
targets:
  - {label: ball, topic: /result, tag: Ball}
  - {label: goal, topic: /goal, tag: Goal}
"""


def test_recorded_topics_feed_the_units_of_an_environment(
    run_recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "fed.yaml").write_text(FED)
    (tmp_path / "count.py").write_text("def count(ball):\n    return ball['number']\n")
    part = tmp_path / "part.yaml"
    assert main(["replay", str(run_recorded), str(tmp_path / "fed.yaml"), "--out", str(part)]) == 0
    capsys.readouterr()
    assert main(["solve", str(tmp_path / "fed.yaml"), "--with", str(part)]) == 0
    assert "ball <- recorded(/result).1/value" in capsys.readouterr().out
    line = command("replay", run_recorded, tmp_path / "fed.yaml", "--loop", "--plain")
    with subprocess.Popen(line, stdout=subprocess.PIPE) as player:
        with subscribe("/goal", wait_s=PATIENCE_S) as goals:
            assert all(isinstance(one.value, int) for one in islice(goals, 5))
        assert main(["ctl", "stop"]) == 0
        assert player.wait(PATIENCE_S) == 0


def test_what_a_replay_lacks_is_told(run_recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(run_recorded), "--topic", "/resul"]) == 30
    assert "did you mean `/result`" in capsys.readouterr().err
    other = tmp_path / "other.yaml"
    other.write_text("format: cfgplan/1\nontology: field.ttl\ntargets: [{label: g, topic: /g, tag: Goal}]\n")
    assert main(["replay", str(run_recorded), str(other)]) == 30
    assert "no target of the environment has one of the recorded topics (/result)" in capsys.readouterr().err
    plain = write(tmp_path / "plain.mcap", ("/t", BEGUN_NS, 1))
    assert main(["replay", str(plain), "--extract", str(tmp_path / "x")]) == 30
    assert "does not hold its run's environment" in capsys.readouterr().err
    assert main(["replay", str(plain), "--dry-run"]) == 0
    assert "recorded(/t).1" in capsys.readouterr().out


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """A recording of /image, /result and /other."""
    given = [("/image", BEGUN_NS, [1, 2]), ("/result", BEGUN_NS + 1, 3), ("/other", BEGUN_NS + 2, 4)]
    return write(tmp_path / "run.mcap", *given)


TAKEN = """\
format: cfgplan/1
ontology: field.ttl
transformations:
  - {label: camera, source: "units.py:camera", labor: 1, outputs: {image: Image}}
  - {label: detector, source: "units.py:Detector", inputs: {image: Image}, outputs: {ball: Ball}}
targets:
  - {label: ball, topic: /result, tag: Ball}
"""
IMAGES = "  - {label: image, topic: /image, tag: Image}\n"
GOALS = "  - {label: goal, topic: /goal, tag: Goal}\n  - {label: other, topic: /other, tag: Field}\n"
COUNTER = '  - {label: counter, source: "count.py:count", inputs: {ball: Ball}, outputs: {number: Goal}}\n'
NOBODY = "warning: no unit of env.yaml uses a recorded topic: only listeners receive"


@pytest.mark.parametrize(
    ("text", "more", "said", "unsaid"),
    [
        (
            TAKEN,
            [],
            [
                "/image, /other can't be played: no target of env.yaml has the topic",
                f"{NOBODY} /result",
                "camera was not recorded; give it a target and record again: {label: input, topic: /input, tag: Image}",
            ],
            ["--topic"],
        ),
        (TAKEN + IMAGES, [], [f"{NOBODY} /image, /result", "play only --topic /image"], ["not recorded"]),
        (TAKEN + IMAGES, ["--topic", "/image"], [], ["can't be played", "uses"]),
        (
            TAKEN.replace("targets:", f"{COUNTER}targets:") + GOALS,
            [],
            ["No unit of env.yaml uses /other: only listeners receive it."],
            ["warning: no unit", "not recorded"],
        ),
        (
            TAKEN.replace("inputs: {image: Image}, ", ""),
            [],
            [f"{NOBODY} /result", "`cfgplan match env.yaml` shows which outputs may feed which inputs"],
            ["not recorded"],
        ),
    ],
)
def test_recorded_topics_that_no_unit_uses_are_named_with_the_remedy(
    pictures: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    text: str,
    more: list[str],
    said: list[str],
    unsaid: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "env.yaml").write_text(text)
    (tmp_path / "field.ttl").write_text(ONTOLOGY)
    assert main(["replay", str(pictures), "env.yaml", *more, "--out", "part.yaml"]) == 0
    told = capsys.readouterr().err
    assert [part for part in said if part not in told] == []
    assert [part for part in unsaid if part in told] == []


def test_a_recording_begins_seconds_after_the_plan_whose_topics_are_told_was_made(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, played = [0], list[str]()

    def plan(*_: object) -> None:
        now_s[0] += 60

    def play(path: Path, *_: object) -> int:
        played.append(path.read_text())
        return 0

    monkeypatch.chdir(tmp_path)
    (tmp_path / "env.yaml").write_text(TAKEN)
    (tmp_path / "field.ttl").write_text(ONTOLOGY)
    monkeypatch.setattr(replay, "time", SimpleNamespace(time_ns=lambda: now_s[0] * 10**9))
    monkeypatch.setattr(replay, "_tell_untaken", plan)
    monkeypatch.setattr(replay, "_play", play)
    assert main(["replay", str(pictures), "env.yaml"]) == 0
    assert re.findall(r"begin_ns: (\d+)", played[0]) == [f"{63 * 10**9}"]


def test_the_plan_that_warnings_need_does_not_keep_a_replay_waiting(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve, limits = api.solve, list[float | None]()

    def solved(world: api.World, *, time_limit_s: float | None = None) -> api.Solved:
        limits.append(time_limit_s)
        return solve(world, time_limit_s=time_limit_s)

    monkeypatch.chdir(tmp_path)
    (tmp_path / "env.yaml").write_text(TAKEN)
    (tmp_path / "field.ttl").write_text(ONTOLOGY)
    monkeypatch.setattr(api, "solve", solved)
    assert main(["replay", str(pictures), "env.yaml", "--out", "part.yaml"]) == 0
    assert limits == [Policy().time_limit_s], "as in a run"


def test_a_replay_counts_the_topics_that_it_plays(pictures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, number in (((), "3 topics"), (("--topic", "/image"), "1 topic")):
        assert main(["replay", str(pictures), *arguments, "--dry-run"]) == 0
        assert f"Playing {number} of run.mcap." in capsys.readouterr().err
