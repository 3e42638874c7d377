"""The formulas that are measured, and streams for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.syntax import (
    Always,
    And,
    Atom,
    Eventually,
    Formula,
    Implies,
    Interval,
    Not,
    Until,
)

SECOND = 1_000_000_000
P, Q, R = Atom("p"), Atom("q"), Atom("r")
Columns = dict[str, npt.NDArray[np.bool_]]
Times = npt.NDArray[np.int64]


def within(begin_s: float, end_s: float) -> Interval:
    return Interval(round(begin_s * SECOND), round(end_s * SECOND))


@dataclass(frozen=True)
class Measured:
    """A formula `always (inner)`: `inner` is checked in each state.

    `reelay` is the same about the past, `rtamt` about a bounded future; intervals in it are counted in states by {2},
    {10} and so on, in seconds.
    """

    name: str
    inner: Formula
    reelay: str | None = None
    rtamt: str | None = None
    always_true: str = ""
    """Propositions that must hold in each state if the answer is to stay open."""

    @property
    def formula(self) -> Formula:
        return Always(self.inner)


def ticks(text: str, rate: int) -> str:
    """An encoding with its seconds counted in states."""
    for seconds in (2, 3, 5, 7, 8, 10):
        text = text.replace(f"<{seconds}>", str(seconds * rate))
    return text


MEASURED = (
    Measured(
        "always[0,10s] p",
        Always(P, within(0, 10)),
        "historically(historically[0:<10>]{p})",
        "always[0,<10>](p>=0.5)",
        "p",
    ),
    Measured(
        "p -> eventually[0,10s] q",
        Implies(P, Eventually(Q, within(0, 10))),
        "historically(once[<10>:<10>]{p} -> once[0:<10>]{q})",
        "(p>=0.5) implies eventually[0,<10>](q>=0.5)",
    ),
    Measured(
        "not p -> eventually[0,10s] p",
        Implies(Not(P), Eventually(P, within(0, 10))),
        "historically(once[<10>:<10>](not({p})) -> once[0:<10>]{p})",
        "(p<0.5) implies eventually[0,<10>](p>=0.5)",
    ),
    Measured(
        "p -> eventually[2s,5s] q",
        Implies(P, Eventually(Q, within(2, 5))),
        "historically(once[<5>:<5>]{p} -> once[0:<3>]{q})",
        "(p>=0.5) implies eventually[<2>,<5>](q>=0.5)",
    ),
    Measured(
        "p -> eventually[0,5s] (q and always[0,3s] r)",
        Implies(P, Eventually(And(Q, Always(R, within(0, 3))), within(0, 5))),
        "historically(once[<8>:<8>]{p} -> once[0:<5>](once[<3>:<3>]{q} and historically[0:<3>]{r}))",
        "(p>=0.5) implies eventually[0,<5>]((q>=0.5) and always[0,<3>](r>=0.5))",
        "r",
    ),
    Measured("p until[0,10s] q", Until(P, Q, within(0, 10)), None, "(p>=0.5) until[0,<10>] (q>=0.5)", "p"),
    Measured("eventually (q and eventually p)", Eventually(And(Q, Eventually(P)))),
)


def columns(measured: Measured, count: int, rate: int, seed: int) -> Columns:
    """Random propositions, such that the answer stays open."""
    random = np.random.default_rng(seed)
    found = {"p": random.random(count) < 0.9, "q": random.random(count) < 1 / rate, "r": random.random(count) < 0.9}
    found["q"][::rate] = True
    for name in measured.always_true:
        found[name][:] = True
    return found


def times(count: int, rate: int, seed: int, *, jitter: bool) -> Times:
    """Times of states in nanoseconds: regular, or with steps from half to one and a half of the period."""
    period = SECOND // rate
    if not jitter:
        return np.arange(count, dtype=np.int64) * period
    return np.cumsum(np.random.default_rng(seed).integers(period // 2, period + period // 2, count), dtype=np.int64)


def truths(monitor: Monitor, given: Columns) -> npt.NDArray[np.int8]:
    """Return a monitor's input: the truth of its propositions in each state."""
    return np.stack([_column(each, given) for each in monitor.program.propositions], axis=1)


def _column(proposition: Formula, given: Columns) -> npt.NDArray[np.int8]:
    match proposition:
        case Atom(name):
            return (2 * given[str(name)]).astype(np.int8)
        case Not(part):
            return (2 - _column(part, given)).astype(np.int8)
        case And(left, right):
            return np.minimum(_column(left, given), _column(right, given))
        case _:
            raise TypeError(proposition)
