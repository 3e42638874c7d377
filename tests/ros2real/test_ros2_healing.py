"""What dies, hangs or is lost of a run of ROS 2 nodes is replaced, and the rest goes on."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from subprocess import Popen

import psutil
import pytest
from operated_world import await_event, eventually
from ros2_words import ENVIRONMENT, Observer, command_of, pid_of, running_nodes, write_words

HANG = ENVIRONMENT.replace("params: {rate: 100", "run: {hang: 2}\n    params: {rate: 100")


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Popen[str]]:
    path = write_words(tmp_path)
    path.write_text(HANG)
    with running_nodes(path) as process:
        yield process


def test_nodes_that_die_or_hang_are_replaced_and_the_others_stay(run: Popen[str], observer: Observer) -> None:
    numbers = (int(shout.removesuffix("!")) for shout in observer.listen("/shout"))
    shouter, talker = pid_of(run, "__node:=shouter_1"), pid_of(run, "__node:=talker_1")
    for number, told in ((signal.SIGKILL, "UnitDied"), (signal.SIGSTOP, "UnitHung")):
        reached = max(islice(numbers, 500))
        os.kill(talker, number)
        await_event(run, told, unit="talker.1")
        eventually(lambda before=talker: pid_of(run, "__node:=talker_1") not in (0, before))
        talker = pid_of(run, "__node:=talker_1")
        assert next(number for number in numbers if number < reached), "it counts anew"
    assert pid_of(run, "__node:=shouter_1") == shouter
    os.kill(shouter, signal.SIGKILL)
    eventually(lambda: pid_of(run, "__node:=shouter_1") not in (0, shouter))
    assert next(numbers), "the topic is the relay's, and its listeners stay"
    assert pid_of(run, "__node:=talker_1") == talker


def test_a_helper_that_dies_is_made_anew_and_nodes_stay(run: Popen[str], observer: Observer) -> None:
    shouts = observer.listen("/shout")
    next(shouts)
    main = next(word for word in command_of(psutil.Process(pid_of_helper(run))) if word.endswith("main.py"))
    nodes = pid_of(run, "__node:=shouter_1"), pid_of(run, "__node:=talker_1")
    helper = pid_of_helper(run)
    os.kill(helper, signal.SIGKILL)
    eventually(lambda: pid_of(run, main) not in (0, helper))
    numbers = [int(shout.removesuffix("!")) for shout in islice(shouts, 400)]
    assert numbers == sorted(set(numbers)), "the same nodes count on"
    assert (pid_of(run, "__node:=shouter_1"), pid_of(run, "__node:=talker_1")) == nodes


def pid_of_helper(run: Popen[str]) -> int:
    children = psutil.Process(run.pid).children(recursive=True)
    return next(one.pid for one in children if any(word.endswith("host/main.py") for word in command_of(one)))
