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
from cfgplan.planners.cpsat.network import Core, Graph, Ints, Rows
from cfgplan.planners.fleet.candidates import Candidates

Host = str | None


@dataclass(frozen=True, slots=True)
class Placed:
    """A candidate that runs on a host."""

    unit: int
    host: Host


@dataclass(frozen=True, slots=True)
class Carried:
    """A stream of a candidate, carried to a host."""

    unit: int
    port: str
    host: Host


@dataclass(frozen=True, slots=True)
class Met:
    """A fact: what a tag demands is there on a host, or, on no host in particular, anywhere."""

    tag: str
    host: Host


@dataclass(frozen=True, slots=True)
class Runs:
    """A fact: a candidate runs."""

    unit: int


Label = Placed | Carried
Fact = Met | Runs


class Flat:
    """The labels and facts of a fleet, their costs, and the core for bounds.

    `streams` says by which streams a label meets a demand.
    """

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        environment = candidates.environment
        hosts: list[Host] = [host.name for host in environment.hosts] or [None]
        self.labels: list[Label] = []
        self.cost_us: list[int] = []
        for i, candidate in enumerate(candidates.all):
            for host in candidate.hosts:
                self._add(Placed(i, host), candidate.cost_us)
        for i, candidate in enumerate(candidates.all):
            for port in candidate.transformation.outputs if environment.hosts else ():
                price_us = transfer_cost_us(port, candidates.problem.horizon_s, environment.transfer_us)
                for host in hosts:
                    if candidate.hosts != (host,):
                        self._add(Carried(i, port.name, host), price_us)
        self.number = {label: n for n, label in enumerate(self.labels)}
        self.wanted: list[Fact] = [Met(target.tag, target.host) for target in environment.targets]
        self.wanted += [Runs(i) for i in range(len(candidates.all)) if candidates.is_pinned(i)]
        self.needs: list[list[Fact]] = [self._needs(label) for label in self.labels]
        self.facts: list[Fact] = list(dict.fromkeys([*self.wanted, *(fact for row in self.needs for fact in row)]))
        self.givers = {fact: self._givers(fact) for fact in self.facts}
        self.graph = Graph(self._core())

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
            return {self.number[Placed(fact.unit, host)]: [] for host in self.candidates.all[fact.unit].hosts}
        givers: dict[int, list[Stream]] = defaultdict(list)
        for stream in self.candidates.streams(fact.tag):
            for label in self._offering(stream, fact.host):
                givers[label].append(stream)
        return givers

    def _offering(self, stream: Stream, host: Host) -> Iterable[int]:
        """The labels by which a stream is on a host, or, if that is None, is there at all."""
        unit = self.candidates.index_of[stream.unit]
        hosts = self.candidates.all[unit].hosts
        if host is None:
            return [self.number[Placed(unit, own)] for own in hosts]
        ways: list[Label] = [Placed(unit, host)] if host in hosts else []
        if hosts != (host,):
            ways.append(Carried(unit, stream.port, host))
        return [self.number[way] for way in ways]

    def _core(self) -> Core:
        """The problem as arrays; facts with the same givers are one."""
        merged: dict[tuple[int, ...], int] = {}
        fact_of = {fact: merged.setdefault(tuple(sorted(givers)), len(merged)) for fact, givers in self.givers.items()}
        rows = [*self.needs, self.wanted]
        return Core(
            Rows.of([sorted({fact_of[fact] for fact in row}) for row in rows]),
            Rows.of(list(merged)),
            np.arange(len(self.labels)),
            np.arange(len(merged)),
        )

    def costs(self) -> Ints:
        return np.array(self.cost_us, np.int64)
