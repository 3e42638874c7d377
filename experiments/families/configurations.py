"""Running configurations to start from: a valid one that is cheap but not optimal, or one with gaps."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Collection

from cfgplan.costs import start_cost_us
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Transformation,
)
from cfgplan.reasons import Providers

MILLISECONDS = 1000
"""In microseconds, as costs are."""


def cheap_configuration(environment: Environment, similarity: Similarity, horizon_s: int) -> Environment:
    """Return the environment with a valid running configuration: the cheapest chain of units for each demand.

    Chains are compared by h_add (Bonet and Geffner 2001), which counts shared units twice. Every target must be
    satisfiable; `distinct` and `feedback` inputs are not supported.
    """
    providers = Providers(environment.library, similarity)
    feeder = _cheapest_feeders(environment, providers, horizon_s)
    publications: dict[str, list[Publication]] = defaultdict(list)
    ahead: list[str] = []
    for target in environment.targets:
        transformation = environment.transformation[feeder[target.tag]]
        publications[transformation.label].append(
            Publication(_port(transformation, target.tag, similarity), target.topic)
        )
        ahead.append(transformation.label)
    units: dict[str, ComputationUnit] = {}
    while ahead:
        label = ahead.pop()
        if label not in units:
            transformation = environment.transformation[label]
            chosen = {port: environment.transformation[feeder[port.tag]] for port in transformation.inputs}
            units[label] = ComputationUnit(
                f"{label}.1",
                label,
                tuple(_subscription(port, provider, similarity) for port, provider in chosen.items()),
                tuple(publications[label]),
            )
            ahead += [provider.label for provider in chosen.values()]
    return Environment(tuple(units.values()), environment.library, environment.targets)


def wired_where_possible(
    environment: Environment, similarity: Similarity, labels: Collection[str]
) -> tuple[ComputationUnit, ...]:
    """Return a unit of each label. Its inputs are fed by earlier units that match; other inputs are gaps."""
    latest: dict[str, Transformation] = {}
    units = []
    for label in labels:
        transformation = environment.transformation[label]
        subscriptions = []
        for port in transformation.inputs:
            matching = sorted(tag for tag in similarity.offers.get(port.tag, ()) if tag in latest)
            if matching:
                subscriptions.append(_subscription(port, latest[matching[0]], similarity))
        units.append(ComputationUnit(f"{label}.1", label, tuple(subscriptions)))
        latest.update({port.tag: transformation for port in transformation.outputs})
    return tuple(units)


def without(units: Collection[ComputationUnit], dead: Collection[str]) -> tuple[ComputationUnit, ...]:
    """Return the units that remain when the units with the ids `dead` fail; subscriptions to these become gaps."""
    return tuple(
        ComputationUnit(
            unit.id,
            unit.transformation,
            tuple(s for s in unit.subscriptions if s.stream.unit not in dead),
            unit.publications,
        )
        for unit in units
        if unit.id not in dead
    )


def _cheapest_feeders(environment: Environment, providers: Providers, horizon_s: int) -> dict[str, str]:
    """For each demanded tag that can be met the transformation at the end of its cheapest chain (Dijkstra)."""
    demanded = {port.tag for t in environment.library for port in t.inputs} | {t.tag for t in environment.targets}
    demanded_of: dict[str, list[str]] = defaultdict(list)
    for tag in sorted(demanded):
        for label in providers.of(tag):
            demanded_of[label].append(tag)
    waiting: dict[str, list[str]] = defaultdict(list)
    missing: dict[str, int] = {}
    total: dict[str, int] = {}
    heap: list[tuple[int, str]] = []
    for t in environment.library:
        tags = {port.tag for port in t.inputs}
        missing[t.label], total[t.label] = len(tags), start_cost_us(t, horizon_s)
        for tag in tags:
            waiting[tag].append(t.label)
        if not tags:
            heap.append((total[t.label], t.label))
    heapq.heapify(heap)
    feeder: dict[str, str] = {}
    while heap:
        cost, label = heapq.heappop(heap)
        for tag in demanded_of[label]:
            if tag not in feeder:
                feeder[tag] = label
                for consumer in waiting[tag]:
                    missing[consumer] -= 1
                    total[consumer] += cost
                    if missing[consumer] == 0:
                        heapq.heappush(heap, (total[consumer], consumer))
    return feeder


def _subscription(port: InputPort, provider: Transformation, similarity: Similarity) -> Subscription:
    return Subscription(port.name, Stream(f"{provider.label}.1", _port(provider, port.tag, similarity)))


def _port(provider: Transformation, tag: str, similarity: Similarity) -> str:
    return next(port.name for port in provider.outputs if similarity.holds(port.tag, tag))
