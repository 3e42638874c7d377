"""Signals that end a command: the first one ends it cleanly, the second stops units at once, the third kills it.

They are Ctrl-C, SIGTERM, and the SIGHUP of a closed terminal.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from cfgplan.cli.exits import Exit

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Windows has no SIGHUP."""
_MOST_PATIENT = 2


class Ending:
    """The events that may end a command before it is done."""

    def __init__(self) -> None:
        self.interrupted = False
        """True once Ctrl-C was pressed; an exception raised after that may be a consequence."""
        self._is_over = False

    def over(self) -> None:
        """Note that nothing is left to clean up: from now on a signal ends the process at once."""
        self._is_over = True

    def hear(self, number: int, _frame: FrameType | None) -> None:
        if self._is_over:
            os._exit(128 + number)
        if number == signal.SIGINT:
            self.interrupted = True
            raise KeyboardInterrupt
        raise SystemExit(128 + number)


@contextmanager
def ended_cleanly(*, for_good: bool = False) -> Iterator[Ending]:
    """Make SIGTERM and a closed terminal end a command by an exception, so that its folders and processes are removed.

    `for_good`: the process ends with the command, and the handlers stay. Otherwise the former handlers are restored.
    """
    ending = Ending()
    signals = _SIGNALS if threading.current_thread() is threading.main_thread() else ()
    usual = (signal.SIG_DFL, signal.default_int_handler)
    before = {one: signal.signal(one, ending.hear) for one in signals if signal.getsignal(one) in usual}
    try:
        yield ending
    finally:
        ending.over()
        if not for_good:
            for one, handler in before.items():
                signal.signal(one, handler)
        elif ending.interrupted:
            # Python gives up its own handlers before it has ended.
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def end_below_threads(code: int) -> None:
    """End the process by this code if a thread is left that a library may have started; return otherwise.

    Up to Python 3.13 the end of the interpreter unwinds a thread that comes back from Rust or C++ code, which aborts
    the process: "FATAL: exception not rethrown" (python/cpython#87135).
    """
    if threading.active_count() == 1 and "zenoh" not in sys.modules:
        return
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


class Interrupts:
    """Counts signals that end a command while it is entered; until `only_count`, the first raises KeyboardInterrupt."""

    def __init__(self) -> None:
        self.count = 0
        self._raises = True

    def only_count(self) -> None:
        """Only count signals from now on: the caller looks at `count`."""
        self._raises = False

    def __enter__(self) -> Interrupts:
        # Under nohup SIGHUP is ignored.
        wanted = [one for one in _SIGNALS if one == signal.SIGINT or signal.getsignal(one) != signal.SIG_IGN]
        self._before = {one: signal.signal(one, self._hear) for one in wanted}
        return self

    def __exit__(self, *_: object) -> None:
        for one, handler in self._before.items():
            signal.signal(one, handler)

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self._raises:
            # A second interrupt must not stop the clean-up of the first.
            self._raises = False
            before = self._before[signal.Signals(number)]
            if number == signal.SIGINT and callable(before):
                before(number, frame)
            raise KeyboardInterrupt
        if self.count > _MOST_PATIENT:
            # Running units end with this process, and the next run removes its folder.
            os._exit(Exit.INTERRUPTED)
