"""From the true booleans of a solution to units with their subscriptions and topics."""

from __future__ import annotations

from collections import defaultdict

from cfgplan.domain import ComputationUnit, InputPort, Publication, Subscription
from cfgplan.planners.cpsat.model import Model
from cfgplan.planners.networks.wiring import fed_stream, published_port


def decode(model: Model, true: set[int], rank: dict[int, int]) -> list[ComputationUnit] | None:
    """The units of a solution that targets and pinned units need, wired; None if one of them is not grounded.

    `true` holds the indices of the true booleans, `rank` their order of derivation from sources.
    Units keep the streams they have wherever these are still there.
    """
    site = model.site
    topics: dict[int, list[Publication]] = defaultdict(list)
    for target in site.environment.targets:
        publisher = _publisher(model, target.label, target.tag, true, rank)
        if publisher is None:
            return None
        topics[publisher].append(Publication(published_port(site, publisher, target.tag, target.topic), target.topic))
    ahead = sorted(topics.keys() | set(filter(site.is_kept_pinned, range(len(site.candidates)))))
    units: dict[int, ComputationUnit] = {}
    for i in ahead:
        if i in units:
            continue
        candidate = site.candidates[i]
        feeders = {port: _feeders(model, i, port, true, rank) for port in candidate.transformation.inputs}
        if model.runs[i].index not in rank or not all(feeders.values()):
            return None
        subscriptions = tuple(Subscription(port.name, fed_stream(site, i, port, feeders[port])) for port in feeders)
        units[i] = ComputationUnit(candidate.id, candidate.transformation.label, subscriptions, tuple(topics[i]))
        ahead += [site.index_of[s.stream.unit] for s in subscriptions]
    return list(units.values())


def _publisher(model: Model, target: str, tag: str, true: set[int], rank: dict[int, int]) -> int | None:
    others = []
    for feeder in model.site.feeders(tag):
        if (target, feeder) in model.publishes:
            if model.publishes[target, feeder].index in true:
                return feeder if model.runs[feeder].index in rank else None
        elif model.runs[feeder].index in rank:
            others.append(feeder)
    return min(others, default=None)


def _feeders(model: Model, unit: int, port: InputPort, true: set[int], rank: dict[int, int]) -> list[int]:
    """Who may feed an input: the feeder connected, or else all that are grounded (before it where they must be)."""
    if (unit, port.name) in model.connects:
        return [f for f, connected in model.connects[unit, port.name].items() if connected.index in true]
    limit = len(rank) if port.feedback else rank.get(model.runs[unit].index, 0)
    return [f for f in model.site.feeders(port.tag) if rank.get(model.runs[f].index, len(rank)) < limit]
