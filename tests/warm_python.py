"""`python -c CODE` as a fork of a process that has imported the modules that the code needs: nurseries, agents, nodes.

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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, Self

try:
    from setproctitle import getproctitle, setproctitle
except ImportError:  # the system's Python, which runs nodes: they keep the title of their server
    setproctitle = None

_LONGEST_BYTES = 1 << 18
_HIGH_NUMBER = 200
"""Descriptors get numbers from here on until all of the caller's numbers are free."""
_CLONE3, _CLONE_PARENT = 435, 0x8000
_CLONE_ARGUMENTS = 8
_LOOK_S = 0.005
_PR_SET_PDEATHSIG = 1


class WarmPython:
    """A process that has imported modules, and forks children of the process that has the other end of its socket."""

    def __init__(self, end: socket.socket, path: Sequence[str] = ()) -> None:
        self._end, self._path = end, path

    def start(
        self,
        command: Sequence[str],
        *,
        pass_fds: Sequence[int] = (),
        stdin: int = subprocess.DEVNULL,
        stdout: int | None = None,
        stderr: int | None = None,
        text: bool = False,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
        start_new_session: bool = False,
        process_group: int | None = None,
        dies_with_us: bool = False,
    ) -> WarmChild | subprocess.Popen[bytes]:
        """Start `python -c CODE ARGUMENT...`, as `subprocess.Popen` does, or by it if the system refuses `clone3`.

        With `dies_with_us`, it is killed at the end of the thread that started the server.
        """
        env, (_, option, code, *arguments) = os.environ if env is None else env, command
        assert (option, stdin) == ("-c", subprocess.DEVNULL), "nothing else is served"
        asked = {
            "code": code, "arguments": arguments, "environment": dict(env),
            "folder": str(cwd or Path.cwd()),
            "numbers": list(pass_fds), "in_session": start_new_session, "in_group": process_group is not None,
            "parent": os.getpid() if dies_with_us else None,
        }  # fmt: skip
        pipes = [os.pipe() if stream == subprocess.PIPE else None for stream in (stdout, stderr)]
        with Path(os.devnull).open("r+b") as nothing:
            numbers = [nothing.fileno(), 1, 2]
            for number, stream, pipe in zip((1, 2), (stdout, stderr), pipes, strict=True):
                known = {None: number, subprocess.DEVNULL: nothing.fileno(), subprocess.STDOUT: numbers[1]}
                numbers[number] = pipe[1] if pipe else known.get(stream, stream)
            socket.send_fds(self._end, [json.dumps(asked).encode()], [*numbers, *pass_fds])
        pid = int(self._end.recv(_LONGEST_BYTES))
        for pipe in filter(None, pipes):
            os.close(pipe[1])
        if pid > 0:
            return WarmChild(pid, *(pipe and os.fdopen(pipe[0], "r" if text else "rb") for pipe in pipes))
        for pipe in filter(None, pipes):
            os.close(pipe[0])
        as_asked: dict[str, Any] = {"start_new_session": start_new_session, "process_group": process_group}
        as_asked |= {"stdin": stdin, "stdout": stdout, "stderr": stderr, "text": text, "cwd": cwd}
        as_asked["env"] = {**env, "PYTHONPATH": os.pathsep.join(filter(None, [*self._path, env.get("PYTHONPATH")]))}
        return subprocess.Popen(command, pass_fds=pass_fds, **as_asked)


class WarmChild:
    """A child of this process, with the methods of `subprocess.Popen` that the runtime and tests use."""

    def __init__(self, pid: int, stdout: IO[Any] | None = None, stderr: IO[Any] | None = None) -> None:
        self.pid = pid
        self.stdout, self.stderr = stdout, stderr
        self.returncode: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for stream in (self.stdout, self.stderr):
            if stream is not None:
                stream.close()
        self.wait()

    def communicate(self, timeout: float | None = None) -> tuple[Any, Any]:
        """Read what it says until nobody has its pipes, then what it says of errors, and wait for its end."""
        said = [stream and stream.read() for stream in (self.stdout, self.stderr)]
        self.wait(timeout)
        return said[0], said[1]

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
    return _subprocess_with(_started(sys.executable, sys.path, modules), sys.path)


@cache
def warm_python(python: str, path: str, *modules: str) -> WarmPython:
    """A process of another Python, which finds modules in the folder `path`, too."""
    return WarmPython(_started(python, [path], modules), [path])


def _started(python: str, path: Sequence[str], modules: Sequence[str]) -> socket.socket:
    """Start a process that has imported modules. Returns the socket that asks it for children."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        command = [python, __file__, str(theirs.fileno()), str(os.getpid()), *modules]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path))}
        subprocess.Popen(command, pass_fds=[theirs.fileno()], env=environment, process_group=0)
    return ours


def _subprocess_with(end: socket.socket, path: Sequence[str] = ()) -> SimpleNamespace:
    start = WarmPython(end, path).start
    return SimpleNamespace(Popen=start, DEVNULL=subprocess.DEVNULL, TimeoutExpired=subprocess.TimeoutExpired)


def _serve(end: socket.socket, parent: int) -> dict[str, Any] | None:
    """Fork children of the parent until it ends. Returns in a child with its order, else None."""
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


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process when its parent's thread ends: without the product, which needs packages."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


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

    if order["parent"] is not None:
        die_with_parent(order["parent"])
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
    renew_streams()
    path = [part for part in os.environ.get("PYTHONPATH", "").split(os.pathsep) if part]
    sys.path[:] = ["", *path, *(part for part in sys.path[1:] if part not in path)]
    sys.argv = ["-c", *order["arguments"]]
    if setproctitle is not None:
        setproctitle(" ".join([sys.executable, "-c", order["code"], *order["arguments"]]))
    signal.signal(signal.SIGINT, signal.default_int_handler)


def renew_streams() -> None:
    """Let `sys` have streams of the descriptors 0 to 2 as they are now, like a Python that starts with them."""
    for name, number, how in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        was = getattr(sys, f"__{name}__")
        is_line = name == "stderr" or os.isatty(number) or "PYTHONUNBUFFERED" in os.environ
        stream = open(number, how, 1 if is_line and how == "w" else -1, was.encoding, was.errors, closefd=False)  # noqa: SIM115
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


def _main() -> None:
    number, parent, *modules = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if setproctitle is not None:
        getproctitle()  # finds the place of titles, for which the environment has to be as it was at the start
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for name in modules:
        importlib.import_module(name)
    if len([*Path("/proc/self/task").iterdir()]) > 1:
        sys.exit(
            f"a module of {' '.join(modules)} has started a thread: forks of this process might wait for it for ever"
        )
    gc.collect()
    gc.freeze()  # a collection in a child would copy all that was imported
    order = _serve(socket.socket(fileno=int(number)), int(parent))
    if order is None:
        return
    _become(order)
    if "Agent" in vars(sys.modules.get("cfgplan_runtime.fleet.agent", sys)):
        order = with_warm_helpers() or order
    exec(order["code"], {"__name__": "__main__"})


def with_warm_helpers() -> dict[str, Any] | None:
    """Let agents, nurseries and relays that this process starts be forks of it as it is now, with one thread.

    Returns None in this process, and its order in such a fork.
    """
    from cfgplan_runtime.fleet import local
    from cfgplan_runtime.processes import nursery_link

    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    me = os.getpid()
    if os.fork() == 0:
        ours.close()
        order = _serve(theirs, me)
        if order is None:
            os._exit(0)
        _become(order)
        return (with_warm_helpers() if order["code"] == local._AGENT_CODE else None) or order
    theirs.close()
    nursery_link.subprocess = local.subprocess = _subprocess_with(ours)  # type: ignore[assignment]
    return None


if __name__ == "__main__":
    _main()
