"""The constraint model of an update: its booleans. The constraints on them are in `rules`.

Booleans say which candidates run, where, and which of them stay as they are. Inputs that accept any feeder share one
boolean for each demand and host (a *hub*), so that the model grows with the ports and not with inputs times outputs. An
input for which the feeder matters is explicit: each stream that may feed it has a boolean.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence

from ortools.sat.python.cp_model import IntVar, LinearExpr, LinearExprT, LiteralT

from cfgplan.costs import transfer_cost_us
from cfgplan.domain import ALL, ComputationUnit, InputPort, Objective, Stream
from cfgplan.planners.exact.best_case import demands_of_quality
from cfgplan.planners.exact.candidates import ONLY_IN_THE_MODEL, Candidates, HostName
from cfgplan.planners.exact.tracking import Tracking, in_cycles
from cfgplan.planners.solving.engine import ExactModel, at_least
from cfgplan.planners.solving.support import Support
from cfgplan.planning import Feature

ModelRule = Callable[["Model"], None]


class Model:
    """The booleans of a problem's candidates, which are named by their index; streams and ports are named by name.

    A candidate `runs` or `waits` as a cold spare, and `is_there` if it does either, each also by host. A running one
    `stays` as it was wired, or `is_wired` by this update. `hubs` say that a demand is met on a host, and `meets` by
    which stream if that matters; `connects` say which streams feed an explicit input, and `publishes` which meet a
    target. With `is_apart`, every input and target is explicit.

    A candidate may be a group of several units, and a host a kind of several (`Candidates.aggregated`). A group `runs`
    if some of its units do, `number` and `numbers_on` say how many, and `has_on` on how many hosts of a kind; of one
    unit these are the booleans that it runs. The model relaxes kinds of several hosts: it bounds their load in all.
    """

    def __init__(
        self,
        candidates: Candidates,
        rules: Iterable[ModelRule],
        *,
        is_apart: bool = False,
        orders_rings: bool = False,
    ) -> None:
        """With `orders_rings`, the model has no solution that is not grounded, as far as inputs are explicit."""
        self.candidates = candidates
        self.problem = candidates.problem
        self.environment = candidates.environment
        self.is_small = len(candidates.all) <= candidates.clock.tuning.fleet.few
        self.asks_for_quality = Feature.QUALITY in self.problem.features
        by_stream = {Feature.LATENCY, *ONLY_IN_THE_MODEL} if self.asks_for_quality else {Feature.LATENCY}
        self.is_apart = is_apart or not by_stream.isdisjoint(self.problem.features)
        self.is_grouped = candidates.groups is not None
        self.in_cycles = in_cycles(candidates) if self.is_grouped else frozenset[int]()
        """The candidates beside counted ones that might feed each other in a cycle: who feeds them is told apart."""
        is_optional = Feature.OPTIONAL in self.problem.features
        self.orders_rings = orders_rings or self.is_small or is_optional or bool(self.in_cycles)
        self.cp = ExactModel()
        self.support = Support()
        self.anywhere = Support()
        """The support with hosts forgotten: what is not grounded there is cut by fewer and stronger clauses."""
        self.literals: list[IntVar] = []
        self.runs: dict[int, IntVar] = {}
        self.waits: dict[int, IntVar] = {}
        self.is_there: dict[int, IntVar] = {}
        self.runs_on: dict[int, dict[HostName, IntVar]] = {}
        self.waits_on: dict[int, dict[HostName, IntVar]] = {}
        self.number: dict[int, IntVar] = {}
        self.numbers_on: dict[int, dict[HostName, IntVar]] = {}
        self.has_on: dict[int, dict[HostName, IntVar]] = {}
        self.stays: dict[int, IntVar] = {}
        self.is_wired: dict[int, IntVar] = {}
        self.hubs: dict[tuple[int, HostName], IntVar] = {}
        self.meets: dict[tuple[int, HostName], dict[Stream, IntVar]] = {}
        self.connects: dict[tuple[int, str], dict[Stream, IntVar]] = {}
        self.takes: dict[tuple[int, str], dict[Stream, IntVar]] = {}
        """By input that takes several streams or limited ones, of a group: how many of each output its units take."""
        self.publishes: dict[str, dict[Stream, IntVar]] = {}
        self.carried: dict[tuple[Stream, HostName], IntVar] = {}
        self.is_fed: dict[tuple[int, str], IntVar] = {}
        """By input that is optional or takes several streams: that it is fed."""
        self.spares: dict[int, IntVar] = {}
        """By candidate that may feed inputs which start nothing: that a failure is not survived without it."""
        self.uses_required: dict[str, IntVar] = {}
        self.uses: dict[HostName, IntVar] = {}
        """By host that is counted or has a rent: that something is there; by kind of hosts, on how many."""
        self.more_costs: list[LinearExprT] = []
        self.missed_by: dict[tuple[str, str], tuple[LinearExprT, int]] = {}
        """By how much each target's stream misses the best of an attribute, in steps, and the size of a step."""
        tracking = Tracking.of(candidates)
        self.idle_feeders, self.keeping_each_other = tracking.idle_feeders, tracking.keeping_each_other
        self.tracked = tracking.units
        """The candidates whose feeders matter."""
        self.needed: dict[int, IntVar] = {}
        """By tracked candidate: that what runs needs it, where a rule asks for that."""
        self._demand_of_tag: dict[str, int] = {}
        self._demand_of_streams: dict[tuple[Stream, ...], int] = {}
        self._streams: list[tuple[Stream, ...]] = []
        is_limited = any(link.bandwidth is not None for link in self.environment.links)
        largest_us = self.environment.prices_us[-1]
        self.placed = {
            Stream(c.id, port.name): port.bytes_per_s
            for c in (candidates.all if self.environment.hosts else ())
            for port in c.transformation.outputs
            if transfer_cost_us(port, self.problem.horizon_s, largest_us) or (is_limited and port.bytes_per_s)
        }
        """The bytes a second of each stream for which it matters where it is made and wanted."""
        self.serves = {
            Stream(c.id, port.name): port.serves
            for c in candidates.all
            for port in c.transformation.outputs
            if port.serves is not None
        }
        """How many inputs and topics may take each stream that serves only so many."""
        takes_all = any(port.count == ALL for t in self.environment.library for port in t.inputs)
        self.tells_ports = bool(
            self.is_apart or self.is_grouped or self.asks_for_quality or self.placed or takes_all or self.serves
        )
        """Whether it matters which stream of a unit is taken."""
        self._any_stream = [Stream(candidate.id, "") for candidate in candidates.all]
        self.needing = self._units_by_demand()
        of_quality = demands_of_quality(candidates) if self.asks_for_quality else {}
        self.is_apart_for_quality = {
            number: of_quality[streams] for number, streams in enumerate(self._streams) if streams in of_quality
        }
        """For the demands whose stream counts for the quality of a target: whether their inputs are told apart."""
        for rule in rules:
            rule(self)

    @staticmethod
    def total(terms: Sequence[LinearExprT]) -> LinearExpr:
        """The sum of some terms."""
        return LinearExpr.sum(terms)

    def boolean(self) -> IntVar:
        literal = self.cp.new_bool_var("")
        self.literals.append(literal)
        return literal

    def needs_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        self.cp.add_bool_or([literal.negated(), *choices])

    def rests_on_any(self, literal: IntVar, choices: Sequence[IntVar]) -> None:
        """The literal implies one of the choices, and one that is derived before it."""
        self.needs_any(literal, choices)
        self.support.rests_on_any(literal.index, [choice.index for choice in choices])

    def rests_on_all(self, literal: IntVar, parts: Iterable[IntVar]) -> None:
        """The literal implies all parts, each derived before it."""
        parts = list(parts)
        for part in parts:
            self.cp.add_implication(literal, part)
        self.support.rests_on_all(literal.index, [part.index for part in parts])

    def only_if(self, *literals: LiteralT) -> IntVar:
        """A boolean that may hold only if all of some literals do."""
        found = self.boolean()
        for literal in literals:
            self.cp.add_implication(found, literal)
        return found

    def hint(self, units: Iterable[ComputationUnit]) -> None:
        """Hint these units on their hosts to the solver, in place of earlier hints; without units, give no hint."""
        self.cp.clear_hints()  # type: ignore[no-untyped-call]
        there = Counter((self.candidates.index_of.get(unit.id), unit.host, unit.standby) for unit in units)
        for places, is_standby in ((self.numbers_on, False), (self.waits_on, True)) if there else ():
            for i, on in places.items():
                for host, number in on.items():
                    self.cp.add_hint(number, there[i, host, is_standby])

    def choices(self, tag: str) -> tuple[Stream, ...]:
        """The streams that match a demanded tag. Where ports don't matter, each unit has one stream, without a port."""
        if self.tells_ports:
            return self.candidates.streams(tag)
        return tuple([self._any_stream[feeder] for feeder in self.candidates.feeders(tag)])

    def demand(self, tag: str) -> int:
        """The number of a demand; tags that the same streams match are one demand."""
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
        """Return the candidates with each demand at an ordinary input, explicit ones included, by demand."""
        needing: dict[int, set[int]] = defaultdict(set)
        for i, candidate in self.candidates.clock.each(enumerate(self.candidates.all)):
            for port in candidate.transformation.inputs if candidate.may_run else ():
                if not (port.feedback or port.optional):
                    needing[self.demand(port.tag)].add(i)
        for target in self.environment.stream_targets:
            self.demand(target.tag)
        return needing

    def there_on(self, unit: int) -> list[tuple[HostName, IntVar]]:
        """How many units of a candidate are on each host, running or as cold spares: of one unit, booleans."""
        return [*self.numbers_on[unit].items(), *self.waits_on[unit].items()]

    def hosts_with(self, unit: int) -> list[tuple[HostName, IntVar]]:
        """On how many hosts of each kind units of a candidate are, running or as cold spares: of one host, booleans."""
        return [*self.has_on[unit].items(), *self.waits_on[unit].items()]

    def hosts_in_use(self, host: HostName) -> LinearExprT:
        """How many hosts of a kind have units; 1 if each candidate is a single unit."""
        return self.uses.get(host, 1) if self.is_grouped else 1

    def running(self, label: str) -> list[int]:
        """The candidates of a transformation that may run."""
        return [i for i in self.candidates.units_of(label) if i in self.runs]

    def to_run(self, label: str) -> list[int]:
        """The candidates of a transformation that may run, by id: the first that runs meets targets that want one."""
        return sorted(self.running(label), key=lambda i: self.candidates.all[i].id)

    def unit_of(self, stream: Stream) -> int:
        return self.candidates.index_of[stream.unit]

    def is_explicit(self, unit: int, port: InputPort) -> bool:
        """Whether it matters who feeds it: for quality, if it is distinct or not usual, or tracked ones may feed it."""
        return (
            self.is_apart
            or port.distinct is not None
            or (not self.is_counted(port) and self._takes_several_or_limited(port))
            or (not port.feedback and self.is_apart_for_quality.get(self.demand(port.tag), False))
            or (unit in self.tracked and not self.tracked.isdisjoint(self.candidates.feeders(port.tag)))
            or (unit in self.in_cycles and not self.in_cycles.isdisjoint(self.candidates.feeders(port.tag)))
        )

    def is_counted(self, port: InputPort) -> bool:
        """Whether it matters how many streams an input takes, but not which: units of a group take them together."""
        return self.is_grouped and not port.is_explicit and self._takes_several_or_limited(port)

    def _takes_several_or_limited(self, port: InputPort) -> bool:
        """Whether an input is not usual, or some of the streams that may feed it serve only so many."""
        return not port.is_usual or any(
            stream in self.serves for stream in (self.choices(port.tag) if self.serves else ())
        )

    def hub(self, tag: str, host: HostName) -> IntVar:
        """The boolean that a demanded tag is met on a host; with host None, that it is met at all."""
        key = self.hub_key(tag, host)
        if key not in self.hubs:
            self.hubs[key] = self.boolean()
        return self.hubs[key]

    def hub_key(self, tag: str, host: HostName) -> tuple[int, HostName]:
        """The key of a hub: its demand, and its host only if a stream that meets the demand costs to be carried."""
        demand = self.demand(tag)
        return demand, host if self.is_carried(demand) else None

    def is_carried(self, demand: int) -> bool:
        """Whether a stream that meets the demand costs to be carried, so that it matters where it is met."""
        return any(stream in self.placed for stream in self._streams[demand])

    def journeys_us(self, stream: Stream, host: HostName) -> dict[HostName, int]:
        """The cost of carrying a stream to a host from each other host where it may be produced."""
        origins = [origin for origin in self.runs_on[self.unit_of(stream)] if origin != host]
        return {origin: self.candidates.carried_us(stream, origin, host) for origin in origins}

    def ways(self, stream: Stream, host: HostName) -> list[IntVar]:
        """Return booleans for the ways to have a stream on a host; a present stream implies one of them."""
        is_new = host is not None and stream in self.placed and (stream, host) not in self.carried
        if is_new and (journeys_us := self.journeys_us(stream, host)):
            carried = self.carried[stream, host] = self.boolean()
            self.more_costs.append(min(journeys_us.values()) * carried)
            self.rests_on_all(carried, [self.runs[self.unit_of(stream)]])
        return self.known_ways(stream, host)

    def known_ways(self, stream: Stream, host: HostName) -> list[IntVar]:
        """The `ways` that the model has already. No other way exists in a solution."""
        unit = self.unit_of(stream)
        if host is None or stream not in self.placed:
            return [self.runs[unit]]
        ways = (self.runs_on[unit].get(host), self.carried.get((stream, host)))
        return [way for way in ways if way is not None]

    def present(self, stream: Stream, host: HostName) -> IntVar:
        """The boolean of a stream that is present on a host."""
        ways = self.ways(stream, host)
        if len(ways) == 1:
            return ways[0]
        present = self.boolean()
        self.rests_on_any(present, ways)
        return present

    def wired_on(self, unit: int) -> dict[HostName, IntVar]:
        """The boolean of each host that the candidate is rewired there."""
        places = self.runs_on[unit]
        if self.candidates.all[unit].size > 1:
            return {None: self.is_wired[unit]}
        return dict.fromkeys(places, self.is_wired[unit]) if len(places) == 1 else places

    def enough_of_each_run(self, landmarks: Iterable[tuple[Iterable[str], int]]) -> None:
        """Demand so many units, or more, of each landmark's labels; a label counts as often as it is named."""
        for labels, least in landmarks:
            of = self.runs if least == 1 else self.number
            at_least(self.cp, least, [of[i] for label in labels for i in self.running(label)])

    def cost(self) -> LinearExprT:
        """Labor, upkeep and standby, and what rules have added."""
        candidates = self.candidates.all
        terms: list[LinearExprT] = [candidates[i].cost_us * number for i, number in self.number.items()]
        terms += [candidates[i].waiting_cost_us * waits for i, waits in self.waits.items()]
        for i, candidate in enumerate(candidates):
            for host, place in candidate.places.items():
                if more_us := place.cost_us - candidate.cost_us if candidate.may_run else 0:
                    terms.append(more_us * self.numbers_on[i][host])
                if more_us := place.waiting_cost_us - candidate.waiting_cost_us if candidate.may_wait else 0:
                    terms.append(more_us * self.waits_on[i][host])
        return LinearExpr.sum([*terms, *self.more_costs])

    def objective(self, which: Objective) -> LinearExprT:
        """An objective as a linear expression."""
        match which:
            case Objective.COST:
                return self.cost()
            case Objective.RENT:
                rent_us = {kind.first: kind.rent_us for kind in self.candidates.hosts}
                return LinearExpr.weighted_sum([*self.uses.values()], [rent_us[name] for name in self.uses])
            case Objective.UNITS:
                return LinearExpr.sum([*self.number.values()])
            case Objective.HOSTS:
                return LinearExpr.sum([*self.uses.values()])
            case Objective.REWIRED:
                return LinearExpr.sum(self.rewired())
            case Objective.STARTED:
                return LinearExpr.sum(self.started())

    def changes(self) -> LinearExprT:
        """Rewired kept units, then started ones: one rewired unit outweighs all that can be started."""
        return (self.most_started() + 1) * LinearExpr.sum(self.rewired()) + LinearExpr.sum(self.started())

    def rewired(self) -> list[IntVar]:
        """The booleans of kept units that are rewired."""
        return [self.is_wired[i] for i in self.runs if self.candidates.all[i].running is not None]

    def started(self) -> list[IntVar]:
        """Return how many new units of each candidate are there."""
        return [self.number_there(i) for i in self.is_there if self.candidates.all[i].running is None]

    def most_started(self) -> int:
        """How many units may be started at most."""
        return sum(candidate.size for candidate in self.candidates.all if candidate.running is None)

    def number_there(self, unit: int) -> IntVar:
        """How many units of a candidate are there, running or as cold spares: of one unit, a boolean."""
        return self.is_there[unit] if self.candidates.all[unit].size == 1 else self.number[unit]
