"""Hosts in the constraint model: what they can bear, and streams that are carried from one to another."""

from __future__ import annotations

from ortools.sat.python.cp_model import IntVar, LinearExpr, LiteralT

from cfgplan.costs import transfer_cost_us
from cfgplan.domain import Stream
from cfgplan.planners.fleet.model import Model


def hosts_bear_their_units(model: Model) -> None:
    """CPU time and memory; cold spares count as if they ran, since they must be able to."""
    numbered = list(enumerate(model.candidates.all))
    for host in model.environment.hosts:
        for needs, has in (
            ([c.transformation.upkeep_us for _, c in numbered], host.cpu_us),
            ([c.transformation.needs_mb for _, c in numbered], host.memory_mb),
        ):
            if has is not None:
                on_it = [
                    need * model.is_on[i][host.name]
                    for (i, c), need in zip(numbered, needs, strict=True)
                    if host.name in c.hosts
                ]
                model.cp.add(LinearExpr.sum(on_it) <= has)


def streams_are_carried_to_where_they_are_wanted(model: Model) -> None:
    """Once for each stream and host that is not its own; the cost is added to the others."""
    problem, environment = model.problem, model.environment
    carried: dict[tuple[Stream, str], IntVar] = {}
    price = {
        Stream(c.id, port.name): transfer_cost_us(port, problem.horizon_s, environment.transfer_us)
        for c in model.candidates.all
        for port in c.transformation.outputs
    }

    def carry(stream: Stream, host: str | None, unless: list[LiteralT]) -> None:
        """The stream is carried to the host unless it is made there or one of these holds."""
        if host is None or price[stream] == 0:
            return
        model.candidates.watch()
        here = model.is_on[model.candidates.index_of[stream.unit]].get(host)
        if (stream, host) not in carried:
            carried[stream, host] = model.boolean()
        model.cp.add_bool_or([*unless, *([] if here is None else [here]), carried[stream, host]])

    for (i, _), choices in model.connects.items():
        for stream, connected in choices.items():
            if stream.unit != model.candidates.all[i].id:
                for host, is_on in model.is_on[i].items():
                    carry(stream, host, [connected.negated(), is_on.negated()])
    for target in environment.targets:
        for stream, publishes in model.publishes[target.topic].items():
            carry(stream, target.host, [publishes.negated()])
    model.more_costs += [price[stream] * is_carried for (stream, _), is_carried in carried.items()]
