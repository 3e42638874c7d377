"""What real machines do to a runtime: heirs, no process or descriptor left, helpers that stop. Real processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path

import failing_forks
import psutil
import pytest
from cfgplan_runtime import ApplyError, Patience, Runtime
from cfgplan_runtime.processes import process_backend
from cfgplan_runtime.processes.process_backend import NURSERY_HELPER, OUTLETS, OUTLETS_HELPER, ProcessBackend
from cfgplan_runtime.supervision.delays import doubling_s
from cfgplan_runtime.supervision.events import HelperHung, OutletsLost, UnitDied, UnitReady
from unit_signals import signal_unit, unit_pid
from watching import Listener, StartRuntime, seen
from world import PATIENCE_S, eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, RunOptions

ONE = start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n"))


@pytest.fixture
def heir(tmp_path: Path) -> Iterator[str]:
    """Where the process that a unit leaves behind notes its id."""
    note = tmp_path / "heir"
    yield str(note)
    with suppress(ProcessLookupError):  # it has ended with its unit
        os.kill(int(note.read_text()), signal.SIGKILL)


def kill(runtime: Runtime, unit_id: str) -> None:
    signal_unit(runtime, unit_id)
    eventually(lambda: unit_id in {event.unit for event in seen(runtime, UnitDied)})


def nursery_of(runtime: Runtime) -> psutil.Process:
    parent = psutil.Process(unit_pid(runtime, "count.1")).parent()
    assert parent is not None
    return parent


def test_an_heir_of_a_dead_source_does_not_delay_its_successor(run_units: StartRuntime, heir: str) -> None:
    runtime = run_units(replace(source(code="count_with_heir"), params={"note": heir}), worker())
    runtime.apply(ONE)
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20 and Path(heir).exists())
    kill(runtime, "count.1")
    rewired = unit("work.1", topic="/result", x="count.2/n")
    applied = runtime.apply(ChangeSet(started=(unit("count.2"),), rewired=(rewired,)))
    assert applied.unswitched == 0
    eventually(lambda: listener.values.count(20) == 2)
    runtime.close()
    listener.join()


def test_an_heir_of_a_dead_consumer_does_not_hold_its_producer_back(run_units: StartRuntime, heir: str) -> None:
    waits = RunOptions(queue=1, blocks=True)
    fast = source(rate_hz=5000)
    runtime = run_units(fast, worker(), worker("heirs", "SameWithHeir", run=waits, note=heir))
    runtime.apply(ONE)
    runtime.apply(start(unit("heirs.1", x="count.1/n")))
    eventually(lambda: Path(heir).exists() and Path(heir).read_text() != "")
    kill(runtime, "heirs.1")
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 10_000)
    runtime.close()
    listener.join()


def test_a_process_that_can_not_be_made_is_one_units_failure(
    run_units: StartRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = tmp_path / "full"
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    monkeypatch.setenv(failing_forks.FULL, str(full))
    runtime = run_units(source(), worker(), preload=["failing_forks"])
    runtime.apply(ONE)
    pids = [runtime.pid("count.1"), runtime.pid("work.1")]
    full.touch()
    with pytest.raises(
        ApplyError, match=r"work\.2 could not start: no process can be made: Resource temporarily unavailable"
    ):
        runtime.apply(start(unit("work.2", x="count.1/n")))
    assert [runtime.pid("count.1"), runtime.pid("work.1")] == pids
    full.unlink()
    runtime.apply(start(unit("work.2", x="count.1/n")))
    assert seen(runtime, OutletsLost) == []


def test_outlets_that_can_not_be_made_are_tried_again_ever_more_rarely(
    run_units: StartRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = tmp_path / "full"
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    monkeypatch.setenv(failing_forks.FULL, str(full))
    runtime = run_units(source(), worker(), preload=["failing_forks"])
    runtime.apply(ONE)
    listener = Listener("/result")
    losses: list[tuple[int, float, float]] = []

    def noted_delay_s(failures: int, first_s: float, most_s: float) -> float:
        delay_s = doubling_s(failures, first_s, most_s)
        losses.append((failures, delay_s, time.monotonic()))
        return delay_s

    monkeypatch.setattr(process_backend, "doubling_s", noted_delay_s)
    monkeypatch.setattr(process_backend, "_GOOD_LIFE_S", inf)  # a slow computer's losses are in a row, too
    full.touch()
    signal_unit(runtime, OUTLETS)
    eventually(lambda: len(seen(runtime, OutletsLost)) >= 5)
    assert [failures for failures, *_ in losses[:5]] == [1, 2, 3, 4, 5]
    assert all(later - at >= delay_s for (_, delay_s, at), (*_, later) in pairwise(losses[:5]))
    full.unlink()
    before = len(listener.received)
    eventually(lambda: len(listener.received) > before + 10)
    runtime.close()
    listener.join()


def test_outlets_that_stop_are_made_anew(run_units: StartRuntime, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_backend, "HELPER_S", 5.0)
    runtime = run_units(source(), worker())
    runtime.apply(ONE)
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 200)
    signal_unit(runtime, OUTLETS, signal.SIGSTOP)
    eventually(lambda: bool(seen(runtime, OutletsLost)))
    assert [event.helper for event in seen(runtime, HelperHung)] == [OUTLETS_HELPER]
    before = len(listener.received)
    eventually(lambda: len(listener.received) > before + 10)
    assert seen(runtime, UnitDied) == []
    runtime.close()
    listener.join()


def test_a_nursery_that_stops_is_made_anew(run_units: StartRuntime, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_backend, "HELPER_S", 5.0)
    runtime = run_units(source(), worker())
    runtime.apply(ONE)
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 200)
    nursery_of(runtime).suspend()
    eventually(lambda: len(seen(runtime, UnitDied)) == 2)
    assert [event.helper for event in seen(runtime, HelperHung)] == [NURSERY_HELPER]
    runtime.apply(ONE)
    before = len(listener.received)
    eventually(lambda: len(listener.received) > before + 10)
    runtime.close()
    listener.join()


FOLDERS = """
import sys
from pathlib import Path
from cfgplan_runtime.streams.run_folder import RunFolder, is_alive
gone = 0
for _ in range(int(sys.argv[2])):
    folder = RunFolder(Path(sys.argv[1]))
    gone += not is_alive(folder.path)
    folder.close()
print(gone)
"""


def test_runs_that_start_at_once_do_not_remove_each_others_folder(tmp_path: Path) -> None:
    line = [sys.executable, "-c", FOLDERS, str(tmp_path), "300"]
    starting = [subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(4)]
    done = [process.communicate(timeout=4 * PATIENCE_S) for process in starting]
    assert [told for told, _ in done] == ["0\n"] * 4, done


def test_processes_are_told_apart_by_run_and_unit_and_observations_give_their_ids(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker())
    runtime.apply(ONE)
    (count, work) = runtime.observe()
    assert (count.pid, work.pid) == (runtime.pid("count.1"), runtime.pid("work.1"))
    assert psutil.Process(work.pid).cmdline()[0] == f"cfgplan {runtime.id} work.1"
    assert nursery_of(runtime).cmdline()[0] == f"cfgplan {runtime.id} nursery"


def test_what_is_ready_has_a_process_id_though_the_nursery_tells_it_late(
    run_units: StartRuntime, monkeypatch: pytest.MonkeyPatch
) -> None:
    hear = ProcessBackend._hear_nursery

    def late(backend: ProcessBackend) -> None:
        if all(child.labor_us is not None for child in backend._children.values()):
            hear(backend)

    monkeypatch.setattr(ProcessBackend, "_hear_nursery", late)
    runtime = run_units(source(), worker())
    pids: list[int | None] = []
    runtime.listen(
        lambda event: pids.append(runtime.supervisor.backend.pid(event.unit)) if isinstance(event, UnitReady) else None
    )
    runtime.apply(ONE)
    assert len(pids) == 2
    assert None not in pids


def test_a_unit_whose_steps_fail_is_replaced_without_waiting_for_what_it_gives(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("bad", "fails"), worker())
    runtime.apply(start(unit("count.1"), unit("bad.1", topic="/result", x="count.1/n")))
    eventually(lambda: any(seen.errors > 700 for seen in runtime.observe()))
    applied = runtime.apply(
        ChangeSet(started=(unit("work.1", topic="/result", x="count.1/n"),), stopped=("bad.1",)),
        patience=Patience(switch_s=100.0),
    )
    assert applied.seconds["rewire"] < 50


SHORT = """
import resource, sys, time
from pathlib import Path
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 4096))
from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, Publication, RunOptions, Target, Transformation
from cfgplan_runtime import Patience, Runtime

COUNT = Transformation("count", (), (OutputPort("n", "N"),), source="running_units.py:count", run=RunOptions(rate_hz=1))
names = range(300)
units = tuple(ComputationUnit(f"count.{n}", "count", (), (Publication("n", f"/{n}"),)) for n in names)
flows = {}
def hear(event):
    flows.update(getattr(event, "flows", {}))
with Runtime([COUNT], [Target(f"{n}", "N", f"/{n}") for n in names], folder=sys.argv[1]) as runtime:
    runtime.listen(hear)
    runtime.apply(ChangeSet(started=units), patience=Patience(start_s=300))
    deadline = time.monotonic() + 120
    while sum(flow.elements > 0 for flow in flows.values()) < 300 and time.monotonic() < deadline:
        time.sleep(0.1)
    print(len(runtime.environment.units), sum(flow.elements > 0 for flow in flows.values()))
"""


def test_300_units_with_topics_run_where_1024_files_may_be_open_but_4096_could() -> None:
    line = [sys.executable, "-c", SHORT, str(Path(__file__).parent)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=8 * PATIENCE_S)
    assert done.stdout.split() == ["300", "300"], done.stderr


def test_subscribers_that_can_not_be_served_wait_and_cost_nothing(tmp_path: Path) -> None:
    line = [sys.executable, "-c", FULL_OUTLETS, str(Path(__file__).parent)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=4 * PATIENCE_S, cwd=tmp_path)
    told, share, served = done.stdout.split()
    assert int(told) == 1, done.stderr
    assert float(share) < 0.05
    assert served == "True"


FULL_OUTLETS = """
import resource, socket, sys, time
from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, Publication, RunOptions, Target, Transformation
from cfgplan_runtime import Runtime, subscribe
from cfgplan_runtime.processes.child_process import cpu_us
from cfgplan_runtime.processes.process_backend import OUTLETS
from cfgplan_runtime.streams.run_folder import address, base_folder

resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
COUNT = Transformation("count", (), (OutputPort("n", "N"),), source="running_units.py:count", run=RunOptions(rate_hz=1))
told = []
def hear(event):
    if type(event).__name__ == "OutOfDescriptors":
        told.append(event)
with Runtime([COUNT], [Target("t", "N", "/t")], folder=sys.argv[1]) as runtime:
    runtime.listen(hear)
    runtime.apply(ChangeSet(started=(ComputationUnit("count.1", "count", (), (Publication("n", "/t"),)),)))
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    clients = []
    for _ in range(40):  # the outlets have about a dozen of their own: some of these wait in the backlog
        client = socket.socket(socket.AF_UNIX)
        client.connect(str(address(base_folder() / runtime.id, "/t")))
        clients.append(client)
    outlets = runtime.pid(OUTLETS)
    resource.prlimit(outlets, resource.RLIMIT_NOFILE, (24, 24))
    more = [socket.socket(socket.AF_UNIX) for _ in range(2)]
    for client in more:
        client.connect(str(address(base_folder() / runtime.id, "/t")))
    deadline = time.monotonic() + 60
    while not told and time.monotonic() < deadline:
        time.sleep(0.05)
    before = cpu_us(outlets)
    time.sleep(4)
    share = (cpu_us(outlets) - before) / 4e6
    for client in clients:
        client.close()
    more[0].settimeout(60)
    print(len(told), share, bool(more[0].recv(1)))
"""
