"""For all tests: how many run at a time, and signals that work as at a shell, whatever the tests were started by."""

from __future__ import annotations

import os
import signal


def pytest_configure() -> None:
    """nohup ignores hang-ups, a shell's background job interrupts, and all children would inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores, since many tests wait for processes that they have started."""
    return (os.cpu_count() or 1) + 1
