"""The process that forks the children. It has imported all modules before, so that a child is ready at once.

However the supervisor ends, the nursery ends too, and kills all children and their descendants. If a child ends, its
descendants are killed.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import gc
import importlib
import io
import logging
import os
import random
import resource
import selectors
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Sequence

from setproctitle import setproctitle

from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.outlet_child import NO_DESCRIPTOR, OutletChild
from cfgplan_runtime.children.program import NOT_READY
from cfgplan_runtime.children.program_source import names_program
from cfgplan_runtime.children.rehearsal import fill_gaps, rehearse
from cfgplan_runtime.children.unit_child import UnitChild
from cfgplan_runtime.children.unit_code import UNIT_VARIABLE
from cfgplan_runtime.errors import ProgramEndedError
from cfgplan_runtime.processes.child_process import kill_group
from cfgplan_runtime.processes.descendants import (
    adopt_orphans,
    children,
    control_process,
    end_children,
    mark_of,
    put_mark,
    serial_of,
)
from cfgplan_runtime.processes.guard import post_guard

DUMP_SIGNAL = signal.SIGUSR1
INTERRUPT_SIGNAL = signal.SIGUSR2
"""The signal that raises SystemExit in a unit's code, wherever it is."""
FAILED = 70
"""Exit status of a child whose unit code failed for good; its last message (Trouble) says why."""

_CALLED_AFTER_FORK = (threading, "_after_fork"), (logging, "_after_at_fork_child_reinit_locks")
"""Functions of the standard library that `os.fork` calls in a child."""
_SIGN_PERIOD_S = 1.0
_SOCKETS_OF_A_CHILD = 2


class Nursery:
    """Forks children on request and reports the end of each."""

    def __init__(self, end: socket.socket, run: str) -> None:
        self._run, self._mark = run, mark_of(run, os.getpid())
        self._guard = post_guard(run, self._mark)
        """The descriptor whose end the guard waits for."""
        self._control: ControlConnection[messages.ToNursery] = ControlConnection(end, messages.ToNursery)
        self._serials: dict[int, int] = {}
        self._selector = selectors.DefaultSelector()
        self._is_left = False
        """Whether the supervisor is gone."""
        self._sign_s = 0.0
        """The time at which the next sign of life is due."""
        self._waker, self._bell_rope = socket.socketpair()
        for waker in (self._waker, self._bell_rope):
            waker.setblocking(False)

    def run(self) -> None:
        # A kill from the kernel would leave what the children have started: their groups are killed first.
        signal.signal(signal.SIGTERM, lambda *_: self._leave())
        tell_of_parents_death(signal.SIGTERM)
        adopt_orphans()
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._bell_rope.fileno(), warn_on_full_buffer=False)
        self._selector.register(self._waker, selectors.EVENT_READ)
        self._selector.register(self._control.socket, selectors.EVENT_READ)
        while not (self._control.has_ended or self._is_left):
            if time.monotonic() >= self._sign_s:
                self._sign_s = time.monotonic() + _SIGN_PERIOD_S
                self._control.send(messages.Alive())
            self._selector.select(max(0.0, self._sign_s - time.monotonic()))
            with contextlib.suppress(BlockingIOError):
                self._waker.recv(4096)
            self._reap()
            for message, sockets in self._control.receive():
                match message:
                    case messages.Fork(serial, order):
                        self._fork(serial, order, sockets)
                    case messages.Kill(serial, dump):
                        self._signal(serial, DUMP_SIGNAL if dump else signal.SIGKILL)
                    case messages.Interrupt(serial):
                        self._signal(serial, INTERRUPT_SIGNAL)
        signal.set_wakeup_fd(-1)
        for pid in self._serials:
            kill_group(pid)
        end_children()

    def _leave(self) -> None:
        self._is_left = True

    def _fork(self, serial: int, order: messages.ChildOrder, sockets: list[socket.socket]) -> None:
        parent = os.getpid()
        cause, pid = NO_DESCRIPTOR, -1
        if len(sockets) == _SOCKETS_OF_A_CHILD:
            try:
                pid = os.fork()
            except OSError as error:
                cause = f"no process can be made: {error.strerror}"
        if pid == 0:
            status = FAILED
            try:
                self._become_child(parent)
                put_mark(self._mark, serial)
                status = be_child(order, *sockets, run=self._run)
            finally:
                os._exit(status)
        for end in sockets:
            end.close()
        if pid == -1:
            self._control.send(messages.NotForked(serial, cause))
            return
        with contextlib.suppress(OSError):
            os.setpgid(pid, pid)
        self._serials[pid] = serial
        self._control.send(messages.Forked(serial, pid))

    def _become_child(self, parent: int) -> None:
        die_with_parent(parent)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        with contextlib.suppress(OSError):
            os.setpgid(0, 0)
        self._selector.close()
        self._control.close()
        os.close(self._guard)
        for waker in (self._waker, self._bell_rope):
            waker.close()

    def _signal(self, serial: int, number: signal.Signals) -> None:
        for pid, other in self._serials.items():
            if other == serial and number == signal.SIGKILL:
                kill_group(pid)
            elif other == serial:
                with contextlib.suppress(OSError):
                    os.kill(pid, number)

    def _reap(self) -> None:
        has_ended = False
        while (ended := self._next_ended()) is not None:
            has_ended = True
            pid, status = ended
            if pid in self._serials:
                self._control.send(messages.Gone(self._serials.pop(pid), status))
        if has_ended:
            self._kill_orphans()

    def _next_ended(self) -> tuple[int, int] | None:
        """Reap a child that has ended, or an adopted process. Returns its id and exit status; None if none has ended.

        If the system allows it, a child's process group is killed before the child is reaped, as afterwards its number
        may be reused.
        """
        try:
            if hasattr(os, "waitid"):
                seen = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
                if seen is None:
                    return None
                if seen.si_pid in self._serials:
                    kill_group(seen.si_pid)
                pid, status = os.waitpid(seen.si_pid, 0)
            else:
                pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return None
        return (pid, os.waitstatus_to_exitcode(status)) if pid else None

    def _kill_orphans(self) -> None:
        """Kill adopted processes of children that have ended. Their own children are adopted next, and killed too."""
        living = set(self._serials.values())
        for pid in children():
            if pid not in self._serials:
                serial = serial_of(pid, self._mark)
                if serial is not None and serial not in living:
                    kill_group(pid)


def be_child(order: messages.ChildOrder, control_end: socket.socket, printed: socket.socket, *, run: str) -> int:
    """Run as a unit, a spare or the outlets until told to finish. Returns the exit status."""
    _redirect(printed)
    atexit._clear()  # what the nursery has registered is the nursery's
    control: ControlConnection[messages.ToChild] = ControlConnection(control_end, messages.ToChild)
    unit: UnitChild | None = None
    is_well = False
    try:
        if isinstance(order, messages.OutletOrder):
            setproctitle(f"cfgplan {run} outlets")
            OutletChild(order, control).run()
            return 0
        _seed_numpy()
        of_unit, title = (order.order, "spare ") if isinstance(order, messages.SpareOrder) else (order, "")
        setproctitle(f"cfgplan {run} {title}{of_unit.unit}")
        os.environ[UNIT_VARIABLE] = f"{run}/{of_unit.unit}"
        _limit_memory(of_unit.memory_bytes)
        signal.signal(INTERRUPT_SIGNAL, signal.SIG_IGN)
        if names_program(of_unit.source):
            faulthandler.unregister(DUMP_SIGNAL)
            signal.signal(DUMP_SIGNAL, lambda *_: _print_debt(unit))
        unit = UnitChild(of_unit, control, is_spare=isinstance(order, messages.SpareOrder))
        signal.signal(INTERRUPT_SIGNAL, lambda *_: unit.interrupt())
        if isinstance(order, messages.SpareOrder):
            begun = unit.await_beginning()
            if begun is None:
                return 0
            setproctitle(f"cfgplan {run} {begun}")
            os.environ[UNIT_VARIABLE] = f"{run}/{begun}"
        unit.run()
        is_well = True
    except SystemExit as error:
        _tell(control, messages.Trouble("exited", unit.step if unit else 0, "".join(traceback.format_exception(error))))
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    except ProgramEndedError as error:
        _tell(control, messages.Trouble("failed", unit.step if unit else 0, str(error)))
        return FAILED
    except BaseException as error:
        _tell(control, messages.Trouble("failed", unit.step if unit else 0, "".join(traceback.format_exception(error))))
        return FAILED
    finally:
        _end_as_python_does(waits=is_well)
    return 0


def _print_debt(unit: UnitChild | None) -> None:
    """Print which message a program has not written: the stack of its unit's process would show only cfgplan's code."""
    os.write(sys.stderr.fileno(), f"{unit.debt if unit else NOT_READY}\n".encode())


def _end_as_python_does(*, waits: bool) -> None:
    """Join threads if `waits`, call functions registered with atexit, and flush all files open for writing.

    A forked child skips the rest of Python's own end, which would be the nursery's. A child that has failed joins no
    threads, since that may never end.
    """
    for end in (threading._shutdown, atexit._run_exitfuncs)[not waits :]:  # type: ignore[attr-defined]
        with contextlib.suppress(BaseException):  # atexit has printed what was raised
            end()
    for each in gc.get_objects():
        if isinstance(each, io.IOBase):
            with contextlib.suppress(Exception):
                each.flush()


def _tell(control: ControlConnection[messages.ToChild], trouble: messages.Trouble) -> None:
    control.socket.setblocking(True)
    control.send(trouble)


def _rehearse_fork() -> None:
    """Call the functions that Python itself calls in each child, unless a thread of a preloaded module runs: they would
    mark it as ended. Then seed numpy, as a child does.

    What they raise is ignored, as in a fork: a preloaded module may have given a log handler another kind of lock.
    """
    if threading.active_count() == 1:
        for module, name in _CALLED_AFTER_FORK:
            with contextlib.suppress(Exception):
                getattr(module, name, bool)()
    random.seed()
    _seed_numpy()


def _seed_numpy() -> None:
    """Give this process random numbers of its own. Python seeds its own generator at a fork, numpy does not."""
    if "numpy.random" in sys.modules:
        # A number changes fewer pages than the generator that numpy would seed itself with.
        sys.modules["numpy.random"].seed(int.from_bytes(os.urandom(4)))


def _open_output() -> None:
    """Open the files of `print` for all children: they write to descriptors that each child redirects."""
    for name, number in (("stdout", 1), ("stderr", 2)):
        setattr(sys, name, os.fdopen(number, "w", buffering=1, errors="backslashreplace", closefd=False))
    faulthandler.enable(sys.stderr)
    faulthandler.register(DUMP_SIGNAL, sys.stderr, all_threads=True)


def _redirect(printed: socket.socket) -> None:
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    for number in (1, 2):
        os.dup2(printed.fileno(), number)
    printed.close()


def _limit_memory(limit: int | None) -> None:
    if limit is not None and sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def main(arguments: Sequence[str]) -> None:
    """Run as a nursery. Arguments: control socket's number, supervisor's process id, run's id, modules to import."""
    number, parent, run, *preload = arguments
    setproctitle(f"cfgplan {run} nursery")
    die_with_parent(int(parent))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _open_output()
    for name in preload:
        with contextlib.suppress(Exception):  # the units that import it will report what is wrong
            importlib.import_module(name)
    rehearse(_rehearse_fork)
    _taken = fill_gaps()
    gc.freeze()
    Nursery(socket.socket(fileno=int(number)), run).run()


_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process when the thread that made it ends. `parent` is that thread's process.

    Only Linux can do that; on other systems a process notices by its closed connection.
    """
    if sys.platform != "linux":
        return
    tell_of_parents_death(signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def tell_of_parents_death(number: signal.Signals) -> None:
    """Let the kernel send this signal when the thread that made this process ends. Only Linux can do that."""
    if sys.platform == "linux":
        control_process(_PR_SET_PDEATHSIG, number)
