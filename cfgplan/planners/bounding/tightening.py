"""How long to look for landmarks: as long as they close enough of the gap."""

from __future__ import annotations

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.solving.clock import Clock

CHUNK = 20
"""After so many landmarks the network is restricted to what may still be used."""
PATIENCE, LAST_PATIENCE = 2e-6, 2e-5
"""Seconds for the number of labels to the power of 1.5 that landmarks may take: about as long as other bounds take
(`closing`) where those follow, and else about as long as the solver does.
"""
LANDMARK_S, NEED_S, CHARGE_S = 1.5e-4, 4e-8, 6e-6
"""About what a landmark takes, and for each fact that is needed; and a member of one in the linear program.

Time is estimated, not measured, so that a plan can be repeated.
"""


def tightened(bound: Bound, enough: int, limit: int, clock: Clock, *, greedily: bool = False) -> Bound:
    """The bound with more landmarks, for plans that cost at most `limit`, until it is `enough` or that no longer pays.

    Where no plan costs as little as `limit`, its value is above that. `greedily` leaves it to `closing`, which is to
    follow, to charge landmarks best.
    """
    while bound.value < enough and not clock.is_over():
        before = bound.value
        keep = bound.may_be_used(limit)
        if not keep.any():
            bound.value = limit + 1
            break
        if keep.sum() < 0.8 * len(keep):
            bound = bound.restricted(keep)
        patience_s = (PATIENCE if greedily else LAST_PATIENCE) * bound.core.goal**1.5
        step_s = CHUNK * (LANDMARK_S + NEED_S * len(bound.core.needs.items) + bound.core.depth_s)
        bound.improve(enough, CHUNK, clock.is_over)
        if bound.value < enough and not _pays(bound.value - before, enough - before, step_s, patience_s):
            if greedily:
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
