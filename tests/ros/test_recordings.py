"""Recordings are imported: bags of ROS 1 and 2, and single files; written by the library that reads them."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from ros_graphs import graph, node
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from cfgplan import api
from cfgplan.cli import main
from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosGraph, merged
from cfgplan.ros.origins import ros1_graph, ros2_graph
from cfgplan.ros.recordings import recorded_graph

SECOND_NS = 10**9
SCAN = "sensor_msgs/msg/LaserScan"


def bag1(path: Path, topics: dict[str, str | None], messages: int = 21) -> Path:
    """A bag of ROS 1 with strings on topics, each by the node that is named; over two seconds."""
    store = get_typestore(Stores.ROS1_NOETIC)
    text = store.types["std_msgs/msg/String"](data="hi")
    with rosbag1.Writer(path) as writer:
        for topic, caller in topics.items():
            kind = "std_msgs/msg/String"
            connection = writer.add_connection(topic, kind, typestore=store, callerid=caller)
            for number in range(messages):
                at = SECOND_NS + number * 2 * SECOND_NS // (messages - 1)
                writer.write(connection, at, store.serialize_ros1(text, kind))
    return path


def bag2(path: Path, topics: dict[str, int], storage: rosbag2.StoragePlugin) -> Path:
    """A bag of ROS 2 with so many scans on topics, over two seconds."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        for topic, number in topics.items():
            connection = writer.add_connection(topic, SCAN, typestore=store)
            for at in range(number):
                writer.write(connection, SECOND_NS + at * 2 * SECOND_NS // max(1, number - 1), bytes(200))
    return path


def told(whole: RosGraph) -> dict[str, list[tuple[str, str, float | None]]]:
    return {each.name: [(port.name, str(port.type), port.rate_hz) for port in each.ports] for each in whole.nodes}


def test_a_bag_of_ros_1_tells_who_published_what_and_how_often(tmp_path: Path) -> None:
    whole = ros1_graph([str(bag1(tmp_path / "drive.bag", {"/words": "/talker", "/said": None}))])
    assert told(whole) == {
        "/talker": [("/words", "std_msgs/msg/String", 10.5)],
        "/play_drive": [("/said", "std_msgs/msg/String", 10.5)],
    }
    (player,) = [each for each in whole.nodes if each.player]
    assert (player.package, player.executable, player.arguments) == ("rosbag", "play", (f"{tmp_path}/drive.bag",))
    assert whole.notes == (f"the subscribers to topics of {tmp_path}/drive.bag: a recording has only publications",)


@pytest.mark.parametrize("storage", [*rosbag2.StoragePlugin])
def test_a_bag_of_ros_2_is_a_player_of_its_topics(tmp_path: Path, storage: rosbag2.StoragePlugin) -> None:
    bag = bag2(tmp_path / "run-1", {"/scan": 81, "/once": 1}, storage)
    expected = {"/play_run_1": [("/once", SCAN, None), ("/scan", SCAN, 40.5)]}
    assert told(ros2_graph([str(bag)], RosGraph)) == expected
    (file,) = [path for path in bag.iterdir() if path.suffix != ".yaml"]
    alone = file.rename(tmp_path / f"run_1{file.suffix}")
    assert told(ros2_graph([str(alone)], RosGraph)) == expected


def test_what_others_publish_a_recording_only_tells_the_rate_of(tmp_path: Path) -> None:
    recorded = recorded_graph(bag2(tmp_path / "run", {"/scan": 81, "/odom": 5}, rosbag2.StoragePlugin.MCAP))
    live = graph(node("/lidar", {"/scan": None}), node("/mapper", {}, {"/scan": SCAN}))
    for order in ([recorded, live], [live, recorded]):
        assert told(merged(order)) == {
            "/lidar": [("/scan", SCAN, 40.5)],
            "/mapper": [("/scan", SCAN, None)],
            "/play_run": [("/odom", SCAN, 2.5)],
        }
    live = graph(node("/lidar", {"/scan": None, "/odom": "nav_msgs/Odometry"}), node("/rear", {"/scan": SCAN}))
    assert told(merged([live, recorded])) == {
        "/lidar": [("/odom", "nav_msgs/msg/Odometry", None), ("/scan", SCAN, 20.25)],
        "/rear": [("/scan", SCAN, 20.25)],
    }


def test_beside_a_live_graph_a_recording_is_not_played(tmp_path: Path) -> None:
    recorded = recorded_graph(bag2(tmp_path / "run", {"/scan": 81, "/odom": 5}, rosbag2.StoragePlugin.MCAP))
    live = graph(replace(node("/lidar", {"/scan": SCAN}), runs=True))
    assert told(merged([live, recorded])) == {"/lidar": [("/scan", SCAN, 40.5)]}


def test_a_node_that_two_sources_know_has_each_port_once(tmp_path: Path) -> None:
    live = graph(node("/talker", {"/words": "std_msgs/String"}, {"/orders": None}))
    both = merged([live, recorded_graph(bag1(tmp_path / "a.bag", {"/words": "/talker"}))])
    assert told(both) == {"/talker": [("/words", "std_msgs/msg/String", 10.5), ("/orders", "None", None)]}
    (port,) = [port for port in both.nodes[0].ports if port.role is Role.PUBLISHES]
    assert port.definition == "992ce8a1687cec8c8bd883ec73ca41d1"  # std_msgs/String, as ROS 1 says


def test_the_command_makes_a_valid_environment_of_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.yaml"
    assert main(["import", "ros1", str(bag1(tmp_path / "a.bag", {"/words": "/talker"})), "--out", str(file)]) == 0
    assert "the subscribers to topics" in capsys.readouterr().err
    (output,) = api.load(file).environment.transformation["talker"].outputs
    assert (output.rate_uhz, output.type) == (10_500_000, "std_msgs/msg/String")
    assert main(["check", str(file)]) == 0


@pytest.mark.parametrize("name", ["cut.bag", "cut.mcap", "cut.db3", "bag2/metadata.yaml", "empty.bag"])
def test_what_is_no_recording_is_told_with_its_file_and_a_mend(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"" if name == "empty.bag" else b"#ROSBAG V2.0\nnonsense: [")
    path = path.parent if name.startswith("bag2") else path
    with pytest.raises(InputError) as raised:
        ros2_graph([str(path)], RosGraph)
    (fault,) = raised.value.faults
    assert fault.file == str(path)
    assert fault.mend


def test_a_bag_without_an_index_is_told(tmp_path: Path) -> None:
    bag = bag1(tmp_path / "a.bag", {"/words": "/talker"})
    bag.write_bytes(bag.read_bytes()[: 13 + 4096 + 40])
    with pytest.raises(InputError, match="recording"):
        ros1_graph([str(bag)])


@pytest.mark.skipif(shutil.which("rosbag", path="/usr/bin") is None, reason="ROS 1 (rosbag) is not installed")
def test_bags_that_these_tests_write_are_bags_to_ros_itself(tmp_path: Path) -> None:
    bag = bag1(tmp_path / "a.bag", {"/words": "/talker"})
    told = subprocess.run(["/usr/bin/rosbag", "info", bag], env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert "/words" in told.stdout
    assert "21 msgs" in told.stdout


@pytest.mark.parametrize("version", ["ros1", "ros2"])
def test_what_is_no_source_is_told_with_those_there_are(
    version: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", version, "/nowhere", "--out", str(tmp_path / "x.yaml")]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "/nowhere: there is no such file" in said
    assert "name `live`, " in said
