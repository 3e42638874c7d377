"""Heartbeats between a manager and agents over loopback, with a wire between that loses datagrams."""

from __future__ import annotations

import queue
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from types import SimpleNamespace

import pytest
from cfgplan_runtime.fleet import heartbeats
from cfgplan_runtime.fleet.heartbeats import Answering, Asking, new_secret
from small_fleet import PATIENCE_S, eventually


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        port: int = end.getsockname()[1]
        return port


class Wire:
    """Passes datagrams between whoever asks at `place` and an agent, unless `keeps` says no to one."""

    def __init__(self, agent: str, keeps: Callable[[bytes], bool]) -> None:
        self.seen: list[bytes] = []
        self._keeps, self._agent = keeps, ("127.0.0.1", int(agent.split()[1]))
        self._end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._end.bind(("127.0.0.1", 0))
        self.place = f"127.0.0.1 {self._end.getsockname()[1]}"
        self._asker: object = None
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            datagram, address = self._end.recvfrom(256)
            if not datagram:
                self._end.close()
                return
            self.seen.append(datagram)
            if address != self._agent:
                self._asker = address
            if self._keeps(datagram) and self._asker is not None:
                self._end.sendto(datagram, self._agent if address != self._agent else self._asker)  # type: ignore[arg-type]

    def close(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
            end.sendto(b"", self._end.getsockname())


class Ends:
    """An agent, a manager that may ask it, and what both have heard."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.of_manager: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.of_agent: queue.SimpleQueue[tuple[str, float]] = queue.SimpleQueue()
        self.agent = Answering([f"127.0.0.1 {free_udp_port()}", "/a/socket"], self.of_manager.put)
        stack.callback(self.agent.close)
        self.manager = Asking(lambda name, _, at_s: self.of_agent.put((name, at_s)))
        stack.callback(self.manager.close)

    def through(self, keeps: Callable[[bytes], bool]) -> Wire:
        """A wire to the agent."""
        wire = Wire(self.agent.places[0], keeps)
        self._stack.callback(wire.close)
        return wire


@pytest.fixture
def ends() -> Iterator[Ends]:
    with ExitStack() as stack:
        yield Ends(stack)


def test_an_agent_answers_the_manager_that_it_obeys_and_both_hear_of_each_other(ends: Ends) -> None:
    secret = new_secret()
    ends.agent.obey("m", secret)
    ends.manager.ask("r1", ends.agent.places, secret)
    answers = [ends.of_agent.get(timeout=PATIENCE_S) for _ in range(3)]
    assert [name for name, _ in answers] == ["r1"] * 3
    assert sorted(at_s for _, at_s in answers) == [at_s for _, at_s in answers]
    assert ends.of_manager.get(timeout=PATIENCE_S) == "m"


def test_an_agent_that_has_answered_is_asked_at_once_and_has_some_round_trips_time(ends: Ends) -> None:
    asked: queue.SimpleQueue[float] = queue.SimpleQueue()
    manager = Asking(lambda _name, asked_s, _at_s: asked.put(asked_s))
    try:
        assert manager.ask_at_once("r1") == 0, "nobody of this name is asked"
        secret = new_secret()
        wire = ends.through(lambda _: is_there)
        is_there = False
        manager.ask("r1", [wire.place], secret)
        eventually(lambda: len(wire.seen) >= 1)
        assert manager.ask_at_once("r1") == 0, "it has never answered"
        ends.agent.obey("m", secret)
        is_there = True
        asked.get(timeout=PATIENCE_S)
        before_s = time.monotonic()
        assert 0.02 <= manager.ask_at_once("r1") < PATIENCE_S
        while asked.get(timeout=PATIENCE_S) < before_s:
            pass
    finally:
        manager.close()


@pytest.mark.parametrize("round_trip_s", [0.001, 0.02, 0.5])
def test_an_agent_is_asked_several_times_before_it_is_gone_since_datagrams_may_be_lost(
    monkeypatch: pytest.MonkeyPatch, round_trip_s: float
) -> None:
    now_s, secret = [0.0], new_secret()
    idle = SimpleNamespace(start=lambda: None, join=lambda: None)
    monkeypatch.setattr(heartbeats, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    monkeypatch.setattr(heartbeats, "threading", SimpleNamespace(Lock=threading.Lock, Thread=lambda **_: idle))
    manager = Asking(lambda *_: None)
    manager.ask("r1", [f"127.0.0.1 {free_udp_port()}"], secret)
    asked = manager._agents["r1"]
    manager._ask_due(0.0)
    now_s[0] = round_trip_s
    manager._take(heartbeats._signed(secret, 1, heartbeats._ANSWER), ("127.0.0.1", 1))
    end_s, number = now_s[0] + manager.ask_at_once("r1"), 0
    while asked.due_s < end_s - 1e-9:
        manager._ask_due(asked.due_s)
        number += 1
    assert number >= 4
    manager.close()


def test_half_of_all_datagrams_may_be_lost(ends: Ends) -> None:
    chance = random.Random(0)
    wire = ends.through(lambda _: chance.random() < 0.5)
    secret = new_secret()
    ends.agent.obey("m", secret)
    ends.manager.ask("r1", [wire.place], secret)
    for _ in range(3):
        assert ends.of_agent.get(timeout=PATIENCE_S)[0] == "r1"


def test_a_question_with_another_secret_is_not_answered(ends: Ends) -> None:
    wire = ends.through(lambda _: True)
    ends.agent.obey("m", new_secret())
    ends.manager.ask("r1", [wire.place], new_secret())
    eventually(lambda: len(wire.seen) >= 4)
    ends.manager.ask("r1", [wire.place], secret := new_secret())
    ends.agent.obey("n", secret)
    assert ends.of_manager.get(timeout=PATIENCE_S) == "n"
    assert ends.of_agent.get(timeout=PATIENCE_S)[0] == "r1"


def test_a_recorded_question_is_no_sign_of_the_manager_and_a_recorded_answer_none_of_the_agent(ends: Ends) -> None:
    wire = ends.through(lambda _: True)
    secret = new_secret()
    ends.agent.obey("m", secret)
    ends.manager.ask("r1", [wire.place], secret)
    ends.of_agent.get(timeout=PATIENCE_S)
    ends.manager.forget("r1")
    recorded = list(wire.seen)
    while not ends.of_manager.empty():
        ends.of_manager.get()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker:
        attacker.settimeout(PATIENCE_S)
        host, port = ends.agent.places[0].split()
        for datagram in (*recorded, b"cfg1", b""):
            attacker.sendto(datagram, (host, int(port)))
        assert attacker.recv(256) in recorded, "the agent is there, and answers as before"
    assert ends.of_manager.empty()


def test_an_agent_whose_port_is_taken_does_without_heartbeats() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        agent = Answering([f"127.0.0.1 {taken.getsockname()[1]}"], lambda _: None)
        agent.close()
        assert agent.places == ()
