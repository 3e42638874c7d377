"""A good plan without search where targets ask for quality: cheapest support over demands met no worse than a step.

The badness of demands is cut into steps. A stream meets a demand at a step if its unit's inputs are met at the step
that its rule asks for; then h_add adds up costs, and a target takes the step at which cost and price are least. What
that rounds or leaves out is corrected: each plan is evaluated exactly, its units wired to the best streams.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from heapq import heappop, heappush
from itertools import repeat

import numpy as np

from cfgplan.domain import Target
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.quality_chains import Chains
from cfgplan.planners.networks.core import Floats, Ints
from cfgplan.planners.networks.greedy import FREE
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Quality
from cfgplan.planning import Notion
from cfgplan.qualities import Better, QualityAttribute, is_met, price_us, propagated, worst_allowed


def can_be_planned(candidates: Candidates) -> bool:
    """Whether a plan is any set of units that are fed: nothing but quality is asked, and inputs are ordinary ones."""
    return candidates.problem.notions == {Notion.QUALITY} and not candidates.network.special


class QualityPlanner:
    """Plans are sets of candidates; all that targets ask is of one attribute."""

    def __init__(self, candidates: Candidates, attribute: QualityAttribute, clock: Clock) -> None:
        self.candidates, self.attribute, self.clock = candidates, attribute, clock
        self.chains = chains = Chains(candidates, attribute, clock.tuning.quality)
        self.cost = np.array([candidate.cost_us for candidate in candidates.all], np.float64)
        self.pinned = {i for i in range(len(self.cost)) if candidates.is_pinned(i)}
        self.inputs = [[chains.demand.get(port.tag, -1) for port in c.transformation.inputs] for c in candidates.all]
        self.meets: list[list[int]] = [[] for _ in chains.streams]
        for demand, stream in zip(chains.pair_demand.tolist(), chains.pair_stream.tolist(), strict=True):
            self.meets[stream].append(demand)
        self.streams_of: list[list[int]] = [[] for _ in candidates.all]
        for stream, unit in enumerate(chains.unit.tolist()):
            self.streams_of[unit].append(stream)
        self.targets = [(target, chains.demand[target.tag]) for target in candidates.environment.stream_targets]
        self.steps = BadnessSteps(chains, self.inputs, self.targets, clock.tuning.quality)

    def best(self, plans: Iterable[Collection[int] | None], share: Floats) -> set[int] | None:
        """The best of some plans and of two more, one at costs and one at costs less each candidate's `share`.

        `share` is what a relaxation runs of each candidate. The plans are improved by doing without their dearest
        members. None if there is no plan.
        """
        left = self.cost * (1 - np.minimum(share, 1)) + 1
        ways = [*plans, self.steps.support(self.cost + 1, self.pinned), self.steps.support(left, self.pinned)]
        found: list[tuple[set[int], int]] = []
        for way in ways:
            is_needed = not found or not self.clock.is_over()
            if way is not None and is_needed and self.total_us(way) is not None:
                found.append(self.lean(way))
        if not found:
            return None
        best, total_us = self.improved(*found[-1], left)
        return self.improved(*min([*found, (best, total_us)], key=lambda one: one[1]), left)[0]

    def improved(self, best: set[int], total_us: int, price: Floats) -> tuple[set[int], int]:
        """The plan, or a better one after attempts to do without its dearest members, and its total cost."""
        tried: set[int] = set()
        while len(tried) < self.clock.tuning.quality.attempts and not self.clock.is_over():
            ahead = sorted(best - tried - self.pinned, key=lambda unit: (-self.cost[unit], unit))
            if not ahead:
                break
            tried.add(ahead[0])
            others = best - {ahead[0]}
            around = price.copy()
            around[list(others)] = FREE
            around[ahead[0]] = np.inf
            support = self.steps.support(around, self.pinned)
            for way in () if support is None else (support, support | others):
                if self.total_us(way) is not None:
                    other, other_us = self.lean(way)
                    if other_us < total_us:
                        best, total_us = other, other_us
        return best, total_us

    def lean(self, plan: Collection[int]) -> tuple[set[int], int]:
        """The plan without members that it is no worse without, the dearest tried first, and its total cost."""
        left, total_us = set(plan), self.total_us(plan)
        assert total_us is not None
        for unit in sorted(left - self.pinned, key=lambda unit: (-self.cost[unit], unit)):
            if self.clock.is_over():
                break
            without_us = self.total_us(left - {unit})
            if without_us is not None and without_us <= total_us:
                left.remove(unit)
                total_us = without_us
        return left, total_us

    def total_us(self, plan: Collection[int]) -> int | None:
        """A plan's costs and prices; None if it is not fed or misses a bound."""
        stream_of, value_of = self._wired(plan)
        total_us = sum(self.candidates.all[unit].cost_us for unit in plan)
        for target, demand in self.targets:
            if demand not in stream_of:
                return None
            for wish in target.quality:
                if not is_met(self.attribute, wish, value_of[demand]):
                    return None
                total_us += price_us(self.attribute, wish, value_of[demand])
        if any(demand not in stream_of for unit in self.pinned for demand in self.inputs[unit]):
            return None
        return total_us

    def _wired(self, plan: Collection[int]) -> tuple[dict[int, int], dict[int, int]]:
        """The stream that meets each demand, and its value; the best streams come first."""
        missing = {unit: len(set(self.inputs[unit])) for unit in plan}
        waiting: dict[int, list[int]] = {}
        ahead: list[tuple[int, int]] = []
        stream_of: dict[int, int] = {}
        value_of: dict[int, int] = {}
        sign = 1 if self.attribute.better is Better.LOWER else -1

        def run(unit: int) -> None:
            inputs = [value_of[demand] for demand in self.inputs[unit]]
            for stream in self.streams_of[unit]:
                value = propagated(self.attribute, self.chains.stated[stream], inputs)
                heappush(ahead, (sign * value, stream))

        for unit in sorted(plan):
            for demand in set(self.inputs[unit]):
                waiting.setdefault(demand, []).append(unit)
            if not missing[unit]:
                run(unit)
        while ahead:
            badness, stream = heappop(ahead)
            for demand in self.meets[stream]:
                if demand not in stream_of:
                    stream_of[demand], value_of[demand] = stream, sign * badness
                    for unit in waiting.get(demand, ()):
                        missing[unit] -= 1
                        if not missing[unit]:
                            run(unit)
        return stream_of, value_of


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
