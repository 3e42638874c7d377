"""Corner cases against the oracle: nothing is wanted, nothing fits, nothing may be paid, something feeds itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import pytest
from fixed import PLAIN_OUTPUT, kind, unit, world
from kinds import differences
from worlds import oracle_of

from cfgplan.domain import ALL, Host, Objective, OutputPort, Target
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planning import Failures, Problem
from cfgplan.qualities import Better, Contribution, QualityAttribute, QualityRule, Wish

SOURCE, SINK, OTHER = kind("s", "", "A", 3), kind("k", "A", "B", 2), kind("o", "", "A", 9)
BOTH = (unit("s"), unit("k", "s.1/x0", topic="B"))
LOOP, RING = kind("l", "A", "A"), kind("f", "BA", "B", feedback=(0,))


def without_targets() -> Iterator[Problem]:
    for units in ((), BOTH[:1], (unit("s"), unit("k", "s.1/x0"))):
        for more in ({}, {"pinned": True}, {"required": True}, {"min_instances": 2}, {"standby_us": 1}):
            for survive in (None, Failures.UNITS):
                yield world("", replace(SOURCE, **more), SINK, units=units, survive=survive)


def two_targets_of_one_stream() -> Iterator[Problem]:
    targets = (Target("a", "A", "/a"), Target("b", "A", "/b"))
    for serves, most, units in product((None, 1, 2), (None, 1, 2), ((), (unit("s", topic="a"),))):
        output = replace(SOURCE.outputs[0], serves=serves)
        yield world(targets, replace(SOURCE, outputs=(output,), max_instances=most), units=units)


def costs_that_are_allowed() -> Iterator[Problem]:
    orders = ((Objective.COST,), (Objective.UNITS,), (Objective.REWIRED, Objective.COST), (Objective.STARTED,))
    for horizon_s, most_us, minimise, units in product((0, 1), (0, 1, 4, 5), orders, ((), BOTH)):
        source = replace(SOURCE, upkeep_us=2)
        problem = world("B", source, SINK, units=units, horizon_s=horizon_s, minimise=minimise)
        yield replace(problem, max_cost_us=most_us)


def who_feeds_itself() -> Iterator[Problem]:
    firsts = ({}, {"count": 2}, {"count": ALL, "optional": True}, {"optional": True}, {"optional": True, "worth_us": 9})
    for first, feedback, pinned in product(firsts, ((), (0,)), (False, True)):
        loop = replace(kind("l", "A", "A", feedback=feedback, first=first), pinned=pinned)
        for units in ((), (unit("l", "l.1/x0", topic="A"),)):
            yield world("A", loop, units=units)
            yield world("A", loop, SOURCE, units=units)


def rings_that_are_pinned_and_required() -> Iterator[Problem]:
    fed = ("f.1/x0", "k.1/x0")
    running = [(), *((unit("s"), unit("k", "s.1/x0"), unit("f", stream, "s.1/x0", topic="B")) for stream in fed)]
    for pinned, required, units in product((False, True), (False, True), running):
        yield world("B", SOURCE, SINK, replace(RING, pinned=pinned, required=required), units=units)
        yield world("B", replace(SOURCE, required=required), replace(SINK, pinned=pinned), RING, units=units)


def hosts_without_room() -> Iterator[Problem]:
    large, small = replace(SOURCE, memory_mb=10, standby_us=1), replace(SINK, memory_mb=1, upkeep_us=1)
    none, little, enough = Host("h0", memory_mb=0), Host("h0", memory_mb=10, rent_us=5), Host("h1", memory_mb=99)
    for hosts in ((none,), (little,), (none, enough), (little, enough)):
        for survive, is_running in product((None, Failures.UNITS, Failures.HOSTS), (False, True)):
            units = tuple(replace(one, host="h0") for one in BOTH) if is_running else ()
            yield world("B", large, small, hosts=hosts, units=units, survive=survive)
        yield world("", replace(large, min_instances=1), hosts=hosts)
        yield world("B", replace(large, pinned=True), small, hosts=hosts, units=(unit("s", host="gone"),))
        yield world("B", replace(large, required=True), OTHER, small, hosts=hosts)


def more_streams_than_there_may_be() -> Iterator[Problem]:
    for count, most, flag, survive in product((1, 2, 3), (0, 1, 2), (False, True), (None, Failures.UNITS)):
        source = replace(SOURCE, max_instances=most, pinned=flag)
        units = (unit("s"), unit("s", number=2)) if flag else ()
        sink = replace(kind("k", "A", "B", 2, first={"count": count}), required=flag, max_instances=2)
        yield world("B", source, sink, units=units, survive=survive)
        if survive is None:
            distinct = kind("k", "AA", "B", 2, distinct=(0, 1), first={"count": count})
            yield world("B", source, OTHER, distinct, units=units)


def scales_whose_worst_is_their_best() -> Iterator[Problem]:
    stated = OutputPort("x", "", (Contribution("f", QualityRule.ADD, 0), Contribution("e", QualityRule.ADD, 3)))
    for at, bound, weight_us in product((0, 7), (None, 0, 7), (0, 1, 10**6)):
        flat = QualityAttribute("f", Better.LOWER, worst=at, best=at)
        wishes = (Wish("f", bound, weight_us), Wish("e", 3, 1))
        for output, units in product((PLAIN_OUTPUT, stated), ((), BOTH)):
            sink = kind("k", "A", "B", 2, output=output)
            target = Target("B", "B", "/B", quality=wishes if bound is not None or weight_us else wishes[1:])
            steep = QualityAttribute("e", Better.LOWER, worst=20)
            yield world((target,), SOURCE, sink, units=units, qualities=(flat, steep))


def pins_that_conflict() -> Iterator[Problem]:
    quality = QualityAttribute("q", Better.LOWER, worst=100)
    target = Target("B", "B", "/B", quality=(Wish("q", None, 1),))
    dear = kind("d", "", "B", 5)
    for both, clash in product((False, True), ({"conflicts": ("p",)}, {"conflicts_on_host": ("p",)})):
        kept, other = kind("p", "", "", pinned=True), kind("o", "", "B", pinned=both, **clash)
        for units in ((unit("p"),), (unit("p"), unit("o", topic="B"))):
            yield world((target,), kept, other, units=units, qualities=(quality,))
            yield world((target,), kept, other, dear, units=units, qualities=(quality,))


def company_that_feeds_itself() -> Iterator[Problem]:
    """The companions of which one is needed need each other, or another that they run with."""
    for serves, count, units in product((None, 1), (2, 3), ((), (unit("t1"),))):
        output = OutputPort("x", "", serves=serves)
        library = (
            kind("t0", "", "A", beside=("t2",), output=output),
            kind("t1", "A", "A", first={"count": count}),
            kind("t2", beside=("t3",)),
            kind("t3", "", "A", beside=("t1",)),
        )
        yield world("A", *library, units=units)
    for count, required in product((ALL, 2), (False, True)):
        cycle = kind("t2", "A", "A", feedback=(0,), first={"count": count})
        taker = kind("t4", "A", "A", first={"count": 2}, required=required)
        yield world("A", kind("t0", "", "A", beside=("t2",)), cycle, taker)


@pytest.mark.parametrize(
    "corner",
    [
        company_that_feeds_itself,
        pins_that_conflict,
        scales_whose_worst_is_their_best,
        without_targets,
        two_targets_of_one_stream,
        costs_that_are_allowed,
        who_feeds_itself,
        rings_that_are_pinned_and_required,
        hosts_without_room,
        more_streams_than_there_may_be,
    ],
)
@pytest.mark.parametrize("tuning", [USUAL, Tuning.solver_only()], ids=["usual", "solver only"])
def test_a_corner_is_planned_as_the_oracle_does(corner: Callable[[], Iterator[Problem]], tuning: Tuning) -> None:
    for problem in corner():
        assert not differences(problem, PlannerSession(tuning).plan(problem), oracle_of(problem)), problem
