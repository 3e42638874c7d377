"""Memory on a long stream: `python experiments/reasoning/memory.py --states 1000000`.

For each formula the size of the obligation that is left (largest and last), what the monitor remembers, and the
process's memory after a tenth of the stream and after all of it. Each formula has a process of its own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time

import psutil
from cfgplan_runtime.reasoning.monitor import Monitor
from formulas import MEASURED, columns, times, truths

_PIECES = 100


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=1_000_000)
    parser.add_argument("--rate", type=int, default=30, help="states a second of the stream's time")
    options = parser.parse_args()
    print(
        f"| `always (...)` of, {options.states:,} states, {options.rate} a second, irregular "
        "| nodes left, at most | remembered | MB after a tenth | MB after all | CPU s |"
    )
    print("|---|---|---|---|---|---|")
    for number in range(len(MEASURED)):
        context = multiprocessing.get_context("spawn")
        with context.Pool(1) as pool:
            print(pool.apply(_row, (number, options.states, options.rate)), flush=True)


def _row(number: int, states: int, rate: int) -> str:
    measured = MEASURED[number]
    monitor = Monitor(measured.formula)
    at = times(states, rate, 1, jitter=True)
    values = truths(monitor, columns(measured, states, rate, 1))
    me = psutil.Process()
    largest, memory = 0, []
    begin = time.process_time()
    for segment in range(_PIECES):
        part = slice(segment * states // _PIECES, (segment + 1) * states // _PIECES)
        if monitor.feed(at[part], values[part]) != "open":
            raise SystemExit(f"the verdict of {measured.name} became {monitor.verdict}")
        largest = max(largest, monitor.size)
        memory.append(me.memory_info().rss >> 20)
    took = time.process_time() - begin
    early, late = memory[_PIECES // 10 - 1], memory[-1]
    return f"| `{measured.name}` | {largest} | {monitor.remembered:,} | {early} | {late} | {took:.1f} |"


if __name__ == "__main__":
    main()
