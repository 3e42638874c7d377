"""The errors of the ball's positions on running units: with one robot, then with both and their fusion.

python experiments/nao/live.py [--seconds 60]
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path

import pipelines
from cfgplan_runtime import Runtime, subscribe

import cfgplan

MODELS = Path(__file__).parents[2] / "models" / "nao"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    head, rule = pipelines.HEAD.splitlines()
    print(f"{head} rate | age | CPU of all units |\n{rule}---|---|---|")
    for stage, stream in (("1-piff-registered", "piff"), ("5-fusion-required", "both, fused")):
        _run(stage, stream, options.seconds)


def _run(stage: str, stream: str, seconds: float) -> None:
    world = cfgplan.load(MODELS / f"{stage}.yaml")
    empty = replace(world.environment, units=())
    problem = cfgplan.match(replace(world, environment=empty, file=None))
    plan = cfgplan.plan(problem)
    assert plan.change_set is not None
    errors, ages, times = [], [], []
    with Runtime(empty.library, empty.targets, folder=MODELS) as runtime:
        runtime.apply(plan.change_set)
        with subscribe("/result", run=runtime.id, timeout_s=30) as subscription:
            elements = iter(subscription)
            next(elements)
            runtime.observe()
            end = time.monotonic() + seconds
            for received in elements:
                errors.append(pipelines.error(received.value, received.time_ns))
                ages.append(time.time_ns() - received.time_ns)
                times.append(received.time_ns)
                if time.monotonic() > end:
                    break
        cpu = sum(observed.upkeep_us or 0 for observed in runtime.observe()) / 1e6
        runtime.stop()
    rate = (len(times) - 1) * 1e9 / (times[-1] - times[0])
    age = statistics.median(ages) / 1e6
    print(f"| {stream} | {pipelines.summary(errors)} | {rate:.2f} Hz | {age:.0f} ms | {cpu:.2f} s/s |")


if __name__ == "__main__":
    main()
