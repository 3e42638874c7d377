"""Why a plan uses what it uses: the difference to the next best plan, against the oracle and by example."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import assume, given
from hypothesis import strategies as st
from worlds import examples, oracle_of, problems

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Target,
    Transformation,
)
from cfgplan.explaining import Choice, Why, why_stream, why_transformation, why_unit
from cfgplan.explaining.what_if import without_transformations
from cfgplan.explaining.why_words import forced_by
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem, Status
from cfgplan.unmet import Lack, NeededBy, Reason

many = examples(60)
cpsat = PLANNERS["cpsat"]


def oracle(problem: Problem) -> Plan:
    size = len(problem.environment.units) + len(problem.environment.library)
    return oracle_of(problem) if size < 6 else cpsat(problem)


@many
@given(problems(most=4), st.data())
def test_what_doing_without_a_transformation_costs_is_exact(problem: Problem, data: st.DataObject) -> None:
    plan = oracle(problem)
    assume(plan.change_set)
    assert plan.change_set is not None and plan.cost_us is not None
    used = {unit.transformation for unit in problem.environment.update(plan.change_set).units}
    label = data.draw(st.sampled_from(sorted(t.label for t in problem.environment.library)))
    why = why_transformation(problem, cpsat, plan, label)
    assert bool(why.units) == (label in used)
    if label in used:
        other = oracle(replace(without_transformations(problem, {label}), max_cost_us=None))
        assert (why.choice is Choice.FORCED) == (other.status is Status.INFEASIBLE)
        if other.cost_us is not None:
            assert why.difference_us == other.cost_us - plan.cost_us
            assert (why.difference_us > 0) == (why.choice is Choice.CHEAPER)
    elif why.choice is not Choice.IMPOSSIBLE:
        assert label in why.more
        assert why.choice in (Choice.CHEAPER, Choice.LESS_CHANGE, Choice.TIE)


def source(label: str, tag: str, cost_us: int, **more: bool) -> Transformation:
    return Transformation(label, (), (OutputPort("o", tag),), labor_us=cost_us, **more)  # type: ignore[arg-type]


def asked(*library: Transformation, units: tuple[ComputationUnit, ...] = ()) -> tuple[Problem, Plan]:
    relation = Similarity({tag: frozenset({tag}) for tag in "ABC"})
    problem = Problem(Environment(units, library, (Target("t", "A", "/t"),)), relation, 1)
    return problem, cpsat(problem)


def why(label: str, *library: Transformation) -> Why:
    problem, plan = asked(*library)
    return why_transformation(problem, cpsat, plan, label)


def test_the_only_way_is_forced() -> None:
    found = why("x", source("x", "A", 1))
    assert (found.choice, found.targets, found.units) == (Choice.FORCED, ("t",), ("x.1",))


def test_the_cheaper_way_says_by_how_much_and_so_does_the_dearer_one() -> None:
    library = source("x", "A", 1), source("y", "A", 5)
    for label, more in (("x", "y"), ("y", "y")):
        found = why(label, *library)
        assert (found.choice, found.difference_us, found.more, found.less) == (Choice.CHEAPER, 4, (more,), ("x",))


def test_equally_good_ways_are_a_tie() -> None:
    assert {why(label, source("x", "A", 1), source("y", "A", 1)).choice for label in "xy"} == {Choice.TIE}


def test_what_runs_is_kept_rather_than_replaced_at_the_same_cost() -> None:
    running = ComputationUnit("y.1", "y", (), (Publication("o", "/t"),))
    problem, plan = asked(source("x", "A", 0), source("y", "A", 0), units=(running,))
    assert why_unit(problem, cpsat, plan, "y.1").choice is Choice.LESS_CHANGE


def test_what_is_required_says_what_it_costs() -> None:
    found = why("y", source("x", "A", 1), source("y", "A", 5, required=True))
    assert (found.choice, found.difference_us) == (Choice.DEMANDED, -4)


def test_what_no_target_can_use_is_impossible() -> None:
    found = why("y", source("x", "A", 1), source("y", "B", 5))
    assert (found.choice, found.units) == (Choice.IMPOSSIBLE, ())


def test_what_could_feed_a_pinned_unit_says_what_that_costs() -> None:
    log = Transformation("log", (InputPort("i", "B"),), (OutputPort("o", "C"),), pinned=True)
    library = log, source("x", "B", 1), source("y", "B", 5), source("z", "A", 1)
    problem, plan = asked(*library, units=(ComputationUnit("log.1", "log"),))
    found = why_transformation(problem, cpsat, plan, "y")
    assert (found.choice, found.difference_us, found.more, found.less) == (Choice.CHEAPER, 4, ("y",), ("x",))


def test_a_stream_is_told_by_who_reads_it() -> None:
    relay = Transformation("relay", (InputPort("in", "B"),), (OutputPort("o", "A"),))
    problem, plan = asked(Transformation("x", (), (OutputPort("b", "B"), OutputPort("c", "C"))), relay)
    found = why_stream(problem, cpsat, plan, "x", "b")
    assert (found.choice, found.consumers, found.targets) == (Choice.FORCED, ("relay.1/in",), ("t",))
    assert why_stream(problem, cpsat, plan, "x", "c").choice is Choice.UNREAD


def test_an_input_that_takes_two_streams_of_a_transformation_is_told_once() -> None:
    twice = Transformation("twice", (InputPort("in", "B", count=2),), (OutputPort("o", "A"),))
    problem, plan = asked(source("x", "B", 1), twice)
    assert why_transformation(problem, cpsat, plan, "x").consumers == ("twice.1/in",)


def test_what_others_run_with_serves_their_targets() -> None:
    web = Transformation("web", (), (OutputPort("page", "Page"),), labor_us=1, beside=("kernel",))
    environment = Environment((), (web, Transformation("kernel")), (Target("t", "Page", "/t"),))
    problem = Problem(environment, Similarity({"Page": frozenset({"Page"})}), 1)
    why = why_transformation(problem, cpsat, cpsat(problem), "kernel")
    assert (why.units, why.targets, why.choice) == (("kernel.1",), ("t",), Choice.FORCED)


def test_what_a_target_wants_to_run_serves_it_and_so_does_what_feeds_it() -> None:
    library = source("camera", "A", 1), Transformation("screen", (InputPort("i", "A"),))
    problem = Problem(Environment((), library, (Target("t", run="screen"),)), Similarity({"A": frozenset("A")}), 1)
    plan = cpsat(problem)
    for label in ("camera", "screen"):
        found = why_transformation(problem, cpsat, plan, label)
        assert (found.units, found.targets, found.choice) == ((f"{label}.1",), ("t",), Choice.FORCED)


def test_a_brief_answer_names_the_target_unless_an_input_is_unfed_and_no_other_target_is_served() -> None:
    unfed = Lack("no output matches", "A", NeededBy("screen", "in"))
    unmet = Plan("own", Status.INFEASIBLE, reasons={"b": Reason(unfed, "b", "B")})
    why = Why("camera.1", ("camera.1",), ("b",), (), Choice.FORCED, unmet)
    whole = "without it, target b wants B, but input in of screen needs A, and no output matches"
    assert forced_by(why) == whole
    assert forced_by(why, is_brief=True) == "without it, input in of screen needs A, and no output matches"
    assert forced_by(replace(why, targets=("b", "c")), is_brief=True) == whole
    assert forced_by(replace(why, targets=()), is_brief=True) == whole
    direct = replace(unmet, reasons={"b": Reason(Lack("no output matches"), "b", "B")})
    whole = "without it, target b wants B, but no output matches"
    assert forced_by(replace(why, otherwise=direct), is_brief=True) == whole, "`no output matches` would say too little"
