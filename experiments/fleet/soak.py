"""A run on four computers under all faults of fleets, with a consumer that checks every element.

python experiments/fleet/soak.py [--minutes 60] [--seed 1]

The computers are network namespaces (`network.py`). Each round causes every fault once, in a random order: links are
cut for a moment or longer, lose packets, or are too slow for large elements; units and agents are killed, the code
fails on one host, a second agent has the name of the first, a certificate expires, the file gets valid and invalid
edits, and includes a pipe without a writer. At least one round runs.

Checks: elements are lost only around a kill or a long cut, or are counted; none is repeated or out of order; a failing
host is left within 10 s; an agent with a duplicate name or an expired certificate says so and ends; no silent target
counts as met; in the end every target is met, and no unit is left on any host.
The exit code is 77 if namespaces are not available.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

from computers import PATIENCE_S, Fleet, Listener, eventually
from network import Network, run_within

if TYPE_CHECKING:
    from cfgplan_runtime.operating.operation import Operation

HOSTS = ("base", "r1", "r2", "r3")
WORKERS = HOSTS[1:]
UNITS = """
import os

def count():
    number = 0
    while True:
        yield number
        number += 1

def large(size):
    while True:
        yield bytes(size)

class Work:
    def __init__(self, seed=0):
        self.bad = os.environ["CFGPLAN_SOAK_BAD"]

    def __call__(self, x):
        if os.path.exists(self.bad):
            os._exit(3)
        return x
"""
RATE_HZ, LARGE_HZ, LARGE_BYTES, SLOW_MBIT_S = 50, 1, 1_000_000, 20
LOSS, DELAY_S, LOSSY_S = 0.2, 0.1, 8.0
BAD_S = 10.0
"""The most seconds until a run leaves a host that is bad for the code."""
SILENT_S = 20.0
"""The most seconds for which a silent target may count as met: a unit is taken for hung before."""
VALID_S = 15
"""How long the short certificate is valid."""
SLACK_S = 0.3
"""How far an element that a deed has cost may be from it in time."""


class Soak:
    """A run of count -> work -> /result and large -> /large on a fleet, and the faults that it survives."""

    def __init__(self, fleet: Fleet, path: Path, seed: int) -> None:
        self.fleet, self.path, self.randoms = fleet, path, random.Random(seed)
        self.upkeep_us = {"work_a": 500, "work_b": 600}
        self.seed = 0.0
        self.excused_s: list[tuple[float, float]] = []
        self.operation: Operation
        self.result: Listener
        self.large: Listener
        self.write()

    def deeds(self) -> list[Callable[[], None]]:
        return [
            self.short_cut,
            self.long_cut,
            self.lossy_links,
            self.slow_link,
            self.kill_unit,
            self.kill_agent,
            self.bad_host,
            self.twin,
            self.certificate_ends,
            self.other_prices,
            self.other_params,
            self.bad_edit,
            self.blocked_file,
        ]

    def short_cut(self) -> None:
        """Cut a link for a moment: no element is lost."""
        host = self.randoms.choice(WORKERS)
        self.fleet.network.cut(host)
        time.sleep(0.3)
        self.fleet.network.mend(host)

    def long_cut(self) -> None:
        host = self._worker.host
        with self.excused():
            self.fleet.network.cut(host)
            self._await_loss(host)
            self.settle(without="large")
            self.fleet.network.mend(host)
            self._await_hosts()

    def lossy_links(self) -> None:
        """Let links lose packets: no host is lost."""
        with self.keeping_hosts(), self.fleet.network.lossy(LOSS, DELAY_S):
            time.sleep(LOSSY_S)

    def slow_link(self) -> None:
        """Slow a link down: large elements and the others beside them still arrive."""
        self.fleet.network.limit("r1", SLOW_MBIT_S)
        self.large.await_more(3)
        self.fleet.network.unlimit("r1")

    def kill_unit(self) -> None:
        unit = self._worker
        with self.excused():
            eventually(lambda: self.operation.runtime.pid(unit.id) is not None, PATIENCE_S)
            os.kill(self.operation.runtime.pid(unit.id), 9)
            self.settle()

    def kill_agent(self) -> None:
        host = self._worker.host
        with self.excused():
            self.fleet.kill_agent(host)
            self.settle(without="large")
            self.fleet.restart()
            self._await_hosts()

    def bad_host(self) -> None:
        """Let the code fail on one host: it runs on another."""
        host = self._worker.host
        bad = self.fleet.folder / f"bad-{host}"
        with self.excused():
            bad.touch()
            took_s = eventually(lambda: self._runs_elsewhere(host) and self._comes(), PATIENCE_S)
            assert took_s < BAD_S, f"the code fails on {host}, and was there for {took_s:.0f} s"
            bad.unlink()

    def twin(self) -> None:
        """Start a second agent of the same name: it ends, and the first keeps its units."""
        name, place = self._worker.host, self.randoms.choice([host for host in WORKERS if host != self._worker.host])
        with self.keeping_hosts(), self.fleet.twin(name, place) as (second, said):
            _await(lambda: second.poll() is not None, lambda: f"a second {name} on {place} says {said.read_text()!r}")
            assert f"the fleet has an agent '{name}'" in said.read_text(), said.read_text()

    def certificate_ends(self) -> None:
        """Let a certificate expire: its agent says so, and its host is used again with a new certificate."""
        from cfgplan_runtime.fleet import certificates

        host, make_host = self._worker.host, certificates._make_host

        def make_short(folder: Path, authority: Any, names: Any, _: int) -> None:
            make_host(folder, authority, names, VALID_S / 86400)  # type: ignore[arg-type]

        with self.excused():
            self.fleet.kill_agent(host)
            with patch.object(certificates, "_make_host", make_short):
                self.fleet.renew_certificate(host)
            self.fleet.start_agent(host)  # on a busy computer the certificate may end before the agent listens
            agent = self.fleet.agents[host]
            _await(lambda: agent.poll() is not None, lambda: f"{host} says {self.fleet.said(host)!r}")
            assert "was valid until" in self.fleet.said(host), self.fleet.said(host)
            self._await_loss(host)  # or the next fault would seem to have caused it
            self.fleet.renew_certificate(host)
            self.fleet.restart()
            self._await_hosts()

    def other_prices(self) -> None:
        for label in self.upkeep_us:
            self.upkeep_us[label] = self.randoms.randrange(200, 1000)
        self.write()
        time.sleep(1.0)

    def other_params(self) -> None:
        self.seed = self.randoms.random()
        self.write()
        time.sleep(1.0)

    def bad_edit(self) -> None:
        """Write an invalid file: the run changes nothing."""
        self.path.write_text("format: cfgplan/1\ntransformations: [{")
        time.sleep(0.5)
        self.write()

    def blocked_file(self) -> None:
        """Include a pipe that blocks its reader: it delays edits, and nothing else."""
        pipe, whole = self.path.with_name("pipe.yaml"), json.loads(self.path.read_text())
        os.mkfifo(pipe)
        self.path.write_text(json.dumps({**whole, "include": [pipe.name]}))
        self.result.await_more(RATE_HZ)
        with pipe.open("w") as end:  # waits for its reader
            end.write("format: cfgplan/1\n")
        self.write()
        time.sleep(0.5)
        pipe.unlink()

    @contextmanager
    def excused(self) -> Iterator[None]:
        """Allow lost elements from now until the targets are met again."""
        begin_s = time.monotonic()
        yield
        self.settle()
        self.excused_s.append((begin_s - SLACK_S, time.monotonic() + SLACK_S))

    def settle(self, *, without: str = "") -> None:
        """Wait until elements come, no review is pending, and every target is met but those that need the host
        `without`.
        """
        end_s = time.monotonic() + PATIENCE_S
        while not (self._comes() and self.operation.manager.settle(1.0) and self.unmet() <= {without}):
            silent_s = time.monotonic() - max(self.result.at_s[-1], end_s - PATIENCE_S)
            assert silent_s < SILENT_S or "result" in self.unmet(), f"silent for {silent_s:.0f} s, and counts as met"
            assert time.monotonic() < end_s, f"unmet after {PATIENCE_S} s: {self.unmet()}"

    def unmet(self) -> set[str]:
        return {view.label for view in self.operation.manager.snapshot().targets if not view.is_met}

    def lost_hosts(self) -> list[str]:
        """Return the hosts that were lost so far and the causes, from the log."""
        log = self.operation.log
        assert log is not None
        told = [json.loads(line) for line in log.path.read_text().splitlines()]
        return [f"{one['host']}: {one['cause']}" for one in told if one["event"] == "HostLost"]

    @contextmanager
    def keeping_hosts(self) -> Iterator[None]:
        """Check that no host is lost within the context."""
        before = len(self.lost_hosts())
        yield
        lost = self.lost_hosts()[before:]
        assert not lost, f"lost: {', '.join(lost)}"

    def wrong(self) -> tuple[int, int]:
        """Return the number of elements lost outside of excused times, and of elements repeated or out of order."""
        lost = repeated = 0
        places = list(zip(self.result.at_s, self.result.values, strict=False))
        for (before_s, before), (after_s, after) in pairwise(places):
            if not any(before_s <= end_s and begin_s <= after_s for begin_s, end_s in self.excused_s):
                repeated += after <= before
                lost += max(0, after - before - 1)
        return lost, repeated

    def counted(self) -> int:
        """Return the number of elements that were reported as dropped, by units or on the way to other hosts."""
        by_units = sum(one.dropped for one in self.operation.runtime.observe())
        return max(by_units, sum(counts.dropped for counts in self.operation.flows.crossings.values()))

    def write(self) -> None:
        """Replace the file as an editor does: write a new one beside it, and rename it."""

        def known(label: str, code: str, host: Any, output: str, upkeep_us: int, **more: Any) -> dict[str, Any]:
            shown = {"label": label, "source": f"units.py:{code}", "host": host, "labor": 0}
            return {**shown, "upkeep": upkeep_us / 1e6, "outputs": {"y": output}, **more}

        library = [
            known("count", "count", "base", "N", 1000, run={"rate": RATE_HZ, "hang": 10}),
            known("large", "large", "r1", "Large", 1000, run={"rate": LARGE_HZ}, params={"size": LARGE_BYTES}),
        ]
        for label, upkeep_us in self.upkeep_us.items():
            more = {"inputs": {"x": "N"}, "params": {"seed": self.seed}, "run": {"hang": 10}}
            library.append(known(label, "Work", list(WORKERS), "Y", upkeep_us, **more))
        targets = [
            {"label": "result", "topic": "/result", "tag": "Y", "host": "base"},
            {"label": "large", "topic": "/large", "tag": "Large", "host": "base"},
        ]
        hosts = [{"name": host} for host in HOSTS]
        beside = self.path.with_suffix(".new")
        whole = {"format": "cfgplan/1", "horizon": 600, "hosts": hosts, "transformations": library, "targets": targets}
        beside.write_text(json.dumps(whole))
        beside.rename(self.path)

    @property
    def _worker(self) -> Any:
        found = list[Any]()

        def is_there() -> bool:
            found[:] = [one for one in self.operation.runtime.environment.units if one.transformation in self.upkeep_us]
            return len(found) == 1

        eventually(is_there, PATIENCE_S)
        return found[0]

    def _runs_elsewhere(self, host: str) -> bool:
        units = self.operation.runtime.environment.units
        return any(one.transformation in self.upkeep_us and one.host != host for one in units)

    def _comes(self) -> bool:
        """Whether an element comes within a second."""
        before, end_s = len(self.result.values), time.monotonic() + 1.0
        while len(self.result.values) == before and time.monotonic() < end_s:
            time.sleep(0.01)
        return len(self.result.values) > before

    def _await_loss(self, host: str) -> None:
        eventually(lambda: host in self.operation.runtime.supervisor.lost_hosts, PATIENCE_S)

    def _await_hosts(self) -> None:
        eventually(lambda: not self.operation.runtime.supervisor.lost_hosts, PATIENCE_S)


def _await(is_so: Callable[[], bool], else_say: Callable[[], str]) -> None:
    try:
        eventually(is_so, PATIENCE_S)
    except TimeoutError:
        raise AssertionError(else_say()) from None


def soak(network: Network, minutes: float, seed: int, names: Sequence[str]) -> None:
    """Run the soak with the named faults, or all, from within the network.

    Raises AssertionError or TimeoutError if a check fails.
    """
    from cfgplan_runtime.fleet.certificates import make
    from cfgplan_runtime.lifecycle.back_off import BackOffRules
    from cfgplan_runtime.lifecycle.policy import Policy
    from cfgplan_runtime.lifecycle.seams import DeclaredCosts
    from cfgplan_runtime.operating.operation import Operation, Settings

    from cfgplan import api

    done, end_s = Counter[str](), time.monotonic() + 60 * minutes
    with tempfile.TemporaryDirectory(prefix="soak") as name:
        folder = Path(name)
        os.environ["XDG_RUNTIME_DIR"] = name
        (folder / "units.py").write_text(UNITS)
        make(folder / "secrets", {host: [network.address[host]] for host in HOSTS}, days=1)
        settings = Settings(policy=Policy(back_off=BackOffRules(most_s=5.0)), log=folder / "log.jsonl", check=None)
        costs = DeclaredCosts(failure_us=0)
        with (
            Fleet(network, folder / "secrets", hosts=HOSTS, units=folder) as fleet,
            patch("cfgplan_runtime.operating.operation.make_estimator", lambda *_: costs),
        ):
            run = Soak(fleet, folder / "env.json", seed)
            with Operation(api.load(run.path), run.path, replace(settings, runtime=fleet.operated)) as run.operation:
                run.operation.begun.wait(PATIENCE_S)
                run.result = Listener(fleet.run_folder("base"))
                run.large = Listener(fleet.run_folder("base"), "/large", number=len)
                run.result.await_more()
                run.settle()
                while not done or time.monotonic() < end_s:
                    deeds = [deed for deed in run.deeds() if not names or deed.__name__ in names]
                    run.randoms.shuffle(deeds)
                    for deed in deeds:
                        print(f"{time.strftime('%X')} {deed.__name__}", flush=True)
                        deed()
                        run.settle()
                        done[deed.__name__] += 1
                    lost, repeated = run.wrong()
                    print(f"{len(run.result.values)} elements, {lost} lost, {run.counted()} counted", flush=True)
                    assert not repeated, f"{repeated} elements are repeated or out of order"
                    assert lost <= run.counted(), f"{lost} elements were lost, {run.counted()} counted"
                elements, hosts_lost = len(run.result.values), len(run.lost_hosts())
            for host in HOSTS:
                eventually(lambda host=host: not fleet.units(host), PATIENCE_S)
    print(f"{dict(done)}\n{elements} elements, {hosts_lost} hosts lost")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--deed", action="append", default=[], help="this one only (several: once for each)")
    parser.add_argument("--within", help=argparse.SUPPRESS)
    options = parser.parse_args()
    return run_within(HOSTS, options.within, lambda network: soak(network, options.minutes, options.seed, options.deed))


if __name__ == "__main__":
    sys.exit(main())
