"""An environment file whose life-cycle runs on real processes, judged by what comes out on its topics."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml
from cfgplan_runtime import Manager, Policy, Received, Runtime, subscribe, watch_file
from cfgplan_runtime.lifecycle.reports import Perturbed, Report, Review, Reviewed, WorldRefused

from cfgplan import api

PATIENCE_S = 60.0
"""Far longer than anything takes on the slowest machine."""

UNITS = '''
"""Unit code: each worker says who it is."""

import time


def count():
    number = 0
    while True:
        yield number
        number += 1


class Worker:
    def __init__(self, name, deed=""):
        self.name = name
        self.deed = deed
        if deed == "start slowly":
            time.sleep(4)
        if deed == "die at start":
            raise ValueError("no such device")

    def __call__(self, x):
        if self.deed == "hang":
            time.sleep(3600)
        if self.deed == "raise":
            raise ValueError("bad luck")
        return [self.name, x if isinstance(x, int) else x[1]]
'''

PROGRAM = '''
"""The worker as a program, which knows nothing of cfgplan. It writes lines of JSON, or frames of msgpack if told so."""

import json, os, sys

params = json.loads(os.environ["CFGPLAN_PARAMS"])
standard_input, is_msgpack = sys.stdin.buffer, sys.argv[1:] == ["msgpack"]
if is_msgpack:
    import msgspec


def say(message):
    written = json.dumps(message).encode() + b"\\n"
    if is_msgpack:
        body = msgspec.msgpack.encode(message)
        written = b"\\xc1CFG" + (len(body) + 4).to_bytes(4, "little") + len(body).to_bytes(4, "little") + body
    sys.stdout.buffer.write(written)
    sys.stdout.buffer.flush()


def requests():
    while not is_msgpack and (line := standard_input.readline()):
        yield json.loads(line)
    while is_msgpack and (head := standard_input.read(8)):
        yield msgspec.msgpack.decode(standard_input.read(int.from_bytes(head[4:], "little"))[4:])


if params.get("deed") == "die at start":
    sys.exit("no such device")
say({"ready": True})
for request in requests():
    x = request["inputs"]["x"]
    say({"step": request["step"], "outputs": {"y": [params["name"], x if isinstance(x, int) else x[1]]}})
'''
PROGRAMS = {form: f"program:{sys.executable} worker_program.py {form}" for form in ("json", "msgpack")}
"""The source of the program in each format."""

Transformations = dict[str, dict[str, Any]]


def source(label: str = "count", *, tag: str = "N", rate: int = 200, **more: Any) -> Transformations:
    return {label: {"source": "units.py:count", "run": {"rate": rate}, "outputs": {"n": tag}, "labor": 0.1, **more}}


def worker(
    label: str = "work", *, needs: str = "N", gives: str = "Y", deed: str = "", upkeep: float = 0.01, **more: Any
) -> Transformations:
    params = {"name": label, "deed": deed}
    ports = {"inputs": {"x": needs}, "outputs": {"y": gives}}
    return {label: {"source": "units.py:Worker", "params": params, **ports, "labor": 0.1, "upkeep": upkeep, **more}}


class Listener:
    """Collects what comes on a topic, in a thread."""

    def __init__(self, topic: str) -> None:
        self.received: list[Received] = []
        self._subscription = subscribe(topic, wait_s=PATIENCE_S)
        self._thread = threading.Thread(target=self._collect, daemon=True)
        self._thread.start()

    def _collect(self) -> None:
        self.received.extend(self._subscription)

    def join(self) -> None:
        self._thread.join(PATIENCE_S)


class RealRun:
    """Writes an environment file, runs it, changes it."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "env.yaml"
        self.reports: list[Report] = []
        self._stack = ExitStack()
        self._listeners: dict[str, Listener] = {}
        (folder / "units.py").write_text(UNITS)
        (folder / "worker_program.py").write_text(PROGRAM)

    def write(
        self, *parts: Transformations, horizon: int = 600, targets: dict[str, str] | None = None, **more: Any
    ) -> None:
        """Write the file as editors do: a new one that takes the old one's place. `more` stands at its top."""
        library = [{"label": label, **rest} for part in parts for label, rest in part.items()]
        wanted = [
            {"label": topic.strip("/"), "topic": topic, "tag": tag}
            for topic, tag in (targets or {"/result": "Y"}).items()
        ]
        text = yaml.safe_dump(
            {"format": "cfgplan/1", "horizon": horizon, **more, "transformations": library, "targets": wanted}
        )
        self.write_text(text)

    def write_text(self, text: str) -> None:
        new = self.file.with_suffix(".new")
        new.write_text(text)
        new.replace(self.file)

    def start(self, *parts: Transformations, policy: Policy | None = None, **more: Any) -> None:
        """Write the file, run it, and wait until /result gives something."""
        self.write(*parts, **more)
        self.runtime = self._stack.enter_context(Runtime(folder=self.file.parent))
        self.manager = Manager(api.load(self.file), self.runtime, policy=policy, report=self.reports.append)
        self._stack.enter_context(self.manager)
        self._stack.enter_context(watch_file(self.file, self.manager))
        self.await_result()

    def close(self) -> None:
        self._stack.close()
        for listener in self._listeners.values():
            listener.join()

    def listener(self, topic: str = "/result") -> Listener:
        if topic not in self._listeners:
            self._listeners[topic] = Listener(topic)
        return self._listeners[topic]

    def providers(self, since: int = 0, topic: str = "/result") -> list[str]:
        """Who gave the elements of a topic, from the one with this position on."""
        return [received.value[0] for received in self.listener(topic).received[since:]]

    def await_result(self, provider: str | None = None, topic: str = "/result", more: int = 5) -> None:
        """Wait until a topic has given some more elements, by this transformation if one is named."""
        since = len(self.listener(topic).received)

        def has_come() -> bool:
            new = self.providers(since, topic)
            return sum(1 for each in new if provider in (None, each)) >= more

        eventually(has_come)

    def kill(self, unit: str) -> None:
        pid = self.runtime.pid(unit)
        assert pid is not None
        os.kill(pid, signal.SIGKILL)

    @property
    def reviews(self) -> list[Review]:
        return [report.review for report in list(self.reports) if isinstance(report, Reviewed)]

    @property
    def refused(self) -> list[WorldRefused]:
        return [report for report in list(self.reports) if isinstance(report, WorldRefused)]

    def seen(self, kind: type) -> list[Any]:
        return [
            report.perturbation
            for report in list(self.reports)
            if isinstance(report, Perturbed) and isinstance(report.perturbation, kind)
        ]


def eventually(is_so: Callable[[], object]) -> None:
    """Wait until something is so; fails if it never is."""
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline, "it never came to be"
        time.sleep(0.01)
