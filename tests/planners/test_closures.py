"""Each closure derives the labels that the rule or the judge derives, with their order, costs or streams."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from unittest.mock import patch

import numpy as np
from fleets import TOGETHER, fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from test_against_the_oracle import many
from worlds import fusions, problems

from cfgplan.domain import Environment
from cfgplan.onward import derivations
from cfgplan.planners.bounding.bounds import cheapest_way
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.grounded import Grounded
from cfgplan.planners.networks.core import Core
from cfgplan.planners.networks.greedy import plan_at
from cfgplan.planners.networks.network import Network
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.support import Support
from cfgplan.planning import Problem
from cfgplan.reasons import Providers, startable, unmet_reasons
from cfgplan.validity.startable import startable as judged_startable

ANY = st.one_of(problems(most=9), fusions(), st.frozensets(st.sampled_from(sorted(TOGETHER))).flatmap(fleets))


def by_rule(labels: Sequence[int], can_run: Callable[[int, set[int]], bool]) -> set[int]:
    """Add labels that can run after others until none is left."""
    found: set[int] = set()
    while new := {label for label in labels if label not in found and can_run(label, found)}:
        found |= new
    return found


def holds(core: Core, fact: int, among: set[int]) -> bool:
    takes = 1 if core.takes is None else int(core.takes[fact])
    return len(among.intersection(core.providers.lists[fact])) >= takes


def network_of(problem: Problem) -> Network:
    environment = problem.environment
    providers = Providers(environment.library, problem.similarity)
    return Network(environment.library, [target.tag for target in environment.targets], [], providers)


@many
@given(ANY, st.data())
def test_the_planner_and_the_judge_name_the_same_startable_transformations(
    problem: Problem, data: st.DataObject
) -> None:
    environment, similarity = problem.environment, problem.similarity
    providers = Providers(environment.library, similarity)
    assert startable(environment, providers) == judged_startable(environment, similarity)
    units = {t.label: data.draw(st.integers(1, 2)) for t in environment.library}
    assert startable(environment, providers, units=units) == judged_startable(environment, similarity, units)


@many
@given(ANY, st.data())
def test_a_reach_has_all_labels_that_can_run_each_after_those_that_feed_it(
    problem: Problem, data: st.DataObject
) -> None:
    core = network_of(problem).core
    labels = data.draw(st.lists(st.integers(0, core.goal), unique=True))

    def can_run(label: int, before: set[int]) -> bool:
        return all(holds(core, fact, before) for fact in core.needs.lists[label])

    reach = Reach(core, labels)
    assert sorted(reach.order) == sorted(by_rule(labels, can_run))
    assert all(can_run(label, set(reach.order[:place])) for place, label in enumerate(reach.order))
    assert all(reach.holds(fact) == holds(core, fact, set(reach.order)) for fact in range(len(core.providers)))


@many
@given(ANY, st.data())
def test_candidates_run_where_the_judge_can_start_them_and_are_fed_by_earlier_ones(
    problem: Problem, data: st.DataObject
) -> None:
    assume(not unmet_reasons(problem))
    candidates = Candidates(problem)
    all_of = candidates.all
    assume(all_of)
    chosen = data.draw(st.sets(st.integers(0, len(all_of) - 1)))
    library = tuple({all_of[i].transformation.label: all_of[i].transformation for i in sorted(chosen)}.values())
    possible = judged_startable(Environment((), library), candidates.problem.similarity)
    can_run = {i for i in chosen if all_of[i].transformation.label in possible}
    # `Grounded` feeds optional inputs, too, and a distinct group by earlier streams only, whether feedback or not.
    ports = [port for t in library for port in t.inputs]
    is_exact = not any(port.optional or (port.feedback and port.distinct is not None) for port in ports)
    for attribute in (None, *problem.environment.qualities):
        grounded = Grounded(candidates, chosen, attribute)
        assert can_run.issuperset(grounded.order)
        assert not is_exact or len(grounded.order) == len(can_run)
        for place, unit in enumerate(grounded.order):
            before = {all_of[i].id for i in grounded.order[:place]}
            for port in all_of[unit].transformation.inputs:
                feeders = {stream.unit for stream in grounded.choices(unit, port)}
                assert feeders or port.optional
                assert port.feedback or feeders <= before


@many
@given(ANY, st.data())
def test_facts_cost_the_same_in_passes_and_one_by_one(problem: Problem, data: st.DataObject) -> None:
    assume(not unmet_reasons(problem))
    network = Candidates(problem).network
    labels = network.core.goal
    cost = np.array(data.draw(st.lists(st.integers(0, 9), min_size=labels, max_size=labels)), np.int64)
    passes = cheapest_way(network.core, cost), plan_at(network, cost, cost + 1.0)
    with (
        patch("cfgplan.planners.bounding.bounds.MOST_PASSES", 0),
        patch("cfgplan.planners.networks.greedy.MOST_PASSES", 0),
    ):
        single = cheapest_way(network.core, cost), plan_at(network, cost, cost + 1.0)
    for one, other in zip(passes[0], single[0], strict=True):
        assert one.tolist() == other.tolist()
    assert passes[1] == single[1]


@many
@given(st.lists(st.sets(st.integers(0, 9), max_size=3), min_size=10, max_size=10), st.booleans())
def test_items_are_derived_once_after_their_last_premise_whatever_comes_first(
    needs: list[set[int]], newest_is_first: bool
) -> None:
    """Each item is the premise of its own number."""
    ahead = [item for item, needed in enumerate(needs) if not needed]
    sources, order = set(ahead), list[int]()

    def premises() -> Iterator[int]:
        while ahead:
            order.append(ahead.pop(-1 if newest_is_first else 0))
            yield order[-1]

    above = [[item for item, needed in enumerate(needs) if premise in needed] for premise in range(10)]
    for item, premise in derivations(premises(), above, [len(needed) for needed in needs]):
        assert premise == order[-1]
        assert premise in needs[item]
        ahead.append(item)
    assert sorted(order) == sorted(by_rule(range(10), lambda item, before: before >= needs[item]))
    assert all(item in sources or set(order[:place]) >= needs[item] for place, item in enumerate(order))


PARTS = st.lists(st.integers(0, 9), max_size=3)


@many
@given(st.lists(st.tuples(st.booleans(), PARTS), min_size=10, max_size=10), st.sets(st.integers(0, 9)))
def test_true_propositions_are_grounded_after_their_premises(
    rows: list[tuple[bool, list[int]]], true: set[int]
) -> None:
    support = Support()
    for proposition, (rests_on_all, parts) in enumerate(rows):
        (support.rests_on_all if rests_on_all else support.rests_on_any)(proposition, parts)

    def can_run(proposition: int, before: set[int]) -> bool:
        rests_on_all, parts = rows[proposition]
        return before.issuperset(parts) if rests_on_all else not before.isdisjoint(parts)

    rank = support.grounded(true)
    order = sorted(rank, key=rank.__getitem__)
    assert set(order) == by_rule(sorted(true), can_run)
    assert all(can_run(proposition, set(order[:place])) for place, proposition in enumerate(order))
