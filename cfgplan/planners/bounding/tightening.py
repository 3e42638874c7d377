"""How long to look for landmarks: as long as they close enough of the gap."""

from __future__ import annotations

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.solving.clock import Clock

CHUNK = 20
"""After so many landmarks the network is restricted to what may still be used."""
PATIENCE = 1.2e-6
"""Seconds for the square of the number of labels: how long the solver may take, and so how long bounds may."""
LARGE, LARGE_PATIENCE = 3000, 3e-6
"""From so many labels on landmarks have so many members that other bounds (`closing`) are better after so many seconds
for the number of labels to the power of 1.5.
"""
STEP_S, CHARGE_S, ROUNDS = 2e-8, 6e-6, 20
"""About what a fact that is needed takes for a round of a landmark, and a member of a landmark in the linear program.

Time is estimated, not measured, so that a plan can be repeated.
"""


def begun(bound: Bound, enough: int, limit: int, clock: Clock) -> Bound:
    """The bound with its first landmarks, for plans that cost at most `limit`."""
    keep = bound.may_be_used(limit)
    if keep.any() and keep.sum() < 0.8 * len(keep):
        bound = bound.restricted(keep)
    bound.improve(enough, CHUNK, clock.is_over)
    return bound


def tightened(bound: Bound, enough: int, limit: int, clock: Clock, *, closing_follows: bool = False) -> Bound:
    """The bound with more landmarks, for plans that cost at most `limit`, until it is `enough` or that no longer pays.

    Where no plan costs as little as `limit`, its value is above that. For large networks it is left to `closing`,
    if that follows, to charge landmarks best.
    """
    while bound.value < enough and not clock.is_over():
        before = bound.value
        keep = bound.may_be_used(limit)
        if not keep.any():
            bound.value = limit + 1
            break
        if keep.sum() < 0.8 * len(keep):
            bound = bound.restricted(keep)
        labels = bound.core.goal
        is_left = closing_follows and labels >= LARGE
        patience_s = LARGE_PATIENCE * labels**1.5 if is_left else PATIENCE * labels**2
        step_s = CHUNK * ROUNDS * STEP_S * len(bound.core.needs.items)
        bound.improve(enough, CHUNK, clock.is_over)
        if bound.value < enough and not _pays(bound.value - before, enough - before, step_s, patience_s):
            if is_left:
                break
            bound.recharge_best(clock.left_s())
            bound.improve(enough, CHUNK, clock.is_over)
            charge_s = CHARGE_S * sum(len(landmark.members) for landmark in bound.landmarks)
            if not _pays(bound.value - before, enough - before, 2 * step_s + charge_s, patience_s):
                break
    return bound


def _pays(closed: int, gap: int, took_s: float, patience_s: float) -> bool:
    """Whether, at the pace of a step that closed so much of a gap, all of it would be closed in time."""
    return closed * patience_s >= gap * took_s
