"""Which single failures leave a target without a stream, judged by what the units that are left can start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from cfgplan.domain import ALL, ComputationUnit, Environment, Target
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.reach import Reach
from cfgplan.planning import Failures, Notion
from cfgplan.reasons import startable

Site = tuple[str, HostName]
"""A transformation and, where some run with others on their host, a host: units of one site may do the same."""
UnitsBySite = Mapping[Site, int]
"""How many units of each site there are; one stands for all where no input takes several streams, and none is limited.
"""


@dataclass(frozen=True)
class Failure:
    """A failure: the units that are left, by site, and the targets that those have to meet.

    A `host` fails, or, without one, a unit.
    """

    host: str | None
    left: UnitsBySite
    targets: tuple[Target, ...]


def site_of(environment: Environment, label: str, host: HostName) -> Site:
    """The site of a unit of a transformation on a host."""
    return label, host if environment.companions else None


def are_counted(candidates: Candidates) -> bool:
    """Whether it matters how many units of a site there are."""
    return not {Notion.COUNTS, Notion.LIMITS}.isdisjoint(candidates.problem.notions)


def units_of_sites(candidates: Candidates, units: Iterable[ComputationUnit]) -> UnitsBySite:
    """How many units of each site some units are."""
    number = Counter(site_of(candidates.environment, unit.transformation, unit.host) for unit in units)
    return number if are_counted(candidates) else dict.fromkeys(number, 1)


def failures(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[Failure]:
    """The single failures to be survived that leave less of some site."""
    problem, environment = candidates.problem, candidates.environment
    if problem.survive is None:
        return
    there = units_of_sites(candidates, units)
    seen: set[Site] = set()
    for unit in units:
        site = site_of(environment, unit.transformation, unit.host)
        if not unit.standby and site not in seen:
            seen.add(site)
            left = units_of_sites(candidates, (other for other in units if other is not unit))
            if left != there:
                yield Failure(None, left, environment.targets)
    for host in environment.hosts if problem.survive is Failures.HOSTS else ():
        left = units_of_sites(candidates, (unit for unit in units if unit.host != host.name))
        if left != there:
            yield Failure(host.name, left, tuple(t for t in environment.targets if t.host != host.name))


def unmet(candidates: Candidates, failure: Failure) -> list[tuple[Target, ...]]:
    """The targets each of which nothing that is left after a failure can meet; else all, if it can't meet all at once.

    UnitsBySite of one site are alike, so it is enough to know how many are left of each.
    """
    reach = Reach(candidates.network, candidates.numbers(label for label, _ in failure.left))
    single = [(target,) for target in failure.targets if not are_met(candidates, reach, failure.left, (target,))]
    is_joint = not single and len(failure.targets) > 1 and are_counted(candidates)
    return (
        [failure.targets] if is_joint and not are_met(candidates, reach, failure.left, failure.targets) else [*single]
    )


def are_met(candidates: Candidates, reach: Reach, units: UnitsBySite, targets: tuple[Target, ...]) -> bool:
    """Whether some units can meet targets, all at once, where `reach` is that of their labels."""
    if not all(reach.meets(target.tag) for target in targets):
        return False
    environment, givers = candidates.environment, candidates.givers
    is_counted = are_counted(candidates)
    if not (candidates.network.special or environment.companions or is_counted):
        return True
    left = dict(units)
    while True:
        library = tuple(environment.transformation[label] for label in sorted({label for label, _ in left}))
        number: Counter[str] = Counter()
        for (label, _), there in left.items():
            number[label] += there
        possible = startable(Environment((), library), givers, units=number if is_counted else None)
        able = {
            (label, host): there
            for (label, host), there in left.items()
            if label in possible and all((t, host) in left for t in environment.transformation[label].beside)
        }
        if len(able) == len(left):
            break
        left = able
    if any(possible.isdisjoint(givers.of(target.tag)) for target in targets):
        return False
    return not is_counted or _can_share(candidates, left, targets)


def _can_share(candidates: Candidates, units: UnitsBySite, targets: tuple[Target, ...]) -> bool:
    """Whether units that can be fed if each stream feeds all who want it meet targets by what streams really feed."""
    library = candidates.environment.transformation
    kinds = [library[label] for label in {label for label, _ in units}]
    if not any(port.serves is not None for kind in kinds for port in kind.outputs) and not any(
        port.count == ALL for kind in kinds for port in kind.inputs
    ):
        return True
    from cfgplan.planners.exact.sharing import Sharing  # the solver takes long to import

    case = frozenset(units.items()), targets
    if case not in candidates.can_share:
        candidates.can_share[case] = Sharing(candidates, units.items(), targets).exists()
    return candidates.can_share[case]


def bears_all_failures(candidates: Candidates, units: Collection[ComputationUnit]) -> bool:
    """Whether no single failure leaves a target without a stream; always so if none has to be survived."""
    return not any(unmet(candidates, failure) for failure in failures(candidates, units))


def can_do_without(candidates: Candidates, units: Collection[ComputationUnit], one: ComputationUnit) -> bool:
    """Whether units that bear all failures do so without `one`; failures that leave others of its site don't matter."""
    others = [unit for unit in units if unit is not one]
    site = site_of(candidates.environment, one.transformation, one.host)
    matter = (f for f in failures(candidates, others) if are_counted(candidates) or site not in f.left)
    return not any(unmet(candidates, failure) for failure in matter)
