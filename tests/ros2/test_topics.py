"""Topics over a router, in both directions with an SDK for ROS 2 over Zenoh that is not ours."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy
import pytest
import xxhash
from cfgplan_runtime.ros2 import ros_session
from cfgplan_runtime.ros2.definitions import Definitions
from cfgplan_runtime.ros2.message_form import MessageForm
from cfgplan_runtime.ros2.ros_session import RosSession, checked_name
from operated_world import eventually
from sdk_graph import at_last, ends
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, get_topic_names_and_types
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

from cfgplan.errors import InputError
from cfgplan.ros import EndpointToken, MessageType, Qos, read_token

Open = Callable[[str], RosSession]
TEXT = "string data\n"
KEEPING = Qos(durability="transient_local", depth=3)
NOW_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope="module")
def definitions() -> Definitions:
    return Definitions()


@pytest.fixture
def text(definitions: Definitions) -> MessageForm:
    return definitions.form(MessageType("std_msgs", "String"))


@pytest.fixture
def opened(endpoint: str) -> Iterator[Open]:
    """Opens sessions that are closed after the test."""
    with ExitStack() as stack:

        def begin(node: str) -> RosSession:
            session = RosSession(node, connect=[endpoint])
            stack.callback(session.close)
            return session

        yield begin


@pytest.fixture
def sdk(router_port: int) -> Iterator[Callable[..., Any]]:
    """Makes publishers and subscribers of the SDK's for std_msgs/String, which are closed after the test."""
    with ExitStack() as stack:

        def make(kind: Any, topic: str, **more: Any) -> Any:
            made = kind(
                topic,
                "std_msgs/msg/String",
                **{"msg_definition": TEXT, "router_port": router_port, "domain_id": 0, **more},
            )
            stack.callback(made.close)
            return made

        yield make


def test_what_is_published_arrives_at_the_sdk_in_order(opened: Open, sdk: Any, text: MessageForm) -> None:
    got: list[str] = []
    sdk(ROS2Subscriber, "/ours", callback=lambda message: got.append(message.data))
    put = opened("talker").publisher("/ours", text, Qos()).put

    def both_know() -> bool:
        put(text.encode("first", NOW_NS), NOW_NS)
        return bool(got)

    eventually(both_know)
    for number in range(10):
        put(text.encode({"data": f"number {number}"}, NOW_NS), NOW_NS)
        eventually(lambda last=number: got[-1] == f"number {last}")  # a burst may be dropped, as with rmw_zenoh
    assert [one for one in got if one != "first"] == [f"number {number}" for number in range(10)]


def test_what_the_sdk_publishes_arrives_in_order(opened: Open, sdk: Any, text: MessageForm) -> None:
    got: list[tuple[str, int]] = []
    publisher = sdk(ROS2Publisher, "/theirs")
    opened("listener").subscribe("/theirs", text, Qos(), lambda data, at: got.append((text.decode(data)["data"], at)))

    def both_know() -> bool:
        publisher.publish(data="first")
        return bool(got)

    eventually(both_know)
    for number in range(10):
        publisher.publish(data=f"number {number}")
        eventually(lambda last=number: got[-1][0] == f"number {last}")
    assert [one for one, _ in got if one != "first"] == [f"number {number}" for number in range(10)]
    times = [at for _, at in got]
    assert times == sorted(times)
    assert times[0] > NOW_NS


def test_an_image_arrives_whole(opened: Open, definitions: Definitions) -> None:
    own = definitions.form(MessageType("sensor_msgs", "Image"))
    pixels = numpy.random.default_rng(1).integers(0, 255, (480, 640, 3), numpy.uint8)
    given = {"height": 480, "width": 640, "encoding": "rgb8", "step": 1920, "data": pixels}
    got: list[dict[str, Any]] = []
    opened("viewer").subscribe("/image", own, Qos(), lambda data, _: got.append(own.decode(data)))
    put = opened("camera").publisher("/image", own, Qos("best_effort")).put

    def arrived() -> bool:
        put(own.encode(given, NOW_NS), NOW_NS)
        return bool(got)

    eventually(arrived)
    assert (got[0]["data"].reshape(480, 640, 3) == pixels).all()
    assert got[0]["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 123_456_789}


def test_the_sdk_lists_our_topics_with_type_hash_and_quality(opened: Open, router_port: int, text: MessageForm) -> None:
    session = opened("/robot/talker")
    session.publisher("/listed", text, KEEPING)
    session.subscribe("/wanted", text, Qos("best_effort"), lambda *_: None)

    topics = at_last(
        lambda: dict(get_topic_names_and_types(0, router_port=router_port)),
        lambda found: {"/listed", "/wanted"} <= {*found},
    )
    assert topics["/listed"] == topics["/wanted"] == ["std_msgs/msg/String"]
    (publisher,) = at_last(lambda: ends("/listed", router_port).publishers)
    assert (publisher.node_name, publisher.node_namespace) == ("talker", "/robot")
    assert (publisher.type_hash, Qos.read(publisher.qos)) == (text.type_hash, KEEPING)
    (subscriber,) = at_last(lambda: ends("/wanted", router_port).subscribers)
    assert Qos.read(subscriber.qos).reliability == "best_effort"


def test_who_comes_late_gets_the_last_messages_that_are_kept(opened: Open, sdk: Any, text: MessageForm) -> None:
    put = opened("map_server").publisher("/map", text, KEEPING).put
    for number in range(5):
        put(text.encode(f"map {number}", NOW_NS), NOW_NS)
    ours: list[str] = []
    opened("planner").subscribe("/map", text, KEEPING, lambda data, _: ours.append(text.decode(data)["data"]))
    eventually(lambda: len(ours) == 3)
    assert ours == ["map 2", "map 3", "map 4"]
    theirs: list[str] = []

    def late() -> bool:
        qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=3)
        sdk(ROS2Subscriber, "/map", callback=lambda message: theirs.append(message.data), qos=qos)
        return bool(theirs)

    eventually(late)
    assert theirs[0] == "map 4"  # of those that are kept the SDK asks for the last


def test_a_volatile_subscriber_gets_nothing_old(opened: Open, text: MessageForm) -> None:
    put = opened("map_server").publisher("/old", text, KEEPING).put
    put(text.encode("old", NOW_NS), NOW_NS)
    got: list[str] = []
    opened("planner").subscribe("/old", text, Qos(), lambda data, _: got.append(text.decode(data)["data"]))

    def arrived() -> bool:
        put(text.encode("new", NOW_NS), NOW_NS)
        return bool(got)

    eventually(arrived)
    assert set(got) == {"new"}


def test_an_attachment_has_number_time_and_the_hash_of_the_publishers_token(opened: Open, text: MessageForm) -> None:
    session = opened("talker")
    heads: list[bytes] = []
    tokens: list[EndpointToken] = []
    other = opened("watcher")
    other.watch_publishers("/numbered", tokens.append)
    put = session.publisher("/numbered", text, Qos()).put
    eventually(lambda: tokens)
    raw = other._session.declare_subscriber(tokens[0].key, lambda sample: heads.append(sample.attachment.to_bytes()))

    def arrived() -> bool:
        put(text.encode("x", NOW_NS), NOW_NS)
        return len(heads) > 1

    eventually(arrived)
    raw.undeclare()
    first, second = (struct.unpack("<qqB16s", head) for head in heads[:2])
    assert second[0] == first[0] + 1
    assert first[1:3] == (NOW_NS, 16)
    digest = xxhash.xxh3_128_intdigest(str(tokens[0]).encode())
    assert first[3] == digest.to_bytes(16, "little")


def test_publishers_of_every_type_are_told(opened: Open, sdk: Any) -> None:
    told: list[EndpointToken] = []
    opened("watcher").watch_publishers("/odd", told.append)
    sdk(ROS2Publisher, "/odd", type_hash="RIHS01_" + "0" * 64)
    eventually(lambda: told)
    assert told[0].type_hash == "RIHS01_" + "0" * 64
    assert read_token(str(told[0])) == told[0]


def test_domains_are_apart(endpoint: str, router_port: int, text: MessageForm, monkeypatch: Any) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    session = RosSession("talker", connect=[endpoint])
    session.publisher("/seventh", text, Qos())
    eventually(lambda: "/seventh" in dict(get_topic_names_and_types(7, router_port=router_port)))
    assert "/seventh" not in dict(get_topic_names_and_types(0, router_port=router_port))
    session.close()


def test_a_router_is_found_by_the_variables_of_rmw_zenoh(
    router_port: int, text: MessageForm, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "session.json5"
    file.write_text(
        '{mode: "peer", connect: {endpoints: ["tcp/127.0.0.1:1"]}, scouting: {multicast: {enabled: false}}}'
    )
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", str(file))
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'mode="client";connect/endpoints=["tcp/127.0.0.1:{router_port}"]')
    session = RosSession("talker")
    session.publisher("/by_variables", text, Qos())
    eventually(lambda: "/by_variables" in dict(get_topic_names_and_types(0, router_port=router_port)))
    session.close()


def test_it_is_told_if_no_router_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_session, "_CONNECT_S", 0.1)
    told: list[str] = []
    session = RosSession("alone", connect=["tcp/127.0.0.1:1"])
    session.tell_if_alone(told.append)
    session.close()
    assert told == [
        'no Zenoh router is reached at ["tcp/127.0.0.1:1"] yet; one is started by `ros2 run rmw_zenoh_cpp rmw_zenohd`'
    ]


@pytest.mark.parametrize(
    ("variable", "value", "told"),
    [
        ("ZENOH_CONFIG_OVERRIDE", "no/such/key=1", "Zenoh can't be configured"),
        ("ZENOH_CONFIG_OVERRIDE", 'mode="throne"', "Zenoh can't be configured"),
        ("ZENOH_SESSION_CONFIG_URI", "/nowhere.json5", "Zenoh can't be configured"),
        ("ROS_DOMAIN_ID", "seven", "`seven` is no domain of ROS 2"),
        ("ROS_DOMAIN_ID", "999", "`999` is no domain of ROS 2"),
    ],
)
def test_a_bad_variable_is_told(variable: str, value: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(InputError, match=told):
        RosSession("talker", connect=["tcp/127.0.0.1:1"]).close()


@pytest.mark.parametrize("name", ["", "/", "a b", "/image-raw", "/1st", "a//b", "/a/", "a%b", "/ä"])
def test_a_name_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="can't be the name of a ROS 2 topic"):
        checked_name(name, "topic")
