"""What a plan prefers where two wishes meet: planner, oracle and judge hold the same rule."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Objective,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.explaining import Choice, alternatives, horizon_sensitivity, why_transformation
from cfgplan.planners import PLANNERS
from cfgplan.planning import Failures, Measured, Plan, Problem, Status
from cfgplan.validity import Rule, plan_violations

MATCHING = Similarity({"T": frozenset({"T"})})
TARGET = (Target("t", "T", "/t"),)
BOTH = pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])


def gives(label: str, labor_us: int, **wishes: object) -> Transformation:
    return Transformation(label, (), (OutputPort("o", "T"),), labor_us=labor_us, **wishes)  # type: ignore[arg-type]


def planned(planner: str, problem: Problem) -> Plan:
    found = PLANNERS[planner](problem)
    assert plan_violations(problem, found) == []
    return found


@BOTH
@pytest.mark.parametrize("rest", [{}, {"conflicts": ("other",)}])
def test_required_comes_before_the_largest_cost(planner: str, rest: dict[str, object]) -> None:
    library = (gives("cheap", 1), gives("must", 9, required=True, **rest))
    environment = Environment((), library, TARGET)
    dear = planned(planner, Problem(environment, MATCHING, 1, max_cost_us=5))
    assert (dear.status, dear.cost_us) == (Status.TOO_EXPENSIVE, 9)
    found = planned(planner, Problem(environment, MATCHING, 1, max_cost_us=9))
    assert (found.cost_us, found.unused_required) == (9, ())


@BOTH
def test_the_bound_on_plans_without_a_required_transformation_is_none_on_plans_with_it(planner: str) -> None:
    library = (gives("one", 1), gives("other", 1), gives("must", 2, required=True))
    environment = Environment((), library, TARGET, hosts=(Host("h"),))
    found = planned(planner, Problem(environment, MATCHING, 0))
    assert (found.status, found.cost_us, found.bound_us, found.ties_proven) == (Status.OPTIMAL, 2, 2, True)


ROOMS = (Host("big", memory_mb=9, rent_us=9), Host("one", memory_mb=4, rent_us=2), Host("two", memory_mb=4, rent_us=2))
TWO = (
    replace(gives("t", 1, memory_mb=3), inputs=(InputPort("i", "S"),)),
    Transformation("s", (), (OutputPort("o", "S"),), labor_us=1, memory_mb=3),
    gives("alone", 90, memory_mb=9),
)


def in_order(*minimise: str, max_cost_us: int | None = None, units: tuple[ComputationUnit, ...] = ()) -> Problem:
    """One dear host bears two cheap units, or a dear unit; two cheap hosts bear a cheap unit each."""
    named = tuple(map(Objective, minimise))
    environment = Environment(units, TWO, TARGET, ROOMS, minimise=named)
    return Problem(environment, Similarity({tag: frozenset(tag) for tag in "ST"}), 1, max_cost_us=max_cost_us)


@BOTH
@pytest.mark.parametrize(
    ("minimise", "values"),
    [
        (["hosts"], [1, 11]),
        (["hosts", "units"], [1, 1, 99]),
        (["rent", "hosts"], [4, 2, 6]),
        (["units", "rent"], [1, 9, 99]),
        (["cost", "hosts"], [6, 2]),
        (["started", "cost"], [1, 99]),
    ],
)
def test_objectives_are_minimised_in_their_order_and_the_cost_after_them(
    planner: str, minimise: list[str], values: list[int]
) -> None:
    found = planned(planner, in_order(*minimise))
    assert (found.status, found.ties_proven, found.gap) == (Status.OPTIMAL, True, 0.0)
    assert [one.value for one in found.objectives] == [one.bound for one in found.objectives] == values
    assert found.objectives[-1].objective == Objective.COST or minimise[-1] == "hosts"


@BOTH
def test_the_largest_cost_is_one_of_the_cost_whatever_is_minimised_first(planner: str) -> None:
    found = planned(planner, in_order("units", max_cost_us=98))
    assert (found.status, [one.value for one in found.objectives]) == (Status.OPTIMAL, [2, 6])
    dear = planned(planner, in_order("units", max_cost_us=5))
    assert (dear.status, dear.cost_us, dear.bound_us) == (Status.TOO_EXPENSIVE, None, 6)


def test_the_gap_is_that_of_the_first_objective_that_is_not_proven() -> None:
    names = (Objective.HOSTS, Objective.COST)
    first, second = (Measured(each, 4, 1) for each in names)
    plan = Plan("by hand", Status.FEASIBLE, ChangeSet(), 4, 1, objectives=(first, second))
    assert plan.gap == 0.75
    assert replace(plan, objectives=(replace(first, bound=4), replace(second, bound=2))).gap == 0.5
    assert [one.bound for one in plan.unproven.objectives] == [0, 0]


def test_a_plan_that_says_something_untrue_of_an_objective_is_found_out() -> None:
    problem = in_order("hosts", "rent")
    found = PLANNERS["exhaustive"](problem)
    hosts, rent, cost = found.objectives

    def rules(*objectives: Measured, **claims: object) -> set[Rule]:
        changed = replace(found, objectives=objectives, **claims)  # type: ignore[arg-type]
        return {violation.rule for violation in plan_violations(problem, changed)}

    assert rules(hosts, rent) == rules(rent, hosts, cost) == {Rule.CONSISTENT}
    assert Rule.COST in rules(hosts, replace(rent, value=8, bound=8), cost)
    assert Rule.COST in rules(hosts, rent, replace(cost, value=10, bound=10))
    assert rules(hosts, replace(rent, bound=8), cost) == {Rule.BOUND}
    assert Rule.BOUND in rules(hosts, replace(rent, bound=10), cost, status=Status.FEASIBLE, ties_proven=False)
    assert rules(hosts, replace(rent, bound=8), cost, status=Status.FEASIBLE, ties_proven=False) == set()


def test_the_bound_of_an_objective_is_held_against_what_runs() -> None:
    first = PLANNERS["exhaustive"](in_order("hosts")).change_set
    assert first is not None
    problem = in_order("hosts", units=first.started)
    alone = ComputationUnit("alone.1", "alone", (), (Publication("o", "/t"),), "big")
    changes = problem.environment.change_to([alone])
    hosts, cost = Measured(Objective.HOSTS, 1, 1), Measured(Objective.COST, 99, 99)
    said = plan_violations(problem, Plan("by hand", Status.OPTIMAL, changes, 99, 99, objectives=(hosts, cost)))
    assert [str(violation) for violation in said] == ["the bound of the cost is 99, but what runs has 9"]


def test_what_compares_costs_refuses_another_order_by_name() -> None:
    problem = in_order("hosts")
    ask = PLANNERS["cpsat"]
    for asked in (lambda: alternatives(problem, ask, 2), lambda: horizon_sensitivity(problem, ask)):
        with pytest.raises(InputError, match=r"compare costs, but `minimise` is \[hosts, cost\]"):
            asked()
    with pytest.raises(InputError, match="does not support an order of objectives"):
        PLANNERS["branch-and-bound"](problem)


@pytest.mark.parametrize(
    ("minimise", "label", "decides", "difference"),
    [("hosts", "s", Objective.COST, 88), ("units", "alone", Objective.UNITS, 1), ("cost", "s", Objective.COST, 93)],
)
def test_why_says_which_objective_decides(minimise: str, label: str, decides: Objective, difference: int) -> None:
    problem, ask = in_order(minimise), PLANNERS["cpsat"]
    why = why_transformation(problem, ask, ask(problem), label)
    assert (why.choice, why.decides, why.difference) == (Choice.CHEAPER, decides, difference)


def surviving(units: tuple[ComputationUnit, ...], *library: Transformation) -> Problem:
    return Problem(Environment(units, library, TARGET), MATCHING, 1, survive=Failures.UNITS)


RUNNING = (
    ComputationUnit("a.1", "a", (), (Publication("o", "/t"),)),
    ComputationUnit("b.1", "b"),
)


@BOTH
@pytest.mark.parametrize("pinned", [False, True])
def test_a_running_unit_never_becomes_a_cold_spare(planner: str, pinned: bool) -> None:
    problem = surviving(RUNNING, gives("a", 5, upkeep_us=1), gives("b", 5, upkeep_us=9, standby_us=1, pinned=pinned))
    found = planned(planner, problem)
    assert found.change_set is not None
    if pinned:
        assert (found.change_set, found.cost_us) == (ChangeSet(), 10)
    else:
        assert [(unit.transformation, unit.standby) for unit in found.change_set.started] == [("b", True)]
        assert (found.change_set.stopped, found.cost_us) == (("b.1",), 2)
    put = ChangeSet(rewired=(ComputationUnit("b.1", "b", standby=True),))
    assert Rule.CONSISTENT in {
        broken.rule for broken in plan_violations(problem, Plan("x", Status.FEASIBLE, put, cost_us=2))
    }


@BOTH
def test_conflicts_cover_spares(planner: str) -> None:
    problem = surviving((), gives("a", 5, conflicts=("b",)), gives("b", 50, standby_us=1))
    assert planned(planner, problem).cost_us == 10


@BOTH
def test_to_promote_a_spare_costs_the_labor_of_a_start(planner: str) -> None:
    spare = (ComputationUnit("a.1", "a", standby=True),)
    problem = Problem(Environment(spare, (gives("a", 5, standby_us=1),), TARGET), MATCHING, 1)
    found = planned(planner, problem)
    assert found.change_set is not None
    assert found.cost_us == 5
    assert found.change_set.stopped == ("a.1",)
    assert [unit.standby for unit in found.change_set.started] == [False]


def test_alike_inputs_take_streams_as_they_do_now_else_sorted() -> None:
    inputs = tuple(InputPort(name, "S", distinct="sources") for name in ("a", "b", "c"))
    join = Transformation("join", inputs, (OutputPort("o", "T"),), labor_us=9)
    sources = [Transformation(f"s{n}", (), (OutputPort("o", "S"),), labor_us=n) for n in range(4)]
    problem = Problem(Environment((), (join, *sources), TARGET), Similarity({tag: frozenset({tag}) for tag in "TS"}), 1)
    found = planned("cpsat", problem).change_set
    assert found is not None
    assert found.started[0].feeds == {name: (Stream(f"s{n}.1", "o"),) for n, name in enumerate("abc")}
    now = {"a": "s3.1", "b": "s1.1", "c": "s2.1"}
    wired = tuple(Subscription(port, Stream(unit, "o")) for port, unit in now.items())
    units = (ComputationUnit("join.1", "join", wired, (Publication("o", "/t"),)),)
    there = tuple(ComputationUnit(f"s{n}.1", f"s{n}") for n in (1, 2))
    again = planned("cpsat", replace(problem, environment=replace(problem.environment, units=units + there))).change_set
    assert again is not None
    assert again.rewired[0].feeds == {port: (Stream(unit, "o"),) for port, unit in {**now, "a": "s0.1"}.items()}


SINK = Transformation("sink", (InputPort("i", "T"),), labor_us=3)
WANTED = Target("wanted", run="sink")


@BOTH
def test_a_unit_that_a_target_wants_is_started_with_what_feeds_it(planner: str) -> None:
    problem = Problem(Environment((), (gives("a", 5), gives("b", 4), SINK), (WANTED,)), MATCHING, 1)
    found = planned(planner, problem)
    assert found.change_set is not None
    assert [unit.id for unit in found.change_set.started] == ["b.1", "sink.1"]
    assert (found.cost_us, found.bound_us) == (7, 7)


@BOTH
def test_of_two_running_units_a_target_that_wants_one_keeps_one(planner: str) -> None:
    fed = (Subscription("i", Stream("a.1", "o")),)
    units = (ComputationUnit("a.1", "a"), *(ComputationUnit(f"sink.{n}", "sink", fed) for n in (1, 2)))
    sink = replace(SINK, upkeep_us=1)
    found = planned(planner, Problem(Environment(units, (gives("a", 5), sink), (WANTED,)), MATCHING, 1))
    assert found.change_set is not None
    assert (found.cost_us, len(found.change_set.stopped)) == (1, 1)


@BOTH
def test_a_required_transformation_may_serve_a_unit_that_a_target_wants(planner: str) -> None:
    library = (gives("a", 5), gives("must", 9, required=True), SINK)
    found = planned(planner, Problem(Environment((), library, (WANTED,)), MATCHING, 1))
    assert (found.cost_us, found.unused_required) == (12, ())


@BOTH
def test_a_unit_that_a_target_wants_has_a_spare_where_failures_are_survived(planner: str) -> None:
    sink = replace(SINK, standby_us=1)
    environment = Environment((), (gives("a", 5, standby_us=2), sink), (WANTED,))
    assert planned(planner, Problem(environment, MATCHING, 1, survive=Failures.UNITS)).cost_us == 5 + 2 + 3 + 1


@BOTH
def test_why_a_wanted_unit_can_not_run_is_said(planner: str) -> None:
    found = planned(planner, Problem(Environment((), (SINK,), (WANTED, Target("no", run="none"))), MATCHING, 1))
    assert found.status is Status.INFEASIBLE
    if planner == "cpsat":
        assert found.reasons == {
            "wanted": "target wanted wants a unit of sink, but input i of sink needs T, and no output matches",
            "no": "target no wants a unit of none, but there is no such one",
        }
