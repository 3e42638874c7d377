"""The constraint model of an update: its booleans, and one function for each rule.

Booleans say which candidates run, where, and which of them stay as they are. Inputs that do not care who feeds them
share one boolean for each demand and host (a *hub*), so that the model grows with the ports and not with inputs times
outputs. Where the feeder matters an input is *told apart*: each stream that may feed it has a boolean.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from ortools.sat.python.cp_model import CpModel, IntVar, LinearExpr, LinearExprT

from cfgplan.costs import transfer_cost_us
from cfgplan.domain import InputPort, Stream
from cfgplan.planners.fleet.candidates import Candidates, Host
from cfgplan.planners.solving.engine import at_least
from cfgplan.planners.solving.support import Support
from cfgplan.planning import Notion

Rule = Callable[["Model"], None]


class Model:
    """The booleans of a problem's candidates, by their index; streams and ports by name.

    With `is_apart`, and where targets ask for quality, every input and target is told apart.
    """

    def __init__(self, candidates: Candidates, *, is_apart: bool = False) -> None:
        self.candidates = candidates
        self.problem = candidates.problem
        self.environment = candidates.environment
        self.is_apart = is_apart or Notion.QUALITY in self.problem.notions
        self.cp = CpModel()
        self.support = Support()
        self.anywhere = Support()
        """The same with hosts forgotten: what is not grounded there is cut by fewer and stronger clauses."""
        self.literals: list[IntVar] = []
        self.runs: dict[int, IntVar] = {}
        self.waits: dict[int, IntVar] = {}
        self.is_there: dict[int, IntVar] = {}
        self.runs_on: dict[int, dict[Host, IntVar]] = {}
        self.waits_on: dict[int, dict[Host, IntVar]] = {}
        self.stays: dict[int, IntVar] = {}
        self.is_wired: dict[int, IntVar] = {}
        self.hubs: dict[tuple[int, Host], IntVar] = {}
        self.connects: dict[tuple[int, str], dict[Stream, IntVar]] = {}
        self.publishes: dict[str, dict[Stream, IntVar]] = {}
        self.carried: dict[tuple[Stream, Host], IntVar] = {}
        self.serves: dict[int, IntVar] = {}
        self.uses_required: dict[str, IntVar] = {}
        self.more_costs: list[LinearExprT] = []
        self.tracked = _downstream_of_required(candidates)
        self._demand_of_tag: dict[str, int] = {}
        self._demand_of_streams: dict[tuple[Stream, ...], int] = {}
        self._streams: list[tuple[Stream, ...]] = []
        self._price_us = {
            Stream(c.id, port.name): transfer_cost_us(port, self.problem.horizon_s, self.environment.transfer_us)
            for c in (candidates.all if self.environment.hosts else ())
            for port in c.transformation.outputs
        }
        self.tells_ports = self.is_apart or any(self._price_us.values())
        """Whether it matters which stream of a unit is taken."""
        self.needing = self._units_by_demand()
        for rule in RULES:
            rule(self)

    def boolean(self) -> IntVar:
        literal = self.cp.new_bool_var("")
        self.literals.append(literal)
        return literal

    def needs_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        self.cp.add_bool_or([literal.negated(), *choices])

    def rests_on_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        """The literal needs one of the choices, and one that comes before it."""
        self.needs_any(literal, choices)
        self.support.rests_on_any(literal.index, [choice.index for choice in choices])

    def rests_on_all(self, literal: IntVar, parts: Iterable[IntVar]) -> None:
        """The literal needs all parts, and all before it."""
        parts = list(parts)
        for part in parts:
            self.cp.add_implication(literal, part)
        self.support.rests_on_all(literal.index, [part.index for part in parts])

    def choices(self, tag: str) -> tuple[Stream, ...]:
        """The streams that match a demanded tag: one of each unit unless it matters which."""
        streams = self.candidates.streams(tag)
        if self.tells_ports:
            return streams
        return tuple({stream.unit: stream for stream in reversed(streams)}.values())[::-1]

    def demand(self, tag: str) -> int:
        """The number of a demand: tags that the same streams match are one."""
        if tag not in self._demand_of_tag:
            streams = self.choices(tag)
            demand = self._demand_of_tag[tag] = self._demand_of_streams.setdefault(streams, len(self._streams))
            if demand == len(self._streams):
                self._streams.append(streams)
        return self._demand_of_tag[tag]

    def streams_of(self, demand: int) -> tuple[Stream, ...]:
        """The streams that meet a demand."""
        return self._streams[demand]

    def _units_by_demand(self) -> dict[int, set[int]]:
        """The candidates that need each demand before they run, told apart or not."""
        needing: dict[int, set[int]] = defaultdict(set)
        for i, candidate in enumerate(self.candidates.all):
            self.candidates.watch()
            for port in candidate.transformation.inputs if candidate.may_run else ():
                if not port.feedback:
                    needing[self.demand(port.tag)].add(i)
        for target in self.environment.targets:
            self.demand(target.tag)
        return needing

    def unit_of(self, stream: Stream) -> int:
        return self.candidates.index_of[stream.unit]

    def is_told_apart(self, unit: int, port: InputPort) -> bool:
        """Whether it matters who feeds the input: a distinct one, or one that a required unit could reach."""
        return (
            self.is_apart
            or port.distinct is not None
            or (unit in self.tracked and any(self.unit_of(s) in self.tracked for s in self.choices(port.tag)))
        )

    def hub(self, tag: str, host: Host) -> IntVar:
        """The boolean that what the tag demands is there on a host; on no host in particular, if it is made at all."""
        key = self.hub_key(tag, host)
        if key not in self.hubs:
            self.hubs[key] = self.boolean()
        return self.hubs[key]

    def hub_key(self, tag: str, host: Host) -> tuple[int, Host]:
        """What a hub is known by: where nothing that meets the demand costs to be carried, hosts do not matter."""
        demand = self.demand(tag)
        return demand, host if any(map(self.price_us, self._streams[demand])) else None

    def price_us(self, stream: Stream) -> int:
        """What it costs to carry a stream to one more host."""
        return self._price_us.get(stream, 0)

    def ways(self, stream: Stream, host: Host) -> list[IntVar]:
        """Booleans one of which holds if the stream is there on a host."""
        unit = self.unit_of(stream)
        is_made_elsewhere = self.runs_on[unit].keys() != {host}
        if host is not None and self.price_us(stream) and is_made_elsewhere and (stream, host) not in self.carried:
            carried = self.carried[stream, host] = self.boolean()
            self.more_costs.append(self.price_us(stream) * carried)
            self.rests_on_all(carried, [self.runs[unit]])
        return self.known_ways(stream, host)

    def known_ways(self, stream: Stream, host: Host) -> list[IntVar]:
        """Those of the booleans that the model has: a stream may be there by no other way."""
        unit = self.unit_of(stream)
        if host is None or not self.price_us(stream):
            return [self.runs[unit]]
        ways = (self.runs_on[unit].get(host), self.carried.get((stream, host)))
        return [way for way in ways if way is not None]

    def ways_to_run(self, unit: int) -> list[IntVar]:
        """Booleans one of which holds if the candidate runs."""
        return [self.runs[unit]] if unit in self.runs else []

    def present(self, stream: Stream, host: Host) -> IntVar:
        """The boolean that the stream is there on a host."""
        ways = self.ways(stream, host)
        if len(ways) == 1:
            return ways[0]
        present = self.boolean()
        self.rests_on_any(present, ways)
        return present

    def wired_on(self, unit: int) -> dict[Host, IntVar]:
        """For each host the boolean that the candidate is wired anew there."""
        places = self.runs_on[unit]
        return dict.fromkeys(places, self.is_wired[unit]) if len(places) == 1 else places

    def enough_of_each_run(self, landmarks: Iterable[tuple[Iterable[str], int]]) -> None:
        """Every plan has so many transformations of each landmark, or more; each counts as often as it is named."""
        index_of = self.candidates.index_of
        for labels, least in landmarks:
            units = [index_of[c.id] for label in labels for c in self.candidates.of(label)]
            at_least(self.cp, least, [self.runs[i] for i in units if i in self.runs])

    def cost(self) -> LinearExprT:
        """Labor, upkeep and standby, and what rules have added."""
        candidates = self.candidates.all
        terms: list[LinearExprT] = [candidates[i].cost_us * runs for i, runs in self.runs.items()]
        terms += [candidates[i].waiting_cost_us * waits for i, waits in self.waits.items()]
        return LinearExpr.sum([*terms, *self.more_costs])

    def changes(self) -> LinearExprT:
        """Rewired kept units, then started ones: one rewired unit outweighs all that can be started."""
        rewired = [self.is_wired[i] for i in self.runs if self.candidates.all[i].running is not None]
        started = self.started()
        return (len(started) + 1) * LinearExpr.sum(rewired) + LinearExpr.sum(started)

    def started(self) -> list[IntVar]:
        """The booleans of new units."""
        return [there for i, there in self.is_there.items() if self.candidates.all[i].running is None]


def a_unit_runs_or_waits_in_one_place(model: Model) -> None:
    for i, candidate in enumerate(model.candidates.all):
        model.candidates.watch()
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
    """The boolean that one of some literals holds, of which no two do."""
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
        feeds, ports = candidate.running.feeds, candidate.transformation.inputs
        model.rests_on_all(stays, [model.present(feeds[p.name], host) for p in ports if not p.feedback])
        for port in ports:
            if port.feedback:
                model.cp.add_implication(stays, model.present(feeds[port.name], host))


def a_wired_unit_is_fed(model: Model) -> None:
    """Through hubs, or told apart; feedback inputs by any unit that runs."""
    for i in model.runs:
        model.candidates.watch()
        inputs = model.candidates.all[i].transformation.inputs
        told_apart = [port for port in inputs if model.is_told_apart(i, port)]
        apart = {port.name: an_input_told_apart_has_one_feeder(model, i, port) for port in told_apart}
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


def an_input_told_apart_has_one_feeder(model: Model, unit: int, port: InputPort) -> list[IntVar]:
    """Booleans of the streams that may feed an input; returns what the unit's wiring then rests on."""
    streams = [s for s in model.choices(port.tag) if model.unit_of(s) != unit or port.feedback]
    connects = model.connects[unit, port.name] = {stream: model.boolean() for stream in streams}
    model.cp.add_exactly_one(*connects.values(), model.runs[unit].negated())
    running = model.candidates.all[unit].running
    if unit in model.stays and running is not None:
        kept = running.feeds[port.name]
        chosen = next(c for s, c in connects.items() if s == kept or (s.unit == kept.unit and not model.tells_ports))
        model.cp.add_implication(model.stays[unit], chosen)
    for stream, connected in connects.items():
        feeder = model.runs[model.unit_of(stream)]
        if port.feedback:
            model.cp.add_implication(connected, feeder)
        else:
            model.rests_on_all(connected, [feeder])
        for host, on in model.runs_on[unit].items() if model.price_us(stream) else ():
            model.cp.add_bool_or([connected.negated(), on.negated(), *model.ways(stream, host)])
    if port.feedback:
        return []
    fed = model.boolean()
    model.rests_on_any(fed, list(connects.values()))
    return [fed]


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
    for target in model.environment.targets:
        choices = model.publishes[target.label] = {}
        others: list[IntVar] = []
        for stream in model.choices(target.tag):
            feeder = model.unit_of(stream)
            running = model.candidates.all[feeder].running
            if not model.is_apart and feeder not in model.tracked and running is None:
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


def a_demand_is_met_first_by_a_unit_that_does_not_need_it(model: Model) -> None:
    """On each host, and at all."""
    what_is_met_on_a_host_is_met_at_all(model)
    for (demand, host), hub in model.hubs.items():
        model.candidates.watch()
        first = {stream: _first_ways(model, stream, demand, host) for stream in model.streams_of(demand)}
        ways = {way.index: way for these in first.values() for way in these}
        model.rests_on_any(hub, list(ways.values()))


def _first_ways(model: Model, stream: Stream, demand: int, host: Host) -> list[IntVar]:
    """The ways by which a stream may be the first on a host to meet a demand."""
    unit = model.unit_of(stream)
    if unit not in model.needing[demand]:
        return model.ways(stream, host)
    here = model.runs[unit] if host is None else model.runs_on[unit].get(host)
    return [way for way in model.ways(stream, host) if way is not here]


def what_is_met_on_a_host_is_met_at_all(model: Model) -> None:
    """And so is what a unit needs that runs on any host.

    Implied, but the model's relaxation spreads units over hosts, and its search lacks it most.
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


def pinned_units_run(model: Model) -> None:
    for i, runs in model.runs.items():
        if model.candidates.is_pinned(i):
            model.cp.add_bool_or([runs])


def required_transformations_serve_a_target(model: Model) -> None:
    """A unit serves a target that it publishes, or through a unit that it feeds and that serves one.

    The distance to the target grows along the way, or two units could serve through each other's feedback inputs.
    """
    candidates = model.candidates
    distance = {i: model.cp.new_int_var(0, len(model.tracked), "") for i in model.tracked}
    ways: dict[int, list[IntVar]] = {i: [] for i in model.tracked}
    model.serves = {i: model.boolean() for i in model.tracked}
    for choices in model.publishes.values():
        for stream, publishes in choices.items():
            if model.unit_of(stream) in ways:
                ways[model.unit_of(stream)].append(publishes)
    for (consumer, _), choices in model.connects.items():
        candidates.watch()
        for stream, connected in choices.items() if consumer in ways else ():
            feeder = model.unit_of(stream)
            if feeder in ways:
                through = model.boolean()
                ways[feeder].append(through)
                model.cp.add_implication(through, connected)
                model.cp.add_implication(through, model.serves[consumer])
                model.cp.add(distance[feeder] > distance[consumer]).only_enforce_if(through)
    units: dict[str, list[IntVar]] = defaultdict(list)
    for i, choices_of in ways.items():
        model.needs_any(model.serves[i], choices_of)
        if candidates.all[i].transformation.required:
            units[candidates.all[i].transformation.label].append(model.serves[i])
    for label, serving in units.items():
        model.uses_required[label] = model.boolean()
        model.needs_any(model.uses_required[label], serving)


def hosts_bear_their_units(model: Model) -> None:
    """CPU time and memory; cold spares count as if they ran, since they must be able to."""
    candidates = model.candidates.all
    for host in model.environment.hosts:
        here = [
            (literal, candidates[i].transformation)
            for places in (model.runs_on, model.waits_on)
            for i, on in places.items()
            for literal in ([on[host.name]] if host.name in on else [])
        ]
        if host.cpu_us is not None:
            model.cp.add(LinearExpr.sum([t.upkeep_us * literal for literal, t in here]) <= host.cpu_us)
        if host.memory_mb is not None:
            model.cp.add(LinearExpr.sum([t.needs_mb * literal for literal, t in here]) <= host.memory_mb)


def units_that_conflict_are_not_there_together(model: Model) -> None:
    there = _by_label(model, model.is_there)
    for transformation in model.environment.library:
        for other in transformation.conflicts:
            if other != transformation.label:
                for one in there[transformation.label]:
                    for second in there[other]:
                        model.cp.add_at_most_one(one, second)


def there_are_as_many_units_as_asked_for_and_allowed(model: Model) -> None:
    there, running = _by_label(model, model.is_there), _by_label(model, model.runs)
    for t in model.environment.library:
        if t.min_instances:
            model.cp.add(LinearExpr.sum(running[t.label]) >= t.min_instances)
        if t.max_instances is not None and len(there[t.label]) > t.max_instances:
            model.cp.add(LinearExpr.sum(there[t.label]) <= t.max_instances)


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


RULES: Final[tuple[Rule, ...]] = (
    a_unit_runs_or_waits_in_one_place,
    a_kept_unit_stays_or_is_wired_anew,
    a_staying_unit_keeps_its_feeders,
    a_wired_unit_is_fed,
    inputs_of_a_group_are_fed_by_different_transformations,
    a_target_is_published_by_one_unit,
    a_demand_is_met_first_by_a_unit_that_does_not_need_it,
    what_is_made_on_a_host_is_not_carried_there,
    pinned_units_run,
    required_transformations_serve_a_target,
    hosts_bear_their_units,
    units_that_conflict_are_not_there_together,
    there_are_as_many_units_as_asked_for_and_allowed,
    new_units_come_in_order,
)
"""What a configuration must be, in the order in which the booleans are made."""


def _downstream_of_required(candidates: Candidates) -> list[int]:
    """The running candidates of required transformations and all that they may feed, directly or through others."""
    ahead = [i for i, c in enumerate(candidates.all) if c.may_run and c.transformation.required]
    if not ahead:
        return []
    needing: dict[str, list[int]] = defaultdict(list)
    for i, candidate in enumerate(candidates.all):
        for port in candidate.transformation.inputs if candidate.may_run else ():
            needing[port.tag].append(i)
    fed_by: dict[int, list[str]] = defaultdict(list)
    for tag in needing:
        for feeder in candidates.feeders(tag):
            fed_by[feeder].append(tag)
    found = set(ahead)
    for i in ahead:
        for tag in fed_by[i]:
            new = [consumer for consumer in needing.pop(tag, ()) if consumer not in found]
            found.update(new)
            ahead += new
    return sorted(found)
