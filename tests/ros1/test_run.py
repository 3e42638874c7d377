"""`cfgplan run --middleware ros1`: what an environment asks for runs as nodes, and nothing of it is left."""

from __future__ import annotations

import os
from contextlib import suppress
from itertools import islice
from pathlib import Path
from subprocess import DEVNULL

import psutil
import pytest
from living import living
from operated_world import await_event, eventually, running
from warm import command
from warm_nodes import start
from words import ENVIRONMENT, listening, node_names, process_of_the_run, system_state, write_words

from cfgplan.cli import main
from cfgplan.errors import InputError
from cfgplan.ros.master import master_graph
from cfgplan.ros.node_api import SilentError


@pytest.fixture
def env(tmp_path: Path) -> Path:
    return write_words(tmp_path)


def test_nodes_are_started_connected_and_stopped_and_nothing_is_left(env: Path) -> None:
    with running("--middleware", "ros1", env) as process:
        await_event(process, "Running")
        with listening("/shout") as shouts:
            numbers = [int(word.removesuffix("!")) for word in islice(shouts, 20)]
        assert numbers == list(range(numbers[0], numbers[0] + 20))
        assert numbers[0] >= 1000, "the parameter was taken"
        assert {"/talker_1", "/shouter_1"} <= node_names()
        children = psutil.Process(process.pid).children(recursive=True)
        assert any("talking.py" in " ".join(child.cmdline()) for child in children)
        process.terminate()
        process.communicate()
    assert process.returncode == 0
    eventually(lambda: not any(child.is_running() for child in children))
    with pytest.raises(InputError, match="no ROS 1 master answers"):
        master_graph()


@pytest.mark.usefixtures("warm_cfgplan")
def test_a_master_that_is_there_is_used_and_knows_nothing_of_the_run_afterwards(
    env: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_NAMESPACE", "elsewhere")  # names of nodes are the run's
    address = os.environ["ROS_MASTER_URI"]
    master = start(["rosmaster", "--core", "-p", address.rpartition(":")[2]], stdout=DEVNULL, stderr=DEVNULL)
    try:
        eventually(is_answered)
        before = system_state()
        with running("--middleware", "ros1", env, call=command) as process:
            await_event(process, "Running")
            with listening("/shout") as shouts:
                next(shouts)
            assert {"/talker_1", "/shouter_1"} <= node_names()
            process.terminate()
            process.communicate()
        assert process.returncode == 0
        assert system_state() == before
    finally:
        master.kill()
        master.wait()


def is_answered() -> bool:
    with suppress(SilentError):
        return bool(system_state())
    return False


@pytest.mark.usefixtures("warm_cfgplan")
def test_nothing_is_left_of_a_run_that_is_killed(env: Path) -> None:
    with running("--middleware", "ros1", env, call=command) as process:
        await_event(process, "Running")
        with listening("/shout") as shouts:
            next(shouts)
        run = process_of_the_run()
        processes = [run, *run.children(recursive=True)]
        process.kill()
    eventually(lambda: not living(processes))


def test_nodes_that_are_run_as_processes_are_told_of_their_middleware(
    env: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(env)]) == 30
    said = " ".join(capsys.readouterr().err.split())
    assert "shouter is a node of ROS (`node:./talking.py shouter`)" in said
    assert "--middleware ros1" in said


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("node:./talking.py talker", "units.py:Talker", "talker: `units.py:Talker` is not a node of ROS 1"),
        ("node:./talking.py talker", "component:a/b::C", "talker: `component:a/b::C` is not a node of ROS 1"),
        ("remap: ~loud", "remap: quiet", "shouter: two ports are 'quiet' to the node"),
        ("topic: /shout", "topic: /sh-out", "shout: `/sh-out` can't be the name of a ROS 1 topic"),
        ("type: std_msgs/String, remap: chatter", "type: String, remap: chatter", "`String` is not a message type"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(
    env: Path, old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env.write_text(ENVIRONMENT.replace(old, new))
    assert main(["run", "--middleware", "ros1", str(env)]) == 30
    assert told in " ".join(capsys.readouterr().err.split())
