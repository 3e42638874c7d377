"""Bound and plan brought together: missed landmarks for the one, repairs for the other, in turn."""

from __future__ import annotations

import numpy as np

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.charging import BUILDING_S
from cfgplan.planners.bounding.landmarks import Landmark
from cfgplan.planners.closing.alike import alike
from cfgplan.planners.closing.program import LandmarkProgram
from cfgplan.planners.closing.repairing import Repairs
from cfgplan.planners.closing.separation import MISSED, Separator
from cfgplan.planners.networks.core import Flags, Floats, Ints
from cfgplan.planners.networks.network import Graph
from cfgplan.planners.solving.clock import Clock

CHUNK, LEAST, LABELS = 25, 3, 50_000
"""After so many rounds of landmarks the network is restricted, and the plan repaired: fewer with many labels."""
PACE = 0.04 / CHUNK
"""The least part of the gap that a round must close to go on."""
FAR, PATIENCE = 0.3, 100
"""While the bound is so far below the plan that the solver has little hope, so many times longer, however slowly."""
AGAIN = 40
"""So many landmarks that were charged greedily, if the fractions miss them, are added again in a round."""
MANY, TIMES = 3000, 4
"""With so many labels, or so far below the plan, a linear program takes so long that more landmarks are looked for."""
ENTRIES = 3
"""About how many entries the first linear program has for each link."""
INWARD = 0.5
"""How far from the fractions towards something that hits every landmark the missed ones are looked for."""
TRUST = 0.8
"""How much cheaper a label is in repairs if the fractions use it as a whole."""
ROUND_S, MEMBER_S, LABEL_S = 1.6e-5, 1.4e-9, 1.2e-8
"""About what a round takes for each fact that is needed, for each member of a landmark and each landmark, and for the
square of the number of labels.

Time is estimated, not measured, so that a plan can be repeated.
"""
ATTEMPT_S, NEED_S = 2e-4, 1.5e-7
"""About what a repair takes, and for each fact that is needed."""
REPAIRS, FIRST_REPAIRS = 0.4, 300
"""The share of time that repairs get, and how many there are at first at most."""


class Closing:
    """A bound for plans no dearer than the best one known, and that plan, on their way to each other.

    `cost` is that of all labels of the network, a multiple of `step`.
    """

    def __init__(self, network: Graph, bound: Bound, cost: Ints, plan: Ints, step: int) -> None:
        self.bound = bound
        self._cost = cost
        self._step = step
        self._attempt_s = ATTEMPT_S + NEED_S * len(network.core.needs.items) + network.core.depth_s
        self._repairs = Repairs(network, cost, set(plan.tolist()))
        self._kinds = alike(network, cost)
        self._rounds: _Rounds | None = None
        self._fractions: Floats = np.zeros(len(cost))

    @property
    def plan(self) -> Ints:
        return np.array(sorted(self._repairs.best), np.int64)

    @property
    def limit(self) -> int:
        """What the plan costs."""
        return int(self._cost[self.plan].sum())

    @property
    def is_closed(self) -> bool:
        """Whether no plan is cheaper."""
        return self.bound.value > self.limit - self._step

    @property
    def _patience(self) -> int:
        return PATIENCE if self.bound.value < (1 - FAR) * self.limit else 0

    def go_on(self, label_s: float, clock: Clock) -> None:
        """Raise the bound and look for a cheaper plan until they meet or hardly move, or it has taken too long.

        That is about so many seconds for the number of labels that the first fractions leave to the power of 1.5.
        """
        took_s = self._begin(label_s, clock)
        for_s = label_s * self._left**1.5
        while took_s < for_s * (1 + self._patience) and not self.is_closed and _can_be_built(self.bound, clock):
            before = self.bound.value
            rounds = min(CHUNK, max(LEAST, LABELS // self.bound.core.goal))
            rounds_s = self._round(for_s, rounds, clock)
            self._repair(REPAIRS * rounds_s, clock)
            least = 0.0 if self._patience else PACE * rounds * (self.limit - before)
            if self.bound.value - before <= least:
                break
            took_s += (1 + REPAIRS) * rounds_s

    @property
    def _left(self) -> int:
        """How many labels may be in a plan that is no dearer."""
        return int(self.bound.may_be_used(self.limit).sum())

    def _begin(self, label_s: float, clock: Clock) -> float:
        """The first fractions show where to look for a cheaper plan; returns about how many seconds they take."""
        for_s = label_s * self._left**1.5
        took_s = self._round(for_s, 1, clock) if _can_be_built(self.bound, clock) else 0.0
        self._repair(min(REPAIRS * for_s, min(FIRST_REPAIRS, self._left) * self._attempt_s), clock)
        return took_s

    def _round(self, for_s: float, most: int, clock: Clock) -> float:
        """Raise the bound by up to so many linear programs; returns about how many seconds they take."""
        if self._rounds is None:
            self._rounds = _Rounds(self.bound, self._kinds)
        self._rounds.restrict(self.bound.may_be_used(self.limit))
        self._rounds.times = TIMES if self._patience or self.bound.core.goal >= MANY else 1
        took_s = self._rounds.improve(self.limit - self._step + 1, for_s, most, clock)
        self.bound = self._rounds.bound
        self._fractions[:] = 0.0
        self._fractions[self.bound.core.labels] = self._rounds.fractions
        return took_s

    def _repair(self, for_s: float, clock: Clock) -> None:
        """Look for a cheaper plan for about so long, unless there is none."""
        if self.is_closed:
            return
        is_left = np.zeros(len(self._cost), np.bool_)
        is_left[self.bound.core.labels] = True
        guide = (self._cost + 1.0) * (1.0 - TRUST * np.minimum(1.0, self._fractions))
        self._repairs.attempt(int(for_s / self._attempt_s), np.where(is_left, guide, np.inf), clock.is_over)


def _can_be_built(bound: Bound, clock: Clock) -> bool:
    """Whether there is time for a linear program."""
    left_s = clock.left_s()
    return not clock.is_over() and (left_s is None or ENTRIES * bound.core.links * BUILDING_S < left_s)


class _Rounds:
    """Rounds of solving the linear program and adding landmarks that its fractions miss."""

    def __init__(self, bound: Bound, kinds: Ints) -> None:
        self.bound = bound
        self.times = 1
        self._kinds = kinds
        self.fractions: Floats = np.zeros(bound.core.goal)
        self._draw = np.random.default_rng(bound.core.goal)
        self._inside: Floats = np.ones(bound.core.goal)
        self._begin()

    def _begin(self) -> None:
        self._separator = Separator(self.bound.core)
        self._program = LandmarkProgram(self.bound.core, self._kinds[self.bound.core.labels], self.bound.cost)
        self._landmarks = [one for one in self.bound.short() if self._program.add(one)]
        self._waiting = self.bound.landmarks[:]

    def restrict(self, keep: Flags) -> None:
        """Go on with a part of the labels, and the landmarks that count, if that is much less."""
        counting = sum(weight > 0 for weight in self.bound.weights)
        if keep.sum() < 0.75 * len(keep) or 2 * counting < len(self.bound.landmarks):
            self.bound = self.bound.restricted(keep)
            self._inside, self.fractions = self._inside[keep], self.fractions[keep]
            self._begin()

    def improve(self, enough: int, for_s: float, most: int, clock: Clock) -> float:
        """Up to `most` rounds; returns about how many seconds they take."""
        took_s = 0.0
        for _ in range(most):
            fractions = self._program.solve(clock.left_s())
            if fractions is None or clock.is_over():
                break
            self.fractions = fractions
            took_s += ROUND_S * len(self.bound.core.needs.items)
            took_s += MEMBER_S * self._program.members * len(self._landmarks) + LABEL_S * self.bound.core.goal**2
            if self._program.value >= enough or took_s >= for_s or not self._add_missed(fractions, clock):
                break
        bound = self._program.bound(self._landmarks[:])
        if bound.value >= self.bound.value:
            self.bound = bound
        return took_s

    def _add_missed(self, fractions: Floats, clock: Clock) -> bool:
        """Landmarks missed by a point further inside, which cut deeper; if none are, by the fractions themselves."""
        inward = fractions + INWARD * (self._inside - fractions)
        if self._add(inward, clock):
            return True
        self._inside = inward
        return self._add(fractions, clock)

    def _add(self, fractions: Floats, clock: Clock) -> bool:
        missed = self._waiting_missed(fractions)
        missed += self._separator.missed(fractions, self._draw, self.times, clock.is_over)
        new = [one for one in missed if self._program.add(one)]
        self._landmarks += new
        return bool(new)

    def _waiting_missed(self, fractions: Floats) -> list[Landmark]:
        """Of the landmarks known before those that the fractions hit least, which no longer wait."""
        hit = np.array([landmark.hit_by(fractions) for landmark in self._waiting])
        least = {i for i in np.argsort(hit, kind="stable")[:AGAIN].tolist() if hit[i] < 1 - MISSED}
        missed = [one for i, one in enumerate(self._waiting) if i in least]
        self._waiting = [one for i, one in enumerate(self._waiting) if i not in least]
        return missed
