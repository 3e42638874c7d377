"""`python -c CODE` as a fork of a process that has imported the modules that the code needs, for nurseries and agents.

The fork is a child of the process that asks for it, as a started Python is: it has its parent's death signal, process
group, session, streams, environment and folder. Its imports take no CPU time. It has the limits and the hash
seed of the process that forks it. Programs that tests start by themselves start nurseries and agents as users do.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from setproctitle import getproctitle, setproctitle

_LONGEST_BYTES = 1 << 18
_HIGH_NUMBER = 200
"""Descriptors get numbers from here on until all of the caller's numbers are free."""
_CLONE3, _CLONE_PARENT = 435, 0x8000
_CLONE_ARGUMENTS = 8
_LOOK_S = 0.005


class WarmPython:
    """A process that has imported modules, and forks children of the process that has the other end of its socket."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def start(
        self,
        command: Sequence[str],
        *,
        pass_fds: Sequence[int] = (),
        stdin: int = subprocess.DEVNULL,
        start_new_session: bool = False,
        process_group: int | None = None,
    ) -> WarmChild | subprocess.Popen[bytes]:
        """Start `python -c CODE ARGUMENT...`, as `subprocess.Popen` does, or by it if the system refuses `clone3`."""
        _, option, code, *arguments = command
        assert (option, stdin) == ("-c", subprocess.DEVNULL), "nothing else is served"
        asked = {
            "code": code, "arguments": arguments, "environment": dict(os.environ), "folder": str(Path.cwd()),
            "numbers": list(pass_fds), "in_session": start_new_session, "in_group": process_group is not None,
        }  # fmt: skip
        with Path(os.devnull).open() as nothing:
            socket.send_fds(self._end, [json.dumps(asked).encode()], [nothing.fileno(), 1, 2, *pass_fds])
        pid = int(self._end.recv(_LONGEST_BYTES))
        if pid > 0:
            return WarmChild(pid)
        as_asked: dict[str, Any] = {"start_new_session": start_new_session, "process_group": process_group}
        return subprocess.Popen(command, pass_fds=pass_fds, stdin=stdin, **as_asked)


class WarmChild:
    """A child of this process, with the methods of `subprocess.Popen` that the runtime uses."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        if self.returncode is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:
                pid, status = self.pid, 0
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        until = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until is not None and time.monotonic() > until:
                raise subprocess.TimeoutExpired([str(self.pid)], timeout or 0.0)
            time.sleep(_LOOK_S)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


@cache
def warm_subprocess(*modules: str) -> SimpleNamespace:
    """The module `subprocess`, for a module of the runtime that starts Python with it: such a Python is warm."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        command = [sys.executable, __file__, str(theirs.fileno()), str(os.getpid()), *modules]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        subprocess.Popen(command, pass_fds=[theirs.fileno()], env=environment, process_group=0)
    return _subprocess_with(ours)


def _subprocess_with(end: socket.socket) -> SimpleNamespace:
    start = WarmPython(end).start
    return SimpleNamespace(Popen=start, DEVNULL=subprocess.DEVNULL, TimeoutExpired=subprocess.TimeoutExpired)


def _serve(end: socket.socket, parent: int) -> dict[str, Any] | None:
    """Fork children of the parent until it ends. Returns in a child with its order, else None."""
    from cfgplan_runtime.processes.nursery import die_with_parent

    die_with_parent(parent)
    with suppress(OSError):
        while True:
            data, descriptors, _, _ = socket.recv_fds(end, _LONGEST_BYTES, 64)
            if not data:
                break
            pid = _fork_a_sibling()
            if pid == 0:
                end.close()
                return {**json.loads(data), "descriptors": descriptors}
            end.send(str(pid).encode())
            for descriptor in descriptors:
                os.close(descriptor)
    return None


def _fork_a_sibling() -> int:
    """Fork this process, which has one thread. The child's parent is this process's parent.

    Returns as `os.fork`, or -1 if the system refuses (containers may forbid `clone3`).
    """
    arguments = (ctypes.c_uint64 * _CLONE_ARGUMENTS)(_CLONE_PARENT)
    ctypes.pythonapi.PyOS_BeforeFork()
    pid = int(ctypes.PyDLL(None).syscall(_CLONE3, ctypes.byref(arguments), ctypes.sizeof(arguments)))
    if pid == 0:
        ctypes.pythonapi.PyOS_AfterFork_Child()
    else:
        ctypes.pythonapi.PyOS_AfterFork_Parent()
    return pid


def _become(order: dict[str, Any]) -> None:
    """Make this process like one that `python -c` has started with this order."""
    import fcntl

    if order["in_session"]:
        os.setsid()
    elif order["in_group"]:
        os.setpgid(0, 0)
    high = [fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _HIGH_NUMBER) for descriptor in order["descriptors"]]
    os.closerange(3, _HIGH_NUMBER)
    for descriptor, number in zip(high, [0, 1, 2, *order["numbers"]], strict=True):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.chdir(order["folder"])
    os.environ.clear()
    os.environ.update(order["environment"])
    time.tzset()
    path = [part for part in os.environ.get("PYTHONPATH", "").split(os.pathsep) if part]
    sys.path[:] = ["", *path, *(part for part in sys.path[1:] if part not in path)]
    sys.argv = ["-c", *order["arguments"]]
    setproctitle(" ".join([sys.executable, "-c", order["code"], *order["arguments"]]))
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _main() -> None:
    number, parent, *modules = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    getproctitle()  # finds the place of titles, for which the environment has to be as it was at the start
    for name in modules:
        importlib.import_module(name)
    gc.collect()
    gc.freeze()  # a collection in a child would copy all that was imported
    order = _serve(socket.socket(fileno=int(number)), int(parent))
    if order is None:
        return
    _become(order)
    if "Agent" in vars(sys.modules.get("cfgplan_runtime.fleet.agent", sys)):
        order = _with_a_warm_nursery(order)
    exec(order["code"], {"__name__": "__main__"})


def _with_a_warm_nursery(order: dict[str, Any]) -> dict[str, Any]:
    """Let the nursery of this agent be a fork of this process as it is now. Returns the order, in a nursery its own."""
    from cfgplan_runtime.processes import nursery_link

    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    agent = os.getpid()
    if os.fork() == 0:
        ours.close()
        of_nursery = _serve(theirs, agent)
        if of_nursery is None:
            os._exit(0)
        _become(of_nursery)
        return of_nursery
    theirs.close()
    nursery_link.subprocess = _subprocess_with(ours)  # type: ignore[assignment]
    return order


if __name__ == "__main__":
    _main()
