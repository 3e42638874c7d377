"""Wrong wirings of ROS nodes are found: the probable fault is told first, with the streams that come near."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_graphs import Ports, faults, graph, node, read_back, written

from cfgplan import api
from cfgplan.cli import main
from cfgplan.domain import Stream
from cfgplan.explaining import Suspicion, WiringFault
from cfgplan.ros.environments import imported
from cfgplan.ros.graph import RosGraph, RosNode, merged
from cfgplan.ros.guesses import guess_table
from cfgplan.validity import violations

SCAN, ODOM, TWIST, IMU = "sensor_msgs/LaserScan", "nav_msgs/Odometry", "geometry_msgs/Twist", "sensor_msgs/Imu"


def robot(lidar: Ports, mover: Ports, *more: RosNode) -> RosGraph:
    """A robot whose lidar publishes and whose mover takes what is said."""
    return graph(
        node("/lidar", lidar),
        node("/base", {"/odom": ODOM, "/imu": IMU}, {"/cmd_vel": TWIST}),
        node("/mover", {"/cmd_vel": TWIST}, {**mover, "/odom": ODOM}),
        *more,
    )


SOUND = robot({"/scan": SCAN}, {"/scan": SCAN})


def first(whole: RosGraph, folder: Path) -> WiringFault:
    return faults(whole, folder)[0]


@pytest.mark.parametrize("wrong", ["/scna", "/robot1/scan", "/base_scan", "/scan_filtered", "/laser"])
def test_a_wrong_name_is_told_with_the_stream_that_was_meant(tmp_path: Path, wrong: str) -> None:
    noisy = robot(
        {"/scan": SCAN, "/front/image": "sensor_msgs/Image"},
        {wrong: SCAN},
        node("/recorder", {}, {"/status": "std_msgs/String", "/battery": "sensor_msgs/BatteryState"}),
    )
    fault = first(noisy, tmp_path)
    assert (fault.suspicion, fault.unit) == (Suspicion.PAIR, "mover.1")
    (near,) = fault.near
    assert near.stream == Stream("lidar.1", "scan")
    assert not near.is_taken
    assert near.verdict.endswith("lacks " + wrong.strip("/").replace("/", "-") + "; nothing subscribes to it")


def test_of_two_that_come_near_the_one_that_nobody_takes_is_told_first(tmp_path: Path) -> None:
    twice = robot({"/scan": SCAN, "/rear_scan": SCAN}, {"/scan": SCAN}, node("/safety", {}, {"/scann": SCAN}))
    fault = first(twice, tmp_path)
    assert fault.unit == "safety.1"
    assert [(str(near.stream), near.is_taken) for near in fault.near] == [
        ("lidar.1/rear_scan", False),
        ("lidar.1/scan", True),
    ]


def looked_at(whole: RosGraph, *stopped: str) -> RosGraph:
    """A graph of which somebody looked what runs: all nodes but some."""
    return replace(whole, nodes=tuple(replace(each, runs=each.name not in stopped) for each in whole.nodes))


def test_what_does_not_run_comes_first_and_a_plan_starts_it(tmp_path: Path) -> None:
    clash = node("/other", {}, {"/odom": IMU})
    dead = looked_at(merged([SOUND, graph(clash)]), "/lidar")
    one, other = [fault for fault in faults(dead, tmp_path) if fault.violation]
    assert (one.suspicion, one.unit, one.port) == (Suspicion.STOPPED, "mover.1", "scan")
    assert [(str(near.stream), near.verdict) for near in one.near] == [
        ("lidar/scan", "sensor_msgs-LaserScan and scan: would match, but does not run")
    ]
    assert other.suspicion is Suspicion.CLASH

    change = api.plan(api.match(read_back(looked_at(SOUND, "/lidar"), tmp_path))).change_set
    assert change is not None
    assert [unit.transformation for unit in change.started] == ["lidar"]
    assert [unit.id for unit in change.rewired] == ["mover.1"]


def test_a_node_that_nobody_needs_is_wanted_though_it_does_not_run(tmp_path: Path) -> None:
    world = read_back(looked_at(SOUND, "/base", "/mover"), tmp_path)
    assert [target.run for target in world.environment.targets] == ["base"]
    assert [unit.id for unit in world.environment.units] == ["lidar.1"]


def test_what_is_launched_but_not_seen_to_run_does_not() -> None:
    launched = graph(RosNode("/lidar", (), "hokuyo", "hokuyo_node"), RosNode("/mover", (), "move_base", "move_base"))
    live = looked_at(graph(node("/lidar", {"/scan": SCAN})))
    for order in ([launched, live], [live, launched]):
        assert {each.name: (each.package, each.runs) for each in merged(order).nodes} == {
            "/lidar": ("hokuyo", True),
            "/mover": ("move_base", False),
        }
    assert {each.runs for each in merged([launched]).nodes} == {None}


def test_a_clash_of_types_comes_before_an_input_that_nobody_feeds(tmp_path: Path) -> None:
    clash = robot({"/scan": "sensor_msgs/PointCloud2"}, {"/scan": SCAN, "/goal": "my_msgs/Goal"})
    one, other = [fault for fault in faults(clash, tmp_path) if fault.violation]
    assert (one.suspicion, one.unit, one.port) == (Suspicion.CLASH, "mover.1", "scan")
    assert "needs sensor_msgs-LaserScan and scan, but lidar.1/scan gives sensor_msgs-PointCloud2 and scan" in one.text
    assert (other.suspicion, other.port, other.near) == (Suspicion.ALONE, "goal", ())


def test_all_that_publish_where_one_is_meant_are_named(tmp_path: Path) -> None:
    twice = robot({"/scan": SCAN}, {"/scan": SCAN}, node("/joystick", {"/cmd_vel": TWIST}))
    fault = first(twice, tmp_path)
    assert fault.suspicion is Suspicion.NUMBER
    assert fault.text.endswith("takes one stream, but has 2: joystick.1/cmd_vel, mover.1/cmd_vel")


def test_another_type_under_nearly_the_same_name_is_told(tmp_path: Path) -> None:
    fault = first(
        graph(
            node("/map", {"/map_info/vector": "map_msgs/VectorArray"}),
            node("/lanes", {}, {"/map_info/vector_class": "map_msgs/VectorClassArray"}),
        ),
        tmp_path,
    )
    assert fault.suspicion is Suspicion.NAMESAKE
    assert fault.near[0].stream == Stream("map.1", "vector")


def test_an_optional_input_is_told_only_where_a_stream_of_its_kind_is_left(tmp_path: Path) -> None:
    joy = "sensor_msgs/Joy"
    alone = robot({"/scan": SCAN}, {"/scan": SCAN, "/joy": joy})
    assert all(fault.suspicion is Suspicion.UNTAKEN for fault in faults(alone, tmp_path))
    fault = first(replace(alone, nodes=(*alone.nodes, node("/pad", {"/pad/joy": joy}))), tmp_path)
    assert (fault.suspicion, fault.rule, fault.violation) == (Suspicion.PERHAPS, "unfed", None)
    assert fault.text == "optional input joy of unit mover.1 is not fed"


def test_streams_that_nobody_takes_come_last_and_services_are_none_of_them(tmp_path: Path) -> None:
    serving = robot({"/scan": SCAN}, {"/scan": SCAN}, node("/map", {}, {}, {"/reload": "std_srvs/Empty"}))
    assert [fault.text for fault in faults(serving, tmp_path)] == ["base.1/imu has no subscriber"]


NAMES = st.sampled_from(["/scan", "/odom", "/cmd_vel", "/left/image", "/right/image", "/map"])
TYPES = st.sampled_from([SCAN, ODOM, "my_msgs/Thing"])


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(NAMES, TYPES, min_size=1), st.data())
def test_whatever_is_renamed_is_told_first_in_a_graph_that_is_else_sound(
    ends: dict[str, str], data: st.DataObject
) -> None:
    wrong = data.draw(st.sampled_from(sorted(ends)))
    takes = {f"{name}_new" if name == wrong else name: kind for name, kind in ends.items()}
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as folder:
        patch.setenv("XDG_CACHE_HOME", folder)
        fault = first(graph(node("/giver", ends), node("/taker", {}, takes)), Path(folder))
    assert fault.suspicion is Suspicion.PAIR
    assert fault.near[0].stream.port == wrong.strip("/").rpartition("/")[2] or "." in fault.near[0].stream.port


def _file(whole: RosGraph, folder: Path) -> Path:
    folder.mkdir()
    return written(imported(whole, guess_table()), folder)


def test_against_the_graph_before_a_change_only_what_is_new_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old_fault = node("/logger", {}, {"/nowhere": "my_msgs/Thing"})
    before = _file(robot({"/scan": SCAN}, {"/scan": SCAN}, old_fault), tmp_path / "before")
    after = _file(robot({"/scan": SCAN}, {"/scan_raw": SCAN}, old_fault), tmp_path / "after")

    assert main(["check", str(after), "--against", str(before)]) == 1
    out = capsys.readouterr().out
    assert "fed: input scan_raw of unit mover.1 is not connected\n" in out
    assert "\n    nearest: lidar.1/scan gives" in out
    assert "nowhere" not in out
    assert f"violates 1 rule that held in {before}." in out

    assert main(["check", str(before), "--against", str(after)]) == 0
    assert f"violates no rule that held in {after}; 1 fault is mended." in capsys.readouterr().out

    assert main(["check", str(after), "--against", str(before), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert [violation["port"] for violation in document["violations"]] == ["scan_raw"]
    assert document["violations"][0]["nearest"] == [
        {"stream": "lidar.1/scan", "offered": "sensor_msgs-LaserScan and scan", "missing": ["scan_raw"], "taken": False}
    ]
    assert (document["against"], document["gone"], document["untaken"]) == (str(before), 0, [])


def test_a_sound_graph_has_nothing_new_against_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = _file(SOUND, tmp_path / "robot")
    assert main(["check", str(file), "--against", str(file)]) == 0
    assert "without a subscriber" not in capsys.readouterr().out
    assert main(["check", str(file)]) == 0
    assert "1 stream without a subscriber: base.1/imu" in capsys.readouterr().out


def test_a_file_to_compare_with_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = _file(SOUND, tmp_path / "robot")
    assert main(["check", str(file), "--against", str(tmp_path / "gone.yaml")]) == 30
    assert "gone.yaml" in capsys.readouterr().err


def test_faults_of_a_large_graph_are_found_in_seconds_and_are_the_judges(tmp_path: Path) -> None:
    nodes = [
        node(f"/n{at}", {f"/n{at}/out": SCAN}, {f"/n{at}/in": SCAN, f"/n{at}/missing": f"my_msgs/T{at % 20}"})
        for at in range(150)
    ]
    found = faults(graph(*nodes), tmp_path)
    world = read_back(graph(*nodes), tmp_path)
    problem = api.match(world)
    judged = violations(problem.environment, problem.similarity)
    assert sorted(fault.text for fault in found if fault.violation) == sorted(violation.text for violation in judged)
