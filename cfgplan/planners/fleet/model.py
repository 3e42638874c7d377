"""The constraint model of a fleet: which units are there, where, and who feeds whom.

What makes a fleet differ from the paper's problem is that the wiring's identity matters: it decides
quality and transfers. So every possible subscription has a boolean of its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from ortools.sat.python.cp_model import CpModel, IntVar, LinearExpr, LinearExprT

from cfgplan.domain import Publication, Stream
from cfgplan.planners.fleet.candidates import Candidates

Port = tuple[int, str]
"""A candidate and the name of one of its ports."""


class Model:
    """The booleans of a fleet's model; units are indices of the candidates, streams and ports by name."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        self.problem = candidates.problem
        self.environment = candidates.environment
        self.cp = CpModel()
        self.true = self.cp.new_constant(1)
        numbered = list(enumerate(candidates.all))
        self.runs = {i: self.boolean() for i, c in numbered if c.may_run}
        self.waits = {i: self.boolean() for i, c in numbered if c.may_wait}
        self.is_there = {i: self.presence(i) for i, _ in numbered}
        self.is_on = {i: self.places(i) for i, _ in numbered}
        self.connects: dict[Port, dict[Stream, IntVar]] = {}
        self.publishes: dict[str, dict[Stream, IntVar]] = {}
        self.rewired: dict[int, IntVar] = {}
        self.serves: dict[int, IntVar] = {}
        self.uses_required: dict[str, IntVar] = {}
        self.more_costs: list[LinearExprT] = []

        a_running_unit_is_fed_at_every_input(self)
        a_target_has_one_stream(self)
        units_feed_each_other_in_no_ring(self)
        inputs_of_a_group_are_fed_by_different_transformations(self)
        pinned_units_run(self)
        a_unit_that_keeps_its_wiring_is_not_rewired(self)
        required_transformations_serve_a_target(self)
        new_units_come_in_order(self)

    def boolean(self) -> IntVar:
        self.candidates.watch()
        return self.cp.new_bool_var("")

    def presence(self, unit: int) -> IntVar:
        """Whether a candidate is there at all, running or waiting."""
        states = [state[unit] for state in (self.runs, self.waits) if unit in state]
        if len(states) == 1:
            return states[0]
        there = self.boolean()
        self.cp.add_exactly_one(*states, there.negated())
        return there

    def places(self, unit: int) -> dict[str | None, IntVar]:
        """Whether a candidate is on each of its hosts."""
        hosts = self.candidates.all[unit].hosts
        if len(hosts) == 1:
            return {hosts[0]: self.is_there[unit]}
        found = {host: self.boolean() for host in hosts}
        self.cp.add_exactly_one(*found.values(), self.is_there[unit].negated())
        return found

    def needs_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        self.cp.add_bool_or([literal.negated(), *choices])

    def ways_to_run(self, unit: int) -> list[IntVar]:
        """Booleans one of which holds if the candidate runs."""
        return [self.runs[unit]]

    def cost(self) -> LinearExprT:
        """Labor, upkeep and standby, and what the other rooms have added."""
        candidates = self.candidates.all
        terms: list[LinearExprT] = [candidates[i].cost_us * runs for i, runs in self.runs.items()]
        terms += [candidates[i].waiting_cost_us * waits for i, waits in self.waits.items()]
        return LinearExpr.sum([*terms, *self.more_costs])

    def changes(self) -> LinearExprT:
        """Rewired kept units, then started ones: one rewired unit outweighs all that can be started."""
        started = [there for i, there in self.is_there.items() if self.candidates.all[i].running is None]
        return (len(started) + 1) * LinearExpr.sum(list(self.rewired.values())) + LinearExpr.sum(started)


def a_running_unit_is_fed_at_every_input(model: Model) -> None:
    for i, runs in model.runs.items():
        for port in model.candidates.all[i].transformation.inputs:
            choices = model.connects[i, port.name] = {}
            for stream in model.candidates.streams(port.tag):
                feeder = model.candidates.index_of[stream.unit]
                if feeder != i or port.feedback:
                    choices[stream] = model.boolean()
                    model.cp.add_implication(choices[stream], model.runs[feeder])
            model.cp.add_exactly_one(*choices.values(), runs.negated())


def a_target_has_one_stream(model: Model) -> None:
    for target in model.environment.targets:
        choices = model.publishes[target.topic] = {}
        for stream in model.candidates.streams(target.tag):
            choices[stream] = model.boolean()
            model.cp.add_implication(choices[stream], model.runs[model.candidates.index_of[stream.unit]])
        model.cp.add_exactly_one(choices.values())


def units_feed_each_other_in_no_ring(model: Model) -> None:
    """What feeds comes before what it feeds, but for feedback; only units that may be on a ring are numbered."""
    ring_of = _rings(model)
    sizes: dict[int, int] = defaultdict(int)
    for ring in ring_of.values():
        sizes[ring] += 1
    level = {i: model.cp.new_int_var(0, sizes[ring] - 1, "") for i, ring in ring_of.items() if sizes[ring] > 1}
    for i, feeder, connected in _ordinary_connections(model):
        model.candidates.watch()
        if i in level and ring_of[i] == ring_of[feeder]:
            model.cp.add(level[i] > level[feeder]).only_enforce_if(connected)


def inputs_of_a_group_are_fed_by_different_transformations(model: Model) -> None:
    candidates = model.candidates
    for i in model.runs:
        sharing: dict[tuple[str, str], list[IntVar]] = defaultdict(list)
        for port in candidates.all[i].transformation.inputs:
            if port.distinct is not None:
                for stream, connected in model.connects[i, port.name].items():
                    feeder = candidates.all[candidates.index_of[stream.unit]]
                    sharing[port.distinct, feeder.transformation.label].append(connected)
        for connections in sharing.values():
            model.cp.add_at_most_one(connections)


def pinned_units_run(model: Model) -> None:
    for i, runs in model.runs.items():
        if model.candidates.is_pinned(i):
            model.cp.add(runs == 1)


def a_unit_that_keeps_its_wiring_is_not_rewired(model: Model) -> None:
    topics = {target.topic for target in model.environment.targets}
    for i, runs in model.runs.items():
        unit = model.candidates.all[i].running
        if unit is None:
            continue
        rewired = model.rewired[i] = model.boolean()
        model.cp.add_implication(rewired, runs)
        kept = [(model.connects.get((i, s.port), {}).get(s.stream)) for s in unit.subscriptions]
        kept += [model.publishes.get(p.topic, {}).get(Stream(unit.id, p.port)) for p in unit.publications]
        is_whole = {port.name for port in model.candidates.all[i].transformation.inputs} == set(unit.feeds)
        if not is_whole or any(p.topic not in topics for p in unit.publications):
            kept = [None]
        for old in kept:
            model.needs_any(runs, [rewired] if old is None else [rewired, old])
        for topic in sorted(topics):
            for stream, publishes in model.publishes[topic].items():
                if stream.unit == unit.id and Publication(stream.port, topic) not in unit.publications:
                    model.cp.add_implication(publishes, rewired)


def required_transformations_serve_a_target(model: Model) -> None:
    """A unit serves a target that it publishes, or through a unit that it feeds and that serves one.

    The distance to the target grows along the way, or two units could serve through each other's feedback inputs.
    """
    candidates = model.candidates
    tracked = _downstream_of_required(candidates)
    distance = {i: model.cp.new_int_var(0, len(tracked), "") for i in tracked}
    ways: dict[int, list[IntVar]] = {i: [] for i in tracked}
    model.serves = {i: model.boolean() for i in tracked}
    for choices in model.publishes.values():
        for stream, publishes in choices.items():
            if candidates.index_of[stream.unit] in ways:
                ways[candidates.index_of[stream.unit]].append(publishes)
    for (consumer, _), choices in model.connects.items():
        candidates.watch()
        for stream, connected in choices.items():
            feeder = candidates.index_of[stream.unit]
            if feeder in ways and consumer in ways:
                through = model.boolean()
                ways[feeder].append(through)
                model.cp.add_implication(through, connected)
                model.cp.add_implication(through, model.serves[consumer])
                model.cp.add(distance[feeder] > distance[consumer]).only_enforce_if(through)
    serving: dict[str, list[IntVar]] = defaultdict(list)
    for i, choices_of in ways.items():
        model.needs_any(model.serves[i], choices_of)
        if candidates.all[i].transformation.required:
            serving[candidates.all[i].transformation.label].append(model.serves[i])
    for label, units in serving.items():
        model.uses_required[label] = model.boolean()
        model.needs_any(model.uses_required[label], units)


def new_units_come_in_order(model: Model) -> None:
    """Of several new units of a transformation the first ones are taken: they are all alike."""
    candidates = model.candidates.all
    for i in range(1, len(candidates)):
        one, next_one = candidates[i - 1], candidates[i]
        if one.transformation == next_one.transformation and one.running is None and next_one.running is None:
            model.cp.add_implication(model.is_there[i], model.is_there[i - 1])


def _ordinary_connections(model: Model) -> list[tuple[int, int, IntVar]]:
    """Every possible subscription at an input that is not for feedback: who is fed, who feeds."""
    return [
        (i, model.candidates.index_of[stream.unit], connected)
        for (i, name), choices in model.connects.items()
        if not model.candidates.all[i].transformation.input[name].feedback
        for stream, connected in choices.items()
    ]


def _rings(model: Model) -> dict[int, int]:
    """For each unit the number of its strongly connected component under possible feeding."""
    from networkx import DiGraph, strongly_connected_components

    graph: DiGraph[int] = DiGraph()
    graph.add_nodes_from(model.runs)
    graph.add_edges_from((feeder, i) for i, feeder, _ in _ordinary_connections(model))
    return {i: number for number, ring in enumerate(strongly_connected_components(graph)) for i in ring}


def _downstream_of_required(candidates: Candidates) -> list[int]:
    """The running candidates of required transformations and all that they may feed, directly or through others."""
    runnable = [i for i, candidate in enumerate(candidates.all) if candidate.may_run]
    found = {i for i in runnable if candidates.all[i].transformation.required}
    grew = bool(found)
    while grew:
        new = {
            i
            for i in runnable
            if i not in found
            and any(not found.isdisjoint(candidates.feeders(p.tag)) for p in candidates.all[i].transformation.inputs)
        }
        found |= new
        grew = bool(new)
    return sorted(found)
