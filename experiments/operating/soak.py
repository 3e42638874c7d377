"""A run under constant requests through its control socket: what leaks, what is lost, what is refused and why.

`python experiments/operating/soak.py [--seconds 60] [--seed 1]` prints threads, descriptors and memory as it goes on.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import psutil
from cfgplan_runtime.operating.control_client import Control, connect
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.operating.protocol import RefusedError

from cfgplan import api

ONTOLOGY = """
@prefix : <https://example.org/field#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
:Robot a owl:Class . :Image a owl:Class . :of a owl:ObjectProperty . :piff a owl:NamedIndividual , :Robot .
"""
UNITS = """
def camera():
    number = 0
    while True:
        yield number
        number += 1
"""
ENVIRONMENT = """
format: cfgplan/1
ontology: field.ttl
transformations:
  - label: camera(${Robot})
    source: units.py:camera
    run: {rate: 100}
    outputs: {image: "Image and of value ${Robot}"}
targets:
  - {label: image, topic: /image, tag: Image and of value piff}
"""
ROBOT = """
individuals: {paff: Robot}
targets: [{label: paffs image, topic: /paff, tag: Image and of value paff}]
"""
TOLD_EVERY = 250


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    chance, refused = random.Random(options.seed), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        env = written(Path(name))
        with Operation(api.load(env), env, Settings(record=env.with_name("run.mcap"))) as operation:
            operation.begun.wait()
            end, requests = time.monotonic() + options.seconds, 0
            while time.monotonic() < end:
                if requests % TOLD_EVERY == 0:
                    tell(requests)
                with connect(operation.id) as control:
                    try:
                        disturb(control, operation, chance)
                    except RefusedError as error:
                        refused[error.message.partition("'")[0]] += 1
                requests += 1
            tell(requests)
    recorder = operation.recorder
    assert recorder is not None
    print(f"recorded {recorder.recording.written}, lost {recorder.lost + operation.dropped}; refused {dict(refused)}")
    print(f"threads afterwards: {threading.active_count()}")


def written(folder: Path) -> Path:
    (folder / "field.ttl").write_text(ONTOLOGY)
    (folder / "units.py").write_text(UNITS)
    (folder / "env.yaml").write_text(ENVIRONMENT)
    return folder / "env.yaml"


def disturb(control: Control, operation: Operation, chance: random.Random) -> None:
    units = [unit.id for unit in operation.runtime.environment.units]
    match chance.choice(["register", "leave", "kill", "look", "remove", "review"]):
        case "register":
            control.call("add", name="paff", text=ROBOT)
        case "leave":
            control.call("withdraw", name="paff")
        case "kill" if units:
            control.call("kill", unit=chance.choice(units))
        case "remove":
            control.call("remove_target", label="image")
            control.call("restore", name="image")
        case "review":
            control.subscribe()
            control.call("review")
        case _:
            control.call("state")


def tell(requests: int) -> None:
    me = psutil.Process()
    memory = me.memory_info().rss >> 20
    print(
        f"{requests:6} requests: {threading.active_count()} threads, {me.num_fds()} descriptors, {memory} MB",
        flush=True,
    )


if __name__ == "__main__":
    main()
