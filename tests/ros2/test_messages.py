"""Values become messages by the names of fields, and messages values; what does not fit is told by its path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy
import pytest
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.ros2.definitions import NO_HASH, Definitions
from cfgplan_runtime.ros2.message_form import MessageForm, MisfitError
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from cfgplan.errors import InputError
from cfgplan.ros.types import MessageType

NOW_NS = 1_700_000_000_123_456_789
HASHES = {
    "std_msgs/msg/Char": "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "std_msgs/msg/Header": "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "sensor_msgs/msg/CameraInfo": "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
}
"""As `ros2 topic info --verbose` tells them in Jazzy."""
EVERYTHING = """\
uint8 LIMIT=7
bool flag
byte raw
char letter
int8 a
uint8 b
int16 c
uint16 d
int32 e
uint32 f
int64 g
uint64 h
float32 small
float64 real
string text
string<=5 short
byte[] raws
bool[2] flags
float32[] reals
int16[<=3] few
string[] texts
Inner inner
Inner[] several
Inner[2] both
float64 from
"""


def form(name: str, **more: Any) -> MessageForm:
    return Definitions(**more).form(MessageType.read(name))


def there_and_back(of: MessageForm, value: object) -> dict[str, Any]:
    return of.decode(bytes(of.encode(value, NOW_NS)))


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> MessageForm:
    """A message with a field of every kind."""
    folder = tmp_path_factory.mktemp("own") / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Everything.msg").write_text(EVERYTHING)
    (folder / "Inner.msg").write_text("geometry_msgs/Point point\nfloat64[] numbers\n")
    return form("own_msgs/Everything", files=[str(folder.parent)])


@pytest.mark.parametrize("name", HASHES)
def test_a_hash_is_that_of_ros(name: str) -> None:
    assert form(name).type_hash == HASHES[name]


def test_humble_has_no_hashes() -> None:
    assert form("std_msgs/String", distribution="humble").type_hash == NO_HASH


def test_bytes_on_the_wire_are_those_of_ros() -> None:
    assert bytes(form("std_msgs/String").encode({"data": "hi"}, NOW_NS)) == b"\0\1\0\0\3\0\0\0hi\0"


def test_what_a_value_lacks_is_empty(everything: MessageForm) -> None:
    value = there_and_back(everything, {})
    assert (value["flag"], value["g"], value["real"], value["text"], value["texts"]) == (False, 0, 0.0, "", [])
    assert value["flags"].tolist() == [False, False]
    assert [inner["point"] for inner in value["both"]] == [{"x": 0.0, "y": 0.0, "z": 0.0}] * 2


KINDS = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]
wholes = {kind: st.integers(int(numpy.iinfo(kind).min), int(numpy.iinfo(kind).max)) for kind in KINDS}
reals = st.floats(allow_nan=False, width=32)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))
inners = st.fixed_dictionaries(
    {
        "point": st.fixed_dictionaries({axis: st.floats(allow_nan=False) for axis in "xyz"}),
        "numbers": st.lists(st.floats(allow_nan=False)),
    }
)
values = st.fixed_dictionaries(
    {
        "flag": st.booleans(),
        "raw": wholes["uint8"],
        "letter": wholes["uint8"],
        **{name: wholes[kind] for name, kind in zip("abcdefgh", KINDS, strict=True)},
        "small": reals,
        "real": st.floats(allow_nan=False),
        "text": texts,
        "short": st.text("abc", max_size=5),
        "raws": st.lists(wholes["uint8"]),
        "flags": st.lists(st.booleans(), min_size=2, max_size=2),
        "reals": st.lists(reals),
        "few": st.lists(wholes["int16"], max_size=3),
        "texts": st.lists(texts),
        "inner": inners,
        "several": st.lists(inners, max_size=3),
        "both": st.lists(inners, min_size=2, max_size=2),
        "from": st.floats(allow_nan=False),
    }
)


def plain(value: Any) -> Any:
    """A value with lists for arrays."""
    match value:
        case dict():
            return {key: plain(inner) for key, inner in value.items()}
        case list():
            return [plain(inner) for inner in value]
        case numpy.ndarray():
            return value.tolist()
    return value


@settings(max_examples=40, deadline=None)
@given(values)
def test_every_value_comes_back(everything: MessageForm, value: dict[str, Any]) -> None:
    assert plain(there_and_back(everything, value)) == value


def test_messages_are_what_an_independent_reader_reads() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    given = {"header": {"frame_id": "map"}, "pose": {"pose": {"position": {"x": 1.5}}, "covariance": range(36)}}
    message: Any = store.deserialize_cdr(
        bytes(form("nav_msgs/Odometry").encode(given, NOW_NS)), "nav_msgs/msg/Odometry"
    )
    assert (message.header.frame_id, message.pose.pose.position.x) == ("map", 1.5)
    assert message.pose.covariance.tolist() == list(range(36))


def test_the_stamp_that_a_value_lacks_is_the_time_of_its_element() -> None:
    stamp = {"sec": 1_700_000_000, "nanosec": 123_456_789}
    image = form("sensor_msgs/Image")
    assert there_and_back(image, {"width": 1})["header"]["stamp"] == stamp
    assert there_and_back(image, {"header": {"frame_id": "eye"}})["header"] == {"stamp": stamp, "frame_id": "eye"}
    given = {"header": {"stamp": {"sec": 5}}}
    assert there_and_back(image, given)["header"]["stamp"] == {"sec": 5, "nanosec": 0}


def test_a_dataclass_and_any_object_are_read_by_their_attributes() -> None:
    @dataclass
    class Point:
        x: float
        y: float

    assert there_and_back(form("geometry_msgs/Point"), Point(1, 2)) == {"x": 1.0, "y": 2.0, "z": 0.0}
    pose = SimpleNamespace(position=Point(3, 4))
    assert there_and_back(form("geometry_msgs/Pose"), pose)["position"] == {"x": 3.0, "y": 4.0, "z": 0.0}


def test_the_value_of_a_type_with_one_field_may_be_that_fields() -> None:
    assert there_and_back(form("std_msgs/Float64"), 2.5) == {"data": 2.5}
    assert there_and_back(form("std_msgs/Empty"), {}) == {}
    assert (
        there_and_back(form("tf2_msgs/TFMessage"), [{"child_frame_id": "arm"}])["transforms"][0]["child_frame_id"]
        == "arm"
    )


def test_an_images_bytes_are_given_as_array_bytes_or_list() -> None:
    image = form("sensor_msgs/Image")
    pixels = numpy.arange(12, dtype=numpy.uint8).reshape(2, 2, 3)
    for data in (pixels, pixels.tobytes(), memoryview(pixels.tobytes()), pixels.tolist(), pixels[:, ::-1][:, ::-1]):
        assert there_and_back(image, {"data": data})["data"].tolist() == list(range(12))


def test_a_received_images_bytes_are_not_copied() -> None:
    image = form("sensor_msgs/Image")
    message = bytes(image.encode({"data": bytes(1000)}, NOW_NS))
    assert numpy.shares_memory(image.decode(message)["data"], numpy.frombuffer(message, numpy.uint8))


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ({"inner": {"point": {"x": "left"}}}, "inner.point.x: a number (float64) is needed, not 'left'"),
        ({"several": [{}, {"point": {"q": 1}}]}, "several[1].point.q: geometry_msgs/msg/Point has no such field"),
        ({"flagg": True}, "flagg: own_msgs/msg/Everything has no such field (did you mean `flag`?)"),
        ({"flag": 1}, "flag: true or false is needed, not 1"),
        ({"a": 128}, "a: 128 is not within -128 and 127 (int8)"),
        ({"b": True}, "b: a whole number (uint8) is needed, not True"),
        ({"e": 1.5}, "e: a whole number (int32) is needed, not 1.5"),
        ({"small": 1e300}, "small: 1e+300 is too large for float32"),
        ({"real": 10**400}, "real: a number (float64) is needed, not 1000"),
        ({"real": 1j}, "real: a number (float64) is needed, not 1j"),
        ({"text": b"bytes"}, "text: a text is needed, not b'bytes'"),
        ({"text": "\udc80"}, "text: this text can't be encoded as UTF-8"),
        ({"short": "longer"}, "short: a text of at most 5 bytes is needed, not of 6"),
        ({"flags": [True]}, "flags: 2 elements are needed, not 1"),
        ({"flags": [True, 2]}, "flags[1]: true or false is needed, not 2"),
        ({"few": [1, 2, 3, 4]}, "few: at most 3 elements may be there, not 4"),
        ({"few": [1, 70000]}, "few[1]: 70000 is not within -32768 and 32767 (int16)"),
        ({"few": [1, "two"]}, "few[1]: a whole number (int16) is needed, not 'two'"),
        ({"few": numpy.array([0.5])}, "few[0]: a whole number (int16) is needed, not 0.5"),
        ({"few": 3}, "few: an array of int16 is needed, not 3"),
        ({"few": "123"}, "few: an array of int16 is needed, not '123'"),
        ({"reals": [[1, 2], [3]]}, "reals: its rows are of different lengths"),
        ({"reals": [1.0, 1e300]}, "reals[1]: 1e+300 is too large for float32"),
        ({"texts": "one"}, "texts: a list is needed, not 'one'"),
        ({"texts": ["a", 2]}, "texts[1]: a text is needed, not 2"),
        ({"both": [{}]}, "both: 2 elements are needed, not 1"),
        ({"inner": 5}, "inner: own_msgs/msg/Inner needs a mapping from field to value, not 5"),
        ([1], "own_msgs/msg/Everything needs a mapping from field to value, not [1]"),
    ],
)
def test_what_does_not_fit_is_told_by_its_path(everything: MessageForm, value: object, told: str) -> None:
    with pytest.raises(MisfitError) as error:
        everything.encode(value, NOW_NS)
    assert str(error.value).startswith(told)


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\7\7\0\0hello"])
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(EncodingError, match="can't be read"):
        form("std_msgs/String").decode(data)


def test_definitions_are_found_relative_to_a_folder_and_win_over_those_of_the_distribution(tmp_path: Path) -> None:
    (tmp_path / "msgs" / "std_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "msgs" / "std_msgs" / "msg" / "String.msg").write_text("string data\nint32 more\n")
    own = form("std_msgs/String", files=["msgs"], folder=tmp_path)
    assert there_and_back(own, {"more": 3}) == {"data": "", "more": 3}
    assert own.type_hash != HASHES["std_msgs/msg/String"]


def test_definitions_of_an_installed_ros_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share = tmp_path / "share" / "my_msgs" / "msg"
    share.mkdir(parents=True)
    (share / "Scan.msg").write_text("std_msgs/Header header\nmy_msgs/Spot[] spots\n")
    (share / "Spot.msg").write_text("float32 bearing\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert there_and_back(form("my_msgs/msg/Scan"), {"spots": [{"bearing": 0.5}]})["spots"] == [{"bearing": 0.5}]


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, "my_msgs/msg/Scan is not known"),
        ({"Scan.msg": "Spot spot\n"}, "no definition of my_msgs/msg/Spot, which my_msgs/msg/Scan has, is known"),
        ({"Scan.msg": "float32 [\n"}, "this is not a message definition"),
        ({"Scan.msg": "wstring wide\n"}, "has texts of wide characters"),
    ],
)
def test_a_definition_that_is_missing_or_bad_is_named(tmp_path: Path, files: dict[str, str], told: str) -> None:
    folder = tmp_path / "my_msgs"
    folder.mkdir()
    for name, text in {"Other.msg": "", **files}.items():
        (folder / name).write_text(text)
    with pytest.raises(InputError, match=told):
        form("my_msgs/Scan", files=[str(folder)])


def test_a_folder_or_distribution_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        Definitions(files=["nowhere"], folder=tmp_path)
    with pytest.raises(InputError, match=r"no \.msg file"):
        Definitions(files=["."], folder=tmp_path)
    with pytest.raises(InputError, match="did you mean `jazzy`"):
        Definitions("jazy")
