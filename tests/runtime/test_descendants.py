"""No death leaves a process behind, whatever the unit has started. Real processes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.processes import descendants, guard
from cfgplan_runtime.processes.process_backend import OUTLETS
from cfgplan_runtime.supervision.events import UnitDied
from unit_signals import signal_unit
from watching import StartRuntime, seen
from world import eventually, source, start, unit

from cfgplan.domain import ChangeSet, InputPort, OutputPort, Transformation

WAYS = {"started": 1, "in_a_session": 1, "forked": 1, "daemon": 1, "family": 2}
"""How unit code starts processes, and how many."""
FOLDER = Path(__file__).parent
KILLED_RUN = """
import sys, time
from pathlib import Path
from test_descendants import started_units
from cfgplan_runtime import Runtime
runtime = Runtime(folder=Path(sys.argv[1]))
started_units(runtime, Path(sys.argv[2]))
time.sleep(3600)
"""


def started_units(runtime: Runtime, notes: Path) -> None:
    """Start a unit for each way; the processes note themselves in folders of `notes`."""
    for way in WAYS:
        (notes / way).mkdir(parents=True, exist_ok=True)
    library = [source(), *(starting(way, notes) for way in WAYS)]
    units = [unit("count.1"), *(unit(f"{way}.1", x="count.1/n") for way in WAYS)]
    runtime.apply(ChangeSet(tuple(units), added_transformations=tuple(library)))


def starting(way: str, notes: Path) -> Transformation:
    ports = (InputPort("x", "N"),), (OutputPort("y", "Y"),)
    params = {"way": way, "notes": str(notes / way)}
    return Transformation(way, *ports, source="daemon_units.py:Starts", params=params)


def noted(notes: Path, way: str = "*") -> set[int]:
    return {int(file.name) for file in notes.glob(f"{way}/*")}


def alive(pids: set[int]) -> set[int]:
    found = set[int]()
    for pid in pids:
        try:
            if psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                found.add(pid)
        except psutil.NoSuchProcess:
            pass
    return found


@pytest.fixture
def runtime(run_units: StartRuntime, tmp_path: Path) -> Runtime:
    """A runtime with a unit for each way, once all processes have noted themselves."""
    made = run_units()
    started_units(made, tmp_path)
    await_all(tmp_path)
    return made


def await_all(notes: Path) -> None:
    eventually(lambda: len(noted(notes)) == sum(WAYS.values()))
    assert alive(noted(notes)) == noted(notes)


def nursery(runtime: Runtime) -> int:
    return psutil.Process(runtime.pid("count.1")).ppid()


def kill_units(runtime: Runtime) -> None:
    for way in WAYS:
        signal_unit(runtime, f"{way}.1")
    eventually(lambda: len(seen(runtime, UnitDied)) == len(WAYS))


def stop_units(runtime: Runtime) -> None:
    runtime.apply(ChangeSet(stopped=tuple(f"{way}.1" for way in WAYS)))


def kill_nursery(runtime: Runtime) -> None:
    os.kill(nursery(runtime), signal.SIGKILL)
    eventually(lambda: len(seen(runtime, UnitDied)) == len(WAYS) + 1)


def close_beside_a_hung_nursery(runtime: Runtime) -> None:
    os.kill(nursery(runtime), signal.SIGSTOP)
    runtime.close()


@pytest.mark.parametrize("end", [kill_units, stop_units, kill_nursery, close_beside_a_hung_nursery, Runtime.close])
def test_what_units_have_started_ends_with_them(
    runtime: Runtime, tmp_path: Path, end: Callable[[Runtime], None]
) -> None:
    end(runtime)
    eventually(lambda: not alive(noted(tmp_path)))


GUARDED = """
import os, subprocess, sys, time
from cfgplan_runtime.processes import descendants, guard
def refuse(name):
    raise OSError
if "unmarked" not in sys.argv:
    guard.NurseryGroup = refuse
held = guard.post_guard("run a", "mark a")
if os.fork() == 0:
    os.close(held)
    if "unmarked" not in sys.argv:
        descendants.put_mark("mark a", 1)
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"], start_new_session=True)
    time.sleep(3600)
print(flush=True)
time.sleep(3600)
"""


def tree(pid: int) -> list[psutil.Process]:
    return psutil.Process(pid).children(recursive=True)


V2_ALONE = 'umount -R /sys/fs/cgroup && mount -t cgroup2 none /sys/fs/cgroup && exec "$@"'
"""Run a command where cgroup v2 is the only hierarchy, as on new systems; only root can make such a place."""
IN_V2_ALONE = ("unshare", "--mount", "sh", "-c", V2_ALONE, "sh")


@pytest.mark.parametrize(("is_marked", "place"), [(True, ()), (False, ()), (False, IN_V2_ALONE)])
def test_what_a_killed_family_leaves_is_ended_by_its_mark_or_as_a_group(
    is_marked: bool, place: tuple[str, ...]
) -> None:
    if place and (shutil.which(place[0]) is None or subprocess.run([*place, "true"]).returncode != 0):
        pytest.skip("no control groups (cgroup v2) can be made here")
    if not is_marked:
        try:
            group = guard.NurseryGroup(f"cfgplan-test-{os.getpid()}")
        except OSError:
            pytest.skip("no control groups (cgroup v2) can be made here")
        group.end()
        assert not group.path.exists()
    line = [*place, sys.executable, "-c", GUARDED, *([] if is_marked else ["unmarked"])]
    with subprocess.Popen(line, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        eventually(lambda: len(tree(process.pid)) == 2)
        child, left = tree(process.pid)
        for one in (process.pid, child.pid):
            os.kill(one, signal.SIGKILL)
    eventually(lambda: not alive({child.pid, left.pid}))


@pytest.mark.parametrize("with_nursery", [False, True])
def test_what_units_have_started_ends_with_a_run_that_is_killed(tmp_path: Path, with_nursery: bool) -> None:
    line = [sys.executable, "-c", KILLED_RUN, str(FOLDER), str(tmp_path)]
    path = os.pathsep.join([str(FOLDER), *sys.path])
    run = subprocess.Popen(line, env={**os.environ, "PYTHONPATH": path})
    with run:
        await_all(tmp_path)
        (of_run,) = [child for child in tree(run.pid) if "nursery" in " ".join(child.cmdline())]
        killed = [run.pid, of_run.pid] if with_nursery else [run.pid]
        for number in (signal.SIGSTOP, signal.SIGKILL):  # neither sees the end of the other
            for pid in killed:
                os.kill(pid, number)
    eventually(lambda: not alive(noted(tmp_path)))
    for left in Path(os.environ["XDG_RUNTIME_DIR"], "cfgplan").glob("*/*"):
        left.unlink()
    for folder in Path(os.environ["XDG_RUNTIME_DIR"], "cfgplan").iterdir():
        folder.rmdir()


def test_what_a_living_unit_has_started_stays_when_another_one_ends(runtime: Runtime, tmp_path: Path) -> None:
    signal_unit(runtime, "daemon.1")
    eventually(lambda: not alive(noted(tmp_path, "daemon")))
    signal_unit(runtime, OUTLETS)
    runtime.apply(ChangeSet(stopped=("started.1",)))
    eventually(lambda: not alive(noted(tmp_path, "started")))
    others = noted(tmp_path) - noted(tmp_path, "daemon") - noted(tmp_path, "started")
    assert alive(others) == others


def test_a_daemon_that_ends_before_its_unit_is_reaped(run_units: StartRuntime, tmp_path: Path) -> None:
    (tmp_path / "brief").mkdir()
    runtime = run_units(source(), starting("brief", tmp_path))
    runtime.apply(start(unit("count.1"), unit("brief.1", x="count.1/n")))
    eventually(lambda: len(noted(tmp_path)) == 1)
    (pid,) = noted(tmp_path)
    eventually(lambda: not psutil.pid_exists(pid))
    assert runtime.pid("brief.1") is not None


def test_a_mark_tells_the_run_and_the_child() -> None:
    code = (
        "import subprocess, sys\n"
        "from cfgplan_runtime.processes.descendants import put_mark\n"
        "put_mark('run a', 7)\n"
        "subprocess.run([sys.executable, '-c', 'import time; print(flush=True); time.sleep(3600)'])\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        (child,) = psutil.Process(process.pid).children()
        assert descendants.serial_of(child.pid, "run a") == 7
        assert descendants.serial_of(child.pid, "run b") is None
        assert descendants.serial_of(os.getpid(), "run a") is None
        descendants.end_marked("run b")
        assert child.is_running()
        descendants.end_marked("run a")
    eventually(lambda: not alive({child.pid}))
