"""A running graph of ROS 2 is imported with ports, qualities of service, parameters, and how its nodes are started."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from cfgplan_runtime.ros2.live_graph import Graph, NodeProcess, graph_of, node_process
from operated_world import eventually

from cfgplan import api
from cfgplan.cli import main

LIDAR = """\
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

rclpy.init()
node = Node("scanner")
node.declare_parameter("rate", 15.0)
publisher = node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
node.create_timer(0.1, lambda: publisher.publish(LaserScan()))
rclpy.spin(node)
"""
GUARD = """\
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool

rclpy.init()
node = Node("watcher")
publisher = node.create_publisher(String, "~/alarm", 10)
node.create_subscription(LaserScan, "scan", lambda _: publisher.publish(String()), 10)
node.create_service(SetBool, "arm", lambda _, answer: answer)
rclpy.spin(node)
"""


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Path]:
    python = os.environ["CFGPLAN_ROS_PYTHON"]
    ros = {
        "lidar": ["-r", "__node:=lidar", "-r", "scan:=/base_scan"],
        "guard": ["-r", "__node:=guard", "-r", "__ns:=/safety", "-r", "scan:=/base_scan"],
    }
    with ExitStack() as stack:
        for name, text in (("lidar", LIDAR), ("guard", GUARD)):
            file = tmp_path / f"{name}.py"
            file.write_text(text)
            command = [python, f"{name}.py", "--loud", "--ros-args", *ros[name]]
            process = stack.enter_context(subprocess.Popen(command, cwd=tmp_path))
            stack.callback(process.send_signal, signal.SIGINT)
        yield tmp_path


def test_a_live_graph_becomes_a_file_that_check_understands_and_a_run_can_start(
    running: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = running / "robot.yaml"

    def both_are_imported() -> bool:
        code = main(["import", "ros2", "live", "--out", str(env)])
        return code == 0 and {"lidar", "safety/guard"} <= {*api.load(env).environment.transformation}

    eventually(both_are_imported)
    library = api.load(env).environment.transformation
    lidar, guard = library["lidar"], library["safety/guard"]
    assert lidar.source == f"node:{running}/lidar.py --loud"
    assert lidar.params == {"rate": 15.0}
    (scan,) = lidar.outputs
    assert (scan.type, scan.remap, scan.qos) == ("sensor_msgs/msg/LaserScan", "scan", "best_effort")
    assert [(port.remap, port.qos) for port in guard.inputs] == [("scan", "reliable")]
    assert {port.remap for port in guard.outputs} == {"~alarm", "arm"}
    capsys.readouterr()
    assert main(["check", str(env)]) == 1
    first = capsys.readouterr().out.splitlines()[0]
    assert (
        "qos: safety/guard.1 gets no messages of lidar.1/base_scan at base_scan: it asks for reliable messages" in first
    )


def test_a_node_that_runs_here_but_is_not_in_the_graph_is_told() -> None:
    found = graph_of(Graph([], [], [], True), "rmw", {"/lidar": NodeProcess("p", "q")})
    assert [note.partition(":")[0] for note in found.notes] == ["the ports of /lidar"]


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (
            "/opt/ros/jazzy/lib/usb_cam/usb_cam_node_exe -x --ros-args -r __node:=cam -r image:=/front -- -y",
            ("/cam", NodeProcess("usb_cam", "usb_cam_node_exe", ("-x", "-y"), (("image", "/front"),))),
        ),
        (
            "/usr/bin/python3 /ws/install/lib/legs/walk --ros-args --remap walker:__node:=w -r __ns:=/r1 -p speed:=2",
            ("/r1/w", NodeProcess("legs", "walk")),
        ),
        ("./node --ros-args -r __node:=n", ("/n", NodeProcess("", "/home/me/node"))),
        ("./node --ros-args -r scan:=/base_scan", None),
    ],
)
def test_a_command_line_says_which_node_it_starts_and_how(
    command: str, expected: tuple[str, NodeProcess] | None
) -> None:
    assert node_process(command.split(), Path("/home/me")) == expected
