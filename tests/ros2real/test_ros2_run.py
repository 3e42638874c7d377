"""`cfgplan run --middleware ros2`: what an environment asks for runs as nodes, and nothing of it is left."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import psutil
import pytest
from operated_world import await_event, eventually, running
from ros2_words import ENVIRONMENT, observing, write_words

from cfgplan.cli import main


@pytest.fixture
def env(tmp_path: Path) -> Path:
    return write_words(tmp_path)


def ports_in_memory() -> set[str]:
    """The files of shared memory that Fast DDS has for this domain."""
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    memory = Path("/dev/shm")
    return {str(path) for port in range(first, first + 250) for path in memory.glob(f"*fastrtps_port{port}*")}


def test_nodes_are_started_connected_and_stopped_and_nothing_is_left(env: Path) -> None:
    with observing() as observer:
        observer.look()
        before = ports_in_memory()
        with running("--middleware", "ros2", env) as process:
            shouts = observer.listen("/shout")
            await_event(process, "Running")
            numbers = [int(word.removesuffix("!")) for word in islice(shouts, 20)]
            assert numbers == list(range(numbers[0], numbers[0] + 20))
            assert numbers[0] >= 1000, "the parameter was taken"
            eventually(lambda: {"/talker_1", "/shouter_1"} <= set(observer.look()["nodes"]))
            children = psutil.Process(process.pid).children(recursive=True)
            assert any("talking.py" in " ".join(child.cmdline()) for child in children)
            assert main(["ctl", "stop"]) == 0
            process.communicate()
        assert process.returncode == 0
        eventually(lambda: not any(child.is_running() for child in children))
        assert ports_in_memory() <= before


def test_nothing_is_left_of_a_run_that_is_killed(env: Path) -> None:
    with observing() as observer, running("--middleware", "ros2", env) as process:
        shouts = observer.listen("/shout")
        await_event(process, "Running")
        next(shouts)
        children = psutil.Process(process.pid).children(recursive=True)
        process.kill()
    eventually(lambda: not any(child.is_running() and child.status() != "zombie" for child in children))


def test_nodes_that_are_run_as_processes_are_told_of_their_middleware(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(env)]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "shouter is a node of ROS (`node:./talking.py shouter`)" in said
    assert "--middleware ros2" in said


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("node:./talking.py talker", "units.py:Talker", "talker: `units.py:Talker` is not a node of ROS 2"),
        ("node:./talking.py talker", "nodelet:a/b", "talker: `nodelet:a/b` is not a node of ROS 2"),
        ("remap: ~loud", "remap: quiet", "shouter: two ports are 'quiet' to the node"),
        ("remap: chatter}", "remap: chatter, topic: a b}", "talker/words: `a b` can't be the name of a ROS 2 topic"),
        ("topic: /shout", "topic: /sh-out", "shout: `/sh-out` can't be the name of a ROS 2 topic"),
        ("type: std_msgs/String, remap: chatter", "type: String, remap: chatter", "`String` is not a message type"),
        ("rate: 100", "rate: [1, two]", "talker: params: rate: `[1, 'two']` can't be a parameter of ROS 2"),
        (
            "node:./talking.py talker",
            "component:talking/Talker loud",
            "talker: a component takes no argument `loud`, only remappings",
        ),
        ("node:./talking.py talker", "component:talking/Talker@a-b", "talker: `a-b` can't be the name of a container"),
        ("rate: 100", "rate: null", "talker: params: rate: `None` can't be a parameter of ROS 2"),
        ("rate: 100", "rate: []", "talker: params: rate: `[]` can't be a parameter of ROS 2"),
        ("rate: 100", "rate: {a: {}}", "talker: params: rate.a: `{}` can't be a parameter of ROS 2"),
        ("rate: 100", f"rate: {2**63}", f"talker: params: rate: `{2**63}` can't be a parameter of ROS 2"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(
    env: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace(old, new))
    for dry in ([], ["--dry-run"]):
        assert main(["run", "--middleware", "ros2", *dry, str(env)]) == 30
        assert told in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("dry", [[], ["--dry-run"]])
def test_a_python_without_rclpy_is_told_before_anything_starts(
    env: Path, dry: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "--middleware", "ros2", "--ros-python", "/bin/false", *dry, str(env)]) == 30
    assert "error: --ros-python: /bin/false: fails" in " ".join(capsys.readouterr().err.split())


def test_a_dry_run_plans_and_starts_nothing_and_names_nodes_that_are_not_there(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", "--middleware", "ros2", "--dry-run", str(env)]
    before = psutil.Process().children()
    assert main(command) == 0
    said = capsys.readouterr()
    assert "+ start   talker.1" in said.out
    assert "left out" not in said.err
    assert psutil.Process().children() == before
    env.write_text(ENVIRONMENT.replace("./talking.py talker", "./silent.py"))
    assert main(command) == 12
    said = capsys.readouterr()
    assert "talker is left out until its code changes: silent.py: there is no file ./silent.py" in said.err


def test_no_warning_of_rclpy_about_quality_of_service_reaches_the_screen(env: Path) -> None:
    nodes = ENVIRONMENT.replace("talking.py talker", "talking.py whisperer")
    env.write_text(nodes.replace("talking.py shouter", "talking.py eager"))
    with observing() as observer, running("--middleware", "ros2", env) as process:
        shouts = observer.listen("/shout")
        await_event(process, "Running")
        next(shouts)
        process.terminate()
        said, _ = process.communicate()
    assert "incompatible QoS" not in said


def test_the_template_of_ros_2_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tmp_path), "--template", "ros2"]) == 0
    assert "--middleware ros2" in capsys.readouterr().out
    with observing() as observer, running("--middleware", "ros2", tmp_path / "env.yaml") as process:
        await_event(process, "Running")
        eventually(lambda: {"/front_lidar_1", "/guard_1"} <= set(observer.look()["nodes"]))
        process.terminate()
        process.communicate()
    assert process.returncode == 0
