"""The CPU cost of watching and recording a stream in the supervisor's process, and the effect on its reactions.

`python experiments/operating/cost.py [--kills 30]` prints a line for each stream, watched only and recorded.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from cfgplan_runtime.lifecycle.changes import KillUnit
from cfgplan_runtime.operating.operation import Operation, Settings

from cfgplan import api

STREAMS = {"4 B, 100 Hz": ("4", 100), "4 B, 1000 Hz": ("4", 1000), "460 kB images, 30 Hz": ("(480, 960)", 30)}
UNITS = """
import numpy

def camera():
    random = numpy.random.default_rng(1)
    image = random.integers(0, 255, {shape}, numpy.uint8)
    while True:
        yield image

def same(x):
    return x
"""
ENVIRONMENT = """
format: cfgplan/1
transformations:
  - {{label: camera, source: "units.py:camera", run: {{rate: {rate}}}, outputs: {{y: Y}}}}
  - {{label: same, source: "units.py:same", inputs: {{x: Y}}, outputs: {{z: Z}}}}
targets: [{{label: z, topic: /z, tag: Z}}]
"""
WATCHED_S = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=30)
    kills = parser.parse_args().kills
    print("| stream | | CPU of the supervisor | kill to restored, median | p99 | latency | recorded | lost |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (shape, rate) in STREAMS.items():
        for is_recorded in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                print(f"| {name} | {measured(Path(folder), shape, rate, kills, is_recorded=is_recorded)} |", flush=True)


def measured(folder: Path, shape: str, rate: int, kills: int, *, is_recorded: bool) -> str:
    (folder / "units.py").write_text(UNITS.format(shape=shape))
    env = folder / "env.yaml"
    env.write_text(ENVIRONMENT.format(rate=rate))
    file = folder / "run.mcap" if is_recorded else None
    with Operation(api.load(env), env, Settings(record=file)) as operation:
        operation.begun.wait()
        time.sleep(1.0)
        cpu, began = time.process_time(), time.perf_counter()
        time.sleep(WATCHED_S)
        share = (time.process_time() - cpu) / (time.perf_counter() - began)
        latency_ms = operation.flows.now()["/z"].latency_ms
        took = sorted(reaction_s(operation) for _ in range(kills))
        recorder = operation.recorder
    counts = "|" if recorder is None else f"{recorder.recording.written} | {recorder.lost + operation.dropped}"
    reactions = f"{statistics.median(took) * 1e3:.0f} ms | {took[-1 - len(took) // 100] * 1e3:.0f} ms"
    return f"{'recorded' if is_recorded else 'watched'} | {share:.1%} | {reactions} | {latency_ms} ms | {counts}"


def reaction_s(operation: Operation) -> float:
    """Return the seconds from a unit's kill until its replacement is connected."""
    time.sleep(0.2)
    unit = next(unit.id for unit in operation.runtime.environment.units if unit.transformation == "same")
    began = time.perf_counter()
    operation.manager.request(KillUnit(unit)).result()
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
