"""Guests of the soak: transformations with harmful code, each with its own target.

A guest may harm only itself. Each has an outcome that the run has to report.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cfgplan_runtime.supervision.events import Event, UnitDied, UnitFailed, UnitHung, UnitPrinted

CODE = '''
import os, signal, socket, subprocess, sys, threading, time

SOME = 20
"""Elements that a guest takes before it misbehaves."""


class Guest:
    number = 0

    def __call__(self, x):
        self.number += 1
        if self.number == SOME:
            self.misbehave()
        return x


class Prints(Guest):
    def __call__(self, x):
        for _ in range(500):
            print("x" * 200)
        return x


class Scribbles(Guest):
    """Writes into descriptors of others, as a double close in a C library does."""

    def misbehave(self):
        for number in range(3, 64):
            try:
                os.write(number, b"garbage " * 100)
            except OSError:
                pass


class Closes(Guest):
    def misbehave(self):
        os.closerange(3, 1024)


class Forks(Guest):
    """Forks carelessly: the copy continues in the runtime's loop."""

    def misbehave(self):
        os.fork()


class Leaves(Guest):
    """Starts a daemon, notes its id, and dies."""

    def misbehave(self):
        between = os.fork()
        if between == 0:
            os.setsid()
            if os.fork() == 0:
                with open(os.environ["CFGPLAN_SOAK_DAEMONS"], "a") as file:
                    file.write(f"{os.getpid()}\\n")
                time.sleep(3600)
            os._exit(0)
        os.waitpid(between, 0)
        time.sleep(0.2)
        os._exit(3)


class Hangs(Guest):
    def misbehave(self):
        while True:
            try:
                time.sleep(3600)
            except BaseException:
                pass


class Exits(Guest):
    def misbehave(self):
        os._exit(3)


class Raises(Guest):
    def __call__(self, x):
        raise RuntimeError("no luck")


class Grows(Guest):
    """Keeps 20 MB of each element."""

    def __call__(self, x):
        self.kept = [*getattr(self, "kept", []), bytearray(20_000_000)]
        return x


class Large(Guest):
    """Gives 5 MB for each element."""

    def __call__(self, x):
        return bytes(5_000_000)


class Silent(Guest):
    def __call__(self, x):
        return None
'''


@dataclass(frozen=True)
class Guest:
    """A guest's code and options, and the event that shows its outcome; without `shows` it just runs for a while."""

    code: str
    shows: Callable[[Event], bool] | None = None
    run: str = "hang: 3, stop: 1s"
    target: str = ""

    @property
    def label(self) -> str:
        return f"guest_{self.code.lower()}"

    @property
    def text(self) -> str:
        """Return the YAML that is added to the run's environment."""
        name, tag = self.label, f"G{self.code}"
        ports = f"inputs: {{x: N}}, outputs: {{y: {tag}}}"
        return (
            f"transformations:\n  - {{label: {name}, source: 'hostile.py:{self.code}', labor: 0, upkeep: 0.001, "
            f"run: {{{self.run}}}, {ports}}}\n"
            f"targets:\n  - {{label: {name}, topic: /{name}, tag: {tag}{self.target}}}\n"
        )

    def is_shown_by(self, event: Event) -> bool:
        """Return whether an event of one of its units is the outcome."""
        return self.shows is not None and self.shows(event)


def _told(kind: type[Event], text: str = "") -> Callable[[Event], bool]:
    return lambda event: isinstance(event, kind) and text in repr(event)


GUESTS = (
    Guest("Prints", _told(UnitPrinted, "more lines are left out")),
    Guest("Scribbles", _told(UnitDied)),
    Guest("Closes", _told(UnitDied)),
    Guest("Forks"),
    Guest("Leaves", _told(UnitDied, "exit status 3")),
    Guest("Hangs", _told(UnitHung)),
    Guest("Exits", _told(UnitDied, "exit status 3")),
    Guest("Raises", _told(UnitFailed, "no luck")),
    Guest("Grows", _told(UnitFailed, "MemoryError"), run="memory: 400"),
    Guest("Large", run="hang: 20"),
    Guest("Silent", target=", silent: 3s"),
)
