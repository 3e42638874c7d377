"""The parts of the page without a browser: its first line, values as it shows them, and source lines of faults."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy
import pytest
from cfgplan_runtime.lifecycle.reports import BackingOff, Snapshot, TargetView, UnitView
from cfgplan_runtime.operating.records import snapshot_record
from cfgplan_runtime.page.health import health
from cfgplan_runtime.page.shown_values import LARGEST_IMAGE, LARGEST_SIDE, MOST_CHARACTERS, shown
from cfgplan_runtime.page.source_lines import error_record, fault_record
from cfgplan_runtime.page.watched import as_seen
from fake_manager import SNAPSHOT
from page_world import building, observed

from cfgplan.errors import Fault
from cfgplan.unmet import Lack, NeededBy, Reason

WELL = building(31)


def said(snapshot: Snapshot, **flows: Any) -> tuple[str, str]:
    told = health(snapshot_record(snapshot, flows))
    return told["level"], told["says"]


def with_targets(snapshot: Snapshot, *unmet: tuple[str, int, str]) -> Snapshot:
    """The snapshot with some targets (label, priority, reason) unmet."""
    lost = {label: (priority, reason) for label, priority, reason in unmet}
    targets = (
        replace(one, stream=None, unit=None, priority=lost[one.label][0], reason=lost[one.label][1])
        if one.label in lost
        else one
        for one in snapshot.targets
    )
    return replace(snapshot, targets=tuple(targets))


def test_it_says_that_all_is_well() -> None:
    assert said(WELL) == ("well", "All is well. All 16 targets are met by 31 units.")
    assert said(replace(WELL, targets=())) == ("well", "All is well. No target is set.")


def test_it_names_the_first_unmet_target_by_priority_with_its_reason() -> None:
    few = with_targets(WELL, ("comfort of room1", 0, "no thermometer"), ("comfort of room2", 5, "no power"))
    assert said(few) == ("bad", "2 of 16 targets are not met. The first is comfort of room2: no power.")
    one = with_targets(WELL, ("comfort of room1", 0, ""))
    assert said(one) == ("bad", "1 of 16 targets is not met. It is comfort of room1: a review is under way.")


def test_lists_of_the_page_tell_a_reason_once_as_the_terminal_does() -> None:
    """Each target had the whole sentence, of which its row had room for the first words, and each copy of a unit that
    waits had a line.
    """
    lack = Lack("no output matches", "U", NeededBy("x", "i"))
    views = [TargetView(label, "T", f"/{label}", 0, None, Reason(lack, label, "T")) for label in "cab"]
    waiting = (BackingOff("a", 2, 4.0, "exited with 3"), BackingOff("b", 2, 3.0, "exited with 3"))
    seen = as_seen(snapshot_record(replace(WELL, targets=(*WELL.targets[:1], *views), backing_off=waiting)))
    shown = [(target["label"], target.get("as"), target.get("told")) for target in seen["targets"]]
    told = "input i of x needs U, and no output matches"
    assert shown == [*((label, "a", told) for label in "abc"), (WELL.targets[0].label, None, None)]
    assert [(one["names"], one["says"]) for one in seen["waiting"]] == [
        (("a", "b"), "not started for up to 4 s, failed 2 times: exited with 3")
    ]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"lost_hosts": ("roof",)}, "host roof is gone"),
        ({"backing_off": (BackingOff("a", 3, 4.0, "exited with 3"),)}, "a waits to be started again: exited with 3"),
        ({"old_code": {"units.py": ("a.1", "b.1")}}, "a.1, b.1 run with the code from before units.py changed"),
        ({"faults": (Fault("this is not YAML"),)}, "the file has an error: this is not YAML"),
    ],
)
def test_it_warns_of_what_needs_an_eye_though_all_targets_are_met(change: dict[str, Any], says: str) -> None:
    assert said(replace(WELL, **change)) == ("warning", f"All targets are met, but {says}.")


def test_it_warns_of_silent_streams_and_failing_units_and_counts_other_warnings() -> None:
    first = WELL.units[0]
    failing = UnitView(first.unit, first.host, replace(observed(first.unit, 0), errors=2))
    snapshot = replace(WELL, units=(failing, *WELL.units[1:]))
    assert said(snapshot) == ("warning", "All targets are met, but logger.1 has failed in 2 steps.")
    silent = {"/log": {"rate_hz": 0.0, "silent_s": 75.0}}
    lead = "All targets are met, but nothing has come for everything that was measured for 75 s."
    assert said(snapshot, **silent) == ("warning", f"{lead} 1 other warning.")


def pixels(url: str) -> numpy.ndarray[Any, Any]:
    image = pytest.importorskip("matplotlib.image", reason="matplotlib is not installed (extra plots)")
    kind, _, data = url.partition(",")
    assert kind == "data:image/png;base64"
    return (image.imread(BytesIO(b64decode(data)), format="png") * 255).round().astype(numpy.uint8)


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3), (20, 30, 4)])
def test_arrays_of_pixels_are_images_as_they_are(shape: tuple[int, ...]) -> None:
    array = numpy.random.default_rng(1).integers(0, 255, shape, numpy.uint8)
    told = shown({"image": array, "number": 3})
    assert numpy.array_equal(pixels(told["images"]["image"]), array)
    assert told["numbers"] == {"number": 3.0}


def test_images_are_bounded_in_size_and_other_numbers_are_scaled() -> None:
    large = numpy.zeros((1000, 2000), numpy.uint8)
    assert max(pixels(shown(large)["images"][""]).shape) <= LARGEST_SIDE
    depth = numpy.linspace(0.0, 4.0, 400, dtype=numpy.float32).reshape(20, 20)
    scaled = pixels(shown(depth)["images"][""])
    assert (scaled.min(), scaled.max()) == (0, 255)
    depth[0, 0] = numpy.nan
    assert shown(depth)["images"]


@pytest.mark.parametrize(
    ("encoding", "shape", "order"),
    [("rgb8", (20, 30, 3), [0, 1, 2]), ("bgr8", (20, 30, 3), [2, 1, 0]), ("mono8", (20, 30), None)],
)
def test_image_messages_of_ros_are_images(encoding: str, shape: tuple[int, ...], order: list[int] | None) -> None:
    image = numpy.random.default_rng(1).integers(0, 255, shape, numpy.uint8)
    padded = numpy.pad(image.reshape(20, -1), ((0, 0), (0, 7)))
    told = {"height": 20, "width": 30, "encoding": encoding, "is_bigendian": 0, "step": padded.shape[1]}
    shown_as = pixels(shown({"header": {}, **told, "data": padded.reshape(-1)})["images"][""])
    assert numpy.array_equal(shown_as if order is None else shown_as[..., order], image)
    assert shown({**told, "data": padded.reshape(-1)[:-8]})["images"] == {}
    deep = numpy.linspace(0, 60_000, 600).astype(">u2").tobytes()
    depth = {**told, "encoding": "16UC1", "is_bigendian": 1, "step": 60, "data": numpy.frombuffer(deep, numpy.uint8)}
    assert (pixels(shown(depth)["images"][""])[0, 0], pixels(shown(depth)["images"][""])[-1, -1]) == (0, 255)
    jpeg = numpy.frombuffer(b"\xff\xd8\xff" + bytes(100), numpy.uint8)
    assert shown({"format": "jpeg", "data": jpeg})["images"][""].startswith("data:image/jpeg")


def test_compressed_images_are_passed_on_unless_they_are_too_large() -> None:
    jpeg = b"\xff\xd8\xff" + bytes(100)
    url = shown(jpeg)["images"][""]
    assert url.startswith("data:image/jpeg;base64,")
    assert b64decode(url.partition(",")[2]) == jpeg
    assert shown(jpeg + bytes(LARGEST_IMAGE)) == {
        "numbers": {},
        "text": f"JPEG image of {LARGEST_IMAGE + 103} bytes",
        "images": {},
    }
    assert shown(b"abc")["text"] == "3 bytes"


def test_numbers_texts_and_nested_values_are_shown_and_long_ones_cut() -> None:
    assert shown(2.5) == {"numbers": {"": 2.5}, "text": "2.5", "images": {}}
    assert shown(float("nan"))["numbers"] == {}
    assert shown(numpy.array([3]))["numbers"] == {"": 3.0}
    assert shown("a <b>")["text"] == "a <b>"
    assert shown({"pose": [1, 2], "big": numpy.zeros((100, 100))})["text"] == (
        '{\n "pose": [\n  1,\n  2\n ],\n "big": "float64 100 x 100"\n}'
    )
    assert len(shown("x" * 10**6)["text"]) < MOST_CHARACTERS + 100
    assert len(shown(list(range(10**6)))["text"]) < MOST_CHARACTERS


def test_a_fault_of_a_file_has_its_line_and_caret(tmp_path: Path) -> None:
    file = tmp_path / "env.yaml"
    file.write_text("a: 1\nb: two\n")
    (fault,) = snapshot_record(replace(SNAPSHOT, faults=(Fault("not two", str(file), 2, 4, mend="write 2"),)))["faults"]
    assert fault_record(fault) == {
        "message": "not two",
        "place": f"{file}:2:4",
        "mend": "write 2",
        "lines": ["    2 | b: two", "      |    ^^^"],
    }


def test_an_error_of_a_unit_has_the_last_line_of_its_own_code(tmp_path: Path) -> None:
    code = tmp_path / "units.py"
    code.write_text("x = 1\ny = x / 0\n")
    import cfgplan_runtime

    ours = Path(cfgplan_runtime.__file__).parent / "children" / "steps.py"
    frames = f'  File "{code}", line 2, in step\n    y\n  File "{ours}", line 3, in run\n'
    text = f"Traceback ...\n{frames}ZeroDivisionError: no\n"
    assert error_record(text) == {
        "message": "ZeroDivisionError: no",
        "place": f"{code}:2",
        "mend": None,
        "lines": ["    2 | y = x / 0", "      | ^^^^^^^^^"],
    }
    assert error_record("it exited")["lines"] == []


def test_a_units_error_shows_no_file_but_code(tmp_path: Path) -> None:
    secret = tmp_path / "secrets"
    secret.write_text("password\n")
    named = error_record(f'  File "{secret}", line 1, in step\nValueError: no\n')
    assert (named["place"], named["lines"]) == ("", [])
