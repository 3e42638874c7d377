"""The network of namespaces that experiments with fleets make: it cuts, mends, limits, and leaves nothing behind."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import network as module
import psutil
import pytest
from network import Network, NotAllowedError

SERVE = """
import socket
server = socket.create_server(("", 7000))
print("ready", flush=True)
while True:
    client, _ = server.accept()
    with client:
        while received := client.recv(65536):
            client.sendall(b"." * len(received))
"""
ASK = """
import socket, sys, time
with socket.create_connection((sys.argv[1], 7000), float(sys.argv[2])) as client:
    start = time.monotonic()
    client.sendall(b"x" * int(sys.argv[3]))
    left = int(sys.argv[3])
    while left:
        left -= len(client.recv(65536))
    print(time.monotonic() - start)
"""


@pytest.fixture(scope="module")
def network() -> Iterator[Network]:
    try:
        made = Network(["r1", "r2", "base"])
    except NotAllowedError as error:
        pytest.skip(f"no network namespaces: {error}")
    with made, made.start("base", [sys.executable, "-c", SERVE], stdout=subprocess.PIPE) as server:
        assert server.stdout is not None and server.stdout.readline() == "ready\n"
        yield made
        server.kill()


def seconds(network: Network, host: str, *, size: int = 1, patience_s: float = 10.0) -> float | None:
    """How long an echo from the base takes; None if it can't be reached."""
    command = [sys.executable, "-c", ASK, network.address["base"], str(patience_s), str(size)]
    with network.start(host, command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as asking:
        assert asking.stdout is not None
        said = asking.stdout.read()
    return float(said) if said else None


@pytest.mark.parametrize("loudly", [False, True])
def test_a_host_that_is_cut_reaches_nobody_until_it_is_mended(network: Network, loudly: bool) -> None:
    assert seconds(network, "r1") is not None
    network.cut("r1", loudly=loudly)
    assert seconds(network, "r1", patience_s=0.3) is None
    assert seconds(network, "r2") is not None
    network.mend("r1")
    assert seconds(network, "r1") is not None


def test_a_limited_link_carries_no_more(network: Network) -> None:
    network.limit("r2", 8)
    echo_s = seconds(network, "r2", size=300_000)
    assert echo_s is not None and echo_s > 0.2


@pytest.mark.usefixtures("network")
def test_nothing_is_left_behind_even_by_who_is_killed() -> None:
    make = "import network, sys, time; made = network.Network(['one']); print('made', flush=True); time.sleep(600)"
    with subprocess.Popen(
        [sys.executable, "-c", make], cwd=Path(module.__file__).parent, stdout=subprocess.PIPE, text=True
    ) as maker:
        assert maker.stdout is not None and maker.stdout.readline() == "made\n"
        holders = psutil.Process(maker.pid).children(recursive=True)
        namespaces = {Path(f"/proc/{holder.pid}/ns/net").stat().st_ino for holder in holders}
        assert len(namespaces) == 2 and Path("/proc/self/ns/net").stat().st_ino not in namespaces
        maker.kill()
    assert psutil.wait_procs(holders, timeout=30)[1] == []
    assert "bridge:" not in Path("/proc/net/dev").read_text()
