"""Single failures that leave a target without a stream, found by starting the remaining units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Final

from cfgplan.domain import ALL, ComputationUnit, Environment, Target
from cfgplan.frozen import dataclass
from cfgplan.planners.exact.candidates import Candidates, HostName, Site
from cfgplan.planners.exact.rule import CheckedUnits, Rule
from cfgplan.planners.networks.reach import Reach
from cfgplan.planning import Failures, Feature
from cfgplan.reasons import startable

UnitsBySite = Mapping[Site, int]
"""How many units of each site there are; 1 for any number where that does not matter, see `are_counted`."""


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
    """Whether the number of units of a site matters: inputs take several streams, or outputs serve only so many."""
    return not {Feature.COUNTS, Feature.LIMITS}.isdisjoint(candidates.problem.features)


def units_of_sites(candidates: Candidates, units: Iterable[ComputationUnit]) -> UnitsBySite:
    """How many units of each site some units are."""
    number = Counter(site_of(candidates.environment, unit.transformation, unit.host) for unit in units)
    return number if are_counted(candidates) else dict.fromkeys(number, 1)


def failures(candidates: Candidates, units: Collection[ComputationUnit]) -> Iterator[Failure]:
    """The single failures to be survived that leave fewer units of some site."""
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
    """Return the targets that the remaining units can't meet after a failure.

    First each target by itself; if each can be met, all targets together if they can't be met at once. Units of one
    site are interchangeable, so only their remaining number matters.
    """
    reach = Reach(candidates.network.core, candidates.numbers(label for label, _ in failure.left))
    together = [failure.targets] if len(failure.targets) > 1 and are_counted(candidates) else []
    for wanted in ([(target,) for target in failure.targets], together):
        found = [targets for targets in wanted if not are_met(candidates, reach, failure.left, targets)]
        if found:
            return found
    return []


def are_met(candidates: Candidates, reach: Reach, units: UnitsBySite, targets: tuple[Target, ...]) -> bool:
    """Whether some units can meet targets, all at once. `reach` has to be that of their labels."""
    if not all(reach.holds(candidates.network.fact_of_tag.get(target.tag)) for target in targets):
        return False
    environment, givers = candidates.environment, candidates.givers
    is_counted = are_counted(candidates)
    if not (candidates.network.special or environment.companions or is_counted):
        return True
    left = _able(candidates, units)
    labels = {label for label, _ in left}
    if any(labels.isdisjoint(givers.of(target.tag)) for target in targets):
        return False
    return not is_counted or _can_share(candidates, left, targets)


def _able(candidates: Candidates, units: UnitsBySite) -> UnitsBySite:
    """The units that can run if all of them may, and each stream feeds all who want it."""
    library, is_counted = candidates.environment.transformation, are_counted(candidates)
    while True:
        number: Counter[str] = Counter()
        for (label, _), there in units.items():
            number[label] += there
        among = Environment((), tuple(library[label] for label in sorted(number)))
        possible = startable(among, candidates.givers, units=number if is_counted else None)
        able = {
            (label, host): there
            for (label, host), there in units.items()
            if label in possible and all((other, host) in units for other in library[label].beside)
        }
        if len(able) == len(units):
            return able
        units = able


def _can_share(candidates: Candidates, units: UnitsBySite, targets: tuple[Target, ...]) -> bool:
    """Whether units that are `_able` to run meet targets also if outputs serve only so many and inputs take all."""
    library = candidates.environment.transformation
    kinds = [library[label] for label in {label for label, _ in units}]
    is_limited = any(port.serves is not None for kind in kinds for port in kind.outputs)
    if not is_limited and not any(port.count == ALL for kind in kinds for port in kind.inputs):
        return True
    from cfgplan.planners.exact.sharing import can_share  # the solver takes long to import

    case = frozenset(units.items()), targets
    if case not in candidates.can_share:
        candidates.can_share[case] = can_share(candidates.of_sites(units, targets))
    return candidates.can_share[case]


def bears_all_failures(candidates: Candidates, units: Collection[ComputationUnit]) -> bool:
    """Whether no single failure leaves a target without a stream; always so if none has to be survived."""
    return not any(unmet(candidates, failure) for failure in failures(candidates, units))


def can_do_without(candidates: Candidates, units: Collection[ComputationUnit], one: ComputationUnit) -> bool:
    """Return whether units that survive all failures do so without `one`.

    If units are not counted, only failures that leave none of its site matter.
    """
    others = [unit for unit in units if unit is not one]
    site = site_of(candidates.environment, one.transformation, one.host)
    matter = (f for f in failures(candidates, others) if are_counted(candidates) or site not in f.left)
    return not any(unmet(candidates, failure) for failure in matter)


def _fatal_failures(checked: CheckedUnits) -> Iterator[str]:
    if not bears_all_failures(checked.candidates, checked.units):
        yield "a failure is not survived"


SURVIVED: Final = Rule(None, Feature.SURVIVAL, _fatal_failures, keeps_units=True)
"""The search demands what it takes, round by round: see `survival`."""
