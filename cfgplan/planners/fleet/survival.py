"""Single failures in the constraint model, as landmarks that have to be hit twice.

A landmark of a target is a set of transformations of which every way to meet the target runs one. After the
failure of a unit the others can still meet all targets exactly if every landmark has two units there: the failing
one may be one of them, and a lone cold spare is no way to meet the target now. After the failure of a host
every landmark needs a unit on another one. There are too many landmarks to name, so those that a solution
misses are added, round by round.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from ortools.sat.python.cp_model import LinearExpr

from cfgplan.domain import ComputationUnit, Environment, Target
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.model import Model
from cfgplan.planning import Failures
from cfgplan.reasons import startable


@dataclass(frozen=True)
class Missed:
    """A landmark that has too few units: one in all or, with a `host`, none on another host."""

    labels: frozenset[str]
    host: str | None = None


class Survival:
    """Finds what failures a configuration does not survive, and demands that of the model."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        self.problem = candidates.problem
        dear: dict[str, int] = {}
        for candidate in candidates.all:
            label = candidate.transformation.label
            dear[label] = max(dear.get(label, 0), candidate.cost_us)
        self._by_cost = sorted(dear, key=lambda label: (-dear[label], label))
        self._known: set[Missed] = set()

    def missed(self, units: Collection[ComputationUnit]) -> list[Missed]:
        """The landmarks of which a configuration has too few units, one for each failure and target."""
        found: list[Missed] = []
        for lost, targets, host in self._failures(units):
            left = {unit.transformation for unit in units if unit.id not in lost}
            unmet = [target for target in targets if not self._is_met(target, left)]
            found += [Missed(self._landmark(target, left), host) for target in unmet]
        return list(dict.fromkeys(found))

    def demand(self, model: Model, missed: Collection[Missed]) -> None:
        """Every landmark that was missed has enough units from now on."""
        for each in missed:
            if each in self._known:
                continue
            self._known.add(each)
            units = [i for i, c in enumerate(self.candidates.all) if c.transformation.label in each.labels]
            if each.host is None:
                model.cp.add(LinearExpr.sum([model.is_there[i] for i in units]) >= 2)
            else:
                model.cp.add_bool_or([on for i in units for host, on in model.is_on[i].items() if host != each.host])

    def _failures(
        self, units: Collection[ComputationUnit]
    ) -> Iterator[tuple[set[str], tuple[Target, ...], str | None]]:
        """The ids of the units that each failure takes, and the targets that have to be met all the same."""
        targets = self.problem.environment.targets
        if self.problem.survive is None:
            return
        for unit in units:
            if not unit.standby:
                yield {unit.id}, targets, None
        for host in self.problem.environment.hosts if self.problem.survive is Failures.HOSTS else ():
            lost = {unit.id for unit in units if unit.host == host.name}
            yield lost, tuple(target for target in targets if target.host != host.name), host.name

    def _is_met(self, target: Target, labels: Collection[str]) -> bool:
        """Units of one transformation feed alike, so the transformations that are left tell all."""
        self.candidates.watch()
        environment = self.problem.environment
        library = tuple(environment.transformation[label] for label in sorted(labels))
        possible = startable(Environment((), library), self.candidates.givers)
        return not possible.isdisjoint(self.candidates.givers.of(target.tag))

    def _landmark(self, target: Target, left: Collection[str]) -> frozenset[str]:
        """What a largest set of transformations that does not meet the target lacks; the dear ones are in the set."""
        without = set(left)
        for label in self._by_cost:
            if label not in without and not self._is_met(target, without | {label}):
                without.add(label)
        return frozenset(self._by_cost) - without
