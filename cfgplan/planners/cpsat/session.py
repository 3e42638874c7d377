"""The planner as a session: what one plan has found out about a problem helps with the next.

A manager keeps one session and asks it again after every change: a unit died, a transformation joined,
a cost moved, a target came. What did not change is not computed anew: the closure and the network of
the library, the landmarks, and the last plan as a first one. The answer is as good as a cold one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event

import numpy as np

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import Environment, Similarity, Transformation
from cfgplan.planners.cpsat.bounds import Bound, Landmark, landmark_of
from cfgplan.planners.cpsat.clock import Clock
from cfgplan.planners.cpsat.greedy import first_plan, improved, is_plan
from cfgplan.planners.cpsat.grounding import Grounding
from cfgplan.planners.cpsat.network import Ints, Network
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.site import Site, relevant
from cfgplan.planners.cpsat.standing import Stage, Standing
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import Givers, startable, unmet_reasons

ATTEMPTS = 30
"""How many members of the first plan are tried to be done without."""
CHUNK = 20
"""After so many landmarks the network is restricted to what may still be used."""
MANY = 500
"""With more labels than this, less gain is enough: the solver would take longer."""
LEAST_GAIN = 0.05
"""Landmarks are looked for as long as a chunk closes this share of the gap."""


@dataclass
class Structure:
    """What depends on library, matching and targets alone, whatever runs and whatever it costs."""

    environment: Environment
    similarity: Similarity
    pinned: frozenset[str]
    givers: Givers
    possible: frozenset[str]
    network: Network
    landmarks: list[Landmark] = field(default_factory=list)
    weights: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, problem: Problem, old: Structure | None) -> Structure:
        environment = problem.environment
        if old is not None and old.similarity == problem.similarity and _alike(old.environment, environment):
            givers, possible = old.givers, old.possible
        else:
            givers = Givers(environment.library, problem.similarity)
            possible = startable(environment, givers)
        labels = relevant(environment, givers, possible)
        network = Network(
            [t for t in environment.library if t.label in labels],
            [target.tag for target in environment.targets if not possible.isdisjoint(givers.of(target.tag))],
            _pinned(environment) & possible,
            givers,
        )
        return cls(environment, problem.similarity, _pinned(environment), givers, possible, network)

    def remember(self, bound: Bound) -> None:
        """Keep the landmarks that counted for the next time, as landmarks of the whole network."""
        known = {landmark.zone.tobytes(): landmark for landmark in self.landmarks}
        counted = [
            (landmark.zone, weight) for landmark, weight in zip(bound.landmarks, bound.weights, strict=True) if weight
        ]
        zones = [bound.core.facts[zone] for zone, _ in counted]
        self.landmarks = [known.get(zone.tobytes()) or landmark_of(self.network.core, zone) for zone in zones]
        self.weights = [weight for _, weight in counted]

    def serves(self, problem: Problem) -> bool:
        """Whether the problem differs in nothing but running units and costs."""
        return (
            (self.similarity is problem.similarity or self.similarity == problem.similarity)
            and _alike(self.environment, problem.environment)
            and self.environment.targets == problem.environment.targets
            and self.pinned == _pinned(problem.environment)
        )


def _pinned(environment: Environment) -> frozenset[str]:
    """The labels of pinned transformations that have running units."""
    library = environment.transformation
    return frozenset(
        unit.transformation
        for unit in environment.units
        if unit.transformation in library and library[unit.transformation].pinned
    )


def _alike(one: Environment, other: Environment) -> bool:
    """Whether the libraries differ in nothing but costs."""
    return one.library is other.library or (
        len(one.library) == len(other.library)
        and all(a is b or _ports(a) == _ports(b) for a, b in zip(one.library, other.library, strict=True))
    )


def _ports(transformation: Transformation) -> tuple[object, ...]:
    t = transformation
    return t.label, t.inputs, t.outputs, t.pinned, t.required


class PlannerSession:
    """A planner that remembers; `plan` is a `planning.Planner` with a way to stop it."""

    def __init__(self, grounding: Grounding = Grounding.CUTS) -> None:
        self._grounding = grounding
        self._structure: Structure | None = None
        self._last: frozenset[str] = frozenset()

    def plan(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
        stop: Event | None = None,
    ) -> Plan:
        """The optimal update. Stopped by the clock, by `stop` or by Ctrl-C it is the best one so far."""
        if problem.notions:
            from cfgplan.planners import fleet

            return fleet.plan(problem, time_limit_s=time_limit_s, report=report, stop=stop)
        clock = Clock(time_limit_s, stop)
        if self._structure is None or not self._structure.serves(problem):
            self._structure = Structure.of(problem, self._structure)
        structure, environment = self._structure, problem.environment
        if any(structure.possible.isdisjoint(structure.givers.of(target.tag)) for target in environment.targets):
            return Plan("cpsat", Status.INFEASIBLE, reasons=unmet_reasons(problem), seconds=clock.end("closure"))
        clock.end("closure")
        standing: Standing | None = None
        try:
            prepared = self._prepare(problem, structure, clock)
            clock.end("bounds")
            standing = Standing(Site(problem, structure.givers, prepared.labels), prepared, clock, report)
            if standing.stage is not Stage.DONE and not clock.is_over():
                from cfgplan.planners.cpsat.search import Search  # the solver takes long to import

                Search(standing, prepared, self._grounding).run()
        except KeyboardInterrupt:
            clock.stop.set()
        clock.end("search")
        if standing is None:
            return Plan("cpsat", Status.UNKNOWN, seconds=clock.seconds)
        if standing.best is not None:
            self._last = frozenset(unit.transformation for unit in standing.best.units)
        return standing.plan()

    def _prepare(self, problem: Problem, structure: Structure, clock: Clock) -> Prepared:
        """Bounds on the cost from both sides, and what may still be used between them."""
        network = structure.network
        counts = {
            "transformations": len(problem.environment.library),
            "startable": len(structure.possible),
            "relevant": len(network.labels),
            "demands": len(network.fact_of_tag),
            "merged demands": len(network.core.givers),
        }
        if any(t.required for t in network.transformations):
            return Prepared(network.labels, counts=counts)
        fixed_us, cost = _costs(problem, network)
        known = {network.number[label] for label in self._last if label in network.number} | set(network.pinned)
        plan: set[int] | None
        if is_plan(network, known):
            running = {unit.transformation for unit in problem.environment.units}
            plan = improved(network, cost, known, {i for i in known if network.labels[i] not in running})
        else:
            plan = first_plan(network, cost, ATTEMPTS, clock.is_over)
        bound = Bound(network.core, cost, list(structure.landmarks))
        bound.recharge(structure.weights)
        limit = None if plan is None else int(cost[list(plan)].sum())
        bound = _tightened(bound, limit, clock)
        structure.remember(bound)
        keep = bound.may_be_used(limit) if limit is not None else np.ones(bound.core.goal, np.bool_)
        left = bound.core.labels[keep]
        if plan is not None and limit is not None and bound.value < limit and clock.is_over():
            left = np.array(sorted(plan), np.int64)
        counts |= {"landmarks": len(bound.landmarks), "left by bounds": len(left)}
        is_left = np.zeros(len(network.labels), np.bool_)
        is_left[left] = True
        return Prepared(
            [network.labels[i] for i in left.tolist()],
            None if plan is None else [network.labels[i] for i in sorted(plan)],
            None if limit is None else limit + fixed_us,
            bound.value + fixed_us,
            [
                [network.labels[i] for i in members[is_left[members]].tolist()]
                for members in (bound.core.labels[landmark.members] for landmark in bound.landmarks)
            ],
            counts,
        )


def _costs(problem: Problem, network: Network) -> tuple[int, Ints]:
    """What pinned units cost whatever is planned, and what each label costs beyond that."""
    running: dict[str, int] = {}
    for unit in problem.environment.units:
        running[unit.transformation] = running.get(unit.transformation, 0) + 1
    library = problem.environment.transformation
    cost = np.fromiter(
        (
            (keep_cost_us if label in running else start_cost_us)(library[label], problem.horizon_s)
            for label in network.labels
        ),
        np.int64,
        len(network.labels),
    )
    fixed_us = sum(running[network.labels[i]] * int(cost[i]) for i in network.pinned)
    cost[network.pinned] = 0
    return fixed_us, cost


def _tightened(bound: Bound, limit: int | None, clock: Clock) -> Bound:
    """Find landmarks, and restrict the network to what may still be used, as long as that pays."""
    enough = int(bound.cost.sum()) if limit is None else limit
    while bound.value < enough and not clock.is_over():
        before = bound.value
        keep = bound.may_be_used(enough)
        if keep.sum() < 0.8 * len(keep):
            bound = bound.restricted(keep)
        bound.improve(enough, CHUNK, clock.is_over)
        if bound.value - before < LEAST_GAIN * (enough - before) * min(1.0, MANY / len(keep)):
            bound.recharge_best(clock.left_s())
            bound.improve(enough, CHUNK, clock.is_over)
            if bound.value - before < LEAST_GAIN * (enough - before) * min(1.0, MANY / len(keep)):
                break
    return bound
