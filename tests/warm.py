"""Commands of `cfgplan` in processes, most of them forks of one that has imported it: see `warm_cfgplan.py`."""

from __future__ import annotations

import atexit
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

_CODE = Path(__file__).with_name("warm_cfgplan.py")


def command(*arguments: object) -> list[str]:
    """The command line of `cfgplan`, for tests that look at what it says and does.

    They use the fixture `warm_cfgplan`, so that the server counts as no process of theirs.
    """
    return [sys.executable, "-I", "-S", str(_CODE), warm_socket(), *map(str, arguments)]


def cold_command(*arguments: object) -> list[str]:
    """The command line of `cfgplan`, for tests that look at its process."""
    return [sys.executable, "-c", "import sys; from cfgplan.cli import main; sys.exit(main())", *map(str, arguments)]


@cache
def warm_socket() -> str:
    """The socket of a server, which ends with this process."""
    folder = tempfile.mkdtemp(prefix="cfgplan-warm-")
    path = str(Path(folder, "socket"))
    server = subprocess.Popen([sys.executable, str(_CODE), "serve", path], stdout=subprocess.PIPE)
    assert server.stdout is not None and server.stdout.readline() == b"ready\n"

    def end() -> None:
        server.kill()
        server.wait()
        shutil.rmtree(folder)

    atexit.register(end)
    return path
