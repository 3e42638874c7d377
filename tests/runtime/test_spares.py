"""Cold spares are prepared: in thought on a clock that is set, and as real processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from cfgplan_runtime import ApplyError, Runtime
from cfgplan_runtime.streams.run_folder import base_folder, remove_dead_runs
from cfgplan_runtime.supervision.events import (
    Event,
    SpareLost,
    SparePrepared,
    SpareUsed,
    UnitDied,
    UnitPrinted,
    UnitReady,
)
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from in_simulation import InSimulation
from watching import Listener, StartRuntime, seen
from world import RESULT, eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Host, RunOptions
from cfgplan.transformations import DEFAULT_LABOR_US

HOSTS = (Host("r1"), Host("r2"))


def cold(unit_id: str, host: str | None = None) -> ComputationUnit:
    return replace(unit(unit_id), host=host, standby=True)


def at(host: str, one: ComputationUnit) -> ComputationUnit:
    return replace(one, host=host)


class InThought(InSimulation):
    """A source and a worker that takes 1 s to start on r1, and a spare of the worker on r2."""

    def __init__(self, work: Behaviour | None = None) -> None:
        library = (source(), worker(run=RunOptions(memory_mb=100)))
        super().__init__(Environment((), library, (RESULT,), HOSTS), {"work": work or Behaviour(start_s=1.0)})
        self.apply(at("r1", unit("count.1")), cold("work.9", "r2"))
        self.pass_time(2.0)

    def apply(self, *started: ComputationUnit, stopped: tuple[str, ...] = (), **more: Any) -> float:
        """Carry out an update. Returns how long its units took to start."""
        return self.supervisor.apply(ChangeSet(started, stopped=stopped, **more)).seconds["start"]

    def told(self, *kinds: type[Event]) -> list[Event]:
        return [event for event in self.events if isinstance(event, kinds)]


WORK = unit("work.1", x="count.1/n")


def test_a_cold_spare_is_prepared_when_its_update_is_over_and_a_unit_begins_in_it_at_once() -> None:
    life = InThought()
    assert life.told(SparePrepared, SpareLost) == [SparePrepared("work.9", DEFAULT_LABOR_US)]
    assert "work.9" not in life.supervisor.alive
    assert life.apply(at("r2", WORK), stopped=("work.9",)) == 0.0
    assert life.told(SpareUsed) == [SpareUsed("work.1", "work.9")]
    assert not life.backend.spares


def test_a_spare_that_was_used_and_stays_one_is_prepared_again() -> None:
    life = InThought()
    life.apply(at("r2", WORK))
    assert life.asked("prepare") == [("prepare", "work.9")] * 2
    life.pass_time(2.0)
    assert life.apply(at("r2", unit("work.2", x="count.1/n"))) == 0.0


@pytest.mark.parametrize(
    ("host", "changes", "begins_in_spare"),
    [
        ("r2", {"labor_us": 5}, True),
        ("r1", {}, False),
        ("r2", {"params": {"other": 1}}, False),
        ("r2", {"source": "running_units.py:Slow"}, False),
        ("r2", {"run": RunOptions(queue=3, memory_mb=100)}, False),
    ],
)
def test_only_a_unit_of_the_same_code_on_the_same_host_begins_in_a_spare(
    host: str, changes: dict[str, Any], begins_in_spare: bool
) -> None:
    life = InThought()
    other = replace(worker("other", run=RunOptions(memory_mb=100)), **changes)
    life.apply(at(host, unit("other.1", x="count.1/n")), added_transformations=(other,))
    assert life.told(SpareUsed) == [SpareUsed("other.1", "work.9")] * begins_in_spare
    assert life.backend.spares.keys() == {"work.9"}


def test_a_spare_that_the_plan_does_not_have_any_more_is_discarded() -> None:
    life = InThought()
    life.apply(stopped=("work.9",))
    assert life.asked("discard") == [("discard", "work.9")]
    life.pass_time(2.0)
    assert len(life.asked("prepare")) == 1


def test_a_spare_whose_transformation_changes_is_prepared_anew_and_one_that_gets_dearer_stays() -> None:
    life = InThought()
    before = life.supervisor.environment.transformation["work"]
    life.apply(added_transformations=(replace(before, labor_us=10),))
    assert not life.asked("discard")
    life.apply(added_transformations=(replace(before, params={"other": 1}),))
    assert life.asked("discard", "prepare")[1:] == [("discard", "work.9"), ("prepare", "work.9")]


def test_a_spare_that_dies_is_prepared_again_ever_later_and_is_no_death_of_a_unit() -> None:
    life = InThought(Behaviour(dies_at_start="no such device"))
    environment = life.supervisor.environment
    life.pass_time(8.0)
    assert life.told(SparePrepared, SpareLost, UnitDied) == [SpareLost("work.9", "no such device")] * 5
    assert life.supervisor.environment == environment
    with pytest.raises(ApplyError, match="no such device"):
        life.apply(at("r2", WORK), stopped=("work.9",))


def test_a_spare_that_dies_after_a_good_life_is_prepared_again_at_once() -> None:
    life = InThought()
    for _ in range(3):
        life.backend.tell(SpareLost("work.9", "killed by SIGKILL"))
        life.pass_time(61.5)
    assert len(life.asked("prepare")) == 4
    assert life.told(SparePrepared)[1:] == [SparePrepared("work.9", DEFAULT_LABOR_US)] * 3


def test_a_spare_that_grows_too_large_is_ended_and_prepared_again() -> None:
    life = InThought(Behaviour(start_s=1.0, memory_bytes=101 << 20))
    assert life.told(SpareLost)[0] == SpareLost("work.9", "uses 101 MB, and may use 100")
    assert life.asked("discard", "prepare")[:3] == [
        ("prepare", "work.9"),
        ("discard", "work.9"),
        ("prepare", "work.9"),
    ]


def test_a_spare_that_an_undone_update_has_used_is_prepared_again() -> None:
    life = InThought()
    life.backend.behaviours["bad"] = Behaviour(start_s=0.5, dies_at_start="no")
    with pytest.raises(ApplyError):
        life.apply(at("r2", WORK), at("r1", unit("bad.1", x="count.1/n")), added_transformations=(worker("bad"),))
    assert life.told(SpareUsed) == [SpareUsed("work.1", "work.9")]
    assert life.backend.spares.keys() == {"work.9"}


def test_spares_on_a_host_that_is_lost_are_forgotten() -> None:
    life = InThought()
    life.backend.lose_host("r2")
    life.pass_time(5.0)
    life.backend.join_host("r2")
    life.pass_time(5.0)
    assert len(life.asked("prepare")) == 1
    life.apply(at("r2", WORK))
    assert not life.told(SpareUsed)


# Real processes.


SLOW = worker("work", "SlowToConstruct", note=__file__)


def spare_pid(runtime: Runtime, spare: str) -> int:
    """The process that waits as a spare."""
    eventually(lambda: any(event.unit == spare for event in seen(runtime, SparePrepared)))
    usage = runtime.supervisor.backend.usage(spare)
    assert usage is not None and usage.pid is not None
    return usage.pid


def titles() -> list[str]:
    """What the processes below this one are called."""
    found = []
    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it has just ended
            found.append(" ".join(child.cmdline()).strip())
    return found


def test_a_unit_begins_in_the_process_of_a_spare_with_the_state_of_the_one_before(run_units: StartRuntime) -> None:
    tally = worker("work", "Tally", run=RunOptions(state=True))
    runtime = run_units(source(), tally)
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n"), cold("work.2")))
    pid = spare_pid(runtime, "work.2")
    assert f"cfgplan {runtime.id} spare work.2" in titles()
    listener = Listener("/result")
    eventually(lambda: any(one.unit == "work.1" and one.steps > 100 for one in runtime.observe()))
    new = unit("work.3", topic="/result", x="count.1/n")
    runtime.apply(ChangeSet((new,), stopped=("work.1", "work.2")))
    assert runtime.pid("work.3") == pid
    assert seen(runtime, SpareUsed) == [SpareUsed("work.3", "work.2")]
    assert sorted(event.unit for event in seen(runtime, UnitReady)) == ["count.1", "work.1", "work.3"]
    eventually(lambda: f"cfgplan {runtime.id} work.3" in titles())
    at_swap = len(listener.received)
    eventually(lambda: len(listener.received) > at_swap + 5)
    runtime.close()
    listener.join()
    assert min(listener.values[at_swap:]) > 100, "it has counted on from what the one before had told last"


def test_a_killed_spare_is_prepared_again_and_what_runs_goes_on(run_units: StartRuntime) -> None:
    runtime = run_units(source(), SLOW)
    runtime.apply(start(unit("count.1"), cold("work.2")))
    environment, pid = runtime.environment, spare_pid(runtime, "work.2")
    os.kill(pid, signal.SIGKILL)
    eventually(lambda: len(seen(runtime, SparePrepared)) == 2)
    assert seen(runtime, SpareLost) == [SpareLost("work.2", "killed by SIGKILL")]
    assert spare_pid(runtime, "work.2") != pid
    assert not seen(runtime, UnitDied)
    assert runtime.environment == environment


def test_a_spare_that_can_not_be_constructed_is_told_and_a_start_goes_the_usual_way(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("work", "Naughty", deed="fail at start"))
    runtime.apply(start(unit("count.1"), cold("work.2")))
    eventually(lambda: bool(seen(runtime, SpareLost)))
    assert "no such camera" in seen(runtime, SpareLost)[0].cause
    with pytest.raises(ApplyError, match="no such camera"):
        runtime.apply(ChangeSet((unit("work.3", x="count.1/n"),), stopped=("work.2",)))


def test_a_spare_whose_constructor_hangs_says_where_and_is_prepared_again(
    run_units: StartRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cfgplan_runtime.processes.process_backend.PREPARE_S", 0.2)
    note = tmp_path / "go on"
    runtime = run_units(source(), replace(SLOW, params={"note": str(note)}))
    runtime.apply(start(unit("count.1"), cold("work.2")))
    eventually(lambda: bool(seen(runtime, SpareLost)))
    assert seen(runtime, SpareLost)[0] == SpareLost("work.2", "was not prepared within 0.2 s")
    assert any("in __init__" in event.line for event in seen(runtime, UnitPrinted))
    note.touch()
    eventually(lambda: bool(seen(runtime, SparePrepared)))
    assert not seen(runtime, UnitDied)


def test_what_is_still_being_prepared_is_begun_in_too(run_units: StartRuntime, tmp_path: Path) -> None:
    note = tmp_path / "used"
    runtime = run_units(source(), replace(SLOW, params={"note": str(note)}))
    runtime.listen(lambda event: note.touch() if isinstance(event, SpareUsed) else None)
    runtime.apply(start(unit("count.1"), cold("work.2")))
    runtime.apply(ChangeSet((unit("work.3", x="count.1/n"),), stopped=("work.2",)))
    assert seen(runtime, SpareUsed) == [SpareUsed("work.3", "work.2")]
    assert not seen(runtime, SparePrepared)


@pytest.mark.parametrize(
    ("changed", "text"),
    [("named.py", "def named(x):\n    return 'new one'\n"), ("names.py", "NAME = 'new one'\n")],
)
def test_a_spare_whose_code_has_changed_is_prepared_anew(tmp_path: Path, changed: str, text: str) -> None:
    (tmp_path / "running_units.py").write_text((Path(__file__).parent / "running_units.py").read_text())
    (tmp_path / "names.py").write_text("NAME = 'old'\n")
    (tmp_path / "named.py").write_text("import names\n\n\ndef named(x):\n    return names.NAME\n")
    with Runtime((source(), replace(worker(), source="named.py:named")), [RESULT], folder=tmp_path) as runtime:
        runtime.apply(start(unit("count.1"), cold("work.2")))
        pid = spare_pid(runtime, "work.2")
        (tmp_path / changed).write_text(text)
        eventually(lambda: len(seen(runtime, SparePrepared)) == 2)
        assert "has changed since it was prepared" in seen(runtime, SpareLost)[0].cause
        assert not psutil.pid_exists(pid)
        listener = Listener("/result")
        runtime.apply(ChangeSet((unit("work.3", topic="/result", x="count.1/n"),), stopped=("work.2",)))
        assert seen(runtime, SpareUsed) == [SpareUsed("work.3", "work.2")]
        eventually(lambda: bool(listener.received))
    listener.join()
    assert set(listener.values) == {"new one"}


def test_a_spare_whose_code_changed_just_now_is_not_begun_in(tmp_path: Path) -> None:
    code = tmp_path / "running_units.py"
    code.write_text((Path(__file__).parent / "running_units.py").read_text())
    with Runtime((source(), worker()), [RESULT], folder=tmp_path) as runtime:
        runtime.apply(start(unit("count.1"), cold("work.2")))
        spare_pid(runtime, "work.2")
        code.write_text(code.read_text().replace("return x\n", "return 'new'\n", 1))
        runtime.apply(ChangeSet((unit("work.3", x="count.1/n"),), stopped=("work.2",)))
        assert not seen(runtime, SpareUsed)
        assert [event.unit for event in seen(runtime, UnitReady)] == ["count.1", "work.3"]


def test_a_prepared_spare_ends_with_a_killed_run() -> None:
    code = """
import sys, time
sys.path.insert(0, sys.argv[1])
from test_spares import RESULT, SLOW, Runtime, cold, source, spare_pid, start, unit
runtime = Runtime((source(), SLOW), [RESULT], folder=sys.argv[1])
runtime.apply(start(unit("count.1"), cold("work.2")))
print(spare_pid(runtime, "work.2"), flush=True)
time.sleep(600)
"""
    command = [sys.executable, "-c", code, str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        spare = psutil.Process(int(process.stdout.readline()))
        process.kill()
    eventually(lambda: not spare.is_running())
    remove_dead_runs(base_folder())
