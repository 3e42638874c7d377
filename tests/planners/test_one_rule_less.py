"""Whoever asks for less never pays more: the optimum of a problem is an upper bound for that with one rule less."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from math import inf

from fleets import KNOWN_TO_BOUNDS, fleets
from hypothesis import given
from hypothesis import strategies as st
from worlds import examples, problems

from cfgplan.domain import Transformation
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status

PROVEN = (Status.OPTIMAL, Status.INFEASIBLE, Status.TOO_EXPENSIVE)
ANY = st.one_of(problems(most=5), fleets(KNOWN_TO_BOUNDS, most=4))


def cost_us(problem: Problem) -> float:
    """What the cheapest plan costs; endless if there is none."""
    plan = PLANNERS["cpsat"](problem)
    assert plan.status in PROVEN
    return inf if plan.change_set is None or plan.cost_us is None else plan.cost_us


def with_library(problem: Problem, library: list[Transformation]) -> Problem:
    return replace(problem, environment=replace(problem.environment, library=tuple(library)))


def without(problem: Problem, *flags: str) -> Problem:
    """The problem in which nothing is pinned, or required."""
    changes = dict.fromkeys(flags, False)
    return with_library(problem, [replace(t, **changes) for t in problem.environment.library])  # type: ignore[arg-type]


def with_less_wanted(problem: Problem) -> Iterator[tuple[str, Problem]]:
    """Each problem with one target or pin less."""
    environment = problem.environment
    for gone in environment.targets:
        left = tuple(target for target in environment.targets if target != gone)
        yield f"without target {gone.label}", replace(problem, environment=replace(environment, targets=left))
    for pinned in (t for t in environment.library if t.pinned):
        library = [replace(t, pinned=t.pinned and t != pinned) for t in environment.library]
        yield f"without the pin of {pinned.label}", with_library(problem, library)


def with_less_forbidden(problem: Problem) -> Iterator[tuple[str, Problem]]:
    """Each problem with one rule less: distinct inputs, conflicts, a number, hosts, a bound, a limit, failures."""
    environment = problem.environment
    for i, t in enumerate(environment.library):
        apart = replace(t, inputs=tuple(replace(port, distinct=None) for port in t.inputs))
        for name, freer in {
            "distinct": apart,
            "conflicts": replace(t, conflicts=()),
            "least number": replace(t, min_instances=0),
            "most": replace(t, max_instances=None if t.max_instances is None else t.max_instances + 1),
            "hosts": replace(t, host=None, hosts=()),
            "needs": replace(t, needs={}),
        }.items():
            if freer != t:
                library = [*environment.library[:i], freer, *environment.library[i + 1 :]]
                yield f"{t.label} without {name}", with_library(problem, library)
    for i, target in enumerate(environment.targets):
        wishes = tuple(replace(wish, bound=None) for wish in target.quality)
        if wishes != target.quality:
            freed = (*environment.targets[:i], replace(target, quality=wishes), *environment.targets[i + 1 :])
            yield f"{target.label} without bounds", replace(problem, environment=replace(environment, targets=freed))
    for host in environment.hosts:
        hosts = tuple(replace(h, cpu_us=None, memory_mb=None) if h == host else h for h in environment.hosts)
        if hosts != environment.hosts:
            yield f"{host.name} without limits", replace(problem, environment=replace(environment, hosts=hosts))
    if problem.survive is not None:
        # Two new units of each are allowed where failures are to be survived: so they have to be without them.
        there = Counter(unit.transformation for unit in environment.units)
        as_many = [
            t if t.max_instances is not None else replace(t, max_instances=2 + there[t.label])
            for t in environment.library
        ]
        yield "without failures", replace(with_library(problem, as_many), survive=None)


@examples(400, part=10)
@given(ANY)
def test_without_required_ones_a_target_or_a_pin_nothing_is_dearer(problem: Problem) -> None:
    free = without(problem, "required")
    most = cost_us(free)
    assert most <= cost_us(problem)
    dearer = [name for name, less in with_less_wanted(free) if cost_us(less) > most]
    assert not dearer


@examples(400, part=10)
@given(ANY)
def test_without_a_rule_that_forbids_something_nothing_is_dearer(problem: Problem) -> None:
    """Nothing is pinned: units that can't be fed are let go, and may have to go on where less is forbidden."""
    free = without(problem, "required", "pinned")
    most = cost_us(free)
    dearer = [name for name, less in with_less_forbidden(free) if cost_us(less) > most]
    assert not dearer
