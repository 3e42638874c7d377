"""Topics by the helper, in both directions with a node of rclpy's that knows nothing of cfgplan."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy
import pytest
from cfgplan_runtime.ros2.definitions import Definitions
from cfgplan_runtime.ros2.message_form import MessageForm
from cfgplan_runtime.ros2.topics import RosTopics, checked_name
from operated_world import eventually
from ros2_words import Observer

from cfgplan.errors import InputError
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType

Open = Callable[..., RosTopics]
USUAL, KEEPING = ServiceQuality(), ServiceQuality(transient_local=True)
NOW_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope="module")
def definitions() -> Definitions:
    return Definitions("jazzy")


@pytest.fixture
def text(definitions: Definitions) -> MessageForm:
    return definitions.form(MessageType("std_msgs", "String"))


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def opened(told: list[str]) -> Iterator[Open]:
    """Opens nodes that are closed after the test."""
    with ExitStack() as stack:

        def begin(node: str, **more: Any) -> RosTopics:
            topics = RosTopics(node, told.append, **more)
            stack.callback(topics.close)
            return topics

        yield begin


def test_what_is_published_arrives_in_order(opened: Open, observer: Observer, text: MessageForm) -> None:
    came = observer.listen("/ours")
    publisher = opened("/robot/talker").publisher("/ours", text, USUAL, 100)
    is_over = threading.Event()

    def talk() -> None:
        number = 0
        while not is_over.wait(0.01):  # the queue of 100 holds a second
            publisher.put(text.encode(str(number), NOW_NS))
            number += 1

    talking = threading.Thread(target=talk)
    talking.start()
    numbers = [int(next(came)) for _ in range(200)]
    is_over.set()
    talking.join()
    assert numbers == list(range(numbers[0], numbers[0] + 200))
    assert "/robot/talker" in observer.look()["nodes"]
    publisher.close()
    eventually(lambda: "/ours" not in observer.look()["topics"])


def test_what_others_publish_arrives_with_the_time_when_it_was_sent(
    opened: Open, observer: Observer, text: MessageForm
) -> None:
    got: list[tuple[str, int]] = []
    take = lambda data, at: got.append((text.decode(data)["data"], at))  # noqa: E731
    opened("listener").read("/theirs", text, USUAL, 10, take)
    observer.publish("/theirs", *map(str, range(1000)), every=0.005)
    eventually(lambda: len(got) >= 100)
    numbers = [int(one) for one, _ in got[:100]]
    assert numbers == list(range(numbers[0], numbers[0] + 100))
    times = [at for _, at in got]
    assert times == sorted(times)
    assert times[0] > NOW_NS


def test_an_image_arrives_whole(opened: Open, definitions: Definitions) -> None:
    form = definitions.form(MessageType("sensor_msgs", "Image"))
    pixels = numpy.random.default_rng(1).integers(0, 255, (1000, 1200, 3), numpy.uint8)
    given = {"height": 1000, "width": 1200, "encoding": "rgb8", "step": 3600, "data": pixels}
    got: list[dict[str, Any]] = []
    opened("viewer").read("/image", form, USUAL, 10, lambda data, _: got.append(form.decode(data)))
    publisher = opened("camera").publisher("/image", form, USUAL, 10)

    def has_arrived() -> bool:
        publisher.put(form.encode(given, NOW_NS))
        return bool(got)

    eventually(has_arrived)
    assert (got[0]["data"].reshape(1000, 1200, 3) == pixels).all()
    assert got[0]["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 123_456_789}


def test_who_comes_late_gets_the_last_messages_that_are_kept(
    opened: Open, observer: Observer, text: MessageForm
) -> None:
    publisher = opened("map_server").publisher("/map", text, KEEPING, 3)
    for number in range(5):
        publisher.put(text.encode(f"map {number}", NOW_NS))
    eventually(lambda: "/map" in observer.look()["topics"])
    ours: list[str] = []
    opened("planner").read("/map", text, KEEPING, 3, lambda data, _: ours.append(text.decode(data)["data"]))
    theirs = observer.listen("/map", latched=True)
    assert [next(theirs) for _ in range(3)] == ["map 2", "map 3", "map 4"]
    eventually(lambda: ours == ["map 2", "map 3", "map 4"])


def test_domains_are_apart(opened: Open, observer: Observer, text: MessageForm) -> None:
    far, near = (opened("talker", domain=domain) for domain in (119, None))
    far.publisher("/far", text, USUAL, 1)
    near.publisher("/near", text, USUAL, 1)
    eventually(lambda: "/near" in observer.look()["topics"])
    assert "/far" not in observer.look()["topics"]


def test_a_publisher_of_another_type_is_told(
    opened: Open, observer: Observer, text: MessageForm, told: list[str]
) -> None:
    opened("listener").read("/odd", text, USUAL, 1, lambda *_: None)
    observer.publish("/odd", "1.5", kind="std_msgs/msg/String", every=0)
    opened("other").publisher("/odd", Definitions("jazzy").form(MessageType("std_msgs", "Bool")), USUAL, 1)
    eventually(lambda: told)
    assert told == ["/odd: /other publishes std_msgs/msg/Bool, which does not come as std_msgs/msg/String"]


def test_a_type_that_the_python_of_ros_lacks_is_told(opened: Open, told: list[str], tmp_path: Any) -> None:
    (tmp_path / "own_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "own_msgs" / "msg" / "Picture.msg").write_text("uint8[] data\n")
    form = Definitions("jazzy", [str(tmp_path)]).form(MessageType("own_msgs", "Picture"))
    opened("camera").publisher("/picture", form, USUAL, 1)
    eventually(lambda: told)
    assert told[0].startswith(
        "/picture: own_msgs/msg/Picture can't be imported by the Python of ROS: source the workspace"
    )


def test_messages_that_nobody_takes_in_time_are_dropped_and_told(
    opened: Open, observer: Observer, text: MessageForm, told: list[str]
) -> None:
    may_go_on, got = threading.Event(), list[str]()

    def take(data: bytes, _: int) -> None:
        may_go_on.wait(60)
        got.append(text.decode(data)["data"])

    opened("listener").read("/many", text, USUAL, 10, take)
    observer.publish("/many", *(str(number) + " " * 50_000 for number in range(1000)), every=0.002)
    eventually(lambda: "/many" in observer.look()["heard"])
    threading.Timer(3.0, may_go_on.set).start()
    eventually(lambda: len(got) > 20)
    assert told == ["/many: messages come faster than they are taken; some are lost"]


@pytest.mark.parametrize("name", ["", "/", "a b", "/image-raw", "/1st", "a//b", "/a/", "a%b", "/ä"])
def test_a_name_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="can't be the name of a ROS 2 topic"):
        checked_name(name, "topic")
