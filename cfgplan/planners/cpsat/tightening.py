"""How long to look for landmarks: as long as they close enough of the gap."""

from __future__ import annotations

from cfgplan.planners.cpsat.bounds import Bound
from cfgplan.planners.cpsat.clock import Clock

CHUNK = 20
"""After so many landmarks the network is restricted to what may still be used."""
MANY = 500
"""With more labels than this, less gain is enough: the solver would take longer."""
LEAST_GAIN = 0.05
"""Landmarks are looked for as long as a chunk closes this share of the gap."""


def tightened(bound: Bound, enough: int, limit: int, clock: Clock) -> Bound:
    """The bound with more landmarks, for plans that cost at most `limit`, until it is `enough` or that no longer pays.

    Where no plan costs as little as `limit`, its value is above that.
    """
    while bound.value < enough and not clock.is_over():
        before = bound.value
        keep = bound.may_be_used(limit)
        if not keep.any():
            bound.value = limit + 1
            break
        if keep.sum() < 0.8 * len(keep):
            bound = bound.restricted(keep)
        least_gain = LEAST_GAIN * (enough - before) * min(1.0, MANY / len(keep))
        bound.improve(enough, CHUNK, clock.is_over)
        if bound.value - before < least_gain:
            bound.recharge_best(clock.left_s())
            bound.improve(enough, CHUNK, clock.is_over)
            if bound.value - before < least_gain:
                break
    return bound
