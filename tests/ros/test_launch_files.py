"""Launch files of ROS 1: what they start is what roslaunch would start, and what they don't say is told."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_graphs import graph, node, read_back

from cfgplan import api
from cfgplan.cli import main
from cfgplan.errors import InputError
from cfgplan.ros.graph import Role, RosNode, RosPort, merged, resolved
from cfgplan.ros.launch_files import launch_graph
from cfgplan.ros.origins import ros1_graph
from cfgplan.ros.sources import NodeSource

ANONYMOUS = re.compile(r"_[\w.-]+_\d+_\d+$")
"""What roslaunch puts behind an anonymous name: host, process and time."""
ORACLE = Path(__file__).with_name("roslaunch_oracle.py")
PYTHON = "/usr/bin/python3"
ROBOT = """\
<launch>
  <arg name="robot" default="spot"/>
  <arg name="sim" default="false"/>
  <arg name="rate" value="$(eval 2 * 5 if robot == 'spot' else 1)"/>
  <param name="robot_description" value="a box"/>
  <param name="/$(arg robot)/mover/max_speed" value="1.5"/>
  <remap from="tf_old" to="tf"/>
  <group ns="$(arg robot)">
    <remap from="scan" to="base_scan"/>
    <param name="~quiet" value="true"/>
    <node pkg="hokuyo" type="hokuyo_node" name="lidar" unless="$(arg sim)" args="--fast 'two words' odom:=wheels/odom">
      <param name="rate" value="$(arg rate)"/>
      <param name="frame" value="laser"/>
      <param name="port" value="0101" type="str"/>
      <rosparam>{offsets: {x: 1, y: 2.5}, names: [a, b]}</rosparam>
      <rosparam param="more">[1, 2]</rosparam>
      <rosparam>
        begins_indented: 1
        and_goes_on: true  # with a comment
      </rosparam>
      <remap from="scan" to="/raw_scan"/>
      <remap from="~status" to="status"/>
    </node>
    <node pkg="gazebo" type="gzserver" name="simulator" if="$(arg sim)"/>
    <group if="$(eval arg('robot') == 'spot' and not sim)">
      <node pkg="legs" type="walk.py" name="$(anon walker)" ns="legs"/>
    </group>
    <node pkg="move_base" type="move_base" name="mover">
      <rosparam ns="costs">{a: 1, deep: {b: 2}}</rosparam>
      <rosparam ns="costs">{deep: {c: 3}}</rosparam>
    </node>
  </group>
  <rosparam file="$(dirname)/more.yaml" ns="$(arg robot)" subst_value="true"/>
  <node pkg="nodelet" type="nodelet" name="eyes" args="manager"/>
  <node pkg="nodelet" type="nodelet" name="rect" args="load image_proc/rectify eyes --no-bond image_mono:=mono"/>
  <include file="$(dirname)/more.xml" ns="upper">
    <arg name="robot" value="$(arg robot)"/>
  </include>
</launch>
"""
MORE = """\
<launch>
  <arg name="robot"/>
  <arg name="unused" default=""/>
  <rosparam command="load" file="$(dirname)/more.yaml" ns="$(arg robot)" subst_value="true"/>
  <node pkg="topic_tools" type="relay" name="echo" args="in out" output="screen"/>
</launch>
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    (tmp_path / "more.xml").write_text(MORE)
    (tmp_path / "more.yaml").write_text("gain: 3\nname: $(arg robot)\nmover: {limits: {x: 1, y: 2}}\n")
    (tmp_path / "robot.launch").write_text(ROBOT)
    return tmp_path / "robot.launch"


@pytest.fixture(scope="session")
def ros() -> None:
    command = [PYTHON, "-c", "import roslaunch"]
    if not Path(PYTHON).exists() or subprocess.run(command, env={}, capture_output=True, check=False).returncode:
        pytest.skip("ROS 1 (roslaunch) is not installed on this computer")


Roslaunch = Callable[[Path, Mapping[str, str]], dict[str, tuple[object, ...]]]


@pytest.fixture(scope="module")
def of_roslaunch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Roslaunch]:
    """Asks roslaunch what it would start: package, type, arguments, remappings, private parameters by node."""
    folder = str(tmp_path_factory.mktemp("roslaunch"))
    environment = {"PATH": "/usr/bin:/bin", "HOME": folder, "ROS_LOG_DIR": folder}
    pipe = subprocess.PIPE
    with subprocess.Popen([PYTHON, ORACLE], env=environment, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin
        assert process.stdout

        def ask(file: Path, arguments: Mapping[str, str]) -> dict[str, tuple[object, ...]]:
            given = [f"{name}:={value}" for name, value in arguments.items()]
            process.stdin.write(json.dumps([str(file), *given]) + "\n")  # type: ignore[union-attr]
            process.stdin.flush()  # type: ignore[union-attr]
            lines = iter(process.stdout.readline, "")  # type: ignore[union-attr]
            return _started(json.loads(next(line for line in lines if line.startswith("{"))))

        yield ask


def _started(told: Mapping[str, Any]) -> dict[str, tuple[object, ...]]:
    found: dict[str, tuple[object, ...]] = {}
    for each in told["nodes"]:
        name, namespace = each["name"], each["name"].rpartition("/")[0]
        words = shlex.split(each["args"])
        pairs = [*each["remaps"], *(word.split(":=") for word in words if ":=" in word)]
        full = {resolved(a, namespace, name): resolved(b, namespace, name) for a, b in pairs}
        remaps = {a: b for a, b in full.items() if a != b}
        private = {key[len(name) + 1 :]: value for key, value in told["params"].items() if key.startswith(f"{name}/")}
        words = [word.strip("/") if at == 2 and words[0] == "load" else word for at, word in enumerate(words)]
        found[ANONYMOUS.sub("", name)] = (
            each["package"],
            each["type"],
            [w for w in words if ":=" not in w],
            remaps,
            flat(private),
        )
    return found


def flat(values: Mapping[str, object], above: str = "") -> dict[str, object]:
    """Parameters by their whole names."""
    found: dict[str, object] = {}
    for key, value in values.items():
        found |= flat(value, f"{above}{key}/") if isinstance(value, dict) else {f"{above}{key}": value}
    return found


def ours(file: Path, arguments: Mapping[str, str]) -> dict[str, tuple[object, ...]]:
    found: dict[str, tuple[object, ...]] = {}
    for each in launch_graph(file, arguments).nodes:
        package, kind, words = each.package, each.executable, [*each.arguments]
        if each.plugin is not None:
            package = kind = "nodelet"
            words = ["load", each.plugin, (each.container or "").strip("/"), *words]
        found[each.name] = package, kind, words, dict(each.remappings), flat(each.parameters)
    return found


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize("arguments", [{}, {"sim": "true"}, {"robot": "husky", "sim": "1"}])
def test_what_is_started_is_what_roslaunch_starts(
    robot: Path, arguments: dict[str, str], of_roslaunch: Roslaunch
) -> None:
    assert ours(robot, arguments) == of_roslaunch(robot, arguments)


NAMES = st.sampled_from(["a", "b", "/c", "d/e"])
OWN_NAMES = st.sampled_from(["x", "/y", "~z", "w/v"])


@st.composite
def elements(draw: st.DrawFn, depth: int = 3) -> str:
    """Some elements of a launch file, those of one depth after the other."""
    kinds = ["remap", "private", "node", "node", "shared"] + (["group"] if depth else [])
    found = []
    for kind in draw(st.lists(st.sampled_from(kinds), max_size=4)):
        if kind == "group":
            space = draw(
                st.sampled_from(["", ' ns="g"', ' ns="/h"', ' ns="i/j"', ' if="$(arg yes)"', ' if="$(arg no)"'])
            )
            found.append(f"<group{space}>{draw(elements(depth - 1))}</group>")
        elif kind == "remap":
            found.append(f'<remap from="{draw(OWN_NAMES)}" to="{draw(OWN_NAMES)}"/>')
        elif kind == "private":
            found.append(f'<param name="~{draw(st.sampled_from("pq"))}" value="{draw(st.integers(0, 9))}"/>')
        elif kind == "shared":
            found.append(f'<rosparam ns="{draw(NAMES)}">{{k: {draw(st.integers(0, 9))}}}</rosparam>')
        else:
            space = draw(st.sampled_from(["", ' ns="n"', ' ns="/m"']))
            value = draw(st.sampled_from(["1", "true", "x", "1.5"]))
            remap = f'<remap from="{draw(OWN_NAMES)}" to="t"/>'
            inside = f'{remap}<param name="r" value="{value}"/>'
            found.append(f'<node pkg="p" type="t" name="UNIQUE"{space} args="u:=v 1">{inside}</node>')
    return "".join(found)


@pytest.mark.usefixtures("ros")
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(elements())
def test_namespaces_remappings_and_parameters_are_those_of_roslaunch(
    tmp_path_factory: pytest.TempPathFactory, of_roslaunch: Roslaunch, text: str
) -> None:
    parts = text.split("UNIQUE")
    numbered = "".join(f"{part}n{at}" for at, part in enumerate(parts[:-1])) + parts[-1]
    file = tmp_path_factory.mktemp("launch") / "any.launch"
    file.write_text(f'<launch><arg name="yes" value="true"/><arg name="no" value="0"/>{numbered}</launch>')
    assert ours(file, {}) == of_roslaunch(file, {})


def test_the_table_knows_ports_of_well_known_nodes_and_the_others_are_told(
    robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = robot.with_suffix(".yaml")
    assert main(["import", "ros1", str(robot), "--out", str(env)]) == 0
    told = capsys.readouterr()
    assert "which ports /eyes, /spot/legs/walker, /spot/lidar have" in told.err
    assert "has the ports of image_proc/rectify" in told.out
    library = api.load(env).environment.transformation
    rect, mover, echo = library["rect"], library["spot/mover"], library["upper/echo"]
    assert rect.source == "nodelet:image_proc/rectify@/eyes --no-bond"
    assert {port.remap: port.tag for port in rect.inputs} == {
        "image_mono": "sensor_msgs-Image and mono",
        "camera_info": "sensor_msgs-CameraInfo and camera_info",
    }
    assert NodeSource.read(mover.source) == NodeSource("node", "move_base", "move_base")
    assert "spot-base_scan" in mover.input["base_scan"].tag
    assert mover.params["max_speed"] == 1.5
    assert ([port.tag for port in echo.inputs], [port.tag for port in echo.outputs]) == (["upper-in"], ["upper-out"])


def test_a_file_of_guesses_says_the_ports_of_ones_own_nodes(robot: Path) -> None:
    guesses = robot.with_name("guesses.yaml")
    guesses.write_text("nodes: {legs/walk.py: {subscribes: {cmd_vel: geometry_msgs/Twist}, publishes: {~gait: null}}}")
    env = robot.with_suffix(".yaml")
    assert main(["import", "ros1", str(robot), "--guesses", str(guesses), "--out", str(env)]) == 0
    walker = api.load(env).environment.transformation["spot/legs/walker"]
    assert [port.tag for port in walker.inputs] == ["geometry_msgs-Twist and spot-legs-cmd_vel"]
    assert [port.remap for port in walker.outputs] == ["~gait"]


def test_a_live_graph_beside_it_knows_the_ports_and_the_launch_file_the_rest(robot: Path) -> None:
    live = graph(node("/spot/lidar", {"/raw_scan": "sensor_msgs/LaserScan"}))
    (lidar,) = [each for each in merged([live, launch_graph(robot)]).nodes if each.name == "/spot/lidar"]
    assert (lidar.package, lidar.executable, lidar.names(Role.PUBLISHES)) == ("hokuyo", "hokuyo_node", ["/raw_scan"])


def test_arguments_are_passed_on_the_command_line(robot: Path) -> None:
    assert "/husky/simulator" in {each.name for each in ros1_graph([str(robot), "robot:=husky", "sim:=true"]).nodes}


def test_packages_are_found_in_the_workspace_and_the_missing_ones_are_told(tmp_path: Path) -> None:
    own, other = tmp_path / "src" / "own" / "launch", tmp_path / "src" / "stack" / "other"
    own.mkdir(parents=True)
    other.mkdir(parents=True)
    (own.parent / "package.xml").write_text("<package><name>own</name></package>")
    (other / "package.xml").write_text("<package><name>other_pkg</name></package>")
    (other / "a.launch").write_text('<launch><node pkg="p" type="t" name="n"/></launch>')
    file = own / "main.launch"
    file.write_text(
        '<launch>\n<include file="$(find other_pkg)/a.launch"/>\n<include file="$(find nowhere_pkg)/b.launch"/>\n'
        '<param name="model" command="$(find xacro)/xacro robot.xacro"/></launch>'
    )
    found = launch_graph(file)
    assert [each.name for each in found.nodes] == ["/n"]
    assert any(f"what {file}:3 includes, since the package `nowhere_pkg` is not found" in note for note in found.notes)
    assert any("the value of model" in note and "by a command" in note for note in found.notes)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("<launch>\n<arg name='a'/></launch>", 2, "the argument `a` has no value"),
        ("<launch>\n\n<node name='n' type='t'/></launch>", 3, "<node> has no `pkg`"),
        ("<launch>\n<node pkg='$(arg b)' type='t' name='n'/></launch>", 2, "the argument `b` has no value"),
        ("<launch>\n<group if='maybe'/></launch>", 2, "`if` is `maybe`"),
        ("<launch>\n<include file='/nowhere.launch'/></launch>", 2, "is not there"),
        ("<launch>\n<include file='$(dirname)/x.launch'/></launch>", 2, "included more than 50 deep"),
        ("<launch>\n<param name='p' type='int' value='x'/></launch>", 2, "`x` is not of type int"),
        ("<launch>\n<param name='p' value='$(eval __import__(1))'/></launch>", 2, "can't be evaluated"),
        ("<launch>\n<param name='p' value='$(now)'/></launch>", 2, "is not a substitution"),
        ("<launch>\n<rosparam>[</rosparam></launch>", 2, "is not YAML"),
        ("<launch>\n<node pkg='p' type='t' name='n' args=\"'\"/></launch>", 2, "args"),
        ("<robot/>", 1, "this is not a launch file"),
        ("<launch>", 1, "this is not XML"),
    ],
)
def test_a_fault_in_a_launch_file_is_told_with_its_line_and_a_mend(
    tmp_path: Path, text: str, line: int, said: str
) -> None:
    file = tmp_path / "x.launch"
    file.write_text(text)
    with pytest.raises(InputError) as raised:
        launch_graph(file)
    (fault,) = raised.value.faults
    assert said in fault.message
    assert (fault.file, fault.line) == (str(file), line)
    assert fault.mend


def test_a_node_whose_ports_are_known_keeps_them(tmp_path: Path) -> None:
    amcl = RosNode("/amcl", (RosPort(Role.SUBSCRIBES, "/scan"),), "amcl", "amcl")
    (port,) = read_back(graph(amcl), tmp_path).environment.transformation["amcl"].inputs
    assert port.remap == "scan"


def test_a_text_with_line_ends_of_windows_is_what_roslaunch_makes_of_it(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_bytes(b"<robot>\r\n</robot>\r\n")
    file = tmp_path / "file.launch"
    file.write_text(
        '<launch><node name="a" pkg="p" type="t"><param name="text" textfile="$(dirname)/robot.urdf"/></node></launch>'
    )
    (one,) = launch_graph(file).nodes
    assert one.parameters == {"text": "<robot>\n</robot>\n"}


def test_an_argument_that_is_passed_but_not_declared_is_known_in_the_first_file_only(tmp_path: Path) -> None:
    (tmp_path / "inner.launch").write_text("<launch><node pkg='p' type='t' name='n' args='$(arg bag)'/></launch>")
    file = tmp_path / "play.launch"
    file.write_text("<launch><node pkg='rosbag' type='play' name='play' args='--clock $(arg bag)'/></launch>")
    (play,) = launch_graph(file, {"bag": "/x.bag"}).nodes
    assert play.arguments == ("--clock", "/x.bag")
    file.write_text(f"<launch><include file='{tmp_path}/inner.launch'/></launch>")
    with pytest.raises(InputError, match="the argument `bag` has no value"):
        launch_graph(file, {"bag": "/x.bag"})


def test_two_nodes_of_one_name_are_refused_with_both_places_as_roslaunch_does(tmp_path: Path) -> None:
    file = tmp_path / "x.launch"
    file.write_text("<launch>\n<node pkg='p' type='t' name='cam'/>\n<node pkg='q' type='u' name='cam'/></launch>")
    with pytest.raises(InputError) as raised:
        launch_graph(file)
    (fault,) = raised.value.faults
    assert fault.line == 3
    assert f"{file}:2 starts a node /cam too" in fault.message


def test_a_machine_is_a_host_and_how_else_a_node_is_started_is_told(tmp_path: Path) -> None:
    file = tmp_path / "x.launch"
    file.write_text(
        "<launch><machine name='far' address='10.0.0.2'/><machine name='near' address='localhost'/>"
        "<node pkg='p' type='t' name='a' machine='far' respawn='true' required='false'/>"
        "<node pkg='p' type='t' name='b' machine='near' required='true' launch-prefix='nice -n 5'/>"
        "<node pkg='p' type='t' name='c'/><test test-name='x' pkg='a' type='b'/></launch>"
    )
    found = launch_graph(file)
    assert [text.partition(":")[0] for text in found.dropped] == [
        'respawn="true" of /a',
        'required="true" of /b',
        'launch-prefix="nice -n 5" of /b',
        f"the test at {file}",
    ]
    environment = read_back(found, tmp_path).environment
    assert [host.name for host in environment.hosts] == ["far", "local"]
    assert {unit.id: unit.host for unit in environment.units} == {"a.1": "far", "b.1": "local", "c.1": "local"}


def test_a_standalone_nodelet_has_the_ports_of_its_plugin(tmp_path: Path) -> None:
    file, env = tmp_path / "x.launch", tmp_path / "x.yaml"
    file.write_text(
        "<launch><node pkg='nodelet' type='nodelet' name='rect' args='standalone image_proc/rectify -x'/></launch>"
    )
    assert main(["import", "ros1", str(file), "--out", str(env)]) == 0
    rect = api.load(env).environment.transformation["rect"]
    assert rect.source == "nodelet:image_proc/rectify -x"
    assert [port.remap for port in rect.inputs] == ["camera_info", "image_mono"]


REMAPPED = """\
<launch>
  <remap from="nobody" to="/cares"/>
  <node name="rect" pkg="nodelet" type="nodelet" args="standalone image_proc/rectify">
    <remap from="{said}" to="/cam/image_raw"/>
  </node>
  <node name="cam" pkg="usb_cam" type="usb_cam_node"/>
</launch>
"""


@pytest.mark.parametrize(
    ("said", "first"),
    [
        (
            "image",
            "rect.1 is to call `image` `/cam/image_raw`, but its code has no `image`: did you mean `image_mono`?",
        ),
        ("foo", "but its code has no `foo`: it has camera_info, image_mono, image_rect"),
        ("image_mono", None),
    ],
)
def test_a_remapping_of_no_topic_of_the_node_is_what_check_names_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], said: str, first: str | None
) -> None:
    file, env = tmp_path / "x.launch", tmp_path / "x.yaml"
    file.write_text(REMAPPED.format(said=said))
    assert main(["import", "ros1", str(file), "--out", str(env)]) == 0
    capsys.readouterr()
    assert main(["check", str(env)]) == 1
    lines = capsys.readouterr().out.splitlines()
    if first is None:
        assert not any(": remap: " in line for line in lines)
    else:
        assert first in lines[0]
        assert sum(": remap: " in line for line in lines) == 1
