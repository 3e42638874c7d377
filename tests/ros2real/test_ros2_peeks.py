"""Streams of ROS 2 nodes as observers see them: by taps, whose messages the relay passes on."""

from __future__ import annotations

from pathlib import Path

import pytest
from peeked_nodes import check_that_messages_are_shown, check_that_rates_are_measured
from ros2_words import write_words


def test_messages_between_nodes_and_on_topics_are_shown_while_somebody_looks(tmp_path: Path) -> None:
    check_that_messages_are_shown("ros2", write_words(tmp_path))


def test_the_rate_of_topics_and_of_streams_between_nodes_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_that_rates_are_measured("ros2", write_words(tmp_path), capsys)
