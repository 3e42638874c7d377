"""A fleet's problem as the plain one: choose units on hosts and streams to carry, at least cost.

A *label* is a candidate on a host, or a stream carried to a host; a *fact* is a demand met on a host, or that
a unit runs somewhere. For the cost alone it does not matter who of several feeds an input: what is on a
host is there for all. So landmarks bound the cost, transfers included. That a unit is in one place, capacity,
conflicts, numbers and quality are left to the constraint model.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cfgplan.costs import transfer_cost_us
from cfgplan.domain import Stream
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.networks.core import Core, Ints, Rows
from cfgplan.planners.networks.network import Graph


@dataclass(frozen=True, slots=True)
class Placed:
    """A candidate that runs on a host."""

    unit: int
    host: HostName


@dataclass(frozen=True, slots=True)
class Carried:
    """A stream of a candidate, carried to a host."""

    unit: int
    port: str
    host: HostName


@dataclass(frozen=True, slots=True)
class Met:
    """A fact: a demanded tag is met on a host; with host None, anywhere."""

    tag: str
    host: HostName


@dataclass(frozen=True, slots=True)
class Runs:
    """A fact: a candidate runs."""

    unit: int


Label = Placed | Carried
Fact = Met | Runs


class Flat:
    """The labels and facts of a fleet, their costs, and the core for bounds.

    `givers` says which labels give a fact, and by which streams.
    """

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        environment = candidates.environment
        hosts: list[HostName] = [host.name for host in environment.hosts] or [None]
        self.labels: list[Label] = []
        self.cost_us: list[int] = []
        for i, candidate in candidates.clock.each(enumerate(candidates.all)):
            for host, place in candidate.places.items():
                self._add(Placed(i, host), place.cost_us)
        for i, candidate in candidates.clock.each(enumerate(candidates.all)):
            for port in candidate.transformation.outputs if environment.hosts else ():
                price_us = transfer_cost_us(port, candidates.problem.horizon_s, environment.transfer_us)
                for host in hosts:
                    if candidate.hosts != (host,):
                        self._add(Carried(i, port.name, host), price_us)
        self.wanted: list[Fact] = [Met(target.tag, target.host) for target in environment.targets]
        self.wanted += [Runs(i) for i in range(len(candidates.all)) if candidates.is_pinned(i)]
        self._link()
        alive = self._alive()
        if len(alive) < len(self.labels):
            self.labels = [self.labels[n] for n in alive]
            self.cost_us = [self.cost_us[n] for n in alive]
            self._link()
        self.is_impossible = any(not self.givers[fact] for fact in self.wanted)

    def _link(self) -> None:
        clock = self.candidates.clock
        self.number = {label: n for n, label in enumerate(self.labels)}
        self.needs = [self._needs(label) for label in clock.each(self.labels)]
        self.facts: list[Fact] = list(dict.fromkeys([*self.wanted, *(fact for row in self.needs for fact in row)]))
        self.givers = {fact: self._givers(fact) for fact in clock.each(self.facts)}

    def _alive(self) -> list[int]:
        """The labels that can be grounded."""
        giving: dict[int, list[Fact]] = defaultdict(list)
        needing: dict[Fact, list[int]] = defaultdict(list)
        for fact, givers in self.candidates.clock.each(self.givers.items()):
            for label in givers:
                giving[label].append(fact)
        for label, needs in enumerate(self.needs):
            for fact in needs:
                needing[fact].append(label)
        missing = [len(needs) for needs in self.needs]
        ahead = [label for label, count in enumerate(missing) if count == 0]
        there: set[Fact] = set()
        for label in self.candidates.clock.each(ahead):
            for fact in giving[label]:
                if fact not in there:
                    there.add(fact)
                    for consumer in needing[fact]:
                        missing[consumer] -= 1
                        if missing[consumer] == 0:
                            ahead.append(consumer)
        return sorted(ahead)

    def _add(self, label: Label, cost_us: int) -> None:
        self.labels.append(label)
        self.cost_us.append(cost_us)

    def _needs(self, label: Label) -> list[Fact]:
        if isinstance(label, Carried):
            return [Runs(label.unit)]
        transformation = self.candidates.all[label.unit].transformation
        return list(dict.fromkeys(Met(port.tag, label.host) for port in transformation.inputs))

    def _givers(self, fact: Fact) -> dict[int, list[Stream]]:
        """The labels that give a fact, each with the streams that do."""
        if isinstance(fact, Runs):
            return {place: [] for place in self.places(fact.unit)}
        givers: dict[int, list[Stream]] = defaultdict(list)
        for stream in self.candidates.streams(fact.tag):
            for label in self._offering(stream, fact.host):
                givers[label].append(stream)
        return givers

    def _offering(self, stream: Stream, host: HostName) -> Iterable[int]:
        """The labels by which a stream is on a host, or, if that is None, is there at all."""
        unit = self.candidates.index_of[stream.unit]
        hosts = self.candidates.all[unit].hosts
        if host is None:
            return self.places(unit)
        ways: list[Label] = [Placed(unit, host)] if host in hosts else []
        if hosts != (host,):
            ways.append(Carried(unit, stream.port, host))
        return [self.number[way] for way in ways if way in self.number]

    def places(self, unit: int) -> list[int]:
        """The labels of a candidate on its hosts."""
        hosts = self.candidates.all[unit].hosts
        return [self.number[place] for host in hosts if (place := Placed(unit, host)) in self.number]

    def graph(self) -> Graph:
        """The problem as arrays; facts with the same givers are one."""
        merged: dict[tuple[int, ...], int] = {}
        fact_of: dict[Fact, int] = {}
        for fact, givers in self.candidates.clock.each(self.givers.items()):
            fact_of[fact] = merged.setdefault(tuple(sorted(givers)), len(merged))
        rows = [*self.needs, self.wanted]
        core = Core(
            Rows.of([sorted({fact_of[fact] for fact in row}) for row in rows]),
            Rows.of(list(merged)),
            np.arange(len(self.labels)),
            np.arange(len(merged)),
        )
        return Graph(core)

    def costs(self) -> Ints:
        return np.array(self.cost_us, np.int64)
