"""Plays a page of the manual: its commands one after the other, in several terminals; they say what it shows."""

from __future__ import annotations

import re
import shlex
import signal
import stat
import subprocess
from collections.abc import Callable, Sequence
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
from functools import partial
from itertools import takewhile
from pathlib import Path

import psutil
from operated_world import PATIENCE_S, eventually

_TOLD = re.compile(r"# (?:terminal (?P<terminal>\d)|ends with (?P<code>\d))$")
_ENDED = re.compile(r"# Ctrl-C in terminals? (\d)(?: and (\d))?$")


class Terminals:
    """Runs commands in a folder; those of another terminal go on there.

    `await_begun` is called with each of these, and returns when it is there. What commands of `asked_again` say may
    still come to be: those at the end of a block are run again until the last says it.
    """

    def __init__(self, folder: Path, await_begun: Callable[[str], None], asked_again: tuple[str, ...]) -> None:
        self.lines: list[str] = []
        """What has been run since something was last shown."""
        self._said: Callable[[], str] = str
        self._folder = folder
        self._await_begun, self._asked_again = await_begun, asked_again
        self._terminals: dict[str, tuple[str, subprocess.Popen[bytes]]] = {}

    def run(self, line: str) -> None:
        """Run a line, and wait until what it begins is there, or what it ends is not."""
        self.lines.append(line)
        if ended := _ENDED.match(line):
            for terminal in filter(None, ended.groups()):
                self._end(terminal)
            return
        told = _TOLD.search(line)
        command = line[: told.start()].strip() if told else line
        if told and told["terminal"]:
            self._begin(told["terminal"], command)
            return
        done = subprocess.run(
            ["/bin/sh", "-c", command], cwd=self._folder, capture_output=True, text=True, timeout=PATIENCE_S
        )
        is_as_told = done.returncode == (int(told["code"]) if told else 0)
        assert is_as_told or command.startswith(self._asked_again), f"{command}: {done.stdout}{done.stderr}"
        self._said = lambda: done.stdout if is_as_told else ""
        if command == "cfgplan ctl stop":
            runs = [process for begun, process in self._terminals.values() if begun.startswith("cfgplan run")]
            eventually(lambda: all(process.poll() is not None for process in runs))

    def shows(self, text: str) -> bool:
        """Whether the last command says this."""
        if OutputChecker().check_output(f"...{text.strip()}...", self._said(), ELLIPSIS | NORMALIZE_WHITESPACE):
            self.lines.clear()
            return True
        if not _TOLD.search(self.lines[-1]) or "terminal" not in self.lines[-1]:
            again = list(takewhile(lambda line: line.startswith(self._asked_again), reversed(self.lines)))[::-1]
            assert again, self._said()
            del self.lines[-len(again) :]
            for line in again:
                self.run(line)
        return False

    def play(self, page: Path) -> None:
        """Write the page's files, run its commands, and look for what it shows."""
        blocks = re.findall(r"<!-- (?:file: (.*?)|tested by: .*?) -->\n```(\w+)\n(.*?)```", page.read_text(), re.DOTALL)
        assert blocks
        for file, language, text in blocks:
            if file:
                (self._folder / file).write_text(text)
            elif language == "text":
                eventually(partial(self.shows, text))
            else:
                for line in text.splitlines():
                    self.run(line)

    def _begin(self, terminal: str, command: str) -> None:
        self._end(terminal)
        output = self._folder / f"terminal_{terminal}.txt"
        with output.open("w") as told:
            line = ["/bin/sh", "-c", f"exec {command}"]
            process = subprocess.Popen(line, cwd=self._folder, stdout=told, stderr=subprocess.STDOUT)
        self._terminals[terminal] = (command, process)
        self._said = output.read_text
        self._await_begun(command)

    def _end(self, terminal: str) -> None:
        """Press Ctrl-C, and wait for the end."""
        if terminal in self._terminals:
            process = self._terminals.pop(terminal)[1]
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE_S)

    def close(self) -> None:
        """End each terminal's program with all that it has started."""
        for _, process in reversed(self._terminals.values()):
            with process:
                if process.poll() is None:
                    children = psutil.Process(process.pid).children(recursive=True)
                    process.terminate()
                    assert not psutil.wait_procs(children, timeout=PATIENCE_S)[1]


def write_cfgplan(folder: Path, line: Sequence[str]) -> None:
    """Write the program `cfgplan` into a folder: `line` is `command()` or `cold_command()` of tests/warm.py."""
    folder.mkdir()
    program = folder / "cfgplan"
    program.write_text(f'#!/bin/sh\nexec {shlex.join(line)} "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
