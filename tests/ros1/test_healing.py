"""What dies, hangs or is lost of a run of ROS 1 nodes is replaced, and the rest goes on."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from subprocess import Popen

import pytest
from operated_world import await_event, eventually, running
from warm import command
from words import ENVIRONMENT, await_pid, listening, pid_of, process_of_the_run, write_words

pytestmark = pytest.mark.usefixtures("warm_cfgplan")
HANG = ENVIRONMENT.replace("params: {rate", "run: {hang: 2}\n    params: {rate")


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Popen[str]]:
    path = write_words(tmp_path)
    path.write_text(HANG)
    with running("--middleware", "ros1", path, call=command) as process:
        await_event(process, "Running")
        yield process
        process.terminate()
        process.communicate()
    assert process.returncode == 0


def test_nodes_that_die_or_hang_are_replaced_and_the_others_stay(run: Popen[str]) -> None:
    with listening("/shout") as shouts:
        numbers = (int(shout.removesuffix("!")) for shout in shouts)
        shouter, talker = await_pid("/shouter_1"), await_pid("/talker_1")
        for number, told in ((signal.SIGKILL, "UnitDied"), (signal.SIGSTOP, "UnitHung")):
            reached = max(islice(numbers, 125))
            os.kill(talker, number)
            await_event(run, told, unit="talker.1")
            eventually(lambda before=talker: pid_of("/talker_1") not in (0, before))
            talker = await_pid("/talker_1")
            assert next(number for number in numbers if number < reached), "it counts anew"
        assert await_pid("/shouter_1") == shouter
        os.kill(shouter, signal.SIGKILL)
        eventually(lambda: pid_of("/shouter_1") not in (0, shouter))
        assert next(shouts), "the topic is the relay's, and its listeners stay"
        assert await_pid("/talker_1") == talker


@pytest.mark.usefixtures("run")
def test_a_relay_and_a_master_that_die_are_made_anew() -> None:
    for what in ("topic_relay", "rosmaster"):
        with listening("/shout") as shouts:
            next(shouts)
        (victim,) = (one for one in process_of_the_run().children() if what in " ".join(one.cmdline()))
        victim.kill()
        eventually(lambda gone=victim: not gone.is_running())
        with listening("/shout") as shouts:
            next(shouts)
