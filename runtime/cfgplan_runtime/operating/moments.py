"""The state of a run after each of its last reviews, so that a viewer can go back to a moment."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

from cfgplan_runtime.lifecycle.reports import Report, Reviewed, Snapshot
from cfgplan_runtime.operating.protocol import Record

MOMENTS_KEPT = 100
"""Snapshots share most of their parts: those of 151 units take some 0.2 MB each."""

Moment = tuple[Snapshot, Mapping[str, Record]]
"""A snapshot, and the flow of each topic at that time."""


class Moments:
    """Keeps the last moments, which `now` returns right after a review. Thread-safe."""

    def __init__(self, now: Callable[[], Moment]) -> None:
        self._now = now
        self._lock = threading.Lock()
        self._kept: dict[int, Moment] = {}

    def hear(self, report: Report) -> None:
        """Listen to a manager: after each review, keep the moment."""
        if isinstance(report, Reviewed):
            moment = self._now()
            with self._lock:
                self._kept[report.review.number] = moment
                if len(self._kept) > MOMENTS_KEPT:
                    del self._kept[min(self._kept)]

    def after(self, review: int) -> Moment | None:
        """Return the moment after a review; None if it is not kept."""
        with self._lock:
            return self._kept.get(review)
