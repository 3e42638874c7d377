"""The constraint model of a flat fleet: booleans for labels and facts, grounded by lazily added cuts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from ortools.sat.python.cp_model import CpModel, IntVar, LinearExpr, LinearExprT

from cfgplan.domain import Stream
from cfgplan.planners.exact.flat import Carried, Fact, Flat, Placed
from cfgplan.planners.solving.support import Support


class FlatModel:
    """`uses` says which labels are chosen, `holds` which facts there are, `feeds` by which stream."""

    def __init__(self, flat: Flat, landmarks: Iterable[list[int]]) -> None:
        self.flat = flat
        self.candidates = flat.candidates
        self.environment = flat.candidates.environment
        self.cp = CpModel()
        self.support = Support()
        self.anywhere = Support()
        self.units_anywhere: list[IntVar] = []
        """The booleans of `anywhere`, the support with hosts forgotten, where cuts are fewer and stronger."""
        each = flat.candidates.clock.each
        self.uses = [self.cp.new_bool_var("") for _ in each(flat.labels)]
        self.holds = {fact: self.cp.new_bool_var("") for fact in each(flat.facts)}
        self.feeds: dict[Fact, dict[tuple[int, Stream], IntVar]] = {}
        self.more_costs: list[LinearExprT] = []
        self.runs = {i: [self.uses[place] for place in flat.places(i)] for i in range(len(flat.candidates.all))}

        a_label_needs_its_facts(self)
        for fact in flat.wanted:
            self.cp.add_bool_or([self.holds[fact]])
        for members in landmarks:
            self.cp.add_bool_or([self.uses[label] for label in members])
        a_unit_is_in_one_place(self)
        hosts_bear_their_units(self)
        numbers_and_conflicts_are_kept(self)

    def ground(self) -> None:
        """Let each fact rest on what gives it. Call it when `feeds` is filled."""
        for fact, holds in self.candidates.clock.each(self.holds.items()):
            if fact in self.feeds:
                choices = self.feeds[fact]
                self.cp.add_exactly_one(*choices.values(), holds.negated())
                for (label, _), feeds in choices.items():
                    self.cp.add_implication(feeds, self.uses[label])
                    self.support.rests_on_all(feeds.index, [self.uses[label].index])
                self.support.rests_on_any(holds.index, [feeds.index for feeds in choices.values()])
            first = [label for label in self.flat.givers[fact] if fact not in self.flat.needs[label]]
            self.cp.add_bool_or([holds.negated(), *(self.uses[label] for label in first)])
            if fact not in self.feeds:
                self.support.rests_on_any(holds.index, [self.uses[label].index for label in first])

    def streams(self, fact: Fact) -> list[tuple[Stream, IntVar]]:
        """The streams by which a fact may be met, each with the boolean that says that it is."""
        return [(stream, feeds) for (_, stream), feeds in self.feeds[fact].items()]

    def ways_to_run(self, unit: int) -> list[IntVar]:
        """Booleans one of which holds if the candidate runs."""
        return self.runs[unit]

    def cost(self) -> LinearExprT:
        return LinearExpr.sum([LinearExpr.weighted_sum(self.uses, self.flat.cost_us), *self.more_costs])

    def started(self) -> list[IntVar]:
        """The booleans of new units, one for each host."""
        units = self.candidates.all
        return [run for i, runs in self.runs.items() for run in runs if units[i].running is None]


def a_label_needs_its_facts(model: FlatModel) -> None:
    for uses, needs in model.candidates.clock.each(zip(model.uses, model.flat.needs, strict=True)):
        for fact in needs:
            model.cp.add_implication(uses, model.holds[fact])
        model.support.rests_on_all(uses.index, [model.holds[fact].index for fact in needs])


def a_unit_is_in_one_place(model: FlatModel) -> None:
    """A unit is on one host at most, and its streams are carried to other hosts only."""
    number = model.flat.number
    for runs in model.runs.values():
        if len(runs) > 1:
            model.cp.add_at_most_one(runs)
    for label, uses in model.candidates.clock.each(zip(model.flat.labels, model.uses, strict=True)):
        here = number.get(Placed(label.unit, label.host)) if isinstance(label, Carried) else None
        if here is not None:
            model.cp.add_at_most_one(uses, model.uses[here])


def hosts_bear_their_units(model: FlatModel) -> None:
    placed = [(n, label) for n, label in enumerate(model.flat.labels) if isinstance(label, Placed)]
    units = model.candidates.all
    for host in model.environment.hosts:
        there = [(n, label.unit) for n, label in placed if label.host == host.name]
        here = [(model.uses[n], units[unit].places[host.name].takes) for n, unit in there]
        for resource in sorted({resource for _, takes in here for resource in takes}):
            room = host.room(resource)
            if room is not None:
                model.cp.add(sum(takes.get(resource, 0) * uses for uses, takes in here) <= room)


def numbers_and_conflicts_are_kept(model: FlatModel) -> None:
    runs_of: dict[str, list[IntVar]] = defaultdict(list)
    units = model.candidates.all
    for i, runs in model.candidates.clock.each(model.runs.items()):
        runs_of[units[i].transformation.label] += runs
        alike = i and units[i].running is None and units[i - 1].running is None
        if alike and units[i].transformation.label == units[i - 1].transformation.label:
            model.cp.add(LinearExpr.sum(runs) <= LinearExpr.sum(model.runs[i - 1]))
    for t in model.environment.library:
        if t.min_instances:
            model.cp.add(LinearExpr.sum(runs_of[t.label]) >= t.min_instances)
        if t.max_instances is not None and len(runs_of[t.label]) > t.max_instances:
            model.cp.add(LinearExpr.sum(runs_of[t.label]) <= t.max_instances)
        for other in t.conflicts:
            if other != t.label:
                for one in runs_of.get(t.label, ()):
                    for second in runs_of.get(other, ()):
                        model.cp.add_at_most_one(one, second)
