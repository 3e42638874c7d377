"""For the soak, preloaded into its nursery: as long as a file exists, no process can be made."""

from __future__ import annotations

import errno
import os
from pathlib import Path

FULL, HEIR = "CFGPLAN_SOAK_FULL", "CFGPLAN_SOAK_HEIR"
"""The variables that name files: while the first is there forks fail; the second wishes for an heir, and is removed."""

_fork = os.fork


def fork() -> int:
    if FULL in os.environ and Path(os.environ[FULL]).exists():
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    return _fork()


os.fork = fork
