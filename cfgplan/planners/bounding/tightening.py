"""How long to look for landmarks: as long as they close enough of the gap."""

from __future__ import annotations

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.solving.clock import Clock


def tightened(bound: Bound, enough: int, limit: int, clock: Clock, *, greedily: bool = False) -> Bound:
    """The bound with more landmarks, for plans that cost at most `limit`, until it is `enough` or that no longer pays.

    Where no plan costs as little as `limit`, its value is above that. `greedily`: less long, since `closing` is to
    follow.
    """
    rise = clock.tuning.rise
    while bound.value < enough and not clock.is_over():
        before = bound.value
        keep = bound.may_be_used(limit)
        if not keep.any():
            bound.value = limit + 1
            break
        if keep.sum() < 0.8 * len(keep):
            bound = bound.restricted(keep)
        patience = (rise.patience if greedily else rise.last_patience) * bound.core.goal**1.5
        each = rise.landmark + rise.need * len(bound.core.needs.items) + rise.link * bound.core.deep_links
        bound.improve(enough, rise.landmarks, clock.is_over)
        if bound.value < enough and not _pays(bound.value - before, enough - before, rise.landmarks * each, patience):
            break
    return bound


def _pays(closed: int, gap: int, took: float, patience: float) -> bool:
    """Whether, at the pace of a step that closed so much of a gap, all of it would be closed in time."""
    return closed * patience >= gap * took
