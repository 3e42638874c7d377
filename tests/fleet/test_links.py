"""Links of a fleet: what may listen where, and what is said without Zenoh."""

from __future__ import annotations

import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.fleet.links import LEASE_S, STALLED_S, Lives, Pulse, config, sign_period_s
from cfgplan_runtime.fleet.ways import ReachedAt, reach
from cfgplan_runtime.streams.zenoh_link import Losses, Taken, ZenohLink, limit_unsent, taken
from small_fleet import PATIENCE_S, eventually, free_port
from test_local_run import CFGPLAN
from warm import warm_processes

from cfgplan.cli import main
from cfgplan.errors import InputError


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "tcp/localhost:7447", "unixsock-stream//x"])
def test_without_certificates_a_link_listens_on_loopback(endpoint: str) -> None:
    assert config([endpoint])["listen"] == {"endpoints": [endpoint]}


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/192.168.1.5:7447", "tcp/[::]:7447", "tcp/robot:7447"])
def test_without_certificates_a_link_listens_nowhere_else(endpoint: str) -> None:
    with pytest.raises(InputError, match="loopback only"):
        config([endpoint])


def test_a_fleet_without_zenoh_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(InputError, match="cfgplan\\[fleet\\]"):
        ZenohLink(config())


def test_an_address_that_is_taken_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match=f"can't listen on {endpoint}"):
            ZenohLink(config([endpoint]))


def test_a_connection_that_zenoh_has_left_unread_is_given_up_and_others_are_not() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:
        port = server.getsockname()[1]
        ends = []
        for _ in range(2):
            client = stack.enter_context(socket.create_connection(("127.0.0.1", port), PATIENCE_S))
            ends.append((client, stack.enter_context(server.accept()[0])))
        (unread, _), (read, reading) = ends
        link = ZenohLink(config(connect=[f"tcp/127.0.0.1:{port}"]))
        stack.callback(link.close)
        unread.sendall(b"what nobody takes")
        unread.setblocking(False)

        def is_given_up() -> bool:
            read.sendall(b"more")
            assert reading.recv(4) == b"more"
            with suppress(BlockingIOError):
                return unread.recv(1) == b""
            return False

        eventually(is_given_up)
        read.sendall(b"more")
        assert reading.recv(4) == b"more"


def test_what_is_not_taken_is_counted_by_looks_as_a_stalled_process_has_looked_only_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:
        sending = stack.enter_context(socket.create_connection(server.getsockname(), PATIENCE_S))
        taking = stack.enter_context(server.accept()[0])
        looks = [taken(taking, None)]
        for number in range(3):
            sending.sendall(b"12")
            assert taking.recv(2, socket.MSG_PEEK | socket.MSG_WAITALL) == b"12"
            if number == 2:
                taking.recv(1)
            looks.append(taken(taking, looks[-1]))
        assert looks == [Taken(0, 0), Taken(0, 1), Taken(0, 2), Taken(1, 0)]


def test_of_two_agents_that_connect_to_each_other_one_ends_and_names_both(tmp_path: Path) -> None:
    ports = {name: free_port() for name in ("r1", "r2")}
    with ExitStack() as stack:
        agents = {}
        for name, other in (("r1", "r2"), ("r2", "r1")):
            ends = [f"--listen=tcp/127.0.0.1:{ports[name]}", f"--connect=tcp/localhost:{ports[other]}"]
            command = [*CFGPLAN, "agent", f"--name={name}", *ends, f"--folder={tmp_path}"]
            agents[name] = stack.enter_context(warm_processes().Popen(command, stderr=subprocess.PIPE, text=True))
            stack.callback(agents[name].terminate)
        _, said = agents["r2"].communicate(timeout=PATIENCE_S)
        assert agents["r2"].returncode == 30
        assert "r2 and r1 connect to each other" in said
        assert "leave out --connect to r1 here, or the one to r2 there" in said
        assert agents["r1"].poll() is None


def test_an_agent_of_a_name_that_the_fleet_has_already_is_refused(tmp_path: Path) -> None:
    first, second = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    agent = [*CFGPLAN, "agent", "--name=r1", f"--folder={tmp_path}"]
    with warm_processes().Popen([*agent, f"--listen={first}"], stderr=subprocess.PIPE, text=True) as one:
        try:
            assert one.stderr is not None and one.stderr.readline()
            patient = f"from cfgplan_runtime.fleet import agent; agent.LINK_S = {PATIENCE_S}; {CFGPLAN[2]}"
            command = [*CFGPLAN[:2], patient, *agent[3:], f"--listen={second}", f"--connect={first}"]
            with warm_processes().Popen(command, stderr=subprocess.PIPE, text=True) as other:
                _, said = other.communicate(timeout=PATIENCE_S)
            assert other.returncode == 30
            assert "the fleet has an agent 'r1' already" in said
            assert one.poll() is None
        finally:
            one.terminate()


def test_of_two_agents_of_one_name_that_meet_late_the_second_ends(tmp_path: Path) -> None:
    first, second = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    agent = [*CFGPLAN, "agent", "--name=r1", f"--folder={tmp_path}"]
    with warm_processes().Popen([*agent, f"--listen={first}"], stderr=subprocess.PIPE, text=True) as one:
        try:
            assert one.stderr is not None and one.stderr.readline()
            late = f"from cfgplan_runtime.fleet.agent import Agent; Agent._refuse_twin = lambda *_: None; {CFGPLAN[2]}"
            command = [*CFGPLAN[:2], late, *agent[3:], f"--listen={second}", f"--connect={first}"]
            with warm_processes().Popen(command, stderr=subprocess.PIPE, text=True) as other:
                _, said = other.communicate(timeout=PATIENCE_S)
            assert other.returncode == 30
            assert "the fleet has an agent 'r1' that began earlier" in said
            assert one.poll() is None
        finally:
            one.terminate()


def test_an_agent_listens_at_all_addresses_of_its_computer_if_none_is_named() -> None:
    one = reach(["tls/0.0.0.0:7447"], ["tls/10.0.0.2:7447"])
    assert all(place.endswith(" 7447") and not place.startswith("127.") for place in one.listens)
    assert one.connects == {"10.0.0.2 7447"}
    other = ReachedAt(frozenset({"10.0.0.2 7447"}), one.listens | {"10.0.0.9 7447"})
    assert one.is_mutual(other) == other.is_mutual(one) == bool(one.listens)
    assert not one.is_mutual(ReachedAt(other.listens, frozenset({"10.0.0.9 7447"})))


def pulse(*signs_s: float) -> Pulse:
    made = Pulse(0.0, 0.0)
    for at_s in signs_s:
        made.note(at_s)
    return made


def test_a_host_is_lost_after_a_lease_without_a_sign_of_life() -> None:
    heard = pulse(1.0)
    assert not heard.is_lost(1.0 + 0.9 * LEASE_S)
    assert heard.is_lost(1.0 + LEASE_S)


def test_heartbeats_keep_a_host_whose_link_is_silent_but_not_for_ever() -> None:
    heard = pulse(1.0)
    heard.beat_s = 1.0 + 4 * LEASE_S
    assert not heard.is_lost(1.0 + 4.9 * LEASE_S)
    assert heard.is_lost(1.0 + 5 * LEASE_S)
    heard.beat_s = 1.0 + STALLED_S
    assert heard.is_lost(1.0 + STALLED_S)


def test_an_agent_whose_signs_came_in_time_up_to_now_has_ended_if_its_links_are_gone() -> None:
    period_s = sign_period_s()
    in_time = [number * period_s for number in range(1, 20)]
    assert pulse(*in_time).is_steady(in_time[-1] + period_s)
    assert not pulse(*in_time).is_steady(in_time[-1] + 3 * period_s), "its link is silent"
    assert not pulse(in_time[-1]).is_steady(in_time[-1]), "its signs were late: this process, or the link, was stalled"


def test_an_agent_whose_links_have_ended_is_gone_unless_it_answers_a_later_question_or_gives_a_sign() -> None:
    silent, answering, signing = (pulse(1.0) for _ in range(3))
    for one in (silent, answering, signing):
        one.note_end(1.1, 0.02)
        assert not one.is_gone(1.11)
    silent.note_beat(1.0, 1.11)
    answering.note_beat(1.1, 1.11)
    signing.note(1.11)
    assert silent.is_gone(1.13), "it answered before its links ended"
    assert not answering.is_gone(1.13)
    assert not signing.is_gone(1.13)
    answering.note_end(2.0, 0.0)
    assert answering.is_gone(2.0)


@pytest.mark.parametrize("late_s", [0.0, 1.5])
def test_a_manager_whose_link_is_gone_is_alive_as_long_as_a_lease_if_its_signs_were_late(late_s: float) -> None:
    lives, period_s = Lives(), sign_period_s()
    for number in range(20):
        lives.note("m", number * period_s)
    gone_s = 19 * period_s + late_s
    lives.note("m", gone_s, is_alive=False)
    assert lives.has("m", gone_s) == bool(late_s)
    assert not lives.has("m", gone_s + LEASE_S)


@pytest.mark.parametrize("is_allowed", [True, False])
def test_an_agent_limits_its_units_together_or_says_once_that_it_can_not(
    is_allowed: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: dict[str, Any] = {}

    class AgentOfNothing:
        def __init__(self, name: str, **more: Any) -> None:
            given.update(more, name=name)

        def run(self) -> None:
            pass

    def groups(limits_us: dict[str, int]) -> dict[str, int]:
        if not is_allowed:
            raise RuntimeFaultError("no group")
        return limits_us

    monkeypatch.setattr("cfgplan_runtime.fleet.agent.Agent", AgentOfNothing)
    monkeypatch.setattr("cfgplan_runtime.processes.cpu_group.cpu_groups", groups)
    assert main(["agent", "--name", "r1", "--cpu", "0.25"]) == 0
    assert (given["name"], given["cpu"]) == ("r1", 250_000 if is_allowed else None)
    assert capsys.readouterr().err.count("the CPU time of units is not limited: no group") == (not is_allowed)


def test_a_peer_loses_packets_if_several_were_sent_again_within_a_minute_over_any_of_its_connections() -> None:
    losses, first, second = Losses(), (("a", 1), ("b", 1)), (("a", 2), ("b", 1))
    seen = [losses.note(first, resent, float(resent), is_stalled=False) for resent in (0, 1, 1, 2, 3)]
    assert not any(seen)
    assert losses.note(second, 1, 4.0, is_stalled=False)
    assert losses.note(second, 1, 60.0, is_stalled=False)
    assert not losses.note(second, 1, 62.0, is_stalled=False), "the first loss was a minute ago"
    assert not losses.note((("a", 1), ("c", 1)), 1, 4.0, is_stalled=False), "another peer"


def test_packets_that_are_sent_again_in_a_cut_count_once_when_it_is_over() -> None:
    losses, ends = Losses(), (("a", 1), ("b", 1))
    assert not any(losses.note(ends, resent, resent / 4, is_stalled=True) for resent in range(1, 9))
    assert not losses.note(ends, 9, 3.0, is_stalled=False)


def test_a_connection_that_works_loses_nothing_and_its_round_trip_is_known() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:
        one = stack.enter_context(socket.create_connection(server.getsockname(), PATIENCE_S))
        stack.enter_context(server.accept()[0])
        is_lossy, round_trip_ms = Losses().look(one, 0.0)
        assert not is_lossy and 0 <= round_trip_ms < 1000


def test_a_full_connection_takes_less_data_once_its_unsent_bytes_are_limited() -> None:
    def filled(*, is_limited: bool) -> int:
        with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as one:
            if is_limited:
                limit_unsent(one)
            one.setblocking(False)
            taken_bytes = 0
            with suppress(BlockingIOError):
                while True:
                    taken_bytes += one.send(bytes(4096))
            return taken_bytes

    assert filled(is_limited=True) < filled(is_limited=False)
