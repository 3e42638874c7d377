"""Checks of observed streams of nodes that ROS 1 and ROS 2 share, in the environment of words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.streams.run_folder import base_folder, topics_of
from operated_world import PATIENCE_S, Call, await_event, command, eventually, running

from cfgplan.cli import main

TOLD = ("/shout", "talker.1/words")
"""A topic and a stream of the environment of words."""


def seen_on(topic: str) -> int:
    """The number in the next word on a topic."""
    with subscribe(topic, timeout_s=PATIENCE_S, wait_s=PATIENCE_S) as subscription:
        return int(next(iter(subscription)).value["data"].removesuffix("!"))


def check_that_messages_are_shown(middleware: str, env: Path, call: Call = command) -> None:
    """Messages between nodes and on topics are shown while a peek lasts."""
    with running("--middleware", middleware, env, call=call) as process:
        await_event(process, "Running")
        with connect() as control:
            first = seen_on(control.call("tap", stream="talker.1/words")["topic"])
            assert first >= 1000
            loud = control.call("tap", stream="/shout")["topic"]
            assert control.call("tap", stream="shouter.1/loud")["topic"] == loud
            assert seen_on(loud) > first
            with pytest.raises(RefusedError, match=re.escape("no unit that runs gives 'talker.1/word'")):
                control.call("tap", stream="talker.1/word")
            control.call("kill", unit="talker.1")
            later = seen_on(control.call("tap", stream="talker.1/words")["topic"])
            assert seen_on(control.call("tap", stream="talker.1/words")["topic"]) > later
            run = base_folder() / control.system.run
            eventually(lambda: topics_of(run) == [])


def check_that_rates_are_measured(
    middleware: str, env: Path, capsys: pytest.CaptureFixture[str], call: Call = command
) -> None:
    """The rate of topics and of streams between nodes is measured."""
    with running("--middleware", middleware, env, call=call) as process:
        await_event(process, "Running")
        for name in TOLD:
            hz = ["ctl", "hz", name, "--for", "2500ms"]
            eventually(lambda hz=hz: main(hz) == 0 and "Hz: " in capsys.readouterr().out)
