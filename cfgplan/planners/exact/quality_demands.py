"""The badness of demands in the model of a flat fleet without hosts; streams have no values of their own.

Where each rule takes the worst input, a stream is no better than its rule makes of any single input. So each input of a
stream that may meet a demand has a row, which holds if the stream is taken. Badness is the distance from the best of
the scale, in steps.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import gcd

from ortools.sat.python.cp_model import IntVar, LinearExpr

from cfgplan.domain import Stream
from cfgplan.planners.exact.best_case import worst_of_use
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.flat import Met
from cfgplan.planners.exact.flat_model import FlatModel
from cfgplan.planners.exact.quality import Scaled, chains_are_as_bad_as_who_runs_lets_them, grant
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.qualities import MICRO, Better, Over, QualityAttribute, QualityRule


def takes_the_worst(candidates: Candidates, attribute: QualityAttribute) -> bool:
    """Whether every rule takes the worst input, and nothing is carried between hosts."""
    return not candidates.environment.hosts and all(
        c.over is Over.WORST or len(candidate.transformation.inputs) == 1 or c.rule is QualityRule.SET
        for candidate in candidates.all
        for port in candidate.transformation.outputs
        for c in port.quality
        if c.attribute == attribute.name
    )


class DemandModel:
    """A variable for the badness of each demand in a model whose `feeds` are filled."""

    def __init__(self, model: FlatModel, attribute: QualityAttribute) -> None:
        self.model, self.scaled = model, Scaled(model.candidates, attribute)
        self.sign = 1 if attribute.better is Better.LOWER else -1
        self.scale = self._badness(self.scaled.attribute.worst)
        worst = worst_of_use(model.candidates, attribute)
        self.bad: dict[Met, IntVar] = {}
        self.is_worst: dict[Met, IntVar] = {}
        for fact in model.candidates.clock.each(model.feeds):
            assert isinstance(fact, Met)
            least = [self._least(stream) for _, stream in model.feeds[fact] if stream in self.scaled.ranges]
            most = self._badness(self.scaled.at_most(worst.get(fact.tag, attribute.worst)))
            start = min([*least, most])
            self.bad[fact] = model.cp.new_int_var(start, most, "")
            if most == self.scale:
                self.is_worst[fact] = model.cp.new_bool_var("")
                model.cp.add(self.bad[fact] == most).only_enforce_if(self.is_worst[fact])
        for fact in self.bad:
            self._is_no_better_than_what_meets_it(fact)

    def grant_all(self, cuts: Iterable[ChainCut]) -> None:
        """Demand what targets ask; `cuts` are of this attribute."""
        missed_by = {}
        for target in self.model.environment.targets:
            for wish in target.quality:
                missed_by[target.label] = self.bad[Met(target.tag, target.host)]
                grant(self.model, self.scaled, wish, missed_by[target.label])
        chains_are_as_bad_as_who_runs_lets_them(self.model, cuts, missed_by, self.scaled.step)

    def _badness(self, value: int) -> int:
        return self.sign * (value - self.scaled.attribute.best)

    def _least(self, stream: Stream) -> int:
        return self._badness(self.scaled.ranges[stream][0])

    def _is_no_better_than_what_meets_it(self, fact: Met) -> None:
        cp, bad = self.model.cp, self.bad[fact]
        known = [(s, taken) for (_, s), taken in self.model.feeds[fact].items() if s in self.scaled.ranges]
        start = min((self._least(stream) for stream, _ in known), default=0)
        at_best = [(self._least(stream) - start) * taken for stream, taken in known]
        most = max(bad.proto.domain)
        if all(self._least(stream) <= most for stream, _ in known):
            cp.add(bad >= LinearExpr.sum(at_best) + start)
        for stream, taken in known:
            if self._least(stream) > most:
                cp.add_bool_or([taken.negated()])
                continue
            held = [taken] if fact not in self.is_worst else [taken, self.is_worst[fact].negated()]
            for before, gain, by, more in self._rule(stream):
                cp.add(by * bad >= gain * self.bad[before] + more).only_enforce_if(held)

    def _rule(self, stream: Stream) -> Iterable[tuple[Met, int, int, int]]:
        """For each input that counts its demand, and what its badness is changed by: a gain, a divisor, an addend."""
        candidate = self.model.candidates.all[self.model.candidates.index_of[stream.unit]]
        port = candidate.transformation.output[stream.port]
        stated = {c.attribute: c for c in port.quality}.get(self.scaled.attribute.name)
        gain, by, more = 1, 1, 0
        if stated is not None and stated.rule is QualityRule.SET:
            return
        if stated is not None and stated.rule is QualityRule.SCALE:
            common = gcd(stated.value, MICRO)
            gain, by = stated.value // common, MICRO // common
            more = self.sign * self.scaled.attribute.best * (gain - by)
        elif stated is not None and stated.rule is QualityRule.ADD:
            more = self.sign * self.scaled.own(stated)
        for tag in dict.fromkeys(port.tag for port in candidate.transformation.inputs):
            yield Met(tag, None), gain, by, more
