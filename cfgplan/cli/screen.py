"""The output of the command line: results on stdout, progress and messages on stderr."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property
from math import isfinite
from threading import Event, Thread
from time import perf_counter
from typing import TYPE_CHECKING, Any, TextIO

from cfgplan.cli.styled import Text
from cfgplan.errors import FULL_DISK, Fault
from cfgplan.summary import counted as counted

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from cfgplan.planning import Progress

OUTPUT_VERSION = 1
_WIDTH_OF_A_FILE = 1000
_SHOWN_AFTER_S = 0.3
_DECIDED = "pairs decided by "
WORK_TOLD_S = 5.0
"""Seconds between two lines about work in progress, without a terminal."""


_ESCAPE = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)|.)")
"""A terminal's control sequence."""
_AT_LINE_END = re.compile(r"(?<! )(?: |\x1b\[[\d;]*m)+$", re.MULTILINE)
"""Spaces and colours at the end of a line. Other spaces are looked at once, not once for each of them."""


def printable(text: str) -> str:
    """The text without control sequences and other characters that a terminal would obey."""
    return "".join(c if c.isprintable() else " " for c in _ESCAPE.sub("", text).expandtabs())


class ShownWork:
    """A piece of work in progress: its name, its duration, and its results so far."""

    def __init__(self, name: str) -> None:
        self.is_told = False
        """Whether something else tells how it goes on."""
        self.knows: Callable[[], str] = str
        """What is known by now, in a few words."""
        self.best = ""
        """The best cost, the bound and the gap, in words."""
        self._name = name
        self._start = perf_counter()

    @property
    def seconds(self) -> float:
        """Its time so far."""
        return perf_counter() - self._start

    def report(self, progress: Progress) -> None:
        """Take in a planner's progress."""
        bound = f"bound {progress.bound_us / 1e6:#.4g}"
        if progress.cost_us is None:
            self.best = bound
        else:
            gap = 1 - progress.bound_us / progress.cost_us if progress.cost_us else 0.0
            self.best = f"best {progress.cost_us / 1e6:#.4g}  {bound}  gap {100 * gap:.2g} %"

    def __str__(self) -> str:
        said = (f"{self._name} {self.seconds:.0f} s", self.best, self.knows())
        return "  ".join(part for part in said if part)

    def __rich__(self) -> str:
        return str(self)


def decided_by(counts: Mapping[str, int]) -> str:
    """Return how many pairs of tags each reasoner decided, by a plan's counts; empty if none was asked."""
    if not counts.get("pairs asked"):
        return ""
    return ", ".join(f"{count} by {who}" for figure, count in counts.items() if (who := figure.partition(_DECIDED)[2]))


class Screen:
    """Output for a terminal or, as JSON, for a program. Only terminals get colours."""

    def __init__(self, *, json: bool, command: Sequence[str] = ()) -> None:
        self.json = json
        self.command = command
        """The words of the command line, in which faults are shown that no line of a file has."""
        self.seconds: dict[str, float] = {}
        self._is_full = False

    @contextmanager
    def phase(self, name: str) -> Iterator[ShownWork]:
        """Time a part of the work for `times`, and show it with its progress while it lasts."""
        work, over = ShownWork(name), Event()
        shown = Thread(target=self._show_work, args=(work, over), name="cfgplan-work", daemon=True)
        shown.start()
        try:
            yield work
        finally:
            over.set()
            shown.join()
            self.seconds[name] = self.seconds.get(name, 0.0) + work.seconds

    def _show_work(self, work: ShownWork, over: Event) -> None:
        """Show a changing line on a terminal, a line every few seconds elsewhere; short work is not shown."""
        if not sys.stderr.isatty():
            while not over.wait(WORK_TOLD_S):
                if not work.is_told:
                    self.note(str(work))
        elif not over.wait(_SHOWN_AFTER_S) and not work.is_told:
            with self._err.status(work):
                over.wait()

    def show(self, result: RenderableType) -> None:
        """Print a result for people, without spaces at line ends.

        A terminal wraps long lines, those of tables too, so that no name is cut.
        """
        if isinstance(result, Text) and _takes_plain_text(sys.stdout):
            shown = f"{result.plain}\n"
        else:
            from rich.console import Group
            from rich.table import Table

            is_whole = not sys.stdout.isatty() or isinstance(result, (Table, Group))
            out = self._console(_WIDTH_OF_A_FILE if is_whole else None)
            with out.capture() as captured:
                out.print(result, soft_wrap=True)
            shown = captured.get()
        self.write(_AT_LINE_END.sub(lambda end: end[0].replace(" ", ""), shown))
        self.flush()

    def show_json(self, document: object) -> None:
        """Print a result for machines: a mapping or a dataclass, as `_plain` says it."""
        self.write(f"{_json(document, indent=2, ensure_ascii=False)}\n")

    def write_json(self, document: object) -> None:
        """Print one of several results for machines, on a line of its own."""
        self.write(f"{json_line(document)}\n")

    def write(self, text: str) -> None:
        """Print text as it is."""
        sys.stdout.write(text)

    def flush(self) -> None:
        """Pass written text to the reader at once."""
        sys.stdout.flush()

    def tell(self, line: str) -> None:
        """Print a line at once. If the disk is full, warn once and go on without the line."""
        self._tell(lambda: self.write(f"{line}\n"))

    def show_at_once(self, result: RenderableType) -> None:
        """Print a result for people as `tell` prints a line."""
        self._tell(lambda: self.show(result))

    def _tell(self, print_it: Callable[[], None]) -> None:
        try:
            print_it()
            self.flush()
        except OSError as error:
            if error.errno not in FULL_DISK:
                raise
            if not self._is_full:
                self._is_full = True
                self.warn(f"standard output can't be written any more: {error.strerror}")

    def write_bytes(self, data: bytes) -> None:
        """Write a file's bytes to stdout as they are."""
        sys.stdout.buffer.write(data)

    def note(self, text: str, style: str = "dim") -> None:
        """Print a message about the work on stderr."""
        self._say(Text(text, style=style))

    def times(self) -> None:
        """Say how long each phase took."""
        parts = [f"{name} {took:.3f} s" for name, took in self.seconds.items()]
        self.note(f"Time: {', '.join(parts)}.")

    def warn(self, text: str) -> None:
        self.note(f"warning: {text}", style="yellow")

    def faults(self, faults: Iterable[Fault]) -> None:
        """Show the faults of the input: place, message, the line with a caret, mend."""
        faults = list(faults)
        if self.json:
            self.write_json({"errors": faults})
            return
        for fault in faults:
            self._say(self._told(fault, "error: ", "bold red"))

    def warn_of(self, fault: Fault) -> None:
        """Show a fault of the input that does not stop the work."""
        self._say(self._told(fault, "warning: ", "yellow"))

    def _say(self, text: Text) -> None:
        """Print text on stderr."""
        if _takes_plain_text(sys.stderr):
            sys.stderr.write(f"{text.plain}\n")
            sys.stderr.flush()
        else:
            self._err.print(text, soft_wrap=True)

    def _told(self, fault: Fault, kind: str, style: str) -> Text:
        """A fault with its place, the line that it is about, and its mend."""
        text = Text(kind, style=style)
        text.append(f"{fault.place}: " if fault.place else "", style="bold")
        text.append(f"{fault.key}: " if fault.key else "", style="cyan")
        text.append(fault.message, style="not bold default")
        append_excerpt(text, fault, style, self.command)
        if fault.mend:
            text.append(f"\n       {fault.mend}", style="green")
        return text

    def internal_error(self, error: Exception) -> None:
        """Report a bug of this package: the input is not to blame."""
        self.faults([Fault(f"internal error: {type(error).__name__}: {error}", mend=blamed(error))])

    def _console(self, width: int | None) -> Console:
        """A console for results, of the terminal's width if none is given."""
        from rich.console import Console

        return Console(highlight=False, markup=False, emoji=False, width=width)

    @cached_property
    def _err(self) -> Console:
        from rich.console import Console

        return Console(stderr=True, highlight=False, markup=False, emoji=False)


def _takes_plain_text(stream: TextIO) -> bool:
    """Whether rich would print no colours there either."""
    return not (stream.isatty() or "FORCE_COLOR" in os.environ or "TTY_COMPATIBLE" in os.environ)


def append_excerpt(text: Text, fault: Fault, style: str, command: Sequence[str] = ()) -> None:
    """Append the line that a fault is about, with carets below it, if it is about one."""
    from cfgplan.excerpts import drawn, excerpt

    if (found := excerpt(fault, command)) is not None:
        line, space, carets = drawn(found)
        text.append(f"\n{line}\n{space}", style="not bold default")
        text.append(carets, style=style)


def blamed(error: Exception) -> str:
    """Return who is responsible for an internal error, and how the user can report it."""
    from cfgplan.planning import PlannerFaultError

    planner = error.plan.planner if isinstance(error, PlannerFaultError) else ""
    if ":" in planner:
        return f"this is a bug in the planner {planner}, not in cfgplan"
    return "this is a bug in cfgplan: CFGPLAN_TRACEBACK=1 shows where; please report it"


def json_line(document: object) -> str:
    """Return a document for machines, as `_plain` says it, on one line for every reader that splits text into lines."""
    return _json(document)


def _json(document: object, **style: Any) -> str:
    return json.dumps({"format_version": OUTPUT_VERSION, **_plain(document)}, allow_nan=False, **style)


def _plain(value: object) -> Any:
    """A mapping or a dataclass as JSON values. A plan becomes its status, cost and bound; a fraction becomes text, and
    NaN and infinite numbers, which JSON lacks, become null.
    """
    from fractions import Fraction

    from cfgplan.planning import Plan

    match value:
        case Enum():
            return value.value
        case float():
            return value if isfinite(value) else None
        case Fraction():
            return value.numerator if value.denominator == 1 else str(value)
        case Plan():
            return {"status": value.status.value, "cost_us": value.cost_us, "bound_us": value.bound_us}
        case Mapping():
            return {name: _plain(member) for name, member in value.items()}
        case set() | frozenset():
            return sorted(map(_plain, value))
        case tuple() | list():
            return [_plain(member) for member in value]
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value
