"""A live ROS 2 graph is imported: nodes of an SDK for ROS 2 over Zenoh that is not ours, and nodes of our own."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh
from cfgplan_runtime.ros2.definitions import Definitions
from cfgplan_runtime.ros2.ros_session import RosSession
from operated_world import eventually
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber

from cfgplan import api
from cfgplan.cli import main
from cfgplan.errors import InputError
from cfgplan.ros import EndpointToken, MessageType, NodeToken, Qos
from cfgplan.ros.graph import Role, RosGraph
from cfgplan.ros.liveliness import EndpointKind
from cfgplan.ros.router import router_graph, token_graph

sys.path.append(str(Path(__file__).parents[1] / "ros"))
from ros_graphs import faults

TEXT = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data\n"}
ADDER = {
    "srv_type": "example_interfaces/srv/AddTwoInts",
    "request_definition": "int64 a\nint64 b\n",
    "response_definition": "int64 sum\n",
}


@pytest.fixture
def sdk(router_port: int) -> Iterator[Callable[..., Any]]:
    """Makes ends of topics and services of the SDK's, which are closed after the test."""
    with ExitStack() as stack:

        def make(kind: Any, name: str, node: str, **more: Any) -> None:
            made = kind(name, node_name=node, router_port=router_port, domain_id=0, **more)
            stack.callback(made.close)

        yield make


def seen(endpoint: str, nodes: set[str], number: int) -> RosGraph:
    """The graph of some nodes, once they have so many ports."""
    found: list[RosGraph] = []

    def is_whole() -> bool:
        whole = router_graph(endpoint)
        kept = tuple(node for node in whole.nodes if node.name in nodes)
        found.append(RosGraph(kept, whole.sources, whole.notes))
        return sum(len(node.ports) for node in kept) == number

    eventually(is_whole)
    return found[-1]


def test_nodes_of_the_sdk_are_imported_with_their_topics_and_services(endpoint: str, sdk: Callable[..., Any]) -> None:
    sdk(ROS2Publisher, "/chatter", "talker", **TEXT)
    sdk(ROS2Subscriber, "/chatter", "listener", callback=lambda _: None, **TEXT)
    sdk(ROS2ServiceServer, "/add", "adder", callback=lambda request: request, **ADDER)
    sdk(ROS2ServiceClient, "/add", "asker", **ADDER)
    whole = seen(endpoint, {"/talker", "/listener", "/adder", "/asker"}, 4)
    told = {node.name: [(port.role, port.name, str(port.type)) for port in node.ports] for node in whole.nodes}
    assert told == {
        "/talker": [(Role.PUBLISHES, "/chatter", "std_msgs/msg/String")],
        "/listener": [(Role.SUBSCRIBES, "/chatter", "std_msgs/msg/String")],
        "/adder": [(Role.SERVES, "/add", "example_interfaces/srv/AddTwoInts")],
        "/asker": [(Role.CALLS, "/add", "example_interfaces/srv/AddTwoInts")],
    }
    assert whole.sources == (f"the ROS 2 domain 0 at {endpoint}",)


def test_the_command_writes_an_environment_that_is_checked(
    endpoint: str, sdk: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sdk(ROS2Publisher, "/words", "speaker", **TEXT)
    sdk(ROS2Subscriber, "/word", "hearer", callback=lambda _: None, **TEXT)
    seen(endpoint, {"/speaker", "/hearer"}, 2)
    file = tmp_path / "robot.yaml"
    assert main(["import", "ros2", endpoint, "--out", str(file)]) == 0
    assert {"speaker", "hearer"} <= set(api.load(file).environment.transformation)
    capsys.readouterr()
    assert main(["check", str(file)]) == 1
    out = capsys.readouterr().out
    assert "input word of unit hearer.1 has no subscription" in out
    assert "nearest: speaker.1/words gives std_msgs-String and words: lacks word; nobody takes it" in out


def test_live_is_where_the_variables_of_ros_say(
    router_port: int, endpoint: str, sdk: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    sdk(ROS2Publisher, "/elsewhere", "wanderer", **TEXT)
    seen(endpoint, {"/wanderer"}, 1)
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["tcp/127.0.0.1:{router_port}"]')
    assert "/elsewhere" in router_graph().topics
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert "/elsewhere" not in router_graph().topics


def test_two_definitions_of_one_type_do_not_understand_each_other(endpoint: str, tmp_path: Path) -> None:
    (tmp_path / "old_msgs" / "msg").mkdir(parents=True)
    definition = tmp_path / "old_msgs" / "msg" / "Count.msg"
    topic, kind = "/count", MessageType("old_msgs", "Count")
    with ExitStack() as stack:
        for number, (node, text) in enumerate({"giver": "int32 n\n", "taker": "int64 n\n"}.items()):
            definition.write_text(text)
            session = RosSession(node, connect=[endpoint])
            stack.callback(session.close)
            form = Definitions(files=[str(definition.parent)]).form(kind)
            if number:
                session.subscribe(topic, form, Qos(), lambda *_: None)
            else:
                session.publisher(topic, form, Qos())
        whole = seen(endpoint, {"/giver", "/taker"}, 2)
    (fault, *_) = faults(whole, tmp_path)
    assert "input count of unit taker.1 needs old_msgs-Count-" in fault.text
    assert "but giver.1/count gives old_msgs-Count-" in fault.text


def test_where_no_router_answers_its_endpoint_and_a_way_out_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cfgplan.ros.router.CONNECT_LIMIT_S", 0.2)
    with pytest.raises(InputError, match="no Zenoh router answers at") as raised:
        router_graph("tcp/127.0.0.1:1")
    assert "127.0.0.1:1" in str(raised.value)
    assert "rmw_zenohd" in (raised.value.faults[0].mend or "")


def test_what_is_no_source_is_told_with_those_there_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "ros2", "/nowhere", "--out", str(tmp_path / "x.yaml")]) == 30
    err = capsys.readouterr().err
    assert "/nowhere: there is no such file" in err
    assert "tcp/localhost:7447" in err


def endpoint_of(node: NodeToken, kind: EndpointKind, topic: str, type_text: str) -> EndpointToken:
    return EndpointToken(node, 5, kind, topic, MessageType.read(type_text), "RIHS01_00")


def test_an_action_is_one_service() -> None:
    server, client = NodeToken(0, "ab", 0, "mover"), NodeToken(0, "cd", 0, "boss", "/lab")
    parts = {
        "send_goal": "nav2_msgs::action::dds_::Go_SendGoal_",
        "get_result": "nav2_msgs::action::dds_::Go_GetResult_",
        "cancel_goal": "action_msgs::srv::dds_::CancelGoal_",
    }
    tokens = [endpoint_of(server, "service", f"/go/_action/{part}", kind) for part, kind in parts.items()]
    tokens += [endpoint_of(client, "client", f"/go/_action/{part}", kind) for part, kind in parts.items()]
    tokens.append(
        endpoint_of(server, "publisher", "/go/_action/feedback", "nav2_msgs::action::dds_::Go_FeedbackMessage_")
    )
    tokens.append(endpoint_of(client, "subscription", "/go/_action/status", "action_msgs::msg::dds_::GoalStatusArray_"))
    whole = token_graph(tokens, "a test")
    told = [(node.name, port.role, port.name, str(port.type)) for node in whole.nodes for port in node.ports]
    assert told == [
        ("/lab/boss", Role.CALLS, "/go", "nav2_msgs/action/Go"),
        ("/mover", Role.SERVES, "/go", "nav2_msgs/action/Go"),
    ]


def test_two_nodes_of_one_name_are_told() -> None:
    tokens = [
        endpoint_of(NodeToken(0, session, 0, "eye"), "publisher", f"/{session}", "a/B") for session in ("ab", "cd")
    ]
    whole = token_graph(tokens, "a test")
    assert [node.name for node in whole.nodes] == ["/eye"]
    assert whole.topics == ("/ab", "/cd")
    assert whole.notes == ("which of the 2 nodes called /eye has which of their topics",)


def test_a_token_in_an_unknown_form_is_counted_not_guessed(endpoint: str) -> None:
    session = zenoh.open(zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}'))
    token = session.liveliness().declare_token("@ros2_lv/0/ab/0/0/XX/%/%/odd")
    eventually(lambda: any("1 of the router's tokens" in note for note in router_graph(endpoint).notes))
    token.undeclare()
    session.close()
