"""Which single failures leave a target without a stream, judged by what the units that are left can start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from cfgplan.domain import ComputationUnit, Environment, Target
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.reach import Reach
from cfgplan.planning import Failures
from cfgplan.reasons import startable

Site = tuple[str, HostName]
"""A transformation and, where some run with others on their host, a host: units of one site may do the same."""


@dataclass(frozen=True)
class Failure:
    """A failure: the sites of the units that are left, and the targets that those have to meet.

    A `host` fails, or, without one, the only unit of a site.
    """

    host: str | None
    left: frozenset[Site]
    targets: tuple[Target, ...]


def site_of(environment: Environment, label: str, host: HostName) -> Site:
    """The site of a unit of a transformation on a host."""
    return label, host if environment.companions else None


def sites_of(environment: Environment, units: Iterable[ComputationUnit]) -> list[Site]:
    """The site of each unit."""
    return [site_of(environment, unit.transformation, unit.host) for unit in units]


def failures(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[Failure]:
    """The single failures to be survived that take the last unit of some site."""
    problem, environment = candidates.problem, candidates.environment
    if problem.survive is None:
        return
    number = Counter(sites_of(environment, units))
    for unit, site in zip(units, sites_of(environment, units), strict=True):
        if not unit.standby and number[site] == 1:
            yield Failure(None, frozenset(number) - {site}, environment.targets)
    for host in environment.hosts if problem.survive is Failures.HOSTS else ():
        left = frozenset(sites_of(environment, (unit for unit in units if unit.host != host.name)))
        if len(left) < len(number):
            yield Failure(host.name, left, tuple(t for t in environment.targets if t.host != host.name))


def unmet(candidates: Candidates, failure: Failure) -> list[Target]:
    """The targets that nothing that is left after a failure can meet.

    Units of one site feed alike, so it is enough to know which sites are left.
    """
    reach = Reach(candidates.network, candidates.numbers(label for label, _ in failure.left))
    return [target for target in failure.targets if not is_met(candidates, reach, failure.left, target)]


def is_met(candidates: Candidates, reach: Reach, sites: Collection[Site], target: Target) -> bool:
    """Whether what is left can meet a target, where `reach` is that of the labels."""
    if not reach.meets(target.tag):
        return False
    environment, givers = candidates.environment, candidates.givers
    if not (candidates.network.special or environment.companions):
        return True
    left = set(sites)
    while True:
        library = tuple(environment.transformation[label] for label in sorted({label for label, _ in left}))
        possible = startable(Environment((), library), givers)
        able = {
            (label, host)
            for label, host in left
            if label in possible and left.issuperset((t, host) for t in environment.transformation[label].beside)
        }
        if able == left:
            return not possible.isdisjoint(givers.of(target.tag))
        left = able


def bears_all_failures(candidates: Candidates, units: Collection[ComputationUnit]) -> bool:
    """Whether no single failure leaves a target without a stream; always so if none has to be survived."""
    return not any(unmet(candidates, failure) for failure in failures(candidates, units))


def can_do_without(candidates: Candidates, units: Collection[ComputationUnit], one: ComputationUnit) -> bool:
    """Whether units that bear all failures do so without `one`; failures that leave others of its site don't matter."""
    others, (site,) = [unit for unit in units if unit is not one], sites_of(candidates.environment, [one])
    return not any(unmet(candidates, failure) for failure in failures(candidates, others) if site not in failure.left)
