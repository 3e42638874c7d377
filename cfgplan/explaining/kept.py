"""Units that run even if no target needs them, and a problem in which each of them has a target of its own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

from cfgplan.domain import ComputationUnit, OutputPort, Publication, Similarity, Target, Transformation
from cfgplan.planning import Plan, Problem
from cfgplan.reasons import Providers, startable

Labels = frozenset[str]


@dataclass(frozen=True)
class Kept:
    """The units that run in every configuration of a problem: running pinned units, and those that `min_instances` asks
    for.
    """

    problem: Problem

    @cached_property
    def labels(self) -> Labels:
        return frozenset(label for label, _ in self._stays)

    def with_own_targets(self, without: Labels = frozenset()) -> Problem:
        """Return the problem in which each such unit that has inputs feeds an artificial target, at no cost.

        Units that feed it then serve a target, so that `required` treats them like any others. Units of the
        transformations in `without` get no artificial target: if required, they have to serve a real one.
        """
        environment, similarity = self.problem.environment, self.problem.similarity
        names = {
            (label, unit): f"\0{label}\0{unit}"
            for label, unit in self._stays
            if label not in without and environment.transformation[label].inputs
        }
        if not names:
            return self.problem
        published = {unit: name for (_, unit), name in names.items()}
        more = [(label, name) for (label, _), name in names.items()]
        return replace(
            self.problem,
            environment=replace(
                environment,
                units=tuple(_publishing(unit, published.get(unit.id)) for unit in environment.units),
                library=tuple(_offering(t, [n for label, n in more if label == t.label]) for t in environment.library),
                targets=(*environment.targets, *(Target(name, name, name) for _, name in more)),
            ),
            similarity=Similarity(
                {**similarity.offers, **{name: frozenset({name}) for _, name in more}}, similarity.open
            ),
        )

    def without_artificial_targets(self, plan: Plan, planned: Problem) -> Plan:
        """Remove the artificial targets from a plan that was made with them: the result is a plan of the problem
        itself.
        """
        if plan.change_set is None:
            return plan
        units = [_without(unit) for unit in planned.after(plan).units]
        return replace(plan, change_set=self.problem.environment.change_to(units))

    @cached_property
    def _stays(self) -> list[tuple[str, str]]:
        """Each unit that always runs: its transformation, and its id if it runs already, else a number."""
        environment = self.problem.environment
        possible = startable(environment, Providers(environment.library, self.problem.similarity))
        found: list[tuple[str, str]] = []
        for transformation in environment.library:
            label, hosts = transformation.label, environment.hosts_for(transformation)
            running = [u.id for u in environment.units if u.transformation == label and u.host in hosts]
            pinned = running if transformation.pinned and label in possible else []
            asked = [*running, *map(str, range(transformation.min_instances))][: transformation.min_instances]
            found += [(label, unit) for unit in dict.fromkeys([*pinned, *asked])]
        return found


def _publishing(unit: ComputationUnit, name: str | None) -> ComputationUnit:
    return unit if name is None else replace(unit, publications=(*unit.publications, Publication(name, name)))


def _offering(transformation: Transformation, names: Iterable[str]) -> Transformation:
    more = tuple(OutputPort(name, name) for name in names)
    return replace(transformation, outputs=(*transformation.outputs, *more)) if more else transformation


def _without(unit: ComputationUnit) -> ComputationUnit:
    return replace(unit, publications=tuple(p for p in unit.publications if not p.topic.startswith("\0")))
