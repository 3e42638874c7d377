"""Ctrl-C, SIGTERM and a closed terminal: one asks for a clean end, a second for one at once, a third has one."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType, TracebackType

from cfgplan.cli.exits import Exit

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
_MOST_PATIENT = 2


@contextmanager
def ended_cleanly() -> Iterator[None]:
    """SIGTERM and a closed terminal end a command by an exception, so that its folders and processes are removed."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    names = _SIGNALS[1:] if current_thread() is main_thread() else ()
    signals = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {one: signal.signal(one, end) for one in signals if signal.getsignal(one) == signal.SIG_DFL}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


class Interrupts:
    """Counts such signals while it is entered; until `only_count`, they raise KeyboardInterrupt."""

    def __init__(self) -> None:
        self.count = 0
        self._raises = True

    def only_count(self) -> None:
        """From now on somebody looks at `count`."""
        self._raises = False

    def __enter__(self) -> Interrupts:
        # Windows has no SIGHUP, and under nohup it is ignored.
        signals = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
        wanted = [one for one in signals if one == signal.SIGINT or signal.getsignal(one) != signal.SIG_IGN]
        self._before = {one: signal.signal(one, self._hear) for one in wanted}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for one, handler in self._before.items():
            signal.signal(one, handler)

    def _hear(self, _number: int, _frame: FrameType | None) -> None:
        self.count += 1
        if self._raises:
            raise KeyboardInterrupt
        if self.count > _MOST_PATIENT:
            # What runs ends with this process, and its folder is removed by the next run.
            os._exit(Exit.INTERRUPTED)
