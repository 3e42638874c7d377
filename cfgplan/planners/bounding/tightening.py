"""How long to look for landmarks: as long as they close enough of the gap."""

from __future__ import annotations

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.solving.clock import Clock


def tightened(bound: Bound, enough: int, limit: int, clock: Clock, *, greedily: bool = False) -> Bound:
    """Add landmarks to a bound for plans within `limit`, until it is `enough` or more of them no longer pay.

    Where no plan is within `limit`, the value ends above it. With `greedily` it stops sooner, since `closing` follows.
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
    """Whether the whole gap would be closed within `patience` at the pace of the last step."""
    return closed * patience >= gap * took
