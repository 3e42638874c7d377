"""How large obligations of random nested formulas become: `python experiments/reasoning/growth.py --formulas 5000`.

Formulas have a given depth, with bounded, unbounded and late intervals, over random irregular streams. Formulas decided
within 100 states are not informative and are not counted.
"""

from __future__ import annotations

import argparse
import random

from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.syntax import (
    ALL_TIME,
    Always,
    And,
    Atom,
    Eventually,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Until,
)

_STATES = 400


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--formulas", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(
        "| depth | formulas that stayed open | largest obligation in nodes: median | 99 % | largest "
        "| second half of the stream against the first |"
    )
    print("|---|---|---|---|---|---|")
    for depth in (2, 3, 4, 5):
        print(_row(depth, options.formulas, random.Random(options.seed)), flush=True)


def _row(depth: int, formulas: int, source: random.Random) -> str:
    largest, ratios = [], []
    for _ in range(formulas):
        sizes = _sizes(Monitor(_formula(depth, source)), source)
        if len(sizes) > _STATES // 4:
            largest.append(max(sizes))
        if len(sizes) == _STATES:
            ratios.append(max(sizes[_STATES // 2 :]) / max(sizes[: _STATES // 2]))
    largest.sort()
    shown = (largest[len(largest) // 2], largest[99 * len(largest) // 100], largest[-1])
    growth = f"{sum(ratios) / len(ratios):.2f} on average, {max(ratios):.1f} at most"
    return f"| {depth} | {len(largest)} | {shown[0]} | {shown[1]} | {shown[2]} | {growth} |"


def _sizes(monitor: Monitor, source: random.Random) -> list[int]:
    sizes, time, share = [], 0, source.choice([0.1, 0.5, 0.9])
    for _ in range(_STATES):
        time += source.randint(1, 3)
        if monitor.step(time, [source.random() < share for _ in monitor.program.propositions]) != "open":
            break
        sizes.append(monitor.size)
    return sizes


def _formula(depth: int, source: random.Random) -> Formula:
    if depth == 0 or source.random() < 0.1:
        return Atom(source.choice("pqr"))
    kind = source.choice([Not, And, Or, Implies, Always, Always, Eventually, Eventually, Until, Until, Until])
    parts = [_formula(depth - 1, source) for _ in range(1 if kind in (Not, Always, Eventually) else 2)]
    if kind in (Always, Eventually, Until):
        return kind(*parts, _interval(source))
    return kind(*parts)


def _interval(source: random.Random) -> Interval:
    begin = source.choice([0, 0, source.randint(1, 9)])
    return source.choice([ALL_TIME, Interval(begin), Interval(begin, begin + source.randint(0, 25))])


if __name__ == "__main__":
    main()
