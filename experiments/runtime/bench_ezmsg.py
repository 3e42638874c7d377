"""One measurement with ezmsg, for `bench.py`: size in bytes, consumers, rate per second (0: flat out)."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import AsyncGenerator
from typing import Any

import ezmsg.core as ez
from measured_units import Ages, payload

SIZE, CONSUMERS, RATE_HZ = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])


class Source(ez.Unit):  # type: ignore[misc]
    """Gives stamped payloads."""

    OUTPUT = ez.OutputStream(list, num_buffers=32)

    @ez.publisher(OUTPUT)
    async def give(self) -> AsyncGenerator[Any, None]:
        data, due = payload(SIZE), time.monotonic()
        while True:
            yield self.OUTPUT, [time.monotonic_ns(), data]
            if RATE_HZ:
                due += 1 / RATE_HZ
                await asyncio.sleep(max(0.0, due - time.monotonic()))


class Sink(ez.Unit):  # type: ignore[misc]
    """Measures how old they are."""

    INPUT = ez.InputStream(list)

    async def initialize(self) -> None:
        self.ages = Ages(50 if RATE_HZ else 200)

    @ez.subscriber(INPUT)
    async def take(self, message: Any) -> None:
        report = self.ages(message)
        if report is not None and self.address.endswith("SINK0"):
            print(json.dumps(report), flush=True)


if __name__ == "__main__":
    components = {"SOURCE": Source()} | {f"SINK{number}": Sink() for number in range(CONSUMERS)}
    edges = tuple((components["SOURCE"].OUTPUT, components[f"SINK{number}"].INPUT) for number in range(CONSUMERS))
    ez.run(components=components, connections=edges, process_components=tuple(components.values()))
