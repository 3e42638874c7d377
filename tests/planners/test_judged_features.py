"""The judge leaves out only rules that nothing in an environment can break, and prices of what it does not have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from fleets import fleets, nearly_plain
from hypothesis import given
from hypothesis import strategies as st
from worlds import problems

from cfgplan.domain import ComputationUnit, Environment
from cfgplan.planning import Feature, Problem
from cfgplan.validity import kept_us, violations


def with_all_features(environment: Environment) -> Environment:
    """The same environment, said to have all features, so that the judge leaves nothing out."""
    copy = replace(environment)
    vars(copy)["features"] = frozenset(Feature)
    return copy


def changed(draw: st.DrawFn, unit: ComputationUnit, hosts: list[str | None]) -> list[ComputationUnit]:
    """A unit as it is, or gone, doubled, on another host, in standby, fed twice, or with an input that is not fed."""
    first = unit.subscriptions[:1]
    return draw(
        st.sampled_from(
            [
                [unit],
                [],
                [unit, replace(unit, id=f"{unit.id}'", publications=())],
                [replace(unit, host=draw(st.sampled_from(hosts)))],
                [replace(unit, standby=True, subscriptions=(), publications=())],
                [replace(unit, subscriptions=unit.subscriptions[1:])],
                [
                    replace(
                        unit, subscriptions=(*first, *(replace(s, stream=replace(s.stream, port="out")) for s in first))
                    )
                ],
            ]
        )
    )


@st.composite
def judged(draw: st.DrawFn, plain: st.SearchStrategy[Any]) -> Problem:
    """A problem whose running units were changed at random, so that they break rules."""
    problem: Problem = draw(plain)
    hosts = [host.name for host in problem.environment.hosts] or [None]
    units = [new for unit in problem.environment.units for new in changed(draw, unit, hosts)]
    return replace(problem, environment=replace(problem.environment, units=tuple(units)))


DRAWN = {str(feature): fleets(frozenset({feature})) for feature in Feature} | {
    "nothing beyond the paper": problems(),
    "a little": nearly_plain(),
    "everything": fleets(frozenset(Feature)),
}


@pytest.mark.parametrize("drawn", DRAWN.values(), ids=DRAWN)
@given(data=st.data())
def test_what_the_judge_leaves_out_breaks_no_rule_and_costs_nothing(
    drawn: st.SearchStrategy[Problem], data: st.DataObject
) -> None:
    problem = data.draw(judged(drawn))
    environment, rest = problem.environment, (problem.similarity, problem.survive, problem.horizon_s)
    assert violations(environment, *rest) == violations(with_all_features(environment), *rest)
    assert kept_us(environment, problem.horizon_s) == kept_us(with_all_features(environment), problem.horizon_s)
