"""`cfgplan` as a fork of a process that has imported it: a command without the CPU time of its imports.

`warm_cfgplan.py serve SOCKET` imports the product and waits. With the name of a module, it imports that instead,
and its commands call the module's `main`. `warm_cfgplan.py SOCKET ARGUMENT...` runs a command: the fork has the
streams, environment and folder of its caller. The caller passes signals on to the fork, ends with its exit code or by
its signal, and takes it along when killed. The fork is no child of its caller: tests of process ids, limits and starts
run `cfgplan` directly.
"""

from __future__ import annotations

import gc
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Callable
from contextlib import suppress

PASSED_ON = (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)
_LENGTH_BYTES = 4
STARTING = (["run"], ["agent"])
"""The commands that start agents, nurseries or relays."""


def call(path: str, arguments: list[str]) -> int:
    """Run a command at the server of a socket. Returns its exit code; ends by a signal if the command did."""
    heard, waking = socket.socketpair()
    waking.setblocking(False)
    signal.set_wakeup_fd(waking.fileno())
    for number in PASSED_ON:
        signal.signal(number, lambda *_: None)
    with socket.socket(socket.AF_UNIX) as server:
        server.connect(path)
        asked = json.dumps([arguments, dict(os.environ), os.getcwd()]).encode()  # noqa: PTH109 (pathlib takes long to import)
        socket.send_fds(server, [len(asked).to_bytes(_LENGTH_BYTES, "big")], [0, 1, 2])
        server.sendall(asked)
        while True:
            ready, _, _ = select.select([heard, server], [], [])
            if server in ready:
                break
            server.sendall(heard.recv(16))
        status, answering = (int.from_bytes(server.recv(_LENGTH_BYTES), "big") for _ in range(2))
    _await_end(answering)
    if os.WIFSIGNALED(status):
        if os.WTERMSIG(status) in PASSED_ON:
            signal.signal(os.WTERMSIG(status), signal.SIG_DFL)
        os.kill(os.getpid(), os.WTERMSIG(status))
    return os.waitstatus_to_exitcode(status)


def _await_end(pid: int) -> None:
    """Wait until a process has ended: a test that looks for processes after its command finds none of the command's."""
    with suppress(ProcessLookupError):
        ended = os.pidfd_open(pid)
        select.select([ended], [], [])


def serve(path: str, module: str) -> int | None:
    """Answer calls until the process that started it ends. Returns in the fork of a call with its exit code."""
    from setproctitle import getproctitle
    from warm_python import die_with_parent

    getproctitle()  # finds the place of titles, as in warm_python.py
    die_with_parent(os.getppid())
    main = _main_of(module) if module else _main_of_the_product()
    gc.collect()
    gc.freeze()  # a collection in a fork would copy all that was imported
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(path)
        listening.listen(64)
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        while True:
            caller, _ = listening.accept()
            if os.fork() == 0:
                listening.close()
                return _answer(caller, main)
            caller.close()
            with suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG) != (0, 0):
                    pass


def _main_of(module: str) -> Callable[[], int | None]:
    import importlib

    main: Callable[[], int | None] = importlib.import_module(module).main
    return main


def _main_of_the_product() -> Callable[[], int]:
    import importlib

    import cfgplan.cli

    for name in product_modules():
        importlib.import_module(name)
    return cfgplan.cli.main


def product_modules() -> list[str]:
    """The names of the modules that commands import when they need them."""
    import pkgutil

    import cfgplan.cli

    return [
        *(module.name for module in pkgutil.iter_modules(cfgplan.cli.__path__, "cfgplan.cli.")),
        "cfgplan.api", "cfgplan.answers", "cfgplan.explaining", "cfgplan.matching.session", "cfgplan.formats.models",
        "cfgplan.planners.cpsat", "cfgplan.planners.exact.deployment", "cfgplan.planners.exact.search", "networkx",
        "rich.live", "rich.table", "cfgplan_runtime.operating.operation", "cfgplan_runtime.lifecycle.file_watch",
    ]  # fmt: skip


def _answer(caller: socket.socket, main: Callable[[], int | None]) -> int | None:
    """Fork the command of a call, pass signals on to it, and send its wait status and the id of this process.

    Returns in the command's process.
    """
    head, streams, _, _ = socket.recv_fds(caller, _LENGTH_BYTES, 3)
    asked, length = b"", int.from_bytes(head, "big")
    while len(asked) < length:
        asked += caller.recv(length - len(asked))
    me = os.getpid()
    command = os.fork()
    if command == 0:
        caller.close()
        return _run(main, streams, *json.loads(asked), parent=me)
    for stream in streams:
        os.close(stream)
    ended = os.pidfd_open(command)
    while ended not in select.select([caller, ended], [], [])[0]:
        numbers = caller.recv(16)
        for number in numbers or (signal.SIGKILL,):
            os.kill(command, number)
        if not numbers:
            break
    with suppress(OSError):
        told = os.waitpid(command, 0)[1], os.getpid()
        caller.sendall(b"".join(number.to_bytes(_LENGTH_BYTES, "big") for number in told))
    os._exit(0)


def _run(
    main: Callable[[], int | None],
    streams: list[int],
    arguments: list[str],
    environment: dict[str, str],
    folder: str,
    *,
    parent: int,
) -> int | None:
    """Become the command, as `python -c` starts it."""
    from warm_python import die_with_parent, renew_streams, with_warm_helpers

    die_with_parent(parent)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[0] = ""
    sys.path[1:1] = [part for part in environment.get("PYTHONPATH", "").split(os.pathsep) if part not in sys.path]
    sys.argv = ["-c", *arguments]
    renew_streams()
    if arguments[:1] in STARTING and (order := with_warm_helpers()):
        exec(order["code"], {"__name__": "__main__"})
        return None
    return main()


if __name__ == "__main__":
    sys.exit(serve(sys.argv[2], sys.argv[3]) if sys.argv[1] == "serve" else call(sys.argv[1], sys.argv[2:]))
