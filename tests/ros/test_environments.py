"""What a graph of ROS nodes becomes: the judge finds wrong with it what is wrong with the graph, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_graphs import faults, graph, judged, node, read_back, written

from cfgplan import api
from cfgplan.domain import ALL
from cfgplan.ros.environments import imported, port_names
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort, merged
from cfgplan.ros.guesses import guess_table
from cfgplan.ros.types import MessageType
from cfgplan.validity import violations

SCAN, ODOM, TWIST, TF = "sensor_msgs/LaserScan", "nav_msgs/Odometry", "geometry_msgs/Twist", "tf2_msgs/TFMessage"

ROBOT = graph(
    node("/lidar", {"/scan": SCAN, "/rosout": "rosgraph_msgs/Log"}),
    node("/base", {"/odom": ODOM, "/tf": TF}, {"/cmd_vel": TWIST}),
    node("/amcl", {"/tf": TF}, {"/scan": SCAN, "/tf": TF, "/initialpose": "geometry_msgs/PoseWithCovarianceStamped"}),
    node("/move_base", {"/cmd_vel": TWIST}, {"/scan": SCAN, "/odom": ODOM, "/tf": TF}, {"/clear": "std_srvs/Empty"}),
    node("/watch", {}, {"/odom": ODOM}, {}, {"/clear": "std_srvs/Empty"}),
    node("/rosout", {}, {"/rosout": "rosgraph_msgs/Log"}),
)


def test_a_running_robot_is_a_valid_environment_that_nothing_would_improve(tmp_path: Path) -> None:
    assert judged(ROBOT, tmp_path) == []
    problem = api.match(api.load(tmp_path / "robot.yaml"))
    change = api.plan(problem).change_set
    assert change is not None
    assert not change


def test_words_of_the_file_say_what_the_graph_is() -> None:
    environment = imported(ROBOT, guess_table()).environment
    amcl = environment.transformation["amcl"]
    assert (amcl.input["tf"].count, amcl.input["tf"].feedback) == (ALL, True)
    assert amcl.input["initialpose"].optional
    assert not amcl.input["scan"].optional
    assert environment.transformation["watch"].input["clear"].service
    assert [s.stream.unit for s in environment.unit["amcl.1"].subscriptions if s.port == "tf"] == ["base.1"]
    assert [s.stream.unit for s in environment.unit["move_base.1"].subscriptions if s.port == "tf"] == [
        "amcl.1",
        "base.1",
    ]
    assert environment.transformation["move_base"].input["odom"].feedback  # the base drives where it is told to
    assert [target.run for target in environment.targets] == ["watch"]
    assert "rosout" not in environment.transformation


def test_every_guess_is_told_and_stands_above_the_file() -> None:
    found = imported(ROBOT, guess_table())
    told = {(guess.about, guess.guess) for guess in found.guesses}
    assert {
        ("nodes", "left out /rosout"),
        ("input initialpose of amcl", "it may stay unfed"),
        ("input tf of amcl", "takes every stream"),
        ("input odom of move_base", "closes a cycle"),
        ("watch", "treated as a target"),
    } <= told
    comments = [line for line in found.text("x.ttl").splitlines() if line.startswith("#")]
    assert all(any(about in line and guess in line for line in comments) for about, guess in told)


def test_two_commanders_are_one_too_many_and_a_file_may_say_that_they_are_not(tmp_path: Path) -> None:
    twice = merged([ROBOT, graph(node("/teleop", {"/cmd_vel": TWIST}))])
    assert [v.text for v in judged(twice, tmp_path)] == [
        "input cmd_vel of unit base.1 takes one stream, but has 2: move_base.1/cmd_vel, teleop.1/cmd_vel"
    ]
    allowed = "inputs: [{topic: /cmd_vel, several: true, why: the base takes both}]"
    assert judged(twice, tmp_path, allowed) == []


def test_a_file_says_who_is_wanted(tmp_path: Path) -> None:
    found = judged(ROBOT, tmp_path, "wanted: [/base]")
    assert {v.unit for v in found} == {"watch.1"}


def test_an_end_without_a_type_has_that_of_the_others() -> None:
    whole = graph(node("/a", {"/x": SCAN}), node("/relay", {"/y": None}, {"/x": None}))
    found = imported(whole, guess_table())
    relay = found.environment.transformation["relay"]
    assert relay.input["x"].tag == "sensor_msgs-LaserScan and x"
    assert relay.output["y"].tag == "y"


def test_topics_that_a_tag_could_not_name_get_another_name(tmp_path: Path) -> None:
    names = ["/value", "/and", "/0day", "/Topic", "/a/b", "/odd name", "/sensor_msgs/LaserScan", "/_", "/"]
    whole = graph(node("/a", dict.fromkeys(names, SCAN)), node("/b", {}, dict.fromkeys(names, SCAN)))
    assert judged(whole, tmp_path) == []


def test_ports_are_called_by_the_least_that_tells_them_apart() -> None:
    both = node(
        "/n", {"/odom": ODOM, "/left/image": SCAN, "/right/image": SCAN}, {"/odom": ODOM}, {"/odom": "std_srvs/Empty"}
    )
    names = {(port.role, port.name): name for port, name in port_names(both).items()}
    assert names[Role.SUBSCRIBES, "/odom"] == "odom"
    assert names[Role.PUBLISHES, "/odom"] == "odom.out"
    assert names[Role.SERVES, "/odom"] == "odom.out.service"
    assert {names[Role.PUBLISHES, f"/{side}/image"] for side in ("left", "right")} == {"left.image", "right.image"}


def test_nodes_of_one_name_are_one_node() -> None:
    one = graph(node("/n", {"/a": None}, {"/b": SCAN}))
    other = graph(node("/n", {"/a": SCAN}))
    (both,) = merged([one, other]).nodes
    assert [(port.name, str(port.type)) for port in both.ports] == [
        ("/a", "sensor_msgs/msg/LaserScan"),
        ("/b", "sensor_msgs/msg/LaserScan"),
    ]


TYPES = st.sampled_from([SCAN, ODOM, TWIST, TF, "my_msgs/Thing", "sensor_msgs/Joy", None])
TOPICS = st.sampled_from(["/a", "/b", "/ns/a", "/ns/b", "/c"])
ENDS = st.dictionaries(TOPICS, TYPES, max_size=3)


@st.composite
def graphs(draw: st.DrawFn) -> RosGraph:
    names = draw(st.lists(st.sampled_from(["/one", "/two", "/ns/one", "/three"]), unique=True, max_size=4))
    return graph(*(node(name, draw(ENDS), draw(ENDS), draw(ENDS), draw(ENDS)) for name in names))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(graphs())
def test_whatever_the_graph_its_environment_is_read_back_and_breaks_no_other_rule(whole: RosGraph) -> None:
    """What can be wrong: an input that nobody feeds, one with several streams, and types that differ."""
    with TemporaryDirectory() as folder:
        rules = {violation.rule.name for violation in judged(whole, Path(folder))}
        assert rules <= {"FED", "MATCHING"}
        read = api.load(Path(folder) / "robot.yaml").environment
        assert read == imported(whole, guess_table()).environment


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(graphs())
def test_a_graph_that_works_breaks_no_rule_but_where_types_differ(whole: RosGraph) -> None:
    with TemporaryDirectory() as folder:
        found = imported(whole, guess_table(), works=True)
        problem = api.match(api.load(written(found, Path(folder))))
        assert {violation.rule.name for violation in violations(problem.environment, problem.similarity)} <= {
            "MATCHING"
        }


def test_a_graph_that_works_is_planned_to_stay_as_it_is(tmp_path: Path) -> None:
    odd = merged([ROBOT, graph(node("/teleop", {"/cmd_vel": TWIST}), node("/mapper", {}, {"/points": SCAN}))])
    assert {fault.suspicion.name for fault in faults(odd, tmp_path) if fault.violation} == {"NUMBER", "TAKEN"}
    found = imported(odd, guess_table(), works=True)
    told = {(guess.about, guess.guess, guess.why) for guess in found.guesses}
    assert ("input points of mapper", "it may stay unfed", "no node feeds it, and the graph works") in told
    assert ("input cmd_vel of base", "takes every stream", "they publish, and the graph works") in told
    change = api.plan(api.match(api.load(written(found, tmp_path)))).change_set
    assert change is not None
    assert not change


def test_one_graph_gives_one_file_in_whatever_order_it_is_told(tmp_path: Path) -> None:
    there = imported(ROBOT, guess_table())
    back = imported(RosGraph(ROBOT.nodes[::-1], ROBOT.sources), guess_table())
    assert (there.text("o.ttl"), there.ontology) == (back.text("o.ttl"), back.ontology)
    assert written(there, tmp_path).read_text() == there.text("robot.ttl")


def test_the_file_says_how_nodes_are_started_and_what_they_call_their_ports(tmp_path: Path) -> None:
    nodes = [
        RosNode(
            "/eyes/talk",
            tuple(RosPort(Role.PUBLISHES, name) for name in ("/b", "/eyes/d", "/eyes/talk/e", "/tf")),
            "rospy_tutorials",
            "talker",
            remappings=(("/eyes/a", "/b"),),
        ),
        RosNode("/eyes/rect", (), "image_proc", None, "image_proc/rectify", "/eyes/manager"),
        RosNode("/eyes/crop", (), "image_proc", None, "image_proc::CropNode"),
        RosNode("/unknown", (RosPort(Role.SUBSCRIBES, "/b", MessageType("std_msgs", "String")),)),
    ]
    library = read_back(graph(*nodes), tmp_path).environment.transformation
    assert {label: each.source for label, each in library.items()} == {
        "eyes/talk": "node:rospy_tutorials/talker",
        "eyes/rect": "nodelet:image_proc/rectify@/eyes/manager",
        "eyes/crop": "component:image_proc/image_proc::CropNode",
        "unknown": "external:/unknown",
    }
    called = {port.name: port.remap for port in library["eyes/talk"].outputs}
    assert called == {"b": "a", "d": "d", "e": "~e", "tf": "/tf"}
    heard = library["unknown"].input["b"]
    assert (heard.remap, heard.type) == ("b", "std_msgs/msg/String")


def test_a_recording_tells_how_often_messages_come() -> None:
    player = RosNode("/player", (RosPort(Role.PUBLISHES, "/a", rate_hz=12.5),))
    (output,) = imported(graph(player), guess_table()).environment.transformation["player"].outputs
    assert output.rate_uhz == 12_500_000


def test_the_manuals_file_of_guesses_is_read_and_believed_first(tmp_path: Path) -> None:
    file = tmp_path / "guesses.yaml"
    text = (Path(api.__file__).parent / "manual" / "ros.md").read_text()
    file.write_text(next(block for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL) if "noise:" in block))
    whole = graph(
        node("/left", {"/odom": ODOM, "/debug/x": SCAN}),
        node("/right", {"/odom": ODOM}),
        node("/fusion", {"/fused": ODOM}, {"/odom": ODOM, "/pad/joy_left": "my_msgs/Stick"}),
        RosNode("/driver", (), "my_robot", "driver"),
    )
    found = imported(whole, guess_table([file]))
    fusion = found.environment.transformation["fusion"]
    assert (fusion.input["odom"].count, fusion.input["joy_left"].optional) == (ALL, True)
    assert "/debug/x" not in found.graph.topics
    assert [port.tag for port in found.environment.transformation["driver"].outputs] == [
        "my_msgs-State and driver-state"
    ]
    assert [target.run for target in found.environment.targets] == ["driver"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("inputs: [{topc: x}]", "unknown key `topc`"),
        ("inputs: [{optional: true}]", "does not say which inputs"),
        ("nodes: {a/b: {publishes: {x: Odometry}}}", "is not a message type"),
        ("inputs: {}", "this must be a list"),
        ("inputs: [{type: a/b, several: 2}]", "true or false"),
    ],
)
def test_a_faulty_file_of_guesses_is_told_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "guesses.yaml"
    file.write_text(text)
    with pytest.raises(api.InputError, match=said) as raised:
        guess_table([file])
    assert all(fault.line == 1 for fault in raised.value.faults)
