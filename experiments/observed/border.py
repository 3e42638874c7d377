"""Count how often a noisy fact changes sides while its true value stays on a bound, or near it.

python experiments/observed/border.py [--hours 20] [--noise 0.2] [--seed 0]

The filter alone is simulated, for values at 1, 5 and 30 Hz and a bound of 2.25.
"""

from __future__ import annotations

import argparse
from random import Random

from cfgplan.noise import Noise, NoisyMean
from cfgplan.qualities import MICRO

BOUND = 2.25
AWAY = (0.0, 0.25, 0.5)
"""Distances of the true value from the bound, in standard deviations of a single value."""
HOUR_S = 3600


def changes(random: Random, truth: float, share: float, rate_hz: int, hours: float) -> int:
    """Return how often the planned value changes sides of the bound."""
    noise, bound = Noise(round(share * MICRO), is_share=True), round(BOUND * MICRO)
    mean, planned, found = NoisyMean(round(truth * MICRO), 0.0), round(truth * MICRO), 0
    for step in range(1, round(hours * HOUR_S * rate_hz)):
        mean = mean.after(round(random.gauss(truth, share * truth) * MICRO), step / rate_hz, noise)
        was, planned = planned, mean.planned_value(noise, planned, (bound,))
        found += (was >= bound) != (planned >= bound)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=20)
    parser.add_argument("--noise", type=float, default=0.2, help="the standard deviation as a share of the value")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random = Random(options.seed)
    for rate_hz in (1, 5, 30):
        for away in AWAY:
            truth = BOUND * (1 + away * options.noise)
            number = changes(random, truth, options.noise, rate_hz, options.hours)
            print(f"{rate_hz} Hz, {away:g} standard deviations away: {number / options.hours:.1f} changes an hour")


if __name__ == "__main__":
    main()
