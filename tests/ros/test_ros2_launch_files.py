"""Launch files of ROS 2 in XML and YAML: both forms start the same nodes, and faults name their places."""

from __future__ import annotations

from pathlib import Path

import pytest

from cfgplan import api
from cfgplan.cli import main
from cfgplan.errors import InputError
from cfgplan.ros.graph import RosGraph, RosNode
from cfgplan.ros.guesses import guess_table
from cfgplan.ros.origins import ros2_graph
from cfgplan.ros.ros2_launch_files import ros2_launch_graph

XML = """\
<launch>
  <arg name="camera" default="front"/>
  <arg name="sim" default="false"/>
  <let name="gain" value="$(eval '2 * 5')"/>
  <set_parameter name="use_sim_time" value="$(var sim)"/>
  <set_remap from="odom" to="/wheels/odom"/>
  <group>
    <push-ros-namespace namespace="$(var camera)"/>
    <let name="gain" value="1"/>
    <node pkg="image_proc" exec="rectify_node" name="rectify" args="--fast 'two words'">
      <remap from="image" to="/$(var camera)/image_raw"/>
      <param name="queue_size" value="5"/>
      <param name="scale" value="15.0"/>
      <param name="frame" value="07" type="str"/>
      <param name="pid"><param name="p" value="1.5"/><param name="i" value="0"/></param>
    </node>
    <group unless="$(var sim)"><node pkg="usb_cam" exec="usb_cam_node_exe" name="driver" respawn="true"/></group>
  </group>
  <node_container pkg="rclcpp_components" exec="component_container" name="box" namespace="">
    <composable_node pkg="image_proc" plugin="image_proc::ResizeNode" name="resize" namespace="small">
      <remap from="image" to="image_in"/>
      <param name="width" value="$(var gain)"/>
      <extra_arg name="use_intra_process_comms" value="true"/>
    </composable_node>
  </node_container>
  <load_composable_node target="/box"><composable_node pkg="p" plugin="p::Late" name="late"/></load_composable_node>
  <include file="$(dirname)/more.launch.xml"><arg name="name" value="$(var camera)_more"/></include>
  <node pkg="p" exec="q" name="sums" if="$(and $(not $(var sim)) $(equals $(var gain) 10))">
    <param from="$(dirname)/params.yaml"/>
  </node>
</launch>
"""
YAML = """\
launch:
- arg: {name: camera, default: front}
- arg: {name: sim, default: "false"}
- let: {name: gain, value: "$(eval '2 * 5')"}
- set_parameter: {name: use_sim_time, value: $(var sim)}
- set_remap: {from: odom, to: /wheels/odom}
- group:
  - push_ros_namespace: {namespace: $(var camera)}
  - let: {name: gain, value: "1"}
  - node:
      pkg: image_proc
      exec: rectify_node
      name: rectify
      args: --fast 'two words'
      remap:
      - {from: image, to: /$(var camera)/image_raw}
      param:
      - {name: queue_size, value: 5}
      - {name: scale, value: 15.0}
      - {name: frame, value: "07", type: str}
      - name: pid
        param:
        - {name: p, value: 1.5}
        - {name: i, value: 0}
  - group:
    - node: {pkg: usb_cam, exec: usb_cam_node_exe, name: driver, respawn: true, unless: $(var sim)}
- node_container:
    pkg: rclcpp_components
    exec: component_container
    name: box
    namespace: ""
    composable_node:
    - pkg: image_proc
      plugin: image_proc::ResizeNode
      name: resize
      namespace: small
      remap: [{from: image, to: image_in}]
      param: [{name: width, value: $(var gain)}]
      extra_arg: [{name: use_intra_process_comms, value: "true"}]
- load_composable_node:
    target: /box
    composable_node: [{pkg: p, plugin: "p::Late", name: late}]
- include:
    file: $(dirname)/more.launch.xml
    arg: [{name: name, value: $(var camera)_more}]
- node:
    pkg: p
    exec: q
    name: sums
    if: $(and $(not $(var sim)) $(equals $(var gain) 10))
    param: [{from: $(dirname)/params.yaml}]
"""
MORE = '<launch><arg name="name"/><node pkg="more" exec="more" name="$(var name)"/></launch>'
PARAMETERS = """\
/**: {ros__parameters: {a: 1, deep: {b: two}}}
sums: {ros__parameters: {a: 3}}
other: {ros__parameters: {a: 4}}
"""


@pytest.fixture(params=["robot.launch.xml", "robot.launch.yaml"])
def robot(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    (tmp_path / "more.launch.xml").write_text(MORE)
    (tmp_path / "params.yaml").write_text(PARAMETERS)
    file = tmp_path / str(request.param)
    file.write_text(XML if file.suffix == ".xml" else YAML)
    return file


def nodes(file: Path, **arguments: str) -> dict[str, RosNode]:
    return {node.name: node for node in ros2_launch_graph(file, arguments).nodes}


def test_both_forms_name_the_nodes_in_their_namespaces(robot: Path) -> None:
    names = ["/front/driver", "/front/rectify", "/front_more", "/late", "/small/resize", "/sums"]
    assert sorted(nodes(robot)) == names
    assert sorted(nodes(robot, sim="true", camera="rear")) == [
        "/late",
        "/rear/rectify",
        "/rear_more",
        "/small/resize",
    ]


def test_a_node_has_its_remappings_arguments_and_typed_parameters(robot: Path) -> None:
    rectify = nodes(robot)["/front/rectify"]
    assert (rectify.package, rectify.executable, rectify.arguments) == (
        "image_proc",
        "rectify_node",
        ("--fast", "two words"),
    )
    assert dict(rectify.remappings) == {"/front/image": "/front/image_raw", "/front/odom": "/wheels/odom"}
    assert rectify.shared == {"/front/odom"}
    assert rectify.parameters == {
        "use_sim_time": False,
        "queue_size": 5,
        "scale": 15.0,
        "frame": "07",
        "pid.p": 1.5,
        "pid.i": 0,
    }


def test_components_are_loaded_into_their_container_and_see_what_groups_have_left(robot: Path) -> None:
    found = nodes(robot)
    assert (found["/small/resize"].plugin, found["/small/resize"].container) == ("image_proc::ResizeNode", "/box")
    assert found["/late"].container == "/box"
    assert {found[name].container_kind for name in ("/small/resize", "/late")} == {"plain"}
    assert found["/small/resize"].parameters["width"] == 10


def test_a_file_of_parameters_counts_for_all_nodes_and_then_for_the_one(robot: Path) -> None:
    assert nodes(robot)["/sums"].parameters == {"use_sim_time": False, "a": 3, "deep.b": "two"}


def test_what_an_environment_has_no_word_for_is_told(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = robot.with_name("env.yaml")
    assert main(["import", "ros2", str(robot), "camera:=rear", "--out", str(env)]) == 0
    told = capsys.readouterr().err
    assert 'not imported: respawn="true" of /rear/driver: a run replaces every unit that dies' in told
    library = api.load(env).environment.transformation
    assert library["small/resize"].source == "component:image_proc/image_proc::ResizeNode@/box"
    assert library["rear/rectify"].params["pid.p"] == 1.5


def test_files_and_packages_that_are_not_here_and_programs_are_told(tmp_path: Path) -> None:
    file = tmp_path / "x.launch.xml"
    (tmp_path / "y.launch.py").write_text("")
    file.write_text(
        "<launch><include file='$(find-pkg-share nowhere_pkg)/a.launch.xml'/><include file='$(dirname)/y.launch.py'/>"
        "<node pkg='p' exec='q' name='n'><param from='$(dirname)/none.yaml'/></node><reset/></launch>"
    )
    found = ros2_launch_graph(file)
    assert [node.name for node in found.nodes] == ["/n"]
    assert any("since the package `nowhere_pkg` is not found" in note for note in found.notes)
    assert any("y.launch.py starts" in note and "it is a program" in note for note in found.notes)
    assert any("the parameters that" in note for note in found.notes)
    assert found.dropped == (f"<reset> at {file}:1",)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("<launch>\n<arg name='a'/></launch>", 2, "the argument `a` has no value"),
        ("<launch>\n<node exec='q' name='n'/></launch>", 2, "<node> has no `pkg`"),
        ("<launch>\n<node pkg='$(var b)' exec='q'/></launch>", 2, "the argument `b` has no value"),
        ("<launch>\n<group if='maybe'/></launch>", 2, "`if` is `maybe`"),
        ("<launch>\n<include file='/nowhere.launch.xml'/></launch>", 2, "is not there"),
        ("<launch>\n<include file='$(dirname)/x.launch.xml'/></launch>", 2, "included more than 50 deep"),
        (
            "<launch>\n<node pkg='p' exec='q' name='n'><param name='a' type='int' value='x'/></node></launch>",
            2,
            "`x` is not of type int",
        ),
        ("<launch>\n<let name='a' value=\"$(eval '__import__(1)')\"/></launch>", 2, "can't be evaluated"),
        ("<launch>\n<let name='a' value='$(command ls)'/></launch>", 2, "is not a substitution that cfgplan reads"),
        ("<launch>\n<node pkg='p' exec='q' name='n' args=\"'\"/></launch>", 2, "args"),
        (
            "<launch><node pkg='p' exec='q' name='n'/>\n<node pkg='p' exec='q' name='n'/></launch>",
            2,
            "starts a node /n",
        ),
        ("<robot/>", 1, "this is not a launch file"),
        ("launch:\n- arg: {name: a}\n", 2, "the argument `a` has no value"),
        ("launch:\n- node: {exec: q}\n", 2, "<node> has no `pkg`"),
        ("launch:\n- node: q\n", 2, "`node` is not a mapping"),
        ("launch:\n- 1\n", 2, "this is not an action of a launch file"),
        ("nodes: []\n", 1, "this is not a launch file"),
    ],
)
def test_a_fault_is_told_with_its_line_and_a_mend(tmp_path: Path, text: str, line: int, said: str) -> None:
    file = tmp_path / ("x.launch.xml" if text.startswith("<") else "x.launch.yaml")
    file.write_text(text)
    with pytest.raises(InputError) as raised:
        ros2_launch_graph(file)
    (fault,) = raised.value.faults
    assert said in fault.message
    assert (fault.file, fault.line) == (str(file), line)
    assert fault.mend


def test_a_launch_file_in_python_is_refused_with_what_to_do_instead(tmp_path: Path) -> None:
    file = tmp_path / "x.launch.py"
    file.write_text("")
    with pytest.raises(InputError, match="can't be read") as raised:
        ros2_graph([str(file)], RosGraph)
    assert "name `live`" in (raised.value.faults[0].mend or "")


@pytest.mark.parametrize("kind", ["mt", "isolated"])
def test_a_container_of_several_threads_is_asked_for_by_its_components(kind: str, robot: Path) -> None:
    robot.write_text(robot.read_text().replace("component_container", f"component_container_{kind}"))
    env = robot.with_name("env.yaml")
    assert main(["import", "ros2", str(robot), "--out", str(env)]) == 0
    library = api.load(env).environment.transformation
    assert {library[label].run.container for label in ("small/resize", "late")} == {kind}
    assert library["front/rectify"].run.container == "plain"
    assert "box" not in library, "the run starts the container by itself"


def test_a_container_of_its_own_executable_stays_a_node(robot: Path) -> None:
    robot.write_text(robot.read_text().replace("component_container", "own_container"))
    assert nodes(robot)["/box"].executable == "own_container"
    assert nodes(robot)["/late"].container_kind is None


def test_a_spawner_calls_the_services_of_its_namespace(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.xml"
    said = {"": "/", "--namespace /arm": "/arm/", "--namespace=arm/": "/arm/"}
    for arguments, space in said.items():
        file.write_text(
            f'<launch><node pkg="controller_manager" exec="spawner" name="s" args="joints {arguments}"/></launch>'
        )
        ports = guess_table().ports_of(nodes(file)["/s"])
        assert ports is not None
        calls = [f"{space}controller_manager/{each}_controller" for each in ("load", "switch", "unload")]
        assert [port.name for port in ports] == calls
