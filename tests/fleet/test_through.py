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


@pytest.fixture
def network() -> Iterator[Network]:
    """A robot r1, a robot r2 that it can't reach, and a base between them, with a computer for who looks on."""
    try:
        made = Network(["r1", "r2", "base", "desk"])
    except NotAllowedError as error:
        pytest.skip(f"no network namespaces: {error}")
    with made:
        for here, there in (("r1", "r2"), ("r2", "r1"), ("desk", "r1"), ("desk", "r2")):
            cut = ["ip", "route", "add", "unreachable", f"{made.address[there]}/32"]
            assert made.start(here, cut).wait(PATIENCE_S) == 0
        yield made


def test_a_stream_between_hosts_that_are_not_linked_goes_through_the_one_between(
    network: Network, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    secrets = tmp_path / "secrets"
    make(secrets, {host: [network.address[host]] for host in ("r1", "r2", "base")}, passing_on=["base"], days=2)
    (tmp_path / "env.yaml").write_text(LINE)
    (tmp_path / "fleet_units.py").write_text((FOLDER / "fleet_units.py").read_text())
    base = f"tls/{network.address['base']}:7447"
    reaching = ["--connect", base, "--certificates", str(secrets / "manager")]

    def started(host: str, *arguments: str) -> subprocess.Popen[str]:
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path_factory.mktemp("r"))}
        return network.start(host, [*CFGPLAN, *arguments], env=environment, stdout=subprocess.PIPE)

    with ExitStack() as stack:

        def keep(host: str, *arguments: str) -> None:
            process = stack.enter_context(started(host, *arguments))
            stack.callback(process.terminate)

        for host in ("r1", "r2", "base"):
            links = ["--listen", "tls/0.0.0.0:7447"] if host == "base" else ["--through", base]
            agent = ["agent", "--name", host, "--certificates", str(secrets / host), "--folder", str(tmp_path)]
            keep(host, *agent, *links)
        keep("base", "run", str(tmp_path / "env.yaml"), "--plain", "--no-estimates", *reaching)
        with started("desk", "listen", "/result", "--json", "--count", "20", "--wait", "60s", *reaching) as listening:
            out, _ = listening.communicate(timeout=2 * PATIENCE_S)
        values = [json.loads(line)["value"] for line in out.splitlines()]
        assert values == list(range(values[0], values[0] + 20))
        with started("desk", "ctl", "state", "--json", *reaching) as asking:
            state = json.loads(asking.communicate(timeout=PATIENCE_S)[0])
        assert {unit["id"]: unit["host"] for unit in state["units"]} == {"count.1": "r1", "work.1": "r2"}
