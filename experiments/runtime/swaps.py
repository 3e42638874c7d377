"""Hundreds of swaps under load, each checked to lose, repeat and reorder nothing. Some hand over a state.

python experiments/runtime/swaps.py [--swaps 300]
"""

from __future__ import annotations

import argparse
import statistics
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from cfgplan_runtime import Runtime, subscribe

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)

NUMBERS, STEPS, IMAGES = "numbers", "steps of a state", "images of 460 kB"
LOADS = (
    *((load, rate_hz) for load in (NUMBERS, STEPS) for rate_hz in (30.0, 200.0, 1000.0)),
    (IMAGES, 30.0),
    (IMAGES, 100.0),
)


def swaps(load: str, rate_hz: float, count: int) -> None:
    """Swap the unit between a source and a target `count` times; prints what came of it."""
    is_image = load == IMAGES
    code = "images" if is_image else "count"
    work, run = ("Steps", RunOptions(state=True)) if load == STEPS else ("same", RunOptions())
    library = (
        Transformation(
            "source",
            outputs=(OutputPort("n", "N"),),
            source=f"measured_units.py:{code}",
            run=RunOptions(rate_hz=rate_hz),
        ),
        Transformation(
            "work", (InputPort("x", "N"),), (OutputPort("y", "N"),), source=f"measured_units.py:{work}", run=run
        ),
    )
    numbers: list[int] = []
    times: list[int] = []
    came_s: list[float] = []
    updates: list[tuple[float, float]] = []
    """When each swap began and ended."""
    switch_ms: list[float] = []
    with Runtime(library, [Target("t", "N", "/result")], folder=Path(__file__).parent) as runtime:
        runtime.apply(ChangeSet(started=(ComputationUnit("source.1", "source"), _work(1))))
        subscription = subscribe("/result", run=runtime.id)

        def collect() -> None:
            for received in subscription:
                numbers.append(int(received.value[0, 0]) if is_image else received.value)
                times.append(received.time_ns)
                came_s.append(time.monotonic())

        listener = threading.Thread(target=collect)
        listener.start()
        unswitched = 0
        for number in range(2, count + 2):
            began_s = time.monotonic()
            applied = runtime.apply(ChangeSet(started=(_work(number),), stopped=(f"work.{number - 1}",)))
            switch_ms.append(applied.seconds["rewire"] * 1000)
            updates.append((began_s, time.monotonic()))
            unswitched += applied.unswitched
        time.sleep(2 / rate_hz + 0.2)
    listener.join()
    steps = {(after - before) % (256 if is_image else 1 << 62) for before, after in pairwise(numbers)}
    ordered = all(before < after for before, after in pairwise(times))
    middle, worst = statistics.median(switch_ms), max(switch_ms)
    silences_ms = [1000 * _longest_silence_s(came_s, *update) for update in updates]
    print(
        f"{rate_hz:6.0f} Hz {load:17} {count} swaps, {len(numbers):6} elements, "
        f"switch {middle:.1f} ms (worst {worst:.0f}), "
        f"longest silence {statistics.median(silences_ms):.1f} ms (worst {max(silences_ms):.0f}), "
        f"dropped {subscription.dropped}, steps {sorted(steps)}, unswitched {unswitched}",
        flush=True,
    )
    assert steps == {1}, "something was lost or repeated"
    assert ordered, "something was reordered"


def _longest_silence_s(came_s: list[float], began_s: float, ended_s: float) -> float:
    """The longest time between two elements that lies at least in part in a swap."""
    return max(
        (after - before for before, after in pairwise(came_s) if after >= began_s and before <= ended_s), default=0.0
    )


def _work(number: int) -> ComputationUnit:
    feed: tuple[Any, ...] = (Subscription("x", Stream("source.1", "n")),)
    return ComputationUnit(f"work.{number}", "work", feed, (Publication("y", "/result"),))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--swaps", type=int, default=300)
    options = parser.parse_args()
    for load, rate_hz in LOADS:
        swaps(load, rate_hz, options.swaps)


if __name__ == "__main__":
    main()
