"""Which processes live: those that run. One that has ended but waits for its parent to look does not."""

from __future__ import annotations

from collections.abc import Iterable

import psutil


def lives(process: psutil.Process) -> bool:
    """Whether a process runs. It may end at any moment, between two questions too."""
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def living(processes: Iterable[psutil.Process]) -> list[psutil.Process]:
    """The processes that run."""
    return list(filter(lives, processes))


def descendants() -> set[psutil.Process]:
    """The processes below this one that run."""
    return set(living(psutil.Process().children(recursive=True)))
