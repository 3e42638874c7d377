"""Hosts that reach each other only through a third one, in network namespaces with certificates."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from cfgplan_runtime.fleet.certificates import make
from network import Network, NotAllowedError
from small_fleet import FOLDER, PATIENCE_S
from test_local_run import CFGPLAN

LINE = """\
format: cfgplan/1
hosts: [{name: base}, {name: r1}, {name: r2}]
transformations:
  - {label: count, source: "fleet_units.py:count", host: r1, outputs: {n: N}, run: {rate: 50}}
  - {label: work, source: "fleet_units.py:same", host: r2, inputs: {x: N}, outputs: {y: Y}}
targets: [{label: result, topic: /result, tag: Y, host: r2}]
"""


APART = (("r1", "r2"), ("r2", "r1"), ("desk", "r1"), ("desk", "r2"))


@pytest.fixture
def network() -> Iterator[Network]:
    """A robot r1, a robot r2 that it can't reach, and a base between them, with a computer for who looks on."""
    try:
        made = Network(["r1", "r2", "base", "desk"])
    except NotAllowedError as error:
        pytest.skip(f"no network namespaces: {error}")
    with made:
        for here, there in APART:
            routed(made, "add", here, there)
        yield made


def routed(network: Network, verb: str, here: str, there: str) -> None:
    """Add or delete what keeps a host from reaching another."""
    command = ["ip", "route", verb, "unreachable", f"{network.address[there]}/32"]
    assert network.start(here, command).wait(PATIENCE_S) == 0


def test_a_stream_between_hosts_goes_through_a_third_while_they_are_not_linked_and_loses_nothing_when_they_are(
    network: Network, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    secrets = tmp_path / "secrets"
    make(secrets, {host: [network.address[host]] for host in ("r1", "r2", "base")}, passing_on=["base"], days=2)
    (tmp_path / "env.yaml").write_text(LINE)
    (tmp_path / "fleet_units.py").write_text((FOLDER / "fleet_units.py").read_text())
    base, r1 = (f"--connect=tls/{network.address[host]}:7447" for host in ("base", "r1"))
    reaching = [base, "--certificates", str(secrets / "manager")]

    def started(host: str, *arguments: str) -> subprocess.Popen[str]:
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path_factory.mktemp("r"))}
        with (tmp_path / f"said-{host}").open("a") as said:
            command = [*CFGPLAN, *arguments]
            return network.start(host, command, env=environment, stdout=subprocess.PIPE, stderr=said)

    with ExitStack() as stack:

        def keep(host: str, *arguments: str) -> subprocess.Popen[str]:
            process = stack.enter_context(started(host, *arguments))
            stack.callback(process.terminate)
            return process

        for host, links in (("r1", [base]), ("r2", [base, r1]), ("base", [])):
            agent = ["agent", "--name", host, "--certificates", str(secrets / host), "--folder", str(tmp_path)]
            keep(host, *agent, *links)
        keep("base", "run", str(tmp_path / "env.yaml"), "--plain", "--no-estimates", *reaching)
        listening = keep("desk", "listen", "/result", "--json", "--wait", "60s", *reaching)
        assert listening.stdout is not None
        lines = listening.stdout

        def next_value() -> int:
            value: int = json.loads(lines.readline())["value"]
            return value

        def said() -> str:
            return "".join(file.read_text() for file in tmp_path.glob("said-r*"))

        values = [next_value() for _ in range(20)]
        with started("desk", "ctl", "state", "--json", *reaching) as asking:
            state = json.loads(asking.communicate(timeout=PATIENCE_S)[0])
        assert {unit["id"]: unit["host"] for unit in state["units"]} == {"count.1": "r1", "work.1": "r2"}
        while "can be reached only through base" not in said():
            values.append(next_value())

        for here, there in APART:
            routed(network, "delete", here, there)
        while "directly again" not in said():
            values.append(next_value())
        values += [next_value() for _ in range(100)]
        assert values == list(range(values[0], values[0] + len(values)))
