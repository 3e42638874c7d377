"""Each rule of the paper by itself, in every model that knows it: allowed and forbidden solutions."""

from __future__ import annotations

from dataclasses import replace

import pytest
from fixed import (
    PLAIN_OUTPUT,
    Apart,
    Explained,
    Hubs,
    WithoutTwins,
    feeds,
    kind,
    publishes,
    rewired,
    runs,
    unit,
    uses,
    world,
)

from cfgplan.domain import ALL, ComputationUnit, Target, Transformation
from cfgplan.planning import Problem

every_model = pytest.mark.parametrize("model", [Hubs, Apart])

SOURCE, OTHER, FILTER = kind("s", gives="A"), kind("t", gives="A"), kind("f", "A", "B")


@every_model
def test_a_running_unit_is_fed(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, FILTER))
    assert fixed.allows(runs("f.1"), runs("s.1"))
    assert not fixed.allows(runs("f.1"), ~runs("s.1"))


@every_model
def test_every_input_of_a_running_unit_is_fed(model: type[Hubs]) -> None:
    fixed = model(world("C", SOURCE, kind("b", gives="B"), kind("f", "AB", "C")))
    assert fixed.allows(runs("s.1"), runs("b.1"))
    assert not fixed.allows(~runs("s.1"))
    assert not fixed.allows(~runs("b.1"))


@every_model
def test_a_target_is_met(model: type[Hubs]) -> None:
    fixed = model(world("A", SOURCE, OTHER))
    assert fixed.allows(runs("s.1"), ~runs("t.1"))
    assert not fixed.allows(~runs("s.1"), ~runs("t.1"))


@every_model
def test_one_unit_publishes_a_target(model: type[Hubs]) -> None:
    fixed = model(world("A", SOURCE, OTHER, units=(unit("s"), unit("t"))))
    assert fixed.allows(publishes("s.1", "A"), ~publishes("t.1", "A"))
    assert not fixed.allows(publishes("s.1", "A"), publishes("t.1", "A"))
    assert not fixed.allows(~publishes("s.1", "A"), ~publishes("t.1", "A"), ~runs("s.2"), ~runs("t.2"))


@every_model
def test_who_publishes_a_target_runs(model: type[Hubs]) -> None:
    fixed = model(world("A", SOURCE, OTHER, units=(unit("s"), unit("t"))))
    assert fixed.allows(publishes("s.1", "A"), runs("s.1"))
    assert not fixed.allows(publishes("s.1", "A"), ~runs("s.1"))


@every_model
def test_units_that_feed_each_other_need_something_from_outside(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, kind("f", "A", "B"), kind("back", "B", "A")))
    assert fixed.allows(runs("f.1"), runs("s.1"))
    assert not fixed.allows(runs("f.1"), runs("back.1"), ~runs("s.1"))


@every_model
def test_a_unit_does_not_feed_itself(model: type[Hubs]) -> None:
    fixed = model(world("A", SOURCE, kind("loop", "A", "A")))
    assert fixed.allows(runs("s.1"), runs("loop.1"))
    assert not fixed.allows(runs("loop.1"), ~runs("s.1"))


@pytest.mark.parametrize("model", [Hubs, Apart, Explained])
def test_three_units_in_a_ring_need_something_from_outside(model: type[Hubs]) -> None:
    cycle = (kind("one", "A", "B"), kind("two", "B", "C"), kind("three", "C", "A"))
    fixed = model(world("C", SOURCE, *cycle))
    assert fixed.allows(runs("s.1"))
    assert not fixed.allows(~runs("s.1"))


@every_model
def test_a_feedback_input_may_close_a_ring(model: type[Hubs]) -> None:
    fixed = model(world("B", kind("f", "C", "B", feedback=[0]), kind("g", "B", "C"), kind("h", gives="C")))
    assert fixed.allows(runs("f.1"), runs("g.1"), ~runs("h.1"))
    assert not fixed.allows(~runs("g.1"), ~runs("h.1"))


@every_model
def test_a_feedback_input_is_fed_by_what_runs(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, kind("f", "AC", "B", feedback=[1]), kind("g", "B", "C"), kind("c", gives="C")))
    assert fixed.allows(runs("f.1"), runs("g.1"))
    assert not fixed.allows(runs("f.1"), ~runs("g.1"), ~runs("c.1"))


@every_model
def test_inputs_of_a_group_are_fed_by_different_transformations(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, OTHER, kind("f", "AA", "B", distinct=[0, 1])))
    assert fixed.allows(runs("s.1"), runs("t.1"))
    assert not fixed.allows(~runs("t.1"))


@every_model
def test_two_units_of_one_transformation_do_not_feed_one_group(model: type[Hubs]) -> None:
    fixed = model(
        world("B", SOURCE, OTHER, kind("f", "AA", "B", distinct=[0, 1]), units=(unit("s"), unit("s", number=2)))
    )
    assert fixed.allows(runs("s.1"), runs("t.1"))
    assert not fixed.allows(runs("s.1"), runs("s.2"), ~runs("t.1"))


@every_model
def test_inputs_of_no_group_may_be_fed_by_one_unit(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, OTHER, kind("f", "AAA", "B", distinct=[0, 1])))
    assert fixed.allows(feeds("s.1", "f.1/in0"), feeds("t.1", "f.1/in1"), runs("f.1"))
    assert model(world("B", SOURCE, OTHER, kind("f", "AA", "B"))).allows(~runs("t.1"))
    assert model(world("B", SOURCE, OTHER, kind("f", "AA", "B", distinct=[0]))).allows(~runs("t.1"))


@every_model
def test_an_input_has_one_feeder(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, OTHER, kind("u", gives="A"), kind("f", "AA", "B", distinct=[0, 1])))
    assert fixed.allows(feeds("s.1", "f.1/in0"), feeds("t.1", "f.1/in1"))
    assert not fixed.allows(feeds("s.1", "f.1/in0"), feeds("u.1", "f.1/in0"))
    assert not fixed.allows(*(~feeds(feeder, "f.1/in0") for feeder in ("s.1", "t.1", "u.1")))


@every_model
def test_a_distinct_feedback_input_is_fed_by_what_runs(model: type[Hubs]) -> None:
    f = kind("f", "AC", "B", distinct=[0, 1], feedback=[1])
    fixed = model(world("B", SOURCE, f, kind("g", "B", "C"), kind("c", gives="C")))
    assert fixed.allows(feeds("g.1", "f.1/in1"), runs("g.1"))
    assert not fixed.allows(feeds("g.1", "f.1/in1"), ~runs("g.1"))
    assert not fixed.allows(feeds("s.1", "f.1/in0"), ~runs("s.1"))


@every_model
def test_a_pinned_unit_is_kept(model: type[Hubs]) -> None:
    def pinned(is_pinned: bool) -> Transformation:
        return kind("p", "A", "C", pinned=is_pinned)

    fixed = model(world("B", SOURCE, FILTER, pinned(True), units=(unit("p", "s.1/x0"),)))
    assert fixed.allows(runs("p.1"))
    assert not fixed.allows(~runs("p.1"))
    assert model(world("B", SOURCE, FILTER, pinned(False), units=(unit("p", "s.1/x0"),))).allows(~runs("p.1"))
    assert model(world("B", SOURCE, FILTER, pinned(True))).allows(~runs("p.1"))


KEPT = (unit("s"), unit("t"), unit("f", "s.1/x0", topic="B"))


@every_model
def test_a_unit_that_is_not_rewired_keeps_its_feeders(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, OTHER, FILTER, units=KEPT))
    assert fixed.allows(runs("f.1"), ~rewired("f.1"), runs("s.1"))
    assert not fixed.allows(runs("f.1"), ~rewired("f.1"), ~runs("s.1"))
    assert fixed.allows(rewired("f.1"), ~runs("s.1"))


@every_model
def test_a_unit_that_is_not_rewired_keeps_its_feedback_feeders(model: type[Hubs]) -> None:
    f = kind("f", "AC", "B", feedback=[1])
    units = (unit("s"), unit("f", "s.1/x0", "g.1/x0", topic="B"), unit("g", "f.1/x0"), unit("c"))
    fixed = model(world("B", SOURCE, f, kind("g", "B", "C"), kind("c", gives="C"), units=units))
    assert fixed.allows(runs("f.1"), ~rewired("f.1"), runs("g.1"))
    assert not fixed.allows(runs("f.1"), ~rewired("f.1"), ~runs("g.1"))
    assert fixed.allows(rewired("f.1"), ~runs("g.1"))


@every_model
def test_a_unit_that_is_not_rewired_keeps_its_topics(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, FILTER, kind("g", gives="B"), units=(*KEPT[::2], unit("g"))))
    assert fixed.allows(runs("f.1"), ~rewired("f.1"), publishes("f.1", "B"))
    assert not fixed.allows(runs("f.1"), ~rewired("f.1"), ~publishes("f.1", "B"))
    assert not fixed.allows(runs("g.1"), ~rewired("g.1"), publishes("g.1", "B"))
    assert fixed.allows(rewired("g.1"), publishes("g.1", "B"))


@every_model
@pytest.mark.parametrize(
    "broken",
    [
        unit("f", "", topic="B"),
        unit("f", "gone.1/x0", topic="B"),
        unit("f", "b.1/x0", topic="B"),
        unit("f", "s.1/x0", topic="stale"),
        unit("f", "s.1/none", topic="B"),
    ],
    ids=["gap", "dead feeder", "unfit feeder", "stale topic", "no such output"],
)
def test_a_unit_whose_wiring_is_broken_is_rewired_or_stopped(model: type[Hubs], broken: ComputationUnit) -> None:
    units = (unit("s"), unit("b"), broken)
    fixed = model(world("BC", SOURCE, FILTER, kind("b", gives="C"), kind("g", gives="B"), units=units))
    assert fixed.allows(rewired("f.1"))
    assert fixed.allows(~runs("f.1"))
    assert not fixed.allows(runs("f.1"), ~rewired("f.1"))


@every_model
def test_units_that_feed_each_other_can_not_all_stay_as_they_are(model: type[Hubs]) -> None:
    cycle = (unit("f", "back.1/x0", topic="B"), unit("back", "f.1/x0"), unit("s"))
    fixed = model(world("B", SOURCE, FILTER, kind("back", "B", "A"), units=cycle))
    assert fixed.allows(rewired("f.1"), runs("s.1"))
    assert not fixed.allows(runs("f.1"), ~rewired("f.1"), runs("back.1"), ~rewired("back.1"))


@every_model
def test_a_stopped_unit_is_not_rewired(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, FILTER, kind("g", gives="B"), units=KEPT[::2]))
    assert fixed.allows(~runs("f.1"), ~rewired("f.1"))
    assert not fixed.allows(~runs("f.1"), rewired("f.1"))


@every_model
def test_a_unit_that_stays_keeps_who_feeds_it_where_that_matters(model: type[Hubs]) -> None:
    source, f = kind("s", gives="A", required=True), kind("f", "A", "B")
    fixed = model(world("B", source, OTHER, f, units=KEPT))
    assert fixed.allows(~rewired("f.1"), feeds("s.1", "f.1/in0"))
    assert not fixed.allows(~rewired("f.1"), feeds("t.1", "f.1/in0"))


@every_model
def test_one_rewired_unit_outweighs_all_started_ones(model: type[Hubs]) -> None:
    units = (unit("f", "gone.1/x0", topic="B"), unit("b"))
    fixed = model(
        world("B", SOURCE, FILTER, kind("g", "CD", "B"), kind("c", gives="C"), kind("d", gives="D"), units=units)
    )
    by_rewiring = fixed.fewest_changes(rewired("f.1"))
    by_starting = fixed.fewest_changes(~runs("f.1"), runs("g.1"))
    assert by_rewiring is not None and by_starting is not None
    assert by_starting < by_rewiring


@every_model
def test_started_units_count_one_by_one(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, FILTER, kind("g", gives="B")))
    assert fixed.fewest_changes(~runs("g.1")) == 2
    assert fixed.fewest_changes() == 1


@every_model
def test_a_started_unit_costs_labor_and_upkeep_and_a_running_one_upkeep(model: type[Hubs]) -> None:
    source, f = kind("s", gives="A", labor_us=7, upkeep_us=2), kind("f", "A", "B", labor_us=5, upkeep_us=3)
    assert model(world("B", source, f, horizon_s=10)).least_us() == 7 + 5 + 10 * (2 + 3)
    assert model(world("B", source, f, horizon_s=10, units=(unit("s"),))).least_us(runs("s.1")) == 5 + 10 * (2 + 3)


@every_model
def test_a_required_transformation_is_used_if_it_feeds_the_way_to_a_target(model: type[Hubs]) -> None:
    source = kind("s", gives="A", required=True)
    fixed = model(world("B", source, OTHER, FILTER))
    assert fixed.allows(uses("s"), feeds("s.1", "f.1/in0"))
    assert not fixed.allows(uses("s"), feeds("t.1", "f.1/in0"))
    assert not fixed.allows(uses("s"), ~runs("s.1"))


@every_model
def test_a_required_transformation_is_used_where_it_publishes(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", required=True), OTHER))
    assert fixed.allows(uses("s"), publishes("s.1", "A"))
    assert not fixed.allows(uses("s"), ~publishes("s.1", "A"))


@every_model
def test_a_required_transformation_is_not_used_by_a_unit_that_serves_no_target(model: type[Hubs]) -> None:
    dead_end = kind("e", "A", "A")
    fixed = model(world("B", kind("s", gives="A", required=True), OTHER, FILTER, dead_end))
    assert fixed.allows(uses("s"), feeds("s.1", "e.1/in0"), feeds("e.1", "f.1/in0"))
    assert not fixed.allows(uses("s"), feeds("s.1", "e.1/in0"), feeds("t.1", "f.1/in0"))


@every_model
def test_units_do_not_serve_through_each_other_s_feedback_inputs(model: type[Hubs]) -> None:
    one, two = kind("one", "C", "AC", feedback=[0], required=True), kind("two", "C", "C", feedback=[0])
    fixed = model(world("B", one, two, OTHER, FILTER))
    assert fixed.allows(uses("one"), feeds("one.1", "f.1/in0"))
    assert not fixed.allows(
        uses("one"), feeds("one.1", "two.1/in0"), feeds("two.1", "one.1/in0"), feeds("t.1", "f.1/in0")
    )


def test_of_new_units_alike_one_runs() -> None:
    fixed = WithoutTwins(world("B", SOURCE, OTHER, FILTER))
    assert fixed.allows(runs("s.1"), ~runs("t.1"))
    assert not fixed.allows(runs("s.1"), runs("t.1"))
    assert Hubs(world("B", SOURCE, OTHER, FILTER)).allows(runs("s.1"), runs("t.1"))


@pytest.mark.parametrize(
    "problem",
    [
        world("BC", SOURCE, OTHER, kind("f", "AA", "B", distinct=[0, 1]), kind("g", gives="C")),
        world("B", kind("s", gives="A", required=True), OTHER, FILTER),
        world("B", SOURCE, OTHER, FILTER, units=(unit("s"), unit("t"))),
        world("BC", kind("s", gives="AC"), OTHER, FILTER),
        world("B", SOURCE, kind("t", gives="A", min_instances=1), FILTER),
    ],
    ids=["distinct", "required", "running", "one offers more", "one is asked for"],
)
def test_units_that_may_differ_are_not_alike(problem: Problem) -> None:
    assert WithoutTwins(problem).allows(runs("s.1"), runs("t.1"))


def test_a_landmark_is_hit_as_often_as_it_says() -> None:
    class Landmark(Hubs):
        least = 1

        def build(self):  # type: ignore[no-untyped-def]
            cp = super().build()
            self.model.enough_of_each_run([(["s", "t"], self.least)])
            return cp

    fixed = Landmark(world("C", SOURCE, OTHER, FILTER, kind("c", gives="C"), kind("d", "B", "C")))
    assert fixed.allows(runs("s.1"), ~runs("t.1"))
    assert not fixed.allows(~runs("s.1"), ~runs("t.1"))
    fixed.least = 2
    assert fixed.allows(runs("s.1"), runs("t.1"))
    assert not fixed.allows(runs("s.1"), ~runs("t.1"))


@every_model
def test_an_input_takes_its_number_of_streams_of_different_units(model: type[Hubs]) -> None:
    both = kind("f", "A", "B", first={"count": 2})
    fixed = model(world("B", SOURCE, OTHER, kind("u", gives="AA", max_instances=1), both))
    assert fixed.allows(feeds("s.1", "f.1/in0"), feeds("t.1", "f.1/in0"))
    assert not fixed.allows(feeds("s.1", "f.1/in0"), feeds("t.1", "f.1/in0"), feeds("u.1", "f.1/in0"))
    alone = model(world("B", kind("u", gives="AA", max_instances=1), both))
    assert not alone.allows()
    assert model(world("B", SOURCE, kind("f", "A", "B", first={"count": 2}))).allows(runs("s.2"))
    assert not model(
        world("B", kind("s", gives="A", max_instances=1), kind("f", "A", "B", first={"count": 2}))
    ).allows()


@every_model
def test_each_of_several_streams_is_grounded(model: type[Hubs]) -> None:
    cycle = kind("r", "B", "A")
    fixed = model(world("B", SOURCE, cycle, kind("f", "A", "B", first={"count": 2})))
    assert fixed.allows(feeds("s.1", "f.1/in0"), feeds("s.2", "f.1/in0"))
    assert not fixed.allows(feeds("r.1", "f.1/in0"))


@every_model
def test_an_input_that_takes_all_takes_what_runs(model: type[Hubs]) -> None:
    fixed = model(world("BA", SOURCE, OTHER, kind("f", "A", "B", first={"count": ALL})))
    assert fixed.allows(runs("s.1"), runs("t.1"), feeds("s.1", "f.1/in0"), feeds("t.1", "f.1/in0"))
    assert not fixed.allows(runs("s.1"), runs("t.1"), ~feeds("t.1", "f.1/in0"))
    cycle = model(world("BA", SOURCE, kind("f", "A", "BD", first={"count": ALL}), kind("g", "D", "A")))
    assert cycle.allows(runs("f.1"), ~runs("g.1"))
    assert not cycle.allows(runs("f.1"), runs("g.1"))


@every_model
def test_an_optional_input_may_stay_unfed_at_its_price(model: type[Hubs]) -> None:
    fixed = model(world("B", SOURCE, kind("f", "A", "B", first={"optional": True, "worth_us": 5})))
    assert fixed.least_us(runs("s.1"), feeds("s.1", "f.1/in0")) == 2
    assert fixed.least_us(~runs("s.1")) == 6
    assert not model(world("B", SOURCE, kind("f", "A", "B"))).allows(~runs("s.1"))


@every_model
def test_an_input_that_starts_nothing_is_fed_by_what_runs_anyway(model: type[Hubs]) -> None:
    f = kind("f", "A", "B", first={"optional": True})
    assert not model(world("B", SOURCE, f)).allows(feeds("s.1", "f.1/in0"))
    assert model(world("B", SOURCE, f)).allows(~runs("s.1"))
    for fixed in (model(world("BA", SOURCE, f)), model(world("B", kind("s", gives="A", min_instances=1), f))):
        assert fixed.allows(feeds("s.1", "f.1/in0"))
        assert not fixed.allows(~feeds("s.1", "f.1/in0"))


@every_model
def test_an_input_that_starts_nothing_is_unfed_where_it_would_close_a_cycle(model: type[Hubs]) -> None:
    f = kind("f", "C", "A", first={"optional": True})
    fixed = model(world("BC", f, kind("g", "A", "B"), kind("h", "B", "C"), kind("c", gives="C")))
    assert fixed.allows(~runs("c.1"), ~feeds("h.1", "f.1/in0"))
    assert not fixed.allows(feeds("h.1", "f.1/in0"))
    assert not fixed.allows(runs("c.1"), publishes("c.1", "C"), ~feeds("c.1", "f.1/in0"))


@every_model
def test_a_stream_serves_no_more_inputs_and_topics_than_it_may(model: type[Hubs]) -> None:
    scarce = kind("s", gives="A", output=replace(PLAIN_OUTPUT, serves=1))
    fixed = model(world("BC", scarce, OTHER, FILTER, kind("g", "A", "C")))
    assert fixed.allows(feeds("s.1", "f.1/in0"), feeds("t.1", "g.1/in0"))
    assert not fixed.allows(feeds("s.1", "f.1/in0"), feeds("s.1", "g.1/in0"))
    assert not model(world("AB", scarce, FILTER)).allows()
    assert model(world("AB", kind("s", gives="A", output=replace(PLAIN_OUTPUT, serves=2)), FILTER)).allows()


@every_model
def test_an_input_that_starts_nothing_is_unfed_where_what_could_feed_it_is_taken(model: type[Hubs]) -> None:
    scarce = kind("s", gives="A", output=replace(PLAIN_OUTPUT, serves=1))
    fixed = model(world("AB", scarce, kind("f", "A", "B", first={"optional": True})))
    assert fixed.allows(~feeds("s.1", "f.1/in0"))
    assert not fixed.allows(feeds("s.1", "f.1/in0"))


@every_model
def test_a_service_closes_a_cycle(model: type[Hubs]) -> None:
    assert model(world("B", kind("f", "C", "B", first={"service": True}), kind("g", "B", "C"))).allows()
    assert not model(world("B", kind("f", "C", "B"), kind("g", "B", "C"))).allows()


@every_model
def test_a_unit_runs_that_a_target_wants_and_what_feeds_it(model: type[Hubs]) -> None:
    fixed = model(world((Target("t", run="f"),), SOURCE, kind("f", "A")))
    assert fixed.allows(runs("f.1"), runs("s.1"))
    assert not fixed.allows(~runs("f.1"))
    assert not model(world((Target("t", run="f"),), kind("f", "A"), kind("g", "B", "A"), kind("h", "A", "B"))).allows()


@every_model
def test_of_units_that_run_the_first_makes_what_feeds_it_serve_a_target(model: type[Hubs]) -> None:
    library = SOURCE, kind("r", gives="A", required=True), kind("f", "A", min_instances=2, max_instances=2)
    fixed = model(world((Target("t", run="f"),), *library))
    assert fixed.allows(feeds("r.1", "f.1/in0"), feeds("s.1", "f.2/in0"), uses("r"))
    assert not fixed.allows(feeds("s.1", "f.1/in0"), uses("r"))
