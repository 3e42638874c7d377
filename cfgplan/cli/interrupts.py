"""Ctrl-C and SIGTERM, counted: the first asks for a clean end, the second for one at once, the third has one."""

from __future__ import annotations

import os
import signal
from types import FrameType, TracebackType

from cfgplan.cli.exits import Exit

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_MOST_PATIENT = 2


class Interrupts:
    """Counts both signals while it is entered; until `only_count`, they raise KeyboardInterrupt."""

    def __init__(self) -> None:
        self.count = 0
        self._raises = True

    def only_count(self) -> None:
        """From now on somebody looks at `count`."""
        self._raises = False

    def __enter__(self) -> Interrupts:
        self._before = [signal.signal(one, self._hear) for one in _SIGNALS]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for one, handler in zip(_SIGNALS, self._before, strict=True):
            signal.signal(one, handler)

    def _hear(self, _number: int, _frame: FrameType | None) -> None:
        self.count += 1
        if self._raises:
            raise KeyboardInterrupt
        if self.count > _MOST_PATIENT:
            # What runs ends with this process, and its folder is removed by the next run.
            os._exit(Exit.INTERRUPTED)
