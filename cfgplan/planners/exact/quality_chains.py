"""How bad a target's stream must be, whatever is wired, unless units run that are better than estimated.

The value of a stream is made along a chain of units, and every unit adds its part to what its worst input has. Choose a
*potential* for each demand: an estimate of how bad the stream is that meets it. A unit is *ahead* by as much as its
stream is better than the potential of a demand that it meets, while its own inputs are as bad as theirs. On the chain
that decides a target's value, being ahead adds up and nothing else helps, so that

    badness of the target + sum over units (ahead * runs) >= potential of the target's demand

whatever the potentials are. They are a dual solution of the longest chain of a wiring, and these are the cuts of
Benders. Badness is the distance from the best of the scale in micro-units, all rounded to the safe side. A value that
is kept at the worst of the scale is no better than any potential, since these are kept there too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cfgplan.domain import Stream
from cfgplan.planners.exact.best_case import best_values, worst_of_use
from cfgplan.planners.exact.candidates import Candidate, Candidates
from cfgplan.planners.networks.core import Flags, Ints
from cfgplan.planners.tuning import USUAL, Quality
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule

MOST_GAIN = 64 * MICRO
"""The largest factor by which units in a row amplify, in millionths; beyond it being ahead counts in full."""


@dataclass(frozen=True)
class ChainCut:
    """A cut: a target's badness, plus `ahead` of each unit that runs, by its id, is at least `least`."""

    target: str
    attribute: str
    least: int
    ahead: Mapping[str, int]


class Chains:
    """Streams and demands of one attribute as arrays; `best` is the least badness of each demand.

    A *pair* is a demand and a stream that meets it; pairs are sorted by demand, whose first one is at `starts`.
    Candidates are numbered as there, demands by `demand`, streams in canonical order.
    """

    def __init__(self, candidates: Candidates, attribute: QualityAttribute, tuning: Quality = USUAL.quality) -> None:
        self.tuning = tuning
        self.attribute = attribute
        self.clock = candidates.clock
        self.sign = 1 if attribute.better is Better.LOWER else -1
        self.size = len(candidates.all)
        self.scale = abs(attribute.worst - attribute.best)
        found = best_values(candidates, attribute)
        of_use = sorted(worst_of_use(candidates, attribute))
        met = {tag: [s for s in candidates.streams(tag) if s in found] for tag in self.clock.each(of_use)}
        tags = [tag for tag in of_use if met[tag]]
        self.demand = {tag: d for d, tag in enumerate(tags)}
        pairs = [(d, stream) for d, tag in enumerate(tags) for stream in met[tag]]
        self.streams = streams = sorted({stream for _, stream in pairs})
        number = {stream: s for s, stream in enumerate(streams)}
        self.unit = np.array([candidates.index_of[stream.unit] for stream in streams], np.int64)
        self.least = np.array([self.badness(found[stream]) for stream in streams], np.int64)
        self.pair_demand = np.array([d for d, _ in pairs], np.int64)
        self.pair_stream = np.array([number[stream] for _, stream in pairs], np.int64)
        self.pair_unit = self.unit[self.pair_stream]
        self.starts = np.searchsorted(self.pair_demand, np.arange(len(tags)))
        self.ends = np.append(self.starts[1:], len(pairs))
        self.best = np.minimum.reduceat(self.least[self.pair_stream], self.starts) if pairs else np.zeros(0, np.int64)
        self._know_rules([candidates.all[i] for i in self.unit.tolist()], streams)

    def badness(self, value: int) -> int:
        return self.sign * (value - self.attribute.best)

    def _know_rules(self, makers: list[Candidate], streams: list[Stream]) -> None:
        """What each stream makes of its inputs: `gain` and `shift` in millionths, and how inputs are combined."""
        end = len(self.demand)
        ports = [maker.transformation.output[s.port] for maker, s in zip(makers, streams, strict=True)]
        self.stated = [{c.attribute: c for c in port.quality}.get(self.attribute.name) for port in ports]
        nothing = Contribution(self.attribute.name, QualityRule.LIMIT, self.attribute.best)
        stated = [one or nothing for one in self.stated]
        inputs = [
            [self.demand.get(port.tag, end) for port in maker.transformation.inputs if not port.feedback]
            if one.rule is not QualityRule.SET
            else []
            for maker, one in self.clock.each(zip(makers, stated, strict=True))
        ]
        width = max((len(row) for row in inputs), default=0) or 1
        self.inputs = np.array([row + [-1] * (width - len(row)) for row in inputs], np.int64).reshape(-1, width)
        self.count = np.array([len(row) for row in inputs], np.int64)
        self.over = [one.over for one in stated]
        self._by_over = {over: np.array([o is over for o in self.over], np.bool_) for over in set(self.over)}
        gains = [one.value if one.rule is QualityRule.SCALE else MICRO for one in stated]
        self.gain = np.array([gain if row else 0 for gain, row in zip(gains, inputs, strict=True)], np.int64)
        best = self.sign * self.attribute.best
        more = [best * (gain - MICRO) for gain in gains]
        for s, one in enumerate(stated):
            if one.rule is QualityRule.ADD:
                more[s] = self.sign * one.value * MICRO
        self._shift = np.array(more, np.int64)

    def made(self, potential: Ints) -> Ints:
        """How bad each stream is at least if its inputs are as bad as their demands' potentials."""
        theirs = np.append(potential, self.scale)[self.inputs]
        is_input = self.inputs >= 0
        combined = np.where(is_input, theirs, 0).max(axis=1)
        for over, rows in self._by_over.items():
            if over is Over.BEST:
                combined[rows] = np.where(is_input[rows], theirs[rows], self.scale).min(axis=1)
            elif over is Over.MEAN:
                total = np.where(is_input[rows], theirs[rows], 0).sum(axis=1)
                combined[rows] = total // np.maximum(self.count[rows], 1)
            elif over is Over.SUM:
                least = np.where(is_input[rows], np.append(self.best, self.scale)[self.inputs[rows]], 0)
                more = np.where(is_input[rows], theirs[rows] - least, 0).max(axis=1)
                offset = self.sign * self.attribute.best * np.maximum(self.count[rows] - 1, 0)
                combined[rows] = least.sum(axis=1) + more + offset
        combined = np.minimum(combined, self.scale)
        made: Ints = np.maximum((self.gain * combined + self._shift) // MICRO, self.least)
        return np.where(self.count > 0, made, self.least)

    def met(self, potential: Ints) -> Ints:
        """How bad the stream of each pair is at least, if its inputs are as bad as their potentials."""
        return self.made(potential)[self.pair_stream]

    @cached_property
    def part(self) -> float:
        """The median of what units add to the badness of their worst input."""
        theirs = np.where(self.inputs >= 0, np.append(self.best, 0)[self.inputs], 0).max(axis=1)
        return max(1.0, float(np.median((self.least - theirs)[self.count > 0]))) if self.count.any() else 1.0

    def deciding(self, stream: int, potential: Ints, spread: float) -> list[tuple[int, float]]:
        """The demands of a stream's inputs that decide its value, each with its part in that.

        With a `spread`, inputs nearly as bad as the worst have a part too; `part` times `spread` is near.
        """
        inputs = self.inputs[stream, : self.count[stream]]
        if not len(inputs):
            return []
        over = self.over[stream]
        if over is Over.BEST:
            return [(int(inputs[np.argmin(potential[inputs])]), 1.0)]
        if over is Over.MEAN:
            return [(demand, 1.0 / len(inputs)) for demand in inputs.tolist()]
        bad = potential[inputs] - (self.best[inputs] if over is Over.SUM else 0)
        if not spread:
            return [(int(inputs[np.argmax(bad)]), 1.0)]
        shares = np.exp((bad - bad.max()) / (spread * self.part))
        shares = np.where(shares < self.tuning.few, 0.0, shares)
        return [
            (demand, part)
            for demand, part in zip(inputs.tolist(), (shares / shares.sum()).tolist(), strict=True)
            if part
        ]

    def root(self, tag: str) -> Root:
        """The root of a target that demands a tag: how much being ahead counts at each demand."""
        end = self.demand[tag]
        weight = np.zeros(len(self.demand), np.int64)
        weight[end] = MICRO
        gain = np.maximum(self.gain, MICRO)
        for _ in range(self.tuning.gains + len(self.demand) * bool((gain == MICRO).all())):
            more = np.append(weight, 0)
            amplified = -(-weight[self.pair_demand] * gain[self.pair_stream] // MICRO)
            for column in self.inputs.T[:, self.pair_stream]:
                np.maximum.at(more, column, amplified)
            more = np.minimum(more[:-1], MOST_GAIN)
            if (more == weight).all():
                return Root(self, end, weight)
            weight = more
        return Root(self, end, np.where(weight > 0, MOST_GAIN, 0))


class Root:
    """A target's demand among the chains: `weight` says how much being ahead at a demand counts, in millionths."""

    def __init__(self, chains: Chains, demand: int, weight: Ints) -> None:
        self.chains = chains
        self.demand = demand
        self.is_before: Flags = weight > 0
        self._pair_weight = weight[chains.pair_demand]
        self._is_even = bool((weight <= MICRO).all())

    def ahead(self, potential: Ints) -> Ints:
        """By how much each candidate is ahead."""
        chains = self.chains
        by = np.where(self._pair_weight > 0, potential[chains.pair_demand] - chains.met(potential), 0)
        by = np.maximum(by, 0)
        all_of_it = max(int(potential[self.demand] - chains.best[self.demand]), 0)
        if not self._is_even:
            by = np.where(by * (self._pair_weight >= MOST_GAIN) > 0, all_of_it, -(-by * self._pair_weight // MICRO))
        ahead = np.zeros(chains.size, np.int64)
        np.maximum.at(ahead, chains.pair_unit, by)
        return np.minimum(ahead, all_of_it)

    def lifted(self, potential: Ints) -> Ints:
        """Potentials at least as high at which no candidate is further ahead."""
        chains = self.chains
        for _ in range(self.chains.tuning.lifts if self._is_even else 0):
            met = chains.met(potential)
            by = np.where(self._pair_weight > 0, potential[chains.pair_demand] - met, 0)
            ahead = np.zeros(chains.size, np.int64)
            np.maximum.at(ahead, chains.pair_unit, by)
            least = np.minimum.reduceat(met + ahead[chains.pair_unit], chains.starts)
            higher = np.where(self.is_before, np.clip(least, potential, chains.scale), potential)
            if (higher == potential).all():
                break
            potential = higher
        return potential
