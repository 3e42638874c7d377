"""A wiring for a given choice of units, without search: whatever can stay as it is stays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable

from cfgplan.domain import ComputationUnit, InputPort, Publication, Stream, Subscription
from cfgplan.planners.networks.site import Site
from cfgplan.reasons import assign_different, distinct_groups


def wire(site: Site, chosen: Collection[int]) -> list[ComputationUnit] | None:
    """The chosen candidates wired, less those that nothing needs; None if they do not ground each other."""
    order = _grounded_order(site, chosen)
    publisher = {
        target.topic: _publisher(site, target.tag, target.topic, chosen) for target in site.environment.targets
    }
    if order is None or None in publisher.values():
        return None
    topics: dict[int, list[Publication]] = defaultdict(list)
    for target in site.environment.targets:
        who = publisher[target.topic]
        assert who is not None
        topics[who].append(Publication(published_port(site, who, target.tag, target.topic), target.topic))
    pinned = [i for i in chosen if site.is_kept_pinned(i)]
    ahead = sorted({*topics, *pinned})
    units: dict[int, ComputationUnit] = {}
    for i in ahead:
        if i not in units:
            candidate = site.candidates[i]
            subscriptions = tuple(
                Subscription(port.name, fed_stream(site, i, port, [feeder]))
                for port in candidate.transformation.inputs
                for feeder in [order[i][port.name]]
            )
            units[i] = ComputationUnit(candidate.id, candidate.transformation.label, subscriptions, tuple(topics[i]))
            ahead += order[i].values()
    return list(units.values())


def forced_changes(site: Site, chosen: Collection[int]) -> int:
    """How many of the chosen running units must be rewired, whatever the wiring."""
    kept = {site.candidates[i].id for i in chosen}
    return sum(
        candidate.running is not None
        and not (candidate.may_stay and all(s.stream.unit in kept for s in candidate.running.subscriptions))
        for candidate in (site.candidates[i] for i in chosen)
    )


def fed_stream(site: Site, unit: int, port: InputPort, feeders: Iterable[int]) -> Stream:
    """The stream by which the first of `feeders` feeds an input; the one it has already, if one of them gives it."""
    feeders = list(feeders)
    running = site.candidates[unit].running
    old = running.feeds.get(port.name) if running else None
    if old is not None and site.index_of.get(old.unit) in feeders and site.gives(old, port.tag):
        return old
    return Stream(site.candidates[feeders[0]].id, site.port_for(feeders[0], port.tag))


def published_port(site: Site, publisher: int, tag: str, topic: str) -> str:
    """The output to publish on the topic: the one that does already, if it matches."""
    candidate = site.candidates[publisher]
    for publication in candidate.running.publications if candidate.running else ():
        if publication.topic == topic and site.gives(Stream(candidate.id, publication.port), tag):
            return publication.port
    return site.port_for(publisher, tag)


def _publisher(site: Site, tag: str, topic: str, chosen: Collection[int]) -> int | None:
    """Who publishes the topic: a unit that does already and may stay, else one that has to change anyway."""

    def reluctance(feeder: int) -> tuple[bool, bool, int]:
        candidate = site.candidates[feeder]
        publishes = candidate.running is not None and any(p.topic == topic for p in candidate.running.publications)
        return not publishes, candidate.may_stay != publishes, feeder

    return min((feeder for feeder in site.feeders(tag) if feeder in chosen), key=reluctance, default=None)


def _grounded_order(site: Site, chosen: Collection[int]) -> dict[int, dict[str, int]] | None:
    """Units from sources on, each with the feeder of each input; units that can stay come first."""
    placed: dict[int, dict[str, int]] = {}
    waiting = sorted(chosen)
    while waiting:
        staying = [(i, feeds) for i in waiting if (feeds := _old_feeds(site, i, placed, chosen)) is not None]
        wired = staying or [(i, feeds) for i in waiting if (feeds := _new_feeds(site, i, placed, chosen)) is not None]
        if not wired:
            return None
        ready = wired if staying else _unable_to_stay(site, wired, chosen)
        placed.update(ready)
        waiting = [i for i in waiting if i not in placed]
    return placed


def _unable_to_stay(
    site: Site, ready: list[tuple[int, dict[str, int]]], chosen: Collection[int]
) -> list[tuple[int, dict[str, int]]]:
    """All of them that have to change anyway, else the first."""
    changing = [
        (i, feeds)
        for i, feeds in ready
        if not site.candidates[i].may_stay
        or any(site.index_of.get(s.stream.unit) not in chosen for s in site.old_subscriptions(i))
    ]
    return changing or ready[:1]


def _old_feeds(site: Site, unit: int, placed: Collection[int], chosen: Collection[int]) -> dict[str, int] | None:
    """The present feeders of a unit that may stay, if they are there before it."""
    candidate = site.candidates[unit]
    if not candidate.may_stay:
        return None
    feeds = {s.port: site.index_of[s.stream.unit] for s in site.old_subscriptions(unit)}
    for port in candidate.transformation.inputs:
        if feeds[port.name] not in (chosen if port.feedback else placed):
            return None
    return feeds


def _new_feeds(site: Site, unit: int, placed: Collection[int], chosen: Collection[int]) -> dict[str, int] | None:
    """A feeder for each input of a unit among those before it, the present one if possible; None if one has none."""
    transformation = site.candidates[unit].transformation
    old = {s.port: site.index_of.get(s.stream.unit) for s in site.old_subscriptions(unit)}
    choices: dict[str, list[int]] = {}
    for port in transformation.inputs:
        among = chosen if port.feedback else placed
        feeders = sorted(i for i in site.feeders(port.tag) if i in among)
        if not feeders:
            return None
        present = old.get(port.name)
        if present in feeders:
            feeders.remove(present)
            feeders.insert(0, present)
        choices[port.name] = feeders
    feeds = {name: feeders[0] for name, feeders in choices.items()}
    for group in distinct_groups(transformation):
        first = {
            port.name: {site.candidates[i].transformation.label: i for i in reversed(choices[port.name])}
            for port in group
        }
        assigned = assign_different({name: list(by_label)[::-1] for name, by_label in first.items()})
        if assigned is None:
            return None
        feeds.update({name: first[name][label] for name, label in assigned.items()})
    return feeds
