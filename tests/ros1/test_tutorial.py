"""The commands of the manual's page `ros_tutorial`, one after the other, in a real graph; they say what it shows."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from operated_world import eventually
from terminals import Terminals, write_cfgplan
from warm import command
from words import node_names

from cfgplan.ros.node_api import SilentError

TOOLS = ("roscore", "rosnode", "rostopic")
LACKING = [tool for tool in TOOLS if shutil.which(tool) is None]
pytestmark = pytest.mark.skipif(
    bool(LACKING), reason=f"no {', '.join(LACKING)} here (Debian: apt install python3-rosnode python3-rostopic)"
)
PAGE = Path(__file__).parents[2] / "cfgplan" / "manual" / "ros_tutorial.md"
BEGUN = {
    "roscore": "/rosout",
    "./robot.py lidar": "/lidar",
    "./robot.py guard": "/guard",
    "cfgplan run healing.yaml": "/lidar_1",
    "cfgplan run robot.yaml": "/guard",
}
"""By what is begun in a terminal: the node that is there then."""


def there() -> set[str]:
    """The nodes that there are."""
    try:
        return node_names()
    except SilentError:
        return set()


@pytest.fixture
def terminals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminals]:
    programs = tmp_path / "bin"
    write_cfgplan(programs, command())
    port = os.environ["ROS_MASTER_URI"].rpartition(":")[2]
    (programs / "roscore").write_text(f"#!/bin/sh\nexec {shutil.which('roscore')} -p {port}\n")
    (programs / "roscore").chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    made = Terminals(tmp_path, await_begun, ("cfgplan ctl state",))
    yield made
    made.close()


def await_begun(command: str) -> None:
    node = next(node for begun, node in BEGUN.items() if command.startswith(begun))
    eventually(lambda: node in there())


def test_the_tutorial_heals_a_graph(terminals: Terminals) -> None:
    terminals.play(PAGE)
    assert not {"/lidar_1", "/sonar_1", "/guard_1"} & there()
