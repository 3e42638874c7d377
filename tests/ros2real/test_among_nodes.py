"""A run among ROS 2 nodes: a topic of another program's feeds its units, and what they give is a topic for others."""

from __future__ import annotations

import sys
from pathlib import Path

import psutil
import pytest
from operated_world import await_event, eventually, running
from ros2_words import Observer, command_of

from cfgplan import extras
from cfgplan.cli import main

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
    params: {topic: /pictures, type: sensor_msgs/Image, reliability: best_effort}
    inputs: {image: Picture}
targets:
  - {label: told, run: replies}
  - {label: shown, run: pictures}
  - {label: place, topic: /place, tag: Place, type: geometry_msgs/Point}
  - {label: private, topic: /private, tag: Reply}
"""
IMAGE, PLACE = "sensor_msgs/msg/Image", "geometry_msgs/msg/Point"
UNITS = """\
import numpy

def clerk(order):
    match order["data"]:
        case "nonsense":
            return {"reply": {"date": 1}}
        case "nowhere":
            return {"place": {"x": "far away"}}
        case "picture":
            pixels = numpy.full((1000, 1000), 3, numpy.uint8)
            return {"image": {"header": {"frame_id": "seen"}, "width": 1000, "data": pixels}}
        case what:
            return {"reply": what.upper(), "place": {"x": 1.5, "y": numpy.float32(2)}}
"""


@pytest.fixture
def env(tmp_path: Path) -> Path:
    (tmp_path / "units.py").write_text(UNITS)
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


def test_a_topic_of_ros_feeds_a_run_and_what_it_gives_is_read_in_ros(env: Path, observer: Observer) -> None:
    """One run for all of it: starting one takes long."""
    replies, pictures = observer.listen("/replies"), observer.listen("/pictures", IMAGE, reliable=False)
    places = observer.listen("/place", PLACE)
    with running(env, "--ros2") as process:
        await_event(process, "Running")
        observer.publish("/orders", "tea", "picture")
        assert next(replies) == "TEA"
        assert next(places) == "1.5 2.0 0.0"
        assert next(pictures) == "seen"
        assert "/private" not in observer.look()["topics"]
        assert any(node.startswith("/cfgplan_") for node in observer.look()["nodes"])
        observer.publish("/orders", "nonsense")
        told = await_event(process, "UnitPrinted", unit="replies.1")
        assert told["line"].startswith("/replies: date: std_msgs/msg/String has no such field (did you mean `data`?)")
        observer.publish("/orders", "nowhere")
        told = await_event(process, "Warning")
        assert told["text"].startswith("/place: a value is not published in ROS 2: x: a number (float64) is needed")

        # Targets of the file hold as soon as it is edited.
        aloud = observer.listen("/aloud")
        edited = ENVIRONMENT.replace(", type: geometry_msgs/Point", "")
        env.write_text(edited + "  - {label: aloud, topic: /aloud, tag: Reply, type: std_msgs/String}\n")
        assert next(aloud) == "TEA"
        eventually(lambda: "/place" not in observer.look()["topics"])
        env.write_text(edited + "  - {label: aloud, topic: /aloud, tag: Reply, type: std_msgs/Sting}\n")
        warnings = iter(lambda: await_event(process, "Warning")["text"], None)
        next(one for one in warnings if one.startswith("/aloud is not published in ROS 2: std_msgs/msg/Sting is not"))
        process.terminate()
        process.communicate()
    eventually(lambda: "/replies" not in observer.look()["topics"])


def test_a_helper_that_dies_is_begun_anew_and_topics_go_on(env: Path, observer: Observer) -> None:
    replies, places = observer.listen("/replies"), observer.listen("/place", PLACE)
    with running(env, "--ros2") as process:
        await_event(process, "Running")
        observer.publish("/orders", "tea")
        assert (next(replies), next(places)) == ("TEA", "1.5 2.0 0.0")
        children = psutil.Process(process.pid).children(recursive=True)
        helpers = [one for one in children if any(word.endswith("host/main.py") for word in command_of(one))]
        assert len(helpers) == 4, "one for each unit, and one for the targets"
        for helper in helpers:
            helper.kill()
        warnings = iter(lambda: await_event(process, "Warning")["text"], None)
        assert any("the ROS 2 helper has ended (-9) and is started again" in warning for warning in warnings)
        eventually(lambda: observer.gives("/replies"))
        eventually(lambda: observer.gives("/place"))
        process.terminate()
        process.communicate()


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
        ("reliability: best_effort", "definitions: nowhere", "no such file or folder of message definitions"),
        ("topic: /orders", "domain: 999, topic: /orders", "orders: `999` is not a domain of ROS 2"),
        ("reliability: best_effort", "depth: 0", "pictures: `0` can't be the depth of a topic"),
        ("inputs: {reply: Reply}", "inputs: {a: Reply, b: Reply}", "replies: a Publisher has one input and no output"),
        ("topic: /place", "topic: /a place", "target place: `/a place` can't be the name of a ROS 2 topic"),
        ("geometry_msgs/Point", "far_msgs/Place", "put its definition into far_msgs/msg/Place.msg here"),
        ("geometry_msgs/Point", "Place", "target place: `Place` is not a message type"),
        (", type: geometry_msgs/Point", "", "no target has a message `type` for ROS 2"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(
    env: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace(old, new))
    assert main(["run", str(env), "--ros2"]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert told in said


def test_without_the_extra_its_name_is_told_before_the_file_is_read(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    find = extras.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "rosbags" else find(name))
    assert main(["run", "nowhere.yaml", "--ros2"]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "ROS 2 topics need the package rosbags, which is not installed" in said
    assert "pip install 'cfgplan[ros2]'" in said


def test_what_nodes_of_ros_1_publish_is_not_for_ros_2(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(env), "--ros2", "--middleware", "ros1"]) == 30
    assert "--ros2 is for units that are processes, not for nodes of ROS 1" in " ".join(capsys.readouterr().err.split())


def test_a_python_without_rclpy_is_told_with_the_ways_to_one(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(env), "--ros2", "--ros-python", sys.executable]) == 30
    assert "--ros-python" in capsys.readouterr().err


def test_what_a_fleet_gives_is_published_too(env: Path, observer: Observer) -> None:
    (env.parent / "counting.py").write_text("def count():\n    yield from range(10**9)\n")
    env.write_text(
        "format: cfgplan/1\n"
        "hosts: [{name: here}, {name: there}]\n"
        "transformations:\n"
        "  - {label: counter, host: there, source: 'counting.py:count', run: {rate: 10}, outputs: {number: Number}}\n"
        "targets:\n"
        "  - {label: number, topic: /number, tag: Number, type: std_msgs/UInt64}\n"
    )
    numbers = observer.listen("/number", "std_msgs/msg/UInt64")
    with running(env, "--local", "--ros2") as process:
        await_event(process, "Running")
        got = [int(next(numbers)) for _ in range(20)]
        process.terminate()
        process.communicate()
    assert got == list(range(got[0], got[0] + 20))
