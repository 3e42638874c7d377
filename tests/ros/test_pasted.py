"""Text of `ros2 node info`, `ros2 topic info -v` and `rosnode info` as people paste it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.errors import InputError
from cfgplan.ros.graph import Role
from cfgplan.ros.origins import ros1_graph
from cfgplan.ros.pasted import graph_of_text, pasted_graph
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType

MIXED = """ann@robot:~/my files$ ros2 node info /eyes/camera
/eyes/camera
  Subscribers:
    /parameter_events: rcl_interfaces/msg/ParameterEvent
  Publishers:
    /image: sensor_msgs/msg/Image

  Service Servers:
    /eyes/camera/reset: std_srvs/srv/Trigger
  Service Clients:

  Action Servers:
    /look: demo/action/Look
  Action Clients:

$ ros2 topic info -v /image
Type: sensor_msgs/msg/Image

Publisher count: 1

Node name: camera
Node namespace: /eyes
Topic type: sensor_msgs/msg/Image
Topic type hash: RIHS01_ab
Endpoint type: PUBLISHER
GID: 01.0f.bb.1e
QoS profile:
  Reliability: BEST_EFFORT
  History (Depth): UNKNOWN
  Durability: VOLATILE
  Lifespan: Infinite
  Deadline: 100000000 nanoseconds
  Liveliness: AUTOMATIC
  Liveliness lease duration: Infinite

Subscription count: 1

Node name: viewer
Node namespace: /
Topic type: sensor_msgs/msg/Image
Endpoint type: SUBSCRIPTION
GID: 01.0f.bb.1f
QoS profile:
  Reliability: RELIABLE
  Durability: TRANSIENT_LOCAL
  Deadline: 9223372036854775807 nanoseconds
  Liveliness: MANUAL_BY_TOPIC
  Liveliness lease duration: 2000000000 nanoseconds
ann@robot:~$
"""
ROSNODE = """$ rosnode info /talker
--------------------------------------------------------------------------------
Node [/talker]
Publications:
 * /chatter [std_msgs/String]

Subscriptions:
 * /clock [unknown type]

Services:
 * /talker/get_loggers


contacting node http://robot:40123/ ...
Pid: 12
Connections:
 * topic: /chatter
    * to: /listener
"""


def test_nodes_and_endpoints_of_topics_are_put_together_with_their_quality_of_service() -> None:
    graph = graph_of_text(MIXED, "text", 2)
    camera, viewer = graph.nodes
    assert (camera.name, viewer.name) == ("/eyes/camera", "/viewer")
    image = MessageType("sensor_msgs", "Image")
    (sent,) = (port for port in camera.ports if port.name == "/image")
    assert (sent.type, sent.definition, sent.qos) == (image, "RIHS01_ab", ServiceQuality(False, deadline_s=0.1))
    assert camera.names(Role.SERVES) == ["/eyes/camera/reset", "/look"]
    assert {str(port.type) for port in camera.ports if port.role is Role.SERVES} == {
        "std_srvs/srv/Trigger",
        "demo/action/Look",
    }
    (heard,) = viewer.ports
    assert (heard.role, heard.type) == (Role.SUBSCRIBES, image)
    assert heard.qos == ServiceQuality(transient_local=True, lease_s=2.0, manual=True)
    assert graph.topics == ("/image", "/parameter_events")


def test_rosnode_info_tells_topics_and_services(tmp_path: Path) -> None:
    file = tmp_path / "robot.txt"
    file.write_text(ROSNODE)
    (node,) = ros1_graph([str(file)]).nodes
    assert [(port.role.value, port.name, port.type) for port in node.ports] == [
        ("publishes", "/chatter", MessageType("std_msgs", "String")),
        ("serves", "/talker/get_loggers", None),
        ("subscribes", "/clock", None),
    ]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("/a\n  Publishers:\n    /x: no type at all\n", 3, "this line describes no port"),
        ("/a\n  Publishers:\n    /x: Image\n", 3, "`Image` is not a message type"),
        ("  Publishers:\n    /x: a/msg/B\n", 1, "this section is of no node"),
        (
            "Type: a/msg/B\n\nNode name: n\nNode namespace: /\nEndpoint type: PUBLISHER\n",
            3,
            "the topic of this endpoint",
        ),
        ("$ ros2 topic info -v /x\nType: a/msg/B\nNode name: n\n", 3, "this endpoint says not whether"),
        ("hello\n", 1, "no node is named"),
    ],
)
def test_a_fault_in_pasted_text_is_told_with_its_line_and_a_mend(text: str, line: int, message: str) -> None:
    with pytest.raises(InputError) as error:
        graph_of_text(text, "text", 2)
    (fault,) = error.value.faults
    assert (fault.line, fault.file) == (line, "text")
    assert fault.message.startswith(message)
    assert fault.mend


def test_a_second_topic_without_its_command_is_not_taken_for_the_first() -> None:
    second = MIXED[MIXED.index("Type: sensor") :]
    with pytest.raises(InputError, match="topic of this endpoint is missing"):
        graph_of_text(MIXED + second, "text", 2)


def test_standard_input_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "in.txt").write_text(MIXED)
    monkeypatch.setattr("cfgplan.ros.pasted._STDIN", str(tmp_path / "in.txt"))
    assert pasted_graph("-", 2).nodes == graph_of_text(MIXED, "text", 2).nodes


@given(
    st.sampled_from((MIXED, ROSNODE)),
    st.sampled_from((1, 2)),
    st.lists(st.tuples(st.integers(0, 1500), st.integers(0, 60), st.text("/:*[] \n$aN", max_size=6)), max_size=6),
)
def test_text_that_was_cut_and_changed_is_read_or_refused(
    text: str, generation: int, cuts: list[tuple[int, int, str]]
) -> None:
    for at, length, instead in cuts:
        text = text[:at] + instead + text[at + length :]
    try:
        graph = graph_of_text(text, "text", generation)
    except InputError as error:
        assert all(fault.line and fault.mend for fault in error.faults)
    else:
        assert graph.nodes
