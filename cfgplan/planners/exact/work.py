"""The working state of one plan: incumbent, proven bounds, the session's memory, and the labels that bounds leave."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.closing.gap import Closing
from cfgplan.planners.closing.separation import Separator
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.configuration import wire
from cfgplan.planners.exact.memory import Memory
from cfgplan.planners.exact.rest import Remainder
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.network import Network, Weighing
from cfgplan.planners.solving.clock import Clock

if TYPE_CHECKING:
    from cfgplan.planners.exact.search import LandmarkFinder, Landmarks, Search


@dataclass(frozen=True)
class Left:
    """The remaining labels of a network, which a better plan can contain, and a plan if one is known.

    No plan weighs less than `value`. With `is_complete` no other labels can be in a better plan. With `holds_for` all
    this holds only for plans that leave no more required transformations unused.
    """

    network: Network
    weighing: Weighing
    labels: Ints
    value: int
    plan: Ints | None = None
    bound: Bound | None = None
    is_complete: bool = True
    holds_for: int | None = None

    @classmethod
    def by(cls, part: Remainder, network: Network, weighing: Weighing, plan: Ints | None, *, is_over: bool) -> Left:
        """The labels that a bound leaves; only the plan's if the time `is_over`."""
        value, labels = weighing.least(part.value), part.labels
        if plan is not None and is_over and value < weighing.of_plan(plan):
            labels = plan
        return cls(network, weighing, labels, value, plan, part.bound)

    @property
    def names(self) -> list[str]:
        return [self.network.labels[i] for i in self.labels.tolist()]

    def landmarks(self) -> list[tuple[list[str], int]]:
        """Short landmarks for plans that have no other labels, as (labels, number).

        A plan has so many of the labels or more, a label counts as often as it is named.
        """
        if self.bound is None:
            return []
        part = self.bound.restricted(np.isin(self.bound.core.labels, self.labels))
        labels, names = part.core.labels, self.network.labels
        return [([names[i] for i in labels[one.counted].tolist()], one.least) for one in part.short()]


class Work:
    """The state of one plan in progress. Each stage starts from the state that the previous stage left."""

    left: Left
    candidates: Candidates
    """The units of the labels that are left."""

    def __init__(self, standing: Standing, memory: Memory) -> None:
        self.standing, self.memory, self.structure = standing, memory, memory.structure
        self.problem, self.clock = standing.problem, standing.clock
        self.closing: Closing | None = None

    def offer(self, plan: Collection[int]) -> None:
        """Offer a plan of labels, by their numbers. Raises OutOfTimeError."""
        labels = [self.structure.network.labels[i] for i in sorted(plan)]
        candidates = self.structure.candidates(self.problem, labels, self.clock)
        units = wire(candidates, candidates.first_of_each(labels))
        if units is not None:
            self.standing.offer(candidates, units)

    def take(self, left: Left) -> None:
        """Continue with the remaining labels: raise the proven bound and offer the plan.

        Raises OutOfTimeError if no plan can be offered.
        """
        standing, weighing = self.standing, left.weighing
        standing.counts["left by bounds"] = len(left.labels)
        if left.bound is not None:
            standing.counts["landmarks"] = len(left.bound.landmarks)
        if left.holds_for != standing.holds_for:
            standing.holds_for, standing.bound_us = left.holds_for, 0
        standing.raise_bound(weighing.cost_us(left.value))
        clock = self.clock if left.plan is None else None  # a plan that is known is offered whatever the time
        self.left, self.candidates = left, self.structure.candidates(self.problem, left.names, clock)
        if left.plan is None:
            return
        cost_us = weighing.cost_us(weighing.of_plan(left.plan))
        if standing.best is not None and standing.best.key.cost_us == cost_us and self.clock.is_over():
            return
        chosen = self.candidates.first_of_each(left.network.labels[i] for i in left.plan.tolist())
        units = wire(self.candidates, chosen)
        if units is not None:
            standing.offer(self.candidates, units)
        if self._proves_all(chosen):
            standing.prove_all()

    def _proves_all(self, chosen: set[int]) -> bool:
        """Whether the incumbent can't be beaten in changes, or is the only choice of units at its cost.

        An only choice must not rewire more than it has to. A choice is the only one if it has all candidates and each
        of them costs something, or has to run: one that costs nothing might be left out.
        """
        standing, candidates, best = self.standing, self.candidates, self.standing.best
        if best is None:
            return False
        fewest_changes = self.left.weighing.changes(self.left.value)
        if fewest_changes is not None and best.key == (0, (), standing.bound_us, *fewest_changes):
            return True
        return (
            self.left.is_complete
            and best.key[:3] == (0, (), standing.bound_us)
            and len(chosen) == len(candidates.all) == len(best.units)
            and all(c.cost_us or candidates.is_pinned(i) for i, c in enumerate(candidates.all))
            and best.key.rewired == _forced_changes(candidates, chosen)
        )

    def search(self, landmarks: Landmarks = (), missed: LandmarkFinder = lambda *_: ()) -> Search:
        """A search among the candidates in the constraint model, which is built here; raises OutOfTimeError."""
        from cfgplan.planners.exact.search import Search  # the solver takes long to import

        self.candidates.clock = self.clock
        return Search(self.candidates, self.standing, landmarks=landmarks, missed=missed)

    def missed(self, labels: Collection[str], clock: Clock) -> list[tuple[list[str], int]]:
        """Landmarks that these labels do not hit. Empty if the labels are grounded and meet every target."""
        network = self.structure.network
        uses = np.zeros(len(network.labels))
        uses[[network.number[label] for label in labels]] = 1.0
        found = self._separator.missed(uses, np.random.default_rng(len(labels)), is_over=clock.is_over)
        return [([network.labels[i] for i in one.counted.tolist()], one.least) for one in found]

    @cached_property
    def _separator(self) -> Separator:
        return Separator(self.structure.network.core, self.clock.tuning.close)


def _forced_changes(candidates: Candidates, chosen: Collection[int]) -> int:
    """How many of the chosen running units must be rewired, whatever the wiring."""
    kept = {candidates.all[i].id for i in chosen}
    running = {i: unit for i in chosen if (unit := candidates.all[i].running) is not None}
    return sum(
        not (candidates.may_stay(i) and all(s.stream.unit in kept for s in unit.subscriptions))
        for i, unit in running.items()
    )


def numbers(labels: Iterable[int]) -> Ints:
    """Labels in order, as an array."""
    return np.array(sorted(labels), np.int64)
