"""The cheapest support of the targets, prices included, where a demand may be met at some steps of badness."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import repeat

import numpy as np

from cfgplan.domain import Target
from cfgplan.planners.exact.quality_chains import Chains
from cfgplan.planners.networks.core import Floats, Ints
from cfgplan.planners.tuning import USUAL, Quality
from cfgplan.qualities import is_met, price_us, worst_allowed


class BadnessSteps:
    """Steps of badness from the best to the worst, and the steps that each stream's inputs must keep for each."""

    def __init__(
        self,
        chains: Chains,
        inputs: Sequence[list[int]],
        targets: Sequence[tuple[Target, int]],
        tuning: Quality = USUAL.quality,
    ) -> None:
        """`inputs` are the demands of each candidate's inputs, targets come with their demands."""
        self.chains, self.inputs = chains, inputs
        self.targets = [demand for _, demand in targets]
        attribute = chains.attribute
        ends, bounds = [1], []
        for target, demand in targets:
            missed_by = [
                chains.badness(worst_allowed(attribute, wish)) for wish in target.quality if wish.bound is not None
            ]
            ends.append(min([tuning.reach * int(chains.best[demand]), *missed_by]))
            bounds += missed_by
        found = np.append(np.linspace(0, max(ends), tuning.badness_steps).astype(np.int64), [*bounds, chains.scale])
        self.step = np.unique(found[(found >= 0) & (found <= chains.scale)])
        made = np.array([self._made(step) for step in chains.clock.each(self.step.tolist(), 1)])
        self._before = np.array([np.searchsorted(row, self.step, side="right") - 1 for row in made.T], np.int64)
        self._is_possible = (self._before >= 0)[chains.pair_stream]
        self._before = np.maximum(self._before, 0)[chains.pair_stream]
        rows = [sorted(set(inputs[unit])) for unit in chains.unit.tolist()]
        width = max((len(row) for row in rows), default=0) or 1
        end = len(chains.demand)
        needs = [[demand if demand >= 0 else end + 1 for demand in row] + [end] * (width - len(row)) for row in rows]
        self._needs = np.array(needs, np.int64).reshape(-1, width)[chains.pair_stream]
        values = [attribute.best + chains.sign * step for step in self.step.tolist()]
        self._price = np.array(
            [
                [
                    sum(price_us(attribute, wish, value) for wish in target.quality)
                    if all(is_met(attribute, wish, value) for wish in target.quality)
                    else np.inf
                    for value in values
                ]
                for target, _ in targets
            ],
            np.float64,
        )

    def _made(self, step: int) -> Ints:
        return self.chains.made(np.full(len(self.chains.demand), step, np.int64))

    def support(self, price: Floats, pinned: Collection[int]) -> set[int] | None:
        """The cheapest candidates at these prices that support targets and pinned ones; None if there are none."""
        meets = self._cheapest(price)
        ahead = [(demand, len(self.step) - 1) for unit in sorted(pinned) for demand in self.inputs[unit]]
        cheapest = np.minimum.reduceat(meets, self.chains.starts, axis=0)
        for target, demand in enumerate(self.targets):
            total = np.minimum.accumulate(cheapest[demand]) + self._price[target]
            ahead.append((demand, int(np.argmin(total))))
            if not np.isfinite(total.min()):
                return None
        chosen, seen = set(pinned), set(ahead)
        for demand, step in ahead:
            first = int(self.chains.starts[demand])
            choices = meets[first : int(self.chains.ends[demand]), : step + 1]
            pair, at = np.unravel_index(int(np.argmin(choices)), choices.shape)
            if not np.isfinite(choices[pair, at]):
                return None
            pair_number = first + int(pair)
            chosen.add(int(self.chains.pair_unit[pair_number]))
            step = int(self._before[pair_number, at])
            for need in self._needs[pair_number].tolist():
                if need < len(self.chains.demand) and (need, step) not in seen:
                    seen.add((need, step))
                    ahead.append((need, step))
        return chosen

    def _cheapest(self, price: Floats) -> Floats:
        """h_add of each pair of a demand and a stream at each step."""
        chains, count = self.chains, len(self.chains.demand)
        met = np.full((count + 2, len(self.step)), np.inf)
        met[count] = 0.0
        own = price[chains.pair_unit][:, None]
        for _ in chains.clock.each(repeat(None), 1):
            meets = own + met[self._needs[:, 0][:, None], self._before]
            for column in self._needs.T[1:]:
                meets += met[column[:, None], self._before]
            meets = np.where(self._is_possible, meets, np.inf)
            better = np.minimum.accumulate(np.minimum.reduceat(meets, chains.starts, axis=0), axis=1)
            if (better == met[:count]).all():
                return meets
            met[:count] = better
        raise AssertionError("h_add comes to an end")
