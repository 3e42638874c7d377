"""Launch files: what they say is what the configuration says.

`launch` and `launch_ros` are stubs here that keep what they are given. That proves that a file can be imported, names
only what these stubs have, and leads each topic where the configuration has it; not that ROS 2 takes it.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, List  # noqa: UP035

import pytest
from cfgplan_runtime.ros2.ros2_unit import Ros2Unit
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cfgplan.cli import main
from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.ros.launch import launch_text
from cfgplan.ros.sources import NodeSource
from cfgplan.ros.topic_names import word

ENVIRONMENT = """\
format: cfgplan/1
transformations:
  - label: camera
    source: node:usb_cam/usb_cam_node_exe --verbose 'two words'
    params:
      {device: /dev/video0, rate: 15, code: "0123", sizes: [1, 2.5], names: ["1", b], deep: {on: true}, none: ""}
    outputs:
      image: {tag: FrontImage, type: sensor_msgs/Image, remap: image_raw}
  - label: rectify
    source: component:image_proc/image_proc::RectifyNode@eyes
    params: {odd: "{x"}
    inputs: {image: {tag: FrontImage, type: sensor_msgs/Image}}
    outputs: {rectified: {tag: RectifiedFrontImage, type: sensor_msgs/Image, remap: ~image_rect}}
  - label: thinker
    source: component:brain/brain::Thinker
    inputs: {eye: RectifiedFrontImage, ear: {tag: Sound, optional: true}}
  - {label: blinker, source: node:./blinker.py, inputs: {image: RectifiedFrontImage}}
  - {label: screen, source: external:/desk/screen, inputs: {show: {tag: FrontImage, remap: picture}}}
targets:
  - {label: view, topic: /front/image_rect, tag: RectifiedFrontImage}
  - {label: blink, run: blinker}
  - {label: think, run: thinker}
  - {label: show, run: screen}
"""

Actions = list[tuple[str, dict[str, Any]]]


def actions_of(text: str, path: str = "/launches/robot.launch.py") -> Actions:
    """What a launch file does: the actions and their keyword arguments."""

    def kept(kind: str) -> Callable[..., tuple[str, dict[str, Any]]]:
        return lambda **given: (kind, given)

    def value(given: object, value_type: object) -> SimpleNamespace:
        return SimpleNamespace(value=given, type=value_type)

    stubs: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "IncludeLaunchDescription": lambda *source, **given: ("Include", {"source": source, **given})
        },
        "launch.launch_description_sources": {"AnyLaunchDescriptionSource": str},
        "launch_ros": {},
        "launch_ros.actions": {name: kept(name) for name in ("ComposableNodeContainer", "Node")},
        "launch_ros.descriptions": {"ComposableNode": lambda **given: given},
        "launch_ros.parameter_descriptions": {"ParameterValue": value},
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, things in stubs.items():
            module = ModuleType(name)
            vars(module).update(things)
            patch.setitem(sys.modules, name, module)
        names: dict[str, Any] = {"__file__": path}
        exec(compile(text, path, "exec"), names)
        found: Actions = names["generate_launch_description"]()
    return found


@pytest.fixture
def env(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(ENVIRONMENT)
    return path


def test_launch_files_are_included_before_everything_else_with_their_arguments(env: Path) -> None:
    drivers = env.parent / "more files" / "drivers.launch.py"
    drivers.parent.mkdir()
    drivers.write_text("")
    said = f"'{drivers}' sim:=true 'name:=two words' url:=a:=b"
    first, second, *others = exported(env, "--include", said, "--include", f"'{drivers}'")
    source = (str(env.parent / "launch" / ".." / "more files" / "drivers.launch.py"),)
    arguments = [("sim", "true"), ("name", "two words"), ("url", "a:=b")]
    assert first == ("Include", {"source": source, "launch_arguments": arguments})
    assert second == ("Include", {"source": source})
    assert others == exported(env)


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("nosuch.launch.py", "nosuch.launch.py: there is no such launch file to include"),
        ("robot.yaml sim=true", "`sim=true` is not an argument of a launch file"),
        ("'robot", "names no launch file"),
        (" ", "names no launch file"),
        ("", "--include: it is an empty word"),
    ],
)
def test_what_can_not_be_included_is_told(
    said: str, told: str, env: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(env.parent)
    assert main(["export", "launch", str(env), "--include", said]) == 30
    assert told in " ".join(capsys.readouterr().err.split())


def test_containers_are_of_the_kind_that_their_components_ask_for(env: Path) -> None:
    for label in ("rectify", "thinker"):
        env.write_text(env.read_text().replace(f"label: {label}\n", f"label: {label}\n    run: {{container: mt}}\n"))
    found = {said["name"]: said["executable"] for kind, said in exported(env) if kind == "ComposableNodeContainer"}
    assert found == {"eyes": "component_container_mt", "cfgplan_container_mt": "component_container_mt"}


def test_a_container_can_not_be_of_two_kinds(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    eyes = ENVIRONMENT.replace("brain::Thinker", "brain::Thinker@eyes\n    run: {container: isolated}")
    env.write_text(eyes)
    assert main(["export", "launch", str(env)]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "share the container `eyes`" in said
    assert "`thinker` asks for isolated" in said


def exported(env: Path, *options: str) -> Actions:
    out = env.parent / "launch" / "robot.launch.py"
    out.parent.mkdir(exist_ok=True)
    assert main(["export", "launch", str(env), "--out", str(out), *options]) == 0
    return actions_of(out.read_text(), str(out))


def test_a_launch_file_starts_the_nodes_of_a_plan_and_remaps_them(env: Path) -> None:
    blinker, camera, own, eyes, relay = exported(env)
    kind, given = camera
    assert (kind, given["package"], given["executable"], given["name"]) == (
        "Node",
        "usb_cam",
        "usb_cam_node_exe",
        "camera_1",
    )
    assert given["arguments"] == ["--verbose", "two words"]
    assert given["remappings"] == [("image_raw", "/camera_1/out/image")]
    (params,) = given["parameters"]
    assert {name: params[name] for name in ("device", "rate", "sizes", "deep")} == {
        "device": "/dev/video0",
        "rate": 15,
        "sizes": [1.0, 2.5],
        "deep": {"on": True},
    }
    texts = {name: (params[name].value, params[name].type) for name in ("code", "names")}
    assert texts == {"code": ("0123", str), "names": (["1", "b"], List[str])}  # noqa: UP006
    assert params["none"] == ""

    assert Path(blinker[1]["executable"]).resolve() == env.parent / "blinker.py"
    assert blinker[1]["remappings"] == [("image", "/front/image_rect")]
    assert relay[1]["arguments"] == ["/camera_1/out/image", "/desk/picture"]  # who is not started is not remapped

    assert [(kind, given["name"]) for kind, given in (own, eyes)] == [
        ("ComposableNodeContainer", "cfgplan_container"),
        ("ComposableNodeContainer", "eyes"),
    ]
    (rectify,) = eyes[1]["composable_node_descriptions"]
    assert rectify["parameters"][0]["odd"].value == "{x"
    assert (rectify["package"], rectify["plugin"]) == ("image_proc", "image_proc::RectifyNode")
    assert rectify["remappings"] == [("image", "/camera_1/out/image"), ("~/image_rect", "/front/image_rect")]
    (thinker,) = own[1]["composable_node_descriptions"]
    assert thinker["remappings"] == [("ear", "/thinker_1/in/ear"), ("eye", "/front/image_rect")]


def test_nodes_and_components_are_launched_apart(env: Path) -> None:
    assert {kind for kind, _ in exported(env, "--only", "nodes")} == {"Node"}
    assert {kind for kind, _ in exported(env, "--only", "components")} == {"ComposableNodeContainer"}


def test_a_plan_that_was_written_is_launched(env: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = env.parent / "plan.json"
    assert main(["solve", str(env), "--out", str(plan)]) == 0
    assert exported(env, "--plan", str(plan)) == exported(env)
    env.write_text(ENVIRONMENT.replace("rate: 15", "rate: 30") + "  - {label: raw, topic: /raw, tag: FrontImage}\n")
    assert main(["export", "launch", str(env), "--plan", str(plan)]) == 30
    assert "plan.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("node:./blinker.py", "units.py:blink", "blinker.1: `units.py:blink` is not a node of ROS 2"),
        ("component:brain/brain::Thinker", "nodelet:brain/Thinker", "is not a node of ROS 2"),
        ("rate: 15", "rate: null", "camera: param rate can't be one of a ROS 2 node: None"),
        ("rate: 15", "rate: [1, a]", "camera: param rate can't be one of a ROS 2 node: [1, 'a']"),
        ("rate: 15", "deeper: {rate: []}", "camera: param deeper.rate can't be one of a ROS 2 node: []"),
        ("ear: {tag: Sound, optional: true}", "ear: {tag: FrontImage, remap: eye}", "two ports are 'eye' to the node"),
    ],
)
def test_what_a_launch_file_cannot_say_is_told(
    env: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace(old, new))
    assert main(["export", "launch", str(env)]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert told in said
    assert f"error: {env}" in said


def test_a_launch_file_is_for_one_host() -> None:
    nodes = [("here", "node:talk/talker", (), ("word",)), ("there", "node:talk/listener", ("word",), ())]
    library = tuple(
        Transformation(
            name,
            tuple(InputPort(port, "Word") for port in takes),
            tuple(OutputPort(port, "Word") for port in gives),
            source=source,
            hosts=(name,),
        )
        for name, source, takes, gives in nodes
    )
    heard = (Subscription("word", Stream("here.1", "word")),)
    units = (ComputationUnit("here.1", "here", host="here"), ComputationUnit("there.1", "there", heard, host="there"))
    environment = Environment(units, library, hosts=(Host("here"), Host("there")))
    ((_, given),) = actions_of(launch_text(environment, host="there"))
    assert (given["name"], given["remappings"]) == ("there_1", [("word", "/here_1/out/word")])
    with pytest.raises(InputError, match="a launch file is for one host"):
        launch_text(environment)
    with pytest.raises(InputError, match="there is no host `nowhere`"):
        launch_text(environment, host="nowhere")


def test_two_units_of_one_name_are_told() -> None:
    library = tuple(Transformation(label, source="node:talk/talker") for label in ("a.b", "a_b"))
    units = tuple(ComputationUnit(f"{each.label}.1", each.label) for each in library)
    with pytest.raises(InputError, match="would both be the node /a_b_1"):
        launch_text(Environment(units, library))


@st.composite
def configurations(draw: st.DrawFn) -> Environment:
    """Some units with ports of names that nobody else has; inputs take any outputs, which are on any topics."""
    ports = (f"p{number}" for number in range(1000))
    types = st.sampled_from([None, "std_msgs/String", "a/action/B"])
    kinds = st.sampled_from(["node:a/b", "component:a/b::C", "external:/x{}", "external:/far/x{}"])
    library = []
    for number in range(draw(st.integers(1, 5))):
        takes, gives = draw(st.integers(0, 2)), draw(st.integers(0, 2))
        library.append(
            Transformation(
                f"t{number}",
                tuple(InputPort(next(ports), "T", count=ALL, type=draw(types)) for _ in range(takes)),
                tuple(OutputPort(next(ports), "T", remap=f"~q{next(ports)}", type=draw(types)) for _ in range(gives)),
                source=draw(kinds).format(number),
            )
        )
    streams = [Stream(f"{each.label}.1", port.name) for each in library for port in each.outputs]
    topics = iter(f"/topic{number}" for number in range(1000))
    some = st.lists(st.sampled_from(streams), max_size=3, unique=True) if streams else st.just([])
    units = []
    for each in library:
        heard = tuple(Subscription(port.name, stream) for port in each.inputs for stream in draw(some))
        count = st.integers(0, 2)
        told = tuple(Publication(port.name, next(topics)) for port in each.outputs for _ in range(draw(count)))
        units.append(ComputationUnit(f"{each.label}.1", each.label, heard, told))
    return Environment(tuple(units), tuple(library))


def full(name: str, node: str) -> str:
    """A name as ROS 2 resolves it at a node."""
    if name.startswith("~"):
        return f"{node}/{name[1:].lstrip('/')}"
    return name if name.startswith("/") else f"{node.rpartition('/')[0]}/{name}"


@settings(max_examples=150, deadline=None)
@given(configurations())
def test_inputs_hear_just_what_feeds_them_and_topics_have_just_their_stream(environment: Environment) -> None:
    remapped: dict[str, dict[str, str]] = {}
    passed_on = defaultdict[str, set[str]](set)
    try:
        actions = actions_of(launch_text(environment))
    except InputError as error:
        assert "nothing to launch" in str(error)
        assert all("external" in str(each.source) for each in environment.library)
        return
    for kind, said in actions:
        inside = said["composable_node_descriptions"] if kind == "ComposableNodeContainer" else [said]
        for each in inside:
            if each["package"] == "topic_tools":
                source, target = each["arguments"]
                passed_on[source].add(target)
            else:
                remapped[f"/{each['name']}"] = dict(each.get("remappings", []))

    comes = defaultdict[str, set[Stream]](set)
    hears = {}
    for unit in environment.units:
        transformation = environment.transformation[unit.transformation]
        foreign = str(transformation.source).startswith("external")
        node = str(transformation.source).removeprefix("external:") if foreign else f"/{unit.id.replace('.', '_')}"
        led = {} if foreign else {full(own, node): name for own, name in remapped[node].items()}
        for output in transformation.outputs:
            name = full(output.remap or output.name, node)
            ahead, seen = [led.get(name, name)], set[str]()
            while ahead:
                seen.add(topic := ahead.pop())
                comes[topic].add(Stream(unit.id, output.name))
                ahead += passed_on[topic] - seen
        for taken in transformation.inputs:
            name = full(taken.name, node)
            hears[unit.id, taken.name] = led.get(name, name)
    for unit in environment.units:
        for port in environment.transformation[unit.transformation].inputs:
            assert comes[hears[unit.id, port.name]] == {*unit.feeds.get(port.name, ())}
        for published in unit.publications:
            assert comes[published.topic] == {Stream(unit.id, published.port)}


@settings(max_examples=100, deadline=None)
@given(configurations())
def test_a_launch_file_and_a_run_name_nodes_their_ports_and_free_topics_the_same(environment: Environment) -> None:
    """A run leads inputs and topics of targets by relays; what is left has one name in both."""
    sources = [NodeSource.read(environment.transformation[unit.transformation].source) for unit in environment.units]
    assume(any(source is not None and source.kind != "external" for source in sources))
    launched = {given["name"]: given for kind, given in actions_of(launch_text(environment)) if kind == "Node"}
    labelled = environment.transformation
    shared = shared_outputs(environment)
    for unit in environment.units:
        transformation = labelled[unit.transformation]
        source = NodeSource.read(transformation.source)
        if source is None or source.kind != "node":
            continue
        arguments = Ros2Unit(f"/{word(unit.id)}", source, transformation).arguments(Path("unused"))
        said = dict(part.split(":=", 1) for part in arguments[2::2])
        node = launched[said.pop("__node")]
        assert said.pop("__ns") == f"/{node.get('namespace', '')}"
        remapped = dict(node.get("remappings", []))
        assert remapped.keys() == said.keys()
        published = {publication.port for publication in unit.publications}
        for port in transformation.outputs:
            own = (port.remap or port.name).replace("~", "~/")
            if port.name not in published and (unit.id, port.name) not in shared:
                assert remapped[own] == said[own]


def shared_outputs(environment: Environment) -> set[tuple[str, str]]:
    """The outputs that feed an input together with others: in a launch file they may have one topic."""
    fed = [unit.feeds.get(port, ()) for unit in environment.units for port in unit.feeds]
    return {(stream.unit, stream.port) for streams in fed if len(streams) > 1 for stream in streams}
