"""Numbers that are read from messages as they are on the wire, beside those that rosbags decodes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy
import pytest
from cfgplan_runtime.nodes.message_layout import (
    Layout,
    NumberReader,
    Several,
    Text,
    UnreadableError,
    field_fault,
    kind_of,
    ros1_layout,
)
from cfgplan_runtime.ros2.definitions import Definitions
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from cfgplan.ros.types import MessageType

PACKAGES = (
    "std_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "nav_msgs",
    "visualization_msgs",
    "diagnostic_msgs",
    "stereo_msgs",
)
FORMS = {"ros2": Stores.ROS2_JAZZY, "ros1": Stores.ROS1_NOETIC}


def made(store: Typestore, name: str, turn: list[int]) -> Any:
    """A message with numbers that all differ, as far as they can, and sequences of three."""

    def value(what: Any, size: int = 3) -> Any:
        if what[0] == Nodetype.NAME:
            return made(store, what[1], turn)
        if what[0] == Nodetype.BASE:
            turn[0] += 1
            kind = what[1][0]
            if kind == "string":
                return "x" * (turn[0] % 7)
            return turn[0] % 2 == 0 if kind == "bool" else turn[0] / 4 if kind.startswith("float") else turn[0] % 100
        inner, length = what[1]
        length = length if what[0] == Nodetype.ARRAY else size
        values = [value(inner) for _ in range(length)]
        is_number = inner[0] == Nodetype.BASE and inner[1][0] != "string"
        return numpy.array(values, dtype=inner[1][0]) if is_number else values

    return store.types[name](*(value(what) for _, what in store.fielddefs[name][1]))


def numbers(kind: Any, value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Each number in a value, with the path to it."""
    if isinstance(kind, Layout):
        for name, inner in kind.fields.items():
            yield from numbers(
                inner, getattr(value, {"secs": "sec", "nsecs": "nanosec"}.get(name, name)), f"{path}.{name}"
            )
    elif isinstance(kind, Several):
        for place, inner in enumerate(value):
            yield from numbers(kind.of, inner, f"{path}.{place}")
    elif not isinstance(kind, Text):
        yield path.removeprefix("."), float(value)


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("ros", FORMS)
def test_every_number_of_a_message_is_read_as_rosbags_decodes_it(ros: str, package: str) -> None:
    store = get_typestore(FORMS[ros])
    names = [
        name for name in sorted(store.fielddefs) if name.startswith(f"{package}/") and "string" not in name.lower()
    ]
    assert names
    for name in names:
        message = made(store, name, [0])
        if ros == "ros2":
            kind, wire = Definitions("jazzy").layout(MessageType.read(name)), bytes(store.serialize_cdr(message, name))
        else:
            definition, _ = store.generate_msgdef(name, ros_version=1)
            body = bytes(store.serialize_ros1(message, name))
            kind, wire = ros1_layout(name.replace("/msg/", "/"), definition), struct.pack("<I", len(body)) + body
        for path, number in numbers(kind, message):
            assert (name, path, field_fault(kind, path)) == (name, path, "")
            read = NumberReader(kind, path, is_aligned=ros == "ros2").number(wire)
            assert (name, path, read) == (name, path, number)


def layout(**fields: str) -> Layout:
    def unknown(name: str) -> Layout:
        raise KeyError(name)

    return Layout("own/Type", {name: kind_of(text, unknown) for name, text in fields.items()})


def test_bytes_in_the_other_order_are_read() -> None:
    reader = NumberReader(layout(flag="boolean", number="double"), "number", is_aligned=True)
    assert reader.number(b"\0\0\0\0\1" + 7 * b"\0" + struct.pack(">d", 2.5)) == 2.5


def test_a_message_without_fields_takes_a_byte_in_ros_2() -> None:
    whole = Layout(
        "own/Whole", {"empty": Layout("own/Empty", {}), "number": kind_of("uint8", lambda _: Layout("", {}))}
    )
    assert NumberReader(whole, "number", is_aligned=True).number(b"\0\1\0\0\0\7") == 7
    assert NumberReader(whole, "number", is_aligned=False).number(b"\1\0\0\0\7") == 7


def test_too_few_values_are_none_and_a_message_that_is_too_short_is_an_error() -> None:
    reader = NumberReader(layout(values="sequence<double>"), "values.1", is_aligned=True)
    assert reader.number(b"\0\1\0\0\1\0\0\0" + 4 * b"\0" + struct.pack("<d", 1.0)) is None
    with pytest.raises(UnreadableError, match=r"too short for a own/Type"):
        reader.number(b"\0\1\0\0\2\0\0\0")
    texts = NumberReader(layout(texts="sequence<string>", number="uint8"), "number", is_aligned=True)
    with pytest.raises(UnreadableError, match="too short"):
        texts.number(b"\0\1\0\0\xff\xff\xff\xff")


@pytest.mark.parametrize(
    ("path", "fault"),
    [
        ("number", ""),
        ("values.7", ""),
        ("fixed.2", ""),
        ("other", "own/Type has no field `other`; it has number, values, fixed, wide, late"),
        ("fixed.3", "`fixed` has several values: name one by its number, from 0 to 2"),
        ("fixed.x", "`fixed` has several values: name one by its number, from 0 to 2"),
        ("values", "`values` is not a number; name one of its values by its number, from 0"),
        ("number.x", "`number` has no parts"),
        ("wide", "`wide` is not a number"),
        ("late", "own/Type has a text of wide characters before `late`, behind which nothing can be read"),
    ],
)
def test_a_path_that_leads_to_no_number_is_told(path: str, fault: str) -> None:
    own = layout(number="int8", values="float64[]", fixed="float32[3]", wide="wstring<9>", late="bool")
    assert field_fault(own, path) == fault


def test_a_definition_that_lacks_a_type_is_an_error() -> None:
    with pytest.raises(UnreadableError, match="the definition of own/Type lacks that of own/Other"):
        ros1_layout("own/Type", "int8 LIMIT=3 # one\nOther other\n")
