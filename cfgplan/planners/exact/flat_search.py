"""The search over a flat fleet: landmarks, then rounds of solving and cutting what is not grounded."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import ceil

from ortools.sat.python.cp_model import INFEASIBLE, MODEL_INVALID, OPTIMAL, CpSolver, IntVar, LinearExpr

from cfgplan.domain import InputPort
from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.tightening import tightened
from cfgplan.planners.exact.anywhere import Anywhere
from cfgplan.planners.exact.best_case import least_prices_us
from cfgplan.planners.exact.flat import Fact, Flat, Met
from cfgplan.planners.exact.flat_decode import decoded, true_of
from cfgplan.planners.exact.flat_model import FlatModel
from cfgplan.planners.exact.quality import QualityValues, targets_get_the_quality_they_ask_for, value_of_choice
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.planners.exact.quality_demands import DemandModel, takes_the_worst
from cfgplan.planners.exact.search import EXACT
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.greedy import first_plan
from cfgplan.planners.networks.keys import Key
from cfgplan.planners.solving.engine import OnSolution, repeatable_solver, solve
from cfgplan.qualities import QualityAttribute


class FlatSearch:
    """Minimises cost, then started units; `is_done` if the incumbent is proven best in both."""

    def __init__(
        self,
        flat: Flat,
        standing: Standing,
        slice_s: float,
        *,
        is_all: bool = True,
        cuts: Iterable[ChainCut] = (),
        bound: Bound | None = None,
        limit_us: int | None = None,
    ) -> None:
        """With `is_all` false some candidates are left out: the search gives plans, but no bounds.

        `bound` holds for plans that are no dearer than the incumbent. With `limit_us` only plans within it are looked
        for.
        """
        self.flat = flat
        self.standing = standing
        self.is_done = False
        self.slice_s = slice_s
        self.is_all = is_all
        cost, graph = flat.costs(), flat.graph()
        price_us = sum(least_prices_us(flat.candidates).values())
        plan = first_plan(graph, cost, standing.clock.tuning.begin.attempts, standing.clock.is_over)
        most = int(cost.sum()) if standing.best is None else standing.best.key.cost_us - price_us
        if limit_us is not None:
            most = min(most, limit_us - price_us)
        enough = most if plan is None else min(most, int(cost[sorted(plan)].sum()))
        bound = bound.at(bound.cost) if bound else Bound(graph.core, cost)
        bound = tightened(bound, enough, most, standing.clock)
        if is_all:
            standing.raise_bound(bound.value + price_us)
        self.least_us = bound.value
        self._bound = bound
        self._price_us = price_us
        self.greedy = plan or set()
        landmarks = [bound.core.labels[one.members].tolist() for one in bound.landmarks]
        has_hosts = bool(flat.candidates.environment.hosts)
        self.model = FlatModel(flat, [] if has_hosts else landmarks)  # with hosts, those of units alone do better
        left = set(bound.core.labels[bound.may_be_used(most)].tolist())
        for label, uses in enumerate(self.model.uses):
            if label not in left:
                self.model.cp.add_bool_or([uses.negated()])
        standing.counts |= {"landmarks": len(landmarks), "left by bounds": len(left)}
        if has_hosts:
            Anywhere(flat, most, standing.clock).add_to(self.model)
        if any(target.quality for target in flat.candidates.environment.targets):
            self._ask_for_quality(cuts)
        self.model.ground()
        started = self.model.started()
        weighed = (len(started) + 1) * (sum(flat.cost_us) + 1) < EXACT
        self.scale = len(started) + 1 if weighed else 1
        terms = [self.model.cost(), LinearExpr.sum(started)]
        self.objective = LinearExpr.weighted_sum(terms, [self.scale, int(weighed)])
        self.is_weighed = weighed
        self._limit_us = limit_us
        self._beaten = standing.best.key if standing.best is not None and has_hosts else None
        if limit_us is not None:
            self.model.cp.add(self.objective <= self.scale * (limit_us + 1) - 1)
        elif self._beaten is not None:
            self.model.cp.add(self.objective <= self._weight(self._beaten) - 1)

    def run(self) -> bool:
        """Solve and cut in rounds until the cost is proven; False if a round takes too long."""
        self.model.cp.minimize(self.objective)
        while not self.standing.clock.is_over():
            self.standing.counts["rounds"] = self.standing.counts.get("rounds", 0) + 1
            solver = self._solver()
            self._hint()
            solver.best_bound_callback = self._learn
            status = solve(solver, self.model.cp, OnSolution(self._look_at), self.standing.clock)
            self.standing.counts["conflicts"] += solver.num_conflicts
            if status in (MODEL_INVALID, INFEASIBLE):
                if self.is_all and status == INFEASIBLE and self._limit_us is not None:
                    self.standing.raise_bound(self._limit_us + 1)
                elif self.is_all and status == INFEASIBLE:
                    self._note_that_none_is_better_than(self._beaten)
                return True
            self._learn(solver.best_objective_bound)
            if status != OPTIMAL:
                return False
            if self._is_proven_by(solver):
                return True
            self._cut(solver.boolean_value)
        return True

    def left(self) -> frozenset[str]:
        """The transformations that may be in a plan as cheap as the incumbent."""
        assert self.standing.best is not None
        keep = self._bound.may_be_used(self.standing.best.key.cost_us - self._price_us)
        units = {self.flat.labels[label].unit for label in self._bound.core.labels[keep].tolist()}
        return frozenset(self.flat.candidates.all[unit].transformation.label for unit in units)

    def _is_proven_by(self, solver: CpSolver) -> bool:
        """Offer the optimum of a round. True if it is a plan, which is then proven."""
        units = decoded(self.model, solver.boolean_value)
        if units is None:
            return False
        key = self.standing.offer(units)
        if self._weight(key) > round(solver.objective_value):
            return False
        if self.is_all:
            self._note_that_none_is_better_than(key)
        return True

    def _weight(self, key: Key) -> int:
        return self.scale * key[1] + (key[3] if self.is_weighed else 0)

    def _note_that_none_is_better_than(self, key: Key | None) -> None:
        best = self.standing.best
        if best is None or key is None:
            self.standing.prove_infeasible()
        else:
            self.standing.prove_cost()
            self.is_done = self.is_weighed and best.key.rewired == 0 and best.key.started == key.started

    def _ask_for_quality(self, cuts: Iterable[ChainCut]) -> None:
        model, flat = self.model, self.flat
        for fact in flat.candidates.clock.each(flat.facts):
            if isinstance(fact, Met):
                model.feeds[fact] = {
                    (label, stream): model.cp.new_bool_var("")
                    for label, streams in flat.givers[fact].items()
                    if fact not in flat.needs[label]
                    for stream in streams
                }

        asked = {wish.attribute for target in model.environment.targets for wish in target.quality}
        attribute = model.environment.quality[asked.pop()]
        if takes_the_worst(flat.candidates, attribute):
            DemandModel(model, attribute).grant_all(cuts)
            return
        value_of: dict[Fact, IntVar] = {}

        def value_of_fact(attribute: QualityAttribute, fact: Met, values: QualityValues) -> IntVar:
            if fact not in value_of:
                value_of[fact] = value_of_choice(model, attribute, model.streams(fact), values)
            return value_of[fact]

        def value_at(attribute: QualityAttribute, unit: int, port: InputPort, values: QualityValues) -> IntVar:
            places = flat.places(unit)
            if len(flat.candidates.all[unit].hosts) == 1 and places:
                return value_of_fact(attribute, Met(port.tag, flat.labels[places[0]].host), values)
            low, high = sorted((attribute.worst, attribute.best))
            value = model.cp.new_int_var(low, high, "")
            for place in places:
                there = value_of_fact(attribute, Met(port.tag, flat.labels[place].host), values)
                no_better = value >= there if attribute.worst > attribute.best else value <= there
                model.cp.add(no_better).only_enforce_if(model.uses[place])
            return value

        targets_get_the_quality_they_ask_for(
            model, lambda target: model.streams(Met(target.tag, target.host)), value_at, cuts
        )

    def _look_at(self, holds: Callable[[IntVar], bool]) -> bool:
        """Offer a solution if it is grounded. Returns True: the solver goes on in any case."""
        units = decoded(self.model, holds)
        if units is not None:
            self.standing.offer(units)
        return True

    def _cut(self, holds: Callable[[IntVar], bool]) -> None:
        """Forbid a solution that is not grounded, and all others that fail for the same reason."""
        true, cp = true_of(self.model, holds), self.model.cp
        anywhere, support = self.model.anywhere, self.model.support
        unfounded, ways_in = anywhere.cut(true, anywhere.grounded(true))
        if not unfounded:
            unfounded, ways_in = support.cut(true, support.grounded(true))
        assert unfounded, "a solution without a plan has something that is not grounded"
        ways = [cp.get_bool_var_from_proto_index(way) for way in ways_in]
        for proposition in unfounded:
            cp.add_bool_or([cp.get_bool_var_from_proto_index(proposition).negated(), *ways])
        self.standing.counts["cuts"] = self.standing.counts.get("cuts", 0) + len(unfounded)

    def _learn(self, bound: float) -> None:
        if not self.is_all:
            return
        bound_us = ceil(bound - 0.5) // self.scale
        if self._limit_us is not None:
            bound_us = min(bound_us, self._limit_us + 1)
        elif self._beaten is not None:
            bound_us = min(bound_us, self._beaten[1])
        self.standing.raise_bound(bound_us)

    def _solver(self) -> CpSolver:
        """A solver for one round, of a length that does not depend on the machine."""
        small = len(self.model.cp.proto.variables) < self.standing.clock.tuning.fleet.small
        solver = repeatable_solver(small=small, time_limit_s=self.standing.clock.left_s())
        solver.parameters.max_deterministic_time = self.slice_s
        if self._beaten is not None:  # a round that took too long is not repeated as it was
            solver.parameters.random_seed = self.standing.counts["rounds"]
        return solver

    def _hint(self) -> None:
        """Hint the incumbent's units and hosts, unless only better plans are looked for."""
        self.model.cp.clear_hints()  # type: ignore[no-untyped-call]
        if self._beaten is not None:
            return
        if self.standing.best is not None:
            there = {(unit.id, unit.host) for unit in self.standing.best.units}
            for i, candidate in enumerate(self.flat.candidates.all):
                for place in self.flat.places(i):
                    self.model.cp.add_hint(
                        self.model.uses[place], (candidate.id, self.flat.labels[place].host) in there
                    )
        else:
            for label, uses in enumerate(self.model.uses):
                self.model.cp.add_hint(uses, label in self.greedy)
