"""Cuts on chains of streams where targets ask for quality."""

from __future__ import annotations

import numpy as np
from fleets import fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from test_fleets_against_the_oracle import some
from worlds import examples

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InputError
from cfgplan.figures import qualities_of_targets
from cfgplan.planners import PLANNERS
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.quality_chains import Chains, Root
from cfgplan.planners.exact.quality_cuts import chain_cuts
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Feature, Problem
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule, Wish
from cfgplan.reasons import unmet_reasons
from experiments.families.random_library import random_library

LATENCY = QualityAttribute("latency", Better.LOWER, worst=1000)


def adds(label: str, needs: str | None, gives: str, latency: int) -> Transformation:
    inputs = () if needs is None else (InputPort("in", needs),)
    return Transformation(
        label, inputs, (OutputPort("out", gives, (Contribution("latency", QualityRule.ADD, latency),)),), 1, 0
    )


def two_ways() -> Candidates:
    """A target that a slow or a fast filter of one sensor meets."""
    library = (adds("sensor", None, "raw", 10), adds("slow", "raw", "clean", 30), adds("fast", "raw", "clean", 5))
    targets = (Target("t", "clean", "/t", quality=(Wish("latency", None, MICRO),)),)
    similarity = Similarity({tag: frozenset({tag}) for tag in ("raw", "clean")})
    return Candidates(Problem(Environment((), library, targets, (), (LATENCY,)), similarity, 60))


def test_only_the_fast_unit_is_ahead_of_what_the_slow_one_makes() -> None:
    candidates = two_ways()
    chains = Chains(candidates, LATENCY)
    potential = np.zeros(2, np.int64)
    potential[chains.demand["raw"]], potential[chains.demand["clean"]] = 10, 40
    ahead = Root(chains, "clean").ahead(potential)
    names = {c.transformation.label: int(ahead[i]) for i, c in enumerate(candidates.all)}
    assert names == {"sensor": 0, "slow": 0, "fast": 25}


def test_potentials_are_lifted_where_nobody_gets_ahead() -> None:
    candidates = two_ways()
    chains = Chains(candidates, LATENCY)
    potential = np.zeros(2, np.int64)
    potential[chains.demand["clean"]] = 15
    lifted = Root(chains, "clean").lifted(potential)
    assert lifted[chains.demand["raw"]] == 10
    assert not Root(chains, "clean").ahead(lifted).any()


def is_kept(problem: Problem, candidates: Candidates, attribute: QualityAttribute, draw: st.DataObject) -> None:
    """Cuts with any potentials hold of an optimal plan."""
    try:
        plan = PLANNERS["exhaustive"](problem)
    except InputError:
        assume(False)
    assume(plan.change_set is not None)
    assert plan.change_set is not None
    units = problem.environment.update(plan.change_set).units
    reached = qualities_of_targets(problem.environment, units)
    chains = Chains(candidates, attribute)
    size = len(chains.demand)
    found = draw.draw(st.lists(st.integers(0, chains.scale), min_size=size, max_size=size))
    potential = np.maximum(np.array(found, np.int64), chains.best)
    running = {unit.id for unit in units}
    for target in problem.environment.targets:
        root = Root(chains, target.tag)
        for potentials in (potential, root.lifted(potential)):
            ahead = root.ahead(potentials)
            helped = sum(int(ahead[i]) for i, c in enumerate(candidates.all) if c.id in running)
            badness = attribute.badness(reached[target.label][attribute.name])
            assert badness + helped >= potentials[root.demand]


@examples(30, part=2)
@given(fleets(frozenset({Feature.QUALITY})), st.data())
def test_cuts_hold_whatever_the_potentials(problem: Problem, data: st.DataObject) -> None:
    assume(not unmet_reasons(problem))
    for attribute in problem.environment.qualities:
        is_kept(problem, Candidates(problem), attribute, data)


@some
@given(fleets(frozenset({Feature.QUALITY, Feature.HOSTS}), most=2), st.data())
def test_cuts_hold_with_hosts_too(problem: Problem, data: st.DataObject) -> None:
    assume(not unmet_reasons(problem))
    for attribute in problem.environment.qualities:
        is_kept(problem, Candidates(problem), attribute, data)


def test_a_fleet_too_large_for_the_relaxation_gets_no_cuts() -> None:
    candidates = Candidates(random_library(0, transformations=2000, branching=400))
    assert chain_cuts(candidates, [], Clock())[0] == []


def test_a_required_unit_is_used_although_another_is_better() -> None:
    tag, worse = "D", Contribution("e", QualityRule.ADD, 0)
    library = (
        Transformation("better", labor_us=0, outputs=(OutputPort("x", tag, (Contribution("e", QualityRule.ADD, 9),)),)),
        Transformation("wanted", labor_us=0, outputs=(OutputPort("x", tag, (worse,)),), required=True),
    )
    attribute = QualityAttribute("e", Better.HIGHER, worst=0, best=9)
    target = Target("t", tag, "/t", quality=(Wish("e", bound=0, weight_us=MICRO),))
    environment = Environment((), library, (target,), qualities=(attribute,))
    found = PLANNERS["cpsat"](Problem(environment, Similarity({tag: frozenset({tag})}), 0))
    assert (found.unused_required, found.cost_us) == ((), 9)
