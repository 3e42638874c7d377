"""Metric temporal logic as a tree (Koymans 1990, with future operators; paper, section III).

A formula is evaluated at a state, over this state and the later ones. Times of states are whole nanoseconds, and rise.
An atom holds any hashable value for a condition on one state; the temporal part never reads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from cfgplan.errors import InvalidValueError

_UNITS = ((60_000_000_000, "min"), (1_000_000_000, "s"), (1_000_000, "ms"), (1_000, "us"), (1, "ns"))


@dataclass(frozen=True, slots=True)
class Interval:
    """The times of later states, relative to a state: from `begin_ns` to `end_ns` nanoseconds, both included.

    Without an end it is unbounded. Raises InvalidValueError for an empty one.
    """

    begin_ns: int = 0
    end_ns: int | None = None

    def __post_init__(self) -> None:
        if self.begin_ns < 0 or (self.end_ns is not None and self.end_ns < self.begin_ns):
            raise InvalidValueError(f"{self.begin_ns} ns to {self.end_ns} ns is not an interval")

    def __str__(self) -> str:
        if self == ALL_TIME:
            return ""
        end = "inf)" if self.end_ns is None else f"{_span_text(self.end_ns)}]"
        return f"[{_span_text(self.begin_ns)}, {end}"


ALL_TIME = Interval()


@dataclass(frozen=True, slots=True)
class Constant:
    """True or false."""

    value: bool

    def __str__(self) -> str:
        return "true" if self.value else "false"


@dataclass(frozen=True, slots=True)
class Atom:
    """A condition on one state."""

    condition: object

    def __str__(self) -> str:
        return str(self.condition)


@dataclass(frozen=True, slots=True)
class Not:
    part: Formula

    def __str__(self) -> str:
        return f"not {_inside(self.part)}"


@dataclass(frozen=True)
class Connected:
    """Two formulas with a word between them."""

    word: ClassVar[str]
    left: Formula
    right: Formula

    def __str__(self) -> str:
        return f"{_inside(self.left)} {self.word} {_inside(self.right)}"


class And(Connected):
    word = "and"


class Or(Connected):
    word = "or"


class Implies(Connected):
    word = "->"


@dataclass(frozen=True)
class Temporal:
    """A formula about the states of an interval."""

    word: ClassVar[str]
    part: Formula
    interval: Interval = ALL_TIME

    def __str__(self) -> str:
        return f"{self.word}{self.interval} {_inside(self.part)}"


class Always(Temporal):
    """In every state of the interval."""

    word = "always"


class Eventually(Temporal):
    """In some state of the interval."""

    word = "eventually"


@dataclass(frozen=True, slots=True)
class Until:
    """`right` in some state of the interval, and `left` in every state before that state, including the present one."""

    left: Formula
    right: Formula
    interval: Interval = ALL_TIME

    def __str__(self) -> str:
        return f"{_inside(self.left)} until{self.interval} {_inside(self.right)}"


Formula: TypeAlias = Constant | Atom | Not | And | Or | Implies | Always | Eventually | Until


def _inside(part: Formula) -> str:
    return f"({part})" if isinstance(part, (Connected, Until)) else str(part)


def _span_text(span_ns: int) -> str:
    size, unit = next(((size, unit) for size, unit in _UNITS if span_ns % size == 0 and span_ns), (1, "s"))
    return f"{span_ns // size}{unit}"
