"""A node before it is one: rclpy imported, its participant up and known to all others, so that it begins at once.

`PYTHON warm.py SOCKET TYPES` says `ready` on the socket and waits there for a line that says what to be: the words of
a command whose program is written in Python, and an environment. Then it becomes that program, in this process. TYPES
are message types, with commas between, whose libraries are loaded before.
"""

from __future__ import annotations

import json
import os
import runpy
import socket
import sys
from contextlib import AbstractContextManager, suppress
from importlib import import_module
from types import TracebackType
from typing import Any

import rclpy
import rclpy.node

_ROS_ARGS, _NAME = "--ros-args", "__node:="
_PR_SET_NAME = 15


class _Begun(AbstractContextManager["_Begun"]):
    """Stands for the context that `rclpy.init` would have made."""

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        rclpy.try_shutdown()


def load(kind: str) -> None:
    """Load the library of a type, if it is installed."""
    package, _, name = kind.partition("/msg/")
    with suppress(ImportError, AttributeError):
        of = getattr(import_module(f"{package}.msg"), name)
        type(of).__import_type_support__()


def show_name(name: str) -> None:
    """Have `top` and `ps -o comm` show a node's name."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_NAME, name.encode())


def become(command: list[str]) -> None:
    """Run a program as if it had been started by this command. Its names and parameters hold for all of its nodes."""
    begin, make = rclpy.init, rclpy.node.Node.__init__
    own = command[command.index(_ROS_ARGS) :] if _ROS_ARGS in command else []

    def init(*args: Any, **options: Any) -> object:
        rclpy.init = begin
        return begin(*args, **options) if "context" in options else _Begun()

    def make_node(self: Any, *args: Any, cli_args: Any = None, **options: Any) -> None:
        make(self, *args, cli_args=[*(cli_args or []), *own], **options)

    rclpy.init, rclpy.node.Node.__init__ = init, make_node
    show_name(next((word.partition(_NAME)[2] for word in own if word.startswith(_NAME)), ""))
    sys.argv = command
    sys.path[0] = os.path.dirname(os.path.realpath(command[0]))  # noqa: PTH120
    runpy.run_path(command[0], run_name="__main__")


def main(number: str, types: str) -> None:
    """Get ready, wait for a command, and become it; end if the run has ended."""
    end = socket.socket(fileno=int(number))
    rclpy.init(args=[])
    for kind in filter(None, types.split(",")):
        load(kind)
    hidden = rclpy.node.Node(f"_cfgplan_warm_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
    end.sendall(b"ready\n")
    with end, end.makefile() as lines:
        line = lines.readline()
    if line:
        command, environment = json.loads(line)
        os.environ.update(environment)
        become(command)
    hidden.destroy_node()


if __name__ == "__main__":
    main(*sys.argv[1:])
