"""The runtime's channels and updates against multiprocessing.Queue, ezmsg and dora-rs, in one run on this machine.

python experiments/runtime/bench.py [--seconds 2] [--json FILE]

Every figure is a median; read them as ratios. `latency` is from unit code to unit code at 200 Hz, `throughput` flat
out with a consumer that makes the producer wait, `fan-out` the latency with 4 consumers.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
from cfgplan_runtime import Runtime, subscribe
from cfgplan_runtime.supervision.events import UnitDied
from measured_units import Ages, payload
from running_pid import running_pid

from cfgplan import api
from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)

HERE = Path(__file__).parent
SIZES = (100, 10_000, 460_000)
RATE_HZ = 200.0
FAN_OUT = 4
MEASURES = (("latency", 1, RATE_HZ), ("fan-out", FAN_OUT, RATE_HZ), ("throughput", 1, None))
TARGET = Target("t", "N", "/result")

Row = dict[str, Any]


def of_runtime(size: int, consumers: int, rate_hz: float | None, seconds: float) -> tuple[float, float]:
    """Median age in microseconds and elements per second at one consumer."""
    blocks = rate_hz is None
    every = 50 if rate_hz else 200
    library = (
        Transformation(
            "source",
            outputs=(OutputPort("n", "N"),),
            source="measured_units.py:stamped",
            params={"size": size},
            run=RunOptions(rate_hz=rate_hz),
        ),
        Transformation(
            "ages",
            (InputPort("x", "N"),),
            (OutputPort("y", "N"),),
            source="measured_units.py:Ages",
            params={"every": every},
            run=RunOptions(blocks=blocks, queue=16 if blocks else 256),
        ),
    )
    with Runtime(library, [TARGET], folder=HERE) as runtime:
        stream = (Subscription("x", Stream("source.1", "n")),)
        sinks = [ComputationUnit("ages.1", "ages", stream, (Publication("y", "/result"),))]
        sinks += [ComputationUnit(f"ages.{number}", "ages", stream) for number in range(2, consumers + 1)]
        runtime.apply(ChangeSet(started=(ComputationUnit("source.1", "source"), *sinks)))
        with subscribe("/result", run=runtime.id) as results:
            return _measured(((received.value) for received in results), seconds)


def _measured(reports: Any, seconds: float) -> tuple[float, float]:
    """Return median age and rate from reports (count, median age, 99th percentile, time), after the first report."""
    first = next(reports)
    medians: list[float] = []
    count = 0
    for report in reports:
        count += report[0]
        medians.append(report[1])
        if report[3] - first[3] >= seconds * 1e9:
            return statistics.median(medians), count / ((report[3] - first[3]) / 1e9)
    raise RuntimeError("the reports ended")


def of_queue(size: int, consumers: int, rate_hz: float | None, seconds: float) -> tuple[float, float]:
    """The same with a multiprocessing.Queue for each consumer."""
    context = multiprocessing.get_context("spawn")
    queues = [context.Queue(16 if rate_hz is None else 256) for _ in range(consumers)]
    reports = context.Queue()
    every = 50 if rate_hz else 200
    processes = [context.Process(target=_put, args=(queues, size, rate_hz), daemon=True)]
    processes += [
        context.Process(target=_get, args=(queue, reports if number == 0 else None, every), daemon=True)
        for number, queue in enumerate(queues)
    ]
    for process in processes:
        process.start()
    try:
        return _measured(iter(reports.get, None), seconds)
    finally:
        for process in processes:
            process.kill()
            process.join()


def _put(queues: Any, size: int, rate_hz: float | None) -> None:
    data, due = payload(size), time.monotonic()
    while True:
        stamp = time.monotonic_ns()
        for queue in queues:
            queue.put([stamp, data])
        if rate_hz is not None:
            due += 1 / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))


def _get(queue: Any, reports: Any, every: int) -> None:
    ages = Ages(every)
    while True:
        report = ages(queue.get())
        if report is not None and reports is not None:
            reports.put(report)


def of_ezmsg(size: int, consumers: int, rate_hz: float | None, seconds: float) -> tuple[float, float]:
    """The same with ezmsg units in processes of their own. Raises ImportError where it is not installed."""
    import ezmsg.core  # noqa: F401

    return _of_script("bench_ezmsg.py", size, consumers, rate_hz, seconds)


def of_dora(size: int, consumers: int, rate_hz: float | None, seconds: float) -> tuple[float, float]:
    """The same with dora-rs nodes. Raises ImportError where it, its command or pyarrow is not installed."""
    import dora  # noqa: F401
    import pyarrow  # noqa: F401

    if not Path(sys.executable).with_name("dora").exists():
        raise ImportError("dora-rs-cli")
    return _of_script("bench_dora.py", size, consumers, rate_hz, seconds)


def _of_script(script: str, size: int, consumers: int, rate_hz: float | None, seconds: float) -> tuple[float, float]:
    command = [sys.executable, str(HERE / script), str(size), str(consumers), str(rate_hz or 0)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        try:
            return _measured((json.loads(line) for line in process.stdout if line.startswith("[")), seconds)
        finally:
            for one in [*psutil.Process(process.pid).children(recursive=True), process]:
                one.kill()


SYSTEMS: dict[str, Callable[[int, int, float | None, float], tuple[float, float]]] = {
    "cfgplan": of_runtime,
    "multiprocessing.Queue": of_queue,
    "ezmsg": of_ezmsg,
    "dora-rs": of_dora,
}


def channels(seconds: float) -> list[Row]:
    rows: list[Row] = []
    for size in SIZES:
        for what, consumers, rate_hz in (
            ("latency", 1, RATE_HZ),
            ("fan-out", FAN_OUT, RATE_HZ),
            ("throughput", 1, None),
        ):
            row: Row = {"what": what, "bytes": size}
            for system, measure in SYSTEMS.items():
                try:
                    age_us, per_s = measure(size, consumers, rate_hz, seconds)
                except (ImportError, RuntimeError, StopIteration):
                    continue
                row[system] = per_s if what == "throughput" else age_us
            rows.append(row)
            _print_row(row)
    return rows


def _print_row(row: Row) -> None:
    unit = "/s" if row["what"] == "throughput" else "us"
    base = row["cfgplan"]
    parts = [f"{name} {value:,.0f} {unit}" for name, value in row.items() if name in SYSTEMS]
    ratios = [
        f"{name} {(base / value if unit == '/s' else value / base):.1f}x"
        for name, value in row.items()
        if name in SYSTEMS and name != "cfgplan"
    ]
    print(
        f"{row['what']:10} {row['bytes']:7,} B  {', '.join(parts)}  | cfgplan better than {', '.join(ratios)}",
        flush=True,
    )


def updates(times: int) -> list[Row]:
    """Load, switch and unload of one unit in a running chain; from kill -9 to the first new result, with planning."""
    library = (
        Transformation(
            "count", (), (OutputPort("n", "N"),), source="measured_units.py:count", run=RunOptions(rate_hz=1000)
        ),
        Transformation("same", (InputPort("x", "N"),), (OutputPort("y", "Y"),), source="measured_units.py:same"),
    )
    target = Target("t", "Y", "/result")
    environment = Environment((), library, (target,))
    seconds: dict[str, list[float]] = {"load": [], "switch": [], "unload": [], "kill to result": []}
    with Runtime(library, [target], folder=HERE) as runtime:
        similarity = api.match_ports(api.world(environment, horizon_s=60)).similarity
        runtime.apply(_plan(environment, similarity), basis=environment)
        with subscribe("/result", run=runtime.id) as subscription:
            results = iter(subscription)
            next(results)
            for number in range(2, times + 2):
                old, new = (_same(one) for one in (number - 1, number))
                applied = runtime.apply(ChangeSet(started=(new,), stopped=(old.id,)))
                for name, phase in (("load", "start"), ("switch", "rewire"), ("unload", "stop")):
                    seconds[name].append(applied.seconds[phase])
            for _ in range(times):
                unit = next(one for one in runtime.environment.units if one.transformation == "same")
                seconds["kill to result"].append(_mend(runtime, similarity, unit.id, results))
    return [{"what": name, "ms": statistics.median(values) * 1000} for name, values in seconds.items()]


def _mend(runtime: Runtime, similarity: Any, unit: str, results: Any) -> float:
    """Seconds from the kill to the first element that the new unit has given."""
    begin, begin_ns = time.monotonic(), time.time_ns()
    os.kill(running_pid(runtime, unit), signal.SIGKILL)
    while not isinstance(runtime.events.get(timeout=30), UnitDied):
        pass
    found_ns = time.time_ns()
    environment = runtime.environment
    runtime.apply(_plan(environment, similarity), basis=environment)
    for received in results:
        if received.time_ns > max(found_ns, begin_ns):
            return time.monotonic() - begin
    raise RuntimeError("the run ended")


def _plan(environment: Environment, similarity: Any) -> ChangeSet:
    from cfgplan.planning import Problem

    change_set = api.plan(Problem(environment, similarity, horizon_s=60)).change_set
    assert change_set is not None
    return change_set


def _same(number: int) -> ComputationUnit:
    feed = (Subscription("x", Stream("count.1", "n")),)
    return ComputationUnit(f"same.{number}", "same", feed, (Publication("y", "/result"),))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0, help="how long each figure is measured")
    parser.add_argument("--updates", type=int, default=50, help="how many updates and kills")
    parser.add_argument("--json", metavar="FILE", help="write all figures to FILE")
    options = parser.parse_args()
    rows = updates(options.updates)
    for row in rows:
        print(f"{row['what']:15} {row['ms']:.1f} ms", flush=True)
    rows += channels(options.seconds)
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
