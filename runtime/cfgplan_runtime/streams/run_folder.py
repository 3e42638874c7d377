"""A run's folder: the sockets of its topics, and a lock that shows others whether the run lives.

The folders of one user's runs are in `$XDG_RUNTIME_DIR/cfgplan`, else in a folder of that user's own
below the temporary folder. Only the user can enter it.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import secrets
import shutil
import socket
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import quote

from cfgplan.errors import did_you_mean
from cfgplan.user_folders import user_folder
from cfgplan_runtime.errors import RuntimeFaultError

_LONGEST_NAME = 24
_LONGEST_BASE = (107 if sys.platform == "linux" else 103) - len("/01234567/.socket") - _LONGEST_NAME
"""In bytes: the system limits the path of a socket."""
_BACKLOG = 64


class RunFolder:
    """The folder of a run. The run counts as alive until `close`."""

    def __init__(self, base: Path | None = None) -> None:
        self.base = base_folder() if base is None else base
        self.id = secrets.token_hex(4)
        self.path = self.base / self.id
        try:
            with _alone(self.base):  # else another process might remove it before it is locked
                remove_dead_runs(self.base)
                self.path.mkdir(mode=0o700)
                self._lock = os.open(self.path / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
                fcntl.flock(self._lock, fcntl.LOCK_EX)
        except OSError as error:
            with suppress(OSError):  # `rmtree` would need descriptors
                (self.path / "lock").unlink(missing_ok=True)
                self.path.rmdir()
            raise RuntimeFaultError(f"{self.path}: can't hold the run's sockets: {error.strerror}") from None

    def tell_clock(self, offset_ns: int) -> None:
        """Publish the offset of the run's clock, on which elements have their times, from the monotonic clock.

        On a full disk the earlier value stays.
        """
        told = self.path / "clock.new"
        with suppress(OSError):
            told.write_text(str(offset_ns))
            told.rename(_clock(self.path))

    def listen(self, topic: str) -> socket.socket:
        """A listening socket at the topic's address. Raises OSError, and leaves none."""
        path = address(self.path, topic)
        path.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.bind(str(path))
            listener.listen(_BACKLOG)
            path.with_suffix(".topic").write_text(topic, encoding="utf-8")
        except OSError:
            listener.close()
            self.forget(topic)
            raise
        return listener

    def show(self, topic: str, run: Path) -> None:
        """Let a topic of another run on this computer be found here too."""
        here, there = address(self.path, topic), address(run, topic)
        self.forget(topic)
        here.symlink_to(there)
        here.with_suffix(".topic").write_text(topic, encoding="utf-8")

    def forget(self, topic: str) -> None:
        """Remove the topic's address."""
        for path in (address(self.path, topic), address(self.path, topic).with_suffix(".topic")):
            path.unlink(missing_ok=True)

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._lock)


def base_folder() -> Path:
    """The folder of this user's runs, created if missing.

    Raises RuntimeFaultError if it is not this user's alone, or if its name is too long for sockets.
    """
    given = user_folder("XDG_RUNTIME_DIR")
    base = given / "cfgplan" if given else Path(tempfile.gettempdir()) / f"cfgplan-{os.getuid()}"
    if len(os.fsencode(base)) > _LONGEST_BASE:
        raise RuntimeFaultError(
            f"{base}: too long a name for the run's sockets: set XDG_RUNTIME_DIR to a shorter folder"
        )
    try:
        base.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = base.lstat()
    except OSError as error:
        told = f"{base}: can't hold the run's sockets: {error.strerror}: set XDG_RUNTIME_DIR to another folder"
        raise RuntimeFaultError(told) from None
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise RuntimeFaultError(f"{base} is open to other users, or not yours: remove it, or set XDG_RUNTIME_DIR")
    return base


def live_runs(base: Path) -> Iterator[Path]:
    """The folders of the live runs."""
    for path in sorted(base.iterdir()) if base.is_dir() else ():
        if is_alive(path):
            yield path


def claim_name(run: Path, name: str) -> None:
    """Give a run a name by which it is found, besides its id. Raises RuntimeFaultError if a live run has it already."""
    with _alone(run.parent):
        for other in live_runs(run.parent):
            if other != run and is_called(other, name):
                raise RuntimeFaultError(f"a live run is called {name!r} already ({other.name}): choose another name")
        (run / "name").write_text(name, encoding="utf-8")


def name_of(run: Path) -> str | None:
    """The name of a run; None if it has none. No topic's socket has this file's name."""
    try:
        return (run / "name").read_text(encoding="utf-8")
    except OSError:
        return None


def is_called(run: Path, wanted: str) -> bool:
    """Whether a run has this id or name."""
    return wanted in (run.name, name_of(run))


def id_and_name(run: Path) -> str:
    """A run's id, with its name if it has one."""
    name = name_of(run)
    return run.name if name is None else f"{name} ({run.name})"


def is_alive(run: Path) -> bool:
    """Whether the process that made a run's folder still runs."""
    try:
        lock = os.open(run / "lock", os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(lock)
    return False


def remove_dead_runs(base: Path) -> None:
    """Remove the folders of runs whose process is gone. Call it under the lock."""
    for path in base.iterdir():
        if path.is_dir() and not is_alive(path):
            shutil.rmtree(path, ignore_errors=True)


def no_such_run(wanted: str | None, live: Sequence[Path], listed: str) -> str:
    """The message that no live run is the `wanted` one, with the name that may be meant and the live runs."""
    named = did_you_mean(wanted or "", [name_of(run) or run.name for run in live])
    return f"no run {wanted!r} is live{f' ({named})' if named else ''}; live runs: {listed}"


def topics_of(run: Path) -> list[str]:
    """The topics of a run, except those that are closed meanwhile."""
    topics = []
    for path in run.glob("*.topic"):
        with suppress(FileNotFoundError):
            topics.append(path.read_text(encoding="utf-8"))
    return sorted(topics)


def address(run: Path, topic: str) -> Path:
    """The path of a topic's socket; short enough for a socket."""
    name = quote(topic, safe="")
    if len(name) > _LONGEST_NAME:
        name = f"{name[:11]}-{hashlib.sha256(topic.encode()).hexdigest()[:12]}"
    return run / f"{name}.socket"


def clock_offset_ns(run: Path) -> int:
    """The value of the last `RunFolder.tell_clock`; without one, the offset of the time of day."""
    try:
        return int(_clock(run).read_text())
    except (OSError, ValueError):
        return time.time_ns() - time.monotonic_ns()


def _clock(run: Path) -> Path:
    """No topic's socket has this name."""
    return run / "clock"


def control_address(run: Path) -> Path:
    """The path of a run's control socket; no topic's socket has this name."""
    return run / "control"


@contextmanager
def _alone(base: Path) -> Iterator[None]:
    """Hold the lock under which folders of runs are made and removed."""
    lock = os.open(base, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)
