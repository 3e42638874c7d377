"""Nodes outside of a run hear its outputs on the topics by which they know them, and nothing is copied for nobody."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from subprocess import Popen

from operated_world import eventually
from ros2_words import ENVIRONMENT, Observer, pid_of, running_nodes, write_words

KNOWN = ENVIRONMENT.replace("remap: chatter}", "remap: chatter, topic: /known/words}")
ALONE = KNOWN[: KNOWN.index("  - label: shouter")] + "targets: [{label: talk, run: talker}]\n"


@contextmanager
def known(folder: Path, text: str) -> Iterator[Popen[str]]:
    path = write_words(folder)
    path.write_text(text)
    with running_nodes(path) as process:
        yield process


def test_an_output_is_heard_on_its_topic_beside_what_the_plan_feeds(tmp_path: Path, observer: Observer) -> None:
    with known(tmp_path, KNOWN):
        next(observer.listen("/shout"))
        assert "/known/words" in observer.look()["topics"]
        numbers = [int(word) for word in islice(observer.listen("/known/words"), 50)]
        assert numbers == list(range(numbers[0], numbers[0] + 50))


def test_the_topic_stays_when_another_unit_gives_it(tmp_path: Path, observer: Observer) -> None:
    with known(tmp_path, KNOWN) as run:
        words = (int(word) for word in observer.listen("/known/words"))
        reached = max(islice(words, 200))
        os.kill(pid_of(run, "__node:=talker_1"), signal.SIGKILL)
        assert next(number for number in words if number < reached) >= 1000, "the replacement counts anew"


def test_nobody_listens_to_an_output_that_nobody_wants(tmp_path: Path, observer: Observer) -> None:
    """The helper listens to each output at first, to see what it is, and then only while there is a listener."""
    with known(tmp_path, ALONE):
        eventually(lambda: "/known/words" in observer.look()["topics"])
        eventually(lambda: "/talker_1/out/words" not in observer.look()["heard"])
        assert int(next(observer.listen("/known/words"))) >= 1000
        assert "/talker_1/out/words" in observer.look()["heard"]


def test_a_topic_that_is_a_target_too_has_each_message_once(tmp_path: Path, observer: Observer) -> None:
    text = ALONE.replace("{label: talk, run: talker}", "{label: words, topic: /known/words, tag: Word}")
    with known(tmp_path, text):
        numbers = [int(word) for word in islice(observer.listen("/known/words"), 100)]
        assert numbers == list(range(numbers[0], numbers[0] + 100))
