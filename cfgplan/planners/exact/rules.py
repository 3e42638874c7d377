"""The rules of an update in the constraint model, each in one function that adds nothing where nobody asks for it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Final

from ortools.sat.python.cp_model import IntVar, LinearExpr, LinearExprT, LiteralT

from cfgplan.domain import ALL, InputPort, Link, Objective, Stream
from cfgplan.onward import reached
from cfgplan.planners.exact.candidates import HostName
from cfgplan.planners.exact.model import Model, ModelRule
from cfgplan.planners.exact.quality import targets_get_the_quality_they_ask_for
from cfgplan.planning import Notion


def a_unit_runs_or_waits_in_one_place(model: Model) -> None:
    for i, candidate in model.candidates.clock.each(enumerate(model.candidates.all)):
        model.runs_on[i] = {host: model.boolean() for host in candidate.hosts} if candidate.may_run else {}
        model.waits_on[i] = {host: model.boolean() for host in candidate.hosts} if candidate.may_wait else {}
        if candidate.may_run:
            model.runs[i] = _any_of(model, list(model.runs_on[i].values()))
        if candidate.may_wait:
            model.waits[i] = _any_of(model, list(model.waits_on[i].values()))
        states = [*model.runs_on[i].values(), *model.waits_on[i].values()]
        if candidate.may_run and candidate.may_wait:
            model.is_there[i] = _any_of(model, states)
        else:
            model.is_there[i] = model.runs[i] if candidate.may_run else model.waits[i]
        if len(candidate.hosts) > 1 and candidate.may_run:
            model.support.rests_on_any(model.runs[i].index, [on.index for on in model.runs_on[i].values()])


def _any_of(model: Model, literals: list[IntVar]) -> IntVar:
    """The boolean that one of some literals holds; no two of them may."""
    if len(literals) == 1:
        return literals[0]
    found = model.boolean()
    model.cp.add_exactly_one(*literals, found.negated())
    return found


def a_kept_unit_stays_or_is_wired_anew(model: Model) -> None:
    for i, runs in model.runs.items():
        model.is_wired[i] = runs
        if model.candidates.may_stay(i):
            stays, wired = model.boolean(), model.boolean()
            model.stays[i], model.is_wired[i] = stays, wired
            model.cp.add_exactly_one(stays, wired, runs.negated())
            model.support.rests_on_any(runs.index, [stays.index, wired.index])


def a_staying_unit_keeps_its_feeders(model: Model) -> None:
    """It stays if its streams are there, grounded before it except at feedback inputs; for topics see targets."""
    for i, stays in model.stays.items():
        candidate = model.candidates.all[i]
        assert candidate.running is not None
        (host,) = candidate.hosts
        kept = [(candidate.transformation.input[s.port], s.stream) for s in candidate.running.subscriptions]
        model.rests_on_all(stays, [model.present(stream, host) for port, stream in kept if not port.feedback])
        for stream in [stream for port, stream in kept if port.feedback]:
            model.cp.add_implication(stays, model.present(stream, host))


def a_wired_unit_is_fed(model: Model) -> None:
    """Inputs rest on hubs, or on feeders told apart; a feedback input is fed by any unit that runs."""
    for i in model.candidates.clock.each(model.runs):
        inputs = model.candidates.all[i].transformation.inputs
        told_apart = [port for port in inputs if model.is_told_apart(i, port)]
        apart = {port.name: an_input_told_apart_has_its_feeders(model, i, port) for port in told_apart}
        for host, wired in model.wired_on(i).items():
            parts = []
            for port in inputs:
                if port.name in apart:
                    parts += apart[port.name]
                elif port.feedback:
                    model.needs_any(wired, [way for s in model.choices(port.tag) for way in model.ways(s, host)])
                else:
                    parts.append(model.hub(port.tag, host))
            model.rests_on_all(wired, parts)


def an_input_told_apart_has_its_feeders(model: Model, unit: int, port: InputPort) -> list[IntVar]:
    """Add a boolean for each stream that may feed an input. Returns what the unit's wiring then rests on."""
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
        for host, on in model.runs_on[unit].items() if model.is_placed(stream) else ():
            model.cp.add_bool_or([connected.negated(), on.negated(), *model.ways(stream, host)])
    if port.feedback:
        return []
    if not port.is_usual:
        return [_grounded_if_it_holds(model, connected) for connected in connects.values()]
    fed = model.boolean()
    model.rests_on_any(fed, list(connects.values()))
    return [fed]


def _grounded_if_it_holds(model: Model, literal: IntVar) -> IntVar:
    """A boolean that rests on a literal where that holds, and on nothing else."""
    unneeded, found = model.boolean(), model.boolean()
    model.cp.add(unneeded != literal)
    model.support.rests_on_all(unneeded.index, [])
    model.rests_on_any(found, [literal, unneeded])
    return found


def units_that_feed_each_other_come_one_after_the_other(model: Model) -> None:
    """Implied, but where inputs need not be fed there are too many ways to close a ring to cut them one by one."""
    if Notion.OPTIONAL not in model.problem.notions:
        return
    from networkx import DiGraph, strongly_connected_components

    candidates = model.candidates
    feeds = [
        (candidates.index_of[stream.unit], unit, connected)
        for (unit, name), connects in model.connects.items()
        for stream, connected in connects.items()
        if not candidates.all[unit].transformation.input[name].feedback
    ]
    rings = strongly_connected_components(DiGraph([(feeder, unit) for feeder, unit, _ in feeds]))
    for ring in (ring for ring in rings if len(ring) > 1):
        place = {unit: model.cp.new_int_var(1, len(ring), "") for unit in sorted(ring)}
        for feeder, unit, connected in feeds:
            if feeder in ring and unit in ring:
                model.cp.add(place[feeder] < place[unit]).only_enforce_if(connected)


def an_input_takes_its_number_of_streams_or_none(model: Model, unit: int, port: InputPort) -> None:
    """So many streams of different units, or all that there are of other ones; none at an optional input."""
    connects, runs = model.connects[unit, port.name], model.runs[unit]
    fed = model.is_fed[unit, port.name] = model.boolean() if port.optional else runs
    if port.optional:
        model.cp.add_implication(fed, runs)
        model.more_costs.append(port.worth_us * model.problem.horizon_s * (runs - fed))
    of_units: dict[int, list[IntVar]] = defaultdict(list)
    for stream, connected in connects.items():
        of_units[model.unit_of(stream)].append(connected)
    if port.count == ALL:
        model.needs_any(fed, list(connects.values()))
        for feeder, literals in of_units.items():
            for connected in literals:
                model.cp.add_implication(connected, fed)
                model.cp.add_implication(connected, model.runs[feeder])
                model.cp.add_bool_or([connected, runs.negated(), model.runs[feeder].negated()])
        return
    model.cp.add(port.count * fed == LinearExpr.sum(list(connects.values())))
    for literals in of_units.values() if port.count > 1 else ():
        model.cp.add_at_most_one(literals)


def inputs_of_a_group_are_fed_by_different_transformations(model: Model) -> None:
    candidates = model.candidates.all
    for i in model.runs:
        sharing: dict[tuple[str, str], list[IntVar]] = defaultdict(list)
        for port in candidates[i].transformation.inputs:
            if port.distinct is not None:
                for stream, connected in model.connects[i, port.name].items():
                    sharing[port.distinct, candidates[model.unit_of(stream)].transformation.label].append(connected)
        for connections in sharing.values():
            if len(connections) > 1:
                model.cp.add_at_most_one(connections)


def a_target_is_published_by_one_unit(model: Model) -> None:
    """A staying unit publishes exactly what it published before."""
    for target in model.environment.stream_targets:
        choices = model.publishes[target.label] = {}
        others: list[IntVar] = []
        for stream in model.choices(target.tag):
            feeder = model.unit_of(stream)
            running = model.candidates.all[feeder].running
            is_told_apart = model.is_apart or target.quality or feeder in model.tracked or stream in model.serves
            if not is_told_apart and running is None:
                others += model.ways(stream, target.host)
                continue
            publishes = choices[stream] = model.boolean()
            model.rests_on_all(publishes, [model.present(stream, target.host)])
            if running is not None and feeder in model.stays:
                keeps = any(
                    p.topic == target.topic and (p.port == stream.port or not model.tells_ports)
                    for p in running.publications
                )
                model.cp.add_implication(model.stays[feeder], publishes if keeps else publishes.negated())
        publishers = list(choices.values())
        if others:
            publishers.append(model.boolean())
            model.rests_on_any(publishers[-1], others)
        met = model.boolean()
        model.rests_on_any(met, publishers)
        model.cp.add_exactly_one(publishers)
        model.cp.add(met == 1)


def a_unit_runs_that_a_target_wants(model: Model) -> None:
    """Where it matters who feeds whom there is a boolean for the first unit that runs, as for one that publishes."""
    for target, label in model.environment.wanted_to_run.items():
        running = [(i, model.runs[i]) for i in model.to_run(label)]
        met = model.boolean()
        model.rests_on_any(met, [runs for _, runs in running])
        model.cp.add(met == 1)
        choices = model.publishes[target] = {}
        for number, (i, runs) in enumerate(running):
            if i not in model.tracked:
                continue
            earlier = [before.negated() for _, before in running[:number]]
            choices[Stream(model.candidates.all[i].id, "")] = _only_if(model, runs, *earlier)


def a_demand_is_met_first_by_a_unit_that_does_not_need_it(model: Model) -> None:
    """On each host, and at all."""
    what_is_met_on_a_host_is_met_at_all(model)
    for (demand, host), hub in model.candidates.clock.each(model.hubs.items()):
        first = {stream: _first_ways(model, stream, demand, host) for stream in model.streams_of(demand)}
        ways = {way.index: way for these in first.values() for way in these}
        if demand in model.is_apart_for_quality and (host is not None or not model.is_carried(demand)):
            model.needs_any(hub, list(ways.values()))
            one_stream_meets_a_demand(model, (demand, host), first)
        else:
            model.rests_on_any(hub, list(ways.values()))


def one_stream_meets_a_demand(model: Model, key: tuple[int, HostName], first: dict[Stream, list[IntVar]]) -> None:
    """All who have the demand there and are wired take it: its quality is theirs."""
    meets = model.meets[key] = {stream: model.boolean() for stream, ways in first.items() if ways}
    for stream, taken in meets.items():
        model.rests_on_any(taken, first[stream])
    model.cp.add_exactly_one(*meets.values(), model.hubs[key].negated())
    model.support.rests_on_any(model.hubs[key].index, [taken.index for taken in meets.values()])


def _first_ways(model: Model, stream: Stream, demand: int, host: HostName) -> list[IntVar]:
    """The ways by which a stream may be the first on a host to meet a demand."""
    unit = model.unit_of(stream)
    if unit not in model.needing[demand]:
        return model.ways(stream, host)
    here = model.runs[unit] if host is None else model.runs_on[unit].get(host)
    return [way for way in model.ways(stream, host) if way is not here]


def what_is_met_on_a_host_is_met_at_all(model: Model) -> None:
    """So is what a running unit needs, whatever its host.

    This is implied, but the model's relaxation spreads units over hosts, and its search lacks it most.
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


def what_is_made_on_a_host_is_not_carried_there(model: Model) -> None:
    for (stream, host), carried in model.carried.items():
        here = model.runs_on[model.unit_of(stream)].get(host)
        if here is not None:
            model.cp.add_at_most_one(carried, here)


def links_bear_what_is_carried_and_have_their_prices(model: Model) -> None:
    """A carried stream has cost the least that it may from anywhere; from elsewhere it costs more."""
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
                loads[link].append(model.bytes_per_s(stream) * journey)
    for link, load in loads.items():
        model.cp.add(LinearExpr.sum(load) <= (link.bandwidth or 0))


def pinned_units_run(model: Model) -> None:
    for i, runs in model.runs.items():
        if model.candidates.is_pinned(i):
            model.cp.add_bool_or([runs])


def required_transformations_serve_a_target(model: Model) -> None:
    candidates = model.candidates
    if not model.environment.required:
        return
    units: dict[str, list[IntVar]] = defaultdict(list)
    for i, serves in _serving(model, {}).items():
        if candidates.all[i].transformation.required:
            units[candidates.all[i].transformation.label].append(serves)
    for label, serving in units.items():
        model.uses_required[label] = model.boolean()
        model.needs_any(model.uses_required[label], serving)


def _serving(
    model: Model, more: Mapping[int, Sequence[IntVar]], *, is_company_served: bool = False
) -> dict[int, IntVar]:
    """For each tracked unit a boolean that it serves a target: it publishes one, or feeds a unit that serves one.

    `more` says when else a unit serves; with `is_company_served`, also where one that serves can't run without it. The
    distance to the target grows along the way; else two units could serve through each other's feedback inputs.
    """
    candidates = model.candidates
    tracked = sorted(model.tracked)
    distance = {i: model.cp.new_int_var(0, len(tracked), "") for i in tracked}
    ways: dict[int, list[IntVar]] = {i: [*more.get(i, ())] for i in tracked}
    serving = {i: model.boolean() for i in tracked}
    for choices in model.publishes.values():
        for stream, publishes in choices.items():
            if model.unit_of(stream) in ways:
                ways[model.unit_of(stream)].append(publishes)
    for (consumer, name), choices in candidates.clock.each(model.connects.items()):
        is_reason = consumer in ways and name not in candidates.all[consumer].transformation.idle_inputs
        for stream, connected in choices.items() if is_reason else ():
            feeder = model.unit_of(stream)
            if feeder in ways:
                ways[feeder].append(through := _only_if(model, connected, serving[consumer]))
                model.cp.add(distance[feeder] > distance[consumer]).only_enforce_if(through)
    for user, alone, both_run in _company(model) if is_company_served else ():
        if user in ways and alone in ways:
            ways[alone].append(through := _only_if(model, *both_run, serving[user]))
            model.cp.add(distance[alone] > distance[user]).only_enforce_if(through)
    for i, choices_of in ways.items():
        model.needs_any(serving[i], choices_of)
    return serving


def _only_if(model: Model, *literals: LiteralT) -> IntVar:
    """A boolean that may hold only if all of some literals do."""
    found = model.boolean()
    for literal in literals:
        model.cp.add_implication(found, literal)
    return found


def _company(model: Model) -> Iterator[tuple[int, int, list[LiteralT]]]:
    """Each unit, one that it may run with on a host, and the literals that both run there, the latter alone of its
    transformation.
    """
    for user, places in model.runs_on.items():
        for label in model.candidates.all[user].transformation.beside:
            units = [i for i in model.candidates.units_of(label) if i in model.runs_on]
            for host, runs in places.items():
                there = {i: model.runs_on[i][host] for i in units if host in model.runs_on[i]}
                for alone in sorted(there.keys() - {user}):
                    others = (other.negated() for i, other in there.items() if i != alone)
                    yield user, alone, [runs, there[alone], *others]


def a_stream_serves_no_more_than_it_may(model: Model) -> None:
    for stream, most in model.serves.items():
        taking = _taking(model, stream)
        if len(taking) > most:
            model.cp.add(LinearExpr.sum(taking) <= most)


def _taking(model: Model, stream: Stream) -> list[IntVar]:
    """The booleans that inputs and topics take a stream that serves only so many."""
    choices = [*model.connects.values(), *model.publishes.values()]
    return [choice[stream] for choice in choices if stream in choice]


def an_input_that_starts_nothing_is_fed_by_what_is_needed_anyway(model: Model) -> None:
    """What is needed: what serves a target, is pinned, or is there by number or for a failure. Nothing else takes a
    stream that serves only so many, since there would be room for the input without it.
    """
    if not model.idle_feeders:
        return
    candidates, roots = model.candidates, defaultdict[int, list[IntVar]](list)
    for i in sorted(model.tracked):
        if candidates.is_pinned(i):
            roots[i].append(model.runs[i])
    for t in model.environment.library:
        units = [i for i in candidates.units_of(t.label) if i in model.runs] if t.min_instances else []
        for i, asked in [(i, _only_if(model, model.runs[i])) for i in units]:
            model.cp.add(LinearExpr.sum([model.runs[n] for n in units]) <= t.min_instances).only_enforce_if(asked)
            roots[i].append(asked)
    for i in sorted(model.tracked & model.runs.keys()) if model.problem.survive is not None else ():
        model.spares[i] = _only_if(model, model.runs[i])
        roots[i].append(model.spares[i])
    needed = _serving(model, roots, is_company_served=True)
    for (unit, name), connects in model.connects.items():
        is_idle = name in candidates.all[unit].transformation.idle_inputs
        for stream, connected in connects.items():
            if is_idle:
                model.cp.add_implication(connected, needed[model.unit_of(stream)])
            if stream in model.serves and model.unit_of(stream) in model.idle_feeders:
                model.cp.add_implication(connected, needed[unit])


def an_input_that_starts_nothing_is_fed_where_it_can_be(model: Model) -> None:
    """It is unfed only where too few units run that may feed it: others depend on its unit, or are not distinct."""
    candidates = model.candidates.all
    for (unit, name), fed in list(model.is_fed.items()):
        port = candidates[unit].transformation.input[name]
        if not port.starts_nothing or port.count == ALL:
            continue
        free: dict[int | str, IntVar] = {}
        below = {} if port.feedback else _below(model, unit, port)
        for stream in model.connects[unit, name]:
            feeder = model.unit_of(stream)
            label = candidates[feeder].transformation.label
            key = feeder if port.distinct is None else label
            barred = [below[feeder]] if feeder in below else []
            barred += [c for s, c in _of_group(model, unit, port) if model.candidates.label_of(s) == label]
            if stream in model.serves:
                barred.append(full := model.boolean())
                model.cp.add(LinearExpr.sum(_taking(model, stream)) >= model.serves[stream]).only_enforce_if(full)
            is_free = free[key] if key in free else model.boolean()
            free[key] = is_free
            model.cp.add_bool_or([is_free, model.runs[unit].negated(), model.runs[feeder].negated(), *barred])
        unfed = [fed.negated(), model.runs[unit]]
        model.cp.add(LinearExpr.sum(list(free.values())) < port.count).only_enforce_if(unfed)


def _of_group(model: Model, unit: int, port: InputPort) -> list[tuple[Stream, IntVar]]:
    """The streams that may feed other inputs of a distinct input's group, each with the boolean that it does."""
    others = [] if port.distinct is None else model.candidates.all[unit].transformation.inputs
    names = [other.name for other in others if other.distinct == port.distinct and other != port]
    return [entry for name in names for entry in model.connects[unit, name].items()]


def _below(model: Model, unit: int, port: InputPort) -> dict[int, IntVar]:
    """For each unit that may depend on a unit, and feed its input, and those between: a boolean that it does depend."""
    candidates = model.candidates.all
    ways: dict[int, list[tuple[int, IntVar]]] = defaultdict(list)
    readers: dict[int, set[int]] = defaultdict(set)
    for (reader, name), connects in model.connects.items():
        for stream, connected in connects.items() if not candidates[reader].transformation.input[name].feedback else ():
            readers[model.unit_of(stream)].add(reader)
            ways[reader].append((model.unit_of(stream), connected))
    _, *below = reached([unit], lambda here: sorted(readers[here]))
    found = {reader: model.boolean() for reader in below}
    if found.keys().isdisjoint(model.candidates.feeders(port.tag)):
        return {}
    for reader, depends in found.items():
        choices = [connected for feeder, connected in ways[reader] if feeder == unit]
        for feeder, connected in ways[reader]:
            if feeder in found:
                choices.append(_only_if(model, connected, found[feeder]))
        model.needs_any(depends, choices)
    return found


def hosts_bear_their_units(model: Model) -> None:
    """Each host has room for its units in each resource; cold spares count as running, as they must be able to run."""
    candidates = model.candidates.all
    for host in model.environment.hosts:
        here = [
            (literal, candidates[i].places[host.name].takes)
            for places in (model.runs_on, model.waits_on)
            for i, on in places.items()
            for literal in ([on[host.name]] if host.name in on else [])
        ]
        for resource in sorted({resource for _, takes in here for resource in takes}):
            room = host.room(resource, model.problem.horizon_s)
            if room is not None:
                taken = [takes.get(resource, 0) * literal for literal, takes in here]
                model.cp.add(LinearExpr.sum(taken) <= room)


def a_host_is_paid_and_counted_while_something_is_there(model: Model) -> None:
    for host in model.environment.hosts:
        if host.rent_us or Objective.HOSTS in model.environment.minimise:
            used = model.uses[host.name] = model.boolean()
            model.more_costs.append(host.rent_us * model.problem.horizon_s * used)
            for places in (*model.runs_on.values(), *model.waits_on.values()):
                if host.name in places:
                    model.cp.add_implication(places[host.name], used)


def units_that_conflict_are_not_there_together(model: Model) -> None:
    there = _by_label(model, model.is_there)
    for transformation in model.environment.library:
        for other in transformation.conflicts:
            if other != transformation.label:
                _are_apart(model, there[transformation.label], there[other])


def _are_apart(model: Model, some: Iterable[IntVar], others: Iterable[IntVar]) -> None:
    for one, second in product(some, others):
        model.cp.add_at_most_one(one, second)


def there_are_as_many_units_as_asked_for_and_allowed(model: Model) -> None:
    there, running = _by_label(model, model.is_there), _by_label(model, model.runs)
    for t in model.environment.library:
        if t.min_instances:
            model.cp.add(LinearExpr.sum(running[t.label]) >= t.min_instances)
        if t.max_instances is not None and len(there[t.label]) > t.max_instances:
            model.cp.add(LinearExpr.sum(there[t.label]) <= t.max_instances)


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
                _are_apart(model, these, there.get(host, ()))


def beside_a_running_unit_run_those_that_it_runs_with(model: Model) -> None:
    for i, places in model.runs_on.items():
        for other in model.candidates.all[i].transformation.beside:
            units = [model.runs_on[j] for j in model.candidates.units_of(other)]
            for host, runs in places.items():
                model.needs_any(runs, [there[host] for there in units if host in there])


def _on_hosts(model: Model, label: str) -> dict[HostName, list[IntVar]]:
    """For each host the booleans that a unit of a transformation is there, running or as a cold spare."""
    found: dict[HostName, list[IntVar]] = defaultdict(list)
    for i in model.candidates.units_of(label):
        for host, there in (*model.runs_on[i].items(), *model.waits_on[i].items()):
            found[host].append(there)
    return found


def _by_label(model: Model, literals: dict[int, IntVar]) -> dict[str, list[IntVar]]:
    found: dict[str, list[IntVar]] = defaultdict(list)
    for i, literal in literals.items():
        found[model.candidates.all[i].transformation.label].append(literal)
    return found


def new_units_come_in_order(model: Model) -> None:
    """Of several new units of a transformation the first ones are taken: they are all alike."""
    candidates = model.candidates.all
    for i in range(1, len(candidates)):
        one, next_one = candidates[i - 1], candidates[i]
        if one.transformation == next_one.transformation and one.running is None and next_one.running is None:
            model.cp.add_implication(model.is_there[i], model.is_there[i - 1])


def one_of_new_units_alike_is_enough(model: Model) -> None:
    """Of new units that meet the same demands at most one runs, and those that have a need share it.

    It shortens the proof where nothing is asked beyond the paper; `closing.program.alike` says why it holds. Where
    transformations are required two of them may be wanted.
    """
    if model.problem.notions or model.tracked:
        return
    candidates = model.candidates
    apart: set[int] = set()
    demands = {model.demand(target.tag): target.tag for target in model.environment.targets}
    for candidate in candidates.all:
        for port in candidate.transformation.inputs:
            demands[model.demand(port.tag)] = port.tag
            if port.distinct is not None:
                apart.update(candidates.feeders(port.tag))
    given: dict[int, list[int]] = defaultdict(list)
    for demand in sorted(demands):
        for feeder in candidates.feeders(demands[demand]):
            given[feeder].append(demand)
    groups: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for unit, candidate in enumerate(candidates.all):
        if candidate.running is None and unit not in apart:
            groups[tuple(given[unit])].append(unit)
    for units in groups.values():
        if len(units) > 1:
            model.cp.add_at_most_one(model.runs[unit] for unit in units)
            _needs_are_shared(model, units)


def _needs_are_shared(model: Model, units: list[int]) -> None:
    needing: dict[int, list[int]] = defaultdict(list)
    for unit in units:
        ports = model.candidates.all[unit].transformation.inputs
        hubs = {model.hub(p.tag, None).index for p in ports if not p.feedback and not model.is_told_apart(unit, p)}
        for hub in sorted(hubs):
            needing[hub].append(unit)
    for hub, sharing in needing.items():
        if len(sharing) > 1:
            met = model.cp.get_bool_var_from_proto_index(hub)
            model.cp.add_at_most_one([met.negated(), *(model.runs[unit] for unit in sharing)])


RULES: Final[tuple[ModelRule, ...]] = (
    a_unit_runs_or_waits_in_one_place,
    a_kept_unit_stays_or_is_wired_anew,
    a_staying_unit_keeps_its_feeders,
    a_wired_unit_is_fed,
    inputs_of_a_group_are_fed_by_different_transformations,
    units_that_feed_each_other_come_one_after_the_other,
    a_demand_is_met_first_by_a_unit_that_does_not_need_it,
    a_target_is_published_by_one_unit,
    a_unit_runs_that_a_target_wants,
    what_is_made_on_a_host_is_not_carried_there,
    links_bear_what_is_carried_and_have_their_prices,
    pinned_units_run,
    required_transformations_serve_a_target,
    a_stream_serves_no_more_than_it_may,
    an_input_that_starts_nothing_is_fed_by_what_is_needed_anyway,
    an_input_that_starts_nothing_is_fed_where_it_can_be,
    hosts_bear_their_units,
    a_host_is_paid_and_counted_while_something_is_there,
    units_that_conflict_are_not_there_together,
    there_are_as_many_units_as_asked_for_and_allowed,
    no_host_has_more_units_of_a_transformation_than_it_allows,
    units_that_conflict_are_not_on_one_host,
    beside_a_running_unit_run_those_that_it_runs_with,
    new_units_come_in_order,
    one_of_new_units_alike_is_enough,
    targets_get_the_quality_they_ask_for,
)
"""What a configuration must be, in the order in which the booleans are made."""
