"""How long it takes from a perturbation to restored results, by kind of perturbation, and where the time goes.

python experiments/lifecycle/reaction.py [--repeat 50] [--library 10] [--library 1000] [--json FILE]

A source at 500 Hz, a chain of three workers and the target /result run as processes; the library has `--library`
transformations that could replace them. `without results` is the longest time after the perturbation in which a
consumer of /result had no element. Read times as orders of magnitude.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import tempfile
import threading
import time
from bisect import bisect
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from cfgplan_runtime import Manager, Policy, Runtime, subscribe, watch_file
from cfgplan_runtime.lifecycle.back_off import BackOffRules
from cfgplan_runtime.lifecycle.changes import Add, Remove
from cfgplan_runtime.lifecycle.reports import PHASES, Decision, Report, Review, Reviewed
from cfgplan_runtime.lifecycle.seams import DeclaredCosts

from cfgplan import api
from cfgplan.domain import Target, Transformation

UNITS = """
def count():
    number = 0
    while True:
        yield number
        number += 1

def same(x, seed=0):
    return x
"""
RATE_HZ = 500
STAGES = 3
HANG_S = 2.0
PATIENCE_S = 30.0
Row = dict[str, Any]


def environment_text(size: int) -> str:
    """Return an environment of `size` transformations: a source and three stages, with more expensive alternatives."""
    randoms = random.Random(0)
    library: list[Row] = []
    for number in range(size):
        stage = number % (STAGES + 1)
        costs = {"labor": randoms.randrange(50, 200) / 1000, "upkeep": randoms.randrange(10, 1000) / 10_000}
        ports: Row = {"outputs": {"y": f"Stage{stage}"}}
        if stage:
            ports["inputs"] = {"x": f"Stage{stage - 1}"}
        else:
            ports["run"] = {"rate": RATE_HZ}
        if stage == 2:
            ports["run"] = {"hang": HANG_S}
        code = "units.py:same" if stage else "units.py:count"
        library.append({"label": f"t{number}", "source": code, **costs, **ports})
    target = {"label": "result", "topic": "/result", "tag": f"Stage{STAGES}"}
    return yaml.safe_dump({"format": "cfgplan/1", "horizon": 600, "transformations": library, "targets": [target]})


class Consumer:
    """Records the arrival time of each element on a topic, in nanoseconds since the epoch."""

    def __init__(self, topic: str, run: str) -> None:
        self.came: list[int] = []
        self._topic = topic
        self._run = run
        threading.Thread(target=self._collect, daemon=True).start()

    def _collect(self) -> None:
        for _ in subscribe(self._topic, run=self._run, wait_s=PATIENCE_S):
            self.came.append(time.time_ns())

    def longest_gap_ns(self, since_ns: int) -> int | None:
        """Return the longest time without an element after a moment; None if none has come since."""
        came = [since_ns, *self.came[bisect(self.came, since_ns) :]]
        return max((end - begin for begin, end in pairwise(came)), default=None)


class Run:
    """A running life-cycle to perturb."""

    def __init__(self, runtime: Runtime, manager: Manager, file: Path) -> None:
        self.runtime = runtime
        self.manager = manager
        self.file = file
        self.reviews: list[Review] = []
        self.consumer = Consumer("/result", runtime.id)
        manager.listen(self._note)

    def _note(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self.reviews.append(report.review)

    def unit_at(self, stage: int) -> str:
        """Return the unit that runs at a stage; 0 is the source."""
        return next(u.id for u in self.runtime.environment.units if _stage(u.transformation) == stage)

    def kill(self, stage: int) -> None:
        pid = self.runtime.pid(self.unit_at(stage))
        assert pid is not None
        os.kill(pid, signal.SIGKILL)

    def hang(self) -> None:
        pid = self.runtime.pid(self.unit_at(2))
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)

    def kill_all(self) -> None:
        for unit in self.runtime.environment.units:
            pid = self.runtime.pid(unit.id)
            if pid is not None:
                os.kill(pid, signal.SIGKILL)

    def cut(self, stage: int) -> None:
        self.runtime.cut(self.unit_at(stage), "x")

    def cut_topic(self) -> None:
        self.runtime.cut(None, "/result")

    def remove(self) -> None:
        label = self.runtime.environment.unit[self.unit_at(2)].transformation
        self.removed: Transformation = self.manager.world.environment.transformation[label]
        self.manager.request(Remove(transformations=(label,)))

    def give_back(self) -> None:
        self.manager.request(Add(transformations=(self.removed,))).result(PATIENCE_S)

    def change_params(self) -> None:
        label = self.runtime.environment.unit[self.unit_at(2)].transformation
        changed = replace(self.manager.world.environment.transformation[label], params={"seed": time.time_ns()})
        self.manager.request(Add(transformations=(changed,)))

    def edit(self) -> None:
        """Change the params of the unit of stage 2 in the file."""
        label = self.runtime.environment.unit[self.unit_at(2)].transformation
        document = yaml.safe_load(self.file.read_text())
        for one in document["transformations"]:
            if one["label"] == label:
                one["params"] = {"seed": time.time_ns()}
        new = self.file.with_suffix(".new")
        new.write_text(yaml.safe_dump(document))
        self.edited_ns = time.time_ns()
        new.replace(self.file)

    def add_target(self) -> None:
        self.manager.request(Add(targets=(Target("other", f"Stage{STAGES - 1}", "/other"),)))

    def remove_target(self) -> None:
        self.manager.request(Remove(targets=("other",))).result(PATIENCE_S)


def _stage(label: str) -> int:
    return int(label[1:]) % (STAGES + 1)


def measure(run: Run, name: str, perturb: Callable[[], None], after: Callable[[], None] | None, topic: str) -> Row:
    """Perturb once; returns the durations in milliseconds."""
    consumer = run.consumer if topic == "/result" else Consumer(topic, run.runtime.id)
    run.manager.settle(PATIENCE_S)
    time.sleep(0.3)
    before = len(run.reviews)
    start_ns = time.time_ns()
    perturb()
    if name == "file edited":
        start_ns = run.edited_ns
    deadline = time.monotonic() + PATIENCE_S
    while _applied(run.reviews[before:]) is None:
        assert time.monotonic() < deadline, f"{name}: nothing was applied"
        time.sleep(0.001)
    run.manager.settle(PATIENCE_S)
    time.sleep(0.1)
    while (gap_ns := consumer.longest_gap_ns(start_ns)) is None:
        assert time.monotonic() < deadline, f"{name}: nothing came"
        time.sleep(0.001)
    review = _applied(run.reviews[before:])
    assert review is not None
    row: Row = {"kind": name, "gap": gap_ns / 1e6}
    row["noticed"] = (review.time_s * 1e9 - start_ns) / 1e6
    row |= {phase: review.seconds.get(phase, 0.0) * 1e3 for phase in PHASES}
    if after is not None:
        after()
    return row


def _applied(reviews: list[Review]) -> Review | None:
    return next((review for review in reviews if review.decision is Decision.APPLIED), None)


def rows(size: int, repeat: int) -> list[Row]:
    """Measure every kind of perturbation `repeat` times."""
    found: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "env.yaml"
        (folder / "units.py").write_text(UNITS)
        file.write_text(environment_text(size))
        # A unit that is killed or cut again and again is not to blame.
        policy = Policy(back_off=BackOffRules(first_s=0.0), most_loss_s=0.0)
        with (
            Runtime(folder=folder) as runtime,
            Manager(api.load(file), runtime, policy=policy, estimator=DeclaredCosts(failure_us=0)) as manager,
            watch_file(file, manager),
        ):
            manager.settle(PATIENCE_S)
            run = Run(runtime, manager, file)
            for _ in range(repeat):
                for kind, perturb, after, topic in (
                    ("source killed", lambda: run.kill(0), None, "/result"),
                    ("worker killed", lambda: run.kill(2), None, "/result"),
                    ("last worker killed", lambda: run.kill(STAGES), None, "/result"),
                    (f"worker hangs for {HANG_S} s", run.hang, None, "/result"),
                    ("all units killed", run.kill_all, None, "/result"),
                    ("subscription cut", lambda: run.cut(2), None, "/result"),
                    ("topic cut", run.cut_topic, None, "/result"),
                    ("transformation removed", run.remove, run.give_back, "/result"),
                    ("params changed", run.change_params, None, "/result"),
                    ("file edited", run.edit, None, "/result"),
                    ("target added", run.add_target, run.remove_target, "/other"),
                ):
                    found.append({"library": size, **measure(run, kind, perturb, after, topic)})
    return found


def table(found: list[Row]) -> str:
    """Return a table of medians, and of the 99th percentile of the time without results, in milliseconds.

    `noticed after` is from the perturbation to the beginning of the review; the planner's share is of the time from the
    perturbation to the end of the update.
    """
    phases = ("match", "estimate", "plan", "judge", "apply")
    heads = ["perturbation", "without results: median", "p99", "noticed after", *phases, "planner's share"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for kind in dict.fromkeys(row["kind"] for row in found):
        some = [row for row in found if row["kind"] == kind]
        numbers = [_median(some, "gap"), _p99(some, "gap"), *(_median(some, key) for key in ("noticed", *phases))]
        share = statistics.median(row["plan"] / (row["noticed"] + sum(row[p] for p in phases)) for row in some)
        lines.append(f"| {kind} | " + " | ".join(f"{number:.1f}" for number in numbers) + f" | {share:.0%} |")
    return "\n".join(lines)


def _median(some: list[Row], key: str) -> float:
    return statistics.median(row[key] for row in some)


def _p99(some: list[Row], key: str) -> float:
    values = sorted(row[key] for row in some)
    return float(values[min(len(values) - 1, round(0.99 * (len(values) - 1)))])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=50)
    parser.add_argument("--library", type=int, action="append", help="how many transformations; may be repeated")
    parser.add_argument("--json", type=Path, help="write each measurement to this file")
    options = parser.parse_args()
    found: list[Row] = []
    for size in options.library or [12, 1000]:
        found += rows(size, options.repeat)
        print(f"\n{size} transformations, {options.repeat} times each, milliseconds\n")
        print(table([row for row in found if row["library"] == size]), flush=True)
    if options.json:
        options.json.write_text("\n".join(map(json.dumps, found)) + "\n")


if __name__ == "__main__":
    main()
