"""From the true booleans of a solution to units with their subscriptions and topics."""

from __future__ import annotations

from collections import defaultdict

from cfgplan.domain import ComputationUnit, InputPort, Publication, Stream, Subscription
from cfgplan.planners.cpsat.model import Model


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
        topics[publisher].append(Publication(_port(model, publisher, target.tag, target.topic), target.topic))
    ahead = sorted(topics.keys() | {i for i, c in enumerate(site.candidates) if c.running and c.transformation.pinned})
    units: dict[int, ComputationUnit] = {}
    for i in ahead:
        if i in units:
            continue
        candidate = site.candidates[i]
        streams = {port.name: _stream(model, i, port, true, rank) for port in candidate.transformation.inputs}
        subscriptions = tuple(Subscription(name, stream) for name, stream in streams.items() if stream is not None)
        if len(subscriptions) < len(streams) or model.runs[i].index not in rank:
            return None
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


def _port(model: Model, publisher: int, tag: str, topic: str) -> str:
    """The output to publish on the topic: the one that does already, if it matches."""
    candidate = model.site.candidates[publisher]
    for publication in candidate.running.publications if candidate.running else ():
        output = candidate.transformation.output.get(publication.port)
        if publication.topic == topic and output and model.site.problem.similarity.holds(output.tag, tag):
            return publication.port
    return model.site.port_for(publisher, tag)


def _stream(model: Model, unit: int, port: InputPort, true: set[int], rank: dict[int, int]) -> Stream | None:
    """The stream to feed an input with, None if no feeder is grounded (and before it where it must be)."""
    site = model.site
    if (unit, port.name) in model.connects:
        feeders = [f for f, connected in model.connects[unit, port.name].items() if connected.index in true]
    else:
        place = rank.get(model.runs[unit].index, 0)
        feeders = [
            f
            for f in site.feeders(port.tag)
            if rank.get(model.runs[f].index, len(rank)) < (len(rank) if port.feedback else place)
        ]
    running = site.candidates[unit].running
    old = running.feeds.get(port.name) if running else None
    if old is not None and site.index_of.get(old.unit) in feeders:
        output = site.candidates[site.index_of[old.unit]].transformation.output.get(old.port)
        if output is not None and site.problem.similarity.holds(output.tag, port.tag):
            return old
    return Stream(site.candidates[feeders[0]].id, site.port_for(feeders[0], port.tag)) if feeders else None
