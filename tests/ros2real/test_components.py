"""Components of ROS 2 in containers: loaded, unloaded and loaded anew by the plan.

The container, in rclpy, and the types of its services are the tests' own: rclcpp's container was never run here.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import psutil
import pytest
from operated_world import await_event, eventually, running
from ros2_words import Observer, command_of, pid_of, running_nodes

from cfgplan.cli import main

HERE = Path(__file__).parent
ENVIRONMENT = """\
format: cfgplan/1
transformations:
  - label: talker
    source: component:talking/talking::Talker{group}
    params: {{rate: 100, first: 1000, deep: {{inner: [1.5, 2.0]}}}}
    outputs: {{words: {{tag: Word, type: std_msgs/String, remap: chatter}}}}
  - label: shouter
    source: component:talking/talking::Shouter{group} idle:=/other
    inputs: {{quiet: {{tag: Word, type: std_msgs/String}}}}
    outputs: {{loud: {{tag: LoudWord, type: std_msgs/String, remap: ~loud}}}}
targets:
  - {{label: words, topic: /words, tag: Word}}
  - {{label: shout, topic: /shout, tag: LoudWord}}
"""
SHOUT = "  - {label: shout, topic: /shout, tag: LoudWord}\n"


pytestmark = pytest.mark.usefixtures("container_package")


@contextmanager
def components(folder: Path, group: str, text: str = ENVIRONMENT) -> Iterator[subprocess.Popen[str]]:
    """A run of components in containers of a group, which ends well."""
    path = folder / "env.yaml"
    path.write_text(text.format(group=group))
    with running_nodes(path) as process:
        yield process


def containers(run: subprocess.Popen[str]) -> list[int]:
    """The processes of a run's containers."""
    children = psutil.Process(run.pid).children(recursive=True)
    return [one.pid for one in children if any("component_container" in word for word in command_of(one))]


def test_components_of_a_group_share_a_container_and_get_names_remappings_and_parameters(
    tmp_path: Path, observer: Observer
) -> None:
    with components(tmp_path, "@eyes") as run:
        numbers = [int(word.removesuffix("!")) for word in islice(observer.listen("/shout"), 20)]
        assert numbers == list(range(numbers[0], numbers[0] + 20))
        assert numbers[0] >= 1000, "the parameter was taken"
        eventually(lambda: {"/talker_1", "/shouter_1", "/eyes"} <= set(observer.look()["nodes"]))
        (container,) = containers(run)
    assert not psutil.pid_exists(container)


def test_a_component_that_is_no_longer_wanted_is_unloaded_and_the_others_stay(
    tmp_path: Path, observer: Observer
) -> None:
    with components(tmp_path, "@eyes") as run:
        words = observer.listen("/words")
        before = containers(run)
        first = int(next(words))
        path = tmp_path / "env.yaml"
        path.write_text(path.read_text().replace(SHOUT, ""))
        await_event(run, "UnitStopped", unit="shouter.1")
        eventually(lambda: "/shouter_1" not in observer.look()["nodes"])
        assert containers(run) == before
        numbers = [first, *(int(word) for word in islice(words, 50))]
        assert numbers == list(range(first, first + 51)), "the talker goes on"


def test_all_components_of_a_container_that_dies_are_loaded_into_a_new_one(tmp_path: Path, observer: Observer) -> None:
    with components(tmp_path, "@eyes") as run:
        shouts = observer.listen("/shout")
        reached = [int(shout.removesuffix("!")) for shout in islice(shouts, 200)][-1]
        (container,) = containers(run)
        os.kill(container, signal.SIGKILL)
        assert "it was in the container /eyes, which was killed by SIGKILL" in await_event(run, "UnitDied")["cause"]
        assert next(number for shout in shouts if (number := int(shout.removesuffix("!"))) < reached), "it counts anew"
        assert container not in containers(run)
        assert len(containers(run)) == 1


def test_a_component_without_a_group_has_a_container_of_its_own(tmp_path: Path, observer: Observer) -> None:
    with components(tmp_path, "") as run:
        next(observer.listen("/shout"))
        assert len(containers(run)) == 2
        talker = pid_of(run, "__node:=talker_1_container")
        os.kill(pid_of(run, "__node:=shouter_1_container"), signal.SIGKILL)
        await_event(run, "UnitDied", unit="shouter.1")
        next(observer.listen("/shout"))
        eventually(lambda: len(containers(run)) == 2)
        assert pid_of(run, "__node:=talker_1_container") == talker


def test_a_new_helper_loads_nothing_twice(tmp_path: Path, observer: Observer) -> None:
    with components(tmp_path, "@eyes") as run:
        shouts = observer.listen("/shout")
        next(shouts)
        children = psutil.Process(run.pid).children(recursive=True)
        helper = next(one for one in children if any(word.endswith("host/main.py") for word in command_of(one)))
        helper.kill()
        numbers = [int(shout.removesuffix("!")) for shout in islice(shouts, 300)]
        assert numbers == sorted(set(numbers)), "the same nodes count on"
        nodes = observer.look()["nodes"]
        assert nodes.count("/talker_1") == 1


def test_a_component_that_can_not_be_loaded_is_told_with_what_its_container_says(tmp_path: Path) -> None:
    text = ENVIRONMENT.replace("talking::Shouter", "talking::Mute")
    path = tmp_path / "env.yaml"
    path.write_text(text.format(group="@eyes"))
    with running("--middleware", "ros2", path) as run:
        died = await_event(run, "UnitDied", unit="shouter.1")
        assert died["cause"] == "talking::Mute can't be loaded: talking has no talking::Mute"
        run.terminate()
        run.communicate()


def test_a_component_that_refuses_to_be_configured_is_unloaded_and_the_others_stay(tmp_path: Path) -> None:
    text = ENVIRONMENT.replace("Shouter{group} idle:=/other", "Worker{group}\n    params: {{lame: true}}")
    path = tmp_path / "env.yaml"
    path.write_text(text.format(group="@eyes"))
    with running("--middleware", "ros2", path) as run:
        await_event(run, "UnitPrinted", line="unloaded /shouter_1")
        died = await_event(run, "UnitDied")
        assert died["cause"] == "/shouter_1 could not be configured; its state is unconfigured"
        assert died["unit"] == "shouter.1"
        run.terminate()
        run.communicate()


def test_a_container_that_does_not_unload_a_component_is_ended_and_the_others_are_loaded_anew(
    tmp_path: Path, observer: Observer
) -> None:
    text = ENVIRONMENT.replace("Shouter{group}", "Stubborn{group}")
    with components(tmp_path, "@eyes", text) as run:
        (before,) = containers(run)
        path = tmp_path / "env.yaml"
        path.write_text(path.read_text().replace(SHOUT, ""))
        await_event(run, "UnitStopped", unit="shouter.1")
        next(observer.listen("/words"))
        eventually(lambda: containers(run) not in ([], [before]))


def test_a_container_that_somebody_else_runs_is_used_and_left_empty(
    tmp_path: Path, container_package: Path, observer: Observer
) -> None:
    command = [container_package, "--ros-args", "-r", "__node:=eyes"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as eyes:
        try:
            eventually(lambda: "/eyes" in observer.look()["nodes"])
            with components(tmp_path, "@eyes") as run:
                next(observer.listen("/shout"))
                assert containers(run) == []
            eventually(lambda: not {"/talker_1", "/shouter_1"} & set(observer.look()["nodes"]))
            assert eyes.poll() is None
        finally:
            eyes.kill()


def test_a_container_that_can_not_be_started_names_the_package(tmp_path: Path, container_package: Path) -> None:
    container_package.unlink()
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT.format(group="@eyes"))
    with running("--middleware", "ros2", path) as run:
        told = await_event(run, "Warning")["text"]
        assert "shouter, talker are left out until their code changes: there is no executable" in told
        assert "'component_container' of a package 'rclcpp_components'" in told
        run.terminate()
        run.communicate()


@pytest.mark.parametrize("group", ["@eyes", ""], ids=["shared", "own"])
def test_a_container_of_several_threads_is_started_where_it_is_asked_for(
    group: str, tmp_path: Path, container_package: Path, observer: Observer
) -> None:
    container_package.rename(container_package.with_name("component_container_mt"))
    several = ENVIRONMENT.replace("    params:", "    run: {{container: mt}}\n    params:").replace(
        "    inputs:", "    run: {{container: mt}}\n    inputs:"
    )
    with components(tmp_path, group, several) as run:
        next(observer.listen("/shout"))
        children = psutil.Process(run.pid).children(recursive=True)
        names = [name for one in children for word in command_of(one) if "component_" in (name := Path(word).name)]
        assert set(names) == {"component_container_mt"}


def test_components_of_one_container_agree_on_its_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(ENVIRONMENT.replace("    inputs:", "    run: {{container: mt}}\n    inputs:").format(group="@eyes"))
    assert main(["run", "--middleware", "ros2", str(path)]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "share the container `eyes`: `shouter` asks for mt and `talker` asks for plain" in said
