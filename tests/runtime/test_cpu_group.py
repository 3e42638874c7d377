"""The control group that limits units' CPU time: what is written where, and what is told where it can't be had."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.processes.cpu_group import cpu_groups
from cfgplan_runtime.processes.process_backend import ProcessBackend
from world import RESULT, source, start, unit

BUSY = """
import os, time
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.processes.cpu_group import cpu_groups
try:
    group = cpu_groups({"units": 100_000})["units"]
except RuntimeFaultError as error:
    print(error)
    raise SystemExit(1)
busy = os.fork()
while not busy:
    pass
group.take(busy)
time.sleep(2)
os.kill(busy, 9)
print(os.wait4(busy, 0)[2].ru_utime)
group.close()
"""


def groups(folder: Path, *, controllers: str = "cpu memory", path: str = "/user/scope") -> tuple[Path, Path]:
    """A folder like the kernel's, and a file that names the group of this process there."""
    here = folder / "cgroup" / path.lstrip("/")
    here.mkdir(parents=True)
    (here / "cgroup.controllers").write_text(controllers)
    told = folder / "told"
    told.write_text(f"4:memory:/elsewhere\n0::{path}\n")
    return here, told


def test_units_get_a_group_with_the_limit_and_this_process_one_beside_it(tmp_path: Path) -> None:
    here, told = groups(tmp_path)
    group = cpu_groups({"units": 250_000}, root=tmp_path / "cgroup", told=told)["units"]
    group.take(4711)
    me = os.getpid()
    assert (here / f"cfgplan-{me}" / "cgroup.procs").read_text() == str(me)
    assert (here / "cgroup.subtree_control").read_text() == "+cpu"
    assert group.path.parent == here
    assert {file.name: file.read_text() for file in group.path.iterdir()} == {
        "cpu.max": "25000 100000",
        "cgroup.procs": "4711",
    }


@pytest.mark.parametrize("controllers", ["", "hugetlb"])
def test_where_no_control_group_limits_cpu_time_nothing_is_made(tmp_path: Path, controllers: str) -> None:
    here, told = groups(tmp_path, controllers=controllers)
    with pytest.raises(RuntimeFaultError, match="no control groups"):
        cpu_groups({"units": 250_000}, root=tmp_path / "cgroup", told=told)
    assert [file.name for file in here.iterdir()] == ["cgroup.controllers"]


def test_a_group_that_may_not_be_divided_is_left_as_it_was(tmp_path: Path) -> None:
    here, told = groups(tmp_path)
    (here / f"cfgplan-{os.getpid()}-0").write_text("in the way")
    with pytest.raises(RuntimeFaultError, match=r"can be made in .*systemd-run --user --scope -p Delegate=yes"):
        cpu_groups({"units": 250_000}, root=tmp_path / "cgroup", told=told)
    assert (here / "cgroup.procs").read_text() == str(os.getpid())


def test_where_the_system_allows_it_a_busy_process_takes_no_more_than_the_limit() -> None:
    done = subprocess.run([sys.executable, "-c", BUSY], capture_output=True, text=True, check=False)
    if done.returncode == 1:
        pytest.skip(done.stdout.strip())
    assert float(done.stdout) < 0.5, done.stderr


def test_units_and_not_the_outlets_are_put_in_the_group(tmp_path: Path) -> None:
    _, told = groups(tmp_path)
    group = cpu_groups({"units": 250_000}, root=tmp_path / "cgroup", told=told)["units"]
    held: list[int] = []
    group.take = held.append  # type: ignore[method-assign]
    backend = partial(ProcessBackend, folder=Path(__file__).parent, cpu=group)
    with Runtime([source()], [RESULT], backend=backend) as runtime:
        runtime.apply(start(unit("count.1", topic="/result", port="n"), unit("count.2")))
        assert set(held) == {runtime.pid("count.1"), runtime.pid("count.2")}


def test_each_host_on_this_computer_has_a_group_with_its_own_limit(tmp_path: Path) -> None:
    here, told = groups(tmp_path)
    made = cpu_groups({"base": 2_000_000, "r1": 100}, root=tmp_path / "cgroup", told=told)
    limits = {name: (group.path.parent, (group.path / "cpu.max").read_text()) for name, group in made.items()}
    assert limits == {"base": (here, "200000 100000"), "r1": (here, "1000 100000")}
