"""Listens to the ball's positions during the play, and compares each with the true position at its time."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from typing import Any

from cfgplan_runtime.errors import NoSuchTopicError
from cfgplan_runtime.streams.subscription import subscribe
from football import scenario

_PATIENCE_S = 0.05


@dataclass(frozen=True, slots=True)
class Sample:
    """A received position in metres, the time of its picture, its arrival time, and the ball's true position.

    `expected_m` is the standard deviation that the position's own covariance gives.
    """

    time_ns: int
    came_ns: int
    x: float
    y: float
    true_x: float
    true_y: float
    expected_m: float

    @property
    def error_m(self) -> float:
        return math.hypot(self.x - self.true_x, self.y - self.true_y)


class Listener:
    """Collects the elements on a topic of a run, in a thread, until the run ends."""

    def __init__(self, topic: str, run: str) -> None:
        self._topic, self._run = topic, run
        self._samples: list[Sample] = []
        self._news = threading.Condition()
        self._is_over = False
        self._thread = threading.Thread(target=self._listen, name="demo-listener", daemon=True)
        self._thread.start()

    def samples(self, since_ns: int = 0, until_ns: int | None = None) -> tuple[Sample, ...]:
        """Return the received positions whose pictures were taken between two times, in nanoseconds since the epoch."""
        with self._news:
            return tuple(
                s for s in self._samples if s.time_ns >= since_ns and (until_ns is None or s.time_ns < until_ns)
            )

    def wait_for(self, since_ns: int, timeout_s: float) -> Sample | None:
        """Wait for the first position whose picture was taken at `since_ns` or later. None if none comes in time."""

        def first() -> Sample | None:
            return next((sample for sample in self._samples if sample.time_ns >= since_ns), None)

        with self._news:
            return self._news.wait_for(first, timeout_s)

    def close(self) -> None:
        """End the thread. Call it after the end of the run."""
        self._is_over = True
        self._thread.join()

    def _listen(self) -> None:
        while not self._is_over:
            try:
                with subscribe(self._topic, run=self._run, wait_s=_PATIENCE_S) as subscription:
                    for received in subscription:
                        self._note(received.value, received.time_ns)
            except NoSuchTopicError:
                continue

    def _note(self, value: Any, time_ns: int) -> None:
        true_x, true_y = scenario.ball(time_ns)
        xx, _, yy = value["covariance"]
        expected_m = math.sqrt(xx + yy)
        sample = Sample(time_ns, time.time_ns(), value["x"], value["y"], true_x, true_y, expected_m)
        with self._news:
            self._samples.append(sample)
            self._news.notify_all()
