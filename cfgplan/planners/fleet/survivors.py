"""Whether what is left after a failure can still meet every target: the closure over given units."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from cfgplan.domain import ComputationUnit, Environment, Target
from cfgplan.planning import Failures, Problem
from cfgplan.reasons import Givers, startable


def bears_all_failures(problem: Problem, units: Collection[ComputationUnit]) -> bool:
    """Whether no single failure leaves a target without a stream; always so if none has to be survived."""
    return all(_are_met(problem, left, targets) for left, targets in _failures(problem, units))


def _failures(
    problem: Problem, units: Collection[ComputationUnit]
) -> Iterator[tuple[list[ComputationUnit], list[Target]]]:
    targets = list(problem.environment.targets)
    if problem.survive is None:
        return
    for lost in units:
        if not lost.standby:
            yield [unit for unit in units if unit is not lost], targets
    for host in problem.environment.hosts if problem.survive is Failures.HOSTS else ():
        yield [u for u in units if u.host != host.name], [t for t in targets if t.host != host.name]


def _are_met(problem: Problem, left: list[ComputationUnit], targets: list[Target]) -> bool:
    """Units of one transformation feed alike, so the transformations that are left tell all."""
    labels = {unit.transformation for unit in left}
    library = tuple(t for t in problem.environment.library if t.label in labels)
    givers = Givers(library, problem.similarity)
    possible = startable(Environment((), library, ()), givers)
    return all(not possible.isdisjoint(givers.of(target.tag)) for target in targets)
