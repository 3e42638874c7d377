"""Streams of ROS 2 nodes as observers see them: by taps, whose messages the relay passes on."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.streams.run_folder import base_folder, topics_of
from operated_world import PATIENCE_S, await_event, eventually, running
from ros2_words import write_words

from cfgplan.cli import main


def seen_on(topic: str) -> int:
    """The number in the next word on a topic."""
    with subscribe(topic, timeout_s=PATIENCE_S, wait_s=PATIENCE_S) as subscription:
        return int(next(iter(subscription)).value["data"].removesuffix("!"))


def test_messages_between_nodes_and_on_topics_are_shown_while_somebody_looks(tmp_path: Path) -> None:
    with running("--middleware", "ros2", write_words(tmp_path)) as process:
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


@pytest.mark.parametrize("name", ["/shout", "talker.1/words"])
def test_the_rate_of_topics_and_of_streams_between_nodes_is_measured(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running("--middleware", "ros2", write_words(tmp_path)) as process:
        await_event(process, "Running")
        eventually(lambda: main(["ctl", "hz", name, "--for", "2500ms"]) == 0 and "Hz: " in capsys.readouterr().out)
