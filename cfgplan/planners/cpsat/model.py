"""The constraint model of an update: booleans, and one function for each rule.

Booleans say which candidate units run, which of them stay as they are, and who publishes each target.
Inputs that do not care who feeds them share one boolean for each demanded tag (a hub), so that the
model grows with the ports and not with inputs times outputs; connections have booleans of their own
only where the feeder's identity matters.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence

from ortools.sat.python.cp_model import CpModel, IntVar, LinearExprT

from cfgplan.domain import InputPort
from cfgplan.planners.networks.site import Site
from cfgplan.planners.solving.engine import at_least
from cfgplan.planners.solving.support import Support


class Model:
    """The booleans of a site's model; units and ports are indices of the site's candidates and port names."""

    def __init__(self, site: Site, watch: Callable[[], None] = lambda: None) -> None:
        """`watch` is called again and again while the model is built, and can end that by an exception."""
        self.site = site
        self.watch = watch
        self.cp = CpModel()
        self.support = Support()
        self.literals: list[IntVar] = []
        self.runs = [self.boolean() for _ in site.candidates]
        self.stays = {i: self.boolean() for i, c in enumerate(site.candidates) if c.may_stay}
        self.is_wired = {i: self.boolean() if i in self.stays else self.runs[i] for i in range(len(site.candidates))}
        self.hubs: dict[tuple[int, ...], IntVar] = {}
        self.connects: dict[tuple[int, str], dict[int, IntVar]] = {}
        self.publishes: dict[tuple[str, int], IntVar] = {}
        self.serves: dict[int, IntVar] = {}
        self.uses_required: dict[str, IntVar] = {}
        self.tracked = _downstream_of_required(site, watch)

        a_kept_unit_stays_or_is_wired_anew(self)
        a_staying_unit_keeps_its_feeders_and_topics(self)
        a_wired_unit_is_fed(self)
        a_hub_is_fed_by_a_unit_that_does_not_need_it(self)
        a_target_is_published_by_one_unit(self)
        pinned_units_run(self)
        required_transformations_serve_a_target(self)

    def boolean(self) -> IntVar:
        literal = self.cp.new_bool_var("")
        self.literals.append(literal)
        return literal

    def needs_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        self.cp.add_bool_or([literal.negated(), *choices])

    def rests_on_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        """The literal needs one of the choices, and one that comes before it."""
        self.needs_any(literal, choices)
        self.support.rests_on_any(literal.index, [choice.index for choice in choices])

    def rests_on_all(self, literal: IntVar, parts: Iterable[IntVar]) -> None:
        """The literal needs all parts, and all before it."""
        parts = list(parts)
        for part in parts:
            self.cp.add_implication(literal, part)
        self.support.rests_on_all(literal.index, [part.index for part in parts])

    def hub(self, tag: str) -> IntVar:
        """The boolean that some running unit offers what the tag demands; equal demands share it."""
        feeders = self.site.feeders(tag)
        if feeders not in self.hubs:
            self.hubs[feeders] = self.boolean()
        return self.hubs[feeders]

    def is_explicit(self, unit: int, port: InputPort) -> bool:
        """Whether it matters who feeds the input: a distinct one, or one that a required unit could reach."""
        return port.distinct is not None or (
            unit in self.tracked and not self.tracked.isdisjoint(self.site.feeders(port.tag))
        )

    def enough_of_each_run(self, landmarks: Iterable[tuple[Iterable[str], int]]) -> None:
        """Every plan has so many transformations of each landmark, or more; each counts as often as it is named."""
        units = self.site.units_of
        for labels, least in landmarks:
            at_least(self.cp, least, [self.runs[i] for label in labels for i in units.get(label, ())])

    def cost(self) -> LinearExprT:
        return sum(c.cost_us * x for c, x in zip(self.site.candidates, self.runs, strict=True))

    def changes(self) -> LinearExprT:
        """Rewired kept units, then started ones: one rewired unit outweighs all that can be started."""
        candidates = self.site.candidates
        started = [self.runs[i] for i, c in enumerate(candidates) if c.running is None]
        rewired = [self.is_wired[i] for i, c in enumerate(candidates) if c.running is not None]
        return (len(started) + 1) * sum(rewired) + sum(started)


def a_kept_unit_stays_or_is_wired_anew(model: Model) -> None:
    for i, runs in enumerate(model.runs):
        if i in model.stays:
            model.cp.add_exactly_one(model.stays[i], model.is_wired[i], runs.negated())
            model.support.rests_on_any(runs.index, [model.stays[i].index, model.is_wired[i].index])


def a_staying_unit_keeps_its_feeders_and_topics(model: Model) -> None:
    """A unit stays if its feeders run, grounded before it except at feedback inputs; for topics see targets."""
    index_of = model.site.index_of
    for i, stays in model.stays.items():
        candidate = model.site.candidates[i]
        assert candidate.running is not None
        feeds = candidate.running.feeds
        ports = candidate.transformation.inputs
        model.rests_on_all(stays, (model.runs[index_of[feeds[p.name].unit]] for p in ports if not p.feedback))
        for port in ports:
            if port.feedback:
                model.cp.add_implication(stays, model.runs[index_of[feeds[port.name].unit]])


def a_wired_unit_is_fed(model: Model) -> None:
    """Through hubs, or explicitly; feedback inputs by any running unit, distinct ones by different transformations."""
    for i, wired in model.is_wired.items():
        model.watch()
        parts = []
        for port in model.site.candidates[i].transformation.inputs:
            if model.is_explicit(i, port):
                parts += an_explicit_input_has_one_feeder(model, i, port)
            elif port.feedback:
                model.needs_any(wired, [model.runs[f] for f in model.site.feeders(port.tag)])
            else:
                parts.append(model.hub(port.tag))
        inputs_of_a_group_are_fed_by_different_transformations(model, i)
        model.rests_on_all(wired, parts)


def an_explicit_input_has_one_feeder(model: Model, unit: int, port: InputPort) -> list[IntVar]:
    """Connection booleans of an input; returns what the unit's wiring then rests on."""
    connects = {feeder: model.boolean() for feeder in model.site.feeders(port.tag)}
    model.connects[unit, port.name] = connects
    model.cp.add_exactly_one(*connects.values(), model.runs[unit].negated())
    running = model.site.candidates[unit].running
    if unit in model.stays and running is not None:
        kept = connects[model.site.index_of[running.feeds[port.name].unit]]
        model.cp.add_implication(model.stays[unit], kept)
    if port.feedback:
        for feeder, connected in connects.items():
            model.cp.add_implication(connected, model.runs[feeder])
        return []
    for feeder, connected in connects.items():
        model.rests_on_all(connected, [model.runs[feeder]])
    fed = model.boolean()
    model.rests_on_any(fed, list(connects.values()))
    return [fed]


def inputs_of_a_group_are_fed_by_different_transformations(model: Model, unit: int) -> None:
    sharing: dict[tuple[str, str], list[IntVar]] = defaultdict(list)
    for port in model.site.candidates[unit].transformation.inputs:
        if port.distinct is not None:
            for feeder, connected in model.connects[unit, port.name].items():
                sharing[port.distinct, model.site.candidates[feeder].transformation.label].append(connected)
    for connections in sharing.values():
        if len(connections) > 1:
            model.cp.add_at_most_one(connections)


def a_hub_is_fed_by_a_unit_that_does_not_need_it(model: Model) -> None:
    """The first unit to offer a tag can't itself need that tag."""
    needing: dict[int, set[int]] = defaultdict(set)
    for i, candidate in enumerate(model.site.candidates):
        model.watch()
        for port in candidate.transformation.inputs:
            feeders = model.site.feeders(port.tag)
            if not port.feedback and feeders in model.hubs:
                needing[model.hubs[feeders].index].add(i)
    for feeders, hub in model.hubs.items():
        model.watch()
        model.rests_on_any(hub, [model.runs[f] for f in feeders if f not in needing[hub.index]])


def a_target_is_published_by_one_unit(model: Model) -> None:
    """A staying unit publishes exactly what it published before."""
    for target in model.site.environment.targets:
        publishers: list[IntVar] = []
        others: list[IntVar] = []
        for feeder in model.site.feeders(target.tag):
            running = model.site.candidates[feeder].running
            if running is None and feeder not in model.tracked:
                others.append(model.runs[feeder])
                continue
            publishes = model.publishes[target.label, feeder] = model.boolean()
            publishers.append(publishes)
            model.rests_on_all(publishes, [model.runs[feeder]])
            if running is not None and feeder in model.stays:
                keeps = any(publication.topic == target.topic for publication in running.publications)
                stays = model.stays[feeder]
                model.cp.add_implication(stays, publishes if keeps else publishes.negated())
        if others:
            publishers.append(model.boolean())
            model.rests_on_any(publishers[-1], others)
        met = model.boolean()
        model.rests_on_any(met, publishers)
        model.cp.add_exactly_one(publishers)
        model.cp.add(met == 1)


def pinned_units_run(model: Model) -> None:
    for i, runs in enumerate(model.runs):
        if model.site.is_kept_pinned(i):
            model.cp.add(runs == 1)


def required_transformations_serve_a_target(model: Model) -> None:
    """A unit serves a target that it publishes, or through a unit that it feeds and that serves one.

    The distance to the target grows along the way, or two units could serve through each other's
    feedback inputs.
    """
    site = model.site
    distance = {i: model.cp.new_int_var(0, len(model.tracked), "") for i in model.tracked}
    ways: dict[int, list[IntVar]] = {i: [] for i in sorted(model.tracked)}
    for i in sorted(model.tracked):
        model.serves[i] = model.boolean()
    for (_, publisher), publishes in model.publishes.items():
        if publisher in ways:
            ways[publisher].append(publishes)
    for (consumer, _), connects in model.connects.items():
        model.watch()
        for feeder, connected in connects.items():
            if feeder in ways and consumer in ways:
                through = model.boolean()
                ways[feeder].append(through)
                model.cp.add_implication(through, connected)
                model.cp.add_implication(through, model.serves[consumer])
                model.cp.add(distance[feeder] > distance[consumer]).only_enforce_if(through)
    for i, choices in ways.items():
        model.needs_any(model.serves[i], choices)
        model.cp.add_implication(model.serves[i], model.runs[i])
    units: dict[str, list[IntVar]] = defaultdict(list)
    for i in sorted(model.tracked):
        if site.candidates[i].transformation.required:
            units[site.candidates[i].transformation.label].append(model.serves[i])
    for label, serving in units.items():
        model.uses_required[label] = model.boolean()
        model.needs_any(model.uses_required[label], serving)


def _downstream_of_required(site: Site, watch: Callable[[], None]) -> frozenset[int]:
    """The units of required transformations and all that they may feed, directly or through others."""
    ahead = [i for i, candidate in enumerate(site.candidates) if candidate.transformation.required]
    if not ahead:
        return frozenset()
    needing: dict[str, list[int]] = defaultdict(list)
    for i, candidate in enumerate(site.candidates):
        for port in candidate.transformation.inputs:
            needing[port.tag].append(i)
    fed_by: dict[int, list[str]] = defaultdict(list)
    for tag in needing:
        watch()
        for feeder in site.feeders(tag):
            fed_by[feeder].append(tag)
    found = set(ahead)
    for i in ahead:
        for tag in fed_by[i]:
            new = [consumer for consumer in needing.pop(tag, ()) if consumer not in found]
            found.update(new)
            ahead += new
    return frozenset(found)
