"""The CPU time and the memory of units that send no elements.

`python experiments/operating/idle.py [--units 100] [--for 20]` starts `cfgplan run` on so many targets, each with a
unit of its own behind one slow source, and prints a line for each kind of process: CPU time in percent of a core, and
memory (proportional set size: shared pages count in parts).
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import psutil

UNITS = """
def seldom():
    while True:
        yield 1

def same(x):
    return x
"""
SOURCE = """format: cfgplan/1
transformations:
  - {label: seldom, source: "units.py:seldom", run: {rate: 0.001}, outputs: {y: Y}}
"""
WORKER = '  - {{label: same{0}, source: "units.py:same", inputs: {{x: Y}}, outputs: {{z: Z{0}}}}}\n'
TARGET = "  - {{label: z{0}, topic: /z{0}, tag: Z{0}}}\n"
SETTLED_S = 5.0
"""Seconds after the last start until the measurement begins."""
START_S = 120.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=100)
    parser.add_argument("--for", type=float, default=20.0, dest="seconds")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "units.py").write_text(UNITS)
        numbers = range(arguments.units)
        targets = "targets:\n" + "".join(TARGET.format(number) for number in numbers)
        (folder / "env.yaml").write_text(SOURCE + "".join(WORKER.format(number) for number in numbers) + targets)
        command = [str(Path(sys.executable).with_name("cfgplan")), "run", "env.yaml", "--plain", "--yes"]
        with (folder / "out.txt").open("w") as out:
            run = subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT)
        try:
            await_units(run, arguments.units + 1, folder / "out.txt")
            show(run.pid, arguments.seconds)
        finally:
            run.send_signal(signal.SIGINT)
            run.wait()


def await_units(run: subprocess.Popen[bytes], number: int, out: Path) -> None:
    """Wait until `number` units of the run have started. Raises SystemExit with the run's output if it ends before."""
    end_s = time.monotonic() + START_S
    while len(kinds(run.pid)["unit"]) < number:
        if run.poll() is not None or time.monotonic() > end_s:
            sys.exit(f"the run has not started {number} units:\n{out.read_text()}")
        time.sleep(0.5)
    time.sleep(SETTLED_S)


def kinds(run: int) -> dict[str, list[psutil.Process]]:
    """Return the processes of a run by kind: unit, outlets, nursery, manager."""
    found: dict[str, list[psutil.Process]] = defaultdict(list)
    manager = psutil.Process(run)
    found["manager"].append(manager)
    for process in manager.children(recursive=True):
        title = process.cmdline()[:1]
        last = title[0].rsplit(" ", 1)[-1] if title else ""
        found[last if last in ("nursery", "outlets") else "unit"].append(process)
    return found


def show(run: int, seconds: float) -> None:
    by_kind = kinds(run)
    before = {kind: sum(map(cpu_s, processes)) for kind, processes in by_kind.items()}
    wakes = {kind: sum(map(switches, processes)) for kind, processes in by_kind.items()}
    began = time.monotonic()
    time.sleep(seconds)
    took_s = time.monotonic() - began
    print("| processes | number | CPU, % of a core | wakes a second, each | memory, MB each |")
    print("|---|---|---|---|---|")
    total = 0.0
    for kind, processes in by_kind.items():
        share = (sum(map(cpu_s, processes)) - before[kind]) / took_s
        woken = (sum(map(switches, processes)) - wakes[kind]) / took_s / len(processes)
        memory_mb = sum(process.memory_full_info().pss for process in processes) / len(processes) / 1e6
        total += share
        print(f"| {kind} | {len(processes)} | {share:.2%} | {woken:.1f} | {memory_mb:.1f} |")
    print(f"| all | | {total:.2%} | | |")


def cpu_s(process: psutil.Process) -> float:
    """Return the CPU time of a process in seconds, at a finer resolution than the system's ticks."""
    return time.clock_gettime_ns(~process.pid << 3 | 2) / 1e9


def switches(process: psutil.Process) -> int:
    """Return the number of voluntary context switches of a process's threads."""
    counts = 0
    for thread in Path(f"/proc/{process.pid}/task").iterdir():
        for line in (thread / "status").read_text().splitlines():
            if line.startswith("voluntary_ctxt_switches"):
                counts += int(line.split()[1])
    return counts


if __name__ == "__main__":
    main()
