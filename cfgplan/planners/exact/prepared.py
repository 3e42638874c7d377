"""What preprocessing hands to the search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.exact.wiring import forced_changes, wire


@dataclass(frozen=True)
class Prepared:
    """What preprocessing leaves: labels that may be used, a first plan, its cost, a bound, landmarks.

    A landmark is (labels, number): a plan has so many of the labels or more, a label counts as often as it is named. A
    plan that costs as little as the bound rewires and starts at least `fewest_changes` units; None if these are not
    known. With `is_complete` no other labels can be in a better plan. With `holds_for` all this holds only for plans
    that leave no more required transformations unused.
    """

    labels: list[str]
    plan: list[str] | None = None
    cost_us: int | None = None
    bound_us: int = 0
    landmarks: Callable[[], list[tuple[list[str], int]]] = list
    counts: dict[str, int] = field(default_factory=dict)
    holds_for: int | None = None
    fewest_changes: tuple[int, int] | None = None
    is_complete: bool = True

    def tell(self, standing: Standing, candidates: Candidates) -> None:
        """Bring a standing forward: raise its bound and offer the plan. `candidates` are those of the labels."""
        standing.counts |= self.counts
        if self.holds_for != standing.holds_for:
            standing.holds_for, standing.bound_us = self.holds_for, 0
        standing.raise_bound(self.bound_us)
        is_known = standing.best is not None and standing.best.key.cost_us == self.cost_us
        if self.plan is None or (is_known and standing.clock.is_over()):
            return
        chosen = candidates.first_of_each(self.plan)
        units = wire(candidates, chosen)
        if units is not None:
            standing.offer(units)
        if self._proves_all(standing, candidates, chosen):
            standing.prove_all()

    def _proves_all(self, standing: Standing, candidates: Candidates, chosen: set[int]) -> bool:
        """Whether the incumbent can't be beaten in changes, or is the only choice of units at its cost.

        An only choice must not rewire more than it has to. A choice is the only one if it has all candidates and each
        of them costs something, or has to run: one that costs nothing might be left out.
        """
        best = standing.best
        if best is None:
            return False
        if self.fewest_changes is not None and best.key == (0, standing.bound_us, *self.fewest_changes):
            return True
        return (
            self.is_complete
            and best.key[:2] == (0, standing.bound_us)
            and len(chosen) == len(candidates.all) == len(best.units)
            and all(c.cost_us or candidates.is_pinned(i) for i, c in enumerate(candidates.all))
            and best.key.rewired == forced_changes(candidates, chosen)
        )
