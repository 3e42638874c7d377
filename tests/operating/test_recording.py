"""Recordings, read back by the reader of the format's own library."""

from __future__ import annotations

import base64
import json
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy
import pytest
from cfgplan_runtime.children.messages import PortCounts
from cfgplan_runtime.lifecycle.reports import Decision, Observed, Review, Reviewed, UnitEvent
from cfgplan_runtime.operating.messages import log_message, messages
from cfgplan_runtime.operating.recording import MOST_SCHEMAS, Recorder, Recording
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import PayloadEncoder
from cfgplan_runtime.supervision.events import UnitDied, UnitHung
from fake_manager import REVIEW, observation

from cfgplan.errors import InputError

NOW_NS = 1_700_000_000_123_456_789


def read(path: Path) -> list[tuple[str, str, int, Any]]:
    """Every message: topic, schema, time, content; each is held against its schema."""
    from mcap.reader import make_reader

    found = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert message.log_time == message.publish_time
            content = json.loads(message.data)
            fits(content, json.loads(schema.data))
            found.append((channel.topic, schema.name, message.log_time, content))
    return found


def fits(value: Any, schema: dict[str, Any]) -> None:
    """Whether a value is what a JSON Schema of types, properties and items says; null for what is no number."""
    kinds = {
        "object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "boolean": bool,
        "null": type(None), None: object,
    }  # fmt: skip
    assert isinstance(value, kinds[schema.get("type")]) or (value, schema) == (None, {"type": "number"})
    for key, inner in schema.get("properties", {}).items():
        if key in value:
            fits(value[key], inner)
    for item in value if isinstance(value, list) and "items" in schema else ():
        fits(item, schema["items"])


def record(path: Path, *values: Any, topic: str = "/result") -> list[tuple[str, str, int, Any]]:
    recording = Recording(path)
    for number, value in enumerate(values):
        for message in messages(topic, value, NOW_NS + number):
            recording.write(message, NOW_NS + number)
    recording.close()
    assert recording.failure is None
    return read(path)


def element(value: Any, time_ns: int = NOW_NS) -> Element:
    return Element(time_ns, 0, 0, b"".join(PayloadEncoder().encode(value)))


def test_a_mapping_is_recorded_as_it_is_and_another_value_in_one(tmp_path: Path) -> None:
    found = record(tmp_path / "a.mcap", {"x": 1, "name": "ball", "seen": True, "where": [1, 2.5], "none": None}, 3.5)
    assert found == [
        (
            "/result",
            "cfgplan.result",
            NOW_NS,
            {"x": 1, "name": "ball", "seen": True, "where": [1, 2.5], "none": None},
        ),
        ("/result", "cfgplan.result", NOW_NS + 1, {"value": 3.5}),
    ]


@pytest.mark.parametrize(
    ("shape", "dtype", "encoding", "step"),
    [
        ((20, 30), "u1", "mono8", 30),
        ((20, 30, 3), "u1", "rgb8", 90),
        ((20, 30, 4), "u1", "rgba8", 120),
        ((20, 30), "<u2", "16UC1", 60),
        ((20, 30), ">u2", "16UC1", 60),
        ((20, 30), "f4", "32FC1", 120),
    ],
)
def test_an_array_that_is_an_image_is_one_for_foxglove(
    tmp_path: Path, shape: tuple[int, ...], dtype: str, encoding: str, step: int
) -> None:
    image = numpy.arange(numpy.prod(shape)).reshape(shape).astype(dtype)
    ((topic, schema, _, content),) = record(tmp_path / "a.mcap", image)
    assert (topic, schema) == ("/result", "foxglove.RawImage")
    assert (content["width"], content["height"], content["encoding"], content["step"]) == (30, 20, encoding, step)
    assert content["timestamp"] == {"sec": 1_700_000_000, "nsec": 123_456_789}
    little = image.astype(image.dtype.newbyteorder("<"))
    assert base64.b64decode(content["data"]) == little.tobytes()


def test_the_images_of_a_mapping_go_beside_it(tmp_path: Path) -> None:
    found = record(tmp_path / "a.mcap", {"x": 1, "image": numpy.zeros((16, 16), "u1"), "jpeg": b"\xff\xd8\xff rest"})
    assert [(topic, schema) for topic, schema, _, _ in found] == [
        ("/result/image", "foxglove.RawImage"),
        ("/result/jpeg", "foxglove.CompressedImage"),
        ("/result", "cfgplan.result"),
    ]
    assert found[1][3]["format"] == "jpeg"
    assert found[2][3] == {"x": 1, "image": {"topic": "/result/image"}, "jpeg": {"topic": "/result/jpeg"}}


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (numpy.eye(2), {"dtype": "float64", "shape": [2, 2], "data": [1, 0, 0, 1]}),
        (numpy.array([True]), {"dtype": "bool", "shape": [1], "data": [True]}),
        (numpy.zeros((20, 0), "u1"), {"dtype": "uint8", "shape": [20, 0], "data": []}),
        (numpy.array([1j]), {"dtype": "complex128", "shape": [1], "data": "AAAAAAAAAAAAAAAAAADwPw=="}),
        (b"abc", "YWJj"),
        ([1, "a", None], [1, "a", None]),
        ([{"x": 1}, {"x": 2}], [{"x": 1}, {"x": 2}]),
        ([], []),
    ],
)
def test_every_value_of_a_stream_can_be_recorded(tmp_path: Path, value: Any, said: Any) -> None:
    ((*_, content),) = record(tmp_path / "a.mcap", value)
    assert content == {"value": said}


def test_what_is_no_number_is_null(tmp_path: Path) -> None:
    ((*_, content),) = record(tmp_path / "a.mcap", {"x": float("nan"), "y": [float("inf"), 1.0]})
    assert content == {"x": None, "y": [None, 1.0]}


def test_a_large_array_that_is_no_image_is_its_bytes(tmp_path: Path) -> None:
    points = numpy.arange(3000, dtype="f8").reshape(1000, 3)
    ((*_, content),) = record(tmp_path / "a.mcap", {"points": points})
    assert content["points"]["shape"] == [1000, 3]
    assert numpy.array_equal(numpy.frombuffer(base64.b64decode(content["points"]["data"])), points.reshape(-1))


def test_a_topic_of_many_forms_does_not_get_ever_more_schemas(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    values = [{f"key{number}": number} for number in range(5 * MOST_SCHEMAS)]
    assert [content for *_, content in record(tmp_path / "a.mcap", *values)] == values
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.channels) == MOST_SCHEMAS + 1


def test_elements_and_reports_of_a_run_are_recorded(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.element("/result", element({"x": 1}))
    recorder.report(UnitEvent(UnitDied("detector.1", "exited with 3")))
    recorder.report(Reviewed(REVIEW))
    recorder.report(Observed((observation("camera.1"),)))
    assert recorder.close()
    assert recorder.lost == 0
    by_topic: dict[str, list[Any]] = {}
    for topic, _, _, content in read(tmp_path / "a.mcap"):
        by_topic.setdefault(topic, []).append(content)
    assert by_topic["/result"] == [{"x": 1}]
    assert by_topic["/cfgplan/events"] == [
        {"kind": "UnitDied", "unit": "detector.1", "cause": "exited with 3", "how": "died"}
    ]
    (review,) = by_topic["/cfgplan/reviews"]
    assert (review["decision"], review["cost_us"]) == ("applied", 2_000_000)
    ((unit,),) = [units["units"] for units in by_topic["/cfgplan/units"]]
    assert (unit["unit"], unit["memory_bytes"]) == ("camera.1", 25 << 20)
    died, reviewed = by_topic["/cfgplan/log"]
    assert (died["level"], died["message"]) == (4, "detector.1 died: exited with 3")
    assert reviewed["message"].startswith("Review 1: started detector.1; goal is not met: nothing gives Goal")


def test_cost_cpu_and_rates_can_be_plotted_from_what_the_schemas_say(tmp_path: Path) -> None:
    counts = PortCounts(elements=7, dropped=1)
    seen = replace(observation("camera.1"), inputs={"x": counts}, outputs={"image": counts}, pid=7)
    unknown = Review(2, 1.0, 2.0, (), Decision.UNDECIDED, 60, 1_000_000)
    recorder = Recorder(tmp_path / "a.mcap")
    for report in (Reviewed(REVIEW), Reviewed(unknown), Observed((seen,)), UnitEvent(UnitHung("camera.1", 11.5))):
        recorder.report(report)
    assert recorder.close()
    read(tmp_path / "a.mcap")
    assert plotted(tmp_path / "a.mcap", "/cfgplan/reviews", "cost_us") == [2_000_000]
    assert plotted(tmp_path / "a.mcap", "/cfgplan/reviews", "seconds", "plan") == [0.002]
    for path, value in {
        ("upkeep_us",): 20_000,
        ("steps_per_s",): 30.0,
        ("pid",): 7,
        ("inputs", 0, "dropped"): 1,
        ("outputs", 0, "elements"): 7,
    }.items():
        assert plotted(tmp_path / "a.mcap", "/cfgplan/units", "units", 0, *path) == [value]
    assert plotted(tmp_path / "a.mcap", "/cfgplan/events", "silent_s") == [11.5]


def plotted(file: Path, topic: str, *path: str | int) -> list[float]:
    """The numbers at a path of a topic's messages, if the schema says that there are numbers."""
    from mcap.reader import make_reader

    found = []
    with file.open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages(topics=[topic]):
            assert schema is not None
            form, value = json.loads(schema.data), json.loads(message.data)
            for step in path:
                inner = form.get("properties", {}).get(step, form.get("additionalProperties"))
                form = form["items"] if isinstance(step, int) else inner
                known = value is not None and (isinstance(step, int) or step in value)
                value = value[step] if known else None
            assert form["type"] in ("integer", "number"), path
            found += [] if value is None else [value]
    return found


def test_what_was_flushed_survives_a_crash_of_the_recorder(tmp_path: Path) -> None:
    from mcap.stream_reader import StreamReader

    recording = Recording(tmp_path / "a.mcap")
    recording.write(log_message("/log", 2, "test", "before", NOW_NS), NOW_NS)
    recording.flush()
    with (tmp_path / "a.mcap").open("rb") as file:
        records = StreamReader(file).records
        kinds = [type(next(records)).__name__ for _ in range(4)]
    recording.close()
    assert kinds == ["Header", "Schema", "Channel", "Message"]


def test_a_file_that_exists_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("precious")
    with pytest.raises(InputError, match="the file exists already"):
        Recorder(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_text() == "precious"


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can't be written: No such file or directory"):
        Recorder(tmp_path / "nowhere" / "a.mcap")


@contextmanager
def full_disk_at(size: int) -> Iterator[None]:
    """Files can't grow beyond so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [0, 1, 100, *range(200_000, 200_050, 10)])
def test_a_full_disk_ends_the_recording_as_a_whole_file_and_is_told(tmp_path: Path, size: int) -> None:
    recorder = Recorder(tmp_path / "a.mcap") if size > 1000 else None
    noise = numpy.random.default_rng(1)
    with full_disk_at(size):
        recorder = recorder or Recorder(tmp_path / "a.mcap")
        for number in range(100):
            recorder.element("/noise", element({"number": number, "bytes": noise.bytes(10_000)}, NOW_NS + number))
            recorder.recording.flush()
        assert recorder.close()
    assert recorder.recording.failure == "File too large"
    assert recorder.recording.written + recorder.lost == 100
    if size > 1000:
        numbers = [content["number"] for *_, content in read(tmp_path / "a.mcap")]
        assert numbers == list(range(len(numbers)))
        assert recorder.recording.written - 1 <= len(numbers)
        assert len(numbers) > 10


def test_a_disk_that_hangs_keeps_nobody_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import threading

    from cfgplan_runtime.operating import recording as module

    monkeypatch.setattr(module, "CLOSE_S", 0.2)
    recorder = Recorder(tmp_path / "a.mcap")
    disk_works = threading.Event()
    monkeypatch.setattr(recorder.recording, "write", lambda *_: disk_works.wait(60))
    began = time.monotonic()
    for _ in range(module.MOST_WAITING_REPORTS + 10):
        recorder.report(Reviewed(REVIEW))
    assert not recorder.close()
    assert time.monotonic() - began < 30
    assert recorder.lost >= 1
    disk_works.set()
