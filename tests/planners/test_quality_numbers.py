"""The numbers of possible values: every value that a wiring makes has one, and they are small."""

from __future__ import annotations

from contextlib import suppress
from unittest.mock import patch

import pytest
from fixed import kind, world
from fleets import fleets
from hypothesis import given
from hypothesis import strategies as st
from kinds import differences, sets_of_units
from worlds import examples, oracle_of

from cfgplan.domain import OutputPort, Target
from cfgplan.errors import InputError
from cfgplan.figures import qualities_of_targets
from cfgplan.planners.cpsat import plan
from cfgplan.planners.exact import quality_numbers
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.quality_numbers import Numbers, numbers_of
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exhaustive import configurations
from cfgplan.planning import Feature, Problem, Status
from cfgplan.qualities import LARGEST_QUALITY, MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish

SEVERAL = frozenset({Feature.QUALITY, Feature.OPTIONAL, Feature.COUNTS})
LATE = frozenset({Feature.QUALITY, Feature.HOSTS, Feature.LATENCY})
COMPARED = st.one_of(fleets(frozenset({Feature.QUALITY})), fleets(SEVERAL, most=2), fleets(LATE, most=2))
LEAST_SKIPS = (2, 5, quality_numbers.LEAST_SKIP)


def chain(rule: QualityRule, factor: int, better: Better, over: Over = Over.WORST) -> Problem:
    """A source that states nothing, one that does, and two units that make something of either."""
    stated = OutputPort("x", "", (Contribution("q", QualityRule.ADD, 3 * MICRO),))
    made = OutputPort("x", "", (Contribution("q", rule, factor, over),))
    library = (
        kind("unknown", "", "A", 1),
        kind("known", "", "A", 5, output=stated),
        kind("first", "A", "B", 1, output=made),
        kind("second", "B", "C", 1, output=made),
    )
    target = Target("C", "C", "/C", quality=(Wish("q", None, MICRO),))
    return world((target,), *library, qualities=(QualityAttribute("q", better),))


FACTORS = {
    QualityRule.ADD: (0, MICRO // 2, 7 * MICRO, -MICRO),
    QualityRule.LIMIT: (0, MICRO, 50_000 * MICRO),
    QualityRule.SCALE: (0, 333_333, MICRO, 1_500_000),
    QualityRule.SET: (0, MICRO, 50_000 * MICRO),
}


@pytest.mark.parametrize("better", Better)
@pytest.mark.parametrize(("rule", "factor"), [(rule, factor) for rule in QualityRule for factor in FACTORS[rule]])
def test_values_on_the_usual_scale_have_small_numbers(rule: QualityRule, factor: int, better: Better) -> None:
    problem = chain(rule, factor, better)
    candidates = Candidates(problem)
    numbers = numbers_of(candidates, problem.environment.qualities[0])
    assert numbers.top < 2**26
    assert Model(candidates, RULES).cp.is_exact()
    assert differences(problem, plan(problem), oracle_of(problem)) == []


def test_numbers_leave_out_the_gaps_between_values() -> None:
    numbers = Numbers(((2, 4), (100, 100), (200, 201)), {}, 10, has_worst=True)
    assert [numbers.at_least(bad) for bad in (0, 20, 21, 40, 41, 1000, 1001, 2010, 2011)] == [0, 0, 1, 2, 3, 3, 4, 5, 6]
    assert [numbers.at_most(bad) for bad in (0, 19, 20, 45, 999, 1000, 2005, 9999)] == [-1, -1, 0, 2, 2, 3, 4, 5]
    assert [number + numbers.offset(span) for number, span in ((2, 0), (3, 1), (5, 2))] == [4, 100, 201]


@examples(40)
@given(problem=COMPARED)
def test_every_value_that_a_valid_configuration_gives_a_target_has_a_number(problem: Problem) -> None:
    if sets_of_units(problem) > 200:
        return
    candidates, numbers = Candidates(problem), []
    for least_skip in LEAST_SKIPS:
        with patch.object(quality_numbers, "LEAST_SKIP", least_skip):
            numbers.append({a.name: numbers_of(candidates, a) for a in problem.environment.qualities})
    with suppress(InputError):  # configurations beyond the oracle's most steps are not looked at
        for _, after in configurations(problem):
            for values in qualities_of_targets(after, after.units).values():
                for name, value in values.items():
                    bad = problem.environment.quality[name].badness(value)
                    assert all(each[name].at_least(bad) == each[name].at_most(bad) for each in numbers)


@pytest.mark.parametrize("least_skip", LEAST_SKIPS)
@examples(40)
@given(problem=COMPARED)
def test_the_planner_equals_the_oracle_however_small_ranges_are_skipped(problem: Problem, least_skip: int) -> None:
    with patch.object(quality_numbers, "LEAST_SKIP", least_skip):
        found = plan(problem)
    assert differences(problem, found, oracle_of(problem)) == []


@pytest.mark.parametrize("over", Over)
def test_a_stream_at_two_inputs_counts_twice(over: Over) -> None:
    problem = chain(QualityRule.ADD, MICRO, Better.LOWER)
    made = OutputPort("x", "", (Contribution("q", QualityRule.ADD, MICRO, over),))
    one, *others = (t for t in problem.environment.library if t.label not in ("first", "unknown"))
    problem = problem.with_parts(library=(one, kind("first", "AA", "B", 1, output=made), *others))
    found = plan(problem)
    assert (found.status, found.cost_us) == (Status.OPTIMAL, 7 + (8 if over is Over.SUM else 5) * MICRO)


def test_a_price_far_beyond_all_other_values_is_exact() -> None:
    problem = chain(QualityRule.ADD, MICRO, Better.LOWER)
    found = plan(problem)
    assert (found.status, found.cost_us) == (Status.OPTIMAL, 7 + 5 * MICRO)
    nothing = problem.with_parts(library=tuple(t for t in problem.environment.library if t.label != "known"))
    found = plan(nothing)
    assert (found.status, found.cost_us) == (Status.OPTIMAL, 3 + LARGEST_QUALITY)


def test_a_cycle_of_units_that_are_a_little_better_than_their_inputs_ends() -> None:
    """Each time around it a stream would be better by a millionth: a bound is 50,000,000,000 times away."""
    source = OutputPort("x", "", (Contribution("q", QualityRule.LIMIT, MICRO, Over.BEST),))
    better = OutputPort("x", "", (Contribution("q", QualityRule.ADD, 1, Over.BEST),))
    library = (kind("source", "", "A", output=source), kind("there", "A", "B", output=better), kind("back", "B", "A"))
    target = Target("B", "B", "/B", quality=(Wish("q", 50_000 * MICRO),))
    problem = world((target,), *library, qualities=(QualityAttribute("q", Better.HIGHER),))
    assert plan(problem, time_limit_s=60).status is Status.INFEASIBLE
