"""Which single failures leave a target without a stream, judged by what the units that are left can start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from cfgplan.domain import ComputationUnit, Environment, Target
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.reach import Reach
from cfgplan.planning import Failures
from cfgplan.reasons import startable


@dataclass(frozen=True)
class Failure:
    """A failure: the transformations of the units that are left, and the targets that those have to meet.

    A `host` fails, or, without one, the only unit of a transformation.
    """

    host: str | None
    left: frozenset[str]
    targets: tuple[Target, ...]


def failures(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[Failure]:
    """The single failures to be survived that take the last unit of some transformation."""
    problem = candidates.problem
    if problem.survive is None:
        return
    number = Counter(unit.transformation for unit in units)
    for unit in units:
        if not unit.standby and number[unit.transformation] == 1:
            yield Failure(None, frozenset(number) - {unit.transformation}, problem.environment.targets)
    for host in problem.environment.hosts if problem.survive is Failures.HOSTS else ():
        left = frozenset(unit.transformation for unit in units if unit.host != host.name)
        if len(left) < len(number):
            yield Failure(host.name, left, tuple(t for t in problem.environment.targets if t.host != host.name))


def unmet(candidates: Candidates, failure: Failure) -> list[Target]:
    """The targets that nothing that is left after a failure can meet.

    Units of one transformation feed alike, so it is enough to know which transformations are left.
    """
    reach = Reach(candidates.network, candidates.numbers(failure.left))
    return [target for target in failure.targets if not is_met(candidates, reach, failure.left, target)]


def is_met(candidates: Candidates, reach: Reach, labels: Collection[str], target: Target) -> bool:
    """Whether the labels can meet a target, where `reach` is theirs."""
    if not reach.meets(target.tag):
        return False
    if not candidates.network.special:
        return True
    library = tuple(candidates.environment.transformation[label] for label in sorted(labels))
    possible = startable(Environment((), library), candidates.givers)
    return not possible.isdisjoint(candidates.givers.of(target.tag))


def bears_all_failures(candidates: Candidates, units: Collection[ComputationUnit]) -> bool:
    """Whether no single failure leaves a target without a stream; always so if none has to be survived."""
    return not any(unmet(candidates, failure) for failure in failures(candidates, units))


def can_do_without(candidates: Candidates, units: Collection[ComputationUnit], one: ComputationUnit) -> bool:
    """Whether units that bear all failures do so without `one`; failures that leave others of its kind don't matter."""
    others = [unit for unit in units if unit is not one]
    return not any(
        unmet(candidates, failure) for failure in failures(candidates, others) if one.transformation not in failure.left
    )
