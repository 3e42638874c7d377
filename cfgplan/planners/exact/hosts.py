"""The rules of hosts and links: capacities and costs, and transfers between hosts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from cfgplan.domain import Link, Objective, Transformation, amount_of
from cfgplan.figures import links_suffice
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planners.exact.rule import CheckedUnits, HostLoads, Rule
from cfgplan.planning import Feature

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import LinearExprT

    from cfgplan.planners.exact.model import Model


def a_stream_made_on_a_host_is_not_carried_there(model: Model) -> None:
    for (stream, host), carried in model.carried.items():
        here = model.runs_on[model.unit_of(stream)].get(host)
        if here is not None:
            model.cp.add_at_most_one(carried, here)


def links_keep_their_bandwidth_and_have_their_prices(model: Model) -> None:
    """Each link carries at most its bandwidth, and each transfer costs the price of its link.

    `Model.ways` has charged each carried stream its cheapest transfer; this rule adds the extra cost of any other one.
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
        model.cp.add(model.total(load) <= (link.bandwidth or 0))


def _overloaded_links(checked: CheckedUnits) -> Iterator[str]:
    if not links_suffice(checked.problem, checked.units):
        yield "a link has to carry too much"


def hosts_have_room_for_their_units(model: Model) -> None:
    """Each host has room for its units in each resource; cold spares count as running, as they must be able to run."""
    candidates = model.candidates.all
    on_hosts = ((i, host, there) for i in model.runs_on for host, there in model.there_on(i))
    taking = grouped((host, (there, candidates[i].places[host].takes)) for i, host, there in on_hosts)
    for kind in model.candidates.hosts:
        here = taking.get(kind.first, [])
        for resource in sorted({resource for _, takes in here for resource in takes} & kind.rooms.keys()):
            taken = [takes.get(resource, 0) * there for there, takes in here]
            model.cp.add(model.total(taken) <= kind.rooms[resource] * model.hosts_in_use(kind.first))


def _has_no_room(loads: HostLoads, kind: Transformation, name: HostName) -> Iterator[str]:
    host = None if name is None else loads.environment.host[name]
    for resource, amount in loads.takes(kind, name).items():
        room = None if host is None else host.room(resource, loads.problem.horizon_s)
        if room is not None and loads.taken[name, resource] + amount > room:
            yield f"{amount_of(resource, amount)} left"


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
            model.cp.add(used <= model.total(here))


def interchangeable_hosts_are_used_in_order(model: Model) -> None:
    """Of two interchangeable hosts, the earlier one is used if the later one is: this breaks the symmetry."""
    for kind, following in pairwise(model.candidates.hosts):
        if kind.rooms is following.rooms:
            model.cp.add(model.uses[following.first] <= model.uses[kind.first])


CARRYING: Final = (
    Rule(a_stream_made_on_a_host_is_not_carried_there),
    Rule(links_keep_their_bandwidth_and_have_their_prices, Feature.HOSTS, _overloaded_links),
)
ROOM: Final = (
    Rule(a_host_is_paid_and_counted_while_something_is_there, is_placed=True),
    Rule(hosts_have_room_for_their_units, Feature.HOSTS, lacks=_has_no_room, is_placed=True),
)
SYMMETRY: Final = Rule(interchangeable_hosts_are_used_in_order, is_placed=True)
