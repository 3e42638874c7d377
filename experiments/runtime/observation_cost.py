"""The cost of observing: CPU of an idle unit, and of one look at all units.

python experiments/runtime/observation_cost.py
"""

from __future__ import annotations

import time
from pathlib import Path

from cfgplan_runtime import Runtime

from cfgplan.domain import ChangeSet, ComputationUnit, InputPort, OutputPort, Transformation

UNITS = 20
LOOKS = 200
IDLE_S = 5.0


def main() -> None:
    idle = Transformation("idle", (InputPort("x", "N"),), (OutputPort("y", "N"),), source="measured_units.py:same")
    with Runtime([idle], folder=Path(__file__).parent) as runtime:
        runtime.apply(ChangeSet(started=tuple(ComputationUnit(f"idle.{n}", "idle") for n in range(UNITS))))
        runtime.observe()
        time.sleep(IDLE_S)
        seen = runtime.observe()
        upkeep = sum(one.upkeep_us or 0 for one in seen) / len(seen)
        memory = sum(one.memory_bytes for one in seen) / len(seen)
        start = time.monotonic()
        for _ in range(LOOKS):
            runtime.observe()
        each_us = (time.monotonic() - start) / LOOKS / UNITS * 1e6
        print(f"idle unit: {upkeep:.0f} us of CPU per second ({upkeep / 1e4:.2f} %), {memory / 2**20:.1f} MB")
        print(f"one look: {each_us:.0f} us per unit")


if __name__ == "__main__":
    main()
