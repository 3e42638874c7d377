"""What is learned of transformations from their units."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from cfgplan_runtime.children.messages import PortCounts
from cfgplan_runtime.estimating.estimator import ESTIMATORS, LearningEstimator, make_estimator
from cfgplan_runtime.estimating.evidence import family
from cfgplan_runtime.estimating.expectations import Origin
from cfgplan_runtime.estimating.forecasters import Average
from cfgplan_runtime.estimating.settings import Learning
from cfgplan_runtime.lifecycle.configuration import EstimatedLibrary
from cfgplan_runtime.supervision.simulated_backend import Behaviour, SimulatedBackend
from hypothesis import given, settings
from hypothesis import strategies as st
from observing import HORIZON_S, WORK, Watched, observation

from cfgplan.domain import Environment, Host, Similarity, Transformation
from cfgplan.planning import Problem

LEARNING = [name for name in ESTIMATORS if name != "declared"]


def piff_and_puff(piff_us: int = 20_000, puff_us: int = 20_000) -> tuple[Transformation, Transformation]:
    return replace(WORK, label="work(piff)", upkeep_us=piff_us), replace(WORK, label="work(puff)", upkeep_us=puff_us)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_what_was_not_observed_costs_what_is_declared(name: str) -> None:
    assert make_estimator(name).estimated([WORK], HORIZON_S) == (WORK,)


@pytest.mark.parametrize("name", LEARNING)
def test_labor_and_upkeep_are_learned(name: str) -> None:
    estimator = make_estimator(name)
    Watched(estimator).run(lambda _: 5_000, 60, labor_us=80_000)
    estimate = estimator.estimate(WORK, HORIZON_S)
    assert (estimate.labor_us, estimate.upkeep_us) == (80_000, 5_000)
    assert (estimate.labor_origin, estimate.upkeep_origin) == (Origin.OBSERVED, Origin.OBSERVED)


def test_nothing_is_learned_from_a_unit_that_gives_nothing() -> None:
    estimator = LearningEstimator()
    for now_s in range(60):
        seen = replace(observation("work.1", 1000), outputs={"y": PortCounts(elements=0)})
        estimator.observe([seen], now_s)
    assert estimator.estimated([WORK], HORIZON_S) == (WORK,)


def test_what_a_unit_used_while_it_gave_nothing_counts_once_it_gives_again() -> None:
    estimator = LearningEstimator(Average)
    for now_s in range(61):
        elements, cpu_us = (min(now_s, 10), 5_000 * now_s) if now_s < 60 else (11, 5_000 * now_s)
        seen = replace(observation("work.1", 100_000 + cpu_us), outputs={"y": PortCounts(elements=elements + 1)})
        estimator.observe([seen], now_s)
        if now_s == 59:
            dead = estimator.evidence["work"].upkeep.samples[-1].until
    assert (dead, estimator.upkeep_us(WORK, HORIZON_S)) == (10, 5_000)


def test_the_declared_estimator_learns_only_from_failures() -> None:
    estimator = make_estimator("declared")
    watched = Watched(estimator)
    watched.run(lambda _: 5_000, 60)
    assert estimator.estimated([WORK], HORIZON_S) == (WORK,)
    estimator.failed("work", watched.now_s)
    assert estimator.upkeep_us(WORK, HORIZON_S) > WORK.upkeep_us


@pytest.mark.parametrize("name", LEARNING)
@settings(max_examples=25)
@given(upkeeps=st.lists(st.integers(0, 2_000_000), min_size=1, max_size=80))
def test_an_estimate_is_not_negative_and_no_further_off_than_the_range_again(name: str, upkeeps: list[int]) -> None:
    estimator = make_estimator(name)
    Watched(estimator).run_once(upkeeps)
    estimate = estimator.estimate(WORK, HORIZON_S).running_us
    low, high = min(upkeeps), max(upkeeps)
    assert max(0, 2 * low - high) - 2 <= estimate <= 2 * high - low + 2


@settings(max_examples=25)
@given(upkeeps=st.lists(st.integers(0, 2_000_000), min_size=1, max_size=80))
def test_an_average_is_within_the_range_of_what_was_observed(upkeeps: list[int]) -> None:
    estimator = LearningEstimator(Average)
    Watched(estimator).run_once(upkeeps)
    assert min(upkeeps) - 1 <= estimator.estimate(WORK, HORIZON_S).running_us <= max(upkeeps) + 1


@pytest.mark.parametrize("name", LEARNING)
@settings(max_examples=25)
@given(before=st.integers(0, 500_000), after=st.integers(0, 500_000))
def test_after_a_step_every_estimator_converges_to_the_new_constant(name: str, before: int, after: int) -> None:
    estimator = make_estimator(name)
    watched = Watched(estimator, every_s=2.5)
    watched.run(lambda now_s: before if now_s < 100 else after, 100 + 10 * 60)
    band = max(0.06 * max(before, after), 1000)
    assert estimator.upkeep_us(WORK, HORIZON_S) == pytest.approx(after, abs=band)


def test_units_of_one_transformation_share_an_estimate() -> None:
    estimator = LearningEstimator(Average)
    for second in range(40):
        estimator.observe(
            [observation("work.1", 100_000 + 1000 * second), observation("work.2", 100_000 + 3000 * second)], second
        )
    assert estimator.upkeep_us(WORK, HORIZON_S) == 2000


def test_a_family_is_the_name_before_the_bracket() -> None:
    assert family("segmenter(piff)") == family("segmenter (puff)") == "segmenter"
    assert family("segmenter") == "segmenter"
    assert family("(odd)") == "(odd)"


def test_a_relative_is_expected_to_cost_what_the_family_was_observed_to() -> None:
    estimator = make_estimator()
    piff, puff = piff_and_puff()
    Watched(estimator, "work(piff)").run(lambda _: 60_000, 30, labor_us=900_000)
    _, estimated = estimator.estimated([piff, puff], HORIZON_S)
    assert (estimated.labor_us, estimated.upkeep_us) == (900_000, 60_000)
    assert estimator.estimate(puff, HORIZON_S).upkeep_origin == Origin.FAMILY


def test_a_relative_that_is_declared_twice_as_dear_is_expected_to_be_twice_as_dear() -> None:
    estimator = make_estimator()
    piff, puff = piff_and_puff(piff_us=20_000, puff_us=40_000)
    Watched(estimator, "work(piff)").run(lambda _: 60_000, 30)
    assert estimator.estimated([piff, puff], HORIZON_S)[1].upkeep_us == 120_000


def test_what_has_other_unit_code_is_no_relative() -> None:
    estimator = make_estimator()
    piff, puff = piff_and_puff()
    other = replace(puff, source="units.py:Other")
    estimator.estimated([piff, other], HORIZON_S)
    Watched(estimator, "work(piff)").run(lambda _: 60_000, 30)
    assert estimator.estimated([piff, other], HORIZON_S)[1] == other


def test_own_observations_count_more_than_the_familys() -> None:
    estimator = make_estimator()
    piff, puff = piff_and_puff()
    Watched(estimator, "work(piff)").run(lambda _: 60_000, 30)
    Watched(estimator, "work(puff)").run(lambda _: 1_000, 30)
    assert [one.upkeep_us for one in estimator.estimated([piff, puff], HORIZON_S)] == [60_000, 1_000]


def test_an_optimist_tries_everything_once_and_then_knows() -> None:
    estimator = make_estimator("trend", "optimistic")
    assert [(one.labor_us, one.upkeep_us) for one in estimator.estimated([WORK], HORIZON_S)] == [(0, 0)]
    Watched(estimator).run(lambda _: 5_000, 10)
    assert estimator.upkeep_us(WORK, HORIZON_S) == 5_000


def test_a_pessimist_expects_the_unknown_to_be_dearer_than_all_that_is_known() -> None:
    estimator = make_estimator("trend", "pessimistic")
    known, unknown = WORK, replace(WORK, label="other", labor_us=1, upkeep_us=1)
    Watched(estimator).run(lambda _: 50_000, 10)
    first, second = estimator.estimated([known, unknown], HORIZON_S)
    assert second.upkeep_us > first.upkeep_us
    assert second.labor_us > first.labor_us


@settings(max_examples=50)
@given(ran_s=st.integers(0, 300), gaps_s=st.lists(st.floats(0.1, 100), min_size=1, max_size=12))
def test_each_failure_makes_a_transformation_dearer(ran_s: int, gaps_s: list[float]) -> None:
    estimator = LearningEstimator(settings=Learning(least_change=0, least_change_us=0, forget_s=1e9))
    watched = Watched(estimator)
    watched.run(lambda _: 5_000, ran_s)
    now_s, costs = watched.now_s, [estimator.upkeep_us(WORK, HORIZON_S)]
    for gap_s in gaps_s:
        now_s += gap_s
        estimator.failed("work", now_s)
        costs.append(estimator.upkeep_us(WORK, HORIZON_S))
    assert all(before < after for before, after in pairwise(costs))


def test_failures_cost_restarts() -> None:
    """Two failures in the prior's 60 s and 60 s of running: one per minute, each a start and an interruption."""
    estimator = LearningEstimator(settings=Learning(forget_s=1e12, failure_us=500_000))
    watched = Watched(estimator)
    watched.run(lambda _: 5_000, 60, labor_us=100_000)
    estimator.failed("work", watched.now_s)
    estimator.failed("work", watched.now_s)
    assert estimator.estimate(WORK, HORIZON_S).failing_us == pytest.approx(2 / 120 * 600_000, abs=1)


def test_what_runs_on_without_failing_is_trusted_again() -> None:
    estimator = make_estimator()
    watched = Watched(estimator)
    watched.run(lambda _: 5_000, 10)
    estimator.failed("work", watched.now_s)
    at_first = estimator.estimate(WORK, HORIZON_S).failing_us
    watched.run(lambda _: 5_000, 1200)
    assert 0 < estimator.estimate(WORK, HORIZON_S).failing_us < at_first / 5


def test_what_is_not_seen_for_long_is_forgotten() -> None:
    estimator = make_estimator()
    watched = Watched(estimator)
    watched.run(lambda _: 90_000, 60)
    estimator.failed("work", watched.now_s)
    watched.pass_time(20 * estimator.settings.forget_s)
    assert estimator.upkeep_us(WORK, HORIZON_S) == pytest.approx(WORK.upkeep_us, abs=300)


def test_what_is_declared_otherwise_is_learned_anew() -> None:
    estimator = make_estimator()
    estimator.estimated([WORK], HORIZON_S)
    Watched(estimator).run(lambda _: 90_000, 60)
    cheaper, slower = replace(WORK, upkeep_us=7), replace(WORK, params={"threshold": 3})
    assert estimator.upkeep_us(WORK, HORIZON_S) == 90_000
    assert estimator.upkeep_us(cheaper, HORIZON_S) == 7
    assert estimator.upkeep_us(slower, HORIZON_S) == WORK.upkeep_us


def test_a_small_change_does_not_change_an_estimate() -> None:
    estimator = make_estimator()
    watched = Watched(estimator)
    watched.run(lambda _: 10_000, 60)
    before = estimator.estimated([WORK], HORIZON_S)
    watched.run(lambda _: 10_200, 600)
    assert estimator.estimated([WORK], HORIZON_S) == before
    watched.run(lambda _: 11_000, 600)
    assert estimator.upkeep_us(WORK, HORIZON_S) == pytest.approx(11_000, rel=0.02)


def test_a_unit_that_bears_a_dead_ones_name_is_a_new_one() -> None:
    estimator = make_estimator("latest")
    estimator.observe([observation("work.1", 5_000_000)], 0)
    estimator.observe([observation("work.1", 5_010_000)], 1)
    estimator.observe([observation("work.1", 100_000)], 2)
    estimator.observe([observation("work.1", 130_000)], 3)
    assert estimator.evidence["work"].starts == 2
    assert [one.value for one in estimator.evidence["work"].upkeep.samples] == [20_000]


def test_looking_twice_at_one_moment_does_no_harm() -> None:
    estimator = make_estimator("latest")
    for now_s in (0, 0, 1, 1, 2, 2):
        estimator.observe([observation("work.1", 100_000 + 5_000 * now_s)], now_s)
    assert estimator.upkeep_us(WORK, HORIZON_S) == 5_000


@given(horizon_s=st.integers(0, 10**9), upkeep_us=st.integers(0, 10**12))
def test_estimated_costs_never_add_up_to_more_than_can_be_computed(horizon_s: int, upkeep_us: int) -> None:
    estimator = make_estimator("latest", "pessimistic")
    Watched(estimator).run_once([upkeep_us], labor_us=upkeep_us)
    library = estimator.estimated([WORK, replace(WORK, label="other")], horizon_s)
    Problem(Environment(library=library), Similarity({}), horizon_s)


def test_a_simulated_unit_uses_what_its_behaviour_says() -> None:
    behaviour = Behaviour(start_s=0.5, labor_us=70_000, upkeep_us=lambda second: 1000 * second)
    backend = SimulatedBackend({"work": behaviour})
    backend.start("work.1", WORK, None, None)
    while backend.now() < 2.5:
        backend.wait(2.5 - backend.now())
    usage = backend.usage("work.1")
    assert usage is not None
    assert (backend.now(), usage.cpu_us) == (2.5, 70_000 + 0 + 1000 + 1000)


SLOW, FAST = Host("slow", speed=500_000), Host("fast", speed=2_000_000)


def on(estimator: LearningEstimator, *hosts: Host) -> list[tuple[int, int]]:
    """The labor and upkeep of WORK that are expected on hosts."""
    return [(estimator.labor_us(WORK, HORIZON_S, at), estimator.upkeep_us(WORK, HORIZON_S, at)) for at in hosts]


def test_what_was_never_seen_costs_on_a_host_what_is_declared_by_its_speed() -> None:
    assert on(make_estimator(), SLOW, FAST) == [(600_000, 40_000), (150_000, 10_000)]


def test_what_was_seen_on_a_host_counts_there_and_elsewhere_by_the_speeds() -> None:
    estimator = make_estimator()
    on(estimator, SLOW, FAST)
    Watched(estimator, host="slow").run(lambda _: 80_000, 60, labor_us=400_000)
    assert on(estimator, SLOW, FAST) == [(400_000, 80_000), (100_000, 20_000)]
    Watched(estimator, host="fast").run(lambda _: 50_000, 60, labor_us=400_000)
    assert on(estimator, SLOW, FAST) == [(400_000, 80_000), (400_000, 50_000)]
    assert estimator.estimated([WORK], HORIZON_S) == (WORK,)


def test_a_failure_makes_a_transformation_dearer_on_its_host_only() -> None:
    estimator = make_estimator()
    (_, slow), fast = on(estimator, SLOW, FAST)
    estimator.failed("work", 0.0, SLOW.name)
    assert on(estimator, SLOW, FAST)[0][1] > slow
    assert on(estimator, SLOW, FAST)[1] == fast


def test_a_host_where_it_never_failed_has_only_the_labor_and_upkeep_of_the_others() -> None:
    estimator = make_estimator()
    on(estimator, SLOW, FAST)
    watched = Watched(estimator, host="slow")
    watched.run(lambda _: 80_000, 60, labor_us=400_000)
    before = on(estimator, SLOW, FAST)
    for _ in range(5):
        estimator.failed("work", watched.now_s, SLOW.name)
    after = on(estimator, SLOW, FAST)
    assert after[0][1] > before[0][1]
    assert after[1] == before[1]


def test_a_failure_on_no_known_host_counts_on_every_host() -> None:
    estimator = make_estimator()
    before = on(estimator, SLOW, FAST)
    estimator.failed("work", 0.0)
    assert all(after > was for (_, was), (_, after) in zip(before, on(estimator, SLOW, FAST), strict=True))


def test_estimates_of_hosts_reach_the_library_that_is_planned_with() -> None:
    estimator, library = make_estimator(), EstimatedLibrary()
    world = Environment((), (WORK,), (), (SLOW, FAST))
    assert library.estimated(world, estimator, HORIZON_S)["work"] is WORK
    Watched(estimator, host="slow").run(lambda _: 80_000, 60, labor_us=400_000)
    known = library.estimated(world, estimator, HORIZON_S)["work"]
    assert known == replace(WORK, seen_us={"slow": (400_000, 80_000), "fast": (100_000, 20_000)})
    assert library.estimated(world, estimator, HORIZON_S)["work"] is known
