"""Streams between two computers: cfgplan, bare Zenoh, NATS and TCP compared, with and without TLS; the cost of agents.

    python experiments/fleet/crossing.py [--seconds 5]

NATS is measured if it is installed: `apt install nats-server`, `pip install nats-py`.

The computers are network namespaces on a bridge (`network.py`). Latency is the median from unit code to unit code,
with one clock for both. In the throughput test a source sends as fast as it can, and received elements are counted.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import os
import shutil
import socket
import ssl
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

import psutil
from cfgplan_runtime.processes.nursery import die_with_parent
from computers import HOSTS, PATIENCE_S, Fleet, Listener, eventually, unit
from network import Network, run_within

SIZES = {100: 200.0, 10_000: 200.0, 460_000: 40.0}
"""Bytes of an element, and how many a second where latency is measured."""
PORT = 7500
NATS_BATCH = 65_536
"""Bytes that its client gathers where elements come faster than 1,000 a second."""
_STAMP = 8
Take: TypeAlias = Callable[[bytes | bytearray], None]


def stamped(size: int) -> bytes:
    """Return a payload of a size in bytes that begins with the time."""
    return time.monotonic_ns().to_bytes(_STAMP, "little") + bytes(size - _STAMP)


def ticks(rate_hz: float, seconds: float) -> Iterator[None]:
    """Yield at a rate for some seconds; as fast as possible if the rate is 0."""
    start = time.monotonic()
    for number in itertools.count():
        now = time.monotonic()
        if now - start > seconds:
            return
        if rate_hz and (wait_s := start + number / rate_hz - now) > 0:
            time.sleep(wait_s)
        yield


def send(way: str, secrets: Path, address: str, size: int, rate_hz: float, seconds: float) -> None:
    """Send over a transport for some seconds, then send an end mark."""
    put = _SENDERS[way.partition(",")[0]](way, secrets, address)
    for _ in ticks(rate_hz, seconds):
        put(stamped(size))
    put(b"last")
    time.sleep(1.0)
    os._exit(0)


def receive(way: str, secrets: Path, address: str) -> None:
    """Receive until the end mark; print the number of elements, their median age in microseconds, and the seconds."""
    ages_us: list[float] = []
    begun: list[float] = []

    def take(data: bytes | bytearray) -> None:
        if len(data) < _STAMP:
            figures = [len(ages_us), statistics.median(ages_us), time.monotonic() - begun[0]]
            print(json.dumps(figures), flush=True)
            os._exit(0)
        begun or begun.append(time.monotonic())
        ages_us.append((time.monotonic_ns() - int.from_bytes(data[:_STAMP], "little")) / 1000)

    _RECEIVERS[way.partition(",")[0]](way, secrets, address, take)


def _tcp_sender(way: str, secrets: Path, address: str) -> Callable[[bytes], None]:
    connection = socket.create_connection((address, PORT))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if way.endswith("TLS"):
        connection = _tls(secrets / "r1", ssl.Purpose.SERVER_AUTH).wrap_socket(connection, server_hostname=address)
    return lambda data: connection.sendall(len(data).to_bytes(4, "little") + data)


def _receive_tcp(way: str, secrets: Path, address: str, take: Take) -> None:
    server = socket.create_server((address, PORT))
    print("ready", flush=True)
    connection = server.accept()[0]
    if way.endswith("TLS"):
        connection = _tls(secrets / "base", ssl.Purpose.CLIENT_AUTH).wrap_socket(connection, server_side=True)
    with connection.makefile("rb") as stream:
        while head := stream.read(4):
            take(stream.read(int.from_bytes(head, "little")))


def _tls(folder: Path, purpose: ssl.Purpose) -> ssl.SSLContext:
    """Both sides show a certificate of a host's folder."""
    context = ssl.create_default_context(purpose, cafile=str(folder / "authority.pem"))
    context.load_cert_chain(folder / "host.pem", folder / "host.key")
    context.verify_mode = ssl.CERT_REQUIRED
    return context


async def _nats_client(way: str, folder: Path, address: str) -> Any:
    import nats

    tls = _tls(folder, ssl.Purpose.SERVER_AUTH) if way.endswith("TLS") else None
    return await nats.connect(f"nats://{address}:{PORT}", tls=tls)


def _nats_sender(way: str, secrets: Path, address: str) -> Callable[[bytes], None]:
    loop = asyncio.new_event_loop()
    client = loop.run_until_complete(_nats_client(way, secrets / "r1", address))

    waiting, last_s = 0, 0.0

    async def put(data: bytes) -> None:
        nonlocal waiting, last_s
        await client.publish("data", data)
        waiting, before_s, last_s = waiting + len(data), last_s, time.monotonic()
        if waiting > NATS_BATCH or last_s - before_s > 0.001 or len(data) < _STAMP:
            await client.flush()
            waiting = 0

    return lambda data: loop.run_until_complete(put(data))


def _receive_nats(way: str, secrets: Path, address: str, take: Take) -> None:
    """By a server beside the receiver."""

    async def listen() -> None:
        async def hear(message: Any) -> None:
            take(message.data)

        client = await _nats_client(way, secrets / "base", address)
        await client.subscribe("data", cb=hear)
        await client.flush()
        print("ready", flush=True)
        await asyncio.sleep(600)

    base = secrets / "base"
    shown = [f"--tlscert={base}/host.pem", f"--tlskey={base}/host.key", f"--tlscacert={base}/authority.pem"]
    secured = ["--tlsverify", *shown] if way.endswith("TLS") else []
    server = ["nats-server", f"--addr={address}", f"--port={PORT}", *secured]
    process = subprocess.Popen(server, stderr=subprocess.DEVNULL, preexec_fn=partial(die_with_parent, os.getpid()))
    eventually(lambda: socket.socket().connect_ex((address, PORT)) == 0)
    asyncio.run(listen())
    process.kill()


def _zenoh_sender(way: str, secrets: Path, address: str) -> Callable[[bytes], None]:
    import zenoh

    session = _session(way, secrets / "r1", connect=address)
    blocks = zenoh.CongestionControl.BLOCK
    publisher = session.declare_publisher("cfgplan/r1/data", congestion_control=blocks, express=True)
    eventually(lambda: publisher.matching_status.matching)

    def put(data: bytes) -> None:
        assert not session.is_closed()  # what nobody holds is closed
        publisher.put(data)

    return put


def _receive_zenoh(way: str, secrets: Path, address: str, take: Take) -> None:
    with _session(way, secrets / "base", listen=address) as session:
        session.declare_subscriber("cfgplan/r1/data", lambda sample: take(sample.payload.to_bytes()))
        print("ready", flush=True)
        time.sleep(600)


def _session(way: str, secrets: Path, *, listen: str | None = None, connect: str | None = None) -> Any:
    import zenoh
    from cfgplan_runtime.fleet import links

    is_secured = way.endswith("TLS")
    links._refuse_strangers = lambda _: None
    ends = [[] if end is None else [f"{'tls' if is_secured else 'tcp'}/{end}:{PORT}"] for end in (listen, connect)]
    given = links.config(*ends, secrets if is_secured else None)
    return zenoh.open(zenoh.Config.from_json5(json.dumps(given)))


_SENDERS = {"TCP": _tcp_sender, "Zenoh": _zenoh_sender, "NATS": _nats_sender}
_RECEIVERS = {"TCP": _receive_tcp, "Zenoh": _receive_zenoh, "NATS": _receive_nats}


def bare(network: Network, way: str, secrets: Path, size: int, rate_hz: float, seconds: float) -> tuple[float, float]:
    """Return the median latency in milliseconds and elements per second from r1 to base, without cfgplan."""
    address = network.address["base"]
    call = [
        sys.executable,
        __file__,
        "--way",
        way,
        "--secrets",
        str(secrets),
        "--address",
        address,
        "--size",
        str(size),
    ]
    with network.start("base", [*call, "--role", "receive"], stdout=subprocess.PIPE) as receiver:
        assert receiver.stdout is not None and receiver.stdout.readline() == "ready\n"
        network.start("r1", [*call, "--role", "send", "--rate", str(rate_hz), "--seconds", str(seconds)]).wait(
            PATIENCE_S + seconds
        )
        came, age_us, took_s = json.loads(receiver.stdout.readline())
    return age_us / 1000, came / took_s


def library(size: int, rate_hz: float) -> tuple[Any, ...]:
    """Return a source of stamped payloads, and a unit that collects their ages."""
    from cfgplan.domain import InputPort, OutputPort, RunOptions, Transformation

    run = RunOptions(rate_hz=rate_hz or None)
    source = f"measured_units.py:{stamped.__name__}"
    every = 50 if rate_hz or size > 100_000 else 200
    ages = "measured_units.py:Ages"
    return (
        Transformation("stamped", outputs=(OutputPort("n", "N"),), source=source, params={"size": size}, run=run),
        Transformation("ages", (InputPort("x", "N"),), (OutputPort("n", "Y"),), source=ages, params={"every": every}),
    )


def crossing(fleet: Fleet, size: int, rate_hz: float, seconds: float) -> tuple[float, float]:
    """Return the median latency in milliseconds and elements per second of a cfgplan stream, from unit to unit."""
    from cfgplan.domain import ChangeSet

    with fleet.runtime() as runtime:
        units = unit("stamped.1", "r1"), unit("ages.1", "base", x="stamped.1/n", topic="/result")
        runtime.apply(ChangeSet(added_transformations=library(size, rate_hz), started=units))
        figures = Listener(runtime.id, number=list)
        figures.await_more(2)
        time.sleep(seconds)
        counts = list(figures.values)[1:]
    took_s = (counts[-1][3] - counts[0][3]) / 1e9
    came = sum(count for count, *_ in counts[1:])
    return statistics.median(median_us for _, median_us, *_ in counts) / 1000, came / took_s if took_s else 0.0


def idle(fleet: Fleet, seconds: float) -> str:
    """Return the CPU time and memory of an idle agent with all its processes, as text."""
    tree = [psutil.Process(fleet.agents["r1"].pid)]
    tree += tree[0].children(recursive=True)

    def cpu_s() -> float:
        return sum(sum(one.cpu_times()[:2]) for one in tree)

    before = cpu_s()
    time.sleep(seconds)
    memory = sum(one.memory_full_info().pss for one in tree) >> 20
    return f"{len(tree)} processes, {100 * (cpu_s() - before) / seconds:.2f} % of a core, {memory} MB"


def first_update(fleet: Fleet) -> float:
    """Return the seconds from the first update to the first element at the base, sent by r1 through r2."""
    from cfgplan.domain import ChangeSet

    with fleet.runtime() as runtime:
        start = time.monotonic()
        units = unit("count.1", "r1"), unit("same.1", "r2", x="count.1/n", topic="/result")
        runtime.apply(ChangeSet(started=units))
        listener = Listener(runtime.id)
        listener.await_more(1)
        return listener.at_s[0] - start


def measure(network: Network, seconds: float) -> None:
    """Print the tables."""
    from cfgplan_runtime.fleet.certificates import make

    with tempfile.TemporaryDirectory(prefix="fleet") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        secrets = Path(folder) / "secrets"
        make(secrets, {host: [network.address[host]] for host in HOSTS}, days=1)
        print("| | " + " | ".join(f"{size:,} B | flat out" for size in SIZES) + " |")
        print("|---" * (2 * len(SIZES) + 1) + "|")
        has_nats = shutil.which("nats-server") and find_spec("nats")
        for way in (name + how for name in _SENDERS if name != "NATS" or has_nats for how in ("", ", TLS")):
            tell(way, lambda *which, way=way: bare(network, way, secrets, *which, seconds))
        for way, is_secured in (("cfgplan", False), ("cfgplan, TLS", True)):
            start = time.monotonic()
            with Fleet(network, secrets, is_secured=is_secured) as fleet:
                first_update(fleet)
                cold_s = time.monotonic() - start
                tell(way, lambda *which, fleet=fleet: crossing(fleet, *which, seconds))
                warm_s = first_update(fleet)
                told = f"\n{way}: an idle agent: {idle(fleet, 2 * seconds)}; first update {1000 * warm_s:.0f} ms"
                print(f"{told}, {cold_s:.1f} s from the start of the agents\n", flush=True)


def tell(way: str, figures: Callable[..., tuple[float, float]]) -> None:
    """Print a row: for each size the median latency, and the elements per second at full speed."""
    cells = [way]
    for size, rate_hz in SIZES.items():
        cells += [f"{figures(size, rate_hz)[0]:.2f} ms", f"{figures(size, 0.0)[1]:,.0f}/s"]
    print("| " + " | ".join(cells) + " |", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="how long each figure is measured")
    for name in ("--role", "--way", "--secrets", "--address", "--within"):
        parser.add_argument(name, help=argparse.SUPPRESS)
    parser.add_argument("--size", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--rate", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role == "receive":
        receive(options.way, Path(options.secrets), options.address)
    elif options.role == "send":
        send(options.way, Path(options.secrets), options.address, options.size, options.rate, options.seconds)
    else:
        return run_within(HOSTS, options.within, lambda network: measure(network, options.seconds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
