"""A flat fleet with its hosts forgotten: which units run at all, and which demands are met anywhere.

Every plan of the fleet is a plan without hosts too, so what holds of all those holds of it: a demand met somewhere was
met first by a unit that does not need it, and landmarks are hit. The model over hosts does not imply this, since its
relaxation spreads a unit over the hosts. What its search lacks most is a decision that a unit runs, wherever that is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.tightening import tightened
from cfgplan.planners.exact.flat import Fact, Flat, Met
from cfgplan.planners.exact.flat_model import FlatModel
from cfgplan.planners.networks.core import Core, Rows
from cfgplan.planners.solving.clock import Clock


class Anywhere:
    """The units that have a place, and the facts without hosts.

    `bound` is a landmark bound on the units' cost, for plans whose units cost at most `limit_us`.
    """

    def __init__(self, flat: Flat, limit_us: int, clock: Clock) -> None:
        candidates = flat.candidates
        self.units = [unit for unit in range(len(candidates.all)) if flat.places(unit)]
        number = {unit: n for n, unit in enumerate(self.units)}
        givers: dict[Fact, set[int]] = {}
        for fact, labels in clock.each(flat.givers.items()):
            givers.setdefault(_hostless(fact), set()).update(number[flat.labels[label].unit] for label in labels)
        self._fact_of = {fact: number for number, fact in enumerate(givers)}
        self._givers = [sorted(units) for units in givers.values()]
        self._needs = [self._numbers(flat.needs[flat.places(unit)[0]]) for unit in self.units]
        core = Core(
            Rows.of([*self._needs, self._numbers(flat.wanted)]),
            Rows.of(self._givers),
            np.arange(len(self.units)),
            np.arange(len(givers)),
        )
        cost = np.array([candidates.all[unit].cost_us for unit in self.units], np.int64)
        self.bound = tightened(Bound(core, cost), limit_us, limit_us, clock)
        self._limit_us = limit_us

    def _numbers(self, facts: list[Fact]) -> list[int]:
        return sorted({self._fact_of[_hostless(fact)] for fact in facts})

    def add_to(self, model: FlatModel) -> None:
        """Add the units and facts without hosts, and what holds of them, to the fleet's model."""
        cp = model.cp
        there = [cp.new_bool_var("") for _ in self.units]
        for unit, is_there in zip(self.units, there, strict=True):
            cp.add_exactly_one(*model.runs[unit], is_there.negated())
        met = [cp.new_bool_var("") for _ in self._givers]
        for fact, holds in model.candidates.clock.each(model.holds.items()):
            cp.add_implication(holds, met[self._fact_of[_hostless(fact)]])
        for needs, is_there in zip(self._needs, there, strict=True):
            for fact_number in needs:
                cp.add_implication(is_there, met[fact_number])
        for number, (givers, is_met) in enumerate(zip(self._givers, met, strict=True)):
            first = [there[n] for n in givers if number not in self._needs[n]]
            cp.add_bool_or([is_met.negated(), *first])
            model.anywhere.rests_on_any(is_met.index, [unit.index for unit in first])
        for needs, is_there in zip(self._needs, there, strict=True):
            model.anywhere.rests_on_all(is_there.index, [met[fact_number].index for fact_number in needs])
        model.units_anywhere += [*there, *met]
        labels = self.bound.core.labels
        for landmark, weight in zip(self.bound.landmarks, self.bound.weights, strict=True):
            if weight:
                cp.add_bool_or([there[n] for n in labels[landmark.members].tolist()])
        left = set(labels[self.bound.may_be_used(self._limit_us)].tolist())
        for n, is_there in enumerate(there):
            if n not in left:
                cp.add_bool_or([is_there.negated()])


def _hostless(fact: Fact) -> Fact:
    return replace(fact, host=None) if isinstance(fact, Met) else fact
