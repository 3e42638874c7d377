"""Hundreds of swaps under load, each checked to lose, repeat and reorder nothing.

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

IMAGES = "images of 460 kB"
LOADS = (("numbers", 30.0), ("numbers", 200.0), ("numbers", 1000.0), (IMAGES, 30.0), (IMAGES, 100.0))


def swaps(load: str, rate_hz: float, count: int) -> None:
    """Swap the unit between a source and a target `count` times; prints what came of it."""
    is_image = load != "numbers"
    code = "images" if is_image else "count"
    library = (
        Transformation(
            "source",
            outputs=(OutputPort("n", "N"),),
            source=f"measured_units.py:{code}",
            run=RunOptions(rate_hz=rate_hz),
        ),
        Transformation("work", (InputPort("x", "N"),), (OutputPort("y", "N"),), source="measured_units.py:same"),
    )
    numbers: list[int] = []
    times: list[int] = []
    switch_ms: list[float] = []
    with Runtime(library, [Target("t", "N", "/result")], folder=Path(__file__).parent) as runtime:
        runtime.apply(ChangeSet(started=(ComputationUnit("source.1", "source"), _work(1))))
        subscription = subscribe("/result", run=runtime.id)

        def collect() -> None:
            for received in subscription:
                numbers.append(int(received.value[0, 0]) if is_image else received.value)
                times.append(received.time_ns)

        listener = threading.Thread(target=collect)
        listener.start()
        unswitched = 0
        for number in range(2, count + 2):
            applied = runtime.apply(ChangeSet(started=(_work(number),), stopped=(f"work.{number - 1}",)))
            switch_ms.append(applied.seconds["rewire"] * 1000)
            unswitched += applied.unswitched
        time.sleep(2 / rate_hz + 0.2)
    listener.join()
    steps = {(after - before) % (256 if is_image else 1 << 62) for before, after in pairwise(numbers)}
    ordered = all(before < after for before, after in pairwise(times))
    middle, worst = statistics.median(switch_ms), max(switch_ms)
    print(
        f"{rate_hz:6.0f} Hz {load:17} {count} swaps, {len(numbers):6} elements, "
        f"switch {middle:.1f} ms (worst {worst:.0f}), dropped {subscription.dropped}, "
        f"steps {sorted(steps)}, unswitched {unswitched}",
        flush=True,
    )
    assert steps == {1}, "something was lost or repeated"
    assert ordered, "something was reordered"


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
