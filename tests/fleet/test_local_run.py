"""`cfgplan run --local`: the warehouse on agents of this computer, and what it does when hosts go."""

from __future__ import annotations

import math
import re
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import psutil
import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.errors import NoSuchTopicError, RuntimeFaultError
from cfgplan_runtime.fleet.fleet_runtime import Fleet, fleet_runtime
from cfgplan_runtime.fleet.reached import ReachedFleet
from cfgplan_runtime.operating.control_client import Control, connect
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.processes.cpu_group import CpuGroup
from small_fleet import FOLDER, PATIENCE_S, eventually, small_fleet, source, unit
from warm import cold_command, command, warm_processes

from cfgplan.domain import ChangeSet, Environment, Host

ROOT = Path(__file__).parents[2]
CFGPLAN = (sys.executable, "-c", "import sys; from cfgplan.cli import main; sys.exit(main())")
START = ROOT / "models" / "fleet" / "1-start.yaml"
SHOP = ROOT / "models" / "shop" / "1-start.yaml"
RESCUE = ROOT / "models" / "rescue" / "1-start.yaml"


@contextmanager
def local_run(path: Path, starts: ModuleType | SimpleNamespace | None = None) -> Iterator[subprocess.Popen[str]]:
    """A run whose imports and those of its agents are warm, unless `starts` is the module `subprocess`."""
    line = cold_command("run", path, "--local", "--plain", "--no-estimates")
    start = (starts or warm_processes()).Popen
    with start(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)


def agent_of(process: subprocess.Popen[str], host: str) -> psutil.Process:
    children = psutil.Process(process.pid).children()
    (agent,) = (child for child in children if re.search(rf"main\(\) \d+ {host} ", " ".join(child.cmdline())))
    return agent


def test_the_map_goes_on_when_a_host_is_given_up_and_when_an_agent_is_killed() -> None:
    with (
        local_run(START, subprocess) as process,
        subscribe("/obstacles", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as maps,
    ):
        received = iter(maps)
        assert next(received).value, "obstacles are seen"
        with connect() as control:
            assert control.call("state")["clocks_ahead_us"].keys() == {"base", "r1", "r2"}
            control.call("lose_host", host="r2")
            assert "r1" in {unit["host"] for unit in control.call("state")["units"]}
            last = next(received).time_ns
            control.call("regain_host", host="r2")
            agent_of(process, "r1").send_signal(signal.SIGKILL)
            eventually(lambda: {unit["host"] for unit in control.call("state")["units"]} == {"base", "r2"})
            eventually(lambda: next(received).time_ns > time.time_ns() - 500_000_000)
            assert next(received).time_ns > last


def test_streams_on_hosts_are_shown_and_again_when_their_host_is_back() -> None:
    def shown(topic: str) -> Any:
        with suppress(NoSuchTopicError, TimeoutError), subscribe(topic, wait_s=1.0, timeout_s=2.0) as values:
            return next(iter(values)).value
        return None

    def cameras(control: Control) -> set[str]:
        """The hosts whose cameras run."""
        units = control.call("state")["units"]
        return {unit["host"] for unit in units if unit["id"].startswith("camera") and unit.get("steps")}

    with local_run(START), subscribe("/obstacles", wait_s=PATIENCE_S, timeout_s=PATIENCE_S), connect() as control:
        assert control.call("tap", stream="/obstacles") == {"topic": "/obstacles"}
        eventually(lambda: bool(cameras(control)))
        seeing = cameras(control).pop()
        other, image = {"r1": "r2", "r2": "r1"}[seeing], f"camera({seeing}).1/image"
        assert shown(control.call("tap", stream=image)["topic"]).nbytes == 230_400
        control.call("lose_host", host=seeing)
        with pytest.raises(RefusedError, match="no unit that runs gives 'camera"):
            control.call("tap", stream=image)
        control.call("regain_host", host=seeing)
        control.call("lose_host", host=other)
        eventually(lambda: cameras(control) == {seeing})
        eventually(lambda: shown(control.call("tap", stream=image)["topic"]) is not None)


def test_people_are_found_at_their_time_of_day_with_and_without_the_gpu() -> None:
    people = runpy.run_path(str(RESCUE.with_name("units.py")))["PEOPLE"]
    with local_run(RESCUE) as process, subscribe("/people", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as maps:
        received = iter(maps)

        def all_are_found(since_ns: int) -> bool:
            one = next(received)
            assert all(min(math.dist(place, person) for person in people) < 1 for place in one.value)
            return one.time_ns > since_ns and len(one.value) == len(people)

        assert abs(next(received).time_ns - time.time_ns()) < PATIENCE_S * 1e9
        eventually(lambda: all_are_found(0))
        with connect() as control:
            assert "person_finder(bee).1" in {unit["id"] for unit in control.call("state")["units"]}
            agent_of(process, "mule").send_signal(signal.SIGKILL)
            eventually(lambda: {unit["host"] for unit in control.call("state")["units"]} == {"ant", "bee", "station"})
            eventually(lambda: all_are_found(time.time_ns() - 500_000_000))


RENTED = """
format: cfgplan/1
horizon: 60
hosts:
  - {name: rented, copies: 2, labels: [cloud], rent: 0.1, memory: 500, speed: 2}
  - {name: robot, labels: [battery], energy: 6000, offers: {power: 50, gpu: 1}}
links: [{between: [cloud, battery], bandwidth: 100000, price: 0.001}]
transformations:
  - {label: asking, source: units.py:count, on: battery, run: {rate: 100}, outputs: {n: {tag: N, rate: 100, size: 4}}}
  - {label: package, source: units.py:package, memory: 10}
  - {label: backend, source: units.py:same, on: cloud and not battery, per_host: 1, with: [package], memory: 200,
     inputs: {x: N}, outputs: {y: {tag: Y, rate: 100, size: 4}}}
  - {label: gather, source: units.py:same, needs: {gpu: 1, power: 20}, inputs: {x: Y}, outputs: {z: Z}}
targets: [{label: answers, topic: /answers, tag: Z, host: robot}]
"""


def test_rented_copies_links_and_packages_run_on_hosts_of_this_computer(tmp_path: Path) -> None:
    (tmp_path / "units.py").write_text((Path(__file__).parent / "fleet_units.py").read_text())
    env = tmp_path / "env.yaml"
    env.write_text(RENTED)

    def hosts() -> dict[str, str]:
        return {unit["transformation"]: unit["host"] for unit in control.call("state")["units"]}

    def placed(rented: str) -> dict[str, str]:
        return {"asking": "robot", "gather": "robot", "backend": rented, "package": rented}

    with local_run(env), subscribe("/answers", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as answers:
        first = next(iter(answers)).value
        with connect() as control:
            there = hosts()
            assert there == placed(there["backend"])
            control.call("lose_host", host=there["backend"])
            assert hosts() == placed("rented.1" if there["backend"] == "rented.2" else "rented.2")
            assert next(iter(answers)).value > first


BATTERIES = """
format: cfgplan/1
hosts: [{name: r1}, {name: r2, speed: 0.5}]
facts: {battery: {of: host, declared: 100, unit: "%", by: "Battery_{host}", field: percent}}
transformations:
  - {label: gauge_r1, source: units.py:gauge, host: r1, params: {file: FOLDER/r1}, outputs: {b: Battery_r1}}
  - {label: gauge_r2, source: units.py:gauge, host: r2, params: {file: FOLDER/r2}, outputs: {b: Battery_r2}}
  - {label: asking, source: units.py:count, requires: battery > 20, upkeep: 0.1, run: {rate: 20}, outputs: {n: N}}
targets: [{label: answers, topic: /answers, tag: N}]
"""


def test_a_unit_leaves_a_robot_whose_battery_is_low_and_comes_back(tmp_path: Path) -> None:
    (tmp_path / "units.py").write_text((Path(__file__).parent / "fleet_units.py").read_text())
    env, first = tmp_path / "env.yaml", tmp_path / "r1"
    env.write_text(BATTERIES.replace("FOLDER", str(tmp_path)))
    for file in (first, tmp_path / "r2"):
        file.write_text("80")

    def place() -> str | None:
        units = control.call("state")["units"]
        return next((unit["host"] for unit in units if unit["transformation"] == "asking"), None)

    with local_run(env), subscribe("/answers", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as answers:
        next(iter(answers))
        with connect() as control:
            eventually(lambda: set(control.call("state")["facts_heard_s"]) == {"r1.battery", "r2.battery"})
            assert place() == "r1"
            first.write_text("15")
            eventually(lambda: place() == "r2")
            state = control.call("state")
            assert state["facts"] == {"r1.battery": "15", "r2.battery": "80"}
            assert state["barred"] == {"asking": {"r1": "needs battery > 20, battery is 15 % on r1"}}
            first.write_text("21")
            eventually(lambda: place() == "r1")


def test_three_backends_answer_visitors_also_after_the_machine_of_one_is_lost() -> None:
    with local_run(SHOP) as process, subscribe("/answers", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as answers:
        pages = (page for received in answers for page in received.value)

        def who_answers() -> set[str]:
            return {page["by"] for page in islice(pages, 12)}

        eventually(lambda: len(who_answers()) == 3)
        before = who_answers()
        with connect() as control:
            machine = next(u["host"] for u in control.call("state")["units"] if u["transformation"] == "backend")
            agent_of(process, machine).send_signal(signal.SIGKILL)
            eventually(lambda: len(now := who_answers()) == 3 and now != before)
            assert machine not in {unit["host"] for unit in control.call("state")["units"]}


def test_a_run_that_is_interrupted_while_it_waits_for_hosts_ends_as_that(tmp_path: Path) -> None:
    env = tmp_path / "env.yaml"
    env.write_text("format: cfgplan/1\nhosts: [{name: r1}]\n")
    patient = f"from cfgplan_runtime.fleet import fleet_runtime; fleet_runtime.WAIT_S = {PATIENCE_S}; {CFGPLAN[2]}"
    with small_fleet("r9") as fleet, ReachedFleet(fleet.endpoints) as reached:
        command = [*CFGPLAN[:2], patient, "run", str(env), f"--connect={fleet.endpoints[0]}", "--no-estimates"]
        with warm_processes().Popen(command, stderr=subprocess.PIPE, text=True) as process:
            eventually(lambda: bool(reached.runs))
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said.strip().splitlines()[-1]) == (130, "interrupted")


@pytest.mark.usefixtures("warm_cfgplan")
def test_hosts_of_a_run_that_no_option_reaches_are_refused_with_the_mend() -> None:
    done = subprocess.run(command("run", START), capture_output=True, text=True, check=False)
    assert done.returncode == 30
    assert "--local" in done.stderr


@pytest.mark.usefixtures("warm_cfgplan")
@pytest.mark.parametrize("option", [["--take-over"], ["--certificates", "secrets"]])
def test_an_option_for_a_fleet_that_is_not_named_is_told(option: list[str]) -> None:
    done = subprocess.run(command("run", START, *option), capture_output=True, text=True, check=False)
    assert done.returncode == 30
    assert "name one of its agents by --connect" in done.stderr


@pytest.mark.usefixtures("warm_cfgplan")
@pytest.mark.parametrize("arguments", [["--connect", "tcp/127.0.0.1:1"], ["--local"]])
def test_a_file_without_hosts_runs_on_no_fleet(tmp_path: Path, arguments: list[str]) -> None:
    path = tmp_path / "env.yaml"
    path.write_text("format: cfgplan/1\ntransformations: [{label: a, source: units.py:a, outputs: {n: N}}]\n")
    done = subprocess.run(command("run", path, *arguments), capture_output=True, text=True, check=False)
    assert done.returncode == 30
    assert "no hosts" in done.stderr


@pytest.mark.parametrize("is_allowed", [True, False])
def test_units_are_put_in_the_group_of_their_host_or_it_is_said_that_there_is_none(
    is_allowed: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    said: list[str] = []

    def groups(limits_us: dict[str, int]) -> dict[str, CpuGroup]:
        assert limits_us == {"r1": 500_000}
        if not is_allowed:
            raise RuntimeFaultError("no group")
        (tmp_path / "r1").mkdir()
        return {"r1": CpuGroup(tmp_path / "r1")}

    monkeypatch.setattr("cfgplan_runtime.fleet.fleet_runtime.cpu_groups", groups)
    environment = Environment(library=(source(),), hosts=(Host("r1", cpu_us=500_000), Host("r2")))
    with fleet_runtime(Fleet(is_local=True), environment, FOLDER, say=said.append) as runtime:
        there = {"added_transformations": environment.library, "added_hosts": environment.hosts}
        runtime.apply(ChangeSet(started=(unit("count.1", "r1"), unit("count.2", "r2")), **there))
        told = {file.parent.name: file.read_text() for file in tmp_path.glob("*/cgroup.procs")}
        assert told == ({"r1": str(runtime.pid("count.1"))} if is_allowed else {})
    assert said == ([] if is_allowed else ["`cpu` of hosts limits plans, but not running units: no group"])
