"""From a solution of the flat model to units with their wiring."""

from __future__ import annotations

from collections.abc import Callable

from ortools.sat.python.cp_model import IntVar

from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription
from cfgplan.planners.exact.decode import lean, named
from cfgplan.planners.exact.flat import Met
from cfgplan.planners.exact.flat_model import FlatModel


def decoded(model: FlatModel, holds: Callable[[IntVar], bool]) -> list[ComputationUnit] | None:
    """The units of a solution; None if what is wanted or asked for is not grounded."""
    rank = model.support.grounded(true_of(model, holds))
    flat, candidates = model.flat, model.candidates
    wanted = [*flat.wanted]
    for i, runs in model.runs.items():
        if candidates.all[i].transformation.min_instances and any(holds(run) for run in runs):
            wanted += flat.needs[next(n for n in flat.places(i) if holds(model.uses[n]))]
    if any(model.holds[fact].index not in rank for fact in wanted):
        return None
    topics: dict[str, list[Publication]] = {}
    for target in candidates.environment.targets:
        stream = _stream(model, Met(target.tag, target.host), holds, rank)
        topics.setdefault(stream.unit, []).append(Publication(stream.port, target.topic))
    units = []
    for i in model.runs:
        place = next((n for n in flat.places(i) if model.uses[n].index in rank), None)
        if place is None:
            continue
        candidate, host = candidates.all[i], flat.labels[place].host
        subscriptions = tuple(
            Subscription(port.name, _stream(model, Met(port.tag, host), holds, rank))
            for port in candidate.transformation.inputs
        )
        published = tuple(topics.get(candidate.id, ()))
        units.append(ComputationUnit(candidate.id, candidate.transformation.label, subscriptions, published, host))
    return named(candidates, lean(candidates, units))


def true_of(model: FlatModel, holds: Callable[[IntVar], bool]) -> set[int]:
    """The indices of the booleans that hold, but for those that support nothing."""
    literals = [*model.uses, *model.holds.values(), *model.units_anywhere]
    literals += [feeds for choices in model.feeds.values() for feeds in choices.values()]
    return {literal.index for literal in literals if holds(literal)}


def _stream(model: FlatModel, fact: Met, holds: Callable[[IntVar], bool], rank: dict[int, int]) -> Stream:
    """The stream that meets a grounded fact: the one chosen, or else the first in the order of derivation."""
    if fact in model.feeds:
        return next(stream for stream, feeds in model.streams(fact) if holds(feeds))
    givers = model.flat.givers[fact]
    label = min(
        (label for label in givers if model.uses[label].index in rank),
        key=lambda label: rank[model.uses[label].index],
    )
    return givers[label][0]
