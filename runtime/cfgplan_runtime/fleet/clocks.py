"""How far the clock of a host is ahead of the run's: measured again and again, and corrected by what is certain.

The times of a run's elements go by one clock, that of its first manager when it began, on every host. No clock that
counts here is ever set: each is monotonic, and what a host adds to it stays. So the correction of a computer's time of
day is shown, and moves no element.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from cfgplan_runtime.streams.crossing import host_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink

CALLS, CALLS_AGAIN = 30, 5
"""The shortest of so many calls tells how far a clock is ahead: at first, and again and again from then on."""
CLOCK_S = 10.0
"""Seconds after which a clock is read again. At 50 ppm it has moved by 0.5 ms then."""
_CALL_S = 1.0
SHOWN_NS = 10_000_000
"""That a host's time of day has changed by so much is told."""


def clock_key(host: str) -> str:
    """The key at which an agent tells its clock."""
    return f"{host_key(host)}/clock"


@dataclass(frozen=True, slots=True)
class Reading:
    """A host's clock is ahead of ours by `ahead_ns`, give or take `doubt_ns`: half the time that the call took.

    `day_ahead_ns` is how far its time of day is ahead.
    """

    ahead_ns: int
    doubt_ns: int
    day_ahead_ns: int


@dataclass(frozen=True, slots=True)
class HostClock:
    """A clock that only rises, and the time of day, both in nanoseconds; those of this process by default."""

    now_ns: Callable[[], int]
    day_ns: Callable[[], int] = time.time_ns

    def told(self) -> bytes:
        """What a host answers who asks for its clock."""
        return f"{self.now_ns()} {self.day_ns()}".encode()

    def read_host(self, link: ZenohLink, host: str, calls: int) -> Reading | None:
        """The best of some readings of a host's clock; None if it does not answer."""
        return self.read(lambda: (answer for _, answer in link.ask(clock_key(host), _CALL_S)), calls)

    def read(self, ask: Callable[[], Iterable[bytes]], calls: int) -> Reading | None:
        """The best of some readings of a clock that `ask` asks; None if it does not answer."""
        found = []
        for _ in range(calls):
            before_ns = self.now_ns()
            for answer in ask():
                after_ns, day_ns = self.now_ns(), self.day_ns()
                theirs_ns, their_day_ns = map(int, answer.split())
                taken_ns = after_ns - before_ns
                day_ahead_ns = their_day_ns - (day_ns - taken_ns // 2)
                found.append(Reading(theirs_ns - before_ns - taken_ns // 2, taken_ns // 2 + 1, day_ahead_ns))
        return min(found, key=lambda reading: reading.doubt_ns, default=None)


def has_moved(shown_ns: int, reading: Reading) -> bool:
    """Whether the time of day of a host is another than was shown, for certain and by much."""
    return abs(reading.day_ahead_ns - shown_ns) >= SHOWN_NS + reading.doubt_ns


def corrected(believed_ns: int, measured_ns: int, doubt_ns: int) -> int:
    """What is next to `believed_ns` of all that a measurement allows: what it does not tell for certain stays."""
    return min(max(believed_ns, measured_ns - doubt_ns), measured_ns + doubt_ns)
