"""What a user of several computers does from any of them: steer a run, listen, record, ask."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from cfgplan_runtime import subscribe
from cfgplan_runtime.errors import NoSuchTopicError
from cfgplan_runtime.fleet import presence
from cfgplan_runtime.fleet.certificates import make
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.fleet.reached import ReachedFleet
from cfgplan_runtime.fleet.tunnels import TunnelClient, TunnelServer
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.streams.run_folder import RunFolder, base_folder
from cfgplan_runtime.streams.subscription import RunPlace, SubscriptionToTopic
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from small_fleet import PATIENCE_S, Listener, SmallFleet, eventually, moved, small_fleet, source, swap, unit, worker
from test_local_run import START, local_run
from warm import command, warm_processes

from cfgplan.domain import ChangeSet
from cfgplan.errors import InputError

COUNT = unit("count.1", "r1")
WORK = unit("work.1", "r1", topic="/result", x="count.1/n")

pytestmark = pytest.mark.usefixtures("warm_cfgplan")


@pytest.fixture
def fleet() -> Iterator[SmallFleet]:
    with small_fleet("r1", "r2") as made:
        yield made


def in_a_row(listener: Listener) -> bool:
    return listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


def test_a_topic_is_heard_from_any_computer_across_swaps_of_what_feeds_it(fleet: SmallFleet) -> None:
    with fleet.runtime(source(), worker()) as runtime, ReachedFleet(fleet.endpoints) as reached:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        listener = Listener(reached.subscribe("/result", run=runtime.id, wait_s=PATIENCE_S))
        listener.await_more(20)
        runtime.apply(swap(WORK, moved(WORK, "work.2", "r2")))
        listener.await_more(20)
        assert in_a_row(listener) and listener.subscription.dropped == 0
        assert (reached.hosts, reached.runs) == (["r1", "r2"], [runtime.id])
        with pytest.raises(NoSuchTopicError, match="did you mean `/result`"):
            reached.subscribe("/resolt")


@pytest.mark.parametrize("is_adopted", [False, True])
def test_who_listens_sees_ages_by_the_clock_of_the_run(
    fleet: SmallFleet, monkeypatch: pytest.MonkeyPatch, is_adopted: bool
) -> None:
    """The manager's clock is a quarter of an hour behind those of the hosts and of who listens, or of the next manager,
    which goes on by it.
    """
    behind_ns, time_ns = 900 * 10**9, time.time_ns
    with ExitStack() as stack:
        if is_adopted:
            stack.enter_context(fleet.other_manager(behind_ns))
        with monkeypatch.context() as patch:
            patch.setattr(time, "time_ns", lambda: time_ns() - (0 if is_adopted else behind_ns))
            runtime = stack.enter_context(fleet.runtime(source(), worker(), takes_over=is_adopted))
        if not is_adopted:
            runtime.apply(ChangeSet(started=(COUNT, WORK)))
        reached = stack.enter_context(ReachedFleet(fleet.endpoints))
        for subscription in (
            reached.subscribe("/result", run=runtime.id, wait_s=PATIENCE_S),
            subscribe("/result", run=runtime.id, wait_s=PATIENCE_S),
        ):
            received = next(iter(subscription))
            assert abs(time_ns() - behind_ns - received.time_ns) < PATIENCE_S * 1e9
            assert 0 < subscription.now_ns() - received.time_ns < PATIENCE_S * 1e9
        where = [f"--connect={fleet.endpoints[0]}", f"--wait={PATIENCE_S}"]
        heard = subprocess.run(
            command("listen", "/result", "--json", "--count=1", *where),
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE_S,
        )
        assert heard.returncode == 0, heard.stdout + heard.stderr
        assert 0 < json.loads(heard.stdout)["latency_ms"] < PATIENCE_S * 1e3


def test_a_topic_is_waited_for_whose_host_is_seen_late(fleet: SmallFleet, monkeypatch: pytest.MonkeyPatch) -> None:
    watch, may_see = ZenohLink.watch, threading.Event()

    def watch_late(link: ZenohLink, keys: str, tell: Callable[[str, bool], None]) -> None:
        def work() -> None:
            may_see.wait(PATIENCE_S)
            watch(link, keys, tell)

        threading.Thread(target=work, daemon=True).start()

    with fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        monkeypatch.setattr(ZenohLink, "watch", watch_late)
        with ReachedFleet(fleet.endpoints) as reached:
            with pytest.raises(NoSuchTopicError, match="is on r1, which can't be connected to"):
                reached.subscribe("/result")
            threading.Timer(0.2, may_see.set).start()
            assert next(iter(reached.subscribe("/result", wait_s=PATIENCE_S))).topic == "/result"


def test_a_topic_on_another_computer_is_in_the_folder_of_the_run(
    fleet: SmallFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(presence, "is_alive", lambda _: False)  # as the folder of an agent elsewhere is not there
    with fleet.runtime(source(rate_hz=50), worker(code="image")) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        place = RunPlace(base_folder() / runtime.id)
        with SubscriptionToTopic("/result", place, timeout_s=PATIENCE_S) as subscription:
            pictures = [received.value for received, _ in zip(subscription, range(20), strict=False)]
        assert {picture.nbytes for picture in pictures} == {460_800}
        listener = Listener(runtime)
        listener.await_more(5)
        fleet.agents.processes["r1"].kill()
        eventually(lambda: not list(place.run.glob("*.topic")))
        eventually(lambda: runtime.environment.units == ())


def test_who_listens_and_is_gone_leaves_no_tunnel_behind(fleet: SmallFleet) -> None:
    code = (
        "import sys; from cfgplan_runtime.fleet.reached import ReachedFleet;"
        "fleet = ReachedFleet(sys.argv[1:]); values = iter(fleet.subscribe('/result', wait_s=60)); next(values);"
        "print('heard', flush=True); [next(values) for _ in range(10 ** 9)]"
    )
    with fleet.runtime(source(), worker()) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, WORK)))
        agent = fleet.agents.processes["r1"].pid
        before = len(list(Path(f"/proc/{agent}/fd").iterdir()))
        line = [sys.executable, "-c", code, *fleet.endpoints]
        with warm_processes().Popen(line, stdout=subprocess.PIPE) as listener:
            assert listener.stdout is not None and listener.stdout.readline() == b"heard\n"
            assert len(list(Path(f"/proc/{agent}/fd").iterdir())) > before
            listener.kill()
        eventually(lambda: len(list(Path(f"/proc/{agent}/fd").iterdir())) <= before)


def test_a_run_is_steered_listened_to_and_asked_from_a_computer_that_has_none_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with local_run(START), subscribe("/obstacles", wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as maps:
        assert next(iter(maps)).value
        with connect() as control:
            run, folder = control.system.run, control.path
        assert folder is not None
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        links = ["--connect", f"unixsock-stream/{folder.parent}/a0"]

        def done(*arguments: str) -> subprocess.CompletedProcess[str]:
            return subprocess.run(
                command(*arguments, *links), capture_output=True, text=True, check=False, timeout=PATIENCE_S
            )

        state = json.loads(done("ctl", "--json", "state").stdout)
        assert state["run"] == run and {one["host"] for one in state["units"]} <= {"base", "r1", "r2"}
        heard = done("listen", "/obstacles", "--json", "--count", "3")
        assert len(heard.stdout.splitlines()) == 3, heard.stderr
        asked = done("query", "eventually[0,1min] count > 0", "--feature", "count=ObstacleMap", "--for", "10s")
        assert "nothing publishes" not in asked.stderr, asked.stderr
        refused = done("ctl", "socket")
        assert refused.returncode == 30 and "on another computer" in refused.stderr
        assert done("ctl", "lose-host", "r2").returncode == 0
        assert "Streams between hosts:" in done("ctl", "state").stdout
        assert done("ctl", "stop").returncode == 0


def test_a_fleet_that_can_not_be_reached_is_told_with_the_mend(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no agent can be reached at unixsock-stream"):
        ReachedFleet([f"unixsock-stream/{tmp_path}/nobody"])
    done = subprocess.run(
        command("ctl", "state", "--certificates", tmp_path), capture_output=True, text=True, check=False
    )
    assert done.returncode == 30 and "name one of its agents by --connect" in done.stderr


def test_only_who_has_the_managers_certificate_reaches_a_topic(tmp_path: Path) -> None:
    folder = tmp_path / "secrets"
    make(folder, {"r1": ["127.0.0.1"], "r2": ["127.0.0.1"]}, days=2)
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tls/127.0.0.1:{free.getsockname()[1]}"
    with (
        closing(RunFolder()) as run,
        run.listen("/t") as listener,
        closing(ZenohLink(config([endpoint], certificates=folder / "r1"))) as link,
        closing(TunnelServer(link, "r1", "life", run.path)),
    ):
        listener.settimeout(PATIENCE_S)
        with (
            closing(ZenohLink(config(connect=[endpoint], certificates=folder / "manager", mode="client"))) as other,
            TunnelClient(other).connect("r1", "life", "/t") as end,
        ):
            topic, _ = listener.accept()
            with topic:
                topic.sendall(b"hello")
                end.settimeout(PATIENCE_S)
                assert end.recv(5) == b"hello"
        listener.settimeout(1.0)
        with (
            closing(ZenohLink(config(connect=[endpoint], certificates=folder / "r2", mode="client"))) as other,
            TunnelClient(other).connect("r1", "life", "/t"),
            pytest.raises(TimeoutError),
        ):
            listener.accept()
