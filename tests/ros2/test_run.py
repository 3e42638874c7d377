"""A run among ROS 2 nodes: a topic of another program's feeds its units, and what they give is a topic for others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import subscribe
from operated_world import await_event, eventually, running
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, get_topic_names_and_types

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
  - {label: reply, topic: /reply, tag: Reply}
"""
PICTURE = "uint32 width\nuint8[] data\n"
UNITS = """\
import numpy

def clerk(order):
    if order["data"] == "nonsense":
        return {"reply": {"date": 1}}
    pixels = numpy.full((1000, 1000), len(order["data"]), numpy.uint8)
    return {"reply": order["data"].upper(), "image": {"width": 1000, "data": pixels}}
"""


@pytest.fixture
def env(tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "units.py").write_text(UNITS)
    (tmp_path / "msgs" / "own_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "msgs" / "own_msgs" / "msg" / "Picture.msg").write_text(PICTURE)
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT)
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["{endpoint}"]')
    return path


def test_a_topic_of_ros_feeds_a_run_and_what_it_gives_is_read_in_ros(env: Path, router_port: int) -> None:
    """One run for all of it: starting one takes long."""
    replies: list[str] = []
    listener = ROS2Subscriber(
        "/replies",
        "std_msgs/msg/String",
        callback=lambda message: replies.append(message.data),
        msg_definition="string data\n",
        router_port=router_port,
    )
    pictures: list[Any] = []
    viewer = ROS2Subscriber(
        "/pictures",
        "own_msgs/msg/Picture",
        callback=pictures.append,
        msg_definition=PICTURE,
        router_port=router_port,
    )
    publisher = ROS2Publisher("/orders", "std_msgs/msg/String", msg_definition="string data\n", router_port=router_port)
    with running(env) as process:
        await_event(process, "Running")

        def arrived() -> bool:
            publisher.publish(data="tea")
            return bool(replies and pictures)

        eventually(arrived)
        assert {"/orders", "/replies", "/pictures"} <= dict(get_topic_names_and_types(router_port=router_port)).keys()
        with subscribe("/reply", wait_s=60) as reply:
            publisher.publish(data="cake")
            eventually(lambda: "CAKE" in replies)
            assert next(value.value for value in reply if value.value != "TEA") == "CAKE"
        publisher.publish(data="nonsense")
        publisher.publish(data="nonsense")
        publisher.publish(data="milk")
        told = await_event(process, "UnitPrinted", unit="replies.1")
        assert told["line"].startswith("/replies: date: std_msgs/msg/String has no such field (did you mean `data`?)")
        eventually(lambda: "MILK" in replies)
        process.terminate()
        process.communicate()
    assert pictures[0].data.shape == (1_000_000,)
    assert pictures[0].data[0] == 3
    assert pictures[0].width == 1000
    for one in (listener, viewer, publisher):
        one.close()


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
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(
    env: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace(old, new))
    assert main(["run", str(env)]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert told in said
