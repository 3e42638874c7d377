"""Listening to the ball's positions during the play, and comparing each with the truth of its moment."""

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
    """A position on the topic, in metres, with the moment that it is of, when it came, and where the ball really was.

    `expected_m` is the error that the position itself expects, a standard deviation.
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
        """The positions of moments in between."""
        with self._news:
            return tuple(
                s for s in self._samples if s.time_ns >= since_ns and (until_ns is None or s.time_ns < until_ns)
            )

    def wait_for(self, since_ns: int, timeout_s: float) -> Sample | None:
        """Wait for the first position of a moment from `since_ns` on. None if there is none in time."""

        def first() -> Sample | None:
            return next((sample for sample in self._samples if sample.time_ns >= since_ns), None)

        with self._news:
            return self._news.wait_for(first, timeout_s)

    def close(self) -> None:
        """End the thread. To be called after the end of the run."""
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
