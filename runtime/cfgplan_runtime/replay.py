"""Unit code that gives a topic of a recording again, in real time or faster.

`source: cfgplan_runtime.replay:Source`; the parameters are those of the class. `cfgplan replay FILE.mcap` writes them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from cfgplan.errors import InputError
from cfgplan_runtime.children.unit_code import At
from cfgplan_runtime.operating.recorded import recorded, values

_ORDERS_AGAIN_S = 0.05
"""A source looks for orders so often while its next value is not due."""


class Source:
    """A source: replays `topic` of the recording `file` at its recorded intervals, `speed` times as fast.

    The first message of the recording, on any topic, is due at `begin_ns` (nanoseconds since 1970); without it, when
    the source is constructed. Sources with the same `begin_ns` stay in step, and a restarted one continues where the
    others are. A value has the time at which it is due. With `loop` the recording begins again one second after its
    end. Raises InputError.
    """

    def __init__(
        self,
        file: str,
        topic: str,
        *,
        speed: float = 1.0,
        begin_ns: int | None = None,
        loop: bool = False,
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not speed > 0:
            raise InputError.of(f"a recording can't be played {speed:g} times as fast", mend="write a speed above 0")
        self._path, self._topic, self._speed, self._loop = Path(file), topic, speed, loop
        self._now_ns, self._sleep = now_ns, sleep
        found = recorded(self._path)
        if topic not in found.topics:
            there = ", ".join(found.topics) or "no topic"
            raise InputError.of(f"the recording has no topic {topic!r}", file=file, mend=f"it has {there}")
        self._first_ns = found.begin_ns
        self._span_ns = found.end_ns - found.begin_ns + 1_000_000_000
        self._begin_ns = now_ns() if begin_ns is None else begin_ns

    def __iter__(self) -> Iterator[At | None]:
        """The values, each when it is due; None while the next one is not."""
        passed_ns = int(max(0, self._now_ns() - self._begin_ns) * self._speed)
        rounds, passed_ns = divmod(passed_ns, self._span_ns) if self._loop else (0, passed_ns)
        after_ns = self._first_ns + passed_ns - 1
        while True:
            for at_ns, value in values(self._path, self._topic, after_ns):
                played_ns = rounds * self._span_ns + at_ns - self._first_ns
                due_ns = self._begin_ns + int(played_ns / self._speed)
                while (left_s := (due_ns - self._now_ns()) / 1e9) > 0:
                    self._sleep(min(left_s, _ORDERS_AGAIN_S))
                    if left_s > _ORDERS_AGAIN_S:
                        yield None
                yield At(due_ns, value)
            if not self._loop:
                return
            rounds, after_ns = rounds + 1, -1
