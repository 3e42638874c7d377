"""Preloaded into a nursery: as long as a file is there, no process can be made."""

from __future__ import annotations

import errno
import os
from pathlib import Path

FULL = "CFGPLAN_TEST_FULL"
"""The variable that names the file."""

_fork = os.fork


def fork() -> int:
    if Path(os.environ[FULL]).exists():
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    return _fork()


os.fork = fork
