"""Small environments of every kind, drawn by Hypothesis."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from unittest.mock import patch

from hypothesis import HealthCheck, assume, settings
from hypothesis import strategies as st

from cfgplan.domain import (
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
from cfgplan.planning import Plan, Problem

TAGS = ("A", "B", "C", "D")
COSTS = st.sampled_from([0, 0, 1, 1, 2, 3, 5, 8])


def examples(usual: int, *, part: int = 1) -> settings:
    """As many new examples as CFGPLAN_EXAMPLES says, else so many of the same each time; or a `part` of these."""
    return settings(
        max_examples=int(os.environ.get("CFGPLAN_EXAMPLES", usual)) // part,
        deadline=None,
        derandomize="CFGPLAN_EXAMPLES" not in os.environ,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
    )


@st.composite
def similarities(draw: st.DrawFn) -> Similarity:
    """Every tag matches itself; some match others, in any direction, so that validity may be cyclic."""
    extra = draw(st.sets(st.tuples(st.sampled_from(TAGS), st.sampled_from(TAGS)), max_size=4))
    return Similarity({tag: frozenset({tag} | {offered for offered, wanted in extra if wanted == tag}) for tag in TAGS})


@st.composite
def transformations(draw: st.DrawFn, label: str, *, special: bool) -> Transformation:
    """Up to three inputs and two outputs; the special ones may be pinned, required, fed back or distinct.

    Half of the groups of distinct inputs ask for the same.
    """
    seldom = st.sampled_from([False, False, False, True]) if special else st.just(False)
    inputs = []
    shared = draw(st.sampled_from(TAGS)) if special and draw(st.booleans()) else None
    for name in ("a", "b", "c")[: draw(st.sampled_from([0, 0, 0, 1, 1, 1, 2, 2, 3]))]:
        group = draw(st.sampled_from([None, None, "g", "g"])) if special else None
        tag = draw(st.sampled_from(TAGS)) if group is None or shared is None else shared
        inputs.append(InputPort(name, tag, distinct=group, feedback=draw(seldom)))
    outputs = [OutputPort(name, draw(st.sampled_from(TAGS))) for name in ("x", "y")[: draw(st.sampled_from([1, 1, 2]))]]
    return Transformation(
        label,
        tuple(inputs),
        tuple(outputs),
        labor_us=draw(COSTS),
        upkeep_us=draw(COSTS),
        pinned=draw(seldom),
        required=draw(seldom),
    )


@st.composite
def problems(draw: st.DrawFn, *, most: int = 6, special: bool = True) -> Problem:
    """A problem of at most `most` transformations, with up to four running units in any state of repair."""
    labels = [f"t{i}" for i in range(draw(st.integers(1, most)))]
    library = [draw(transformations(label, special=special)) for label in labels]
    relation = draw(similarities())
    given = sorted({port.tag for transformation in library for port in transformation.outputs})
    wanted = st.one_of(*[st.sampled_from(given)] * 7, st.sampled_from(TAGS))
    targets = [
        Target(f"q{i}", draw(wanted), f"/{i}", draw(st.integers(0, 2)))
        for i in range(draw(st.sampled_from([1, 1, 1, 2, 2, 3])))
    ]
    units = draw(running_units(library, targets, relation)) if draw(st.sampled_from([False, True, True])) else []
    horizon_s = draw(st.sampled_from([0, 1, 1, 2, 10]))
    max_cost_us = draw(st.one_of(st.none(), st.none(), st.integers(0, 30)))
    environment = Environment(tuple(units), tuple(library), tuple(targets))
    return Problem(environment, relation, horizon_s, max_cost_us)


@st.composite
def fusions(draw: st.DrawFn) -> Problem:
    """Sources, what is made of them, and one or two ways to fuse that from different transformations."""
    paid = st.integers(0, 9)

    def made(label: str, inputs: list[str], output: str) -> Transformation:
        group = draw(st.sampled_from([None, "g", "g"]))
        ports = tuple(InputPort(f"i{i}", tag, distinct=group) for i, tag in enumerate(inputs))
        return Transformation(label, ports, (OutputPort("x", output),), draw(paid), draw(st.integers(0, 1)))

    library = [made(f"s{i}", [], draw(st.sampled_from("AAB"))) for i in range(draw(st.integers(1, 3)))]
    for i in range(draw(st.integers(1, 4))):
        inputs = draw(st.sampled_from([["A"], ["A"], ["B"], ["A", "A"], ["A", "B"], ["C", "A"], []]))
        library.append(made(f"m{i}", inputs, draw(st.sampled_from("CCCD"))))
    for i in range(draw(st.integers(1, 2))):
        inputs = draw(st.sampled_from([["C", "C"], ["C", "C"], ["C", "D"], ["C", "C", "C"], ["C", "A"]]))
        library.append(made(f"f{i}", inputs, draw(st.sampled_from("QQQC"))))
    if draw(st.integers(0, 3)) == 0:
        library.append(made("q", [], "Q"))
    relation = {tag: {tag} for tag in "ABCDQ"}
    if draw(st.booleans()):
        relation["C"].add("D")
    targets = [Target(tag, tag, f"/{tag}") for tag in draw(st.sampled_from(["Q", "Q", "Q", "QC"]))]
    similarity = Similarity({tag: frozenset(offered) for tag, offered in relation.items()})
    return Problem(Environment((), tuple(library), tuple(targets)), similarity, draw(st.integers(0, 2)))


@st.composite
def pipelines(draw: st.DrawFn) -> Problem:
    """Pipelines that share nothing but perhaps a source, with alternatives inside; two or three are fused."""
    paid, rate = st.integers(0, 9), st.integers(0, 1)

    def made(label: str, inputs: list[str], output: str, group: str | None = None) -> Transformation:
        ports = tuple(InputPort(f"i{i}", tag, distinct=group) for i, tag in enumerate(inputs))
        return Transformation(label, ports, (OutputPort("x", output),), draw(paid), draw(rate))

    count = draw(st.integers(2, 4))
    library = [made("fuse", ["C"] * draw(st.integers(2, min(count, 3))), "Q", "g")]
    is_shared = draw(st.booleans())
    if is_shared:
        library.append(made("shared", [], "S"))
    for i in range(count):
        length = draw(st.sampled_from([1, 1, 2, 2, 3] if count < 4 else [1, 1, 2]))
        for stage in range(length):
            inputs = [f"{i}.{stage - 1}"] if stage else ["S"] if is_shared and draw(st.booleans()) else []
            output = "C" if stage == length - 1 else f"{i}.{stage}"
            alternatives = draw(st.sampled_from([1, 1, 2])) if stage < length - 1 and len(library) < 8 else 1
            library += [made(f"m{i}{stage}{way}", inputs, output) for way in range(alternatives)]
    tags = {port.tag for t in library for port in t.outputs}
    relation = Similarity({tag: frozenset({tag}) for tag in tags})
    targets = [Target("Q", "Q", "/Q")]
    units = draw(running_units(library, targets, relation)) if draw(st.integers(0, 3)) == 0 else []
    return Problem(Environment(tuple(units), tuple(library), tuple(targets)), relation, draw(st.integers(0, 2)))


@st.composite
def running_units(
    draw: st.DrawFn, library: list[Transformation], targets: list[Target], relation: Similarity
) -> list[ComputationUnit]:
    """Units with gaps, dead feeders, unfit streams, cycles and stale topics; some of a transformation that left."""
    gone = Transformation("gone", (), (OutputPort("x", "A"),))
    count = draw(st.integers(1, 4))
    kinds = [draw(st.sampled_from([*library, *library, gone])) for _ in range(count)]
    ids = [f"{kind.label}.{i + 1}" for i, kind in enumerate(kinds)]
    offered = [
        (port.tag, Stream(unit, port.name)) for unit, kind in zip(ids, kinds, strict=True) for port in kind.outputs
    ]
    topics = [*(target.topic for target in targets), "/stale"]
    units = []
    for unit_id, kind in zip(ids, kinds, strict=True):
        subscriptions = []
        for port in kind.inputs:
            fit = [stream for tag, stream in offered if relation.holds(tag, port.tag)]
            unfit = [*(stream for _, stream in offered), Stream("dead.1", "x"), None]
            stream = draw(
                st.one_of(st.sampled_from(fit or unfit), st.sampled_from(fit or unfit), st.sampled_from(unfit))
            )
            if stream is not None:
                subscriptions.append(Subscription(port.name, stream))
        published = draw(st.lists(st.sampled_from(topics), max_size=2, unique=True))
        publications = [Publication(draw(st.sampled_from(kind.outputs)).name, topic) for topic in published]
        units.append(ComputationUnit(unit_id, kind.label, tuple(subscriptions), tuple(publications)))
    return units


@st.composite
def changed(draw: st.DrawFn, problem: Problem) -> Problem:
    """The problem after one thing happened to it."""
    environment = problem.environment
    kind = draw(
        st.sampled_from(["unit died", "joined", "left", "cost", "target came", "target left", "relation", "cap"])
    )
    units, library, targets = list(environment.units), list(environment.library), list(environment.targets)
    similarity, max_cost_us = problem.similarity, problem.max_cost_us
    if kind == "unit died" and units:
        units.remove(draw(st.sampled_from(units)))
    elif kind == "joined":
        library.append(draw(transformations(f"new{len(library)}", special=draw(st.booleans()))))
        library = list({t.label: t for t in library}.values())
    elif kind == "left" and len(library) > 1:
        library.remove(draw(st.sampled_from(library)))
    elif kind == "cost":
        moved = draw(st.sampled_from(library))
        library[library.index(moved)] = replace(
            moved, labor_us=draw(st.integers(0, 9)), upkeep_us=draw(st.integers(0, 5))
        )
    elif kind == "target came" and len(targets) < 4:
        targets.append(Target(f"late{len(targets)}", draw(st.sampled_from(TAGS)), f"/late{len(targets)}"))
        targets = list({t.label: t for t in targets}.values())
    elif kind == "target left" and targets:
        targets.remove(draw(st.sampled_from(targets)))
    elif kind == "relation":
        one, other = draw(st.sampled_from(TAGS)), draw(st.sampled_from(TAGS))
        similarity = Similarity({**similarity.offers, one: similarity.offers[one] ^ ({other} - {one})})
    elif kind == "cap":
        max_cost_us = draw(st.one_of(st.none(), st.integers(0, 30)))
    return Problem(
        Environment(tuple(units), tuple(library), tuple(targets)), similarity, problem.horizon_s, max_cost_us
    )


DRAWS_ALL = "CFGPLAN_EXAMPLES" in os.environ or os.environ.get("CFGPLAN_SHARE") == "1"
"""Whether all examples are drawn, as at night."""
FEW_STEPS = 10_000
"""The most steps of the oracle for an example of a push: about 2 s of CPU."""


@contextmanager
def few_steps() -> Iterator[None]:
    """Let the oracle refuse examples that take many steps, up to half a minute, unless all examples are drawn."""
    with patch.object(exhaustive, "MOST_STEPS", exhaustive.MOST_STEPS if DRAWS_ALL else FEW_STEPS):
        yield


@cache
def _answer_of_the_oracle(problem: Problem) -> Plan | None:
    """The oracle's answer, None where it refuses one; tests with one seed draw the same problems."""
    try:
        with few_steps():
            return PLANNERS["exhaustive"](problem)
    except InputError:
        return None


def oracle_of(problem: Problem) -> Plan:
    """The oracle's answer; the example is not counted where it refuses one."""
    found = _answer_of_the_oracle(problem)
    if found is None:
        assume(False)
    assert found is not None
    return found


@st.composite
def histories(draw: st.DrawFn, *, most: int = 5) -> list[tuple[Problem, Plan]]:
    """A problem with the oracle's plan, and what comes of it: that plan runs and something happens, once or twice."""
    problem = draw(problems(most=most, special=draw(st.booleans())))
    plan = oracle_of(problem)
    history = [(problem, plan)]
    for _ in range(draw(st.integers(1, 2)) if plan.change_set is not None else 0):
        if plan.change_set is not None:
            problem = replace(problem, environment=problem.environment.update(plan.change_set))
        problem = draw(changed(problem))
        plan = oracle_of(problem)
        history.append((problem, plan))
    return history


@st.composite
def costs_far_apart(draw: st.DrawFn, drawn: st.SearchStrategy[Problem]) -> Problem:
    """A problem with costs of 0 and of up to a million seconds, beside those of microseconds, and with any horizon."""
    problem = draw(drawn)
    costs = st.sampled_from([0, 0, 1, 10**6, 10**12])
    library = tuple(
        replace(t, labor_us=draw(costs), upkeep_us=draw(costs), required=t.required or draw(st.integers(0, 5)) == 0)
        for t in problem.environment.library
    )
    most_us = draw(st.sampled_from([None, None, 0, 1, 10**6, 10**12]))
    environment = replace(problem.environment, library=library)
    return replace(
        problem, environment=environment, horizon_s=draw(st.sampled_from([0, 0, 1, 10])), max_cost_us=most_us
    )


@st.composite
def required_within_a_cost(draw: st.DrawFn, drawn: st.SearchStrategy[Problem]) -> Problem:
    """A problem in which something is required and the cost is limited."""
    problem = draw(drawn)
    environment = problem.environment
    wanted = draw(st.sets(st.sampled_from([t.label for t in environment.library]), min_size=1, max_size=2))
    library = tuple(replace(t, required=t.label in wanted) for t in environment.library)
    most_us = draw(st.integers(0, 30))
    return replace(problem, environment=replace(environment, library=library), max_cost_us=most_us)


def reordered(problem: Problem, draw: st.DrawFn) -> Problem:
    """The same problem with all its lists in another order."""
    environment = problem.environment
    return Problem(
        Environment(
            tuple(draw(st.permutations(environment.units))),
            tuple(
                Transformation(
                    t.label,
                    tuple(draw(st.permutations(t.inputs))),
                    tuple(draw(st.permutations(t.outputs))),
                    t.labor_us,
                    t.upkeep_us,
                    pinned=t.pinned,
                    required=t.required,
                )
                for t in draw(st.permutations(environment.library))
            ),
            tuple(draw(st.permutations(environment.targets))),
        ),
        Similarity(dict(draw(st.permutations(list(problem.similarity.offers.items()))))),
        problem.horizon_s,
        problem.max_cost_us,
    )
