"""Moving a live subscription of an unmodified node to another topic, without a relay: an experiment beside the product.

    CFGPLAN_ROS_PYTHON=ros/bin/python python experiments/ros2/moving.py [--moves 40]

The camera, the detectors and the tracker are those of `switches.py`. `shim.c`, compiled by `cc` and preloaded into the
tracker, moves its subscription from one detector to the other: with a hand-over by stamp, and by a cut. The run's relay
does the same beside it. The same tracker without the shim says what the shim costs. Needs a compiler and ROS's headers.
"""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path

from cfgplan_runtime.processes.child_process import cpu_us
from cfgplan_runtime.ros2.fast_dds import FastDdsProfiles
from cfgplan_runtime.ros2.ros_python import RosPython, ros_python

sys.path.append(str(Path(__file__).parents[2]))
from experiments.ros2.switches import DELAYS_S, RATE_HZ, Heard, heard
from experiments.workers import eventually

HERE = Path(__file__).parent
STAMP, CUT, RELAY = "shim, hand-over by stamp", "shim, cut", "relay"
WAYS = {STAMP: "stamp", CUT: "cut"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=40)
    number = parser.parse_args().moves
    print(f"load {os.getloadavg()[0]:.1f}; {number} moves each")
    print("| way | got | lost | repeated | back | longest gap, ms | a move, ms: median (worst) |")
    print("|---|---|---|---|---|---|---|")
    costs_us = {}
    for way in (*WAYS, RELAY):
        if way == RELAY:
            found = heard("stamped", number)
        else:
            found, costs_us[way] = moved(WAYS[way], number)
        took_ms = [1e3 * seconds for seconds in found.switch_s]
        figures = (len(found.numbers), found.lost, found.repeated, found.back, f"{found.gap_s * 1e3:.0f}")
        print(f"| {way} | {' | '.join(map(str, figures))} | {statistics.median(took_ms):.0f} ({max(took_ms):.0f}) |")
    _, costs_us["without the shim"] = moved("", number)
    print(f"\nCPU of the tracker for a message: {', '.join(f'{way} {us:.0f} us' for way, us in costs_us.items())}")
    print(f"load {os.getloadavg()[0]:.1f} at the end")


def compiled(python: RosPython, folder: Path) -> Path:
    """The shim's library, made in a folder. Ends with a message if it can't be made."""
    if shutil.which("cc") is None:
        sys.exit("there is no C compiler `cc`")
    said = subprocess.run([python.program, "-c", "import sys; print(sys.prefix)"], capture_output=True, check=True)
    prefixes = [Path(said.stdout.decode().strip()), *map(Path, os.environ.get("AMENT_PREFIX_PATH", "").split(":"))]
    headers = [f"-I{found}" for prefix in prefixes for found in sorted((prefix / "include").glob("*"))]
    library = folder / "shim.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", *headers, HERE / "shim.c", "-o", library, "-ldl"], check=True)
    return library


def moved(way: str, moves: int) -> tuple[Heard, float]:
    """Move the tracker's subscription so many times, twice a second at most.

    Returns its numbers, and its CPU time for a message in us. Without a `way` the tracker has no shim, and stays.
    """
    python = ros_python(is_known=True)
    got: list[tuple[int, int]] = []
    took_s = [0.0]
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        profiles = FastDdsProfiles(folder, python.environment)

        def start(node: str, name: str, more: Mapping[str, str], *said: str) -> subprocess.Popen[str]:
            command = [python.program, str(HERE / "nodes.py"), node, "--ros-args", "-r", f"__node:={name}", *said]
            environment = {**python.environment, **profiles.environment(name), **more}
            process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        start("numbered", "numbered", {}, "-r", "n:=/n")
        for label, delay_s in DELAYS_S.items():
            start("detector", label, {}, "-r", "x:=/n", "-r", f"y:=/{label}", "-p", f"delay:={delay_s}")
        shim = {"LD_PRELOAD": str(compiled(python, folder)), "CFGPLAN_SHIM": str(folder / "orders")} if way else {}
        tracker = start("tracker", "tracker", shim, "-r", "x:=/quick")
        threading.Thread(target=collect, args=(tracker, got), daemon=True).start()
        eventually(lambda: len(got) >= 2 * RATE_HZ)
        got.clear()  # which have come while they found each other
        before_us = cpu_us(tracker.pid) or 0
        if way:
            took_s = ordered(folder / "orders", way, moves, got)
        at = len(got)
        eventually(lambda: len(got) >= at + RATE_HZ)
        cost_us = ((cpu_us(tracker.pid) or 0) - before_us) / len(got)
    numbers, times_ns = zip(*got, strict=True)
    return Heard(numbers, max(after - before for before, after in pairwise(times_ns)) / 1e9, took_s), cost_us


def collect(tracker: subprocess.Popen[str], got: list[tuple[int, int]]) -> None:
    assert tracker.stdout is not None
    with suppress(ValueError):  # the pipe is closed while the thread waits
        for line in tracker.stdout:
            _, number, at_ns = line.split()
            got.append((int(number), int(at_ns)))


def ordered(path: Path, way: str, moves: int, got: list[tuple[int, int]]) -> list[float]:
    """Order the moves, and return how long each took, in seconds."""
    took_s = []
    with socket.socket(socket.AF_UNIX) as orders:
        orders.connect(str(path))
        for number in range(moves):
            began_s, at = time.monotonic(), len(got)
            orders.sendall(f"/quick {('/slow', '/quick')[number % 2]} {way}\n".encode())
            answer = orders.recv(100).decode()
            took_s.append(time.monotonic() - began_s)
            if not answer.startswith("switched "):
                raise OSError(f"the shim did not move: {answer or 'the tracker has ended'}")
            eventually(lambda at=at: len(got) >= at + RATE_HZ // 2)  # type: ignore[misc]
    return took_s


if __name__ == "__main__":
    main()
