"""Plans that pay for what they carry: where their units are, and what first plans cost with them."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from statistics import mean

import pytest
from fleets import fleets
from hypothesis import given
from hypothesis import strategies as st
from test_fleets_against_the_oracle import some

from cfgplan.domain import Environment, Host, InputPort, Link, OutputPort, Similarity, Target, Transformation
from cfgplan.planners import PLANNERS
from cfgplan.planners.exact import first_plans
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.placed import PlacedNetwork
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.solving.clock import Clock, OutOfTimeError
from cfgplan.planning import Feature, Plan, Problem
from experiments.study.instances import generated

ROBOT, BASE, CLOUD = Host("robot"), Host("base"), Host("cloud")


def first(asked: Problem) -> Plan:
    """The first plan, without attempts to do without one of its members."""
    state = SolveState(asked, Clock(), None)
    FirstPlans(Candidates(asked), state).look(0)
    return state.plan()


def source(label: str, host: str, *, megabytes: int, labor_us: int) -> Transformation:
    out = OutputPort("out", "image", rate_uhz=1_000_000, size_bytes=megabytes * 1_000_000)
    return Transformation(label, (), (out,), labor_us=labor_us, host=host)


def step(label: str, host: str | None = None, *, needs: str, gives: str, megabytes: int = 1) -> Transformation:
    out = OutputPort("out", gives, rate_uhz=1_000_000, size_bytes=megabytes * 1_000_000)
    return Transformation(label, (InputPort("in", needs),), (out,), labor_us=1, host=host)


FILTER = step("filter", "base", needs="image", gives="objects")


def problem(library: list[Transformation], links: tuple[Link, ...] = ()) -> Problem:
    """The objects are wanted on the base; to carry a megabyte costs 10."""
    targets = (Target("seen", "objects", "objects", host="base"),)
    environment = Environment((), tuple(library), targets, hosts=(ROBOT, BASE, CLOUD), transfer_us=10, links=links)
    same = {tag: frozenset({tag}) for tag in ("image", "wide", "objects")}
    return Problem(environment, Similarity(same), horizon_s=1)


def first_units(asked: Problem) -> set[tuple[str, str | None]]:
    """The units of a first plan that is the best one, and their hosts."""
    found, best = first(asked), PLANNERS["cpsat"](asked)
    assert found.change_set is not None
    assert found.cost_us == best.cost_us
    return {(unit.transformation, unit.host) for unit in found.change_set.started}


def test_a_source_that_costs_more_is_taken_where_the_stream_of_the_cheaper_one_costs_more_to_carry() -> None:
    far, near = source("far", "robot", megabytes=9, labor_us=1), source("near", "base", megabytes=9, labor_us=50)
    assert first_units(problem([far, near, FILTER])) == {("near", "base"), ("filter", "base")}


def test_a_unit_whose_output_is_larger_than_its_input_is_where_the_output_is_needed() -> None:
    camera = source("camera", "robot", megabytes=1, labor_us=1)
    widen = step("widen", needs="image", gives="wide", megabytes=9)
    detect = step("detect", "base", needs="wide", gives="objects")
    units = {("camera", "robot"), ("widen", "base"), ("detect", "base")}
    assert first_units(problem([camera, widen, detect])) == units


def test_a_link_with_a_price_of_its_own_says_which_way_is_cheap() -> None:
    cameras = [source("a", "robot", megabytes=1, labor_us=1), source("b", "cloud", megabytes=1, labor_us=1)]
    toll = (Link(("robot", "base"), price_us=900),)
    assert first_units(problem([*cameras, FILTER], toll)) == {("b", "cloud"), ("filter", "base")}


def test_a_target_that_wants_a_unit_does_not_hide_the_streams_of_that_unit() -> None:
    """Their demands are one fact: the same transformations meet both."""
    asked = problem([source("camera", "robot", megabytes=1, labor_us=1), FILTER])
    wanted = (*asked.environment.targets, Target("a camera", run="camera"))
    candidates = Candidates(replace(asked, environment=replace(asked.environment, targets=wanted)))
    assert PlacedNetwork(candidates).cheap_plan(0) == {0: "robot", 1: "base"}


@some
@given(fleets(frozenset({*Feature}), most=6), st.integers(0, 4))
def test_each_candidate_is_on_one_of_its_hosts(asked: Problem, attempts: int) -> None:
    candidates = Candidates(asked)
    if asked.environment.hosts and len(candidates.network.targets) == len(asked.environment.targets):
        for index, host in PlacedNetwork(candidates).cheap_plan(attempts).items():
            assert candidates.all[index].may_run
            assert host in candidates.all[index].places


def test_a_transformation_with_one_new_unit_is_on_one_host() -> None:
    candidates = Candidates(generated("fleet", 7344, transformations=60, hosts=3).problem)
    network = PlacedNetwork(candidates)
    twice = [network.units.index((index, host)) for index, host in network.units[:6]]
    host_of, too_many = network._hosts(twice)
    of_each = Counter(candidates.all[index].transformation.label for index in host_of)
    assert len(too_many) == 6 - len(host_of) > 0
    assert set(of_each.values()) == {1}
    cheap = Counter(candidates.all[index].transformation.label for index in network.cheap_plan(30))
    assert set(cheap.values()) == {1}


def test_cheap_attempts_come_before_the_plan_that_pays_for_what_it_carries(monkeypatch: pytest.MonkeyPatch) -> None:
    """A core of all units on all hosts may take longer than a short time limit allows."""

    def is_too_late(_: Candidates) -> None:
        raise OutOfTimeError

    monkeypatch.setattr(first_plans, "PlacedNetwork", is_too_late)
    asked, costs_us = generated("fleet", 1, transformations=60, hosts=3).problem, list[int]()
    for attempts in (0, 30):
        state = SolveState(asked, Clock(), None)
        with pytest.raises(OutOfTimeError):
            FirstPlans(Candidates(asked), state).look(attempts)
        costs_us.append(state.plan().cost_us or 0)
    assert costs_us[1] < costs_us[0]


def test_first_plans_of_fleets_cost_little_more_than_the_best() -> None:
    ratios = []
    for seed in range(5100, 5110):
        asked = generated("fleet", seed, transformations=60, hosts=3).problem
        found, best = first(asked), PLANNERS["cpsat"](asked)
        assert found.cost_us is not None
        assert best.cost_us is not None
        ratios.append(found.cost_us / best.cost_us)
    assert mean(ratios) < 1.25
