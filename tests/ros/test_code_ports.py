"""Ports from the sources of nodes' packages: what is read, what is only told, and that odd text never raises."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.ros.code.code_ports import CodeReading, ports_of_code
from cfgplan.ros.code.cpp_ports import cpp_ports
from cfgplan.ros.code.cpp_tokens import cpp_file
from cfgplan.ros.code.package_sources import ports_of_sources
from cfgplan.ros.code.python_ports import imported_modules, python_ports
from cfgplan.ros.environments import imported
from cfgplan.ros.graph import RosGraph, RosNode
from cfgplan.ros.guesses import guess_table
from cfgplan.ros.launch_files import launch_graph

DRIVER = """
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>
#include "driver/names.h"
// nh.advertise<std_msgs::Empty>("commented", 1);
/* nh.advertise<std_msgs::Empty>("commented_too", 1); */
#if 0
ros::Publisher p = nh.advertise<std_msgs::Empty>("switched_off", 1);
#endif
typedef geometry_msgs::Twist Order;
class Driver {
 public:
  Driver(ros::NodeHandle nh, ros::NodeHandle own) : nh_(nh), it_(nh) {
    own.param<std::string>("order_topic", order_topic_, "cmd_vel");
    imu_ = nh_.advertise<sensor_msgs::Imu>(IMU_TOPIC, 10);
    state_ = own.advertise<std_msgs::String>("state/" "text", 1, true);
    order_ = nh_.subscribe(order_topic_, 1, &Driver::ordered, this);
    laser_ = nh_.subscribe<sensor_msgs::LaserScan>(kScan + "_raw", 1, [this](const auto& m) {});
    reset_ = own.advertiseService("reset", &Driver::reset, this);
    map_ = nh_.serviceClient<nav_msgs::GetMap>("static_map");
    image_ = it_.advertise("image", 1);
    computed_ = nh_.advertise<std_msgs::String>(name(), 1);
  }
  void ordered(const Order::ConstPtr& order);
  bool reset(std_srvs::Empty::Request& in, std_srvs::Empty::Response& out);
 private:
  ros::NodeHandle nh_;
  image_transport::ImageTransport it_;
  std::string order_topic_;
};
int main(int argc, char** argv) {
  ros::NodeHandle nh, own("~");
  Driver driver(nh, own);
  ros::NodeHandle arm(nh, "arm");
  message_filters::Subscriber<sensor_msgs::JointState> joints(arm, "joint_states", 1);
  tf::TransformListener listener;
  tf::TransformBroadcaster broadcaster;
}
"""
NAMES = 'static const std::string kScan = "scan";\n#define IMU_TOPIC "imu/data"\n'
TALKER = """
class Talker : public rclcpp::Node {
 public:
  Talker() : Node("talker") {
    const auto topic = declare_parameter<std::string>("topic", "chatter");
    out_ = create_publisher<std_msgs::msg::String>(topic, 10);
    in_ = this->create_subscription<sensor_msgs::msg::Image>("~/image", 10, std::bind(&Talker::seen, this, _1));
    ask_ = create_client<std_srvs::srv::Trigger>("ask");
    act_ = rclcpp_action::create_server<nav2_msgs::action::Wait>(this, "wait", a, b, c);
  }
};
"""
SCRIPT = """#!/usr/bin/env python
import rospy, actionlib
from std_msgs.msg import String
import sensor_msgs.msg as sensors
from std_srvs.srv import Empty, EmptyResponse
from move_base_msgs.msg import MoveBaseAction
PREFIX = "arm"
def main(given):
    print "a statement of Python 2"
    name = rospy.get_param("~out", "chatter")
    rospy.Publisher(name, String, queue_size=1)
    rospy.Subscriber(f"{PREFIX}/joints", sensors.JointState, heard)
    rospy.Subscriber("%s/wrench" % PREFIX, data_class=String, callback=heard)
    rospy.Service("~stop", Empty, stopped)
    rospy.ServiceProxy(given, Empty)
    actionlib.SimpleActionClient("move_base", MoveBaseAction)
"""
SCRIPT2 = """
from rclpy.node import Node
from rclpy.action import ActionClient
from std_msgs.msg import String
from nav2_msgs.action import Wait
class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.declare_parameter("topic", "chatter")
        self.topic = self.get_parameter("topic").get_parameter_value().string_value
        self.create_publisher(String, self.topic, 10)
        self.create_subscription(msg_type=String, topic="heard", callback=None, qos_profile=1)
        ActionClient(self, Wait, "wait")
"""
NODE = RosNode("/robot/mine", (), "driver", "driver_node", remappings=(("/robot/static_map", "/map"),))


def told(reading: CodeReading, node: RosNode = NODE) -> set[str]:
    places, _ = ports_of_code(reading, node, {})
    return {f"{port.role.value} {port.own} {port.type.ros1 if port.type else None}" for port in places}


def cpp(**files: str) -> CodeReading:
    return cpp_ports([cpp_file(text, name) for name, text in files.items()])


def test_calls_of_roscpp_are_ports_by_their_handle_name_and_type() -> None:
    found = cpp(driver=DRIVER, names=NAMES)
    assert told(found) == {
        "publishes imu/data sensor_msgs/Imu",
        "publishes ~state/text std_msgs/String",
        "subscribes cmd_vel geometry_msgs/Twist",
        "subscribes scan_raw sensor_msgs/LaserScan",
        "serves ~reset std_srvs/Empty",
        "calls static_map nav_msgs/GetMap",
        "publishes image sensor_msgs/Image",
        "subscribes arm/joint_states sensor_msgs/JointState",
        "publishes /tf tf2_msgs/TFMessage",
    }
    assert found.unclear == ("publishes `name ( )` at driver:22",)


def test_calls_of_rclcpp_are_ports() -> None:
    assert told(cpp(talker=TALKER)) == {
        "publishes chatter std_msgs/String",
        "subscribes ~/image sensor_msgs/Image",
        "calls ask std_srvs/Trigger",
        "serves wait nav2_msgs/Wait",
    }


def test_a_parameter_that_the_launch_file_sets_is_the_topics_name() -> None:
    node = RosNode("/a", (), parameters={"order_topic": "/stop", "out": "said", "topic": "other"})
    assert "subscribes /stop geometry_msgs/Twist" in told(cpp(driver=DRIVER, names=NAMES), node)
    assert "publishes other std_msgs/String" in told(cpp(talker=TALKER), node)
    assert "publishes said std_msgs/String" in told(python_ports(SCRIPT, "s.py"), node)
    assert "publishes other std_msgs/String" in told(python_ports(SCRIPT2, "s.py"), node)


def test_calls_of_rospy_are_ports_also_in_python_2() -> None:
    found = python_ports(SCRIPT, "s.py")
    assert told(found) == {
        "publishes chatter std_msgs/String",
        "subscribes arm/joints sensor_msgs/JointState",
        "subscribes arm/wrench std_msgs/String",
        "serves ~stop std_srvs/Empty",
        "publishes move_base/goal move_base_msgs/MoveBaseActionGoal",
        "publishes move_base/cancel actionlib_msgs/GoalID",
        "subscribes move_base/status actionlib_msgs/GoalStatusArray",
        "subscribes move_base/feedback move_base_msgs/MoveBaseActionFeedback",
        "subscribes move_base/result move_base_msgs/MoveBaseActionResult",
    }
    assert found.unclear == ("calls `given` at s.py:15",)


def test_calls_of_rclpy_are_ports() -> None:
    assert told(python_ports(SCRIPT2, "s.py")) == {
        "publishes chatter std_msgs/String",
        "subscribes heard std_msgs/String",
        "calls wait nav2_msgs/Wait",
    }


@pytest.mark.parametrize(
    "lines",
    [
        'std::string t = "a"; if (x) t = "b"; nh.advertise<std_msgs::String>(t, 1);',
        'nh.param<std::string>("t", t, prefix()); nh.advertise<std_msgs::String>(t, 1);',
        'ros::NodeHandle& other = find(); other.advertise<std_msgs::String>("a", 1);',
        "nh.advertise<std_msgs::String>(argv[1], 1);",
        'std::string t; nh.param<std::string>("t", t, "a"); t = "b" + t; nh.advertise<std_msgs::String>(t, 1);',
        'std::string t; nh.getParam("t", t); nh.advertise<std_msgs::String>(t, 1);',
    ],
)
def test_a_name_or_handle_that_is_computed_is_told_and_left_out(lines: str) -> None:
    found = cpp(main=f"int main() {{ ros::NodeHandle nh; {lines} }}")
    places, unclear = ports_of_code(found, NODE, {})
    assert (list(places), len(unclear)) == ([], 1)


def test_variables_of_functions_are_kept_apart() -> None:
    one, other = (f'void {n}() {{ ros::NodeHandle nh("{n}"); nh.advertise<std_msgs::Empty>("x", 1); }}' for n in "ab")
    assert told(cpp(main=one + other)) == {"publishes a/x std_msgs/Empty", "publishes b/x std_msgs/Empty"}


def _package(folder: Path, files: Iterable[tuple[str, str]]) -> Path:
    """A package `driver` with these files; returns its launch file."""
    for name, text in [("package.xml", "<package><name>driver</name></package>"), *files]:
        path = folder / "driver" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / "driver" / "robot.launch"


def _node(kind: str) -> str:
    return f"<launch><node pkg='driver' type='{kind}' name='mine'/></launch>"


def _own_names(graph: RosGraph) -> set[str | None]:
    return {port.own for port in ports_of_sources(graph.nodes[0], graph.parameters).places}


CMAKE = """
set(FILES src/driver.cpp) # a comment (with brackets
add_executable(driver_node ${FILES})
add_executable(other src/other.cpp)
set_target_properties(other PROPERTIES OUTPUT_NAME second)
"""
PUBLISH = "int main() {{ ros::NodeHandle nh; nh.advertise<std_msgs::Empty>({}, 1); }}"


def test_a_node_has_the_ports_of_its_own_files_and_of_the_headers_they_include(tmp_path: Path) -> None:
    file = _package(
        tmp_path,
        [
            ("CMakeLists.txt", CMAKE),
            ("src/driver.cpp", DRIVER),
            ("include/driver/names.h", NAMES),
            ("src/other.cpp", PUBLISH.format('"other"')),
            ("robot.launch", _node("driver_node")),
            ("second.launch", _node("second")),
            ("none.launch", _node("not_made")),
        ],
    )
    found = imported(launch_graph(file), guess_table())
    (node,) = found.graph.nodes
    assert {port.own for port in node.ports} == {
        *("imu/data", "~state/text", "cmd_vel", "scan_raw", "~reset", "static_map", "image"),
        *("arm/joint_states", "/tf"),
    }
    why = {guess.guess: guess.why for guess in found.guesses if guess.about == "/mine"}
    assert why["publishes /imu/data"] == "its source says so: driver/src/driver.cpp:15"
    assert [note for note in found.graph.notes if "computes" in note] == [
        "which topics of /mine its code computes: publishes `name ( )` at driver/src/driver.cpp:22"
    ]
    assert _own_names(launch_graph(file.with_name("second.launch"))) == {"other"}
    assert _own_names(launch_graph(file.with_name("none.launch"))) == set()


def test_a_nodelet_has_the_ports_of_the_file_that_registers_its_class(tmp_path: Path) -> None:
    body = 'namespace d {{ void {0}::onInit() {{ getPrivateNodeHandle().advertise<std_msgs::Empty>("{1}", 1); }} }}'
    export = "\nPLUGINLIB_EXPORT_CLASS(d::{}, nodelet::Nodelet)"
    file = _package(
        tmp_path,
        [
            (
                "plugins.xml",
                '<library path="a"><class name="driver/One" type="d::First" base_class_type="x"/></library>',
            ),
            ("src/first.cc", body.format("First", "one") + export.format("First")),
            ("src/second.cc", body.format("Second", "two") + export.format("Second")),
            ("robot.launch", "<launch><node pkg='nodelet' type='nodelet' name='n' args='load driver/One m'/></launch>"),
        ],
    )
    assert _own_names(launch_graph(file)) == {"~one"}


def test_a_script_has_its_own_ports_and_those_of_the_modules_it_imports(tmp_path: Path) -> None:
    file = _package(
        tmp_path,
        [
            ("scripts/run", "#!/usr/bin/env python\nfrom driver.inner import Inner\n"),
            ("src/driver/inner.py", "import rospy\nrospy.Publisher('inner', T)\n"),
            ("src/driver/other.py", "import rospy\nrospy.Publisher('other', T)\n"),
            ("robot.launch", _node("run")),
        ],
    )
    assert _own_names(launch_graph(file)) == {"inner"}


def test_parameters_outside_of_nodes_name_topics_too(tmp_path: Path) -> None:
    code = 'int main() { ros::NodeHandle nh; std::string t; nh.param<std::string>("all/topic", t, "a"); %s }'
    use = "nh.advertise<std_msgs::Empty>(t, 1);"
    setting = "<launch><param name='all/topic' value='b'/><node pkg='driver' type='x' name='mine'/></launch>"
    file = _package(
        tmp_path,
        [
            ("CMakeLists.txt", "add_executable(x main.cpp)"),
            ("main.cpp", code % use),
            ("robot.launch", setting),
            ("plain.launch", _node("x")),
        ],
    )
    assert _own_names(launch_graph(file)) == {"b"}
    assert _own_names(launch_graph(file.with_name("plain.launch"))) == {"a"}


def test_the_whole_package_is_read_and_told_where_it_does_not_say_which_files_are_whose(tmp_path: Path) -> None:
    file = _package(tmp_path, [("main.cpp", PUBLISH.format('"a"')), ("robot.launch", _node("x"))])
    found = imported(launch_graph(file), guess_table())
    assert "a source of its package says so: driver/main.cpp:1" in {guess.why for guess in found.guesses}


def test_the_table_is_believed_before_the_sources(tmp_path: Path) -> None:
    guesses = tmp_path / "guesses.yaml"
    guesses.write_text("nodes: {driver/x: {subscribes: {known: null}}}")
    file = _package(tmp_path, [("main.cpp", PUBLISH.format('"a"')), ("robot.launch", _node("x"))])
    (node,) = imported(launch_graph(file), guess_table([guesses])).graph.nodes
    assert [port.own for port in node.ports] == ["known"]


def test_files_that_are_no_text_or_do_not_parse_are_told_or_passed_over(tmp_path: Path) -> None:
    file = _package(tmp_path, [("scripts/bad.py", "def ("), ("robot.launch", _node("bad.py"))])
    (tmp_path / "driver" / "blob.cpp").write_bytes(bytes(range(256)) * 10)
    (tmp_path / "driver" / "CMakeLists.txt").write_bytes(b"add_executable(x blob.cpp\xff) set(")
    found = imported(launch_graph(file), guess_table())
    assert any("driver/scripts/bad.py, which does not parse" in note for note in found.graph.notes)
    file.write_text(_node("x"))
    assert _own_names(launch_graph(file)) == set()


SOURCES = (DRIVER, NAMES, TALKER, SCRIPT, SCRIPT2)
CUTS = st.lists(
    st.tuples(st.integers(0, 2000), st.integers(0, 40), st.text("(){}[]<>\"'/*#,;:&~=.\\\n\0é a1", max_size=5)),
    max_size=8,
)


@given(st.sampled_from(SOURCES), CUTS)
def test_the_readers_raise_nothing_on_text_that_was_cut_and_changed(
    text: str, cuts: list[tuple[int, int, str]]
) -> None:
    for at, length, instead in cuts:
        text = text[:at] + instead + text[at + length :]
    for reading in (cpp(a=text, b=NAMES), python_ports(text, "a.py")):
        places, unclear = ports_of_code(reading, NODE, {})
        assert all(port.own for port in places) and len(unclear) >= len(reading.unclear)
    assert isinstance(imported_modules(text), frozenset)


@pytest.mark.parametrize("sign", ["(", "{", "a<", "x(", '"', "/*", "#if 0\n", "nh.advertise<A>(t="])
def test_a_long_run_of_one_sign_is_read_in_time(sign: str) -> None:
    assert cpp(a=sign * 20_000).ports == ()
    assert python_ports(sign * 20_000, "a.py").ports == ()
