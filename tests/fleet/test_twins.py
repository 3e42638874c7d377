"""Two agents of one name: of those that meet late, the one that began later ends."""

from __future__ import annotations

import msgspec
import pytest
from cfgplan_runtime.fleet import twins
from cfgplan_runtime.fleet.links import LEASE_S
from cfgplan_runtime.fleet.twins import Sign, Twins
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.errors import InputError


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


class Pair:
    """Two agents called r1 that hear each other's signs, and who of them has ended."""

    def __init__(self, clock: Clock, lives: tuple[str, str], later_by_s: float) -> None:
        self.ended: list[str] = []
        self.agents: dict[str, Twins] = {}
        for life in lives:
            self.agents[life] = Twins("r1", life, lambda error, life=life: self._note(life, error))  # type: ignore[misc]
            clock.now_s += later_by_s

    def _note(self, life: str, error: InputError) -> None:
        assert "the fleet has an agent 'r1' that began earlier" in str(error)
        self.ended.append(life)

    def exchange(self) -> None:
        for life, agent in self.agents.items():
            for other, hearer in self.agents.items():
                if life not in self.ended and other not in self.ended:
                    hearer.hear(life, agent.sign())


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(twins, "time", made)
    return made


@given(st.permutations(["a", "b"]), st.floats(0.001, 1e6))
def test_of_two_agents_that_meet_the_one_that_began_later_ends(lives: list[str], later_by_s: float) -> None:
    with pytest.MonkeyPatch.context() as patch:
        clock = Clock()
        patch.setattr(twins, "time", clock)
        pair = Pair(clock, (lives[0], lives[1]), later_by_s)
        for _ in range(4):
            pair.exchange()
            clock.now_s += LEASE_S
        assert pair.ended == [lives[1]]


def test_of_two_agents_that_began_at_once_exactly_one_ends(clock: Clock) -> None:
    pair = Pair(clock, ("a", "b"), 0.0)
    for _ in range(4):
        pair.exchange()
        clock.now_s += LEASE_S
    assert pair.ended == ["b"]


def test_an_agent_that_was_killed_and_is_heard_late_ends_nobody(clock: Clock) -> None:
    dead = Twins("r1", "a", lambda _: None)
    clock.now_s += 60
    ended: list[InputError] = []
    alive = Twins("r1", "b", ended.append)
    for _ in range(3):
        alive.hear("a", dead.sign())
        clock.now_s += LEASE_S / 8
    assert ended == []


def test_a_sign_of_another_version_ends_nobody(clock: Clock) -> None:
    ended: list[InputError] = []
    alive = Twins("r1", "b", ended.append)
    for payload in (b"", b"garbage", msgspec.msgpack.encode({"age": 1}), msgspec.msgpack.encode(Sign(10**9))):
        alive.hear("a", payload)
        clock.now_s += LEASE_S
        alive.hear("a", payload)
    assert ended == []
