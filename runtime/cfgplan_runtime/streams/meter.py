"""The traffic of a topic: rate, count and age of its elements."""

from __future__ import annotations

from collections import deque
from typing import TypedDict

OVER_S = 3.0
"""The seconds over which rate and age are measured."""
_MOST_STAMPS = 4096


class Figures(TypedDict):
    """The fields of `children.messages.Flow`."""

    rate_hz: float
    latency_ms: float | None
    elements: int
    dropped: int
    silent_s: float | None


class Meter:
    """Counts a topic's elements, and measures their age at arrival; times in seconds."""

    def __init__(self, since_s: float) -> None:
        self._since_s = since_s
        self._elements = 0
        self._stamps: deque[tuple[float, float]] = deque(maxlen=_MOST_STAMPS)

    def note(self, age_s: float, now_s: float) -> None:
        """Count an element."""
        self._elements += 1
        self._stamps.append((now_s, age_s))

    def figures(self, dropped: int, now_s: float) -> Figures:
        """Rate, age and counts at `now_s`; `dropped` is the caller's count."""
        first_s = self._stamps[0][0] if len(self._stamps) == _MOST_STAMPS else 0.0
        begin_s = max(now_s - OVER_S, self._since_s, first_s)
        ages = sorted(age for at, age in self._stamps if at >= begin_s)
        return Figures(
            rate_hz=round(len(ages) / (now_s - begin_s), 2) if now_s > begin_s else 0.0,
            latency_ms=round(ages[len(ages) // 2] * 1e3, 3) if ages else None,
            elements=self._elements,
            dropped=dropped,
            silent_s=round(now_s - self._stamps[-1][0], 3) if self._stamps else None,
        )
