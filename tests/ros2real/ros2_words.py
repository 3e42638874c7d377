"""A small environment of ROS 2 nodes for tests, and what comes on a topic, seen by a node of another process."""

from __future__ import annotations

import json
import queue
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
from operated_world import PATIENCE_S, await_event, running
from ros2_venv import PYTHON

NODES = Path(__file__).with_name("talking.py")
STRING, POINT = "std_msgs/msg/String", "geometry_msgs/msg/PointStamped"
ENVIRONMENT = """\
format: cfgplan/1
transformations:
  - label: talker
    source: node:./talking.py talker
    params: {rate: 100, first: 1000}
    outputs: {words: {tag: Word, type: std_msgs/String, remap: chatter}}
  - label: shouter
    source: node:./talking.py shouter
    inputs: {quiet: {tag: Word, type: std_msgs/String}}
    outputs: {loud: {tag: LoudWord, type: std_msgs/String, remap: ~loud}}
targets:
  - {label: shout, topic: /shout, tag: LoudWord}
"""


def write_words(folder: Path) -> Path:
    """The environment file, with its nodes beside it."""
    shutil.copy(NODES, folder)
    path = folder / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


class Observer:
    """A node that listens, and looks at the graph."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._told: dict[str, queue.SimpleQueue[Any]] = {}
        threading.Thread(target=self._hear, daemon=True).start()

    def listen(self, topic: str, kind: str = STRING, **quality: bool) -> Iterator[str]:
        """The texts that come on a topic from now on."""
        told = self._told[topic] = queue.SimpleQueue()
        self._ask(listen=topic, type=kind, **quality)
        return iter(lambda: told.get(timeout=PATIENCE_S), None)

    def publish(self, topic: str, *texts: str, kind: str = STRING, every: float = 0.05, **quality: bool) -> None:
        """Publish texts one after the other, again and again unless `every` is 0."""
        self._ask(publish=topic, type=kind, texts=texts, every=every, **quality)

    def gives(self, topic: str) -> bool:
        """Whether a text comes on a topic within a second."""
        if topic not in self._told:
            self.listen(topic)
        told = self._told[topic]
        while not told.empty():
            told.get()
        try:
            told.get(timeout=1.0)
        except queue.Empty:
            return False
        return True

    def look(self) -> dict[str, list[str]]:
        """The `topics` that are published, those that are `heard`, and the `nodes`."""
        told = self._told[""] = queue.SimpleQueue()
        self._ask(look=True)
        found: dict[str, list[str]] = told.get(timeout=PATIENCE_S)
        return found

    def _ask(self, **what: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(what) + "\n")
        self._process.stdin.flush()

    def _hear(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            if "text" in told:
                self._told[told["topic"]].put(told["text"])
            elif "nodes" in told:
                self._told[""].put(told)


@contextmanager
def observing() -> Iterator[Observer]:
    """An observer, once it is there."""
    command = [str(PYTHON), str(Path(__file__).with_name("observer.py"))]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, start_new_session=True) as process:
        try:
            yield Observer(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(PATIENCE_S)
            finally:
                process.kill()


@contextmanager
def running_nodes(path: Path) -> Iterator[subprocess.Popen[str]]:
    """A run of ROS 2 nodes under way, which is stopped at the end, and ends well."""
    with running("--middleware", "ros2", path) as process:
        await_event(process, "Running")
        yield process
        process.terminate()
        process.communicate()
    assert process.returncode == 0


def pid_of(run: subprocess.Popen[str], what: str) -> int:
    """The child of a run whose command line has a word; 0 if there is none.

    A node `__node:=NAME` that has begun in a process that waited has that name instead, as far as the system keeps it.
    """
    name = what.removeprefix("__node:=")[:15]
    children = psutil.Process(run.pid).children(recursive=True)
    return next((one.pid for one in children if what in command_of(one) or name_of(one) == name), 0)


def name_of(process: psutil.Process) -> str:
    """The name that a process has given itself; "" if it has ended."""
    try:
        return process.name() if process.status() != psutil.STATUS_ZOMBIE else ""
    except psutil.NoSuchProcess:
        return ""


def command_of(process: psutil.Process) -> list[str]:
    """The command line of a process; empty if it has ended."""
    try:
        return process.cmdline() if process.status() != psutil.STATUS_ZOMBIE else []
    except psutil.NoSuchProcess:
        return []
