"""States per second of cfgplan, reelay and rtamt on the same streams: `python experiments/reasoning/speed.py`.

CPU time of one process, best of three (one for rtamt); the peers are told the truth of propositions, too, so that
nothing but the temporal part is measured. reelay (C++) gets formulas about the past, rtamt (Python) bounded ones,
which it turns to the past itself.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from cfgplan_runtime.reasoning.monitor import Monitor
from formulas import MEASURED, Columns, Measured, Times, columns, ticks, times, truths

_MOST_FOR_UNTIL = 50
"""rtamt takes minutes for an until over more states a second: its time is quadratic in the horizon."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=200_000, help="states of a stream; a twentieth of them for rtamt")
    parser.add_argument("--rate", type=int, default=30, help="states a second of the stream's time")
    options = parser.parse_args()
    print(
        f"| `always (...)` of, at {options.rate} states/s | cfgplan, regular | cfgplan, irregular "
        "| one at a time | reelay | rtamt |"
    )
    print("|---|---|---|---|---|---|")
    for measured in MEASURED:
        given = columns(measured, options.states, options.rate, 1)
        rates = [
            _cfgplan(measured, given, times(options.states, options.rate, 1, jitter=jitter)) for jitter in (False, True)
        ]
        rates.append(_cfgplan_stepwise(measured, given, times(options.states, options.rate, 1, jitter=True)))
        rates += [_reelay(measured, given, options.rate), _rtamt(measured, given, options.rate)]
        shown = (f"{rate:,.0f}" if rate else "-" for rate in rates)
        print(f"| `{measured.name}` | {' | '.join(shown)} |", flush=True)


def _best(count: int, run: Callable[[], object], tries: int = 3) -> float:
    least = float("inf")
    for _ in range(tries):
        begin = time.process_time()
        run()
        least = min(least, time.process_time() - begin)
    return count / least


def _cfgplan(measured: Measured, given: Columns, at: Times) -> float:
    values = truths(Monitor(measured.formula), given)
    return _best(len(at), lambda: _stays_open(Monitor(measured.formula).feed(at, values)))


def _cfgplan_stepwise(measured: Measured, given: Columns, at: Times) -> float:
    rows = list(zip(at.tolist(), truths(Monitor(measured.formula), given).tolist(), strict=True))

    def run() -> None:
        monitor = Monitor(measured.formula)
        for time_ns, row in rows:
            monitor.step(time_ns, row)
        _stays_open(monitor.verdict)

    return _best(len(rows), run)


def _reelay(measured: Measured, given: Columns, rate: int) -> float | None:
    if measured.reelay is None:
        return None
    import reelay

    rows = [dict(zip(given, row, strict=True)) for row in zip(*(v.tolist() for v in given.values()), strict=True)]

    def run() -> None:
        monitor = reelay.discrete_timed_monitor(ticks(measured.reelay, rate))
        for row in rows:
            monitor.update(row)

    return _best(len(rows), run)


def _rtamt(measured: Measured, given: Columns, rate: int) -> float | None:
    is_endless = rate > _MOST_FOR_UNTIL and "until" in (measured.rtamt or "")
    if measured.rtamt is None or is_endless:
        return None
    count = len(given["p"]) // 20
    rows = [
        list(zip(given, row, strict=True))
        for row in zip(*(v[:count].astype(float).tolist() for v in given.values()), strict=True)
    ]

    def run() -> None:
        monitor = rtamt_monitor(ticks(measured.rtamt, rate))
        for number, row in enumerate(rows):
            monitor.update(number, row)

    return _best(count, run, tries=1)


def rtamt_monitor(formula: str):  # type: ignore[no-untyped-def]
    """rtamt's monitor of a bounded formula over p, q and r."""
    import rtamt

    monitor = rtamt.StlDiscreteTimeSpecification()
    for name in ("p", "q", "r", "out"):
        monitor.declare_var(name, "float")
    monitor.spec = f"out = {formula}"
    monitor.parse()
    monitor.pastify()
    return monitor


def _stays_open(verdict: str) -> None:
    if verdict != "open":
        raise SystemExit(f"the verdict became {verdict}: the stream is not suited to be measured with")


if __name__ == "__main__":
    main()
