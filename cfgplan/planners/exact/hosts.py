"""The rules of hosts: capacities and costs, transfers between hosts, and units that exclude or need each other."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise, product

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
    for kind in model.candidates.hosts:
        here = taking.get(kind.first, [])
        for resource in sorted({resource for _, takes in here for resource in takes} & kind.rooms.keys()):
            taken = [takes.get(resource, 0) * there for there, takes in here]
            model.cp.add(LinearExpr.sum(taken) <= kind.rooms[resource] * model.hosts_in_use(kind.first))


def a_host_is_paid_and_counted_while_something_is_there(model: Model) -> None:
    having = grouped(has for i in model.runs_on for has in model.hosts_with(i))
    is_counted = model.is_grouped or Objective.HOSTS in model.environment.minimise
    for kind in model.candidates.hosts:
        if kind.first is None or not (kind.rent_us or is_counted):
            continue
        used = model.uses[kind.first] = model.boolean() if kind.is_one else model.cp.new_int_var(0, len(kind.names), "")
        model.more_costs.append(kind.rent_us * used)
        here = having.get(kind.first, [])
        for has in here:
            if kind.is_one:
                model.cp.add_implication(has, used)
            else:
                model.cp.add(has <= used)
        if model.is_grouped:
            model.cp.add(used <= LinearExpr.sum(here))


def hosts_alike_are_taken_in_order(model: Model) -> None:
    """Where each host is a kind of its own: the later ones have less on them."""
    for kind, following in pairwise(model.candidates.hosts):
        if kind.rooms is following.rooms:
            model.cp.add(model.uses[following.first] <= model.uses[kind.first])


def no_host_has_more_units_of_a_transformation_than_it_allows(model: Model) -> None:
    for t in model.environment.library:
        if t.per_host is not None:
            there = grouped(on for i in model.candidates.units_of(t.label) for on in model.there_on(i))
            for host, units in there.items():
                model.cp.add(LinearExpr.sum(units) <= t.per_host * model.hosts_in_use(host))


def units_that_conflict_are_not_on_one_host(model: Model) -> None:
    for transformation in model.environment.library:
        for other in transformation.conflicts_on_host:
            there = _hosts_with(model, other) if other != transformation.label else {}
            for host, these in _hosts_with(model, transformation.label).items():
                if model.candidates.host_kind[host].is_one:
                    are_apart(model, these, there.get(host, ()))
                    continue
                for one, second in product(these, there.get(host, ())):
                    model.cp.add(one + second <= model.hosts_in_use(host))


def beside_a_running_unit_run_those_that_it_runs_with(model: Model) -> None:
    for i, places in model.has_on.items():
        for other in model.candidates.all[i].transformation.beside:
            units = [model.has_on[j] for j in model.candidates.units_of(other)]
            for host, has in places.items():
                company = [there[host] for there in units if host in there]
                if model.candidates.host_kind[host].is_one:
                    model.needs_any(has, company)
                else:
                    model.cp.add(has <= LinearExpr.sum(company))


def _hosts_with(model: Model, label: str) -> dict[HostName, list[IntVar]]:
    """On how many hosts of each kind some units of a transformation run or wait; of one host, booleans."""
    return grouped(has for i in model.candidates.units_of(label) for has in model.hosts_with(i))
