"""Rules of hosts: places of units, capacities, and the cost of carrying streams between hosts."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from cfgplan.domain import CPU, POWER, Environment, Link, amount_of
from cfgplan.validity.facts import costs_there as costs_there
from cfgplan.validity.facts import known_units
from cfgplan.validity.rules import Rule, Violation


def placing_violations(environment: Environment, horizon_s: int = 0) -> Iterator[Violation]:
    """Yield units on no host or a wrong one, and hosts with too many units; nothing without hosts.

    Energy has to last for the horizon.
    """
    if not environment.hosts:
        return
    for unit, transformation in known_units(environment):
        if unit.host is None:
            yield Violation(Rule.PLACED, f"unit {unit.id} has no host", unit.id)
        elif unit.host not in environment.host:
            yield Violation(
                Rule.PLACED, f"unit {unit.id} is on {unit.host}, which is not declared under `hosts:`", unit.id
            )
        elif unit.host not in environment.hosts_for(transformation):
            why = environment.barred.get(transformation.label, {}).get(unit.host)
            for_now = f" for now: it {why}" if why else ""
            text = f"unit {unit.id} is on {unit.host}, where {transformation.label} may not run{for_now}"
            yield Violation(Rule.PLACED, text, unit.id)
    for host in environment.hosts:
        there = [
            {**transformation.takes, CPU: costs_there(environment, unit, transformation)[1]}
            for unit, transformation in known_units(environment)
            if unit.host == host.name
        ]
        for resource in sorted({resource for takes in there for resource in takes}):
            taken, room = sum(takes.get(resource, 0) for takes in there), host.room(resource)
            if room is not None and taken > room:
                both = f"{amount_of(resource, taken)}, but it has {amount_of(resource, room)}"
                yield Violation(Rule.CAPACITY, f"the units on {host.name} take {both}")
        energy = horizon_s * sum(takes.get(POWER, 0) for takes in there)
        if host.energy is not None and energy > host.energy:
            text = (
                f"the units on {host.name} take {energy} W s of energy in {horizon_s} s, but it has {host.energy} W s"
            )
            yield Violation(Rule.CAPACITY, text)


def company_violations(environment: Environment) -> Iterator[Violation]:
    """Yield violations of `beside`, `per_host`, `at_most` and `conflicts_on_host`.

    Without hosts, all units count as being on one host.
    """
    at: dict[str | None, Counter[str]] = defaultdict(Counter)
    running = {(unit.transformation, unit.host) for unit in environment.units if not unit.standby}
    for unit, transformation in known_units(environment):
        at[unit.host][transformation.label] += 1
        for other in transformation.beside if not unit.standby else ():
            if (other, unit.host) not in running:
                where = "" if unit.host is None else f" on {unit.host}"
                yield Violation(Rule.BESIDE, f"unit {unit.id} runs{where} without a unit of {other}", unit.id)
    for host, there in at.items():
        where = "there" if host is None else f"on {host}"
        for label, number in there.items():
            most = environment.transformation[label].per_host
            if most is not None and number > most:
                text = f"{number} units of {label} are {where}, but it allows {most} on one host"
                yield Violation(Rule.INSTANCES, text)
            for other in environment.transformation[label].conflicts_on_host:
                if other in there and other != label:
                    yield Violation(Rule.APART, f"units of {label} and {other} are {where}, which conflict on a host")
    for transformation in environment.library:
        for text, most in transformation.at_most.items():
            hosts = {host.name for host in environment.hosts if host.fits(text)}
            number = sum(u.transformation == transformation.label and u.host in hosts for u in environment.units)
            if number > most:
                those = f"{number} units of {transformation.label} are on {text}"
                yield Violation(Rule.INSTANCES, f"{those}, but at most {most} may run on {text}")


def rents_us(environment: Environment) -> int:
    """The cost per second of the hosts in use."""
    there = {unit.host for unit in environment.units}
    return sum(host.rent_us for host in environment.hosts if host.name in there)


def carried_us(environment: Environment, horizon_s: int) -> int:
    """Return the cost of carrying streams to other hosts; a stream is paid once for each host that needs it."""
    cost = 0
    for a_second, origin, to in _journeys(environment):
        link = _link(environment, origin, to)
        price_us = environment.transfer_us if link is None or link.price_us is None else link.price_us
        cost += -(-a_second * horizon_s * price_us // 1_000_000)
    return cost


def link_violations(environment: Environment) -> Iterator[Violation]:
    """Yield each link that carries more bytes per second than its bandwidth."""
    over: Counter[Link] = Counter()
    for a_second, origin, to in _journeys(environment) if environment.links else ():
        link = _link(environment, origin, to)
        if link is not None:
            over[link] += a_second
    for link, carried in over.items():
        if link.bandwidth is not None and carried > link.bandwidth:
            ends = " and ".join(link.between)
            text = (
                f"the link between {ends} carries {carried} bytes per second, but has a bandwidth of {link.bandwidth}"
            )
            yield Violation(Rule.CAPACITY, text)


def _journeys(environment: Environment) -> Iterator[tuple[int, str | None, str]]:
    """Yield the bytes per second of each stream, its host, and each other host that needs it."""
    at = {unit.id: unit.host for unit in environment.units}
    topic_host = {target.topic: target.host for target in environment.targets}
    journeys: set[tuple[str, str, str]] = set()
    for unit in environment.units:
        wanted = [(s.stream.unit, s.stream.port, unit.host) for s in unit.subscriptions]
        wanted += [(unit.id, p.port, topic_host.get(p.topic)) for p in unit.publications]
        journeys |= {(feeder, port, to) for feeder, port, to in wanted if to is not None and at.get(feeder) != to}
    library = {unit.id: transformation for unit, transformation in known_units(environment)}
    for feeder, name, to in journeys:
        port = library[feeder].output.get(name) if feeder in library else None
        if port is not None:
            yield -(-port.rate_uhz * port.size_bytes // 1_000_000), at[feeder], to


def latency(environment: Environment, attribute: str, one: str | None, other: str | None) -> int:
    """Return the amount that a transfer between two hosts adds to a stream's value of an attribute."""
    link = None if one == other or other is None else _link(environment, one, other)
    return link.latency if link is not None and link.adds == attribute else 0


def _link(environment: Environment, one: str | None, other: str) -> Link | None:
    """The first link that joins two hosts."""
    ends = environment.host.get(one or ""), environment.host.get(other)
    if ends[0] is None or ends[1] is None:
        return None
    return next((link for link in environment.links if link.joins(ends[0], ends[1])), None)
