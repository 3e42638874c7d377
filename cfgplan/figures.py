"""Figures of a configuration: the parts of its cost, the quality of targets, the load of hosts, transfers.

Planners and output use them; the judge computes its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from cfgplan.costs import keep_cost_us, labor_us, standby_cost_us, taken, transfer_cost_us
from cfgplan.domain import (
    CPU,
    MEMORY,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Link,
    Objective,
    Stream,
    Transformation,
)
from cfgplan.planning import Problem
from cfgplan.qualities import QualityAttribute, delayed, price_us, propagated
from cfgplan.summary import counted, cpu

_COUNTED = {
    Objective.UNITS: "running unit",
    Objective.HOSTS: "host",
    Objective.REWIRED: "rewired unit",
    Objective.STARTED: "started unit",
}


@dataclass(frozen=True, slots=True)
class CostParts:
    """The cost of an update over the horizon by category, in microseconds of CPU time."""

    labor_us: int
    upkeep_us: int
    standby_us: int = 0
    transfer_us: int = 0
    quality_us: int = 0
    rent_us: int = 0
    unfed_us: int = 0

    @property
    def total_us(self) -> int:
        kept_us = self.upkeep_us + self.standby_us + self.transfer_us + self.rent_us + self.unfed_us
        return self.labor_us + kept_us + self.quality_us


@dataclass(frozen=True, slots=True)
class Transfer:
    """A stream that is carried to a host, and what that costs over the horizon."""

    stream: Stream
    origin: str | None
    to: str
    cost_us: int


def cost_parts(problem: Problem, units: Collection[ComputationUnit]) -> CostParts:
    """The cost of an update that leaves these units, by parts."""
    environment, horizon_s = problem.environment, problem.horizon_s
    library, place_of = environment.transformation, environment.place_of
    hot = [unit for unit in units if not unit.standby]
    labor = sum([labor_us(library[u.transformation], place_of(u)) for u in hot if u.id not in environment.unit])
    upkeep = sum([keep_cost_us(library[u.transformation], horizon_s, place_of(u)) for u in hot])
    if problem.is_plain:
        return CostParts(labor, upkeep)
    return CostParts(
        labor,
        upkeep,
        sum(standby_cost_us(library[u.transformation], horizon_s, place_of(u)) for u in units if u.standby),
        sum(transfer.cost_us for transfer in transfers(problem, units)),
        _prices_us(environment, units),
        sum(host.rent_us for host in used_hosts(environment, units)) * horizon_s,
        sum(port.worth_us for unit in hot for port in _unfed(library[unit.transformation], unit)) * horizon_s,
    )


def _prices_us(environment: Environment, units: Collection[ComputationUnit]) -> int:
    """The prices that targets set on the quality of their streams."""
    wishes = [(target.label, wish) for target in environment.targets for wish in target.quality]
    reached = qualities_of_targets(environment, units) if wishes else {}
    return sum(
        price_us(environment.quality[wish.attribute], wish, reached[label][wish.attribute])
        for label, wish in wishes
        if label in reached
    )


def used_hosts(environment: Environment, units: Iterable[ComputationUnit]) -> list[Host]:
    """The hosts that units are on, running or as cold spares."""
    used = {unit.host for unit in units}
    return [host for host in environment.hosts if host.name in used]


def links_suffice(problem: Problem, units: Collection[ComputationUnit]) -> bool:
    """Return whether no link carries more bytes per second than its bandwidth."""
    return all(link.bandwidth is None or load <= link.bandwidth for link, load in link_loads(problem, units).items())


def link_loads(problem: Problem, units: Collection[ComputationUnit]) -> Counter[Link]:
    """The bytes that each link carries each second."""
    environment = problem.environment
    loads: Counter[Link] = Counter()
    kind = {unit.id: environment.transformation[unit.transformation] for unit in units} if environment.links else {}
    for transfer in transfers(problem, units) if environment.links else ():
        link = environment.link.get((transfer.origin or "", transfer.to))
        if link is not None:
            loads[link] += kind[transfer.stream.unit].output[transfer.stream.port].bytes_per_s
    return loads


def _unfed(transformation: Transformation, unit: ComputationUnit) -> Iterator[InputPort]:
    return (port for port in transformation.inputs if port.optional and port.name not in unit.feeds)


def transfers(problem: Problem, units: Collection[ComputationUnit]) -> list[Transfer]:
    """The streams that leave their hosts, each once for each host that it is wanted on."""
    environment = problem.environment
    if not environment.hosts:
        return []
    host_of = {unit.id: unit.host for unit in units}
    target_host = {target.topic: target.host for target in environment.targets}
    wanted = {(s.stream, unit.host) for unit in units for s in unit.subscriptions}
    wanted |= {(Stream(unit.id, p.port), target_host.get(p.topic)) for unit in units for p in unit.publications}
    transformation_of = {unit.id: environment.transformation[unit.transformation] for unit in units}
    return [
        Transfer(
            stream,
            host_of[stream.unit],
            to,
            transfer_cost_us(
                transformation_of[stream.unit].output[stream.port],
                problem.horizon_s,
                environment.price_us(host_of[stream.unit], to),
            ),
        )
        for stream, to in sorted((stream, to) for stream, to in wanted if to is not None)
        if host_of[stream.unit] != to
    ]


def loads(environment: Environment, units: Collection[ComputationUnit]) -> Mapping[str, Counter[str]]:
    """Return each host's load by resource (see `Transformation.takes`); cold spares count too."""
    found: dict[str, Counter[str]] = {host.name: Counter({CPU: 0, MEMORY: 0}) for host in environment.hosts}
    for unit in units:
        if unit.host in found and unit.transformation in environment.transformation:
            found[unit.host].update(taken(environment.transformation[unit.transformation], environment.place_of(unit)))
    return found


def qualities_of_targets(environment: Environment, units: Collection[ComputationUnit]) -> dict[str, dict[str, int]]:
    """The value of each attribute (micro-units) at each target that has a stream, by labels; gaps count as worst."""
    by_id = {unit.id: unit for unit in units}
    topic_stream = {p.topic: Stream(unit.id, p.port) for unit in units for p in unit.publications}
    found: dict[str, dict[str, int]] = {
        target.label: {} for target in environment.stream_targets if target.topic in topic_stream
    }
    for attribute in environment.qualities:
        values: dict[Stream, int] = {}
        for target in environment.targets:
            if target.label in found:
                stream = topic_stream[target.topic]
                value = _value(environment, by_id, attribute, stream, values)
                found[target.label][attribute.name] = _come(environment, by_id, attribute, stream, value, target.host)
    return found


def told_qualities(environment: Environment, units: Collection[ComputationUnit]) -> dict[str, dict[str, int]]:
    """The qualities of targets, by label and attribute, formatted for texts and pictures.

    Targets that only observe a fact are left out. So is an attribute's worst value if no target has a demand on the
    attribute: it only means that the stream states nothing.
    """
    observed = {fact.observed_on for fact in environment.variable.values() if fact.by is not None}
    return {
        label: {
            name: value
            for name, value in values.items()
            if value != environment.quality[name].worst
            or any(wish.attribute == name for wish in environment.target[label].quality)
        }
        for label, values in qualities_of_targets(environment, units).items()
        if environment.target[label].topic not in observed
    }


def _come(
    environment: Environment,
    units: Mapping[str, ComputationUnit],
    attribute: QualityAttribute,
    stream: Stream,
    value: int,
    host: str | None,
) -> int:
    """Return the value of a stream after its transfer to a host."""
    origin = units[stream.unit].host if stream.unit in units else None
    return delayed(attribute, value, environment.latency(attribute.name, origin, host))


def _value(
    environment: Environment,
    units: Mapping[str, ComputationUnit],
    attribute: QualityAttribute,
    wanted: Stream,
    values: dict[Stream, int],
) -> int:
    """The value of a stream, without recursion: a chain of units may be long."""
    ahead = [wanted]
    opened: set[Stream] = set()
    while ahead:
        stream = ahead[-1]
        unit = units.get(stream.unit)
        transformation = environment.transformation.get(unit.transformation) if unit else None
        if stream in values or unit is None or transformation is None or stream.port not in transformation.output:
            values.setdefault(stream, attribute.worst)
            ahead.pop()
            continue
        ordinary = [port.name for port in transformation.inputs if not port.feedback]
        gap = {port.name: () if port.optional else (None,) for port in transformation.inputs}
        feeds = [feed for name in ordinary for feed in unit.feeds.get(name, gap[name])]
        waiting = [feed for feed in feeds if feed is not None and feed not in values and feed not in opened]
        if waiting and stream not in opened:
            opened.add(stream)
            ahead += waiting
            continue
        inputs = [
            attribute.worst
            if feed is None
            else _come(environment, units, attribute, feed, values.get(feed, attribute.worst), unit.host)
            for feed in feeds
        ]
        stated = {c.attribute: c.on(unit.host) for c in transformation.output[stream.port].quality}
        values[stream] = propagated(attribute, stated.get(attribute.name), inputs)
        ahead.pop()
    return values[wanted]


def amount(objective: Objective, value: int) -> str:
    """A value of an objective in words: `2 hosts`, `1.25 s of rent`, `1.25 s`."""
    if objective in _COUNTED:
        return counted(value, _COUNTED[objective])
    return cpu(value) if objective is Objective.COST else f"{cpu(value)} of rent"
