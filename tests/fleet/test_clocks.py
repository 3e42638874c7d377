"""Clocks of hosts that drift and are set, read over links that are slow now and then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

import pytest
from cfgplan_runtime.fleet.clocks import CALLS, CALLS_AGAIN, CLOCK_S, SHOWN_NS, HostClock, Reading, corrected, has_moved

MS = 1_000_000
HOUR_S = 3600


@dataclass
class SimulatedHosts:
    """A manager and a host whose clock is ahead by `ahead_ns` and drifts; a call takes up to `slow_ns` one way."""

    random: Random
    slow_ns: int
    drift_ppm: float = 0.0
    ahead_ns: int = 0
    day_ahead_ns: int = 0
    true_ns: int = 0

    @property
    def truth_ns(self) -> int:
        """How far the host's clock is ahead now."""
        return self.ahead_ns + round(self.true_ns * self.drift_ppm / 1e6)

    def read(self, calls: int) -> Reading:
        manager = HostClock(lambda: self.true_ns, lambda: self.true_ns)
        host = HostClock(lambda: self.true_ns + self.truth_ns, lambda: self.true_ns + self.day_ahead_ns)

        def ask() -> Iterator[bytes]:
            self.true_ns += self.random.randrange(50_000, self.slow_ns)
            answer = host.answer()
            self.true_ns += self.random.randrange(50_000, self.slow_ns)
            yield answer

        reading = manager.read(ask, calls)
        assert reading is not None
        return reading


@pytest.mark.parametrize("drift_ppm", [-100.0, 0.0, 50.0, 500.0])
@pytest.mark.parametrize("slow_ns", [MS // 5, 50 * MS])
def test_a_clock_that_drifts_is_followed_for_an_hour(drift_ppm: float, slow_ns: int) -> None:
    hosts = SimulatedHosts(Random(1), slow_ns, drift_ppm, ahead_ns=-700 * MS)
    believed_ns, largest_step_ns = hosts.read(CALLS).ahead_ns, 0
    for _ in range(int(HOUR_S / CLOCK_S)):
        hosts.true_ns += int(CLOCK_S * 1e9)
        reading = hosts.read(CALLS_AGAIN)
        before_ns, believed_ns = believed_ns, corrected(believed_ns, reading.ahead_ns, reading.doubt_ns)
        largest_step_ns = max(largest_step_ns, abs(believed_ns - before_ns))
        while_asked_ns = abs(drift_ppm) / 1e6 * CALLS_AGAIN * 2 * slow_ns
        assert abs(believed_ns - hosts.truth_ns) <= 2 * reading.doubt_ns + while_asked_ns
    assert largest_step_ns <= slow_ns + abs(drift_ppm) * 1e3 * CLOCK_S * 2


def test_what_a_slow_link_makes_uncertain_moves_nothing() -> None:
    hosts = SimulatedHosts(Random(2), 50 * MS, ahead_ns=5 * MS)
    believed_ns = 5 * MS
    for _ in range(100):
        reading = hosts.read(CALLS_AGAIN)
        believed_ns = corrected(believed_ns, reading.ahead_ns, reading.doubt_ns)
    assert believed_ns == 5 * MS


def test_a_time_of_day_that_is_set_is_told_and_moves_no_element() -> None:
    hosts = SimulatedHosts(Random(3), MS, ahead_ns=MS, day_ahead_ns=MS)
    first = hosts.read(CALLS)
    assert abs(first.day_ahead_ns - MS) <= first.doubt_ns
    assert not has_moved(first.day_ahead_ns, hosts.read(CALLS_AGAIN))
    hosts.day_ahead_ns += 500 * MS
    reading = hosts.read(CALLS_AGAIN)
    assert has_moved(first.day_ahead_ns, reading)
    assert abs(reading.day_ahead_ns - 501 * MS) <= reading.doubt_ns
    assert corrected(first.ahead_ns, reading.ahead_ns, reading.doubt_ns) == pytest.approx(MS, abs=2 * MS)


def test_a_computer_that_has_slept_is_corrected_at_once() -> None:
    hosts = SimulatedHosts(Random(4), MS)
    believed_ns = hosts.read(CALLS).ahead_ns
    hosts.ahead_ns -= 3_000 * MS
    reading = hosts.read(CALLS_AGAIN)
    assert abs(corrected(believed_ns, reading.ahead_ns, reading.doubt_ns) + 3_000 * MS) <= 2 * reading.doubt_ns


def test_a_clock_that_does_not_answer_tells_nothing() -> None:
    assert HostClock(lambda: 0).read(lambda: (), CALLS) is None
    assert not has_moved(0, Reading(0, SHOWN_NS, 2 * SHOWN_NS - 1))
