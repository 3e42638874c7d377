"""Talking to a run through its control socket."""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from cfgplan_runtime.errors import ControlError, NoSuchRunError
from cfgplan_runtime.operating.protocol import VERSION, Record, line, refused
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.run_folder import (
    base_folder,
    control_address,
    id_and_name,
    is_called,
    live_runs,
    no_such_run,
)

if TYPE_CHECKING:
    from cfgplan_runtime.fleet.reached import ReachedFleet

_GREETING_S = 5.0
_RUN_LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class RunningSystem:
    """A run that can be controlled: its id, its environment file, the process that supervises it, and its name."""

    run: str
    environment: str
    pid: int
    name: str | None = None


class Control(Closable):
    """A connection to a run; a context manager. `path` is that of its socket, if it is on this computer."""

    def __init__(self, run: str, end: socket.socket, path: Path | None = None) -> None:
        """Hear the greeting of the run behind `end`. Raises ControlError if it does not answer, or refuses."""
        self.path = path
        self._end = end
        self._number = 0
        self._is_subscribed = False
        self._heard: deque[Record] = deque()
        """Events that arrived while waiting for a reply."""
        try:
            self._end.settimeout(_GREETING_S)
            self._lines = self._end.makefile("rb")
            hello = self._next()
        except (OSError, msgspec.DecodeError):
            self._end.close()
            raise ControlError(f"run {run} does not answer") from None
        if "error" in hello:
            self.close()
            raise ControlError(hello["error"]["message"])
        if hello.get("cfgplan_control") != VERSION:
            self.close()
            raise ControlError(f"run {run} speaks another version of the control protocol than {VERSION}")
        self.system = RunningSystem(hello["run"], hello["environment"], hello["pid"], hello.get("name"))

    def call(self, method: str, *, timeout_s: float | None = None, **params: Any) -> Record:
        """Call a method of the run. Raises RefusedError if the run refuses, ControlError if it does not answer."""
        self._number += 1
        self._end.settimeout(timeout_s)
        try:
            self._end.sendall(line({"id": self._number, "method": method, "params": params}))
            while "event" in (reply := self._next()):
                self._heard.append(reply)
        except TimeoutError:
            raise ControlError(f"run {self.system.run} did not answer within {timeout_s:g} s") from None
        except OSError:
            raise ControlError(f"run {self.system.run} has ended") from None
        if "error" in reply:
            raise refused(reply["error"])
        given: Record = reply["result"]
        return given

    def subscribe(self) -> None:
        """Ask the run to send its events from now on; `events` yields them."""
        if not self._is_subscribed:
            self._is_subscribed = True
            self.call("subscribe")

    def events(self) -> Iterator[Record]:
        """Yield events until the run ends. `dropped` in an event counts those that were lost before it."""
        self.subscribe()
        self._end.settimeout(None)
        with suppress(OSError):
            while True:
                told = self._heard.popleft() if self._heard else self._next()
                yield {**told["event"], **({"dropped": told["dropped"]} if "dropped" in told else {})}

    def hang_up(self) -> None:
        """End all waits for the run. Thread-safe."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Disconnect."""
        with suppress(AttributeError):
            self._lines.close()
        self._end.close()

    def _next(self) -> Record:
        data = self._lines.readline()
        if not data:
            raise ConnectionResetError
        told: Record = msgspec.json.decode(data)
        return told


def connect(run: str | None = None, fleet: ReachedFleet | None = None) -> Control:
    """Connect to a run of this user on this machine, or of a fleet. `run` is its id or name, needed only if there are
    several.

    Raises NoSuchRunError, which names the live runs, and ControlError if the run does not answer.
    """
    if fleet is not None:
        return _connect_in(fleet, run)
    folders = [folder for folder in live_runs(base_folder()) if control_address(folder).exists()]
    found = [folder for folder in folders if run is None or is_called(folder, run)]
    if len(found) == 1:
        return connect_to(found[0])
    if found:
        raise NoSuchRunError(f"several runs are live: name one by --name: {_listed(found)}")
    if folders:
        raise NoSuchRunError(no_such_run(run, folders, _listed(folders)))
    raise NoSuchRunError("no run is live: start one with `cfgplan run ENV`")


def _connect_in(fleet: ReachedFleet, run: str | None) -> Control:
    """Connect to a run of a fleet. Each run that is alive is asked for its name, until one has it or all are known."""
    end_s = time.monotonic() + _GREETING_S
    while run is not None and run not in fleet.runs:
        runs = fleet.runs
        for one in runs:
            with suppress(ControlError):
                control = Control(*fleet.control(one))
                if control.system.name == run:
                    return control
                control.close()
        if runs or time.monotonic() > end_s:
            break
        time.sleep(_RUN_LOOK_S)
    return Control(*fleet.control(run))


def connect_to(folder: Path) -> Control:
    """Connect to the run in a folder. Raises ControlError."""
    path, end = control_address(folder), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        end.settimeout(_GREETING_S)
        end.connect(str(path))
    except OSError:
        end.close()
        raise ControlError(f"run {folder.name} does not answer") from None
    return Control(folder.name, end, path)


def _listed(folders: list[Path]) -> str:
    parts = []
    for folder in folders:
        try:
            with connect_to(folder) as control:
                system = control.system
                about = f"{Path(system.environment).name}, pid {system.pid}"
                parts.append(f"{system.name} ({system.run}, {about})" if system.name else f"{system.run} ({about})")
        except ControlError:
            parts.append(id_and_name(folder))
    return ", ".join(parts)
