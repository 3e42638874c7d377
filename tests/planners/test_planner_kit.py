"""The conformance kit for planners catches each of these broken ones, and finds nothing wrong with the registered ones.

A mutant is a planner that is right but for one thing. Yours is checked in the same way: `check_planner(plan)`.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest
from test_code_blocks import blocks_of
from worlds import few_steps

from cfgplan.domain import ChangeSet, Stream, Subscription
from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS, exhaustive
from cfgplan.planning import Feature, OnProgress, Plan, Planner, Problem, Progress, Status, refuse_features
from cfgplan.testing import Promise, check_planner, drawn_problem, examine_planner

MANUAL = Path(__file__).parents[2] / "cfgplan" / "manual"
EVERY_FEATURE = tuple(Feature)


@pytest.fixture(scope="module", autouse=True)
def asked_once() -> Iterator[None]:
    """The oracle answers each problem once: most checks of this module draw the same ones."""
    ask, known = exhaustive.plan, dict[Problem, tuple[Plan | InputError, list[Progress]]]()

    def remembered(problem: Problem, *, time_limit_s: float | None = None, report: OnProgress | None = None) -> Plan:
        if time_limit_s is not None:
            return ask(problem, time_limit_s=time_limit_s, report=report)
        if problem not in known:
            told: list[Progress] = []
            try:
                known[replace(problem)] = ask(problem, report=told.append), told
            except InputError as error:
                known[replace(problem)] = error, told
        found, told = known[problem]
        for progress in told if report is not None else ():
            report(progress)
        if isinstance(found, InputError):
            raise found
        return found

    with pytest.MonkeyPatch.context() as patch, few_steps():
        patch.setattr(exhaustive, "plan", remembered)
        yield


def right(problem: Problem, time_limit_s: float | None = None, report: Any = None) -> Plan:
    """The oracle, that gives up what it can't enumerate."""
    try:
        return exhaustive.plan(problem, time_limit_s=time_limit_s, report=report)
    except InputError:
        return Plan("right", Status.UNKNOWN)


def mutant(change: Callable[[Problem, Plan], Any], *, of: str = "has a plan") -> Planner:
    """The oracle with another answer where it `of` its own answer."""

    def plan(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
        found = right(problem, time_limit_s, report)
        applies = {"has a plan": found.change_set is not None, "has none": found.change_set is None, "any": True}
        return change(problem, found) if applies[of] else found  # type: ignore[no-any-return]

    return plan


def told_anew(problem: Problem, found: Plan, **parts: Any) -> Plan:
    """The plan with another change set, and the true cost of that."""
    from cfgplan.validity import unused_required
    from cfgplan.validity.plans import cost_us

    changes = ChangeSet(**{**vars(found.change_set), **parts})
    after = problem.environment.update(changes)
    cost = cost_us(problem, after)
    return replace(found, change_set=changes, cost_us=cost, unused_required=unused_required(after))


def too_dear(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    """The optimum of the problem without its cheapest transformation, as if it were that of the problem."""
    found = right(problem, time_limit_s, report)
    used = {unit.transformation for unit in found.change_set.started} if found.change_set is not None else set()
    for label in sorted(used):
        library = tuple(t for t in problem.environment.library if t.label != label)
        other = right(problem.with_parts(library=library), time_limit_s)
        if other.status is Status.OPTIMAL and other.change_set is not None:
            return told_anew(problem, replace(other, bound_us=other.cost_us or 0))
    return found


def without_wire(problem: Problem, found: Plan) -> Plan:
    """A new unit with an input that is fed by nothing."""
    assert found.change_set is not None
    started = tuple(replace(unit, subscriptions=()) for unit in found.change_set.started)
    return told_anew(problem, found, started=started)


def of_an_unknown_unit(problem: Problem, found: Plan) -> Plan:
    """New units that are fed by a unit that is not there."""
    assert found.change_set is not None
    started = tuple(
        replace(unit, subscriptions=tuple(Subscription(s.port, Stream("nobody.1", "x")) for s in unit.subscriptions))
        for unit in found.change_set.started
    )
    return told_anew(problem, found, started=started)


def stops_an_unknown_unit(_: Problem, found: Plan) -> Plan:
    assert found.change_set is not None
    return replace(found, change_set=replace(found.change_set, stopped=(*found.change_set.stopped, "nobody.1")))


def renamed(problem: Problem, found: Plan, names: Mapping[str, str]) -> Plan:
    """The plan with other ids of units."""
    assert found.change_set is not None
    units = tuple(
        replace(
            unit,
            id=names.get(unit.id, unit.id),
            subscriptions=tuple(
                Subscription(s.port, Stream(names.get(s.stream.unit, s.stream.unit), s.stream.port))
                for s in unit.subscriptions
            ),
        )
        for unit in problem.environment.update(found.change_set).units
    )
    return replace(found, change_set=problem.environment.change_to(units))


def starts_under_another_id(problem: Problem, found: Plan) -> Plan:
    """The plan that also restarts each kept unit under another id, as if that cost nothing."""
    assert found.change_set is not None
    kept = {unit.id for unit in problem.environment.units} - {*found.change_set.stopped}
    return renamed(problem, found, {name: f"{name}.again" for name in kept})


def takes_ids_of_the_dead(problem: Problem, found: Plan) -> Plan:
    """New units take ids that something that runs still subscribes to."""
    assert found.change_set is not None
    there = {unit.id for unit in problem.environment.units}
    dead = sorted({s.stream.unit for unit in problem.environment.units for s in unit.subscriptions} - there)
    started = (unit.id for unit in found.change_set.started)
    return renamed(problem, found, dict(zip(started, dead, strict=False)))


def leaves_what_is_not_needed(problem: Problem, found: Plan) -> Plan:
    """Nothing is ever stopped."""
    return told_anew(problem, found, stopped=())


def rewires_for_nothing(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    """The oracle's plan of the problem in which nothing runs, with what runs where that costs the same."""
    found = right(problem, time_limit_s, report)
    if found.change_set is None or not found.ties_proven:
        return found
    for _, after in exhaustive.configurations(problem):
        changes = problem.environment.change_to(after.units)
        other = replace(found, change_set=changes)
        told = told_anew(problem, other)
        if told.cost_us == found.cost_us and told.unused_required == found.unused_required and told.rank > found.rank:
            return told
    return found


def ignoring_a_part(**parts: Any) -> Planner:
    """Plans the problem without some part, and says what it has found."""

    def plan(problem: Problem, *, time_limit_s: float | None = None, **_: Any) -> Plan:
        found = right(replace(problem, **parts), time_limit_s)
        if found.change_set is None:
            return found
        told = told_anew(problem, found)
        return replace(told, bound_us=told.cost_us or 0) if found.status is Status.OPTIMAL else told

    return plan


def ignoring_required(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    library = tuple(replace(t, required=False) for t in problem.environment.library)
    found = right(problem.with_parts(library=library), time_limit_s, report)
    return found if found.change_set is None else told_anew(problem, found)


def ignoring_pinned(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    library = tuple(replace(t, pinned=False) for t in problem.environment.library)
    return right(problem.with_parts(library=library), time_limit_s, report)


def ignoring_the_time(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    if time_limit_s:
        time.sleep(2)
    return right(problem, time_limit_s, report)


def raising(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    if any(len(t.inputs) > 1 for t in problem.environment.library):
        raise ZeroDivisionError("two inputs")
    return right(problem, time_limit_s, report)


def refusing(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    if any(t.pinned for t in problem.environment.library):
        raise InputError.of("pinned units are not known")
    return right(problem, time_limit_s, report)


def overlooking_features(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    """What is beyond the paper is left out of the problem, not refused."""
    library = tuple(
        replace(t, conflicts=(), conflicts_on_host=(), beside=(), min_instances=0, max_instances=None)
        for t in problem.environment.library
    )
    return right(problem.with_parts(library=library), time_limit_s, report)


def reporting(progress: Callable[[Plan], Progress]) -> Planner:
    """Reports something else than what is so."""

    def plan(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
        found = right(problem, time_limit_s, report)
        if report is not None and found.cost_us is not None:
            report(progress(found))
        return found

    return plan


def changing(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
    """Changes what it is given."""
    object.__setattr__(problem, "max_cost_us", 7)
    return right(problem, time_limit_s, report)


MUTANTS: dict[str, tuple[Planner, Promise]] = {
    "too dear": (too_dear, Promise.OPTIMAL),
    "an input without a wire": (mutant(without_wire), Promise.VALID),
    "a wire from an unknown unit": (mutant(of_an_unknown_unit), Promise.VALID),
    "an unknown unit is stopped": (mutant(stops_an_unknown_unit), Promise.VALID),
    "other ids": (mutant(starts_under_another_id), Promise.VALID),
    "ids of the dead": (mutant(takes_ids_of_the_dead), Promise.VALID),
    "needless units": (mutant(leaves_what_is_not_needed), Promise.VALID),
    "another cost": (mutant(lambda _, found: replace(found, cost_us=found.cost_us + 1)), Promise.VALID),
    "false optimal": (
        mutant(lambda _, found: replace(found, status=Status.OPTIMAL, bound_us=0)),
        Promise.VALID,
    ),
    "false bound of what is too expensive": (
        mutant(
            lambda _, found: replace(found, bound_us=found.bound_us + 99) if found.bound_us else found, of="has none"
        ),
        Promise.BOUND,
    ),
    "false infeasible": (
        mutant(lambda p, _: Plan("m", Status.INFEASIBLE, reasons={t.label: "no" for t in p.environment.targets})),
        Promise.VALID,
    ),
    "false too expensive": (
        mutant(
            lambda p, found: (
                found if p.max_cost_us is None else Plan("m", Status.TOO_EXPENSIVE, bound_us=p.max_cost_us + 1)
            )
        ),
        Promise.STATUS,
    ),
    "reasons of other targets": (
        mutant(lambda _, found: replace(found, reasons={"nobody": "no"}) if found.reasons else found, of="has none"),
        Promise.VALID,
    ),
    "a plan for what is infeasible": (
        mutant(lambda _, found: replace(found, status=Status.OPTIMAL, change_set=ChangeSet()), of="has none"),
        Promise.VALID,
    ),
    "ignores max_cost": (ignoring_a_part(max_cost_us=None), Promise.VALID),
    "ignores the horizon": (ignoring_a_part(horizon_s=1), Promise.OPTIMAL),
    "ignores required": (ignoring_required, Promise.OPTIMAL),
    "ignores pinned": (ignoring_pinned, Promise.VALID),
    "ignores failures": (ignoring_a_part(survive=None), Promise.VALID),
    "ignores the time limit": (ignoring_the_time, Promise.TIME),
    "raises": (raising, Promise.ANSWERS),
    "returns nothing": (mutant(lambda *_: None, of="any"), Promise.ANSWERS),
    "refuses the paper's problems": (refusing, Promise.TAKES),
    "overlooks features": (overlooking_features, Promise.VALID),
    "wrong ties": (rewires_for_nothing, Promise.TIES),
    "hides unused required ones": (mutant(lambda _, found: replace(found, unused_required=())), Promise.VALID),
    "reports a false bound": (reporting(lambda found: Progress(0.0, None, found.cost_us + 1)), Promise.REPORTS),
    "reports a false cost": (reporting(lambda found: Progress(0.0, found.cost_us - 1, 0)), Promise.REPORTS),
    "changes the problem": (changing, Promise.PURE),
    "never proves": (
        mutant(lambda _, found: replace(found.unproven, status=Status.FEASIBLE)),
        Promise.PROVES,
    ),
    "never finds": (lambda *_, **__: Plan("m", Status.UNKNOWN), Promise.FINDS),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_the_kit_catches_a_broken_planner(name: str) -> None:
    planner, promise = MUTANTS[name]
    patience_s = 1.0 if promise is Promise.TIME else 60.0
    with pytest.raises(AssertionError, match=re.escape(promise)):
        check_planner(
            planner,
            features=EVERY_FEATURE,
            is_exact=promise is Promise.PROVES,
            patience_s=patience_s,
            most=2,
            number=120,
        )


@pytest.mark.parametrize("name", PLANNERS)
def test_a_registered_planner_keeps_its_promises(name: str) -> None:
    known = () if name == "branch-and-bound" else EVERY_FEATURE
    without = ("required",) if name == "branch-and-bound" else ()
    how = {"features": known, "without": without, "is_exact": name != "branch-and-bound"}
    report = check_planner(PLANNERS[name], number=100, **how)
    assert report.answers["optimal" if known else "feasible"] > 20
    assert report.faults == ()


def test_the_planner_of_the_manual_keeps_its_promises() -> None:
    (shown,) = (block for block in blocks_of(MANUAL / "planner.md") if block.said == "greedy.py")
    names: dict[str, Any] = {}
    exec(shown.text, names)
    report = check_planner(names["plan"], without=("distinct", "pinned", "required", "max_cost", "feedback"))
    assert report.answers["refused"] > 20
    assert report.answers["feasible"] > 20


def test_a_fault_shows_the_smallest_problem_and_its_answer_as_python() -> None:
    report = examine_planner(raising)
    (fault,) = report.faults
    assert fault.problem is not None
    assert [len(t.inputs) for t in fault.problem.environment.library] == [2]
    assert "Transformation(label='t" in str(fault)
    assert "ZeroDivisionError: two inputs" in str(fault)


def test_one_seed_draws_the_same_problems_and_another_others() -> None:
    problems = [[drawn_problem(Random(seed), (Feature.HOSTS,)) for _ in range(3)] for seed in (1, 1, 2)]
    assert problems[0] == problems[1] != problems[2]


@pytest.mark.parametrize("feature", Feature)
def test_problems_of_each_feature_are_drawn(feature: Feature) -> None:
    random = Random(0)
    assert sum(feature in drawn_problem(random, (feature,)).features for _ in range(100)) > 20


@pytest.mark.parametrize("word", ["distinct", "feedback", "max_cost", "pinned", "required", "running"])
def test_problems_are_drawn_without_a_word(word: str) -> None:
    random = Random(0)
    problems = [drawn_problem(random, (), (word,)) for _ in range(200)]
    inputs = [port for problem in problems for t in problem.environment.library for port in t.inputs]
    said = {
        "distinct": any(port.distinct for port in inputs),
        "feedback": any(port.feedback for port in inputs),
        "max_cost": any(problem.max_cost_us is not None for problem in problems),
        "pinned": any(t.pinned for problem in problems for t in problem.environment.library),
        "required": any(problem.environment.required for problem in problems),
        "running": any(problem.environment.units for problem in problems),
    }
    assert [each for each, is_said in said.items() if not is_said] == [word]


def test_a_planner_that_refuses_what_it_does_not_know_keeps_its_promises() -> None:
    def plain(problem: Problem, *, time_limit_s: float | None = None, report: Any = None) -> Plan:
        refuse_features(problem, "plain")
        return right(problem, time_limit_s, report)

    assert check_planner(plain, is_exact=True).answers["refused"] > 50


def test_pytest_shows_no_line_of_cfgplan_for_a_planner_that_breaks_a_promise(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text(
        "from cfgplan import Plan, Status\n"
        "from cfgplan.testing import check_planner\n\n\n"
        "def plan(problem, **_):\n"
        "    return Plan('own', Status.INFEASIBLE)\n\n\n"
        "def test_plan():\n"
        "    check_planner(plan, number=1)\n"
    )
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    folders = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": folders}, capture_output=True, text=True
    )
    assert "the planner breaks promises" in done.stdout
    assert "test_own.py:10: AssertionError" in done.stdout
    assert "testing.py" not in done.stdout
    assert "arguments.py" not in done.stdout
