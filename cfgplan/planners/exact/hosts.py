"""The rules of hosts: capacities and costs, transfers between hosts, and units that exclude or need each other."""

from __future__ import annotations

from collections import defaultdict

from ortools.sat.python.cp_model import IntVar, LinearExpr, LinearExprT

from cfgplan.domain import Link, Objective
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.units import are_apart


def what_is_made_on_a_host_is_not_carried_there(model: Model) -> None:
    for (stream, host), carried in model.carried.items():
        here = model.runs_on[model.unit_of(stream)].get(host)
        if here is not None:
            model.cp.add_at_most_one(carried, here)


def links_bear_what_is_carried_and_have_their_prices(model: Model) -> None:
    """`Model.ways` has charged a carried stream its cheapest transfer. This rule adds the extra cost of any other
    transfer.
    """
    loads: dict[Link, list[LinearExprT]] = defaultdict(list)
    for (stream, host), carried in model.carried.items() if model.environment.links else ():
        costs_us = model.journeys_us(stream, host)
        least_us = min(costs_us.values())
        for origin, cost_us in costs_us.items():
            link = model.environment.link.get((origin or "", host or ""))
            is_limited = link is not None and link.bandwidth is not None
            if cost_us == least_us and not is_limited:
                continue
            journey = carried
            if len(costs_us) > 1:
                journey = model.boolean()
                made_there = model.runs_on[model.unit_of(stream)][origin]
                model.cp.add_bool_or([carried.negated(), made_there.negated(), journey])
            model.more_costs.append((cost_us - least_us) * journey)
            if link is not None and is_limited:
                loads[link].append(model.placed[stream] * journey)
    for link, load in loads.items():
        model.cp.add(LinearExpr.sum(load) <= (link.bandwidth or 0))


def hosts_bear_their_units(model: Model) -> None:
    """Each host has room for its units in each resource; cold spares count as running, as they must be able to run."""
    candidates = model.candidates.all
    on_hosts = ((i, host, there) for i in model.runs_on for host, there in model.there_on(i))
    taking = grouped((host, (there, candidates[i].places[host].takes)) for i, host, there in on_hosts)
    for host in model.environment.hosts:
        here = taking[host.name]
        for resource in sorted({resource for _, takes in here for resource in takes}):
            room = host.room(resource, model.problem.horizon_s)
            if room is not None:
                taken = [takes.get(resource, 0) * there for there, takes in here]
                model.cp.add(LinearExpr.sum(taken) <= room)


def a_host_is_paid_and_counted_while_something_is_there(model: Model) -> None:
    on_hosts = grouped(on for i in model.runs_on for on in model.there_on(i))
    for host in model.environment.hosts:
        if host.rent_us or Objective.HOSTS in model.environment.minimise:
            used = model.uses[host.name] = model.boolean()
            model.more_costs.append(host.rent_us * model.problem.horizon_s * used)
            for there in on_hosts[host.name]:
                model.cp.add_implication(there, used)


def no_host_has_more_units_of_a_transformation_than_it_allows(model: Model) -> None:
    for t in model.environment.library:
        if t.per_host is not None:
            for there in _on_hosts(model, t.label).values():
                model.cp.add(LinearExpr.sum(there) <= t.per_host)


def units_that_conflict_are_not_on_one_host(model: Model) -> None:
    for transformation in model.environment.library:
        for other in transformation.conflicts_on_host:
            there = _on_hosts(model, other) if other != transformation.label else {}
            for host, these in _on_hosts(model, transformation.label).items():
                are_apart(model, these, there.get(host, ()))


def beside_a_running_unit_run_those_that_it_runs_with(model: Model) -> None:
    for i, places in model.runs_on.items():
        for other in model.candidates.all[i].transformation.beside:
            units = [model.runs_on[j] for j in model.candidates.units_of(other)]
            for host, runs in places.items():
                model.needs_any(runs, [there[host] for there in units if host in there])


def _on_hosts(model: Model, label: str) -> dict[HostName, list[IntVar]]:
    """The booleans of a transformation on each host: one of its units runs or waits there."""
    return grouped(on for i in model.candidates.units_of(label) for on in model.there_on(i))
