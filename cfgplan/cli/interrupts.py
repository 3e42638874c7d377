"""Ctrl-C and SIGTERM, counted: the first asks for a clean end, the second for one at once."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
