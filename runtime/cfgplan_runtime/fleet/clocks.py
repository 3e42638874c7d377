"""The difference of each host's clock from the run's: measured repeatedly, and corrected by its certain part.

The times of a run's elements use one clock on every host: that of the run's first manager when it began. All these
clocks are monotonic, and the offset that a host adds to its own stays the same until it is corrected. So if a user sets
a computer's time of day, the run shows the change, and no element's time changes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from cfgplan_runtime.streams.crossing import host_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink

CALLS, CALLS_AGAIN = 30, 5
"""The number of calls of the first reading, and of later ones. The shortest call counts."""
CLOCK_S = 10.0
"""Seconds from one reading to the next. At 50 ppm a clock moves by 0.5 ms in that time."""
_CALL_S = 1.0
SHOWN_NS = 10_000_000
"""The least change of a host's time of day that is reported."""


def clock_key(host: str, life: str) -> str:
    """The key at which a host's agent answers with its clock; `life` is the id of its process."""
    return f"{host_key(host)}/clock/{life}"


@dataclass(frozen=True, slots=True)
class Reading:
    """A host's clock is ahead of the local one by `ahead_ns`, give or take `doubt_ns`, half the time that the call
    took.

    Its time of day is ahead by `day_ahead_ns`.
    """

    ahead_ns: int
    doubt_ns: int
    day_ahead_ns: int


@dataclass(frozen=True, slots=True)
class HostClock:
    """A monotonic clock (`now_ns`) and the time of day, both in nanoseconds."""

    now_ns: Callable[[], int]
    day_ns: Callable[[], int] = time.time_ns

    def answer(self) -> bytes:
        """The answer to a question for this clock."""
        return f"{self.now_ns()} {self.day_ns()}".encode()

    def read_host(self, link: ZenohLink, host: str, life: str, calls: int) -> Reading | None:
        """Read a host's clock from the agent `life` with `calls` calls. None if no call is answered."""
        return self.read(lambda: (answer for _, answer in link.ask(clock_key(host, life), _CALL_S)), calls)

    def read(self, ask: Callable[[], Iterable[bytes]], calls: int) -> Reading | None:
        """Read a clock with `calls` calls of `ask`, which gives answers. None if no call is answered."""
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
    """Whether a host's time of day differs from the one shown by SHOWN_NS or more, whatever the doubt."""
    return abs(reading.day_ahead_ns - shown_ns) >= SHOWN_NS + reading.doubt_ns


def corrected(believed_ns: int, measured_ns: int, doubt_ns: int) -> int:
    """The value nearest to `believed_ns` that the measurement and its doubt allow."""
    return min(max(believed_ns, measured_ns - doubt_ns), measured_ns + doubt_ns)
