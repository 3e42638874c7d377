"""What goes wrong with real processes, and what does not follow from it."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

import psutil
import pytest
from cfgplan_runtime import (
    ApplyError,
    Patience,
    Runtime,
    SimulatedBackend,
    SimulatedRuntime,
    StaleChangeSetError,
    subscribe,
)
from cfgplan_runtime.errors import NoSuchTopicError, RuntimeFaultError, UnsupportedPlatformError
from cfgplan_runtime.processes import nursery_link
from cfgplan_runtime.processes.nursery_link import start_helper
from cfgplan_runtime.runtime import Inline, OwnThread
from cfgplan_runtime.streams.run_folder import base_folder, remove_dead_runs, topics_of
from cfgplan_runtime.supervision.events import (
    OutletsLost,
    RolledBack,
    SourceExhausted,
    UnitDied,
    UnitFailed,
    UnitHung,
    UnitPrinted,
    UnitTooLarge,
)
from cfgplan_runtime.supervision.wiring import starved_units
from living import lives, living
from unit_signals import signal_unit, unit_pid
from watching import Listener, StartRuntime, seen
from world import PATIENCE_S, eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, InputPort, RunOptions


@pytest.mark.parametrize(
    ("deed", "kind", "part"),
    [
        ("raise", "raised", "five is too much"),
        ("not sendable", "can't be sent", "object"),
        ("wrong ports", "wrong ports", "no output port 'z'"),
    ],
)
def test_unit_code_that_fails_in_a_step_is_reported_and_goes_on(
    run_units: StartRuntime, deed: str, kind: str, part: str
) -> None:
    naughty = worker("naughty", "TwoOutputs" if deed == "wrong ports" else "Naughty", deed=deed)
    if deed == "wrong ports":
        naughty = worker("naughty", "TwoOutputs", outputs=("even", "double"), deed=deed)
    runtime = run_units(source(), naughty, worker())
    feeds = unit("naughty.1", x="count.1/n")
    runtime.apply(start(unit("count.1"), feeds, unit("work.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: bool(seen(runtime, UnitFailed)) and len(listener.received) > 20)
    failure = seen(runtime, UnitFailed)[0]
    assert (failure.unit, failure.what) == ("naughty.1", kind)
    assert part in failure.text
    assert failure.step > 0
    assert seen(runtime, UnitDied) == []
    eventually(lambda: any(o.errors and o.last_error for o in runtime.observe()))
    runtime.close()
    listener.join()
    assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


def test_a_failure_that_repeats_is_reported_once_and_counted(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("naughty", "TwoOutputs", outputs=("even", "double"), deed="wrong ports"))
    runtime.apply(start(unit("count.1"), unit("naughty.1", x="count.1/n")))
    eventually(lambda: any(failure.suppressed for failure in seen(runtime, UnitFailed)))
    first, more = seen(runtime, UnitFailed)[:2]
    assert (first.what, first.suppressed) == ("wrong ports", 0)
    assert (more.what, more.text) == (first.what, first.text)
    assert more.suppressed
    assert more.step > first.step


def test_the_traceback_names_the_users_line(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("naughty", "Naughty", deed="raise"))
    runtime.apply(start(unit("count.1"), unit("naughty.1", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitFailed)))
    assert 'raise ValueError("five is too much")' in seen(runtime, UnitFailed)[0].text


@pytest.mark.parametrize(("deed", "part"), [("exit", "SystemExit: 4"), ("hard exit", "exit status 5")])
def test_a_unit_that_exits_is_reported_and_takes_nobody_with_it(run_units: StartRuntime, deed: str, part: str) -> None:
    runtime = run_units(source(rate_hz=5), worker("naughty", "Naughty", deed=deed), worker())
    naughty = unit("naughty.1", x="count.1/n")
    runtime.apply(start(unit("count.1"), naughty, unit("work.1", topic="/result", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitDied)))
    death = seen(runtime, UnitDied)[0]
    assert death.unit == "naughty.1"
    assert part in death.cause
    assert death.how == "died"
    assert [unit.id for unit in runtime.environment.units] == ["count.1", "work.1"]


def test_a_generator_that_raises_has_failed_as_a_unit(run_units: StartRuntime) -> None:
    runtime = run_units(source(code="raising"))
    with suppress(ApplyError):  # on a slow machine it dies before it is published
        runtime.apply(start(unit("count.1", topic="/result", port="n")))
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert seen(runtime, UnitDied)[0].cause.endswith("OSError: camera: frame timeout (in step 3)")
    assert seen(runtime, SourceExhausted) == []


@pytest.mark.parametrize("raises_last", [True, False])
def test_a_source_that_ends_after_an_exception_has_failed_and_others_that_raised_go_on(
    run_units: StartRuntime, raises_last: bool
) -> None:
    flaky = replace(source(code="Flaky"), params={"last": 9, "raises_last": raises_last})
    runtime = run_units(flaky)
    with suppress(ApplyError):  # on a slow machine it dies before it is published
        runtime.apply(start(unit("count.1", topic="/result", port="n")))
    eventually(lambda: bool(seen(runtime, UnitDied) or seen(runtime, SourceExhausted)))
    assert [bool(seen(runtime, kind)) for kind in (UnitDied, SourceExhausted)] == [raises_last, not raises_last]
    eventually(lambda: sum(failure.suppressed or 1 for failure in seen(runtime, UnitFailed)) >= 4)


def test_what_a_unit_prints_is_an_event(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("naughty", "Naughty", deed="print"))
    runtime.apply(start(unit("count.1"), unit("naughty.1", x="count.1/n")))
    eventually(lambda: len(seen(runtime, UnitPrinted)) >= 2)
    lines = {(event.unit, event.line) for event in seen(runtime, UnitPrinted)}
    assert lines == {("naughty.1", "hello from the unit"), ("naughty.1", "and from its stderr")}


def test_what_a_unit_prints_without_end_is_left_out_and_counted_and_stops_nobody(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("chatty", "Chatterer"), worker())
    feeds = unit("chatty.1", x="count.1/n")
    runtime.apply(start(unit("count.1"), feeds, unit("work.1", topic="/result", x="count.1/n")))
    left_out = "at most 500 a second are shown"
    eventually(lambda: any(event.line.endswith(left_out) for event in seen(runtime, UnitPrinted)))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    runtime.apply(ChangeSet(started=(unit("work.2", x="count.1/n"),)))
    runtime.stop()
    assert seen(runtime, UnitDied) == []


def test_who_goes_on_printing_for_a_dead_unit_stops_nobody(run_units: StartRuntime, tmp_path: Path) -> None:
    note = tmp_path / "pid"
    runtime = run_units(source(), worker("leaving", "LeavesAChatterer", note=str(note)))
    try:
        runtime.apply(start(unit("count.1"), unit("leaving.1", x="count.1/n")))
        eventually(lambda: [event.unit for event in seen(runtime, UnitDied)] == ["leaving.1"])
        runtime.apply(start(unit("leaving.2", x="count.1/n")))
        eventually(lambda: any(o.unit == "leaving.2" and o.steps > 5 for o in runtime.observe()))
    finally:
        with suppress(ProcessLookupError):  # it has ended with its unit
            os.kill(int(note.read_text()), signal.SIGKILL)


def test_a_unit_that_writes_into_foreign_descriptors_takes_nobody_with_it(
    run_units: StartRuntime, tmp_path: Path
) -> None:
    runtime = run_units(source(), worker("scribbler", "Scribbler", note=str(tmp_path / "done")), worker())
    feeds = unit("scribbler.1", x="count.1/n")
    runtime.apply(start(unit("count.1"), feeds, unit("work.1", topic="/result", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert {event.unit for event in seen(runtime, UnitDied)} == {"scribbler.1"}
    assert "file descriptors that are not its own" in seen(runtime, UnitDied)[0].cause
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)


def test_a_hung_unit_is_killed_after_it_has_said_where_it_is(run_units: StartRuntime) -> None:
    run = RunOptions(hang_us=2_500_000)
    runtime = run_units(source(), worker("naughty", "Naughty", run=run, deed="hang"))
    runtime.apply(start(unit("count.1"), unit("naughty.1", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert [event.unit for event in seen(runtime, UnitHung)] == ["naughty.1"]
    assert any("running_units.py" in event.line for event in seen(runtime, UnitPrinted))


def test_a_stopped_process_is_noticed_and_killed(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker(run=RunOptions(hang_us=2_500_000)))
    runtime.apply(start(unit("count.1"), unit("work.1", x="count.1/n")))
    eventually(lambda: any(o.unit == "work.1" and o.steps for o in runtime.observe()))
    signal_unit(runtime, "work.1", signal.SIGSTOP)
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert [event.unit for event in seen(runtime, UnitHung)] == ["work.1"]
    assert re.fullmatch(r"killed by SIGKILL \(in step [1-9]\d* or later\)", seen(runtime, UnitDied)[0].cause)


def test_a_unit_that_eats_memory_harms_nobody_else(run_units: StartRuntime) -> None:
    hungry = worker("naughty", "Naughty", run=RunOptions(memory_mb=200), deed="eat memory")
    runtime = run_units(source(), hungry)
    runtime.apply(start(unit("count.1"), unit("naughty.1", x="count.1/n")))
    eventually(lambda: bool(seen(runtime, UnitFailed) or seen(runtime, UnitTooLarge)))
    failures = seen(runtime, UnitFailed)
    assert not failures or "MemoryError" in failures[0].text
    assert runtime.environment.unit["count.1"]


@pytest.mark.parametrize(
    ("deed", "part"),
    [
        ("fail at start", r"(?s)naughty\.1 could not start: .*ValueError: no such camera"),
        ("die at start", r"naughty\.1 died: .*exit status 3"),
    ],
)
def test_an_update_whose_unit_can_not_start_is_undone(run_units: StartRuntime, deed: str, part: str) -> None:
    runtime = run_units(source(), worker(), worker("naughty", "Naughty", deed=deed))
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    before = runtime.environment
    listener = Listener("/result")
    change = ChangeSet(
        started=(unit("naughty.1", topic="/result", x="work.2/y"), unit("work.2", x="count.1/n")), stopped=("work.1",)
    )
    with pytest.raises(ApplyError, match=part):
        runtime.apply(change, basis=before)
    assert runtime.environment == before
    assert [event.id for event in seen(runtime, RolledBack)] != []
    eventually(lambda: len(listener.received) > 20)
    assert {o.unit for o in runtime.observe()} == {"count.1", "work.1"}
    runtime.close()
    listener.join()
    assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


def test_an_input_that_has_gone_over_goes_back_when_another_new_unit_dies(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker(), worker("naughty", "Naughty", deed="die at first"))
    runtime.apply(
        start(
            unit("count.1"),
            unit("work.1", x="count.1/n"),
            unit("work.2", topic="/result", x="work.1/y"),
            unit("work.3", x="work.1/y"),
        )
    )
    before = runtime.environment
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    change = ChangeSet(
        started=(unit("work.4", x="count.1/n"), unit("naughty.1", x="count.1/n")),
        rewired=(unit("work.2", topic="/result", x="work.4/y"), unit("work.3", x="naughty.1/y")),
        stopped=("work.1",),
    )
    with pytest.raises(ApplyError, match=r"naughty\.1"):
        runtime.apply(change)
    assert runtime.environment == before
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 20)
    runtime.close()
    listener.join()
    assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


def test_an_update_whose_unit_is_never_ready_is_undone_after_the_unit_has_said_where_it_is(
    run_units: StartRuntime,
) -> None:
    runtime = run_units(source(), worker("naughty", "Naughty", deed="never ready"))
    runtime.apply(start(unit("count.1")))
    with pytest.raises(ApplyError, match=r"naughty\.1 was not ready"):
        runtime.apply(start(unit("naughty.1", x="count.1/n")), patience=Patience(start_s=0.5, stop_s=0.2))
    assert [unit.id for unit in runtime.environment.units] == ["count.1"]
    printed = [event.line for event in seen(runtime, UnitPrinted) if event.unit == "naughty.1"]
    assert any("running_units.py" in line and "in __init__" in line for line in printed)


def test_source_that_does_not_exist_is_named(run_units: StartRuntime) -> None:
    runtime = run_units(worker(code="nowhere"))
    with pytest.raises(ApplyError, match=r"running_units\.py has no nowhere"):
        runtime.apply(start(unit("work.1")))


def test_a_change_set_is_carried_out_once(run_units: StartRuntime) -> None:
    runtime = run_units(source())
    first = runtime.apply(start(unit("count.1")), id="one")
    assert runtime.apply(start(unit("count.1")), id="one") == first
    with pytest.raises(StaleChangeSetError, match="runs already"):
        runtime.apply(start(unit("count.1")), id="two")


def test_the_death_of_the_outlets_is_mended(run_units: StartRuntime) -> None:
    runtime = run_units(source())
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    signal_unit(runtime, "")
    eventually(lambda: bool(seen(runtime, OutletsLost)))
    before = len(listener.received)
    eventually(lambda: len(listener.received) > before + 3)
    runtime.close()
    listener.join()
    assert listener.values == sorted(set(listener.values))


def test_what_a_unit_has_started_goes_with_it(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("naughty", "Naughty", deed="start a child"))
    runtime.apply(start(unit("count.1"), unit("naughty.1", topic="/result", x="count.1/n")))
    process = psutil.Process(runtime.pid("naughty.1"))
    eventually(lambda: bool(process.children()))
    (child,) = process.children()[:1]
    process.kill()
    eventually(lambda: not lives(child))


SUPERVISOR = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from cfgplan_runtime import Runtime
from world import RESULT, source, start, unit, worker

if __name__ == "__main__":
    runtime = Runtime([source(), worker("naughty", "Naughty", deed="hang")], [RESULT], folder={tests!r})
    runtime.apply(start(unit("count.1", topic="/result", port="n"), unit("naughty.1", x="count.1/n")))
    print("running", flush=True)
    time.sleep(3600)
"""


def test_nothing_outlives_a_killed_supervisor(run_units: StartRuntime, nothing_is_left_behind: Path) -> None:
    script = SUPERVISOR.format(tests=str(Path(__file__).parent))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as supervisor:
        assert supervisor.stdout is not None
        assert supervisor.stdout.readline() == b"running\n"
        family = psutil.Process(supervisor.pid).children(recursive=True)
        assert len(family) == 4
        supervisor.kill()
    eventually(lambda: not living(family))
    runs = nothing_is_left_behind / "cfgplan"
    assert len(list(runs.iterdir())) == 1
    with pytest.raises(NoSuchTopicError):
        subscribe("/result")
    runtime = run_units(source())
    assert [path.name for path in runs.iterdir()] == [runtime.id]


FORKING = SUPERVISOR.replace('deed="hang"', 'deed="start a child"')


def relatives(process: psutil.Process) -> list[psutil.Process]:
    with suppress(psutil.Error):
        return process.children(recursive=True)
    return []


@pytest.mark.parametrize("killed", ["the supervisor", "the nursery"])
def test_what_units_have_started_outlives_nobody_who_is_killed(nothing_is_left_behind: Path, killed: str) -> None:
    assert nothing_is_left_behind
    script = FORKING.format(tests=str(Path(__file__).parent))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as supervisor:
        try:
            assert supervisor.stdout is not None
            assert supervisor.stdout.readline() == b"running\n"
            one = psutil.Process(supervisor.pid)
            eventually(lambda: len(relatives(one)) >= 5)
            family = relatives(one)
            nursery = next(each for each in one.children() if "nursery" in " ".join(each.cmdline()))
            victim, left = (one, family) if killed == "the supervisor" else (nursery, relatives(nursery))
            victim.kill()
            eventually(lambda: not living(left))
        finally:
            supervisor.kill()
    eventually(lambda: not living(family))
    remove_dead_runs(base_folder())


def test_two_runtimes_do_not_disturb_each_other(run_units: StartRuntime) -> None:
    one, two = run_units(source()), run_units(source())
    for runtime in (one, two):
        runtime.apply(start(unit("count.1", topic="/result", port="n")))
    with pytest.raises(NoSuchTopicError, match="several runs"):
        subscribe("/result")
    one.close()
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    two.close()
    listener.join()


CONSUMER = """
import cfgplan_runtime
for received in cfgplan_runtime.subscribe("/result"):
    print(received.value, flush=True)
"""


def test_a_consumer_that_is_killed_harms_nobody(run_units: StartRuntime) -> None:
    runtime = run_units(source())
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    with subprocess.Popen([sys.executable, "-c", CONSUMER], stdout=subprocess.PIPE) as consumer:
        assert consumer.stdout is not None
        assert int(consumer.stdout.readline()) >= 0
        consumer.kill()
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 20)
    assert not seen(runtime, OutletsLost)
    runtime.close()
    listener.join()
    assert listener.subscription.dropped == 0
    assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


NOBODY = 65534
STRANGER = """
import os, socket, sys
os.setgroups([]); os.setgid({nobody}); os.setuid({nobody})
try:
    socket.socket(socket.AF_UNIX).connect(sys.argv[1])
except PermissionError:
    sys.exit(7)
"""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user to try")
def test_another_user_can_not_connect_to_a_topic(run_units: StartRuntime, monkeypatch: pytest.MonkeyPatch) -> None:
    with TemporaryDirectory() as base:
        Path(base).chmod(0o755)
        monkeypatch.setenv("XDG_RUNTIME_DIR", base)
        runtime = run_units(source())
        runtime.apply(start(unit("count.1", topic="/result", port="n")))
        sockets = [path for path in Path(base, "cfgplan", runtime.id).rglob("*") if path.is_socket()]
        assert sockets != []
        script = STRANGER.format(nobody=NOBODY)
        for path in sockets:
            assert subprocess.run([sys.executable, "-c", script, path], check=False).returncode == 7
        runtime.close()


def test_a_folder_whose_name_is_too_long_for_sockets_is_refused_with_the_mend(
    run_units: StartRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / ("x" * 100)))
    with pytest.raises(RuntimeFaultError, match="set XDG_RUNTIME_DIR to a shorter folder"):
        run_units(source())


def test_a_run_on_a_full_disk_runs_on_without_a_note_of_its_clock(
    run_units: StartRuntime, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, *_: object, **__: object) -> None:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        runtime = run_units(source())
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    with subscribe("/result") as topic:
        came = next(iter(topic))
        assert 0 <= topic.now_ns() - came.time_ns < PATIENCE_S * 1e9


def test_where_no_descriptor_is_left_for_a_run_no_folder_is_left(
    run_units: StartRuntime, nothing_is_left_behind: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    really = os.open

    def short(path: str | Path, *more: int) -> int:
        if str(path).endswith("lock"):
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return really(path, *more)

    monkeypatch.setattr(os, "open", short)
    with pytest.raises(RuntimeFaultError, match="Too many open files"):
        run_units(source())
    assert list((nothing_is_left_behind / "cfgplan").iterdir()) == []


def test_topics_that_are_closed_while_they_are_listed_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "there.topic").write_text("/there")
    (tmp_path / "gone.topic").symlink_to(tmp_path / "nowhere")
    assert topics_of(tmp_path) == ["/there"]


def test_only_the_user_can_reach_the_topics(run_units: StartRuntime, nothing_is_left_behind: Path) -> None:
    runtime = run_units(source())
    runs = nothing_is_left_behind / "cfgplan"
    assert (runs.stat().st_mode & 0o777, (runs / runtime.id).stat().st_mode & 0o777) == (0o700, 0o700)


@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
def test_unit_code_may_use_processes_of_its_own(run_units: StartRuntime, method: str) -> None:
    runtime = run_units(source(rate_hz=10), worker("square", "Pool", method=method))
    runtime.apply(start(unit("count.1"), unit("square.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.values) > 3)
    assert seen(runtime, UnitFailed) == []
    runtime.close()
    listener.join()
    assert all(round(value**0.5) ** 2 == value for value in listener.values)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, a disk that is always full")
def test_a_full_disk_for_the_log_harms_nothing(run_units: StartRuntime) -> None:
    runtime = run_units(source(), log="/dev/full")
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    runtime.close()
    listener.join()


def test_cpu_clocks_agree_with_psutil(run_units: StartRuntime) -> None:
    from cfgplan_runtime.processes.child_process import cpu_us, cpu_us_by_psutil

    runtime = run_units(source(rate_hz=1000))
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    pid = unit_pid(runtime, "count.1")
    eventually(lambda: (cpu_us(pid) or 0) > 200_000)
    before, by_psutil, after = cpu_us(pid), cpu_us_by_psutil(pid), cpu_us(pid)
    assert before is not None
    assert by_psutil is not None
    assert after is not None
    # psutil counts user and system time in whole ticks of 10 ms each.
    assert before - 30_000 < by_psutil < after + 30_000
    (observation,) = runtime.observe()
    assert observation.labor_us > 0
    assert observation.memory_bytes > 1_000_000


def test_the_death_of_the_nursery_takes_all_units_and_the_next_update_starts_anew(run_units: StartRuntime) -> None:
    runtime = run_units(source())
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    psutil.Process(runtime.pid("count.1")).parent().kill()
    eventually(lambda: not runtime.environment.units)
    before = len(listener.received)
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    eventually(lambda: len(listener.received) > before + 3)
    runtime.close()
    listener.join()


def test_windows_is_refused_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    import cfgplan_runtime

    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.delitem(vars(cfgplan_runtime), "Runtime", raising=False)  # another test may have imported it
    with pytest.raises(UnsupportedPlatformError, match="needs Linux or macOS"):
        _ = cfgplan_runtime.Runtime


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc")
def test_no_process_of_a_run_uses_shared_memory_that_a_kill_could_leave_behind(run_units: StartRuntime) -> None:
    runtime = run_units(source(code="image_units.py:images"), worker())
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    nursery = psutil.Process(runtime.pid("work.1")).parent()
    assert nursery is not None
    family = [nursery, *nursery.children()]
    assert len(family) == 4
    assert not [p for p in family if "/dev/shm/" in Path(f"/proc/{p.pid}/maps").read_text()]


def test_a_runtime_of_processes_works_in_the_calling_thread_too(run_units: StartRuntime) -> None:
    here = Inline()
    runtime = run_units(source(), worker(), executor=here)
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    signal_unit(runtime, "count.1")
    for _ in range(round(10 * PATIENCE_S)):
        if "count.1" not in runtime.environment.unit:
            break
        here.wait(threading.Event(), 0.1)
    assert [died.unit for died in seen(runtime, UnitDied)] == ["count.1"]


def test_what_is_asked_just_as_a_runtime_ends_is_refused(
    run_units: StartRuntime, monkeypatch: pytest.MonkeyPatch
) -> None:
    executor = OwnThread()
    runtime = run_units(source(), executor=executor)

    class Late(SimpleQueue[Callable[[], None]]):
        """What is put there comes when the thread has ended."""

        def put(self, item: Callable[[], None], *_: Any, **__: Any) -> None:
            executor.close()
            super().put(item)

    monkeypatch.setattr(executor, "_work", Late())
    with ThreadPoolExecutor(1) as asking, pytest.raises(RuntimeFaultError, match="closed"):
        asking.submit(runtime.observe).result(PATIENCE_S)


def test_a_signal_that_does_not_wake_the_main_thread_interrupts_its_wait_for_a_runtime() -> None:
    """Another thread gets the signal, which has the effect of one that comes just before the wait."""
    goes_on, is_closed, went_on = threading.Event(), threading.Event(), list[bool]()

    class Slow(SimulatedBackend):
        def close(self) -> None:
            is_closed.set()

    def make() -> Slow:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR1})
        os.kill(os.getpid(), signal.SIGUSR1)
        went_on.append(goes_on.wait(PATIENCE_S))
        return Slow({})

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    handler = signal.signal(signal.SIGUSR1, interrupt)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
    try:
        with pytest.raises(KeyboardInterrupt):
            Runtime(backend=make)
    finally:
        goes_on.set()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGUSR1, handler)
    assert is_closed.wait(PATIENCE_S), "what was made too late is closed"
    assert went_on == [True], "the wait ended before the runtime was made"


def test_ctrl_c_reaches_no_process_that_makes_the_units_from_its_first_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nursery_link, "subprocess", subprocess)  # not a warm one
    process, ours = start_helper("import sys; sys.stdin.read()")
    with ours, process:
        assert os.getpgid(process.pid) == process.pid != os.getpgrp()


def test_a_closed_runtime_in_thought_says_so_too() -> None:
    with SimulatedRuntime([source()]) as runtime:
        runtime.apply(start(unit("count.1")))
    with pytest.raises(RuntimeFaultError, match="the runtime is closed"):
        runtime.apply(ChangeSet(stopped=("count.1",)))


def test_a_unit_steps_without_its_optional_input_and_gets_none_for_it(run_units: StartRuntime) -> None:
    ports = (InputPort("x", "N"), InputPort("z", "N", optional=True))
    runtime = run_units(source(), replace(worker("work", "lacks"), inputs=ports))
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    assert starved_units(runtime.environment) == set()
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 5)
    runtime.close()
    listener.join()
    assert all(is_none for _, is_none in listener.values)
