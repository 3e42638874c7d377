"""The rules of inputs: each is fed by present streams, and a unit's feeders come before it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from cfgplan.domain import ALL, InputPort, Stream
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planners.exact.rule import CheckedUnits, Rule
from cfgplan.planners.networks.keys import is_well_wired

if TYPE_CHECKING:
    from ortools.sat.python.cp_model import IntVar

    from cfgplan.planners.exact.model import Model


def a_staying_unit_keeps_its_feeders(model: Model) -> None:
    """It stays if its streams are present, grounded before it except at feedback inputs; for topics see targets."""
    for i, stays in model.stays.items():
        candidate = model.candidates.all[i]
        assert candidate.running is not None
        (host,) = candidate.hosts
        kept = [(candidate.transformation.input[s.port], s.stream) for s in candidate.running.subscriptions]
        model.rests_on_all(stays, [model.present(stream, host) for port, stream in kept if not port.feedback])
        for stream in [stream for port, stream in kept if port.feedback]:
            model.cp.add_implication(stays, model.present(stream, host))


def a_wired_unit_is_fed(model: Model) -> None:
    """An input depends on its hub or, if it has variables of its own, on its feeders; a feedback input takes any
    running unit.
    """
    for i in model.candidates.clock.each(model.runs):
        inputs = model.candidates.all[i].transformation.inputs
        explicit = [port for port in inputs if model.is_explicit(i, port)]
        apart = {port.name: an_explicit_input_has_its_feeders(model, i, port) for port in explicit}
        for port in inputs:
            if port.name not in apart and model.is_counted(port):
                a_counted_input_has_its_number(model, i, port)
        for host, wired in model.wired_on(i).items():
            parts = []
            for port in inputs:
                if port.name in apart:
                    parts += apart[port.name]
                elif model.is_counted(port):
                    continue
                elif port.feedback:
                    model.needs_any(wired, [way for s in model.choices(port.tag) for way in model.ways(s, host)])
                else:
                    parts.append(model.hub(port.tag, host))
            model.rests_on_all(wired, parts)


def an_explicit_input_has_its_feeders(model: Model, unit: int, port: InputPort) -> list[IntVar]:
    """Add a boolean for each stream that may feed an input. Returns the literals that the unit's wiring rests on."""
    may_be_own = port.feedback and port.count != ALL
    streams = [s for s in model.choices(port.tag) if model.unit_of(s) != unit or may_be_own]
    connects = model.connects[unit, port.name] = {stream: model.boolean() for stream in streams}
    if port.is_usual:
        model.cp.add_exactly_one(*connects.values(), model.runs[unit].negated())
    else:
        an_input_takes_its_number_of_streams_or_none(model, unit, port)
    running = model.candidates.all[unit].running
    if unit in model.stays and running is not None:
        feeds = running.feeds.get(port.name, ())
        for kept in feeds:
            same = [c for s, c in connects.items() if s == kept or (s.unit == kept.unit and not model.tells_ports)]
            model.cp.add_implication(model.stays[unit], same[0])
        if not feeds:
            model.cp.add_implication(model.stays[unit], model.is_fed[unit, port.name].negated())
        for connected in [c for s, c in connects.items() if s not in feeds] if port.count == ALL else ():
            model.cp.add_implication(model.stays[unit], connected.negated())
    for stream, connected in connects.items():
        feeder = model.runs[model.unit_of(stream)]
        if port.feedback:
            model.cp.add_implication(connected, feeder)
        else:
            model.rests_on_all(connected, [feeder])
        for host, on in model.runs_on[unit].items() if stream in model.placed else ():
            model.cp.add_bool_or([connected.negated(), on.negated(), *model.ways(stream, host)])
    if port.feedback:
        return []
    if not port.is_usual:
        return [_grounded_if_it_holds(model, connected) for connected in connects.values()]
    fed = model.boolean()
    model.rests_on_any(fed, list(connects.values()))
    return [fed]


def a_counted_input_has_its_number(model: Model, unit: int, port: InputPort) -> None:
    """As many units run as an input counts; where they serve only so many, the streams that a group takes are counted.

    A unit that stays keeps its streams. No unit of the group may feed another, directly or through others.
    """
    streams, size = model.choices(port.tag), model.candidates.all[unit].size
    of_feeders = grouped((model.unit_of(stream), stream) for stream in streams)
    enough = model.total([model.number[feeder] for feeder in of_feeders]) >= port.count
    model.cp.add(enough).only_enforce_if(model.runs[unit])
    if model.serves.keys().isdisjoint(streams):
        return
    takes = model.takes[unit, port.name] = {}
    for feeder, outputs in of_feeders.items():
        units = model.candidates.all[feeder].size
        most = size * min(port.count, units)
        takes |= {stream: model.cp.new_int_var(0, most, "") for stream in outputs}
        taken = model.total([takes[stream] for stream in outputs])
        if port.count == 1 or size == 1:
            model.cp.add(taken <= size * model.number[feeder])
            continue
        pairs = model.cp.new_int_var(0, size * units, "")
        model.cp.add_multiplication_equality(pairs, [model.number[feeder], model.number[unit]])
        model.cp.add(taken <= pairs)
    model.cp.add(model.total([*takes.values()]) == port.count * model.number[unit])
    running = model.candidates.all[unit].running
    for stream in running.feeds.get(port.name, ()) if unit in model.stays and running is not None else ():
        model.cp.add(model.stays[unit] <= takes[stream])


def an_input_takes_its_number_of_streams_or_none(model: Model, unit: int, port: InputPort) -> None:
    """An input takes `count` streams of different units, or `all` streams of others. An optional one may take none."""
    connects, runs = model.connects[unit, port.name], model.runs[unit]
    fed = model.is_fed[unit, port.name] = model.boolean() if port.optional else runs
    if port.optional:
        model.cp.add_implication(fed, runs)
        model.more_costs.append(port.worth_us * model.problem.horizon_s * (runs - fed))
    of_units = grouped((model.unit_of(stream), connected) for stream, connected in connects.items())
    if port.count == ALL:
        model.needs_any(fed, list(connects.values()))
        for feeder, literals in of_units.items():
            for connected in literals:
                model.cp.add_implication(connected, fed)
                model.cp.add_implication(connected, model.runs[feeder])
                model.cp.add_bool_or([connected, runs.negated(), model.runs[feeder].negated()])
        return
    model.cp.add(port.count * fed == model.total(list(connects.values())))
    for literals in of_units.values() if port.count > 1 else ():
        model.cp.add_at_most_one(literals)


def _grounded_if_it_holds(model: Model, literal: IntVar) -> IntVar:
    """A boolean that rests on a literal where that holds, and on nothing else."""
    unneeded, found = model.boolean(), model.boolean()
    model.cp.add(unneeded != literal)
    model.support.rests_on_all(unneeded.index, [])
    model.rests_on_any(found, [literal, unneeded])
    return found


def inputs_of_a_group_are_fed_by_different_transformations(model: Model) -> None:
    for i in model.runs:
        sharing = grouped(
            ((port.distinct, model.candidates.label_of(stream)), connected)
            for port in model.candidates.all[i].transformation.inputs
            if port.distinct is not None
            for stream, connected in model.connects[i, port.name].items()
        )
        for connections in sharing.values():
            if len(connections) > 1:
                model.cp.add_at_most_one(connections)


def units_that_feed_each_other_come_one_after_the_other(model: Model) -> None:
    """An implied rule: inputs that may stay unfed allow too many cycles to cut each of them lazily.

    In small problems there are as many where streams are counted, limited or compared.
    """
    if not model.orders_rings:
        return
    from networkx import DiGraph, strongly_connected_components

    candidates = model.candidates
    feeds = [
        (candidates.index_of[stream.unit], unit, connected)
        for (unit, name), connects in model.connects.items()
        for stream, connected in connects.items()
        if not candidates.all[unit].transformation.input[name].feedback
    ]
    cycles = strongly_connected_components(DiGraph([(feeder, unit) for feeder, unit, _ in feeds]))
    for cycle in (cycle for cycle in cycles if len(cycle) > 1):
        place = {unit: model.cp.new_int_var(1, len(cycle), "") for unit in sorted(cycle)}
        for feeder, unit, connected in feeds:
            if feeder in cycle and unit in cycle:
                model.cp.add(place[feeder] < place[unit]).only_enforce_if(connected)


def a_demand_is_met_first_by_a_unit_that_does_not_need_it(model: Model) -> None:
    """This holds on each host, and for all hosts together."""
    a_demand_met_on_a_host_is_met_at_all(model)
    for (demand, host), hub in model.candidates.clock.each(model.hubs.items()):
        first = {stream: _first_ways(model, stream, demand, host) for stream in model.streams_of(demand)}
        ways = {way.index: way for these in first.values() for way in these}
        if demand in model.is_apart_for_quality and (host is not None or not model.is_carried(demand)):
            model.needs_any(hub, list(ways.values()))
            one_stream_meets_a_demand(model, (demand, host), first)
        else:
            model.rests_on_any(hub, list(ways.values()))


def a_demand_met_on_a_host_is_met_at_all(model: Model) -> None:
    """Also the demands of each running unit are met, on whatever host it is.

    This is implied, but the model's relaxation, which spreads units over hosts, is much weaker without it.
    """
    on_hosts = list(dict.fromkeys(demand for demand, host in model.hubs if host is not None))
    for demand in on_hosts:
        model.hubs.setdefault((demand, None), model.boolean())
    for (demand, host), hub in model.hubs.items():
        if host is not None:
            model.cp.add_implication(hub, model.hubs[demand, None])
    needs: dict[int, list[IntVar]] = {i: [] for i in (model.runs if on_hosts else ())}
    for demand in on_hosts:
        met = model.hubs[demand, None]
        for unit in sorted(model.needing[demand]):
            needs[unit].append(met)
            model.cp.add_implication(model.runs[unit], met)
        first = [s for s in model.streams_of(demand) if model.unit_of(s) not in model.needing[demand]]
        model.anywhere.rests_on_any(met.index, sorted({model.runs[model.unit_of(stream)].index for stream in first}))
    for unit, met_at_all in needs.items():
        model.anywhere.rests_on_all(model.runs[unit].index, [met.index for met in met_at_all])


def _first_ways(model: Model, stream: Stream, demand: int, host: HostName) -> list[IntVar]:
    """The ways by which a stream may be the first on a host to meet a demand."""
    unit = model.unit_of(stream)
    if unit not in model.needing[demand]:
        return model.ways(stream, host)
    here = model.runs[unit] if host is None else model.runs_on[unit].get(host)
    return [way for way in model.ways(stream, host) if way is not here]


def one_stream_meets_a_demand(model: Model, key: tuple[int, HostName], first: dict[Stream, list[IntVar]]) -> None:
    """Each wired consumer of the demand takes the hub's stream, and so has its quality."""
    meets = model.meets[key] = {stream: model.boolean() for stream, ways in first.items() if ways}
    for stream, taken in meets.items():
        model.rests_on_any(taken, first[stream])
    model.cp.add_exactly_one(*meets.values(), model.hubs[key].negated())
    model.support.rests_on_any(model.hubs[key].index, [taken.index for taken in meets.values()])


def _badly_wired(checked: CheckedUnits) -> Iterator[str]:
    def label_of(unit_id: str) -> str | None:
        unit = checked.hot.get(unit_id)
        return None if unit is None else unit.transformation

    for unit in checked.hot.values():
        if not is_well_wired(checked.problem, label_of, unit):
            yield f"unit {unit.id} is not wired as its transformation asks"


def _cycles(checked: CheckedUnits) -> Iterator[str]:
    """Units that do not all come after those that feed their ordinary inputs."""
    waits_for: dict[str, set[str]] = {}
    for unit in checked.hot.values():
        feedback = [port.name for port in checked.kind(unit).inputs if port.feedback]
        waits_for[unit.id] = {s.stream.unit for s in unit.subscriptions if s.port not in feedback}
    readers = grouped((feeder, unit_id) for unit_id, feeders in waits_for.items() for feeder in feeders)
    fed = {unit_id: len(feeders) for unit_id, feeders in waits_for.items()}
    ahead = [unit_id for unit_id, number in fed.items() if not number]
    for unit_id in ahead:
        for reader in readers.get(unit_id, ()):
            fed[reader] -= 1
            if not fed[reader]:
                ahead.append(reader)
    if len(ahead) < len(checked.hot):
        yield "units feed each other in a cycle"


FEEDING: Final = (
    Rule(a_staying_unit_keeps_its_feeders),
    Rule(a_wired_unit_is_fed, flaws=_badly_wired),
    Rule(inputs_of_a_group_are_fed_by_different_transformations),
    Rule(units_that_feed_each_other_come_one_after_the_other),
    Rule(a_demand_is_met_first_by_a_unit_that_does_not_need_it, flaws=_cycles),
)
