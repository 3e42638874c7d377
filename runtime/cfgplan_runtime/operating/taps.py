"""Taps of streams that no topic shows to observers. Each ends by itself, soon after its last renewal."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from cfgplan.domain import Stream
from cfgplan_runtime.lifecycle.reports import Observed, Report
from cfgplan_runtime.streams.run_folder import address

TAP_S = 6.0
"""Seconds for which a tap stays open after it was asked for."""


class Tapped(Protocol):
    """A runtime that shows streams on topics of their own."""

    def tap(self, stream: Stream) -> str: ...

    def untap(self, stream: Stream) -> None: ...


class LeasedTaps:
    """Opens taps, and closes those that were not renewed in time. `run` is the folder of the run. Thread-safe."""

    def __init__(self, runtime: Tapped, run: Path, now_s: Callable[[], float] = time.monotonic) -> None:
        self._run = run
        self._runtime = runtime
        self._now_s = now_s
        self._lock = threading.Lock()
        self._until_s: dict[Stream, float] = {}

    def is_shown(self, topic: str) -> bool:
        """Whether observers can subscribe to a topic; one of ROS nodes is in ROS alone."""
        return address(self._run, topic).exists()

    def renew(self, stream: Stream) -> str:
        """Show a stream on a topic for TAP_S seconds from now, and return the topic."""
        with self._lock:
            self._until_s[stream] = self._now_s() + TAP_S
            return self._runtime.tap(stream)

    def hear(self, report: Report) -> None:
        """Listen to a manager: with each observation, close the taps whose time is over."""
        if isinstance(report, Observed) and self._until_s:
            with self._lock:
                now_s = self._now_s()
                for stream in [stream for stream, until_s in self._until_s.items() if until_s <= now_s]:
                    del self._until_s[stream]
                    self._runtime.untap(stream)
