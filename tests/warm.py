"""Commands of `cfgplan` in processes, most of them forks of one that has imported it: see `warm_cfgplan.py`."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace

from warm_cfgplan import product_modules
from warm_python import warm_subprocess

_CODE = Path(__file__).with_name("warm_cfgplan.py")


def command(*arguments: object) -> list[str]:
    """The command line of `cfgplan`, for tests that look at what it says and does.

    They use the fixture `warm_cfgplan`, so that the server counts as no process of theirs.
    """
    return [sys.executable, "-I", "-S", str(_CODE), warm_socket(), *map(str, arguments)]


def cold_command(*arguments: object) -> list[str]:
    """The command line of `cfgplan`, for tests that look at its process."""
    return [sys.executable, "-c", "import sys; from cfgplan.cli import main; sys.exit(main())", *map(str, arguments)]


def warm_processes() -> SimpleNamespace:
    """The module `subprocess`: its `Popen` starts a `cold_command` as a child of this process, with warm imports.

    Agents, nurseries and relays that the child starts are forks of it as it was before its command began.
    """
    return warm_subprocess(
        *product_modules(), "cfgplan_runtime.fleet.agent", "cfgplan_runtime.ros1.topic_relay", "zenoh"
    )


def module_command(module: str) -> list[str]:
    """The command line of a module's `main`, as a fork of a process that has imported the module."""
    return [sys.executable, "-I", "-S", str(_CODE), warm_socket(module)]


@cache
def warm_socket(module: str = "") -> str:
    """The socket of a server, which ends with this process. Its forks run the module, `cfgplan` if none is named."""
    folder = tempfile.mkdtemp(prefix="cfgplan-warm-")
    path = str(Path(folder, "socket"))
    line = [sys.executable, str(_CODE), "serve", path, module]
    # A module beside the tests is found, too.
    there = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)} if module else None
    server = subprocess.Popen(line, stdout=subprocess.PIPE, env=there)
    assert server.stdout is not None and server.stdout.readline() == b"ready\n"

    def end() -> None:
        server.kill()
        server.wait()
        shutil.rmtree(folder)

    atexit.register(end)
    return path
