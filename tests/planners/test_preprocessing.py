"""Each step of the preprocessing keeps an optimal plan, and says nothing untrue about cost."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from test_against_the_oracle import fewer
from worlds import problems

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.planners import PLANNERS
from cfgplan.planners.bounding.bounds import Bound, chained_bound, cheapest_way
from cfgplan.planners.closing.program import charged
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.configuration import wire
from cfgplan.planners.networks.greedy import first_plan, is_plan
from cfgplan.planners.networks.network import LexicographicWeights, Network
from cfgplan.planners.reducing.closure import Closure
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Plan, Problem, Status


class Stage:
    """A plain problem, its oracle's plan, and its network, for one step to be tried on."""

    def __init__(self, problem: Problem) -> None:
        plan = PLANNERS["exhaustive"](Problem(problem.environment, problem.similarity, problem.horizon_s))
        assume(plan.status is Status.OPTIMAL and plan.change_set is not None)
        assert plan.change_set is not None
        environment = problem.environment
        self.plan: Plan = plan
        self.used = {unit.transformation for unit in environment.update(plan.change_set).units}
        closure = Closure.of(problem, Clock())
        self.providers, self.possible, self.relevant = closure.providers, closure.possible, closure.relevant
        library = [t for t in environment.library if t.label in self.relevant]
        self.network = Network(library, [target.tag for target in environment.targets], [], self.providers)
        running = {unit.transformation for unit in environment.units}
        self.cost = np.array(
            [(keep_cost_us if t.label in running else start_cost_us)(t, problem.horizon_s) for t in library], np.int64
        )

    def numbers(self, labels: set[str]) -> set[int]:
        return {self.network.number[label] for label in labels}


@fewer
@given(problems(special=False))
def test_forward_groundedness_and_backward_relevance_keep_what_an_optimal_plan_uses(problem: Problem) -> None:
    stage = Stage(problem)
    assert stage.used <= stage.relevant <= stage.possible


@fewer
@given(problems(special=False))
def test_an_optimal_plan_is_one_of_the_network_and_demands_are_merged(problem: Problem) -> None:
    stage = Stage(problem)
    assert len(stage.network.core.providers) <= len(stage.network.fact_of_tag)
    assert is_plan(stage.network, stage.numbers(stage.used))


@fewer
@given(problems(special=False))
def test_the_first_plan_is_a_plan_and_not_cheaper_than_the_optimum(problem: Problem) -> None:
    stage = Stage(problem)
    plan = first_plan(stage.network, stage.cost, 5, Clock())
    assert plan is not None
    assert is_plan(stage.network, plan)
    assert int(stage.cost[sorted(plan)].sum()) >= (stage.plan.cost_us or 0)
    candidates = Candidates(problem)
    assert wire(candidates, candidates.first_of_each(stage.network.labels[i] for i in sorted(plan))) is not None


@fewer
@given(problems(special=False))
def test_bounds_do_not_exceed_the_optimum_and_fixing_keeps_optimal_plans(problem: Problem) -> None:
    stage = Stage(problem)
    assert stage.plan.cost_us is not None
    used = sorted(stage.numbers(stage.used))
    bound = Bound(stage.network.core, stage.cost)
    whole = bound.may_be_used(stage.plan.cost_us)
    assert whole[used].all()
    part = bound.restricted(whole)
    part.improve(stage.plan.cost_us, 100, lambda: False)
    assert 0 <= part.value <= stage.plan.cost_us
    left = set(part.core.labels[part.may_be_used(stage.plan.cost_us)].tolist())
    assert left >= set(used)


@fewer
@given(problems(special=False))
def test_every_plan_has_a_member_of_each_landmark_also_after_costs_moved(problem: Problem) -> None:
    stage = Stage(problem)
    core = stage.network.core
    bound = Bound(core, stage.cost)
    bound.improve(2**50, 100, lambda: False)
    landmarks = bound.landmarks
    used = stage.numbers(stage.used)
    assert all(used & set(landmark.members.tolist()) for landmark in landmarks)
    value = bound.value
    bound = charged(bound, Clock())
    assert value <= bound.value <= (stage.plan.cost_us or 0)
    assert (bound.residual >= 0).all()
    free = Bound(core, np.zeros_like(stage.cost), landmarks)
    free = charged(free, Clock())
    assert free.value == 0


@fewer
@given(problems(special=False))
def test_short_landmarks_have_no_more_members_than_others_and_than_there_are_offers_and_needs(problem: Problem) -> None:
    stage = Stage(problem)
    bound = Bound(stage.network.core, stage.cost)
    bound.improve(2**50, 100, lambda: False)
    short = bound.short()
    lengths = sorted(len(landmark.members) for landmark in bound.landmarks)
    assert [len(landmark.members) for landmark in short] == lengths[: len(short)]
    assert sum(lengths[: len(short)]) <= bound.core.links
    assert len(short) == len(lengths) or sum(lengths[: len(short) + 1]) > bound.core.links


@fewer
@given(problems(special=False))
def test_the_dearest_unavoidable_chain_is_never_more_than_the_optimum(problem: Problem) -> None:
    stage = Stage(problem)
    _, before = cheapest_way(stage.network.core, stage.cost)
    assert int(before[-1]) <= (stage.plan.cost_us or 0)


@fewer
@given(problems(special=False))
def test_dearest_chains_charged_one_after_the_other_are_never_more_than_the_optimum(problem: Problem) -> None:
    stage = Stage(problem)
    core = stage.network.core
    assert (
        int(cheapest_way(core, stage.cost)[1][-1])
        <= chained_bound(core, stage.cost, stage.network.pinned, lambda: False)
        <= (stage.plan.cost_us or 0)
    )


@fewer
@given(problems(special=False))
def test_a_weight_is_cost_and_where_nothing_runs_started_units(problem: Problem) -> None:
    stage = Stage(problem)
    weights = LexicographicWeights.of(problem, stage.network)
    used = np.array(sorted(stage.numbers(stage.used)), np.int64)
    weight = weights.of_plan(used)
    assert weights.cost_us(weight) == int(stage.cost[used].sum())
    running = {unit.transformation for unit in problem.environment.units}
    assert weights.counts_starts == running.isdisjoint(stage.relevant)
    assert weights.changes(weight) == ((0, len(used)) if weights.counts_starts else None)
    assert weights.least(weight) == weight
    assert (
        weights.least(chained_bound(stage.network.core, weights.weight, stage.network.pinned, lambda: False)) <= weight
    )


def test_plans_that_tie_need_no_solver_where_the_bound_counts_started_units() -> None:
    from test_planners import make, world

    library = (make("one", gives="A"), make("other", gives="A"), make("last", "A", "B"))
    plan = PlannerSession().plan(world("B", *library))
    assert plan.status is Status.OPTIMAL
    assert "rounds" not in plan.counts


def test_the_counts_say_what_each_step_left() -> None:
    from test_planners import make, world

    library = (
        make("source", gives="A"),
        make("dear", gives="A", labor=99),
        make("filter", "A", "B"),
        make("unfed", "G", "B"),
        make("beside", "A", "C"),
    )
    plan = PlannerSession().plan(world("B", *library))
    assert plan.counts["transformations"] == 5
    assert plan.counts["startable"] == 4
    assert plan.counts["relevant"] == 3
    assert plan.counts["left by bounds"] == 2
    assert "rounds" not in plan.counts
    assert plan.status is Status.OPTIMAL
