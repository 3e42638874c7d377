"""Every kind of random environment, and what must be so of the planner's answer to one: what the oracle's is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import comb, prod
from types import MappingProxyType
from typing import Any

import plain_model
import undecided
from fleets import (
    KNOWN_TO_BOUNDS,
    TOGETHER,
    clashing_pins,
    fleets,
    nearly_plain,
    on_flat_scales,
    with_facts,
    with_words_that_do_nothing,
)
from hypothesis import strategies as st
from worlds import costs_far_apart, fusions, histories, oracle_of, pipelines, problems, required_within_a_cost

from cfgplan.domain import Similarity
from cfgplan.planners import PLANNERS
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.groups import is_countable
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Fleets, Tuning
from cfgplan.planning import Feature, Plan, Problem, Status
from cfgplan.qualities import MICRO, Contribution, QualityAttribute, QualityRule
from cfgplan.validity import plan_violations


@dataclass(frozen=True)
class Kind:
    """How environments of a kind are drawn, and every way in which the answer to one is not as good as the oracle's."""

    drawn: st.SearchStrategy[Any]
    differences: Callable[[Any], list[str]]


def as_good(plan: Plan) -> tuple[object, ...]:
    """What two optimal plans have in common."""
    changes = plan.change_set
    counts = None if changes is None else (len(changes.rewired), len(changes.started))
    return plan.status, len(plan.unused_required), plan.cost_us, counts, plan.ties_proven, plan.objectives


def differences(problem: Problem, found: Plan, oracle: Plan) -> list[str]:
    """What the judge says about a plan, and that it is not as good as the oracle's."""
    wrong = [str(violation) for violation in plan_violations(problem, found)]
    if failed := found.counts.get("failed searches"):
        wrong.append(f"{failed} searches failed")
    if as_good(found) != as_good(oracle):
        wrong.append(f"the planner says {as_good(found)}, the oracle {as_good(oracle)}")
    return wrong


def sets_of_units(problem: Problem) -> int:
    """How many sets of units the oracle tries, about."""
    environment = problem.environment
    waits = [t.standby_us is not None and problem.survive is not None for t in environment.library]
    places = [len(environment.hosts_for(t)) * (1 + wait) for t, wait in zip(environment.library, waits, strict=True)]
    new = [comb(there + problem.most_new(t), there) for t, there in zip(environment.library, places, strict=True)]
    return 2 ** len(environment.units) * prod(new)


def of_one(problem: Problem) -> list[str]:
    oracle = oracle_of(problem)
    return differences(problem, PLANNERS["cpsat"](problem), oracle)


def of_each_planner(problem: Problem) -> list[str]:
    """The planner is as good as the oracle; the paper's, which proves little, contradicts neither judge nor oracle."""
    oracle = oracle_of(problem)
    wrong, found = of_one(problem), PLANNERS["branch-and-bound"](problem)
    wrong += [f"branch-and-bound: {violation}" for violation in plan_violations(problem, found)]
    claims = found.status not in (Status.FEASIBLE, Status.UNKNOWN)
    if claims and as_good(found)[:3] != as_good(oracle)[:3]:
        wrong.append(f"branch-and-bound says {as_good(found)}, the oracle {as_good(oracle)}")
    return wrong


def of_a_history(history: list[tuple[Problem, Plan]]) -> list[str]:
    """One session plans all that happens, one after the other."""
    session = PlannerSession()
    return [wrong for problem, oracle in history for wrong in differences(problem, session.plan(problem), oracle)]


def of_open_pairs(case: tuple[Problem, Similarity]) -> list[str]:
    """What is asked ends in the truth, and an answer without asking claims nothing that a truth denies."""
    return undecided.differences(*case)


PATIENCE_S = 60.0
"""Seconds for each plan and each optimum of a kind that the plain model decides."""


class LeftOpenError(Exception):
    """The planner has not proven its plan in time, and nothing that it claims is false."""


def of_the_plain_model(problem: Problem) -> list[str]:
    """The plain model is the oracle of problems that are too large for the enumeration. Raises LeftOpenError."""
    found = PLANNERS["cpsat"](problem, time_limit_s=PATIENCE_S)
    wrong = [str(violation) for violation in plan_violations(problem, found)]
    is_open = found.status in (Status.FEASIBLE, Status.UNKNOWN)
    try:
        optimum = plain_model.optimum(problem, PATIENCE_S)
    except plain_model.TooLargeError:
        if is_open and not wrong:
            raise LeftOpenError from None
        raise
    if is_open:
        if found.change_set is not None and optimum.cost_us is None:
            wrong.append(f"the planner has a plan, the plain model says {optimum.status}")
        elif optimum.cost_us is not None and Feature.ORDER not in problem.features:
            most_us = found.cost_us if len(found.unused_required) == optimum.unused else None
            if found.bound_us > optimum.cost_us or (most_us is not None and most_us < optimum.cost_us):
                wrong.append(f"the planner says {found.bound_us} to {most_us}, the plain model {optimum.cost_us}")
        if not wrong:
            raise LeftOpenError
    elif plain_model.Optimum.of(found) != optimum:
        wrong.append(f"the planner says {plain_model.Optimum.of(found)}, the plain model {optimum}")
    return wrong


@st.composite
def far_apart(draw: st.DrawFn, problems: st.SearchStrategy[Problem]) -> Problem:
    """Problems whose costs differ by a factor of 10^12, with qualities of millionths and of whole units."""
    problem = draw(problems)
    costs_us = st.sampled_from([0, 1, MICRO, 10**6 * MICRO])
    library = []
    for t in problem.environment.library:
        each = draw(st.sampled_from([1, MICRO]))
        outputs = tuple(replace(port, quality=tuple(_times(each, one) for one in port.quality)) for port in t.outputs)
        library.append(replace(t, labor_us=draw(costs_us), upkeep_us=draw(costs_us), seen_us={}, outputs=outputs))
    qualities = tuple(QualityAttribute(a.name, a.better) for a in problem.environment.qualities)
    targets = tuple(
        replace(t, quality=tuple(replace(w, bound=w.bound and w.bound * MICRO) for w in t.quality))
        for t in problem.environment.targets
    )
    environment = replace(problem.environment, library=tuple(library), qualities=qualities, targets=targets)
    return Problem(environment, problem.similarity, draw(st.sampled_from([0, 1, 7])))


def _times(factor: int, stated: Contribution) -> Contribution:
    if stated.rule is QualityRule.SCALE:
        return stated
    plain = replace(stated, value=stated.stated * factor, seen=0, seen_on=())
    return plain.taught({host: by * factor for host, by in stated.learned.items()})


HOSTS, QUALITY, SURVIVAL = (frozenset({feature}) for feature in (Feature.HOSTS, Feature.QUALITY, Feature.SURVIVAL))
BESIDE = frozenset({Feature.BESIDE})
NUMBERS = frozenset({Feature.CONFLICTS, Feature.INSTANCES})
WIRING = frozenset({Feature.OPTIONAL, Feature.COUNTS, Feature.LIMITS})
LIMITS = frozenset({Feature.LIMITS})
RUNS = frozenset({Feature.RUNS})
ORDER = frozenset({Feature.ORDER})
OPTIONAL, COUNTS = (frozenset({feature}) for feature in (Feature.OPTIONAL, Feature.COUNTS))

ALIKE = Tuning(fleet=Fleets(apart=0, shared=1))
"""Hosts alike are limited together, however few they are, and units are counted wherever they can be."""
LARGER = st.one_of(
    fleets(WIRING | NUMBERS, most=6),
    fleets(WIRING | QUALITY, most=5),
    fleets(WIRING | QUALITY | HOSTS | NUMBERS | ORDER, most=4),
    fleets(QUALITY | HOSTS | BESIDE | RUNS | NUMBERS, most=5),
).filter(lambda problem: plain_model.number_of_units(problem) <= plain_model.MOST_UNITS)
"""Problems for the plain model."""
COUNTABLE = st.one_of(
    fleets(COUNTS | LIMITS | NUMBERS | HOSTS, most=2),
    fleets(COUNTS | LIMITS | NUMBERS | BESIDE | RUNS | ORDER | HOSTS, most=2),
    fleets(COUNTS | LIMITS | NUMBERS, most=3),
    fleets(WIRING | NUMBERS | HOSTS | BESIDE | RUNS, most=2),
    fleets(WIRING | NUMBERS, most=3),
).filter(lambda problem: is_countable(Candidates(problem, clock=Clock(tuning=ALIKE))))
"""Problems whose units are counted with the tuning `ALIKE`."""

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "plain": Kind(st.one_of(problems(special=False), problems(most=5), fusions(), pipelines()), of_one),
        "nearly plain": Kind(
            nearly_plain().filter(lambda problem: bool(problem.features) and sets_of_units(problem) < 2000), of_one
        ),
        "replanning": Kind(histories(), of_a_history),
        "hosts": Kind(st.one_of(fleets(HOSTS), fleets(HOSTS | NUMBERS)), of_one),
        "company": Kind(
            st.one_of(
                fleets(BESIDE | HOSTS), fleets(BESIDE | HOSTS | NUMBERS), fleets(BESIDE | SURVIVAL | HOSTS, most=2)
            ),
            of_one,
        ),
        "optional company": Kind(
            st.one_of(fleets(BESIDE | OPTIONAL), fleets(BESIDE | WIRING | HOSTS, most=2)).filter(
                lambda problem: problem.features >= BESIDE | OPTIONAL
            ),
            of_one,
        ),
        "quality": Kind(st.one_of(fleets(QUALITY), fleets(QUALITY | HOSTS, most=2)), of_one),
        "quality of several": Kind(
            st.one_of(fleets(QUALITY | OPTIONAL), fleets(QUALITY | COUNTS), fleets(QUALITY | WIRING | HOSTS, most=2)),
            of_one,
        ),
        "latency": Kind(fleets(QUALITY | HOSTS | {Feature.LATENCY}, most=2), of_one),
        "survival of wiring": Kind(
            st.one_of(
                fleets(SURVIVAL | OPTIONAL),
                fleets(SURVIVAL | COUNTS | LIMITS, most=2),
                fleets(SURVIVAL | WIRING | NUMBERS, most=2),
                fleets(SURVIVAL | WIRING | HOSTS | BESIDE, most=2),
            ).filter(lambda problem: bool(problem.features & WIRING) and sets_of_units(problem) < 2000),
            of_one,
        ),
        "survival": Kind(st.one_of(fleets(SURVIVAL), fleets(SURVIVAL | HOSTS, most=2)), of_one),
        "optional": Kind(st.one_of(fleets(OPTIONAL), fleets(OPTIONAL, most=4)), of_one),
        "counts": Kind(st.one_of(fleets(COUNTS), fleets(WIRING)), of_one),
        "limits": Kind(st.one_of(fleets(LIMITS, most=4), fleets(LIMITS | OPTIONAL)), of_one),
        "order": Kind(st.one_of(fleets(ORDER), fleets(ORDER | HOSTS), fleets(ORDER | WIRING | HOSTS, most=2)), of_one),
        "counting": Kind(COUNTABLE, of_one),
        "wiring": Kind(fleets(WIRING | NUMBERS | HOSTS, most=2), of_one),
        "runs": Kind(
            st.one_of(
                fleets(RUNS),
                fleets(RUNS, most=4),
                fleets(RUNS | NUMBERS | HOSTS | BESIDE, most=2),
                fleets(RUNS | SURVIVAL, most=3),
                fleets(RUNS | OPTIONAL | COUNTS, most=2),
                fleets(RUNS | QUALITY | HOSTS, most=2),
            ),
            of_one,
        ),
        "everything": Kind(
            st.one_of(
                fleets(KNOWN_TO_BOUNDS, most=2),
                fleets(TOGETHER - SURVIVAL, most=2),
                fleets(TOGETHER - SURVIVAL - QUALITY, most=2),
                with_facts(fleets(TOGETHER, most=2)).filter(lambda problem: sets_of_units(problem) < 2000),
            ),
            of_one,
        ),
        "facts": Kind(
            with_facts(st.one_of(problems(most=4), fleets(HOSTS), fleets(HOSTS | NUMBERS), fleets(QUALITY))), of_one
        ),
        "larger": Kind(LARGER, of_the_plain_model),
        "far apart": Kind(
            far_apart(st.one_of(fleets(QUALITY | WIRING), fleets(QUALITY), fleets(WIRING | NUMBERS))),
            of_the_plain_model,
        ),
        "clashing pins": Kind(
            st.one_of(
                clashing_pins(NUMBERS),
                clashing_pins(NUMBERS | QUALITY),
                clashing_pins(NUMBERS | QUALITY | HOSTS),
                clashing_pins(NUMBERS | WIRING),
            ),
            of_one,
        ),
        "flat scales": Kind(
            st.one_of(
                on_flat_scales(QUALITY, most=2),
                on_flat_scales(QUALITY | OPTIONAL | COUNTS, most=2),
                on_flat_scales(QUALITY | HOSTS | {Feature.LATENCY}, most=2),
            ),
            of_one,
        ),
        "company of several": Kind(
            st.one_of(
                fleets(BESIDE | COUNTS),
                fleets(BESIDE | COUNTS | LIMITS),
                fleets(BESIDE | COUNTS | NUMBERS),
                fleets(BESIDE | COUNTS | HOSTS, most=2),
            ).filter(lambda problem: problem.features >= BESIDE | COUNTS),
            of_one,
        ),
        "required within a cost": Kind(
            st.one_of(
                required_within_a_cost(problems(special=False, most=5)), required_within_a_cost(problems(most=5))
            ),
            of_each_planner,
        ),
        "required in fleets": Kind(
            st.one_of(
                required_within_a_cost(fleets(QUALITY)),
                required_within_a_cost(fleets(HOSTS | NUMBERS)),
                required_within_a_cost(fleets(WIRING)),
                required_within_a_cost(fleets(ORDER | HOSTS, most=2)),
            ),
            of_one,
        ),
        "costs far apart": Kind(
            st.one_of(
                costs_far_apart(problems(most=5)),
                costs_far_apart(fleets(QUALITY)),
                costs_far_apart(fleets(HOSTS | NUMBERS, most=2)),
                costs_far_apart(fleets(WIRING)),
                costs_far_apart(fleets(SURVIVAL)),
                costs_far_apart(fleets(ORDER)),
            ),
            of_one,
        ),
        "words that do nothing": Kind(
            st.one_of(
                with_words_that_do_nothing(problems(most=4)),
                with_words_that_do_nothing(fleets(QUALITY | HOSTS, most=2)),
                with_words_that_do_nothing(fleets(WIRING, most=2)),
                with_words_that_do_nothing(fleets(SURVIVAL, most=2)),
            ),
            of_one,
        ),
        "undecided": Kind(
            st.one_of(undecided.undecided(problems(most=3)), undecided.undecided(fleets(TOGETHER, most=2))),
            of_open_pairs,
        ),
    }
)
