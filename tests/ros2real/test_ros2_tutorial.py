"""The commands of the manual's page `ros2_tutorial`, one after the other, among real nodes; they say what it shows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from operated_world import eventually
from ros2_venv import PYTHON
from ros2_words import observing
from terminals import Terminals, write_cfgplan
from warm import cold_command

PAGE = Path(__file__).parents[2] / "cfgplan" / "manual" / "ros2_tutorial.md"
BEGUN = {"./robot.py lidar": "/lidar", "./robot.py guard": "/guard", "cfgplan run healing.yaml": "/guard_1"}
"""By what is begun in a terminal: the node that is there then."""

ASKED_AGAIN = ("cfgplan import", "cfgplan check", "cfgplan ctl state", "./robot.py look")
"""What nodes that are just there may not be part of yet, on a busy computer."""


@pytest.fixture
def terminals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminals]:
    programs = tmp_path / "bin"
    write_cfgplan(programs, cold_command())
    monkeypatch.setenv("PATH", f"{programs}:{PYTHON.parent}:{os.environ['PATH']}")
    made = Terminals(tmp_path, await_begun, ASKED_AGAIN)
    yield made
    made.close()


def await_begun(command: str) -> None:
    node = next(node for begun, node in BEGUN.items() if command.startswith(begun))
    with observing() as observer:
        eventually(lambda: node in observer.look()["nodes"])


def test_the_tutorial_of_ros2_finds_both_faults_and_heals_the_graph(terminals: Terminals) -> None:
    terminals.play(PAGE)
    with observing() as observer:
        eventually(lambda: not {"/lidar_1", "/sonar_1", "/guard_1"} & {*observer.look()["nodes"]})
