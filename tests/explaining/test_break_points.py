"""Break points by example, and by property against the oracle at every value."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest
from fleets import fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from worlds import examples, oracle_of, problems

from cfgplan.costs import LARGEST_COST_US
from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.explaining import Sensitivity, horizon_sensitivity, upkeep_sensitivity
from cfgplan.planners import PLANNERS
from cfgplan.planning import Failures, Feature, Plan, Problem, Status
from cfgplan.qualities import MICRO

many = examples(60)
few = examples(60, part=2)
cpsat = PLANNERS["cpsat"]


def oracle(problem: Problem) -> Plan:
    size = len(problem.environment.units) + len(problem.environment.library)
    problem = replace(problem, max_cost_us=None)
    return oracle_of(problem) if size < 6 else PLANNERS["cpsat"](problem)


def is_envelope(found: Sensitivity, cost_at: dict[int, int | None]) -> None:
    """Each span's line is the least cost in all its values, and only there."""
    assert found.exact
    ends = [span.end for span in found.spans]
    assert [span.begin for span in found.spans] == [0, *ends[:-1]]
    assert ends[-1] is None
    slopes = [span.line.each_us for span in found.spans]
    assert slopes == sorted(set(slopes), reverse=True)
    for value, cost_us in cost_at.items():
        for span in found.spans:
            if span.holds(value):
                assert span.line.at(value) == cost_us
            else:
                assert span.line.at(value) > (cost_us or 0)


@many
@given(problems(most=5))
def test_the_least_cost_is_that_of_the_spans_at_every_horizon(problem: Problem) -> None:
    found = horizon_sensitivity(problem, cpsat)
    if not found.spans:
        assert oracle(problem).status is Status.INFEASIBLE
        return
    values = [0, 1, 2, 3, 5, 10, 20, 100]
    is_envelope(found, {value: oracle(replace(problem, horizon_s=value)).cost_us for value in values})
    assert found.here is not None


@many
@given(problems(most=5), st.data())
def test_the_least_cost_is_that_of_the_spans_at_every_upkeep(problem: Problem, data: st.DataObject) -> None:
    label = data.draw(st.sampled_from(sorted(problem.environment.transformation)))
    found = upkeep_sensitivity(problem, cpsat, label)
    assume(found.spans)

    def cost_us(upkeep_us: int) -> int | None:
        library = problem.environment.library
        changed = tuple(replace(t, upkeep_us=upkeep_us) if t.label == label else t for t in library)
        return oracle(replace(problem, environment=replace(problem.environment, library=changed))).cost_us

    is_envelope(found, {value: cost_us(value) for value in (0, 1, 2, 3, 5, 8, 20, 100)})


FEATURES = [
    frozenset({Feature.QUALITY, Feature.CONFLICTS}),
    frozenset({Feature.INSTANCES}),
    frozenset({Feature.HOSTS}),
    frozenset({Feature.SURVIVAL}),
    frozenset({Feature.OPTIONAL}),
]
beyond_the_paper = st.sampled_from(FEATURES).flatmap(
    lambda features: fleets(features, most=2 if features & {Feature.SURVIVAL, Feature.HOSTS} else 3)
)


def fleet_oracle(problem: Problem) -> int | None:
    try:
        return PLANNERS["exhaustive"](replace(problem, max_cost_us=None)).cost_us
    except InputError:
        return cpsat(replace(problem, max_cost_us=None)).cost_us


@few
@given(beyond_the_paper)
def test_fleets_have_such_spans_of_horizons_too(problem: Problem) -> None:
    try:
        found = horizon_sensitivity(problem, cpsat)
    except InputError as error:
        environment = problem.environment
        has_energy = any(host.energy is not None for host in environment.hosts)
        assert "energy" in str(error) or environment.transfer_us or any(link.price_us for link in environment.links)
        assert ("rounded" in str(error)) or has_energy
        return
    if found.spans:
        values = [0, 1, 2, 3, 10, 100]
        is_envelope(found, {value: fleet_oracle(replace(problem, horizon_s=value)) for value in values})
    else:
        assert fleet_oracle(problem) is None


@few
@given(beyond_the_paper, st.data())
def test_fleets_have_such_spans_of_upkeeps_too(problem: Problem, data: st.DataObject) -> None:
    environment = problem.environment
    unlimited = tuple(replace(host, cpu_us=None, speed=MICRO) for host in environment.hosts)
    label = data.draw(st.sampled_from(sorted(environment.transformation)))
    problem = replace(problem, environment=replace(environment, hosts=unlimited))
    found = upkeep_sensitivity(problem, cpsat, label)
    assume(found.spans)

    def cost_us(upkeep_us: int) -> int | None:
        library = problem.environment.library
        changed = tuple(replace(t, upkeep_us=upkeep_us) if t.label == label else t for t in library)
        return fleet_oracle(replace(problem, environment=replace(problem.environment, library=changed)))

    is_envelope(found, {value: cost_us(value) for value in (0, 1, 2, 3, 8, 100)})


def ways(*costs: tuple[int, int], horizon_s: int = 1) -> Problem:
    """One target, and a transformation for each labor and upkeep."""
    library = [
        Transformation(f"t{i}", (), (OutputPort("o", "A"),), labor_us=labor, upkeep_us=upkeep)
        for i, (labor, upkeep) in enumerate(costs)
    ]
    relation = Similarity({"A": frozenset({"A"})})
    return Problem(Environment((), tuple(library), (Target("t", "A", "/t"),)), relation, horizon_s)


def test_break_points_are_exact_fractions() -> None:
    found = horizon_sensitivity(ways((0, 10), (7, 7), (20, 4), (100, 4)), cpsat)
    assert found.breaks == (Fraction(7, 3), Fraction(13, 3))
    assert [span.runs for span in found.spans] == [("t0",), ("t1",), ("t2",)]
    assert found.here == found.spans[0]


def test_a_plan_that_is_never_best_at_a_whole_value_has_no_span() -> None:
    found = horizon_sensitivity(ways((0, 10), (6, 6), (10, 0)), cpsat)
    assert [span.runs for span in found.spans] == [("t0",), ("t2",)]


def test_the_upkeep_at_which_another_way_is_cheaper_is_found() -> None:
    found = upkeep_sensitivity(ways((2, 3), (5, 7), horizon_s=10), cpsat, "t0")
    assert found.breaks == (Fraction(73, 10),)
    assert [span.line.each_us for span in found.spans] == [10, 0]


def test_a_cold_spare_may_cost_more_than_what_runs() -> None:
    ready = Transformation("t", (), (OutputPort("o", "A"),), labor_us=0, standby_us=1)
    environment = Environment((), (ready,), (Target("t", "A", "/t"),))
    problem = Problem(environment, Similarity({"A": frozenset({"A"})}), 1, survive=Failures.UNITS)
    found = upkeep_sensitivity(problem, cpsat, "t")
    assert [(span.line.fixed_us, span.line.each_us) for span in found.spans] == [(0, 2), (1, 1)]
    with pytest.raises(InvalidValueError, match="more than can be computed exactly"):
        replace(problem, horizon_s=LARGEST_COST_US)


def test_an_optional_input_is_fed_from_the_horizon_on_at_which_it_is_worth_it() -> None:
    asks = InputPort("i", "B", optional=True, worth_us=3)
    library = (
        Transformation("user", (asks,), (OutputPort("o", "A"),), labor_us=0),
        Transformation("giver", (), (OutputPort("o", "B"),), labor_us=10, upkeep_us=1),
    )
    relation = Similarity({"A": frozenset("A"), "B": frozenset("B")})
    found = horizon_sensitivity(Problem(Environment((), library, (Target("t", "A", "/t"),)), relation, 1), cpsat)
    assert found.breaks == (5,)
    assert [span.runs for span in found.spans] == [("user",), ("giver", "user")]


def test_costs_that_grow_beyond_what_is_exact_end_the_last_span() -> None:
    found = horizon_sensitivity(ways((2**40, 2**40), (2**41, 0)), cpsat)
    assert found.breaks == (1,)
    assert found.spans[-1].end == found.last
