"""Random faults and swaps against running processes, with a consumer that checks every element.

python experiments/runtime/soak.py --faults 1000

Checks: elements are lost only while something was killed, never by a swap or an undone update; none comes twice or
out of order; no process, descriptor or file is left over; the supervisor's memory stays flat. Among the faults are
stalls of the supervisor, forks that fail, and units that leave a process behind that holds their sockets open.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import preloaded
import psutil
from cfgplan_runtime import ApplyError, Received, Runtime, StaleChangeSetError, subscribe
from cfgplan_runtime.supervision.events import OutletsLost, UnitDied
from running_pid import running_pid

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

LIBRARY = (
    Transformation("count", (), (OutputPort("n", "N"),), source="measured_units.py:count", run=RunOptions(rate_hz=200)),
    *(
        Transformation(label, (InputPort("x", "N"),), (OutputPort("y", "N"),), source="measured_units.py:SameWithHeir")
        for label in ("first", "second")
    ),
    Transformation("bad", (InputPort("x", "N"),), (OutputPort("y", "N"),), source="measured_units.py:FailsToStart"),
)
SLACK_NS = 50_000_000
"""How far an element that a kill has cost may be from that in time: it was on its way, or waited for its turn."""

REST_S = 0.15
"""How long nothing is done after a kill, so that it excuses nothing that follows."""


@dataclass
class Soak:
    """A chain count -> first -> second -> /result under attack."""

    runtime: Runtime
    rng: random.Random
    number: dict[str, int] = field(default_factory=lambda: {"count": 1, "first": 1, "second": 1})
    kills_ns: list[tuple[int, int]] = field(default_factory=list)
    done: Counter[str] = field(default_factory=Counter)
    mended_ms: list[float] = field(default_factory=list)

    def name(self, label: str) -> str:
        return f"{label}.{self.number[label]}"

    def unit(self, label: str) -> ComputationUnit:
        feeds = {"count": (), "first": (("x", self.name("count"), "n"),), "second": (("x", self.name("first"), "y"),)}
        topics = (Publication("y", "/result"),) if label == "second" else ()
        subscriptions = tuple(Subscription(port, Stream(unit, out)) for port, unit, out in feeds[label])
        return ComputationUnit(self.name(label), label, subscriptions, topics)

    def begin(self) -> None:
        self.runtime.apply(ChangeSet(started=tuple(self.unit(label) for label in self.number)))

    def step(self) -> None:
        deed = self.rng.choices(
            [
                self.swap,
                self.swap_both,
                self.undone_update,
                self.kill_unit,
                self.kill_in_update,
                self.kill_outlets,
                self.kill_nursery,
                self.stall,
                self.failing_fork,
                self.kill_with_heirs,
            ],
            [40, 20, 10, 20, 6, 3, 1, 1, 5, 4],
        )[0]
        self.done[deed.__name__] += 1
        kills = len(self.kills_ns)
        deed()
        if len(self.kills_ns) > kills:
            time.sleep(REST_S)
        time.sleep(self.rng.uniform(0.0, 0.05))

    def swap(self) -> None:
        self._replace({self.rng.choice(["first", "second"])})

    def swap_both(self) -> None:
        self._replace({"first", "second"})

    def undone_update(self) -> None:
        bad = ComputationUnit(
            "bad.1", "bad", (Subscription("x", Stream(self.name("first"), "y")),), (Publication("y", "/result"),)
        )
        second = ComputationUnit(self.name("second"), "second", self.unit("second").subscriptions)
        try:
            self.runtime.apply(ChangeSet(started=(bad,), rewired=(second,)))
        except ApplyError:
            return
        raise AssertionError("a unit that can't start was started")

    def kill_unit(self) -> None:
        label = self.rng.choice(["first", "second"])
        begin = time.time_ns()
        os.kill(running_pid(self.runtime, self.name(label)), signal.SIGKILL)
        self._await_death(self.name(label))
        self._replace({label})
        self.kills_ns.append((begin, time.time_ns()))
        self.mended_ms.append((time.time_ns() - begin) / 1e6)

    def stall(self) -> None:
        """Stop this process with supervisor and consumer for longer than a round: no unit may be reported as hung."""
        me = os.getpid()
        subprocess.run(["sh", "-c", f"(kill -STOP {me}; sleep 1.5; kill -CONT {me}) &"], check=True)
        time.sleep(0.3)

    def failing_fork(self) -> None:
        """An update for which no process can be made is undone."""
        full = Path(os.environ[preloaded.FULL])
        full.touch()
        try:
            self.runtime.apply(
                ChangeSet(started=(ComputationUnit("first.0", "first", self.unit("first").subscriptions),))
            )
        except ApplyError:
            return
        finally:
            full.unlink()
        raise AssertionError("a unit was started though no process can be made")

    def kill_with_heirs(self) -> None:
        """Kill units after one of them has left a process behind that holds its sockets open."""
        wish = Path(os.environ[preloaded.HEIR])
        wish.touch()
        deadline = time.monotonic() + 30
        while wish.exists():
            assert time.monotonic() < deadline, "no unit leaves an heir"
            time.sleep(0.005)
        for label in ("first", "second"):
            begin = time.time_ns()
            os.kill(running_pid(self.runtime, self.name(label)), signal.SIGKILL)
            self._await_death(self.name(label))
            self._replace({label})
            self.kills_ns.append((begin, time.time_ns()))

    def kill_in_update(self) -> None:
        """Kill the unit that is being replaced, at some moment of the update."""
        label = self.rng.choice(["first", "second"])
        begin, pid = time.time_ns(), running_pid(self.runtime, self.name(label))
        timer = threading.Timer(self.rng.uniform(0, 0.02), _kill, [pid])
        timer.start()
        self._replace({label})
        timer.join()
        self.kills_ns.append((begin, time.time_ns()))

    def kill_outlets(self) -> None:
        begin = time.time_ns()
        os.kill(running_pid(self.runtime, ""), signal.SIGKILL)
        while not isinstance(self.runtime.events.get(timeout=30), OutletsLost):
            pass
        time.sleep(0.1)
        self.kills_ns.append((begin, time.time_ns()))

    def kill_nursery(self) -> None:
        begin = time.time_ns()
        psutil.Process(self.runtime.pid("")).parent().kill()
        while self.runtime.environment.units:
            time.sleep(0.005)
        self._replace(set(self.number))
        self.kills_ns.append((begin, time.time_ns()))

    def _replace(self, labels: set[str]) -> None:
        """Replace units of these labels by new ones, whatever is left of the old."""
        while True:
            basis = self.runtime.environment
            gone = {label for label in self.number if self.name(label) not in basis.unit}
            old = tuple(self.name(label) for label in labels - gone)
            for label in labels | gone:
                self.number[label] += 1
            started = tuple(self.unit(label) for label in sorted(labels | gone))
            rewired = tuple(
                unit
                for unit in (self.unit(label) for label in sorted(set(self.number) - labels - gone))
                if unit != basis.unit[unit.id]
            )
            try:
                self.runtime.apply(ChangeSet(started=started, rewired=rewired, stopped=old), basis=basis)
            except (StaleChangeSetError, ApplyError):
                for label in labels | gone:
                    if self.name(label) not in self.runtime.environment.unit:
                        self.number[label] -= 1
                labels = labels | gone
                continue
            if all(self.name(label) in self.runtime.environment.unit for label in self.number):
                return
            labels = set()

    def _await_death(self, unit: str) -> None:
        while True:
            event = self.runtime.events.get(timeout=30)
            if isinstance(event, UnitDied) and event.unit == unit:
                return


def _kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def anomalies(received: list[Received], kills_ns: list[tuple[int, int]]) -> list[str]:
    """Return everything in the received elements that a consumer must not see."""
    found = []
    for before, after in pairwise(received):
        excused = any(before.time_ns <= end + SLACK_NS and begin - SLACK_NS <= after.time_ns for begin, end in kills_ns)
        if after.time_ns <= before.time_ns:
            found.append(
                f"out of order: {after.value} (of {after.time_ns}) behind {before.value} (of {before.time_ns})"
            )
        if after.value != before.value + 1 and not excused:
            found.append(f"missing between {before.value} and {after.value}, without any kill")
    return found


def soak(faults: int, seed: int) -> dict[str, object]:
    """Run it; raises AssertionError for anything that must not be."""
    me = psutil.Process()
    received: list[Received] = []
    before = set(me.children(recursive=True))
    descriptors_outside = me.num_fds()
    here, notes = Path(__file__).parent, Path(tempfile.mkdtemp())
    os.environ["PYTHONPATH"] = os.pathsep.join([str(here), *sys.path])
    os.environ |= {preloaded.FULL: str(notes / "full"), preloaded.HEIR: str(notes / "heir")}
    with Runtime(LIBRARY, [Target("t", "N", "/result")], folder=here, preload=["preloaded"]) as runtime:
        run = Soak(runtime, random.Random(seed))
        run.begin()
        subscription = subscribe("/result", run=runtime.id)
        listener = threading.Thread(target=lambda: received.extend(subscription))
        listener.start()
        sizes: list[int] = []
        descriptors: list[int] = []
        for number in range(faults):
            run.step()
            if number % max(1, faults // 20) == 0:
                sizes.append(me.memory_info().rss - sys.getsizeof(received) - 200 * len(received))
                descriptors.append(me.num_fds())
                print(
                    f"{number:5} faults, {len(received)} elements, {sizes[-1] >> 10} kB, {descriptors[-1]} descriptors",
                    flush=True,
                )
        time.sleep(0.3)
    listener.join(30)
    found = anomalies(received, run.kills_ns)
    assert not found, found[:10]
    assert subscription.dropped == 0
    left = [child for child in set(me.children(recursive=True)) - before if child.is_running()]
    assert not left, left
    assert me.num_fds() <= descriptors_outside, (me.num_fds(), descriptors_outside)
    assert max(descriptors) <= descriptors[0] + 3, descriptors
    mended = sorted(run.mended_ms)
    return {
        "deeds": dict(run.done),
        "elements": len(received),
        "mended_ms_median": round(mended[len(mended) // 2], 1) if mended else None,
        "memory_growth_kB": (sizes[-1] - sizes[len(sizes) // 4]) >> 10,
        "descriptors": (min(descriptors), max(descriptors)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name, value in soak(options.faults, options.seed).items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
