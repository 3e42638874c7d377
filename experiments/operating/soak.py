"""A run in operation under the faults of real machines, with a consumer that checks every element.

python experiments/operating/soak.py [--minutes 30] [--seed 1]

Each round causes every fault once, in a random order: units, outlets and nursery are killed and stopped, the whole run
is stalled, forks fail, a dead unit leaves a process behind that holds its sockets open, a unit loads slowly, the disk
is full, the file gets valid and invalid edits and includes a pipe without a writer, requests come through the control
socket, and guests with harmful code join (`hostile_guests.py`). At least one round runs.

Checks: elements are lost only around a kill or a stop, or a unit counts them as dropped because it got no CPU time.
None is lost by an edit, a request, a stall, a slow start, a failing fork, a full disk or a guest; none comes out of
order. The outcome of each guest is reported, and the target of a silent guest counts as unmet. In the end every target
is met, at exactly the cost that `cfgplan solve` finds for the final file; no process, descriptor, thread or daemon of a
guest is left over; memory stays flat.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import psutil
from cfgplan_runtime import subscribe
from cfgplan_runtime.lifecycle.back_off import BackOffRules
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.seams import DeclaredCosts
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.operation import Operation, Settings
from cfgplan_runtime.processes.process_backend import OUTLETS
from cfgplan_runtime.supervision.events import SIGNS, Event, UnitStatus
from hostile_guests import CODE, GUESTS, Guest

from cfgplan import api

RUNTIME = Path(__file__).parents[1] / "runtime"
"""Where what is preloaded into the nursery is."""

UNITS = """
import os, time

def count():
    number = 0
    while True:
        yield number
        number += 1

class Work:
    def __init__(self, load=0, seed=0):
        time.sleep(load)

    def __call__(self, x):
        wish = os.environ["CFGPLAN_SOAK_HEIR"]
        if os.path.exists(wish):
            try:
                os.unlink(wish)
            except FileNotFoundError:
                return x
            if os.fork() == 0:
                os.setsid()
                time.sleep(5)
                os._exit(0)
        return x
"""
WORKERS = {"first_a": ("N", "M"), "first_b": ("N", "M"), "second_a": ("M", "Y"), "second_b": ("M", "Y")}
GUEST = "targets: [{label: guest, topic: /guest, tag: M}]"
PATIENCE_S = 120.0
REST_S = 0.4
"""How long nothing is done after a kill, so that it excuses nothing that follows."""

SIGN_NS = 10_000_000_000
"""After this time at the latest, a unit on a busy computer has told what it has dropped."""

STALL_S = 7.0
"""Longer than the least silence for which a unit is killed."""

MOST_BACK_OFF_S = 5.0
"""So short that in the end nothing waits for long that failed before."""

MOST_GROWTH_KB = 30_000


@dataclass
class Soak:
    """A run of count -> first -> second -> /result, and the faults that it survives."""

    operation: Operation
    path: Path
    randoms: random.Random
    times_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[int] = field(default_factory=lambda: array("q"))
    came_ns: array[int] = field(default_factory=lambda: array("q"))
    """When each element came here; `times_ns` has when it was made."""
    kills_ns: list[tuple[int, int]] = field(default_factory=list)
    upkeep_us: dict[str, int] = field(default_factory=lambda: dict.fromkeys(WORKERS, 500))
    params: dict[str, dict[str, float]] = field(default_factory=lambda: {label: {} for label in WORKERS})
    told: list[Event] = field(default_factory=list)
    dropped: dict[tuple[str, str], int] = field(default_factory=dict)
    """The last count of dropped elements of each port of each unit."""
    drops_ns: list[tuple[int, int]] = field(default_factory=list)
    """When units told of drops, and of how many."""

    def deeds(self) -> list[Callable[[], None]]:
        return [
            self.kill_unit,
            self.kill_units,
            self.kill_outlets,
            self.kill_nursery,
            self.stop_unit,
            self.stop_outlets,
            self.stop_nursery,
            self.stall,
            self.failing_fork,
            self.kill_with_heir,
            self.slow_start,
            self.full_disk,
            self.other_prices,
            self.other_params,
            self.bad_edit,
            self.blocked_file,
            self.requests,
            *map(self._visit, GUESTS),
        ]

    def listen(self) -> None:
        for received in subscribe("/result", run=self.operation.id):
            self.times_ns.append(received.time_ns)
            self.values.append(received.value)
            self.came_ns.append(time.time_ns())

    def note(self, event: Event) -> None:
        """Keep an event for the current fault, and count the elements that units dropped from full queues."""
        if not isinstance(event, SIGNS):
            self.told.append(event)
        if isinstance(event, UnitStatus) and event.unit.partition(".")[0] in WORKERS.keys() | {"count"}:
            for port, counts in (*event.inputs.items(), *event.outputs.items()):
                before = self.dropped.get((event.unit, port), 0)
                self.dropped[event.unit, port] = counts.dropped
                if counts.dropped > before:
                    self.drops_ns.append((time.time_ns(), counts.dropped - before))

    def kill_unit(self) -> None:
        self._signal([self.randoms.choice(self._unit_pids())], signal.SIGKILL)

    def kill_units(self) -> None:
        self._signal(self._unit_pids(), signal.SIGKILL)

    def kill_outlets(self) -> None:
        self._signal([self._outlets()], signal.SIGKILL)

    def kill_nursery(self) -> None:
        self._signal_nursery(signal.SIGKILL)

    def stop_unit(self) -> None:
        self._signal([self.randoms.choice(self._unit_pids())], signal.SIGSTOP)

    def stop_outlets(self) -> None:
        self._signal([self._outlets()], signal.SIGSTOP)

    def stop_nursery(self) -> None:
        self._signal_nursery(signal.SIGSTOP)

    def stall(self) -> None:
        """Stop this process, with supervisor and consumer, for a while: no unit may be reported as hung."""
        me, before, now = os.getpid(), self.faults_told(), time.monotonic()
        subprocess.run(["sh", "-c", f"(kill -STOP {me}; sleep {STALL_S}; kill -CONT {me}) &"], check=True)
        _await_gap(now)
        self._await_result()
        time.sleep(0.5)
        assert self.faults_told() == before, self.faults_told()

    def failing_fork(self) -> None:
        """Let the fork of a start fail: the running units continue until it succeeds."""
        full = Path(os.environ["CFGPLAN_SOAK_FULL"])
        full.touch()
        self._edit_params()
        time.sleep(0.5)
        full.unlink()

    def kill_with_heir(self) -> None:
        wish = Path(os.environ["CFGPLAN_SOAK_HEIR"])
        wish.touch()
        _await(lambda: not wish.exists(), "no unit leaves an heir")
        self.kill_units()

    def slow_start(self) -> None:
        """Make the cheapest worker slow to load: it must not delay the repair of units that die meanwhile."""
        label = self.randoms.choice(list(WORKERS))
        self.upkeep_us[label] = min(self.upkeep_us.values()) - 1
        self.params[label] = {"load": self.randoms.uniform(0.5, 3.0)}
        self.write()
        time.sleep(0.3)
        self.await_review(
            lambda: any(unit.startswith(f"{label}.") for unit in self._units()), f"{label} does not start"
        )

    def full_disk(self) -> None:
        """Forbid this process to enlarge files for a moment: the log loses lines, and the run continues."""
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, hard))
        self._call("review")
        time.sleep(0.3)
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        log = self.operation.log
        assert log is not None
        assert log.failure is not None, "the disk was not full"

    def other_prices(self) -> None:
        for label in self.upkeep_us:
            self.upkeep_us[label] = self.randoms.randrange(200, 1000)
        self.write()

    def other_params(self) -> None:
        self._edit_params()

    def bad_edit(self) -> None:
        """Write an invalid file: the run changes nothing."""
        self.path.write_text("format: cfgplan/1\ntransformations: [{")
        time.sleep(0.5)
        self.write()

    def blocked_file(self) -> None:
        """Include a pipe that blocks its reader: it delays edits, and nothing else."""
        pipe = self.path.with_name("pipe.yaml")
        os.mkfifo(pipe)
        whole = self.path.read_text()
        self.path.write_text(json.dumps({**json.loads(whole), "include": [pipe.name]}))
        time.sleep(1.0)
        self._await_result()
        _await(lambda: _is_given_to(pipe, "format: cfgplan/1\n"), "nobody reads the pipe")
        self.write()
        time.sleep(0.5)
        pipe.unlink()

    def _visit(self, guest: Guest) -> Callable[[], None]:
        """The deed of a guest: it comes, its outcome is told, and it leaves nothing behind when it goes."""

        def deed() -> None:
            mine = re.compile(rf"{guest.label}\.\d+")
            self.told.clear()
            self._call("add", name=guest.label, text=guest.text)

            def is_shown() -> bool:
                of_guest = (one for one in list(self.told) if mine.fullmatch(getattr(one, "unit", None) or ""))
                return any(map(guest.is_shown_by, of_guest))

            if guest.shows is not None:
                _await(is_shown, f"what {guest.label} does is not told")
            if guest.target:
                _await(lambda: guest.label in self.unmet(), f"{guest.label} sends nothing and counts as met")
            time.sleep(1.0)
            self._await_result()
            self._call("withdraw", name=guest.label)
            _await(lambda: not any(map(_is_alive, _daemons())), "daemons are left")

        deed.__name__ = guest.label
        return deed

    def requests(self) -> None:
        """Add a guest through the control socket, remove and restore a target, and remove the guest."""
        self._call("add", name="guest", text=GUEST)
        self._call("remove_target", label="other")
        self._call("state")
        self._call("restore", name="other")
        self._call("withdraw", name="guest")

    def settle(self) -> None:
        """Wait until elements come, no review is pending and every target is met."""
        self._await_result()
        _await(lambda: self.operation.manager.settle(1.0) and not self.unmet(), f"unmet: {self.unmet()}")

    def read_news(self) -> None:
        """Read and forget the reports that have come, so that unread ones take no memory."""
        for unread in (self.operation.news, self.operation.runtime.events):
            with suppress(queue.Empty):
                while True:
                    unread.get_nowait()

    def faults_told(self) -> dict[str, int]:
        """Return the number of deaths and hangs in the log, by kind."""
        assert self.operation.log is not None
        told = Counter(json.loads(line)["event"] for line in self.operation.log.path.read_text().splitlines())
        return {kind: told[kind] for kind in ("UnitDied", "UnitHung", "HelperHung", "OutletsLost")}

    def await_review(self, what: Callable[[], bool], else_say: str) -> None:
        """Request reviews until `what()` is true, since reviews exclude recently failed transformations for a while."""

        def reviewed() -> bool:
            self._call("review")
            time.sleep(0.5)
            return what()

        _await(reviewed, else_say)

    def unmet(self) -> list[str]:
        return [view.label for view in self.operation.manager.snapshot().targets if not view.is_met]

    def write(self) -> None:
        """Replace the file as an editor does: write a new one beside it, and rename it."""
        known: list[dict[str, object]] = [
            {
                "label": "count",
                "source": "units.py:count",
                "labor": 0,
                "upkeep": 0.001,
                "run": {"rate": 30, "hang": 5},
                "outputs": {"y": "N"},
            }
        ]
        for label, (needs, gives) in WORKERS.items():
            known.append(
                {
                    "label": label,
                    "source": "units.py:Work",
                    "labor": 0,
                    "upkeep": self.upkeep_us[label] / 1e6,
                    "run": {"hang": 5},
                    "params": self.params[label],
                    "inputs": {"x": needs},
                    "outputs": {"y": gives},
                }
            )
        targets = [
            {"label": "result", "topic": "/result", "tag": "Y"},
            {"label": "other", "topic": "/other", "tag": "M"},
        ]
        beside = self.path.with_suffix(".new")
        beside.write_text(json.dumps({"format": "cfgplan/1", "transformations": known, "targets": targets}))
        beside.rename(self.path)

    def _edit_params(self) -> None:
        label = self.randoms.choice(self._units()).partition(".")[0]
        self.params[label if label in WORKERS else "first_a"] = {"seed": self.randoms.random()}
        self.write()

    def _units(self) -> list[str]:
        return sorted(self.operation.runtime.environment.unit)

    def _unit_pids(self) -> list[int]:
        """The processes of units, but for those that are just being replaced."""
        pids = [self.operation.runtime.pid(unit) for unit in self._units()]
        return [pid for pid in pids if pid is not None]

    def _outlets(self) -> int:
        """The process of the outlets; never 0, since a signal to that would reach the whole process group."""
        pids = list[int]()

        def are_there() -> bool:
            pid = self.operation.runtime.pid(OUTLETS)
            pids.extend([] if pid is None else [pid])
            return bool(pids)

        _await(are_there, "there are no outlets")
        return pids[0]

    def _signal_nursery(self, number: signal.Signals) -> None:
        """All that it has made ends with it."""
        outlets = self._outlets()
        self._signal([psutil.Process(outlets).ppid()], number, ending=[*self._unit_pids(), outlets])

    def _call(self, method: str, **parameters: object) -> None:
        with connect(self.operation.id) as control:
            control.call(method, **parameters)

    def _signal(self, pids: list[int], number: signal.Signals, ending: list[int] | None = None) -> None:
        """Kill or stop processes, and wait until these are gone, or those `ending`, and elements come again."""
        begin = time.time_ns()
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        gone = [*pids, *(ending or ())]
        _await(lambda: not any(_is_alive(pid) for pid in gone), f"{gone} are not gone")
        _await(lambda: not self._run_knows(gone), f"nobody has noticed that {gone} are gone")
        self.settle()
        self.kills_ns.append((begin, time.time_ns()))
        time.sleep(REST_S)

    def _run_knows(self, pids: list[int]) -> bool:
        """Whether the run takes one of these processes for one of its own."""
        runtime = self.operation.runtime
        return not {runtime.pid(unit) for unit in (*self._units(), OUTLETS)}.isdisjoint(pids)

    def _await_result(self) -> None:
        now = time.time_ns()
        _await(lambda: bool(self.times_ns) and self.times_ns[-1] > now, "nothing comes on /result")


def _is_alive(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def _daemons() -> list[int]:
    """The ids that daemons of guests have noted."""
    file = Path(os.environ["CFGPLAN_SOAK_DAEMONS"])
    return [int(line) for line in file.read_text().split()] if file.exists() else []


def _is_given_to(pipe: Path, text: str) -> bool:
    """Write to a pipe if somebody reads it. Returns whether somebody does."""
    try:
        end = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        return False
    os.write(end, text.encode())
    os.close(end)
    return True


def _await(what: Callable[[], bool], else_say: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline, else_say
        time.sleep(0.01)


def _await_gap(since_s: float) -> None:
    """Wait until this process has been stopped and continued."""
    last_s = since_s
    while (now_s := time.monotonic()) - last_s < STALL_S - 1:
        assert now_s - since_s < PATIENCE_S, "nobody stops this process"
        last_s = now_s
        time.sleep(0.01)


def anomalies(soak: Soak) -> list[str]:
    """Return each anomaly in the received elements: unexplained losses, repetitions and wrong order.

    A kill may lose the elements that are on their way when it begins. A unit that gets no CPU time until its queue is
    full drops elements, and counts them.
    """
    found = []
    elements = zip(soak.times_ns, soak.values, soak.came_ns, strict=True)
    for (before_ns, before, before_came_ns), (after_ns, after, after_came_ns) in pairwise(elements):
        if after_ns <= before_ns:
            found.append(f"out of order: {after} (made {after_ns}) behind {before} (made {before_ns})")
        excused = any(before_came_ns <= end and begin <= after_came_ns for begin, end in soak.kills_ns)
        until_ns = after_came_ns + SIGN_NS
        counted = sum(number for at_ns, number in soak.drops_ns if before_ns <= at_ns <= until_ns)
        if after != before + 1 and not excused and not 0 < after - before <= counted + 1:
            whens = map(_when, (before_ns, before_came_ns, after_ns, after_came_ns))
            told = "between {0} (made {2}, came {3}) and {1} (made {4}, came {5})".format(before, after, *whens)
            found.append(f"missing {told}, though nothing was killed or stopped; {counted} are counted as dropped")
    return found


def _when(at_ns: int) -> str:
    return f"{time.strftime('%X', time.localtime(at_ns // 1_000_000_000))}.{at_ns // 1_000_000 % 1000:03}"


def fresh_cost_us(path: Path) -> int:
    """Return the cost in microseconds that `cfgplan solve` finds for the file, which lists no running unit."""
    code = "import sys; from cfgplan.cli import main; sys.exit(main())"
    line = [sys.executable, "-c", code, "solve", str(path), "--json"]
    solved = subprocess.run(line, capture_output=True, text=True, check=True)
    plan = json.loads(solved.stdout)
    assert plan["status"] == "optimal", plan
    return int(plan["cost_us"])


def running_cost_us(operation: Operation) -> int:
    """Return the cost of the running units over the horizon in microseconds; their starts were free."""
    world = operation.manager.world
    upkeep = sum(
        world.environment.transformation[u.transformation].upkeep_us for u in operation.runtime.environment.units
    )
    return upkeep * world.horizon_s


def of_run(run: str) -> list[psutil.Process]:
    """Return the processes whose titles name a run."""
    found = psutil.process_iter(["cmdline"])
    return [process for process in found if " ".join(process.info["cmdline"] or ()).startswith(f"cfgplan {run} ")]


@contextmanager
def operated(folder: Path, seed: int) -> Iterator[Soak]:
    """Yield a run of the soak's world, with log and recording, and a consumer."""
    path = folder / "env.json"
    (folder / "units.py").write_text(UNITS)
    (folder / "hostile.py").write_text(CODE)
    written = Soak(None, path, random.Random(seed))  # type: ignore[arg-type]
    written.write()
    policy = Policy(back_off=BackOffRules(most_s=MOST_BACK_OFF_S))
    settings = Settings(policy=policy, preload=["preloaded"], log=folder / "log.jsonl", record=folder / "run.mcap")
    costs = DeclaredCosts(failure_us=0)  # what crashed is to be as good as before in the end
    with (
        patch("cfgplan_runtime.operating.operation.make_estimator", lambda *_: costs),
        Operation(api.load(path), path, settings) as operation,
    ):
        written.operation = operation
        operation.runtime.listen(written.note)
        operation.begun.wait(PATIENCE_S)
        listener = threading.Thread(target=written.listen)
        listener.start()
        written.settle()
        yield written
    listener.join(PATIENCE_S)


def soak(minutes: float, seed: int) -> dict[str, object]:
    """Run the soak and return its figures; raises AssertionError if a check fails."""
    me, done, sizes, descriptors = psutil.Process(), Counter[str](), list[int](), list[int]()
    before, threads = me.num_fds(), threading.active_count()
    end = time.monotonic() + 60 * minutes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["PYTHONPATH"] = os.pathsep.join([str(RUNTIME), *sys.path])
        os.environ |= {"CFGPLAN_SOAK_FULL": f"{folder}/full", "CFGPLAN_SOAK_HEIR": f"{folder}/heir"}
        os.environ["CFGPLAN_SOAK_DAEMONS"] = f"{folder}/daemons"
        with operated(folder, seed) as run:
            while not sizes or time.monotonic() < end:
                deeds = run.deeds()
                run.randoms.shuffle(deeds)
                for deed in deeds:
                    print(f"{time.strftime('%X')} {deed.__name__}", flush=True)
                    deed()
                    run.settle()
                    run.read_news()
                    done[deed.__name__] += 1
                sizes.append(me.memory_info().rss >> 10)
                descriptors.append(me.num_fds())
                print(f"{len(run.values)} elements, {sizes[-1]} kB, {descriptors[-1]} descriptors", flush=True)
            time.sleep(1.0)
            run.settle()
            fresh_us = fresh_cost_us(run.path)
            run.await_review(
                lambda: running_cost_us(run.operation) == fresh_us, f"a fresh plan costs {fresh_us} us, not what runs"
            )
        found = anomalies(run)
        log, recorder = run.operation.log, run.operation.recorder
        assert log is not None
        assert recorder is not None
        assert (folder / "run.mcap").stat().st_size > 0
    assert not found, found[:10]
    _await(lambda: not of_run(run.operation.id), f"left over: {of_run(run.operation.id)}")
    assert me.num_fds() <= before, f"{me.num_fds()} descriptors, {before} before"
    assert threading.active_count() <= threads, threading.enumerate()
    assert max(descriptors) <= descriptors[0] + 5, descriptors
    assert sizes[-1] - sizes[len(sizes) // 4] <= MOST_GROWTH_KB, sizes
    return {
        "deeds": dict(done),
        "elements": f"{len(run.values)}, {sum(number for _, number in run.drops_ns)} counted as dropped",
        "log": f"{log.written} lines, {log.lost} lost",
        "recording": f"{recorder.recording.written} messages, {recorder.lost} lost",
        "memory_growth_kB": sizes[-1] - sizes[len(sizes) // 4],
        "descriptors": (min(descriptors), max(descriptors)),
        "cost_us": f"{fresh_us}, as a fresh plan",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name, value in soak(options.minutes, options.seed).items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
