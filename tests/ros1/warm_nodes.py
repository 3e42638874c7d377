"""Nodes of `talking.py`, and masters, as forks of a process that has imported rospy."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from warm_python import WarmChild, WarmPython, warm_python

NODES = Path(__file__).with_name("talking.py")
PYTHON = "/usr/bin/python3"
_CODES = {
    NODES.name: "import sys, rospy.names, talking; rospy.names.reload_mappings(sys.argv); talking.main()",
    "rosmaster": "import sys, rosmaster; rosmaster.rosmaster_main(sys.argv)",
}
"""By the name of a program: the code that does the same in a process that has imported its modules."""


def with_rospy() -> WarmPython:
    """The process that forks. The thread that calls this first must outlive all of its forks."""
    return warm_python(PYTHON, str(NODES.parent), "rosmaster.main", "talking")


def start(command: Sequence[str], **as_asked: Any) -> WarmChild | subprocess.Popen[bytes]:
    """Start what `with_parent` wraps as `subprocess.Popen` does; a node of `talking.py` and a master as forks."""
    program, *arguments = command[command.index("--") + 1 :] if "--" in command else command
    code = _CODES.get(Path(program).name)
    if code is None:
        return subprocess.Popen(command, **as_asked)
    return with_rospy().start([PYTHON, "-c", code, *arguments], dies_with_us=True, **as_asked)


SUBPROCESS = SimpleNamespace(Popen=start, DEVNULL=subprocess.DEVNULL, TimeoutExpired=subprocess.TimeoutExpired)
"""The module `subprocess`, for modules of the runtime that start nodes and masters."""
