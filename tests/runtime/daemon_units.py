"""Unit code that starts processes in every way; each process writes its id into the folder `notes`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

CODE = "import os, sys, time; open(os.path.join(sys.argv[1], str(os.getpid())), 'w').close(); time.sleep(3600)"


def stay(notes: str) -> None:
    """Never return."""
    os.execv(sys.executable, [sys.executable, "-c", CODE, notes])


def started(notes: str) -> None:
    subprocess.Popen([sys.executable, "-c", CODE, notes])


def in_a_session(notes: str) -> None:
    subprocess.Popen([sys.executable, "-c", CODE, notes], start_new_session=True)


def forked(notes: str) -> None:
    """A copy of the unit itself, which goes on without exec."""
    if os.fork() == 0:
        os.setsid()
        (Path(notes) / str(os.getpid())).touch()
        time.sleep(3600)


def daemon(notes: str) -> None:
    """Forks twice, as daemons do, so that its parent ends."""
    between = os.fork()
    if between == 0:
        os.setsid()
        if os.fork() == 0:
            stay(notes)
        os._exit(0)
    os.waitpid(between, 0)


def family(notes: str) -> None:
    """A daemon that starts another one, in a session of its own."""
    between = os.fork()
    if between == 0:
        os.setsid()
        if os.fork() == 0:
            in_a_session(notes)
            stay(notes)
        os._exit(0)
    os.waitpid(between, 0)


def brief(notes: str) -> None:
    """A daemon that ends at once."""
    between = os.fork()
    if between == 0:
        pid = os.fork()
        if pid == 0:
            (Path(notes) / str(os.getpid())).touch()
        os._exit(0)
    os.waitpid(between, 0)


class Starts:
    """Starts a process as it is constructed, then gives what it takes."""

    def __init__(self, way: str, notes: str) -> None:
        globals()[way](notes)

    def __call__(self, x: Any) -> Any:
        return x
