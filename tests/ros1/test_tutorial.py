"""The commands of the manual's page `ros_tutorial`, one after the other, in a real graph; they say what it shows."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
from functools import partial
from pathlib import Path

import psutil
import pytest
from operated_world import PATIENCE_S, eventually
from words import node_names

from cfgplan.errors import InputError

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
TOLD = r"# (terminal \d|ends with \d)$"


class Shell:
    """Runs commands in a folder; those of another terminal go on there."""

    def __init__(self, folder: Path) -> None:
        self.last = self.said = ""
        self._folder = folder
        self._terminals: list[tuple[str, subprocess.Popen[bytes]]] = []

    def run(self, line: str) -> None:
        """Run a line, and wait until what it begins is there, or what it ends is not."""
        told = re.search(TOLD, line)
        command = line[: told.start()].strip() if told else line
        if told and told[1].startswith("terminal"):
            self._begin(command)
            return
        done = subprocess.run(
            ["/bin/sh", "-c", command], cwd=self._folder, capture_output=True, text=True, timeout=PATIENCE_S
        )
        self.last, self.said = line, done.stdout
        assert done.returncode == (int(told[1][-1]) if told else 0), f"{command}: {done.stdout}{done.stderr}"
        if command == "cfgplan ctl stop":
            runs = [process for begun, process in self._terminals if begun.startswith("cfgplan run")]
            eventually(lambda: all(process.poll() is not None for process in runs))

    def shows(self, text: str) -> bool:
        """Whether the last command said this. If it asked for a run's state, which may still come to be, ask again."""
        if OutputChecker().check_output(f"...{text.strip()}...", self.said, ELLIPSIS | NORMALIZE_WHITESPACE):
            return True
        assert self.last == "cfgplan ctl state", self.said
        self.run(self.last)
        return False

    def _begin(self, command: str) -> None:
        if command == "roscore":
            command += f" -p {os.environ['ROS_MASTER_URI'].rpartition(':')[2]}"
        process = subprocess.Popen(["/bin/sh", "-c", f"exec {command}"], cwd=self._folder, stdout=subprocess.DEVNULL)
        self._terminals.append((command, process))
        eventually(lambda: next(node for begun, node in BEGUN.items() if command.startswith(begun)) in there())

    def close(self) -> None:
        """End each terminal's program with all that it has started."""
        for _, process in reversed(self._terminals):
            with process:
                if process.poll() is None:
                    children = psutil.Process(process.pid).children(recursive=True)
                    process.terminate()
                    assert not psutil.wait_procs(children, timeout=PATIENCE_S)[1]


def there() -> set[str]:
    """The nodes that there are."""
    try:
        return node_names()
    except InputError:
        return set()


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Shell]:
    programs = tmp_path / "bin"
    programs.mkdir()
    cfgplan = programs / "cfgplan"
    code = "import sys; from cfgplan.cli import main; sys.exit(main())"
    cfgplan.write_text(f'#!/bin/sh\nexec {sys.executable} -c {shlex.quote(code)} "$@"\n')
    cfgplan.chmod(cfgplan.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    made = Shell(tmp_path)
    yield made
    made.close()


def test_the_tutorial_heals_a_graph(shell: Shell, tmp_path: Path) -> None:
    blocks = re.findall(r"<!-- (?:file: (.*?)|tested by: .*?) -->\n```(\w+)\n(.*?)```", PAGE.read_text(), re.DOTALL)
    for file, language, text in blocks:
        if file:
            (tmp_path / file).write_text(text)
        elif language == "text":
            eventually(partial(shell.shows, text))
        else:
            for line in text.splitlines():
                shell.run(line)
    assert not {"/lidar_1", "/sonar_1", "/guard_1"} & there()
