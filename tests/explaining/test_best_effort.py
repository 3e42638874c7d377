"""Best effort against the oracle asked for every set of targets.

`CFGPLAN_EXAMPLES=5000 pytest tests/explaining` runs the long version.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from worlds import TAGS, examples, oracle_of, problems

from cfgplan.domain import Environment, OutputPort, Similarity, Target, Transformation
from cfgplan.explaining import BestEffort, best_effort
from cfgplan.explaining.what_if import only_targets
from cfgplan.planners import PLANNERS
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planning import Plan, Problem, Status
from cfgplan.qualities import Better, QualityAttribute, Wish
from cfgplan.reasons import unmet_reasons
from cfgplan.unmet import shared_reasons
from cfgplan.validity import plan_violations

many = examples(100)
oracle, cpsat = oracle_of, PLANNERS["cpsat"]


@st.composite
def crowded(draw: st.DrawFn, *, special: bool) -> Problem:
    """A problem with up to four targets of several priorities, and a largest cost that may be too small."""
    problem = draw(problems(most=3 if special else 5, special=special))
    count = draw(st.integers(2, 4))
    targets = [Target(f"q{i}", draw(st.sampled_from(TAGS)), f"/{i}", draw(st.integers(0, 2))) for i in range(count)]
    environment = replace(problem.environment, targets=tuple(targets))
    return replace(problem, environment=environment, max_cost_us=draw(st.one_of(st.none(), st.integers(0, 25))))


def quality(problem: Problem, plan: Plan) -> tuple[object, ...]:
    """How good a plan of some of the targets is, the least is best."""
    assert plan.change_set is not None
    count = Counter(target.priority for target in problem.environment.targets)
    unmet = tuple(-count[priority] for priority in (2, 1, 0))
    changes = plan.change_set
    return unmet, len(plan.unused_required), plan.cost_us, len(changes.rewired), len(changes.started)


def best_of_all_sets(problem: Problem) -> tuple[object, ...] | None:
    """The quality of the best set of targets that the oracle can meet."""
    targets = problem.environment.targets
    found = []
    for size in range(len(targets) + 1):
        for chosen in combinations(targets, size):
            reduced = only_targets(problem, {target.label for target in chosen})
            plan = oracle(reduced)
            if plan.change_set is not None:
                found.append(quality(reduced, plan))
    return min(found, default=None)


def agree(problem: Problem) -> None:
    found = best_effort(problem, cpsat)
    assert found.exact
    assert plan_violations(found.problem, found.plan) == []
    met = {target.label for target in found.problem.environment.targets}
    assert met.isdisjoint(found.unmet)
    assert met.union(found.unmet) == {target.label for target in problem.environment.targets}
    best = best_of_all_sets(problem)
    assert best == (None if found.plan.change_set is None else quality(found.problem, found.plan))


@many
@given(crowded(special=False))
def test_no_set_of_targets_that_can_be_met_is_better_or_cheaper(problem: Problem) -> None:
    agree(problem)


@many
@given(crowded(special=True))
def test_nor_with_pinned_required_distinct_and_feedback(problem: Problem) -> None:
    agree(problem)


def offering(*costs: int, priorities: tuple[int, ...] = ()) -> Problem:
    """A target and a transformation of its own for each cost."""
    names = "abcdefgh"[: len(costs)]
    library = [Transformation(n, (), (OutputPort("o", n),), labor_us=c) for n, c in zip(names, costs, strict=True)]
    targets = [Target(n, n, f"/{n}", p) for n, p in zip(names, priorities or (0,) * len(names), strict=True)]
    relation = Similarity({name: frozenset({name}) for name in (*names, "z")})
    return Problem(Environment((), tuple(library), tuple(targets)), relation, 10)


def met(found: BestEffort) -> str:
    return "".join(target.label for target in found.problem.environment.targets)


def test_one_important_target_outweighs_any_number_of_others() -> None:
    problem = replace(offering(9, 1, 1, 1, priorities=(1, 0, 0, 0)), max_cost_us=9)
    assert met(best_effort(problem, cpsat)) == "a"
    assert met(best_effort(replace(problem, max_cost_us=8), cpsat)) == "bcd"


def test_of_equally_many_targets_the_cheapest_are_met() -> None:
    found = best_effort(replace(offering(5, 2, 3, 4), max_cost_us=8), cpsat)
    assert met(found) == "bc"
    assert found.plan.cost_us == 5


def test_a_target_given_up_says_what_it_would_have_cost() -> None:
    problem = replace(offering(5_000_000, 2_000_000, 30_000_000), max_cost_us=6_000_000)
    reasons = best_effort(problem, cpsat).plan.reasons
    assert reasons["a"].endswith("with the targets that are met it would cost 7 s, and 6 s is allowed")
    assert reasons["c"].endswith("by itself it would cost 30 s, and 6 s is allowed")


def test_what_nothing_offers_takes_down_no_other_target_and_costs_one_call_of_the_planner() -> None:
    problem = offering(5, 2)
    targets = (*problem.environment.targets, Target("z", "z", "/z", 9))
    problem = replace(problem, environment=replace(problem.environment, targets=targets))
    asked: list[Problem] = []
    session = PlannerSession()

    def planner(problem: Problem, **_: object) -> Plan:
        asked.append(problem)
        return session.plan(problem)

    found = best_effort(problem, planner)
    assert (met(found), found.unmet) == ("ab", ("z",))
    assert "no output matches" in found.plan.reasons["z"]
    assert best_effort(problem, planner) == found
    assert len(asked) == 2
    assert asked[0] == asked[1]


def hurried(problem: Problem, *, time_limit_s: float | None = None, **more: Any) -> Plan:
    """Plan with what runs alone if there is no time."""
    if time_limit_s != 0:
        return cpsat(problem, **more)
    environment = problem.environment
    labels = {unit.transformation for unit in environment.units}
    library = tuple(t for t in environment.library if t.label in labels)
    found = cpsat(replace(problem, environment=replace(environment, library=library)))
    return replace(found, status=Status.UNKNOWN if found.change_set is None else Status.FEASIBLE, bound_us=0)


def test_a_planner_without_time_gives_no_answer_and_no_proof() -> None:
    found = best_effort(offering(5, 2), hurried, time_limit_s=0)
    assert (found.exact, found.plan.status) == (False, Status.UNKNOWN)


def test_without_time_targets_that_are_met_and_required_transformations_that_are_used_are_not_given_up() -> None:
    problem = offering(5, 2)
    library = tuple(replace(t, required=True) for t in problem.environment.library)
    problem = replace(problem, environment=replace(problem.environment, library=library))
    one = best_effort(only_targets(problem, {"a"}), cpsat)
    assert one.plan.change_set is not None
    problem = replace(problem, environment=problem.environment.update(one.plan.change_set))
    problem = replace(problem, environment=replace(problem.environment, targets=offering(5, 2).environment.targets))
    found = best_effort(problem, hurried, time_limit_s=0)
    assert met(found) == "a"
    assert not found.exact
    assert not found.plan.change_set
    assert "time ran out" in found.plan.reasons["b"]


def test_without_time_few_questions_find_what_runs_of_many_targets() -> None:
    labels = [f"t{number}" for number in range(64)]
    library = tuple(Transformation(label, outputs=(OutputPort("out", label),)) for label in labels)
    targets = tuple(Target(label, label, f"/{label}") for label in labels)
    similarity = Similarity({label: frozenset({label}) for label in labels})
    problem = Problem(Environment((), library, targets), similarity, 1)
    running = problem.after(cpsat(problem)).units
    asked: list[Problem] = []

    def planner(problem: Problem, **more: Any) -> Plan:
        asked.append(problem)
        return hurried(problem, **more)

    found = best_effort(problem.with_parts(units=running[1:]), planner, time_limit_s=0)
    assert (len(found.problem.environment.targets), len(asked) < 20) == (63, True)


@many
@given(crowded(special=True))
def test_who_knows_already_what_is_impossible_gets_the_same_answer(problem: Problem) -> None:
    known = best_effort(problem, cpsat, impossible=unmet_reasons(problem))
    found = best_effort(problem, cpsat)
    assert (known.plan, known.problem, known.exact) == (found.plan, found.problem, found.exact)


def test_targets_that_can_not_be_met_by_themselves_share_their_own_reason() -> None:
    """Each was told in a line that named it twice: `target a wants B, but by itself it can't be met: target a ...`."""
    delay = QualityAttribute("delay", Better.LOWER, worst=1_000_000)
    wish = (Wish("delay", bound=300_000),)
    targets = tuple(Target(label, "A", f"/{label}", quality=wish) for label in "ab")
    library = (Transformation("camera", outputs=(OutputPort("x", "A"),)),)
    environment = Environment((), library, targets, qualities=(delay,))
    found = best_effort(Problem(environment, Similarity({"A": frozenset("A")}), 1), cpsat)
    (told,) = shared_reasons(found.given_up)
    assert told.text == "targets a, b ask for delay of at most 0.3, but the best that any wiring reaches is 1"


def test_a_planner_that_gives_no_reason_leaves_its_target_with_one() -> None:
    def silent(problem: Problem, **how: Any) -> Plan:
        return replace(cpsat(problem, **how), reasons={})

    delay = QualityAttribute("delay", Better.LOWER, worst=1_000_000)
    target = Target("a", "A", "/a", quality=(Wish("delay", bound=300_000),))
    library = (Transformation("camera", outputs=(OutputPort("x", "A"),)),)
    environment = Environment((), library, (target,), qualities=(delay,))
    found = best_effort(Problem(environment, Similarity({"A": frozenset("A")}), 1), silent)
    assert found.given_up == {"a": "target a wants A, but by itself it can't be met"}
