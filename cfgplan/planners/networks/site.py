"""What a plan can be made of: the units that run and those that may be started."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import ComputationUnit, Environment, Stream, Subscription, Transformation
from cfgplan.planning import Problem, fresh_unit_ids
from cfgplan.reasons import Givers


@dataclass(frozen=True)
class Candidate:
    """A unit that a plan may have: a running one, or the new one of its transformation.

    `may_stay` says that its present wiring is valid as far as it can tell by itself: its feeders run
    and match, and what it publishes is wanted.
    """

    id: str
    transformation: Transformation
    running: ComputationUnit | None
    cost_us: int
    may_stay: bool = False


class Site:
    """The candidates for a problem, in canonical order, and who of them can feed what."""

    def __init__(self, problem: Problem, givers: Givers, labels: Iterable[str]) -> None:
        self.problem = problem
        self.environment = problem.environment
        self._givers = givers
        self.candidates = tuple(_candidates(problem, frozenset(labels)))
        self.units_of: dict[str, list[int]] = defaultdict(list)
        for index, candidate in enumerate(self.candidates):
            self.units_of[candidate.transformation.label].append(index)
        self.index_of = {candidate.id: index for index, candidate in enumerate(self.candidates)}
        self._rows: dict[str, tuple[int, ...]] = {}

    def among(self, labels: Iterable[str]) -> Site:
        """The site of the same problem with these labels."""
        return Site(self.problem, self._givers, labels)

    def first_of_each(self, labels: Iterable[str]) -> set[int]:
        """The first unit of each label, a running one if there is one; of pinned ones all that run."""
        chosen = {self.units_of[label][0] for label in labels}
        return chosen | {i for i in range(len(self.candidates)) if self.is_kept_pinned(i)}

    def feeders(self, tag: str) -> tuple[int, ...]:
        """The candidates with an output that matches the demanded tag."""
        if tag not in self._rows:
            self._rows[tag] = tuple(i for label in self._givers.of(tag) for i in self.units_of.get(label, ()))
        return self._rows[tag]

    def gives(self, stream: Stream, tag: str) -> bool:
        """Whether a candidate's stream matches the demanded tag."""
        index = self.index_of.get(stream.unit)
        output = None if index is None else self.candidates[index].transformation.output.get(stream.port)
        return output is not None and self.problem.similarity.holds(output.tag, tag)

    def old_subscriptions(self, unit: int) -> tuple[Subscription, ...]:
        """What the candidate subscribes to at present; a new unit to nothing."""
        running = self.candidates[unit].running
        return running.subscriptions if running is not None else ()

    def is_kept_pinned(self, unit: int) -> bool:
        """Whether the candidate runs and must go on."""
        candidate = self.candidates[unit]
        return candidate.running is not None and candidate.transformation.pinned

    def port_for(self, feeder: int, tag: str) -> str:
        """The first output of the feeder that matches the demanded tag."""
        outputs = self.candidates[feeder].transformation.outputs
        return next(port.name for port in outputs if self.problem.similarity.holds(port.tag, tag))


def relevant(environment: Environment, givers: Givers, possible: frozenset[str]) -> frozenset[str]:
    """The labels out of `possible` that some target, or a pinned unit, may need, directly or through others."""
    pinned = {unit.transformation for unit in environment.units if unit.transformation in possible}
    found = {label for label in pinned if environment.transformation[label].pinned}
    tags = {target.tag for target in environment.targets}
    ahead = sorted(found)
    tags_ahead = sorted(tags)
    while ahead or tags_ahead:
        while ahead:
            for port in environment.transformation[ahead.pop()].inputs:
                if port.tag not in tags:
                    tags.add(port.tag)
                    tags_ahead.append(port.tag)
        while tags_ahead:
            givers.watch()
            new = [label for label in givers.of(tags_ahead.pop()) if label in possible and label not in found]
            found.update(new)
            ahead += new
    return frozenset(found)


def _candidates(problem: Problem, labels: frozenset[str]) -> list[Candidate]:
    """Running units, then new ones.

    A new unit beside a running one can pay only if it costs no labor, or lets more required ones be used.
    """
    environment = problem.environment
    candidates = []
    running = set()
    for unit in environment.units:
        if unit.transformation in labels:
            running.add(unit.transformation)
            transformation = environment.transformation[unit.transformation]
            cost_us = keep_cost_us(transformation, problem.horizon_s)
            candidates.append(Candidate(unit.id, transformation, unit, cost_us, may_stay(problem, labels, unit)))
    forced = any(environment.transformation[label].required for label in labels)
    may_start = [
        label
        for label in sorted(labels)
        if forced or label not in running or environment.transformation[label].labor_us == 0
    ]
    for label, unit_id in fresh_unit_ids(environment, may_start).items():
        transformation = environment.transformation[label]
        candidates.append(Candidate(unit_id, transformation, None, start_cost_us(transformation, problem.horizon_s)))
    return candidates


def may_stay(problem: Problem, labels: Collection[str], unit: ComputationUnit) -> bool:
    """Whether the unit's wiring is valid as far as it can tell by itself, if units of no other labels run."""
    environment, holds = problem.environment, problem.similarity.holds
    transformation = environment.transformation[unit.transformation]
    if unit.feeds.keys() != transformation.input.keys():
        return False
    feeders: set[tuple[str, str]] = set()
    for port in transformation.inputs:
        stream = unit.feeds[port.name]
        feeder = environment.unit.get(stream.unit)
        if feeder is None or feeder.transformation not in labels:
            return False
        output = environment.transformation[feeder.transformation].output.get(stream.port)
        if output is None or not holds(output.tag, port.tag):
            return False
        if port.distinct is not None and (port.distinct, feeder.transformation) in feeders:
            return False
        if port.distinct is not None:
            feeders.add((port.distinct, feeder.transformation))
    wanted = {target.topic: target.tag for target in environment.targets}
    return all(
        publication.topic in wanted
        and publication.port in transformation.output
        and holds(transformation.output[publication.port].tag, wanted[publication.topic])
        for publication in unit.publications
    )
