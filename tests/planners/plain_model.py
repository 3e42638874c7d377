"""A second oracle: one plain constraint model of a problem, written from the manual, without any of the planners' code.

It has a boolean for each possible wire, a place in an order for each unit and a value for each stream, and knows no
bounds, no cuts and no rounds. So it is slow where the planner is fast, but it takes problems of twenty units, which
the enumeration does not. It is solved without any linearisation: no large number misleads the engine then.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

from ortools.sat.python.cp_model import INFEASIBLE, OPTIMAL, CpModel, CpSolver, IntVar, LinearExpr

from cfgplan.costs import keep_cost_us, start_cost_us, taken, transfer_cost_us
from cfgplan.domain import ALL, ComputationUnit, InputPort, Objective, OutputPort, Stream, Transformation
from cfgplan.planning import Feature, Plan, Problem, Status, fresh_units
from cfgplan.qualities import MICRO, Contribution, Over, QualityAttribute, QualityRule
from cfgplan.validity.startable import startable

MOST_UNITS = 24
Wire = tuple[int, str, int, str]
"""The unit that is fed and its input, the unit that feeds it and its output, units by number."""
Costs = list[tuple[IntVar, int]]
"""Booleans and integers, and what each of their units costs."""


class TooLargeError(RuntimeError):
    """The model does not take the problem, or its engine does not end in time."""


@dataclass(frozen=True)
class Optimum:
    """What all optimal plans of a problem have in common; only the status where there is none."""

    status: Status
    unused: int = 0
    cost_us: int | None = None
    rewired: int = 0
    started: int = 0
    objectives: tuple[int, ...] = ()

    @classmethod
    def of(cls, plan: Plan) -> Optimum:
        """The same of a planner's answer."""
        if plan.change_set is None:
            return cls(plan.status)
        changes, values = plan.change_set, tuple(one.value for one in plan.objectives)
        numbers = len(changes.rewired), len(changes.started)
        return cls(plan.status, len(plan.unused_required), plan.cost_us, *numbers, values)


@dataclass(frozen=True)
class Unit:
    """A unit that may run: a new one, or one that runs `now`."""

    id: str
    transformation: Transformation
    hosts: tuple[str | None, ...]
    now: ComputationUnit | None


def optimum(problem: Problem, time_limit_s: float = 60) -> Optimum:
    """What the optimal plans have in common. Raises TooLargeError; failures to survive are not looked at."""
    if Feature.SURVIVAL in problem.features:
        raise TooLargeError("failures to survive are not modelled")
    return PlainModel(problem, time_limit_s).optimum()


def number_of_units(problem: Problem) -> int:
    """How many units the model of a problem has."""
    return len(_units(problem))


class PlainModel:
    """The model of a problem, with what each rule of the manual adds to it."""

    def __init__(self, problem: Problem, time_limit_s: float) -> None:
        self.problem, self.environment, self.time_limit_s = problem, problem.environment, time_limit_s
        self.cp = CpModel()
        self.units = _units(problem)
        if len(self.units) > MOST_UNITS:
            raise TooLargeError(f"{len(self.units)} units")
        self.on = [{host: self.bool() for host in unit.hosts} for unit in self.units]
        self.runs = [self.bool() for _ in self.units]
        for runs, on in zip(self.runs, self.on, strict=True):
            self.cp.add(sum(on.values()) == runs)
        for (one, unit), (other, following) in pairwise(enumerate(self.units)):
            if unit.now is None and following.now is None and unit.transformation == following.transformation:
                self.cp.add_implication(self.runs[other], self.runs[one])
        self.wires: dict[Wire, IntVar] = {}
        self.fed: dict[tuple[int, str], IntVar] = {}
        self.edges: dict[tuple[int, int], list[IntVar]] = defaultdict(list)
        """Wires between two units that are no feedback, by who feeds and who is fed."""
        self.publishes: dict[tuple[str, int, str], IntVar] = {}
        self.costs: Costs = []
        self._wire()
        self._meet_targets()
        self._serve()
        self._feed_what_is_idle()
        self._keep_numbers()
        self._fit_on_hosts()
        self._carry()
        for attribute in self.environment.qualities:
            self._have_quality(attribute)
        self._are_needed()
        self._cost()

    def bool(self) -> IntVar:
        return self.cp.new_bool_var("")

    def any_of(self, literals: Iterable[IntVar]) -> IntVar:
        """A boolean that is the disjunction of some."""
        literals = list(literals)
        found = self.bool()
        for literal in literals:
            self.cp.add_implication(literal, found)
        self.cp.add_bool_or([*literals, ~found])
        return found

    def all_of(self, *literals: IntVar) -> IntVar:
        found = self.bool()
        self.cp.add_bool_and(literals).only_enforce_if(found)
        self.cp.add_bool_or([found, *(~literal for literal in literals)])
        return found

    @cached_property
    def ports(self) -> dict[tuple[int, str], InputPort]:
        return {(i, port.name): port for i, unit in enumerate(self.units) for port in unit.transformation.inputs}

    @cached_property
    def outputs(self) -> dict[tuple[int, str], OutputPort]:
        return {(i, port.name): port for i, unit in enumerate(self.units) for port in unit.transformation.outputs}

    def of_label(self, label: str) -> list[int]:
        return [i for i, unit in enumerate(self.units) if unit.transformation.label == label]

    def _wire(self) -> None:
        place = [self.cp.new_int_var(0, len(self.units), "") for _ in self.units]
        for (i, name), port in self.ports.items():
            of: dict[int, list[IntVar]] = defaultdict(list)
            for (j, output), offered in self.outputs.items():
                is_own = i == j and (not port.feedback or port.count == ALL)
                if is_own or not self.problem.similarity.holds(offered.tag, port.tag):
                    continue
                wire = self.wires[i, name, j, output] = self.bool()
                of[j].append(wire)
                self.cp.add_implication(wire, self.runs[j])
                if not port.feedback:
                    self.edges[j, i].append(wire)
                    self.cp.add(place[j] < place[i]).only_enforce_if(wire)
            fed = self.fed[i, name] = self.bool() if port.optional else self.runs[i]
            self.cp.add_implication(fed, self.runs[i])
            wires = [wire for these in of.values() for wire in these]
            if port.count == ALL:
                self.cp.add_bool_or([~fed, *wires])
                for j, these in of.items():
                    for wire in these:
                        self.cp.add_implication(wire, fed)
                        self.cp.add_bool_or([wire, ~self.runs[i], ~self.runs[j]])
            else:
                self.cp.add(sum(wires) == port.count * fed)
                for these in of.values():
                    self.cp.add_at_most_one(these)
            if port.optional and port.worth_us:
                self.costs += [(self.all_of(self.runs[i], ~fed), port.worth_us * self.problem.horizon_s)]
        for i, unit in enumerate(self.units):
            for group in {port.distinct for port in unit.transformation.inputs} - {None}:
                by_label: dict[str, list[IntVar]] = defaultdict(list)
                for wire, literal in self.wires.items():
                    if wire[0] == i and self.ports[wire[:2]].distinct == group:
                        by_label[self.units[wire[2]].transformation.label].append(literal)
                for literals in by_label.values():
                    self.cp.add_at_most_one(literals)

    def _meet_targets(self) -> None:
        for target in self.environment.targets:
            if target.run is not None:
                self.cp.add_bool_or([self.runs[i] for i in self.of_label(target.run)])
                continue
            for (j, output), offered in self.outputs.items():
                if self.problem.similarity.holds(offered.tag, target.tag):
                    publishes = self.publishes[target.label, j, output] = self.bool()
                    self.cp.add_implication(publishes, self.runs[j])
            self.cp.add_exactly_one(
                literal for (label, _, _), literal in self.publishes.items() if label == target.label
            )

    @cached_property
    def taking(self) -> Mapping[tuple[int, str], list[IntVar]]:
        """The inputs and topics that may take each stream."""
        found: dict[tuple[int, str], list[IntVar]] = defaultdict(list)
        for (_, _, j, output), wire in self.wires.items():
            found[j, output].append(wire)
        for (_, j, output), publishes in self.publishes.items():
            found[j, output].append(publishes)
        return found

    def _serve(self) -> None:
        for stream, literals in self.taking.items():
            serves = self.outputs[stream].serves
            if serves is not None:
                self.cp.add(sum(literals) <= serves)

    def _feed_what_is_idle(self) -> None:
        """An optional input without worth is unfed only if too few of those that run may feed it."""
        idle = {key: port for key, port in self.ports.items() if port.starts_nothing and port.count != ALL}
        if not idle:
            return
        fed_by = {pair: self.any_of(wires) for pair, wires in self.edges.items()}
        replaceable_by = {pair: self.bool() for pair in product(range(len(self.units)), repeat=2) if pair[0] != pair[1]}
        for (a, b), is_behind in replaceable_by.items():
            through = [
                self.all_of(replaceable_by[a, c], edge)
                for (c, to), edge in fed_by.items()
                if to == b and c not in (a, b)
            ]
            self.cp.add_bool_or([~is_behind, *through, *([fed_by[a, b]] if (a, b) in fed_by else [])])
        for (i, name), port in idle.items():
            unfed = self.all_of(self.runs[i], ~self.fed[i, name])
            group = [p.name for p in self.units[i].transformation.inputs if p.distinct == port.distinct]
            may: dict[object, list[IntVar]] = defaultdict(list)
            for i_, name_, j, output in self.wires:
                if (i_, name_) != (i, name):
                    continue
                label, serves = self.units[j].transformation.label, self.outputs[j, output].serves
                barred = [~self.runs[j]]
                if not port.feedback:
                    barred.append(replaceable_by[i, j])
                if serves is not None:
                    full = self.bool()
                    self.cp.add(sum(self.taking[j, output]) >= serves).only_enforce_if(full)
                    barred.append(full)
                if port.distinct is not None:
                    barred += [
                        wire
                        for (to, at, of, _), wire in self.wires.items()
                        if to == i and at in group and self.units[of].transformation.label == label
                    ]
                may_feed = self.bool()
                self.cp.add_bool_or([may_feed, *barred])
                may[j if port.distinct is None else label].append(may_feed)
            self.cp.add(sum(self.any_of(these) for these in may.values()) < port.count).only_enforce_if(unfed)

    def _keep_numbers(self) -> None:
        hosts = {host for unit in self.units for host in unit.hosts}
        for t in self.environment.library:
            units = self.of_label(t.label)
            number = sum(self.runs[i] for i in units)
            self.cp.add(number >= t.min_instances)
            if t.max_instances is not None:
                self.cp.add(number <= t.max_instances)
            for host in hosts:
                here = [self.on[i][host] for i in units if host in self.on[i]]
                if t.per_host is not None:
                    self.cp.add(sum(here) <= t.per_host)
                for other in t.conflicts_on_host:
                    self._are_apart(
                        here, [self.on[j][host] for j in self.of_label(other) if host in self.on[j]], t, other
                    )
                for other in t.beside:
                    company = [self.on[j][host] for j in self.of_label(other) if host in self.on[j]]
                    for one in here:
                        self.cp.add_bool_or([~one, *company])
            for text, most in t.at_most.items():
                chosen = {host.name for host in self.environment.hosts if host.fits(text)}
                self.cp.add(sum(on for i in units for host, on in self.on[i].items() if host in chosen) <= most)
            for other in t.conflicts:
                self._are_apart([self.runs[i] for i in units], [self.runs[j] for j in self.of_label(other)], t, other)
        possible = startable(self.environment, self.problem.similarity)
        for runs, unit in zip(self.runs, self.units, strict=True):
            if unit.now is not None and unit.transformation.pinned and unit.transformation.label in possible:
                self.cp.add_bool_or([runs])

    def _are_apart(self, some: list[IntVar], others: list[IntVar], of: Transformation, other: str) -> None:
        for pair in product(some, others) if of.label != other else ():
            self.cp.add_at_most_one(pair)

    def _fit_on_hosts(self) -> None:
        self.used: dict[str, IntVar] = {}
        for host in self.environment.hosts:
            here = [(unit, on[host.name]) for unit, on in zip(self.units, self.on, strict=True) if host.name in on]
            takes = [(taken(unit.transformation, host), on) for unit, on in here]
            for resource in sorted({resource for takes_, _ in takes for resource in takes_}):
                room = host.room(resource, self.problem.horizon_s)
                if room is not None:
                    self.cp.add(sum(takes_.get(resource, 0) * on for takes_, on in takes) <= room)
            self.used[host.name] = self.any_of(on for _, on in here)

    def _carry(self) -> None:
        """A stream is carried once to each other host where it is wanted."""
        wanted: dict[tuple[int, str, str], list[IntVar]] = defaultdict(list)
        always = self.cp.new_constant(1)
        for (i, _, j, output), wire in self.wires.items() if self.environment.hosts else ():
            for host, on in self.on[i].items():
                wanted[j, output, host or ""].append(self.all_of(wire, on))
        for (label, j, output), publishes in self.publishes.items():
            host = self.environment.target[label].host
            if host is not None:
                wanted[j, output, host].append(self.all_of(publishes, always))
        loads: dict[object, list[tuple[IntVar, int]]] = defaultdict(list)
        for (j, output, host), literals in wanted.items():
            is_wanted, port = self.any_of(literals), self.outputs[j, output]
            for origin, on in self.on[j].items():
                if origin == host:
                    continue
                carried = self.all_of(is_wanted, on)
                price_us = self.environment.price_us(origin, host)
                self.costs.append((carried, transfer_cost_us(port, self.problem.horizon_s, price_us)))
                link = self.environment.link.get((origin or "", host))
                if link is not None and link.bandwidth is not None:
                    loads[link].append((carried, port.bytes_per_s))
        for link in {link for link in self.environment.link.values() if link is not None}:
            if link.bandwidth is not None:
                self.cp.add(_sum(loads[link]) <= link.bandwidth)

    def _have_quality(self, attribute: QualityAttribute) -> None:
        """Each stream has a value, no better than its rule makes it; values are signed, and what is larger is worse."""
        asked = [(t, w) for t in self.environment.targets for w in t.quality if w.attribute == attribute.name]
        if not asked:
            return
        best, worst = attribute.sign * attribute.best, attribute.sign * attribute.worst
        value = {stream: self.cp.new_int_var(best, worst, "") for stream in self.outputs}
        for (i, output), port in self.outputs.items():
            stated = next((c for c in port.quality if c.attribute == attribute.name), None)
            inputs = [
                (wire, self._arriving(attribute, value[j, of], j, self.on[i]))
                for (to, name, j, of), wire in self.wires.items()
                if to == i and not self.ports[i, name].feedback
            ]
            is_worst = self.bool()
            self.cp.add(value[i, output] == worst).only_enforce_if(is_worst)
            for host, on in self.on[i].items():
                there = None if stated is None else stated.on(host)
                self._follow(attribute, there, value[i, output], [on, ~is_worst], inputs)
        for target, wish in asked:
            comes = self.cp.new_int_var(best, worst, "")
            for (label, j, output), publishes in self.publishes.items():
                if label == target.label:
                    arriving = self._arriving(attribute, value[j, output], j, {target.host: publishes})
                    self.cp.add(comes >= arriving).only_enforce_if(publishes)
            if wish.bound is not None:
                self.cp.add(comes <= attribute.sign * wish.bound)
            if wish.weight_us:
                price_us = self.cp.new_int_var(0, -(-wish.weight_us * (worst - best) // MICRO), "")
                self.cp.add(MICRO * price_us >= wish.weight_us * (comes - best))
                self.costs.append((price_us, 1))

    def _arriving(
        self, attribute: QualityAttribute, value: IntVar, origin: int, at: Mapping[str | None, IntVar]
    ) -> IntVar:
        """The value that a stream of a unit has on a host where it is taken."""
        latency = {
            (one, other): self.environment.latency(attribute.name, one, other)
            for one, other in product(self.on[origin], at)
        }
        if not any(latency.values()):
            return value
        worst = attribute.sign * attribute.worst
        arriving = self.cp.new_int_var(attribute.sign * attribute.best, worst, "")
        is_worst = self.bool()
        self.cp.add(arriving == worst).only_enforce_if(is_worst)
        self.cp.add(arriving >= value)
        for (one, other), late in latency.items():
            self.cp.add(arriving >= value + late).only_enforce_if([self.on[origin][one], at[other], ~is_worst])
        return arriving

    def _follow(
        self,
        attribute: QualityAttribute,
        stated: Contribution | None,
        made: IntVar,
        holds: list[IntVar],
        inputs: Sequence[tuple[IntVar, IntVar]],
    ) -> None:
        """While some literals hold, a value is no better than what a rule makes of the inputs that are wired."""
        cp, best, worst = self.cp, attribute.sign * attribute.best, attribute.sign * attribute.worst
        own = worst if stated is None else attribute.sign * stated.value
        is_fed = self.any_of(wire for wire, _ in inputs)
        cp.add(made >= min(max(own, best), worst)).only_enforce_if([holds[0], ~is_fed])
        rule = None if stated is None else stated.rule
        if rule in (QualityRule.SET, QualityRule.LIMIT):
            cp.add(made >= own).only_enforce_if([*holds, is_fed])
        if rule is QualityRule.SET:
            return
        factor = stated.value if stated is not None and rule is QualityRule.SCALE else MICRO
        more = own if rule is QualityRule.ADD else 0

        def no_better_than(theirs: LinearExpr | IntVar, *literals: IntVar) -> None:
            cp.add(MICRO * made >= factor * theirs + MICRO * more).only_enforce_if([*holds, is_fed, *literals])

        over = Over.WORST if stated is None else stated.over
        if over is Over.WORST:
            for wire, theirs in inputs:
                no_better_than(theirs, wire)
        elif over is Over.BEST:
            chosen = [self.all_of(wire, self.bool()) for wire, _ in inputs]
            cp.add_bool_or([*chosen, ~is_fed])
            for choice, (_, theirs) in zip(chosen, inputs, strict=True):
                no_better_than(theirs, choice)
        else:
            counted = []
            for wire, theirs in inputs:
                counted.append(cp.new_int_var(min(best, 0), max(worst, 0), ""))
                cp.add(counted[-1] >= theirs).only_enforce_if(wire)
                cp.add(counted[-1] == 0).only_enforce_if(~wire)
            if over is Over.SUM:
                no_better_than(LinearExpr.sum(counted))
                return
            for number in range(1, len(inputs) + 1):
                is_number = self.bool()
                cp.add(sum(wire for wire, _ in inputs) == number).only_enforce_if(is_number)
                cp.add(sum(wire for wire, _ in inputs) != number).only_enforce_if(~is_number)
                mean = cp.new_int_var(best, worst, "")
                cp.add(number * mean >= LinearExpr.sum(counted)).only_enforce_if(is_number)
                no_better_than(mean, is_number)

    def _are_needed(self) -> None:
        """Each unit that runs is needed by a target, a number, or its pin if it ran; what targets need is known."""
        roots: dict[int, list[IntVar]] = defaultdict(list)
        for (_, j, _), publishes in self.publishes.items():
            roots[j].append(publishes)
        for label in self.environment.wanted_to_run.values():
            ordered = sorted(self.of_label(label), key=lambda i: self.units[i].id)
            for place, i in enumerate(ordered):
                roots[i].append(self.all_of(self.runs[i], *(~self.runs[before] for before in ordered[:place])))
        serving = self._needed({i: list(literals) for i, literals in roots.items()}, [])
        for t in self.environment.library:
            units = self.of_label(t.label)
            is_few = self.bool()
            self.cp.add(sum(self.runs[i] for i in units) <= t.min_instances).only_enforce_if(is_few)
            for i in units:
                is_kept = t.pinned and self.units[i].now is not None
                roots[i].append(self.cp.new_constant(1) if is_kept else is_few)
        needed = self._needed(roots, list(self._company()))
        for runs, is_needed in zip(self.runs, needed, strict=True):
            self.cp.add_implication(runs, is_needed)
        self.used_required = []
        for t in self.environment.library:
            if t.required:
                used = self.bool()
                self.cp.add_bool_or([~used, *(serving[i] for i in self.of_label(t.label))])
                self.used_required.append(used)

    def _needed(self, roots: Mapping[int, list[IntVar]], company: Iterable[tuple[int, int, IntVar]]) -> list[IntVar]:
        """For each unit a boolean that may hold only if it runs and is a root, or if one needs it that is needed."""
        needed = [self.bool() for _ in self.units]
        distance = [self.cp.new_int_var(0, len(self.units), "") for _ in self.units]
        reasons = {i: list(literals) for i, literals in roots.items()}
        through = [
            (i, j, wire) for (i, name, j, _), wire in self.wires.items() if not self.ports[i, name].starts_nothing
        ]
        for i, j, literal in [*through, *company]:
            if i != j:
                reason = self.bool()
                self.cp.add_bool_and(literal, needed[i]).only_enforce_if(reason)
                self.cp.add(distance[j] > distance[i]).only_enforce_if(reason)
                reasons.setdefault(j, []).append(reason)
        for i, is_needed in enumerate(needed):
            self.cp.add_implication(is_needed, self.runs[i])
            self.cp.add_bool_or([~is_needed, *reasons.get(i, ())])
        return needed

    def _company(self) -> Iterator[tuple[int, int, IntVar]]:
        """A unit, another that it runs with, and the boolean that this is the only one of its kind there."""
        for i, unit in enumerate(self.units):
            for label, host in product(unit.transformation.beside, self.on[i]):
                there = [j for j in self.of_label(label) if host in self.on[j]]
                for j in there:
                    others = [~self.on[other][host] for other in there if other != j]
                    yield i, j, self.all_of(self.on[i][host], self.on[j][host], *others)

    def _cost(self) -> None:
        horizon_s, hosts = self.problem.horizon_s, self.environment.host
        for unit, on in zip(self.units, self.on, strict=True):
            cost_us = start_cost_us if unit.now is None else keep_cost_us
            for name, here in on.items():
                host = None if name is None else hosts[name]
                self.costs.append((here, cost_us(unit.transformation, horizon_s, host)))
        rents = [(self.used[host.name], host.rent_us * horizon_s) for host in self.environment.hosts]
        self.costs += rents
        new = [(runs, 1) for runs, unit in zip(self.runs, self.units, strict=True) if unit.now is None]
        self.objectives: Mapping[Objective, Costs] = {
            Objective.COST: self.costs,
            Objective.RENT: rents,
            Objective.UNITS: [(runs, 1) for runs in self.runs],
            Objective.HOSTS: [(used, 1) for used in self.used.values()],
            Objective.REWIRED: [(self._rewired(i), 1) for i, unit in enumerate(self.units) if unit.now is not None],
            Objective.STARTED: new,
        }

    def _rewired(self, i: int) -> IntVar:
        """The boolean that a unit runs on with other streams at some input or on some topic."""
        now = self.units[i].now
        assert now is not None
        had = {(s.port, s.stream) for s in now.subscriptions}
        had_topics = {(p.port, p.topic) for p in now.publications}
        topics = {target.label: target.topic for target in self.environment.stream_targets}
        subscribed = {
            (name, Stream(self.units[j].id, output)): wire
            for (to, name, j, output), wire in self.wires.items()
            if to == i and self.units[j].now is not None
        }
        new = [wire for (to, _, j, _), wire in self.wires.items() if to == i and self.units[j].now is None]
        published = {
            (output, topics[label]): publishes for (label, j, output), publishes in self.publishes.items() if j == i
        }
        gone = [key for key in had if key not in subscribed] + [key for key in had_topics if key not in published]
        differs = [
            *new,
            *(~wire if key in had else wire for key, wire in subscribed.items()),
            *(~literal if key in had_topics else literal for key, literal in published.items()),
            *([self.runs[i]] if gone else []),
        ]
        return self.all_of(self.runs[i], self.any_of(differs))

    def optimum(self) -> Optimum:
        """Minimise one objective after the other, each with those before it at their least."""
        problem = self.problem
        order = list(self.environment.minimise)
        if Objective.COST not in order:
            order.append(Objective.COST)
        used = [(literal, -1) for literal in self.used_required]
        if (unused := self._least(used)) is None:
            return Optimum(Status.INFEASIBLE)
        most_us = problem.max_cost_us
        if most_us is not None:
            if (self._least(self.costs, is_kept=False) or 0) > most_us:
                return Optimum(Status.TOO_EXPENSIVE)
            self.cp.add(_sum(self.costs) <= most_us)
        values = {each: self._least(self.objectives[each]) or 0 for each in order}
        changes = [self._least(self.objectives[each]) or 0 for each in (Objective.REWIRED, Objective.STARTED)]
        named = self.environment.minimise if Feature.ORDER in problem.features else ()
        return Optimum(
            Status.OPTIMAL,
            len(used) + unused,
            values[Objective.COST],
            *changes,
            tuple(values[each] for each in named),
        )

    def _least(self, costs: Costs, *, is_kept: bool = True) -> int | None:
        """The least sum of some costs, which stays so if it `is_kept`; None if there is no solution."""
        total = _sum(costs)
        self.cp.minimize(total)
        solver = CpSolver()
        solver.parameters.num_workers = 1
        solver.parameters.linearization_level = 0
        solver.parameters.max_time_in_seconds = self.time_limit_s
        status = solver.solve(self.cp)
        if status == INFEASIBLE:
            return None
        if status != OPTIMAL:
            raise TooLargeError(solver.status_name(status))
        value = sum(weight * solver.value(literal) for literal, weight in costs)
        if is_kept:
            self.cp.add(total <= value)
        return value


def _sum(costs: Costs) -> LinearExpr:
    return LinearExpr.weighted_sum([literal for literal, _ in costs], [weight for _, weight in costs])


def _units(problem: Problem) -> list[Unit]:
    """All units that a plan may have: those that run now, then new ones."""
    environment = problem.environment
    found = []
    for unit in environment.units:
        transformation = environment.transformation.get(unit.transformation)
        if transformation is not None and unit.host in environment.hosts_for(transformation) and not unit.standby:
            found.append(Unit(unit.id, transformation, (unit.host,), unit))
    new = fresh_units(environment, {t.label: problem.most_new(t) for t in environment.library})
    for t in environment.library:
        found += [Unit(id_, t, environment.hosts_for(t), None) for id_ in new[t.label]]
    return found
