"""A run among ROS 2 nodes: a topic of another program's feeds its units, and what they give is a topic for others."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from operated_world import await_event, eventually, running
from sdk_graph import at_last, ends
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, get_topic_names_and_types

from cfgplan import extras
from cfgplan.cli import main
from cfgplan.ros import Qos

ENVIRONMENT = """\
format: cfgplan/1
transformations:
  - label: orders
    source: cfgplan_runtime.ros2:Subscriber
    params: {topic: /orders, type: std_msgs/msg/String}
    outputs: {text: Order}
  - label: clerk
    source: units.py:clerk
    inputs: {order: Order}
    outputs:
      reply: Reply
      place: Place
      image: Picture
  - label: replies
    source: cfgplan_runtime.ros2:Publisher
    params: {topic: /replies, type: std_msgs/String}
    inputs: {reply: Reply}
  - label: pictures
    source: cfgplan_runtime.ros2:Publisher
    params: {topic: /pictures, type: own_msgs/Picture, definitions: msgs, reliability: best_effort}
    inputs: {image: Picture}
targets:
  - {label: told, run: replies}
  - {label: shown, run: pictures}
  - {label: place, topic: /place, tag: Place, type: near_msgs/Place}
  - {label: private, topic: /private, tag: Reply}
"""
TEXT, PICTURE, PLACE = "string data\n", "uint32 width\nuint8[] data\n", "string of\nfloat64 x\nfloat64[2] size\n"
UNITS = """\
import numpy

def clerk(order):
    match order["data"]:
        case "nonsense":
            return {"reply": {"date": 1}}
        case "nowhere":
            return {"place": {"x": "far away"}}
        case "picture":
            return {"image": {"width": 1000, "data": numpy.full((1000, 1000), 3, numpy.uint8)}}
        case what:
            return {"reply": what.upper(), "place": {"of": what, "x": 1.5, "size": numpy.array([2, 3])}}
"""
AGAIN_S = 0.05


@pytest.fixture
def env(tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "units.py").write_text(UNITS)
    for folder, name, text in [("msgs/own_msgs/msg", "Picture", PICTURE), ("near_msgs/msg", "Place", PLACE)]:
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / f"{name}.msg").write_text(text)
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT)
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["{endpoint}"]')
    return path


@pytest.fixture
def heard(router_port: int) -> Iterator[Callable[[str, str, str], list[Any]]]:
    """Subscribes to a topic by the SDK; gives the list that its messages come into."""
    with ExitStack() as stack:

        def listen(topic: str, kind: str, definition: str) -> list[Any]:
            messages: list[Any] = []
            more = {"msg_definition": definition, "router_port": router_port}
            stack.callback(ROS2Subscriber(topic, kind, callback=messages.append, **more).close)
            return messages

        yield listen


@pytest.fixture
def ordered(router_port: int) -> Iterator[Callable[[str], Any]]:
    """While it is entered, publishes an order by the SDK again and again.

    Once would not do: as rmw_zenoh does, Zenoh drops a message for which there is no room, however reliable its topic.
    """
    publisher = ROS2Publisher("/orders", "std_msgs/msg/String", msg_definition=TEXT, router_port=router_port)

    @contextmanager
    def order(what: str) -> Iterator[None]:
        is_over = threading.Event()

        def send() -> None:
            while not is_over.wait(AGAIN_S):
                publisher.publish(data=what)

        sending = threading.Thread(target=send)
        sending.start()
        try:
            yield
        finally:
            is_over.set()
            sending.join()

    yield order
    publisher.close()


def test_a_topic_of_ros_feeds_a_run_and_what_it_gives_is_read_in_ros(
    env: Path, router_port: int, heard: Callable[..., list[Any]], ordered: Callable[[str], Any]
) -> None:
    """One run for all of it: starting one takes long."""
    replies = heard("/replies", "std_msgs/msg/String", TEXT)
    pictures = heard("/pictures", "own_msgs/msg/Picture", PICTURE)
    places = heard("/place", "near_msgs/msg/Place", PLACE)

    def topics() -> set[str]:
        return {name for name, _ in get_topic_names_and_types(router_port=router_port)}

    def publishers(topic: str) -> list[Any]:
        found: list[Any] = ends(topic, router_port).publishers
        return found

    with running(env, "--ros2") as process:
        await_event(process, "Running")
        with ordered("tea"):
            eventually(lambda: replies and places)
        with ordered("picture"):
            eventually(lambda: pictures)
        assert "/private" not in at_last(topics, {"/orders", "/replies", "/pictures", "/place"}.issubset)
        assert [place.of for place in places] == ["tea"] * len(places)
        assert (places[0].x, list(places[0].size)) == (1.5, [2.0, 3.0])
        assert (pictures[0].width, pictures[0].data.shape, pictures[0].data[0]) == (1000, (1_000_000,), 3)

        (publisher,) = at_last(lambda: publishers("/replies"))
        assert publisher.type_hash == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
        (publisher,) = at_last(lambda: publishers("/place"))
        assert publisher.node_name.startswith("cfgplan_")
        assert Qos.read(publisher.qos) == Qos("reliable", "volatile", depth=10)

        with ordered("nonsense"):
            told = await_event(process, "UnitPrinted", unit="replies.1")
        assert told["line"].startswith("/replies: date: std_msgs/msg/String has no such field (did you mean `data`?)")
        with ordered("nowhere"):
            told = await_event(process, "Warning")
        assert told["text"].startswith("/place: a value is not published in ROS 2: x: a number (float64) is needed")

        # What the file says of targets holds as soon as it is edited.
        aloud = heard("/aloud", "std_msgs/msg/String", TEXT)
        edited = ENVIRONMENT.replace(", type: near_msgs/Place", "")
        env.write_text(edited + "  - {label: aloud, topic: /aloud, tag: Reply, type: std_msgs/String}\n")
        with ordered("milk"):
            eventually(lambda: any(message.data == "MILK" for message in aloud))
        eventually(lambda: not publishers("/place"))
        env.write_text(edited + "  - {label: aloud, topic: /aloud, tag: Reply, type: std_msgs/Sting}\n")
        told = await_event(process, "Warning")
        assert told["text"].startswith("/aloud is not published in ROS 2: std_msgs/msg/Sting is not known")
        process.terminate()
        process.communicate()
    eventually(lambda: not publishers("/replies"))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("std_msgs/msg/String", "std_msgs/msg/Sting", "orders: std_msgs/msg/Sting is not known"),
        ("topic: /orders", "topic: /or-ders", "orders: `/or-ders` can't be the name of a ROS 2 topic"),
        ("topic: /orders", "topik: /orders", "orders: params of a ROS 2 topic: Object contains unknown field `topik`"),
        (
            "reliability: best_effort",
            "reliability: good",
            "pictures: params of a ROS 2 topic: Invalid enum value 'good'",
        ),
        ("definitions: msgs", "definitions: nowhere", "no such file or folder of message definitions"),
        ("reliability: best_effort", "depth: 0", "pictures: `0` is no depth of a topic"),
        ("inputs: {reply: Reply}", "inputs: {a: Reply, b: Reply}", "replies: a Publisher has one input and no output"),
        ("topic: /place", "topic: /a place", "target place: `/a place` can't be the name of a ROS 2 topic"),
        ("near_msgs/Place", "far_msgs/Place", "put its definition into far_msgs/msg/Place.msg here"),
        ("near_msgs/Place", "Place", "target place: `Place` is no message type"),
        (", type: near_msgs/Place", "", "no target says as what message `type` it is to be published in ROS 2"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(
    env: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace(old, new))
    assert main(["run", str(env), "--ros2"]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert told in said


@pytest.mark.parametrize("missing", ["rosbags", "xxhash"])
def test_without_the_extra_its_name_is_told_before_the_file_is_read(
    missing: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    find = extras.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == missing else find(name))
    assert main(["run", "nowhere.yaml", "--ros2"]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert f"ROS 2 topics need the package {missing}, which is not installed" in said
    assert "pip install 'cfgplan[ros2]'" in said


def test_what_nodes_of_ros_1_publish_is_not_for_ros_2(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(env), "--ros2", "--middleware", "ros1"]) == 30
    assert "--ros2 does not know what nodes of ROS 1 publish" in " ".join(capsys.readouterr().err.split())


def test_what_a_fleet_gives_is_published_too(env: Path, heard: Callable[..., list[Any]]) -> None:
    (env.parent / "counting.py").write_text("def count():\n    yield from range(10**9)\n")
    env.write_text(
        "format: cfgplan/1\n"
        "hosts: [{name: here}, {name: there}]\n"
        "transformations:\n"
        "  - {label: counter, host: there, source: 'counting.py:count', run: {rate: 50}, outputs: {number: Number}}\n"
        "targets:\n"
        "  - {label: number, topic: /number, tag: Number, type: std_msgs/UInt64}\n"
    )
    numbers = heard("/number", "std_msgs/msg/UInt64", "uint64 data\n")
    with running(env, "--local", "--ros2") as process:
        await_event(process, "Running")
        eventually(lambda: len(numbers) >= 20)
        process.terminate()
        process.communicate()
    got = [message.data for message in numbers]
    assert got == sorted(set(got))
