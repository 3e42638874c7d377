"""An environment for tests of `cfgplan run`, its unit code, and the command as users call it."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from warm import cold_command as command

PATIENCE_S = 60.0
"""Far longer than anything takes on the slowest machine."""

ONTOLOGY = """
@prefix : <https://example.org/field#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
<https://example.org/field> a owl:Ontology .
:Robot a owl:Class . :Image a owl:Class . :Ball a owl:Class . :Goal a owl:Class .
:Field a owl:Class . :Position a owl:Class .
:of a owl:ObjectProperty . :nextTo a owl:ObjectProperty .
:field1 a owl:NamedIndividual , :Field .
:piff a owl:NamedIndividual , :Robot .
"""
ENVIRONMENT = """\
format: cfgplan/1
ontology: field.ttl
horizon: 600
transformations:
  - label: camera(${Robot})
    source: units.py:camera
    run: {rate: 100}
    labor: 0.1
    upkeep: 0.01
    outputs: {image: "Image and of value ${Robot}"}
  - label: detector(${Robot})
    source: units.py:Detector
    params: {robot: "${Robot}"}
    labor: 0.1
    upkeep: 0.01
    inputs: {image: "Image and of value ${Robot}"}
    outputs: {ball: "Ball and of value ${Robot}"}
targets:
  - {label: ball, topic: /result, tag: Ball}
"""
UNITS = """\
import numpy

def camera():
    number = 0
    while True:
        yield numpy.full((32, 32), number % 200, numpy.uint8)
        number += 1

class Detector:
    def __init__(self, robot):
        self.robot = robot

    def __call__(self, image):
        return {"robot": self.robot, "number": int(image[0, 0]), "image": image}
"""
ROBOT = """\
individuals: {paff: Robot}
targets:
  - {label: paffs ball, topic: /paff, tag: Ball and of value paff}
"""


def write_world(folder: Path) -> Path:
    """The environment file, with everything beside it."""
    (folder / "field.ttl").write_text(ONTOLOGY)
    (folder / "units.py").write_text(UNITS)
    path = folder / "env.yaml"
    path.write_text(ENVIRONMENT)
    return path


Call = Callable[..., list[str]]
"""The command line of `cfgplan` for arguments: `command` or `cold_command` of tests/warm.py."""


@contextmanager
def running(
    *arguments: object, call: Call = command, start: Callable[..., Any] = subprocess.Popen
) -> Iterator[subprocess.Popen[str]]:
    """`cfgplan run --json`, once it runs; killed at the end if it still does. `start` may be that of warm processes.

    It plans with declared costs, unless it keeps estimates: a cost that is learned within the test changes its plans.
    """
    costs = () if "--estimates" in arguments else ("--no-estimates", "--estimator", "declared")
    line = call("run", "--json", *costs, *arguments)
    with start(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def await_event(process: subprocess.Popen[str], event: str, **facts: Any) -> dict[str, Any]:
    """The next event of a kind with these facts that a run prints."""
    assert process.stdout is not None
    for line in process.stdout:
        told: dict[str, Any] = json.loads(line)
        assert "event" in told, f"the run did not begin: {line}"
        if told["event"] == event and all(told.get(key) == value for key, value in facts.items()):
            return told
    raise AssertionError(f"the run ended without {event}: {process.stderr.read() if process.stderr else ''}")


def eventually(is_so: Callable[[], object]) -> None:
    """Wait until something is so; fails if it never is."""
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline, "it never came to be"
        time.sleep(0.02)
