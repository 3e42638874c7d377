"""The rules of units that may, or must, be there together: numbers of units, conflicts and company."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from itertools import product
from typing import TYPE_CHECKING, Final

from cfgplan.domain import ComputationUnit, Environment, Host, Transformation
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planners.exact.rule import CheckedUnits, HostLoads, Rule
from cfgplan.planning import Feature

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar

    from cfgplan.planners.exact.model import Model


def conflicting_units_do_not_exist_together(model: Model) -> None:
    for transformation in model.environment.library:
        for other in transformation.conflicts:
            if other != transformation.label:
                are_apart(model, _there(model, transformation.label), _there(model, other))


def _conflicts(checked: CheckedUnits) -> Iterator[str]:
    there = checked.there
    for kind in checked.environment.library:
        if kind.conflicts and there[kind.label] and any(there[o] for o in kind.conflicts if o != kind.label):
            yield f"units of {kind.label} are there with one that they conflict with"


def are_apart(model: Model, some: Iterable[IntVar], others: Iterable[IntVar]) -> None:
    for one, second in product(some, others):
        model.cp.add_at_most_one(one, second)


def _there(model: Model, label: str) -> list[IntVar]:
    """Return the `is_there` booleans of a transformation's units, running or as cold spares."""
    return [model.is_there[i] for i in model.candidates.units_of(label)]


def there_are_as_many_units_as_asked_for_and_allowed(model: Model) -> None:
    for t in model.environment.library:
        if t.min_instances:
            model.cp.add(model.total([model.number[i] for i in model.running(t.label)]) >= t.min_instances)
        units = model.candidates.units_of(t.label)
        if t.max_instances is not None and sum(model.candidates.all[i].size for i in units) > t.max_instances:
            model.cp.add(model.total([model.number_there(i) for i in units]) <= t.max_instances)


def _wrong_numbers(checked: CheckedUnits) -> Iterator[str]:
    for kind in checked.environment.library:
        if checked.running[kind.label] < kind.min_instances:
            yield f"too few units of {kind.label} run"
        if kind.max_instances is not None and checked.there[kind.label] > kind.max_instances:
            yield f"too many units of {kind.label} are there"


def no_host_has_more_units_of_a_transformation_than_it_allows(model: Model) -> None:
    for t in model.environment.library:
        if t.per_host is not None:
            there = grouped(on for i in model.candidates.units_of(t.label) for on in model.there_on(i))
            for host, units in there.items():
                model.cp.add(model.total(units) <= t.per_host * model.hosts_in_use(host))


def _is_full(loads: HostLoads, kind: Transformation, name: HostName) -> Iterator[str]:
    if kind.per_host is not None and loads.there[name][kind.label] >= kind.per_host:
        yield f"fewer than {kind.per_host} of them"


def selected_hosts_keep_their_common_limit(model: Model) -> None:
    for t in model.environment.library:
        there = [on for i in model.candidates.units_of(t.label) for on in model.there_on(i)] if t.at_most else []
        for text, most in t.at_most.items():
            chosen = [number for host, number in there if _fits(model.environment, host, text)]
            model.cp.add(model.total(chosen) <= most)


def _is_full_with_others(loads: HostLoads, kind: Transformation, name: HostName) -> Iterator[str]:
    for text, most in kind.at_most.items():
        if _fits(loads.environment, name, text):
            hosts = [host for host in loads.there if _fits(loads.environment, host, text)]
            if sum(loads.there[host][kind.label] for host in hosts) >= most:
                yield f"room for it, as {f'at most {most}' if most else 'none'} may run on {text}"


def _chosen_by(environment: Environment, host: Host) -> frozenset[str]:
    """The selectors of numbers of units that choose a host."""
    return frozenset(text for t in environment.library for text in t.at_most if host.fits(text))


def _fits(environment: Environment, name: HostName, text: str) -> bool:
    return name is not None and environment.host[name].fits(text)


def conflicting_units_are_not_on_one_host(model: Model) -> None:
    for transformation in model.environment.library:
        for other in transformation.conflicts_on_host:
            there = _hosts_with(model, other) if other != transformation.label else {}
            for host, these in _hosts_with(model, transformation.label).items():
                if model.candidates.host_kind[host].is_one:
                    are_apart(model, these, there.get(host, ()))
                    continue
                for one, second in product(these, there.get(host, ())):
                    model.cp.add(one + second <= model.hosts_in_use(host))


def _hosts_with(model: Model, label: str) -> dict[HostName, list[IntVar]]:
    """On how many hosts of each kind some units of a transformation run or wait; of one host, booleans."""
    return grouped(has for i in model.candidates.units_of(label) for has in model.hosts_with(i))


def _has_a_rival(loads: HostLoads, kind: Transformation, name: HostName) -> Iterator[str]:
    library = loads.environment.transformation
    for other in sorted(loads.there[name].keys() - {kind.label}):
        if other in kind.conflicts_on_host or kind.label in library[other].conflicts_on_host:
            yield f"no unit of {other}"


def companions_run_beside_a_running_unit(model: Model) -> None:
    for i, places in model.has_on.items():
        for other in model.candidates.all[i].transformation.beside:
            units = [model.has_on[j] for j in model.candidates.units_of(other)]
            for host, has in places.items():
                company = [there[host] for there in units if host in there]
                if model.candidates.host_kind[host].is_one:
                    model.needs_any(has, company)
                else:
                    model.cp.add(has <= model.total(company))


def have_company(environment: Environment, units: Collection[ComputationUnit]) -> bool:
    """Whether on the host of each running unit there runs one of each transformation that it runs with."""
    if not environment.companions:
        return True
    running = running_on(units)
    return all(
        running.get((unit.host, label))
        for unit in units
        if not unit.standby
        for label in environment.transformation[unit.transformation].beside
    )


Running = dict[tuple[HostName, str], list[str]]
"""The ids of the running units of each transformation on each host."""


def running_on(units: Iterable[ComputationUnit]) -> Running:
    """The running units of some."""
    return grouped(((unit.host, unit.transformation), unit.id) for unit in units if not unit.standby)


def _alone(checked: CheckedUnits) -> Iterator[str]:
    if not have_company(checked.environment, checked.units):
        yield "a unit runs without one that it runs with"


COMPANY: Final = (
    Rule(conflicting_units_do_not_exist_together, Feature.CONFLICTS, _conflicts),
    Rule(there_are_as_many_units_as_asked_for_and_allowed, Feature.INSTANCES, _wrong_numbers, keeps_units=True),
    Rule(no_host_has_more_units_of_a_transformation_than_it_allows, Feature.INSTANCES, lacks=_is_full, is_placed=True),
    Rule(
        selected_hosts_keep_their_common_limit,
        Feature.INSTANCES,
        lacks=_is_full_with_others,
        trait=_chosen_by,
        is_placed=True,
    ),
    Rule(conflicting_units_are_not_on_one_host, Feature.CONFLICTS, lacks=_has_a_rival, is_placed=True),
    Rule(companions_run_beside_a_running_unit, Feature.BESIDE, _alone, is_placed=True, keeps_units=True),
)
