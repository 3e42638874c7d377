"""The best quality that any wiring gives a target's stream, unless running units are better than estimated.

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

from cfgplan.domain import Stream
from cfgplan.planners.exact.best_case import OutputRule, demands_of_quality, least_badness, most_badness
from cfgplan.planners.exact.candidates import Candidate, Candidates
from cfgplan.planners.networks.core import Flags, Ints
from cfgplan.planners.solving.arrays import np
from cfgplan.planning import Feature
from cfgplan.qualities import MICRO, Over, QualityAttribute


@dataclass(frozen=True)
class ChainCut:
    """A cut: a target's badness, plus `ahead` of each unit that runs, by its id, is at least `least`."""

    target: str
    attribute: str
    least: int
    ahead: Mapping[str, int]


def has_chains(candidates: Candidates) -> bool:
    """Whether one attribute counts, and one stream is the best for all who demand it."""
    asked = {wish.attribute for target in candidates.environment.targets for wish in target.quality}
    is_simple = len(asked) == 1 and Feature.SURVIVAL not in candidates.problem.features
    return is_simple and not any(demands_of_quality(candidates).values())


class Chains:
    """Streams and demands of one attribute as arrays; `best` is the least badness of each demand.

    A *pair* is a demand and a stream that meets it; pairs are sorted by demand, whose first one is at `starts`.
    Candidates are numbered as there, demands by `demand`, streams in canonical order.
    """

    def __init__(self, candidates: Candidates, attribute: QualityAttribute) -> None:
        self.tuning = candidates.clock.tuning.quality
        self.attribute = attribute
        self.clock = candidates.clock
        self.size = len(candidates.all)
        self.scale = attribute.scale
        found = least_badness(candidates, attribute)
        of_use = sorted(most_badness(candidates, attribute))
        met = {tag: [s for s in candidates.streams(tag) if s in found] for tag in self.clock.each(of_use)}
        tags = [tag for tag in of_use if met[tag]]
        self.demand = {tag: d for d, tag in enumerate(tags)}
        pairs = [(d, stream) for d, tag in enumerate(tags) for stream in met[tag]]
        self.streams = streams = sorted({stream for _, stream in pairs})
        number = {stream: s for s, stream in enumerate(streams)}
        self.unit = np.array([candidates.index_of[stream.unit] for stream in streams], np.int64)
        self.least = np.array([found[stream] for stream in streams], np.int64)
        self.pair_demand = np.array([d for d, _ in pairs], np.int64)
        self.pair_stream = np.array([number[stream] for _, stream in pairs], np.int64)
        self.pair_unit = self.unit[self.pair_stream]
        self.starts = np.searchsorted(self.pair_demand, np.arange(len(tags)))
        self.ends = np.append(self.starts[1:], len(pairs))
        self.best = np.minimum.reduceat(self.least[self.pair_stream], self.starts) if pairs else np.zeros(0, np.int64)
        self._know_rules([candidates.all[i] for i in self.unit.tolist()], streams)

    def _know_rules(self, makers: list[Candidate], streams: list[Stream]) -> None:
        """Store each stream's quality rule as arrays: its inputs, their combination, gain and shift."""
        making = [
            OutputRule.of(self.attribute, maker.transformation, maker.transformation.output[stream.port], maker.hosts)
            for maker, stream in self.clock.each(zip(makers, streams, strict=True))
        ]
        inputs = [[self.demand.get(port.tag, len(self.demand)) for port in one.inputs] for one in making]
        width = max((len(row) for row in inputs), default=0) or 1
        self.inputs = np.array([row + [-1] * (width - len(row)) for row in inputs], np.int64).reshape(-1, width)
        self.count = np.array([len(row) for row in inputs], np.int64)
        self.over = [one.over for one in making]
        self._by_over = {over: np.array([o is over for o in self.over], np.bool_) for over in set(self.over)}
        self.gain = np.array([one.gain for one in making], np.int64)
        self._shift = np.array([one.shift for one in making], np.int64)

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
                offset = self.attribute.sign * self.attribute.best * np.maximum(self.count[rows] - 1, 0)
                combined[rows] = least.sum(axis=1) + more + offset
        combined = np.minimum(combined, self.scale)
        made: Ints = np.maximum((self.gain * combined + self._shift) // MICRO, self.least)
        return np.where(self.count > 0, made, self.least)

    def met(self, potential: Ints) -> Ints:
        """How bad the stream of each pair is at least, if its inputs are as bad as their potentials."""
        return self.made(potential)[self.pair_stream]

    def deciding(self, stream: int, potential: Ints) -> list[tuple[int, float]]:
        """The demands of a stream's inputs that decide its value, each with its part in that."""
        inputs = self.inputs[stream, : self.count[stream]]
        if not len(inputs):
            return []
        over = self.over[stream]
        if over is Over.BEST:
            return [(int(inputs[np.argmin(potential[inputs])]), 1.0)]
        if over is Over.MEAN:
            return [(demand, 1.0 / len(inputs)) for demand in inputs.tolist()]
        bad = potential[inputs] - (self.best[inputs] if over is Over.SUM else 0)
        return [(int(inputs[np.argmax(bad)]), 1.0)]


class Root:
    """A target's demand among the chains, and a flag for each demand: whether its streams may lead to the target's."""

    def __init__(self, chains: Chains, tag: str) -> None:
        self.chains, self.demand = chains, chains.demand[tag]
        is_before = np.zeros(len(chains.demand) + 1, np.bool_)  # the last is for demands that nothing meets
        ahead = np.array([self.demand])
        while len(ahead):
            is_before[ahead] = True
            streams = chains.pair_stream[np.isin(chains.pair_demand, ahead)]
            inputs = chains.inputs[streams]
            ahead = np.unique(inputs[inputs >= 0])
            ahead = ahead[~is_before[ahead] & (ahead < len(chains.demand))]
        self.is_before: Flags = is_before[:-1]
        self._is_pair_before = self.is_before[chains.pair_demand]
        self._is_even = not (chains.gain > MICRO).any()

    def ahead(self, potential: Ints) -> Ints:
        """By how much each candidate is ahead; in full where units amplify."""
        chains = self.chains
        by = self._by(potential, chains.met(potential))
        all_of_it = max(int(potential[self.demand] - chains.best[self.demand]), 0)
        ahead = np.zeros(chains.size, np.int64)
        np.maximum.at(ahead, chains.pair_unit, by if self._is_even else np.where(by > 0, all_of_it, 0))
        return np.minimum(ahead, all_of_it)

    def lifted(self, potential: Ints) -> Ints:
        """Potentials at least as high at which no candidate is further ahead."""
        chains = self.chains
        for _ in range(chains.tuning.lifts if self._is_even else 0):
            met = chains.met(potential)
            ahead = np.zeros(chains.size, np.int64)
            np.maximum.at(ahead, chains.pair_unit, self._by(potential, met))
            least = np.minimum.reduceat(met + ahead[chains.pair_unit], chains.starts)
            higher = np.where(self.is_before, np.clip(least, potential, chains.scale), potential)
            if (higher == potential).all():
                break
            potential = higher
        return potential

    def _by(self, potential: Ints, met: Ints) -> Ints:
        """By how much each pair's stream is better than the potential of the demand."""
        better = np.maximum(potential[self.chains.pair_demand] - met, 0)
        return np.where(self._is_pair_before, better, 0)
