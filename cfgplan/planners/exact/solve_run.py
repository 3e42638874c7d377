"""The working state of one plan: incumbent, proven bounds, the session's memory, and the labels that bounds leave."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.configuration import wire, wired_as_before
from cfgplan.planners.exact.memory import Memory
from cfgplan.planners.exact.remaining import Remaining
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.network import LexicographicWeights, Network
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock

if TYPE_CHECKING:
    from cfgplan.planners.closing.gap import GapClosing
    from cfgplan.planners.closing.separation import Separator
    from cfgplan.planners.exact.search import LandmarkFinder, Landmarks, Search


class SolveRun:
    """The state of one plan in progress. Each stage starts from the state that the previous stage left."""

    remaining: Remaining
    network: Network
    """The network of these labels."""
    weights: LexicographicWeights
    candidates: Candidates
    """The units of the labels that are left."""

    def __init__(self, state: SolveState, memory: Memory) -> None:
        self.state, self.memory, self.structure = state, memory, memory.structure
        self.problem, self.clock = state.problem, state.clock
        self.closing: GapClosing | None = None
        self._offered: tuple[frozenset[str], Candidates] | None = None

    def offer(self, plan: Iterable[int], clock: Clock | None = None) -> None:
        """Offer a plan of labels, by their numbers. Raises OutOfTimeError by this clock, or by the run's."""
        labels = frozenset(self.structure.network.labels[i] for i in plan)
        candidates = self._candidates_of(labels, clock or self.clock)
        self._offer(candidates, candidates.first_of_each(labels))
        self._offered = labels, candidates

    def _candidates_of(self, labels: frozenset[str], clock: Clock) -> Candidates:
        """The candidates of some labels: those of the last offer, if it had the same labels."""
        offered, candidates = self._offered or (None, None)
        if candidates is None or labels != offered:
            return self.structure.candidates(self.problem, labels, clock)
        candidates.clock = clock
        return candidates

    def _offer(self, candidates: Candidates, chosen: set[int]) -> None:
        """Offer a choice of candidates: wired as in the last plan if that rewires no unit which might stay."""
        if self.memory.warm_start is not None:
            units = wired_as_before(candidates, chosen, self.memory.last)
            key = None if units is None else self.state.offer(candidates, units)
            if key is not None and key.rewired == _forced_changes(candidates, chosen):
                return
        units = wire(candidates, chosen)
        if units is not None:
            self.state.offer(candidates, units)

    def take(
        self,
        remaining: Remaining,
        network: Network,
        weights: LexicographicWeights,
        plan: Sequence[int] | Ints | None = None,
    ) -> None:
        """Continue with the remaining labels of a network: raise the proven bound and offer the plan, if one is known.

        Raises OutOfTimeError if no plan can be offered.
        """
        state = self.state
        state.counts["left by bounds"] = len(remaining.labels)
        if remaining.bound is not None:
            state.counts["landmarks"] = len(remaining.bound.landmarks)
        if remaining.holds_for != state.holds_for:
            state.holds_for, state.bound_us = remaining.holds_for, 0
        state.raise_bound(weights.cost_us(remaining.value))
        self.remaining, self.network, self.weights = remaining, network, weights
        best_us = None if state.best is None else state.best.key.cost_us
        if plan is not None and self.clock.is_over() and best_us == weights.cost_us(weights.of_plan(plan)):
            return
        clock = self.clock if plan is None else Clock()  # a plan that is known is offered whatever the time
        self.candidates = self._candidates_of(frozenset(remaining.names(network)), clock)
        if plan is None:
            return
        labels = frozenset(network.labels[i] for i in plan)
        chosen = self.candidates.first_of_each(labels)
        if self._offered is None or labels != self._offered[0]:
            self._offer(self.candidates, chosen)
        if self._proves_all(chosen):
            state.prove_all()

    def take_bounded(self, part: Remaining, network: Network, weights: LexicographicWeights, plan: Ints | None) -> None:
        """Continue with the labels that a bound leaves; with the plan's only, if the time is over."""
        value, labels = weights.least(part.value), part.labels
        if plan is not None and self.clock.is_over() and value < weights.of_plan(plan):
            labels = plan
        self.take(replace(part, labels=labels, value=value), network, weights, plan)

    def tell_of(self, closing: GapClosing) -> None:
        """Offer the plan of a gap that is being closed, if it is cheaper, and raise the bound; both are told."""
        best, weights, plan = self.state.best, self.weights, closing.plan
        if best is None or weights.cost_us(weights.of_plan(plan)) < best.key.cost_us:
            self.offer(plan.tolist(), Clock())
        self.state.raise_bound(weights.cost_us(weights.least(closing.bound.value)))

    def landmarks(self) -> Landmarks:
        """The landmarks of the remaining labels."""
        return self.remaining.landmarks(self.network)

    def _proves_all(self, chosen: set[int]) -> bool:
        """Whether the incumbent can't be beaten in changes, or is the only choice of units at its cost.

        An only choice must not rewire more than it has to. A choice is the only one if it has all candidates and each
        of them costs something, or has to run: one that costs nothing might be left out.
        """
        state, candidates, best = self.state, self.candidates, self.state.best
        if best is None:
            return False
        fewest_changes = self.weights.changes(self.remaining.value)
        if fewest_changes is not None and best.key == (0, (), state.bound_us, *fewest_changes):
            return True
        return (
            self.remaining.is_complete
            and best.key[:3] == (0, (), state.bound_us)
            and len(chosen) == len(candidates.all) == len(best.units)
            and all(c.cost_us or candidates.is_pinned(i) for i, c in enumerate(candidates.all))
            and best.key.rewired == _forced_changes(candidates, chosen)
        )

    def search(self, landmarks: Landmarks = (), missed: LandmarkFinder = lambda *_: ()) -> Search:
        """A search among the candidates in the constraint model, which is built here; raises OutOfTimeError."""
        from cfgplan.planners.exact.search import Search  # the solver takes long to import

        self.candidates.clock = self.clock
        return Search(self.candidates, self.state, landmarks=landmarks, missed=missed)

    def missed(self, labels: Collection[str], clock: Clock) -> list[tuple[list[str], int]]:
        """Landmarks that these labels do not hit. Empty if the labels are grounded and meet every target."""
        network = self.structure.network
        uses = np.zeros(len(network.labels))
        uses[[network.number[label] for label in labels]] = 1.0
        found = self._separator.missed(uses, np.random.default_rng(len(labels)), is_over=clock.is_over)
        return [([network.labels[i] for i in one.counted.tolist()], one.least) for one in found]

    @cached_property
    def _separator(self) -> Separator:
        from cfgplan.planners.closing.separation import Separator

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
