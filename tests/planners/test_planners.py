"""Facts about single worlds that every planner, or one of them, must get right."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from threading import Event
from typing import Any

import pytest

from cfgplan.domain import (
    ALL,
    ChangeSet,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS, exhaustive
from cfgplan.planners.cpsat import plan as cpsat_plan
from cfgplan.planning import Failures, Planner, Problem, Progress, Status
from cfgplan.validity import plan_violations

every_planner = pytest.mark.parametrize("planner", PLANNERS.values(), ids=list(PLANNERS))
every_exact_planner = pytest.mark.parametrize(
    "planner",
    [planner for name, planner in PLANNERS.items() if not name.startswith("branch-and-bound")],
    ids=["cpsat", "exhaustive"],
)


def make(label: str, needs: str = "", gives: str = "", labor: int = 1, upkeep: int = 0, **more: int) -> Transformation:
    """A transformation with one input for each letter of `needs` and one output for each of `gives`."""
    inputs = tuple(InputPort(f"in{i}", tag) for i, tag in enumerate(needs))
    outputs = tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(gives))
    return Transformation(label, inputs, outputs, labor_us=labor, upkeep_us=upkeep, **more)


def unit(label: str, *feeds: str, topics: dict[str, str] | None = None, number: int = 1) -> ComputationUnit:
    subscriptions = tuple(Subscription(f"in{i}", Stream.parse(feed)) for i, feed in enumerate(feeds) if feed)
    publications = tuple(Publication(port, topic) for topic, port in (topics or {}).items())
    return ComputationUnit(f"{label}.{number}", label, subscriptions, publications)


def world(
    wanted: str, *library: Transformation, units: tuple[ComputationUnit, ...] = (), max_cost: int | None = None
) -> Problem:
    """Targets for the letters of `wanted`, published on the topic of the same letter; each tag matches itself."""
    targets = tuple(Target(tag, tag, f"/{tag}") for tag in wanted)
    similarity = Similarity({tag: frozenset(tag) for tag in "ABCDEFG"})
    return Problem(Environment(units, library, targets), similarity, horizon_s=10, max_cost_us=max_cost)


@every_planner
def test_a_reused_unit_costs_no_labor(planner: Planner) -> None:
    source = make("source", gives="A", labor=7, upkeep=2)
    plan = planner(world("A", source, units=(unit("source", topics={"/A": "out0"}),)))
    assert plan.cost_us == 20
    assert not plan.change_set


@every_planner
def test_a_gap_is_closed_by_rewiring_not_by_a_new_unit(planner: Planner) -> None:
    problem = world(
        "B",
        make("source", gives="A"),
        make("filter", "A", "B"),
        units=(unit("filter", "source.1/out0", topics={"/B": "out0"}),),
    )
    plan = planner(problem)
    assert plan.change_set is not None
    assert [started.id for started in plan.change_set.started] == ["source.2"]
    assert [rewired.id for rewired in plan.change_set.rewired] == ["filter.1"]
    assert plan_violations(problem, plan) == []


@every_planner
def test_an_input_that_has_two_streams_is_left_with_one(planner: Planner) -> None:
    left, right = make("left", gives="A"), make("right", gives="A", upkeep=1)
    both = (Subscription("in0", Stream("left.1", "out0")), Subscription("in0", Stream("right.1", "out0")))
    sink = replace(unit("sink", topics={"/B": "out0"}), subscriptions=both)
    problem = world("B", left, right, make("sink", "A", "B"), units=(unit("left"), unit("right"), sink))
    plan = planner(problem)
    assert plan_violations(problem, plan) == []
    assert problem.after(plan).unit["sink.1"].feeds == {"in0": (Stream("left.1", "out0"),)}


@every_planner
def test_a_unit_whose_transformation_left_is_stopped(planner: Planner) -> None:
    old = unit("old", topics={"/A": "out0"})
    plan = planner(world("A", make("source", gives="A"), units=(old,)))
    assert plan.change_set is not None
    assert plan.change_set.stopped == ("old.1",)


@every_planner
def test_units_that_only_feed_each_other_are_no_plan(planner: Planner) -> None:
    plan = planner(world("A", make("left", "B", "A"), make("right", "A", "B")))
    assert plan.status is Status.INFEASIBLE
    assert set(plan.reasons) == {"A"}


@every_planner
def test_only_the_targets_that_cannot_be_met_have_reasons(planner: Planner) -> None:
    plan = planner(world("AB", make("source", gives="A")))
    assert plan.status is Status.INFEASIBLE
    assert set(plan.reasons) == {"B"}


@every_planner
def test_without_targets_everything_is_stopped(planner: Planner) -> None:
    plan = planner(world("", make("source", gives="A"), units=(unit("source"),)))
    assert plan.change_set is not None
    assert plan.change_set.stopped == ("source.1",)
    assert plan.cost_us == 0


@every_planner
def test_a_pinned_unit_is_kept_with_what_feeds_it(planner: Planner) -> None:
    problem = world(
        "B",
        make("source", gives="A"),
        make("logger", "A", "G", pinned=True),
        make("other", gives="B"),
        units=(unit("logger"),),
    )
    plan = planner(problem)
    assert plan.change_set is not None
    assert [started.transformation for started in plan.change_set.started] == ["other", "source"]
    assert plan_violations(problem, plan) == []


@every_planner
def test_a_unit_may_feed_its_own_feedback_input(planner: Planner) -> None:
    tracker = Transformation(
        "tracker", (InputPort("old", "B", feedback=True), InputPort("new", "A")), (OutputPort("out", "B"),), labor_us=1
    )
    problem = world("B", make("source", gives="A"), tracker)
    plan = planner(problem)
    assert plan.cost_us == 2
    assert plan_violations(problem, plan) == []


@every_planner
def test_one_stream_meets_two_targets_on_both_topics(planner: Planner) -> None:
    source = make("source", gives="A")
    targets = (Target("one", "A", "/one"), Target("two", "A", "/two"))
    plan = planner(Problem(Environment((), (source,), targets), Similarity({"A": frozenset("A")}), 10))
    assert plan.change_set is not None
    (started,) = plan.change_set.started
    assert [publication.topic for publication in started.publications] == ["/one", "/two"]


@every_exact_planner
def test_a_shared_transformation_beats_dedicated_ones_that_are_cheaper_alone(planner: Planner) -> None:
    problem = world("AB", make("A_only", gives="A", labor=3), make("both", gives="AB", labor=4))
    assert planner(problem).cost_us == 4
    assert PLANNERS["branch-and-bound"](problem).cost_us == 7


@every_exact_planner
def test_sharing_below_one_target_counts_too(planner: Planner) -> None:
    library = (
        make("join", "AB", "C", labor=1),
        make("A_only", gives="A", labor=3),
        make("B_only", gives="B", labor=4),
        make("both", gives="AB", labor=4),
    )
    problem = world("C", *library)
    assert planner(problem).cost_us == 5
    assert PLANNERS["branch-and-bound"](problem).cost_us == 8


@every_exact_planner
def test_more_than_the_largest_cost_is_said_to_be_too_expensive_with_the_cost(planner: Planner) -> None:
    plan = planner(world("A", make("source", gives="A", labor=7), max_cost=6))
    assert (plan.status, plan.cost_us, plan.change_set) == (Status.TOO_EXPENSIVE, 7, None)


@every_exact_planner
def test_exactly_the_largest_cost_is_allowed(planner: Planner) -> None:
    assert planner(world("A", make("source", gives="A", labor=7), max_cost=7)).status is Status.OPTIMAL


@every_exact_planner
def test_distinct_inputs_are_fed_by_different_transformations(planner: Planner) -> None:
    fusion = Transformation(
        "fusion",
        (InputPort("left", "A", distinct="sources"), InputPort("right", "A", distinct="sources")),
        (OutputPort("out", "B"),),
        labor_us=0,
    )
    detectors = (make("cheap", gives="A", labor=1), make("dear", gives="A", labor=9))
    assert planner(world("B", fusion, *detectors)).cost_us == 10
    assert planner(world("B", fusion, detectors[0])).status is Status.INFEASIBLE


@every_exact_planner
def test_a_required_transformation_is_used_though_it_costs_more(planner: Planner) -> None:
    library = (make("plain", gives="B"), make("source", gives="A"), make("fusion", "A", "B", labor=9, required=True))
    problem = world("B", *library)
    plan = planner(problem)
    assert plan.cost_us == 10
    assert plan.unused_required == ()
    assert plan_violations(problem, plan) == []


@every_exact_planner
def test_a_required_transformation_that_cannot_be_used_is_named(planner: Planner) -> None:
    plan = planner(world("B", make("plain", gives="B"), make("fusion", "A", "B", required=True)))
    assert (plan.status, plan.unused_required) == (Status.OPTIMAL, ("fusion",))


@every_exact_planner
def test_among_equal_costs_no_kept_unit_is_rewired(planner: Planner) -> None:
    sources = (make("a_source", gives="A", labor=0), make("z_source", gives="A", labor=0))
    kept = (unit("z_source"), unit("filter", "z_source.1/out0", topics={"/B": "out0"}))
    assert not planner(world("B", *sources, make("filter", "A", "B"), units=kept)).change_set


@every_exact_planner
def test_zero_costs_start_nothing_that_is_not_needed(planner: Planner) -> None:
    free = [make(f"free{i}", gives="A", labor=0) for i in range(4)]
    plan = planner(world("A", *free))
    assert plan.change_set is not None
    assert len(plan.change_set.started) == 1


def test_branch_and_bound_says_unknown_instead_of_giving_out_an_invalid_plan() -> None:
    fusion = Transformation(
        "fusion",
        (InputPort("left", "A", distinct="sources"), InputPort("right", "A", distinct="sources")),
        (OutputPort("out", "B"),),
    )
    plan = PLANNERS["branch-and-bound"](world("B", fusion, make("one", gives="A"), make("two", gives="A")))
    assert (plan.status, plan.change_set) == (Status.UNKNOWN, None)
    assert "must differ" in plan.reasons["B"]


@every_planner
def test_what_is_required_comes_before_the_largest_cost(planner: Planner) -> None:
    library = (make("free", gives="A", labor=0), make("wanted", gives="A", labor=5, required=True))
    assert planner(world("A", *library, max_cost=4)).status in (Status.TOO_EXPENSIVE, Status.UNKNOWN)
    assert planner(world("A", *library, max_cost=5)).status in (Status.OPTIMAL, Status.UNKNOWN)
    free = planner(world("A", *library))
    assert (free.status is Status.OPTIMAL) == free.required_proven == (free.cost_us == 5)


def test_the_oracle_refuses_what_it_cannot_try(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="too many"):
        PLANNERS["exhaustive"](world("A", *(make(f"t{i}", gives="A") for i in range(19))))
    monkeypatch.setattr(exhaustive, "MOST_STEPS", 1000)
    wide = [make(f"f{i}", "A" * 3, "A") for i in range(5)]
    with pytest.raises(InputError, match="steps were too few"):
        PLANNERS["exhaustive"](world("A", make("s", gives="A"), make("r", gives="D", required=True), *wide))


def test_the_oracle_keeps_a_time_limit_before_it_wires_anything() -> None:
    problem, began = world("A", *(make(f"t{i}", gives="A") for i in range(17))), time.process_time()
    assert PLANNERS["exhaustive"](problem, time_limit_s=0.2).status is Status.UNKNOWN
    assert time.process_time() - began < 3  # the sets of units alone take 12 s


@every_planner
def test_no_time_at_all_gives_an_honest_answer(planner: Planner) -> None:
    problem = world("B", *(make(f"s{i}", gives="A", labor=i) for i in range(4)), make("filter", "A", "B"))
    plan = planner(problem, time_limit_s=0)
    assert plan.status in (Status.UNKNOWN, Status.FEASIBLE, Status.OPTIMAL)
    assert plan_violations(problem, plan) == []


@every_exact_planner
def test_progress_is_reported_with_ever_better_costs(planner: Planner) -> None:
    seen: list[Progress] = []
    problem = world("C", *(make(f"s{i}", gives="A", labor=9 - i) for i in range(4)), make("f", "A", "C", labor=2))
    plan = planner(problem, report=seen.append)
    costs = [progress.cost_us for progress in seen if progress.cost_us is not None]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == plan.cost_us == 8


def test_the_registry_imports_no_solver() -> None:
    code = "import cfgplan.planners, sys; sys.exit(any(m in sys.modules for m in ('ortools', 'numpy', 'scipy')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_plan_stopped_before_it_is_known_whether_all_required_can_be_used_claims_no_bound() -> None:
    library = (
        Transformation("source", (), (OutputPort("o", "A"),), labor_us=1),
        Transformation("wanted", (InputPort("i", "A"),), (OutputPort("o", "B"),), labor_us=9, required=True),
        Transformation("sink", (InputPort("i", "B"),), (OutputPort("o", "A"),), labor_us=9),
    )
    similarity = Similarity({tag: frozenset({tag}) for tag in "AB"})
    problem = Problem(Environment((), library, (Target("q", "A", "/q"),)), similarity, 1, max_cost_us=5)
    stop = Event()
    stop.set()
    stopped = cpsat_plan(problem, stop=stop)
    assert stopped.bound_us == 0
    assert stopped.status is not Status.TOO_EXPENSIVE
    assert cpsat_plan(problem).status is Status.TOO_EXPENSIVE
    assert cpsat_plan(problem).cost_us == 19


def test_what_nothing_needs_takes_no_place_from_an_input_that_starts_nothing() -> None:
    sink = Transformation(
        "sink", (InputPort("a", "B", optional=True), InputPort("b", "D")), (), labor_us=5, min_instances=1
    )
    source = Transformation("source", (), (OutputPort("x", "D"), OutputPort("y", "B", serves=2)))
    units = (
        ComputationUnit("sink.2", "sink", (Subscription("b", Stream("source.1", "x")),)),
        ComputationUnit("source.1", "source", (), (Publication("x", "/q"),)),
    )
    environment = Environment(units, (sink, source), (Target("q", "B", "/q"),))
    problem = Problem(environment, Similarity({tag: frozenset({tag}) for tag in "BD"}), 0)
    plan = cpsat_plan(problem)
    assert plan_violations(problem, plan) == []
    assert problem.after(plan).unit["sink.2"].feeds["a"]


def test_it_is_said_which_input_lacks_streams_of_different_units() -> None:
    source = make("source", gives="A", max_instances=1)
    sink = replace(make("sink", "A", "B"), inputs=(InputPort("in0", "A", count=2),))
    plan = cpsat_plan(world("B", source, sink))
    assert plan.status is Status.INFEASIBLE
    assert plan.reasons["B"] == (
        "target B would have no stream: input in0 of sink needs 2 streams of different units; "
        "only source/out0 can feed it, 1 in all"
    )


def test_it_is_said_which_inputs_take_more_streams_than_outputs_serve() -> None:
    source = replace(make("source"), outputs=(OutputPort("out0", "A", serves=2),))
    between = replace(make("between", "A", "B"), inputs=(InputPort("in0", "A", count=2),))
    sink = replace(make("sink", "B", "C"), inputs=(InputPort("in0", "B", count=3),))
    found = cpsat_plan(world("C", source, between, sink))
    assert found.reasons["C"].endswith(
        "together: 3 x between take 6 streams as in0, but 2 x source (serves 2) give 4 at most; "
        "max_instances may allow more"
    )
    more = cpsat_plan(world("C", replace(source, max_instances=3), between, sink))
    assert more.status is Status.OPTIMAL


def test_a_unit_that_runs_is_one_of_those_that_its_transformation_allows() -> None:
    source = replace(make("source", max_instances=1), outputs=(OutputPort("out0", "A", serves=1),))
    running = (ComputationUnit("source.1", "source"),)
    found = cpsat_plan(world("BC", source, make("one", "A", "B"), make("other", "A", "C"), units=running))
    assert "but 1 x source (serves 1) give 1 at most" in found.reasons["B"]


def test_a_unit_that_takes_all_streams_is_rewired_when_one_comes() -> None:
    logger = Transformation("logger", (InputPort("alarms", "A", count=ALL),), (), labor_us=1)
    units = (
        ComputationUnit("fire.1", "fire", (), (Publication("out0", "/f"),)),
        ComputationUnit("logger.1", "logger", (Subscription("alarms", Stream("fire.1", "out0")),)),
    )
    targets = (Target("f", "F", "/f"), Target("w", "W", "/w"), Target("log", run="logger"))
    environment = Environment(units, (make("fire", gives="F"), make("water", gives="W"), logger), targets)
    pairs = {"A": frozenset("FW"), "F": frozenset("F"), "W": frozenset("W")}
    plan = cpsat_plan(Problem(environment, Similarity(pairs), 0))
    assert plan.status is Status.OPTIMAL
    assert plan.change_set is not None
    assert [unit.id for unit in plan.change_set.rewired] == ["logger.1"]


def test_a_count_starts_as_many_units_as_it_takes() -> None:
    sink = replace(make("sink", "A", "B"), inputs=(InputPort("in0", "A", count=3),))
    problem = world("B", make("source", gives="A"), sink)
    plan = cpsat_plan(problem)
    assert plan_violations(problem, plan) == []
    assert [stream.unit for stream in problem.after(plan).unit["sink.1"].feeds["in0"]] == [
        "source.1",
        "source.2",
        "source.3",
    ]


def backends(**said: Any) -> Problem:
    """A balancer of two backends, each of which asks a database; every unit may fail."""
    database = Transformation(
        "database", (), (OutputPort("rows", "A", **said),), labor_us=9, upkeep_us=9, max_instances=3
    )
    balancer = replace(make("balancer", "B", "C", upkeep=3), inputs=(InputPort("pages", "B", count=2),))
    library = (replace(t, standby_us=1) for t in (database, make("backend", "A", "B", labor=5, upkeep=3), balancer))
    return replace(world("C", *library), survive=Failures.UNITS)


@pytest.mark.parametrize(("said", "databases"), [({}, (1, 1)), ({"serves": 2}, (1, 1)), ({"serves": 1}, (2, 1))])
def test_after_a_failure_as_many_streams_are_there_as_inputs_take(
    said: dict[str, Any], databases: tuple[int, int]
) -> None:
    problem = backends(**said)
    plan = cpsat_plan(problem)
    assert plan.status is Status.OPTIMAL
    assert plan_violations(problem, plan) == []
    there = problem.after(plan).units
    numbers = {
        label: tuple(sum((u.transformation, u.standby) == (label, waits) for u in there) for waits in (False, True))
        for label in ("database", "backend", "balancer")
    }
    assert numbers == {"database": databases, "backend": (2, 1), "balancer": (1, 1)}


def test_it_is_said_after_which_failure_there_are_too_few_units_for_an_input() -> None:
    problem = backends()
    two = tuple(replace(t, max_instances=2) if t.label == "backend" else t for t in problem.environment.library)
    found = cpsat_plan(problem.with_parts(library=two))
    assert found.status is Status.INFEASIBLE
    assert found.reasons == {"C": "target C would have no stream if one of 2 units of backend fails"}


def test_an_input_that_starts_nothing_is_fed_by_a_unit_that_runs_for_a_failure_and_by_no_other() -> None:
    one, other = make("one", gives="A", upkeep=0), make("other", gives="A", upkeep=0)
    screen = replace(make("screen", "A", "D"), inputs=(InputPort("in0", "A", optional=True),))
    runs = (
        unit("one", topics={"/A": "out0"}),
        unit("other"),
        unit("screen", "other.1/out0", topics={"/D": "out0"}),
        unit("screen", "other.1/out0", number=2),
    )
    problem = world("AD", one, other, screen, units=runs)
    fragile, firm = cpsat_plan(problem), cpsat_plan(replace(problem, survive=Failures.UNITS))
    assert fragile.change_set is not None
    assert fragile.change_set.stopped in (("one.1", "screen.2"), ("other.1", "screen.2"))
    assert len(fragile.change_set.rewired) == 1
    assert (firm.status, firm.change_set) == (Status.OPTIMAL, ChangeSet())


def test_of_two_units_that_may_be_the_spare_one_runs_though_both_feed_inputs_that_start_nothing() -> None:
    sources = [make(label, gives="A", labor=9) for label in ("one", "other", "third")]
    screens = [replace(make(f"screen_{tag}", "A", tag), inputs=(InputPort("in0", "A", optional=True),)) for tag in "DE"]
    firm = [replace(screen, outputs=(*screen.outputs, OutputPort("more", "F"))) for screen in screens]
    runs = (
        unit("one", topics={"/A": "out0"}),
        unit("other"),
        unit("third"),
        unit("screen_D", "other.1/out0", topics={"/F": "more"}),
        unit("screen_E", "third.1/out0"),
    )
    problem = replace(world("AF", *sources, *firm, units=runs), survive=Failures.UNITS)
    plan = cpsat_plan(problem)
    assert (plan_violations(problem, plan), plan.status) == ([], Status.OPTIMAL)
    assert plan.change_set is not None
    assert (len(plan.change_set.rewired), len(plan.change_set.stopped)) == (1, 1)
