"""Follow noisy facts whose sensors also give wrong values, with and without the rule that outliers do not count.

python experiments/observed/outliers.py [--repeat 10] [--seed 0]

The filter alone is simulated. SUAVE's visibility swings from 1.25 to 3.75 m in 80 s, with 20 % noise and the bounds
1.25, 2.25 and 3.25 m; the light of NAO's field has a night of a minute, with 5 % noise and the bound 0.78. Both filters
see the same values.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import cos, pi
from random import Random
from statistics import fmean, median
from types import MappingProxyType
from typing import Final

from cfgplan.noise import Noise, NoisyMean
from cfgplan.qualities import MICRO

CODE = 65_535.0
"""The value of a 16-bit sensor for "nothing seen"."""
EXPLAINS_ALL: Final = Noise(10**15)
"""With so much noise, no value is an outlier."""


@dataclass(frozen=True)
class Family:
    """A true value as a function of time, with the relative noise of its sensor, its rate, and the compared bounds."""

    truth: Callable[[float], float]
    noise: float
    rate_hz: int
    bounds: tuple[float, ...]
    seconds: int = 480

    def side(self, value: float) -> int:
        """Return how many bounds a value reaches."""
        return sum(value >= bound for bound in self.bounds)


@dataclass(frozen=True)
class Fault:
    """A wrong value, given `length` times in a row with a total `share` of all values, or for 3 s in every 30 s."""

    value: float
    share: float = 0.0
    length: int = 1

    def begins(self, random: Random, at_s: float) -> bool:
        """Return whether wrong values begin or continue now."""
        return random.random() < self.share / self.length if self.share else 15 < at_s % 30 < 18


def visibility(at_s: float) -> float:
    return 2.5 + 1.25 * cos(2 * pi * at_s / 80)


def light(at_s: float) -> float:
    return min(1.0, max(0.05, 0.8 + 0.75 * cos(2 * pi * at_s / 120)))


SUAVE_BOUNDS: Final = (1.25 - 1e-6, 2.25, 3.25)
FAMILIES: Final[Mapping[str, Family]] = MappingProxyType(
    {
        **{f"visibility, {rate} Hz": Family(visibility, 0.2, rate, SUAVE_BOUNDS) for rate in (1, 5, 30)},
        **{f"light, {rate} Hz": Family(light, 0.05, rate, (0.78,)) for rate in (1, 5)},
    }
)
FAULTS: Final[Mapping[str, Fault | None]] = MappingProxyType(
    {
        "none": None,
        "1 % of 65535": Fault(CODE, 0.01),
        "2 % of 65535, in pairs": Fault(CODE, 0.02, 2),
        "1 % of 0": Fault(0.0, 0.01),
        "5 % of 0": Fault(0.0, 0.05),
        "5 % of 10": Fault(10.0, 0.05),
        "65535 for 3 s in 30 s": Fault(CODE),
        "0 for 3 s in 30 s": Fault(0.0),
    }
)


def values(family: Family, fault: Fault | None, random: Random) -> Iterator[tuple[float, float]]:
    """Yield each time with its value."""
    wrong = 0
    for step in range(1, family.seconds * family.rate_hz + 1):
        at_s = step / family.rate_hz
        value = random.gauss(1, family.noise) * family.truth(at_s)
        if fault is not None and wrong == 0 and fault.begins(random, at_s):
            wrong = fault.length
        if fault is not None and wrong > 0:
            value, wrong = fault.value, wrong - 1
        yield at_s, value


def followed(
    family: Family, fault: Fault | None, random: Random, *, leaves_out: bool
) -> tuple[int, list[float], float]:
    """Return the number of switches, the delay of each crossing that was followed, and the share of time on a wrong
    side.
    """
    noise = Noise(round(family.noise * MICRO), is_share=True)
    bounds = [round(bound * MICRO) for bound in family.bounds]
    told = round(family.truth(0) * MICRO)
    mean = NoisyMean(told, 0.0)
    side = true = family.side(family.truth(0))
    switches, wrong, delays, crossed_s = 0, 0, list[float](), None
    for at_s, value in values(family, fault, random):
        mean = mean.after(round(value * MICRO), at_s, noise if leaves_out else EXPLAINS_ALL)
        told = mean.planned_value(noise, told, bounds)
        before, side = side, sum(told >= bound for bound in bounds)
        switches += side != before
        if family.side(family.truth(at_s)) != true:
            true, crossed_s = family.side(family.truth(at_s)), at_s
        if crossed_s is not None and side == true:
            delays.append(at_s - crossed_s)
            crossed_s = None
        wrong += side != true
    return switches, delays, wrong / (family.seconds * family.rate_hz)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name, family in FAMILIES.items():
        sides = [family.side(family.truth(step / 100)) for step in range(family.seconds * 100)]
        crossings = sum(before != after for before, after in pairwise(sides))
        for kind, fault in FAULTS.items():
            for leaves_out in (False, True):
                seeds = range(options.seed, options.seed + options.repeat)
                rows = [followed(family, fault, Random(seed), leaves_out=leaves_out) for seed in seeds]
                delays = [delay for row in rows for delay in row[1]]
                print(
                    f"{name}; wrong values: {kind}; {'without' if leaves_out else 'with'} outliers: "
                    f"{fmean(row[0] for row in rows):.1f} switches for {crossings} crossings, "
                    f"{median(delays):.1f} s late, {fmean(row[2] for row in rows):.1%} of the time on a wrong side",
                    flush=True,
                )


if __name__ == "__main__":
    main()
