"""`import ros2 live` looks again while a node that runs here is not in the graph, and refuses a graph without nodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from cfgplan_runtime.ros2 import live_graph as module
from cfgplan_runtime.ros2.host_messages import Listening
from cfgplan_runtime.ros2.live_graph import DescribeGraph, Graph, NodeProcess, NodeTold, live_graph

from cfgplan.errors import InputError


class Helper:
    """Answers each question with the next of its graphs; at the end, always with the last one."""

    def __init__(self, *graphs: Graph) -> None:
        self.graphs, self.asked = list(graphs), 0

    def send(self, message: object) -> None:
        assert message == DescribeGraph()
        self.asked += 1

    def await_words(self, _: float) -> Iterator[object]:
        if self.asked == 1:
            yield Listening("rmw_fake")
        yield self.graphs[min(self.asked, len(self.graphs)) - 1]

    def close(self) -> None:
        self.graphs = []


def graph(*names: str) -> Graph:
    return Graph([NodeTold(name) for name in names], [], [], True)


@pytest.fixture
def looking(monkeypatch: pytest.MonkeyPatch) -> Any:
    def looking(helper: Helper, *running: str, rmw: str = "", own: str = "") -> Any:
        monkeypatch.setenv("ROS_DOMAIN_ID", "7")
        monkeypatch.setenv("RMW_IMPLEMENTATION", own)
        monkeypatch.setattr(module, "ros_python", lambda python: python)
        monkeypatch.setattr(module, "HostLink", lambda *_: helper)
        monkeypatch.setattr(module, "processes", lambda: {name: NodeProcess("", name, rmw=rmw) for name in running})
        return live_graph()

    return looking


def test_a_node_that_comes_late_is_waited_for(looking: Any) -> None:
    helper = Helper(graph(), graph("/lidar"), graph("/guard", "/lidar"), graph())
    found = looking(helper, "/guard", "/lidar")
    assert [node.name for node in found.nodes] == ["/guard", "/lidar"]
    assert (found.sources, found.notes) == (("the ROS 2 domain 7 (rmw_fake)",), ())
    assert (helper.asked, helper.graphs) == (3, [])


def test_a_node_that_stays_away_is_told_after_some_looks(looking: Any) -> None:
    helper = Helper(graph("/guard"))
    found = looking(helper, "/guard", "/lidar")
    assert [node.name for node in found.nodes] == ["/guard"]
    assert found.notes == ("the ports of /lidar: a process here is that node, but the graph lacks it; import again",)
    assert helper.asked == 4


@pytest.mark.parametrize(
    ("rmw", "own", "looks"),
    [("rmw_zenoh_cpp", "", 1), ("rmw_fake", "rmw_fake", 4), ("", "rmw_fake", 1), ("", "", 4)],
    ids=["another", "the same", "the usual one", "the usual one here, too"],
)
def test_a_node_with_another_middleware_is_not_waited_for(looking: Any, rmw: str, own: str, looks: int) -> None:
    helper = Helper(graph("/guard"))
    found = looking(helper, "/guard", "/lidar", rmw=rmw, own=own)
    assert helper.asked == looks
    (note,) = found.notes
    assert ("another RMW_IMPLEMENTATION than rmw_fake" in note) is (looks == 1)


def test_a_graph_without_nodes_is_refused_with_what_may_be_wrong(looking: Any) -> None:
    with pytest.raises(InputError, match=r"no node in the ROS 2 domain 7 \(rmw_fake\) \(start the nodes first"):
        looking(Helper(graph()))
    with pytest.raises(InputError, match=r"domain 7 \(rmw_fake\) shows no node yet, though /lidar run here"):
        looking(Helper(graph()), "/lidar")


def test_parameters_that_no_file_can_set_are_left_out(looking: Any) -> None:
    """A run would refuse an empty list: ROS 2 gives the node no value for it."""
    parameters = {"rate": 15.0, "frames": [], "gains": [1.5], "unset": None, "silent": False}
    found = looking(Helper(Graph([NodeTold("/lidar", parameters=parameters)], [], [], True)), "/lidar")
    assert found.nodes[0].parameters == {"rate": 15.0, "gains": [1.5], "silent": False}
