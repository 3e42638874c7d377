"""A live ROS 1 system: a master and nodes are started, and their graph is imported."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosGraph
from cfgplan.ros.master import master_graph

NODES = Path(__file__).with_name("nodes.py")
PYTHON = "/usr/bin/python3"
LONGEST_WAIT_S = 60.0


@pytest.fixture(scope="session")
def ros() -> None:
    command = [PYTHON, "-c", "import rospy, roscpp.srv"]
    is_found = shutil.which("rosmaster", path=os.defpath) is not None
    if not is_found or subprocess.run(command, env={}, capture_output=True, check=False).returncode:
        pytest.skip("ROS 1 (rosmaster, rospy) is not installed on this computer")


class Master:
    """A master on a free port, and what was started beside it."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.address = f"http://127.0.0.1:{port}"
        self._environment = {
            "PATH": os.defpath,
            "HOME": str(folder),
            "ROS_LOG_DIR": str(folder),
            "ROS_MASTER_URI": self.address,
            "ROS_IP": "127.0.0.1",
        }
        self._started: list[subprocess.Popen[bytes]] = []
        self.start("rosmaster", "--core", "-p", str(port))

    def start(self, *command: str) -> subprocess.Popen[bytes]:
        null = subprocess.DEVNULL
        process = subprocess.Popen(command, env=self._environment, stdout=null, stderr=null)
        self._started.append(process)
        return process

    def stop(self) -> None:
        for process in reversed(self._started):
            process.kill()
            process.wait()


@pytest.fixture
def master(tmp_path: Path) -> Iterator[Master]:
    started = Master(tmp_path)
    yield started
    started.stop()


def _graph(address: str, is_whole: Callable[[RosGraph], bool]) -> RosGraph:
    """The graph once it is whole."""
    until = time.monotonic() + LONGEST_WAIT_S
    while True:
        try:
            found = master_graph(address)
            if is_whole(found):
                return found
        except InputError:
            found = None
        assert time.monotonic() < until, found
        time.sleep(0.1)


@pytest.mark.usefixtures("ros")
def test_a_node_of_a_package_runs_and_says_how_it_was_started(master: Master, tmp_path: Path) -> None:
    package = tmp_path / "my_robot"
    package.mkdir()
    (package / "package.xml").write_text("<package><name>my_robot</name></package>")
    program = Path(shutil.copy(NODES, package / "driver.py"))
    master.start(PYTHON, str(program), "lidar", "scan:=/base_scan", "__ns:=robot")
    (node,) = _graph(master.address, lambda seen: "/base_scan" in seen.topics).nodes
    assert (node.package, node.executable, node.arguments) == ("my_robot", "driver.py", ("lidar",))
    assert (node.remappings, node.runs) == ((("/robot/scan", "/base_scan"),), True)


@pytest.mark.usefixtures("ros")
def test_a_live_graph_has_its_nodes_with_types_and_services(master: Master) -> None:
    address = master.address
    lidar = master.start(PYTHON, str(NODES), "lidar", "scan:=/base_scan", "__ns:=robot")
    master.start(PYTHON, str(NODES), "planner")
    found = _graph(address, lambda seen: {"/base_scan", "/scan", "/way", "/map"} <= {*seen.topics})
    nodes = {node.name: node for node in found.nodes}
    ports = {(port.role, port.name): str(port.type) for port in nodes["/robot/lidar"].ports}
    assert ports[Role.PUBLISHES, "/base_scan"] == "std_msgs/msg/Float64"
    assert ports[Role.SERVES, "/robot/lidar/reset"] == "roscpp/srv/Empty"
    types = {port.name: str(port.type) for port in nodes["/planner"].ports}
    assert (types["/scan"], types["/map"]) == ("std_msgs/msg/Float64", "std_msgs/msg/String")
    assert not any("/robot/lidar" in note for note in found.notes)
    assert any("the callers of services" in note for note in found.notes)

    lidar.kill()
    lidar.wait()
    dead = master_graph(address)  # a master forgets nobody that does not say goodbye
    assert any("whether /robot/lidar is alive" in note for note in dead.notes)
    assert {node.name: node.runs for node in dead.nodes} == {"/robot/lidar": False, "/planner": True}
    assert {port.name for node in dead.nodes for port in node.ports} >= {"/base_scan"}


def test_where_no_master_answers_its_address_and_a_way_out_are_told() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # nobody listens, and nobody else gets the port
        address = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match="no ROS 1 master answers") as raised:
            master_graph(address)
    assert address in str(raised.value)
    assert "roscore" in (raised.value.faults[0].mend or "")
    with pytest.raises(InputError, match="is not the address"):
        master_graph("ftp://nowhere")
