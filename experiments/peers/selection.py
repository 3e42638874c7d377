"""The candidate units of a plan; tells of a set of candidates whether it is grounded, and how it is wired.

It serves planners that first choose units and then wire them, and is independent of any solver.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from cfgplan.domain import ComputationUnit, InputPort, Publication, Stream, Subscription
from cfgplan.errors import InputError
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planning import Plan, Problem, Status, refuse_features
from cfgplan.reasons import assign_different


@dataclass(frozen=True)
class Limit:
    """A limit: the chosen ones of some candidates use at most `most` together; each has its own use."""

    most: int
    takes: Mapping[int, int]


class Selection:
    """The candidates of a problem by index, in canonical order: units that can be fed and may help to meet a target.

    A transformation with a running unit has no new candidate, since the running unit is never worse. `kept` are the
    running units of pinned transformations, `wanted` the tags of the targets. Raises InputError for features beyond the
    paper, and for required transformations, since a set of units does not say which unit a target uses.
    """

    limits: tuple[Limit, ...] = ()
    implied: tuple[Limit, ...] = ()
    """Limits that whole numbers keep anyway, but fractions do not."""

    def __init__(self, problem: Problem, who: str) -> None:
        refuse_features(problem, who)
        if any(transformation.required for transformation in problem.environment.library):
            raise InputError.of(f"{who} does not support required transformations", mend="use the planner cpsat")
        self.problem = problem
        self.who = who
        found = Candidates(problem)
        self._givers = found.providers
        running = {unit.transformation for unit in problem.environment.units}
        self.candidates = tuple(c for c in found.all if c.running or c.transformation.label not in running)
        self.kept = frozenset(i for i, c in enumerate(self.candidates) if c.running and c.transformation.pinned)
        self.wanted = tuple(dict.fromkeys(target.tag for target in problem.environment.targets))
        self._by_label: dict[str, list[int]] = defaultdict(list)
        for index, candidate in enumerate(self.candidates):
            self._by_label[candidate.transformation.label].append(index)
        self._feeders: dict[str, tuple[int, ...]] = {}

    def feeders(self, tag: str) -> tuple[int, ...]:
        """Return the candidates with an output that matches the demanded tag."""
        if tag not in self._feeders:
            self._feeders[tag] = tuple(i for label in self._givers.of(tag) for i in self._by_label.get(label, ()))
        return self._feeders[tag]

    def cost_us(self, chosen: Collection[int]) -> int:
        return sum(self.candidates[i].cost_us for i in chosen)

    def answer(
        self, chosen: Collection[int] | None, bound_us: int, *, seconds: Mapping[str, float], counts: Mapping[str, int]
    ) -> Plan:
        """Return a plan that runs the chosen units; `bound_us` is the proven lower bound. Ties in cost are broken
        arbitrarily.
        """
        largest = self.problem.max_cost_us
        if largest is not None and bound_us > largest:
            return Plan(self.who, Status.TOO_EXPENSIVE, bound_us=bound_us, seconds=seconds, counts=counts)
        wired = {} if chosen is None else self._wired(chosen)
        cost_us = self.cost_us(wired)
        if chosen is None or (largest is not None and cost_us > largest):
            return Plan(self.who, Status.UNKNOWN, bound_us=bound_us, seconds=seconds, counts=counts)
        changes = self.problem.environment.change_to(wired.values())
        bound_us = min(bound_us, cost_us)
        status = Status.of_plan(cost_us, bound_us, is_required_proven=True)
        return Plan(self.who, status, changes, cost_us, bound_us, required_proven=True, seconds=seconds, counts=counts)

    def grounded(self, chosen: Collection[int]) -> list[int]:
        """Return the grounded ones of the chosen units, each after the units that feed it."""
        alive = frozenset(chosen)
        while True:
            order = self._fed_in_order(alive, alive)
            if len(order) == len(alive):
                return order
            alive = frozenset(order)

    def ways_in(self, chosen: Collection[int]) -> list[int]:
        """Return units of which every valid superset of the chosen ones has at least one, if the chosen ones are not
        valid.

        The first added unit in such a superset's order of feeding is fed by chosen units, or has no inputs.
        """
        anyone = range(len(self.candidates))
        fed = set(self._fed_in_order(frozenset(chosen), anyone))
        return [i for i in anyone if i not in chosen and self.can_be_fed(i, fed, anyone)]

    def _fed_in_order(self, chosen: frozenset[int], anywhere: Collection[int]) -> list[int]:
        order: list[int] = []
        before: set[int] = set()
        grew = True
        while grew:
            new = [i for i in sorted(chosen - before) if self.can_be_fed(i, before, anywhere)]
            order += new
            before.update(new)
            grew = bool(new)
        return order

    def can_be_fed(self, index: int, before: Collection[int], anywhere: Collection[int]) -> bool:
        """Return whether the candidates `before` can feed a candidate's inputs, and `anywhere` its feedback inputs."""
        return self._feed(index, before, anywhere) is not None

    def satisfied(self, chosen: Collection[int]) -> bool:
        """Return whether all chosen units are grounded and meet every target."""
        return not self.open_demands(frozenset(chosen)) and len(self.grounded(chosen)) == len(chosen)

    def plan_within(self, chosen: Collection[int]) -> list[int] | None:
        """Return the grounded ones of the chosen units if they meet every target, otherwise None."""
        grounded = self.grounded(chosen)
        is_plan = self.kept <= set(grounded) and not self.open_demands(frozenset(grounded))
        return grounded if is_plan else None

    def open_demands(self, chosen: frozenset[int]) -> dict[str, tuple[int, ...]]:
        """Return the demands of targets and chosen units that no chosen unit feeds, each with its feeders."""
        tags = dict.fromkeys(self.wanted)
        for i in sorted(chosen):
            tags.update(dict.fromkeys(port.tag for port in self.candidates[i].transformation.inputs))
        return {tag: self.feeders(tag) for tag in tags if chosen.isdisjoint(self.feeders(tag))}

    def needed(self, chosen: Collection[int]) -> frozenset[int]:
        """Return the units of a satisfied set that targets and pinned units need in the wiring of `answer`."""
        return frozenset(self._wired(chosen))

    def _wired(self, chosen: Collection[int]) -> dict[int, ComputationUnit]:
        """The needed ones of the chosen as wired units; old streams are preferred."""
        order = self.grounded(chosen)
        topics: dict[int, list[Publication]] = defaultdict(list)
        for target in self.problem.environment.targets:
            publisher, port = self._publisher(target.tag, target.topic, order)
            topics[publisher].append(Publication(port, target.topic))
        units: dict[int, ComputationUnit] = {}
        ahead = sorted(topics.keys() | (self.kept & set(order)))
        for i in ahead:
            if i not in units:
                feeds = self._feed(i, order[: order.index(i)], order)
                assert feeds is not None
                subscriptions = tuple(self._subscription(i, port, feeder) for port, feeder in feeds.items())
                candidate = self.candidates[i]
                units[i] = ComputationUnit(
                    candidate.id, candidate.transformation.label, subscriptions, tuple(topics[i])
                )
                ahead += feeds.values()
        return units

    def _feed(self, index: int, before: Collection[int], anywhere: Collection[int]) -> dict[InputPort, int] | None:
        """Return a feeder for each input, its old one if it may stay; None if no choice feeds all inputs."""
        feeds: dict[InputPort, int] = {}
        groups: dict[str, dict[str, dict[str, int]]] = defaultdict(dict)
        for port in self.candidates[index].transformation.inputs:
            allowed = anywhere if port.feedback else before
            fit = [i for i in self.feeders(port.tag) if i in allowed]
            if not fit:
                return None
            old = self._old_feeder(index, port)
            preferred = [old, *fit] if old is not None and old in fit else fit
            feeds[port] = preferred[0]
            if port.distinct is not None:
                by_label: dict[str, int] = {}
                for i in preferred:
                    by_label.setdefault(self.candidates[i].transformation.label, i)
                groups[port.distinct][port.name] = by_label
        ports = self.candidates[index].transformation.input
        for choices in groups.values():
            assigned = assign_different(choices)
            if assigned is None:
                return None
            feeds.update({ports[name]: choices[name][label] for name, label in assigned.items()})
        return feeds

    def _old_feeder(self, index: int, port: InputPort) -> int | None:
        running = self.candidates[index].running
        old = {stream.unit for stream in running.feeds.get(port.name, ())} if running else set()
        return next((i for i in self.feeders(port.tag) if self.candidates[i].id in old), None)

    def _subscription(self, index: int, port: InputPort, feeder: int) -> Subscription:
        candidate, provider = self.candidates[index], self.candidates[feeder]
        old = candidate.running.feeds.get(port.name, ()) if candidate.running else ()
        fit = list(self._ports(feeder, port.tag))
        kept = [stream for stream in old if stream.unit == provider.id and stream.port in fit]
        return Subscription(port.name, kept[0] if kept else Stream(provider.id, fit[0]))

    def _publisher(self, tag: str, topic: str, order: list[int]) -> tuple[int, str]:
        """The publisher of a target and its port: the present ones if they may stay."""
        fit = [(i, port) for i in order if i in self.feeders(tag) for port in self._ports(i, tag)]

        def is_old(choice: tuple[int, str]) -> bool:
            running = self.candidates[choice[0]].running
            return running is not None and Publication(choice[1], topic) in running.publications

        return next(filter(is_old, fit), fit[0])

    def _ports(self, feeder: int, tag: str) -> Iterator[str]:
        for port in self.candidates[feeder].transformation.outputs:
            if self.problem.similarity.holds(port.tag, tag):
                yield port.name
