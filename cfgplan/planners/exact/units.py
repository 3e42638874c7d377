"""The rules of single units: the state of each, and the order of those that are interchangeable."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidate, HostKind
from cfgplan.planners.exact.rule import CheckedUnits, Rule
from cfgplan.planning import Feature

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar

    from cfgplan.planners.exact.model import Model


def a_unit_runs_or_waits_in_one_place(model: Model) -> None:
    for i, candidate in model.candidates.clock.each(enumerate(model.candidates.all)):
        if candidate.size > 1:
            _several_run_in_places(model, i)
            continue
        model.runs_on[i] = {host: model.boolean() for host in candidate.hosts} if candidate.may_run else {}
        model.numbers_on[i] = model.has_on[i] = model.runs_on[i]
        model.waits_on[i] = {host: model.boolean() for host in candidate.hosts} if candidate.may_wait else {}
        if candidate.may_run:
            model.runs[i] = model.number[i] = _any_of(model, list(model.runs_on[i].values()))
        if candidate.may_wait:
            model.waits[i] = _any_of(model, list(model.waits_on[i].values()))
        model.is_there[i] = _any_of(model, [state[i] for state in (model.runs, model.waits) if i in state])
        if len(candidate.hosts) > 1 and candidate.may_run:
            model.support.rests_on_any(model.runs[i].index, [on.index for on in model.runs_on[i].values()])


def _several_run_in_places(model: Model, unit: int) -> None:
    """Units of a group run on hosts of kinds: on each host as many as fit there."""
    candidate = model.candidates.all[unit]
    model.runs_on[unit], model.waits_on[unit] = {}, {}
    numbers, has = model.numbers_on[unit], model.has_on[unit] = {}, {}
    for host in candidate.places:
        kind = model.candidates.host_kind[host]
        most = most_on_one(candidate, kind)
        has[host] = model.boolean() if kind.is_one else model.cp.new_int_var(0, len(kind.names), "")
        numbers[host] = has[host]
        if most != 1:
            numbers[host] = model.cp.new_int_var(0, min(candidate.size, most * len(kind.names)), "")
            model.cp.add(numbers[host] <= most * has[host])
            model.cp.add(has[host] <= numbers[host])
    model.number[unit] = model.cp.new_int_var(0, candidate.size, "")
    model.cp.add(model.number[unit] == model.total([*numbers.values()]))


def _misplaced(checked: CheckedUnits) -> Iterator[str]:
    environment = checked.environment
    allowed = {label: frozenset(environment.hosts_for(environment.transformation[label])) for label in checked.there}
    for unit in checked.units:
        if unit.host not in allowed[unit.transformation]:
            yield f"unit {unit.id} is on a host where it may not be"


def a_group_runs_if_some_of_its_units_do(model: Model) -> None:
    for i, candidate in enumerate(model.candidates.all):
        if candidate.size > 1:
            runs = model.runs[i] = model.is_there[i] = model.boolean()
            model.cp.add(model.number[i] <= candidate.size * runs)
            model.cp.add(model.number[i] >= runs)


def most_on_one(candidate: Candidate, kind: HostKind) -> int:
    """How many units of a candidate fit on one host of a kind."""
    takes, per_host = candidate.places[kind.first].takes, candidate.transformation.per_host
    by_room = [room // takes[each] for each, room in kind.rooms.items() if takes.get(each)]
    return min([candidate.size, *by_room, *([] if per_host is None else [per_host])])


def _any_of(model: Model, literals: list[IntVar]) -> IntVar:
    """The boolean that one of some literals holds; no two of them may."""
    if len(literals) == 1:
        return literals[0]
    found = model.boolean()
    model.cp.add_exactly_one(*literals, found.negated())
    return found


def a_kept_unit_stays_or_is_rewired(model: Model) -> None:
    for i, runs in model.runs.items():
        model.is_wired[i] = runs
        if model.candidates.may_stay(i):
            stays, wired = model.boolean(), model.boolean()
            model.stays[i], model.is_wired[i] = stays, wired
            model.cp.add_exactly_one(stays, wired, runs.negated())
            model.support.rests_on_any(runs.index, [stays.index, wired.index])


def pinned_units_run(model: Model) -> None:
    for i, runs in model.runs.items():
        if model.candidates.is_pinned(i):
            model.cp.add_bool_or([runs])


def _missing_pinned(checked: CheckedUnits) -> Iterator[str]:
    ids, environment = {unit.id for unit in checked.units}, checked.environment
    for unit in environment.units:
        kind = environment.transformation.get(unit.transformation)
        if kind is None or not kind.pinned or unit.standby or unit.id in ids:
            continue
        may_stay = not environment.hosts or unit.host in environment.hosts_for(kind)
        if may_stay and kind.label in checked.candidates.closure.possible:
            yield f"the pinned unit {unit.id} is missing"


def new_units_come_in_order(model: Model) -> None:
    """New units of a transformation are interchangeable, so the first ones are used."""
    candidates = model.candidates.all
    for i in range(1, len(candidates)):
        one, next_one = candidates[i - 1], candidates[i]
        if one.transformation == next_one.transformation and one.running is None and next_one.running is None:
            model.cp.add_implication(model.is_there[i], model.is_there[i - 1])


def one_of_interchangeable_new_units_is_enough(model: Model) -> None:
    """At most one of several interchangeable new units that meet the same demands runs, and its consumers share it.

    This shortens the proof of problems without features; `closing.program` says why it holds. It is left out if
    transformations are required, since two of them may be wanted.
    """
    if model.problem.features or model.tracked:
        return
    candidates = model.candidates
    apart: set[int] = set()
    demands = {model.demand(target.tag): target.tag for target in model.environment.targets}
    for candidate in candidates.all:
        for port in candidate.transformation.inputs:
            demands[model.demand(port.tag)] = port.tag
            if port.distinct is not None:
                apart.update(candidates.feeders(port.tag))
    given = grouped((feeder, demand) for demand in sorted(demands) for feeder in candidates.feeders(demands[demand]))
    new = [unit for unit, candidate in enumerate(candidates.all) if candidate.running is None and unit not in apart]
    for units in grouped((tuple(given[unit]), unit) for unit in new).values():
        if len(units) > 1:
            model.cp.add_at_most_one(model.runs[unit] for unit in units)
            _needs_are_shared(model, units)


def _needs_are_shared(model: Model, units: list[int]) -> None:
    def hubs(unit: int) -> list[int]:
        ports = model.candidates.all[unit].transformation.inputs
        together = [port for port in ports if not port.feedback and not model.is_explicit(unit, port)]
        return sorted({model.hub(port.tag, None).index for port in together})

    for hub, sharing in grouped((hub, unit) for unit in units for hub in hubs(unit)).items():
        if len(sharing) > 1:
            met = model.cp.get_bool_var_from_proto_index(hub)
            model.cp.add_at_most_one([met.negated(), *(model.runs[unit] for unit in sharing)])


STATES: Final = (
    Rule(a_unit_runs_or_waits_in_one_place, is_placed=True),
    Rule(None, Feature.HOSTS, _misplaced),
    Rule(a_group_runs_if_some_of_its_units_do),
    Rule(a_kept_unit_stays_or_is_rewired),
)
PINNED: Final = Rule(pinned_units_run, flaws=_missing_pinned)
ORDER: Final = (Rule(new_units_come_in_order), Rule(one_of_interchangeable_new_units_is_enough))
