"""How long after the deciding state a verdict comes: `python experiments/reasoning/delay.py`.

The deciding state is the first after which no continuation of the stream changes the value. A monitor of the past,
or one that turns a formula to the past, answers about a state when the horizon of the formula is over; progression
answers when the answer is certain.
"""

from __future__ import annotations

from dataclasses import dataclass

from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.reader import Vocabulary
from formulas import SECOND, ticks
from speed import rtamt_monitor

RATE = 10


@dataclass(frozen=True)
class Case:
    """A stream in which p, q and r hold in spans of seconds; the answer is certain at `decided_s`."""

    formula: str
    p: tuple[float, float]
    q: tuple[float, float]
    answer: bool
    decided_s: float
    reelay: str
    rtamt: str
    horizon_s: float


NEVER = (99.0, 99.0)
CASES = (
    Case("always[0,10s] p", (0, 3), NEVER, False, 3, "historically[0:<10>]{p}", "always[0,<10>](p>=0.5)", 10),
    Case("eventually[0,10s] q", NEVER, (3, 3), True, 3, "once[0:<10>]{q}", "eventually[0,<10>](q>=0.5)", 10),
    Case("eventually[0,10s] q", NEVER, NEVER, False, 10, "once[0:<10>]{q}", "eventually[0,<10>](q>=0.5)", 10),
    Case(
        "eventually[0,5s] (q and always[0,3s] p)",
        (0, 99),
        (2, 2),
        True,
        5,
        "once[0:<5>](once[<3>:<3>]{q} and historically[0:<3>]{p})",
        "eventually[0,<5>]((q>=0.5) and always[0,<3>](p>=0.5))",
        8,
    ),
    Case(
        "p until[0,10s] q",
        (0, 4),
        NEVER,
        False,
        4,
        "",
        "(p>=0.5) until[0,<10>] (q>=0.5)",
        10,
    ),
    Case(
        "always[0,5s] (p -> eventually[0,2s] q)",
        (0, 99),
        (0, 2),
        False,
        4,
        "historically[0:<5>](once[<2>:<2>]{p} -> once[0:<2>]{q})",
        "always[0,<5>]((p>=0.5) implies eventually[0,<2>](q>=0.5))",
        7,
    ),
)


def main() -> None:
    print("| formula | answer | certain after | cfgplan | reelay, pastified | rtamt, pastified |")
    print("|---|---|---|---|---|---|")
    for case in CASES:
        delays = [_cfgplan(case), _reelay(case), _rtamt(case)]
        shown = " | ".join("-" if delay is None else f"{delay:.1f} s later" for delay in delays)
        print(f"| `{case.formula}` | {str(case.answer).lower()} | {case.decided_s:g} s | {shown} |")


def _holds(span: tuple[float, float], tick: int) -> bool:
    first, last = (round(bound * RATE) for bound in span)
    return first <= tick < last or tick == first == last


def _cfgplan(case: Case) -> float:
    monitor = Monitor(parse(case.formula, Vocabulary({"p", "q"})))
    tick = -1
    while monitor.verdict == "open":
        tick += 1
        state = {"p": _holds(case.p, tick), "q": _holds(case.q, tick)}
        monitor.step(tick * SECOND // RATE, [state[str(each)] for each in monitor.program.propositions])
    if monitor.verdict != str(case.answer).lower():
        raise SystemExit(f"{case.formula}: {monitor.verdict}")
    return tick / RATE - case.decided_s


def _reelay(case: Case) -> float | None:
    """The value about the first state is given at its horizon."""
    if not case.reelay:
        return None
    import reelay

    monitor = reelay.discrete_timed_monitor(ticks(case.reelay, RATE), condense=False)
    horizon = round(case.horizon_s * RATE)
    told = [
        monitor.update({"p": _holds(case.p, tick), "q": _holds(case.q, tick)})["value"] for tick in range(horizon + 1)
    ]
    if told[horizon] != case.answer:
        raise SystemExit(f"{case.formula}: reelay says {told[horizon]}")
    return case.horizon_s - case.decided_s


def _rtamt(case: Case) -> float:
    monitor = rtamt_monitor(ticks(case.rtamt, RATE))
    horizon = round(case.horizon_s * RATE)
    told = 0.0
    for tick in range(horizon + 1):
        state = [("p", float(_holds(case.p, tick))), ("q", float(_holds(case.q, tick))), ("r", 0.0)]
        told = monitor.update(tick, state)
    if (told > 0) != case.answer:
        raise SystemExit(f"{case.formula}: rtamt says {told}")
    return case.horizon_s - case.decided_s


if __name__ == "__main__":
    main()
