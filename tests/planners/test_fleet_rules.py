"""Each rule beyond the paper by itself, in every model that knows it: what it allows, and what it forbids."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from alone import search_alone
from fixed import Apart, Explained, Hubs, kind, on, publishes, rewired, runs, unit, waits, world

from cfgplan.domain import Host, Link, OutputPort, Stream, Target, Transformation
from cfgplan.figures import qualities_of_targets
from cfgplan.planners import PLANNERS
from cfgplan.planning import Failures, Problem, Status
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish
from cfgplan.validity import plan_violations

every_model = pytest.mark.parametrize("model", [Apart, Hubs])

TWO = (Host("h0"), Host("h1"))
STREAM = OutputPort("x", "", (), 1_000_000, 1_000_000)  # a megabyte each second


def placed(*hosts: Host, wanted: str | tuple[Target, ...] = "B", **more: object) -> Problem:
    library = (kind("s", gives="A", output=STREAM, **more), kind("f", "A", "B", output=STREAM, **more))
    return world(wanted, *library, hosts=hosts, transfer_us=100)


@every_model
def test_a_unit_is_on_one_host(model: type[Hubs]) -> None:
    fixed = model(placed(*TWO))
    assert fixed.allows(on("s.1", "h0"))
    assert fixed.allows(on("s.1", "h1"), ~on("s.1", "h0"))
    assert not fixed.allows(on("s.1", "h0"), on("s.1", "h1"))
    assert not fixed.allows(~on("s.1", "h0"), ~on("s.1", "h1"))


@every_model
def test_a_unit_is_on_a_host_that_its_transformation_allows(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", hosts=("h0", "h2")), hosts=(*TWO, Host("h2"))))
    assert fixed.allows(on("s.1", "h2"))
    assert not fixed.allows(on("s.1", "h1"))


@every_model
def test_a_unit_is_on_a_host_that_its_selector_fits(model: type[Hubs]) -> None:
    hosts = (Host("h0", labels=("robot", "spot")), Host("h1", labels=("robot",)), Host("h2"))
    fixed = model(world("A", kind("s", gives="A", on="robot and not spot or h2"), hosts=hosts))
    assert fixed.allows(on("s.1", "h1"))
    assert fixed.allows(on("s.1", "h2"))
    assert not fixed.allows(on("s.1", "h0"))


@every_model
def test_a_running_unit_stays_on_its_host(model: type[Hubs]) -> None:
    library = (kind("s", gives="A"), kind("t", gives="A"))
    fixed = model(world("A", *library, hosts=TWO, units=(unit("s", host="h1"),)))
    assert fixed.allows(on("s.1", "h1"))
    assert not fixed.allows(on("s.1", "h0"))


@every_model
@pytest.mark.parametrize(
    ("small", "takes"),
    [
        (Host("h0", cpu_us=5), {"upkeep_us": 3}),
        (Host("h0", memory_mb=5), {"memory_mb": 3}),
        (Host("h0", offers={"gpu": 5}), {"needs": {"gpu": 3}}),
        (Host("h0", energy=5), {"needs": {"power": 3}}),
        (Host("h0", energy=50, offers={"power": 5}), {"needs": {"power": 3}}),
    ],
)
def test_a_host_bears_its_units(model: type[Hubs], small: Host, takes: dict[str, Any]) -> None:
    fixed = model(placed(small, Host("h1", offers={"gpu": 6}), **takes))
    assert fixed.allows(on("s.1", "h0"), on("f.1", "h1"))
    assert fixed.allows(on("s.1", "h1"), on("f.1", "h1"))
    assert not fixed.allows(on("s.1", "h0"), on("f.1", "h0"))


@every_model
@pytest.mark.parametrize(("energy", "is_enough"), [(39, False), (40, True), (None, True)])
def test_energy_lasts_for_the_horizon(model: type[Hubs], energy: int | None, is_enough: bool) -> None:
    fixed = model(
        world("A", kind("s", gives="A", needs={"power": 4}), hosts=(Host("h0", energy=energy),), horizon_s=10)
    )
    assert fixed.allows(on("s.1", "h0")) == is_enough


@every_model
def test_a_host_is_paid_while_something_is_there(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", max_instances=2), kind("t", gives="A"))
    rented = (Host("h0", rent_us=3, speed=2 * MICRO), Host("h1", rent_us=50))
    fixed = model(world("A", *library, hosts=rented, horizon_s=10))
    assert fixed.least_us(on("s.1", "h0")) == 1 + 30
    assert fixed.least_us(on("s.1", "h0"), on("s.2", "h0")) == 2 + 30
    assert fixed.least_us(on("s.1", "h0"), on("s.2", "h1")) == 2 + 30 + 500
    running = model(world("A", *library, hosts=rented, horizon_s=10, units=(unit("s", topic="A", host="h1"),)))
    assert running.least_us(on("s.1", "h1"), ~on("t.1", "h0")) == 500
    assert running.least_us() == 1 + 30


def test_the_host_of_a_cold_spare_is_paid() -> None:
    fixed = Apart(
        world("A", kind("s", gives="A", standby_us=1), hosts=(TWO[0], Host("h1", rent_us=7)), survive=Failures.UNITS)
    )
    assert fixed.least_us(on("s.1", "h0"), waits("s.2"), on("s.2", "h1")) == 1 + 1 + 7


@every_model
def test_what_a_host_does_not_offer_it_has_not(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", needs={"gpu": 1}), hosts=(Host("h0"), Host("h1", offers={"gpu": 1}))))
    assert fixed.allows(on("s.1", "h1"))
    assert not fixed.allows(on("s.1", "h0"))


@pytest.mark.parametrize("takes", [{"upkeep_us": 3}, {"memory_mb": 3}, {"needs": {"gpu": 3}}])
def test_a_host_bears_its_cold_spares(takes: dict[str, Any]) -> None:
    source = kind("s", gives="A", standby_us=1, **takes)
    hosts = tuple(Host(name, 5, 5, {"gpu": 5}) for name in ("h0", "h1"))
    fixed = Apart(world("A", source, hosts=hosts, survive=Failures.UNITS))
    assert fixed.allows(waits("s.1"), on("s.1", "h0"), on("s.2", "h1"))
    assert not fixed.allows(waits("s.1"), on("s.1", "h0"), on("s.2", "h0"))


@every_model
def test_a_stream_is_carried_to_where_it_is_wanted(model: type[Hubs]) -> None:
    fixed = model(placed(*TWO))
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h0")) == 2
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h1")) == 2 + 100


@every_model
def test_a_stream_is_carried_to_a_unit_that_stays(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", labor_us=500, output=STREAM), kind("f", "A", "B", labor_us=500))
    units = (unit("s", host="h0"), unit("f", "s.1/x0", host="h1", topic="B"))
    fixed = model(world("B", *library, units=units, hosts=TWO, transfer_us=100))
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h1")) == 100


@every_model
def test_a_stream_is_carried_to_the_target_s_host(model: type[Hubs]) -> None:
    fixed = model(placed(*TWO, wanted=(Target("B", "B", "/B", host="h1"),)))
    assert fixed.least_us(on("s.1", "h1"), on("f.1", "h1")) == 2
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h0")) == 2 + 100


@every_model
def test_a_stream_is_carried_once_to_each_host(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", output=STREAM), kind("f", "A", "B"), kind("g", "AA", "C"), kind("h", "A", "D"))
    fixed = model(world("BCD", *library, hosts=(*TWO, Host("h2")), transfer_us=100))
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h1"), on("g.1", "h1"), on("h.1", "h1")) == 4 + 100
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h1"), on("g.1", "h1"), on("h.1", "h2")) == 4 + 200


ROUND = (Host("h0", labels=("robot",)), Host("h1", labels=("robot",)), Host("h2"))
RADIO = Link(("robot", "robot"), 1_500_000, 30)


@every_model
def test_the_first_link_that_joins_two_hosts_has_its_price(model: type[Hubs]) -> None:
    links = (RADIO, Link(("robot", "⊤"), None, 7), Link(("h2", "h0"), 0, 9))
    library = (kind("s", gives="A", output=STREAM), kind("f", "A", "B"))
    fixed = model(world("B", *library, hosts=ROUND, transfer_us=100, links=links))
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h1")) == 2 + 30
    assert fixed.least_us(on("s.1", "h1"), on("f.1", "h0")) == 2 + 30
    assert fixed.least_us(on("s.1", "h2"), on("f.1", "h0")) == 2 + 7
    assert fixed.least_us(on("s.1", "h0"), on("f.1", "h0")) == 2
    without = model(world("B", *library, hosts=ROUND, transfer_us=100, links=(RADIO,)))
    assert without.least_us(on("s.1", "h2"), on("f.1", "h0")) == 2 + 100


@every_model
def test_a_link_bears_no_more_than_its_bandwidth_over_all_its_hosts(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", output=STREAM), kind("t", gives="B", output=STREAM), kind("f", "AB", "C"))
    fixed = model(world("C", *library, hosts=ROUND, links=(RADIO,)))
    assert fixed.allows(on("s.1", "h0"), on("t.1", "h1"), on("f.1", "h1"))
    assert fixed.allows(on("s.1", "h2"), on("t.1", "h0"), on("f.1", "h1"))
    assert not fixed.allows(on("s.1", "h0"), on("t.1", "h0"), on("f.1", "h1"))
    narrow = model(world("C", *library, hosts=ROUND, links=(Link(("h0", "h1"), 999_999),)))
    assert not narrow.allows(on("s.1", "h0"), on("t.1", "h1"), on("f.1", "h1"))


@every_model
def test_what_does_not_run_is_not_carried(model: type[Hubs]) -> None:
    light = OutputPort("x", "", (), 1_000_000, 100_000)
    library = (
        kind("s", gives="A", output=STREAM, host="h0"),
        kind("t", gives="A", labor_us=500, output=light, host="h0"),
    )
    fixed = model(world("B", *library, kind("f", "A", "B", host="h1"), hosts=TWO, transfer_us=100))
    assert fixed.least_us() == 2 + 100


@every_model
def test_a_stream_is_not_carried_back_to_feed_itself(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A"), kind("loop", "A", "A"), hosts=TWO))
    assert fixed.allows(runs("s.1"))
    assert not fixed.allows(runs("loop.1"), ~runs("s.1"))


@every_model
def test_units_on_different_hosts_that_feed_each_other_need_something_from_outside(model: type[Hubs]) -> None:
    library = (kind("s", gives="A"), kind("f", "A", "B"), kind("back", "B", "A"))
    fixed = model(world("B", *library, hosts=TWO))
    assert fixed.allows(on("f.1", "h0"), on("back.1", "h1"), runs("s.1"))
    assert not fixed.allows(on("f.1", "h0"), on("back.1", "h1"), ~runs("s.1"))


@every_model
def test_a_pinned_unit_on_a_host_is_kept(model: type[Hubs]) -> None:
    library = (kind("s", gives="A"), kind("p", gives="B", pinned=True))
    fixed = model(world("A", *library, hosts=TWO, units=(unit("p", host="h0"),)))
    assert fixed.allows(runs("p.1"))
    assert not fixed.allows(~runs("p.1"))


@every_model
def test_units_that_conflict_are_not_there_together(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", conflicts=("t", "s")), kind("t", gives="A"), kind("u", gives="B", max_instances=2))
    fixed = model(world("AB", *library, kind("v", "B", "C")))
    assert fixed.allows(runs("s.1"), ~runs("t.1"))
    assert fixed.allows(runs("t.1"), ~runs("s.1"))
    assert not fixed.allows(runs("s.1"), runs("t.1"))


@every_model
def test_a_transformation_that_conflicts_with_itself_may_have_two_units(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", conflicts=("s",), max_instances=2)))
    assert fixed.allows(runs("s.1"), runs("s.2"))


def test_a_cold_spare_conflicts_too() -> None:
    library = (kind("s", gives="A", standby_us=1, conflicts=("t",)), kind("t", gives="A", max_instances=3))
    fixed = Apart(world("A", *library, survive=Failures.UNITS))
    assert fixed.allows(runs("t.1"), runs("t.2"))
    assert not fixed.allows(runs("t.1"), waits("s.1"))


@every_model
def test_units_that_conflict_on_a_host_are_on_different_ones(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", conflicts_on_host=("t", "s"), max_instances=2), kind("t", gives="A"))
    fixed = model(world("A", *library, hosts=TWO))
    assert fixed.allows(on("s.1", "h0"), on("t.1", "h1"))
    assert not fixed.allows(on("s.1", "h0"), on("t.1", "h0"))
    assert fixed.allows(on("s.1", "h0"), on("s.2", "h0"))
    assert not model(world("A", *library)).allows(runs("s.1"), runs("t.1"))


def test_a_cold_spare_conflicts_on_its_host_too() -> None:
    library = (kind("s", gives="A", standby_us=1, conflicts_on_host=("t",)), kind("t", gives="A", max_instances=3))
    fixed = Apart(world("A", *library, hosts=TWO, survive=Failures.UNITS))
    assert fixed.allows(on("t.1", "h1"), waits("s.1"), on("s.1", "h0"))
    assert not fixed.allows(on("t.1", "h0"), waits("s.1"), on("s.1", "h0"))


@every_model
def test_beside_a_unit_run_those_that_it_runs_with(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", beside=("t", "s")), kind("t", gives="B"), kind("u", gives="A"))
    fixed = model(world("A", *library, hosts=TWO))
    assert fixed.allows(on("s.1", "h0"), on("t.1", "h0"))
    assert fixed.allows(on("s.1", "h0"), on("t.1", "h0"), on("t.2", "h1"))
    assert not fixed.allows(on("s.1", "h0"), on("t.1", "h1"), ~runs("t.2"))
    assert not fixed.allows(runs("s.1"), ~runs("t.1"))
    assert not model(world("A", *library)).allows(runs("s.1"), ~runs("t.1"))
    assert not model(world("A", library[0], library[2], hosts=TWO)).allows(runs("s.1"))


@every_model
def test_units_that_run_with_each_other_may_feed_each_other_in_one_direction(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", beside=("f",)), kind("f", "A", "B", beside=("s",)))
    assert model(world("B", *library, hosts=TWO)).allows(on("s.1", "h1"), on("f.1", "h1"))


def test_a_cold_spare_is_no_company_and_needs_none() -> None:
    library = (kind("s", gives="A", standby_us=1, beside=("t",)), kind("t", gives="B", standby_us=1))
    fixed = Apart(world("A", *library, kind("u", gives="A", max_instances=2), hosts=TWO, survive=Failures.UNITS))
    assert fixed.allows(runs("u.1"), waits("s.1"), waits("t.1"))
    assert not fixed.allows(on("s.1", "h0"), runs("s.1"), waits("t.1"), waits("t.2"))


@every_model
def test_as_many_units_run_as_are_asked_for(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", min_instances=2)))
    assert fixed.allows(runs("s.1"), runs("s.2"))
    assert not fixed.allows(~runs("s.2"))


@every_model
def test_a_unit_that_is_asked_for_runs_though_no_target_needs_it(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A"), kind("n", "A", "B", min_instances=1)))
    assert fixed.allows(runs("n.1"))
    assert not fixed.allows(~runs("n.1"))


@every_model
def test_no_more_units_run_than_are_allowed(model: type[Hubs]) -> None:
    units = tuple(unit("s", number=number) for number in (1, 2, 3))
    fixed = model(world("A", kind("s", gives="A", max_instances=2), units=units))
    assert fixed.allows(runs("s.1"), runs("s.2"), ~runs("s.3"))
    assert not fixed.allows(runs("s.1"), runs("s.2"), runs("s.3"))


@every_model
def test_no_host_has_more_units_of_a_transformation_than_it_allows(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", max_instances=3, per_host=1), hosts=TWO))
    assert fixed.allows(on("s.1", "h0"), on("s.2", "h1"))
    assert not fixed.allows(on("s.1", "h0"), on("s.2", "h0"))
    assert not fixed.allows(runs("s.1"), runs("s.2"), runs("s.3"))


@every_model
def test_without_hosts_all_units_are_on_one(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", max_instances=3, per_host=2)))
    assert fixed.allows(runs("s.1"), runs("s.2"))
    assert not fixed.allows(runs("s.1"), runs("s.2"), runs("s.3"))


@every_model
def test_hosts_that_a_selector_chooses_have_no_more_units_together_than_it_allows(model: type[Hubs]) -> None:
    hosts = (*(replace(host, labels=("spot",)) for host in TWO), Host("h2"))
    fixed = model(world("A", kind("s", gives="A", max_instances=3, at_most={"spot": 1}), hosts=hosts))
    assert fixed.allows(on("s.1", "h0"), on("s.2", "h2"), on("s.3", "h2"))
    assert not fixed.allows(on("s.1", "h0"), on("s.2", "h1"))
    assert not fixed.allows(on("s.1", "h1"), on("s.2", "h1"))
    none = model(world("A", kind("s", gives="A", at_most={"spot": 0}), hosts=hosts))
    assert none.allows(on("s.1", "h2")) and not none.allows(on("s.1", "h0"))


def test_cold_spares_count_among_those_on_the_hosts_that_a_selector_chooses() -> None:
    spot = kind("s", gives="A", standby_us=1, at_most={"h0 or h1": 1})
    fixed = Apart(world("A", spot, hosts=(*TWO, Host("h2")), survive=Failures.UNITS))
    assert fixed.allows(on("s.1", "h0"), waits("s.2"), on("s.2", "h2"))
    assert not fixed.allows(on("s.1", "h0"), waits("s.2"), on("s.2", "h1"))


def test_cold_spares_count_among_those_allowed_on_a_host() -> None:
    fixed = Apart(world("A", kind("s", gives="A", standby_us=1, per_host=1), hosts=TWO, survive=Failures.UNITS))
    assert fixed.allows(on("s.1", "h0"), waits("s.2"), on("s.2", "h1"))
    assert not fixed.allows(on("s.1", "h0"), waits("s.2"), on("s.2", "h0"))


def test_cold_spares_count_among_those_allowed_but_not_among_those_asked_for() -> None:
    fixed = Apart(world("A", kind("s", gives="A", standby_us=1, max_instances=2), survive=Failures.UNITS))
    assert fixed.allows(runs("s.1"), waits("s.2"))
    more = kind("s", gives="A", standby_us=1, max_instances=2)
    units = (unit("s"), unit("s", number=2), unit("s", number=3))
    fixed = Apart(world("A", more, units=units, survive=Failures.UNITS))
    assert not fixed.allows(runs("s.1"), runs("s.2"), waits("s.4"))
    asked = kind("s", gives="A", standby_us=1, min_instances=2, max_instances=3)
    fixed = Apart(world("A", asked, survive=Failures.UNITS))
    assert fixed.allows(runs("s.1"), runs("s.2"))
    assert not fixed.allows(waits("s.1"), waits("s.2"))


@every_model
def test_the_first_of_several_new_units_are_taken(model: type[Hubs]) -> None:
    fixed = model(world("A", kind("s", gives="A", max_instances=3)))
    assert fixed.allows(runs("s.1"), ~runs("s.2"))
    assert not fixed.allows(runs("s.2"), ~runs("s.1"))


@every_model
def test_new_units_beside_a_running_one_are_not_in_its_order(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", max_instances=3), kind("t", gives="A"))
    fixed = model(world("A", *library, units=(unit("s"),)))
    assert fixed.allows(~runs("s.1"), runs("s.2"))
    assert fixed.allows(runs("t.1"), ~runs("s.1"), ~runs("s.2"))


def test_a_unit_runs_or_waits() -> None:
    fixed = Apart(world("A", kind("s", gives="A", standby_us=1), survive=Failures.UNITS))
    assert fixed.allows(runs("s.1"), waits("s.2"))
    assert not fixed.allows(runs("s.1"), waits("s.1"))


def test_a_cold_spare_costs_its_standby_and_feeds_nobody() -> None:
    fixed = Apart(world("A", kind("s", gives="A", labor_us=5, upkeep_us=7, standby_us=2), survive=Failures.UNITS))
    assert fixed.least_us(runs("s.1"), waits("s.2")) == 5 + 7 + 2
    assert fixed.least_us(runs("s.1"), runs("s.2")) == 2 * (5 + 7)
    assert not fixed.allows(waits("s.2"), publishes("s.2", "A"))
    assert not fixed.allows(waits("s.1"), waits("s.2"))


def test_after_the_failure_of_a_unit_another_meets_the_target() -> None:
    fixed = Apart(world("B", kind("s", gives="A"), kind("t", gives="A"), kind("f", "A", "B"), survive=Failures.UNITS))
    assert fixed.allows(runs("s.1"), runs("t.1"), runs("f.2"))
    assert fixed.allows(runs("s.1"), runs("s.2"), ~runs("t.1"))
    assert not fixed.allows(~runs("s.2"), ~runs("t.1"))
    assert not fixed.allows(~runs("f.2"))


def test_after_the_failure_of_a_host_units_on_another_meet_the_target() -> None:
    fixed = Apart(world("A", kind("s", gives="A"), hosts=TWO, survive=Failures.HOSTS))
    assert fixed.allows(on("s.1", "h0"), on("s.2", "h1"))
    assert not fixed.allows(on("s.1", "h0"), on("s.2", "h0"))


def test_a_target_at_a_host_that_fails_need_not_be_met_then() -> None:
    targets = (Target("A", "A", "/A", host="h0"),)
    fixed = Apart(world(targets, kind("s", gives="A"), hosts=TWO, survive=Failures.HOSTS))
    assert fixed.allows(on("s.1", "h0"), on("s.2", "h0"))
    assert not fixed.allows(on("s.1", "h1"), on("s.2", "h1"))


@every_model
def test_wherever_a_unit_runs_its_demands_are_met_somewhere(model: type[Hubs]) -> None:
    fixed = model(placed(*TWO))
    assert fixed.allows(on("f.1", "h0"), on("s.1", "h1"))
    assert not fixed.allows(on("f.1", "h0"), ~runs("s.1"))
    assert not fixed.allows(~runs("f.1"))


@every_model
def test_a_demand_is_met_first_by_a_unit_that_does_not_have_it_wherever_that_is(model: type[Hubs]) -> None:
    library = [kind(label, wants, "A", output=STREAM) for label, wants in (("s", ""), ("t", ""), ("loop", "A"))]
    fixed = model(world("A", *library, hosts=TWO, transfer_us=100))
    assert fixed.allows(on("loop.1", "h0"), on("s.1", "h1"))
    assert not fixed.allows(on("loop.1", "h0"), ~runs("s.1"), ~runs("t.1"))


LOW = QualityAttribute("q", Better.LOWER, worst=100, best=0)
HIGH = QualityAttribute("q", Better.HIGHER, worst=0, best=100)


def with_quality(
    attribute: QualityAttribute, rule: QualityRule, own: int, over: Over, inputs: tuple[int, ...], wish: Wish
) -> Problem:
    """One transformation; its inputs have the values given, unless the best sources run, and its output states one."""
    sources = [kind(f"s{i}", gives="ABC"[i], output=states(value)) for i, value in enumerate(inputs)]
    sources += [kind(f"best{i}", gives="ABC"[i], output=states(attribute.best)) for i in range(len(inputs))]
    fused = kind("f", "ABC"[: len(inputs)], "D", output=states(own, rule, over))
    return world((Target("D", "D", "/D", quality=(wish,)),), *sources, fused, qualities=(attribute,))


WITHOUT_THE_BEST = (~runs("best0.1"), ~runs("best1.1"))


def states(value: int, rule: QualityRule = QualityRule.SET, over: Over = Over.WORST) -> OutputPort:
    return OutputPort("x", "", (Contribution("q", rule, value, over),))


@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
def test_what_runs_as_company_feeds_inputs_that_start_nothing(planner: str) -> None:
    problem = world("B", kind("w", "A", "B", first={"optional": True}, beside=("k",)), kind("k", gives="A"))
    found = PLANNERS[planner](problem)
    assert found.change_set is not None
    assert [unit.feeds for unit in found.change_set.started] == [{}, {"in0": (Stream("k.1", "x0"),)}]
    assert plan_violations(problem, found) == []


@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
@pytest.mark.parametrize(("over", "quality"), [(Over.WORST, 30), (Over.BEST, 9), (Over.MEAN, 20), (Over.SUM, 39)])
def test_each_of_several_streams_counts_for_quality(planner: str, over: Over, quality: int) -> None:
    sources = [kind(f"s{i}", gives="A", output=states(value), max_instances=1) for i, value in enumerate((9, 30))]
    fused = kind("f", "A", "D", output=states(0, QualityRule.ADD, over), first={"count": 2})
    target = Target("D", "D", "/D", quality=(Wish("q", weight_us=MICRO),))
    problem = world((target,), *sources, fused, qualities=(LOW,))
    found = PLANNERS[planner](problem)
    assert (found.cost_us, plan_violations(problem, found)) == (3 + quality, [])


@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
@pytest.mark.parametrize(("worth_us", "cost_us"), [(20, 2 + 10 + 20), (50, 3 + 50)])
def test_an_optional_input_that_is_not_fed_does_not_count_for_quality(
    planner: str, worth_us: int, cost_us: int
) -> None:
    loose = kind("f", "BA", "D", output=states(5, QualityRule.ADD), first={"optional": True, "worth_us": worth_us})
    sources = kind("s", gives="A", output=states(5)), kind("t", gives="B", output=states(45))
    target = Target("D", "D", "/D", quality=(Wish("q", weight_us=MICRO),))
    problem = world((target,), *sources, loose, qualities=(LOW,))
    found = PLANNERS[planner](problem)
    assert (found.cost_us, plan_violations(problem, found)) == (cost_us, [])


@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
@pytest.mark.parametrize(
    ("weight_us", "where", "quality"), [(0, "far", 57), (MICRO, "far", 57), (3 * MICRO, "near", 12)]
)
def test_what_a_stream_loses_on_a_journey_is_weighed(planner: str, weight_us: int, where: str, quality: int) -> None:
    hosts = (Host("near"), Host("far", labels=("cheap",)))
    library = (
        kind("s", gives="A", output=states(5), host="near"),
        kind("f", "A", "B", output=states(7, QualityRule.ADD), on="cheap"),
        kind("g", "A", "B", output=states(7, QualityRule.ADD), host="near", labor_us=100),
    )
    wish = Wish("q", weight_us=weight_us)
    link = Link(("near", "far"), latency=45, adds="q")
    targets = (Target("B", "B", "/B", quality=(wish,)),)
    problem = world(targets, *library, hosts=hosts, qualities=(LOW,), links=(link,))
    found = PLANNERS[planner](problem)
    assert plan_violations(problem, found) == []
    after = problem.after(found)
    assert (found.status, {unit.host for unit in after.units}) == (Status.OPTIMAL, {"near", where})
    assert qualities_of_targets(after, after.units)["B"]["q"] == quality


@pytest.mark.parametrize("model", [Apart, Hubs, Explained])
def test_what_a_link_adds_is_added_to_what_a_stream_is_and_not_to_the_best_that_it_may_be(model: type[Hubs]) -> None:
    library = (
        kind("good", gives="A", output=states(1)),
        kind("poor", gives="A", output=states(5)),
        kind("f", "A", "B", output=states(2, QualityRule.ADD)),
    )
    targets = (Target("B", "B", "/B", quality=(Wish("q", 10),), host="h1"),)
    links = (Link(("h0", "h1"), latency=4, adds="q"),)
    fixed = model(world(targets, *library, qualities=(LOW,), hosts=TWO, links=links))
    assert fixed.allows(on("good.1", "h0"), on("f.1", "h0"), ~runs("poor.1"))
    assert fixed.allows(on("poor.1", "h1"), on("f.1", "h1"), ~runs("good.1"))
    assert not fixed.allows(on("poor.1", "h0"), on("f.1", "h0"), ~runs("good.1"))


RESULTS = [
    (LOW, QualityRule.SET, 7, Over.WORST, (90, 90), 7),
    (LOW, QualityRule.ADD, 7, Over.WORST, (10, 30), 37),
    (LOW, QualityRule.ADD, 7, Over.BEST, (10, 30), 17),
    (LOW, QualityRule.ADD, 7, Over.MEAN, (10, 31), 28),
    (LOW, QualityRule.ADD, 7, Over.SUM, (10, 30), 47),
    (LOW, QualityRule.ADD, -7, Over.WORST, (10, 30), 23),
    (LOW, QualityRule.LIMIT, 40, Over.WORST, (10, 30), 40),
    (LOW, QualityRule.LIMIT, 20, Over.WORST, (10, 30), 30),
    (LOW, QualityRule.SCALE, MICRO // 2, Over.WORST, (10, 31), 16),
    (LOW, QualityRule.SCALE, 2 * MICRO, Over.BEST, (10, 31), 20),
    (HIGH, QualityRule.SET, 70, Over.WORST, (10, 10), 70),
    (HIGH, QualityRule.ADD, -7, Over.WORST, (50, 30), 23),
    (HIGH, QualityRule.ADD, -7, Over.BEST, (50, 30), 43),
    (HIGH, QualityRule.ADD, 7, Over.MEAN, (50, 31), 47),
    (HIGH, QualityRule.ADD, 7, Over.SUM, (50, 30), 87),
    (HIGH, QualityRule.LIMIT, 20, Over.WORST, (50, 30), 20),
    (HIGH, QualityRule.LIMIT, 40, Over.WORST, (50, 30), 30),
    (HIGH, QualityRule.SCALE, MICRO // 2, Over.WORST, (50, 31), 15),
    (HIGH, QualityRule.SCALE, 2 * MICRO, Over.BEST, (40, 31), 80),
]


@every_model
@pytest.mark.parametrize(("attribute", "rule", "own", "over", "inputs", "value"), RESULTS)
def test_a_stream_is_as_good_as_its_rule_says(
    model: type[Hubs],
    attribute: QualityAttribute,
    rule: QualityRule,
    own: int,
    over: Over,
    inputs: tuple[int, ...],
    value: int,
) -> None:
    better = value - 1 if attribute is LOW else value + 1
    assert model(with_quality(attribute, rule, own, over, inputs, Wish("q", value))).allows(*WITHOUT_THE_BEST)
    assert not model(with_quality(attribute, rule, own, over, inputs, Wish("q", better))).allows(*WITHOUT_THE_BEST)


@every_model
@pytest.mark.parametrize(("attribute", "rule", "own", "over", "inputs", "value"), RESULTS)
def test_a_target_pays_for_what_its_stream_misses(
    model: type[Hubs],
    attribute: QualityAttribute,
    rule: QualityRule,
    own: int,
    over: Over,
    inputs: tuple[int, ...],
    value: int,
) -> None:
    fixed = model(with_quality(attribute, rule, own, over, inputs, Wish("q", weight_us=3 * MICRO)))
    assert fixed.least_us(*WITHOUT_THE_BEST) == 1 + len(inputs) + 3 * abs(value - attribute.best)


@every_model
def test_a_price_is_rounded_up_to_a_microsecond(model: type[Hubs]) -> None:
    fixed = model(with_quality(LOW, QualityRule.SET, 7, Over.WORST, (1,), Wish("q", weight_us=MICRO // 2)))
    assert fixed.least_us() == 2 + 4


@every_model
def test_a_bound_is_kept_by_who_meets_the_target(model: type[Hubs]) -> None:
    library = (kind("s", gives="A", output=states(10)), kind("t", gives="A", output=states(20)), kind("f", "A", "B"))
    fixed = model(world((Target("B", "B", "/B", quality=(Wish("q", 10),)),), *library, qualities=(LOW,)))
    assert fixed.allows(runs("s.1"))
    assert not fixed.allows(~runs("s.1"))


@every_model
def test_a_source_that_states_nothing_is_as_bad_as_can_be(model: type[Hubs]) -> None:
    def asking(bound: int) -> Problem:
        targets = (Target("A", "A", "/A", quality=(Wish("q", bound),)),)
        return world(targets, kind("s", gives="A"), qualities=(LOW,))

    assert model(asking(100)).allows()
    assert not model(asking(99)).allows()


@every_model
def test_what_is_worse_than_the_scale_counts_as_its_worst(model: type[Hubs]) -> None:
    assert model(with_quality(LOW, QualityRule.ADD, 70, Over.WORST, (70,), Wish("q", 100))).allows(*WITHOUT_THE_BEST)
    assert not model(with_quality(LOW, QualityRule.ADD, 70, Over.WORST, (70,), Wish("q", 99))).allows(*WITHOUT_THE_BEST)


@every_model
def test_quality_is_that_of_the_stream_on_its_host(model: type[Hubs]) -> None:
    library: tuple[Transformation, ...] = (
        kind("s", gives="A", output=states(10)),
        kind("t", gives="A", output=states(20), host="h1"),
        kind("f", "A", "B", output=states(5, QualityRule.ADD)),
    )
    targets = (Target("B", "B", "/B", quality=(Wish("q", 15),), host="h0"),)
    fixed = model(world(targets, *library, qualities=(LOW,), hosts=TWO))
    assert fixed.allows(on("s.1", "h0"), on("f.1", "h1"))
    assert not fixed.allows(~runs("s.1"))


@every_model
@pytest.mark.parametrize("learned", [{"h0": 20}, {"h0": 20, "h2": 30}, {None: 20, "h1": 0, "h2": 30}])
def test_quality_is_as_learned_on_the_host_of_the_unit(model: type[Hubs], learned: dict[str | None, int]) -> None:
    """The source is worse than declared, but not on h1."""
    stated = states(10)
    output = replace(stated, quality=tuple(each.taught(learned) for each in stated.quality))
    library = (kind("s", gives="A", output=output), kind("f", "A", "B", output=states(5, QualityRule.ADD)))
    targets = (Target("B", "B", "/B", quality=(Wish("q", 15),)),)
    fixed = model(world(targets, *library, qualities=(LOW,), hosts=(*TWO, Host("h2"))))
    assert fixed.allows(on("s.1", "h1"), on("f.1", "h0"))
    assert not fixed.allows(on("s.1", "h0"))
    assert fixed.allows(on("s.1", "h2")) is ("h2" not in learned)


@every_model
def test_a_unit_that_stays_has_the_quality_of_the_stream_that_it_keeps(model: type[Hubs]) -> None:
    library: tuple[Transformation, ...] = (
        kind("s", gives="A", output=states(50)),
        kind("t", gives="A", output=states(10)),
        kind("f", "A", "B", output=states(5, QualityRule.ADD)),
    )
    targets = (Target("B", "B", "/B", quality=(Wish("q", 15),)),)
    units = (unit("s"), unit("t"), unit("f", "s.1/x0", topic="B"))
    fixed = model(world(targets, *library, qualities=(LOW,), units=units))
    assert fixed.allows(rewired("f.1"), runs("s.1"))
    assert not fixed.allows(runs("f.1"), ~rewired("f.1"), runs("t.1"))


def test_two_attributes_are_both_kept() -> None:
    def both(latency: int, error: int) -> OutputPort:
        return OutputPort(
            "x", "", (Contribution("e", QualityRule.SET, error), Contribution("q", QualityRule.SET, latency))
        )

    library = (kind("s", gives="A", output=both(10, 90)), kind("t", gives="A", output=both(90, 10)))
    middle = kind("u", gives="A", output=both(50, 50))
    targets = (Target("A", "A", "/A", quality=(Wish("e", 60), Wish("q", 60))),)
    error = QualityAttribute("e", Better.LOWER, worst=100, best=0)
    fixed = Apart(world(targets, *library, middle, qualities=(LOW, error)))
    assert fixed.allows(runs("u.1"))
    assert not fixed.allows(~runs("u.1"))


def explicit(problem: Problem) -> set[str]:
    """The inputs, by label and port, that have a boolean for each stream that may feed them."""
    model = search_alone(problem).model
    return {f"{model.candidates.all[i].transformation.label}/{port}" for i, port in model.connects}


def of_error_and_latency(*library: Transformation) -> Problem:
    """A sensor of A; C must have little error, D little latency, and nothing is asked of E."""
    sensors = (kind("s", gives="A", output=states(1)), kind("t", gives="A", output=states(2)))
    asked = {"C": (Wish("e", 60),), "D": (Wish("q", 60),)}
    targets = tuple(Target(tag, tag, f"/{tag}", quality=asked.get(tag, ())) for tag in "CDE")
    error = replace(LOW, name="e")
    return world(targets, *sensors, *library, qualities=(LOW, error))


def test_only_inputs_whose_stream_counts_for_two_attributes_are_told_apart() -> None:
    ways = (kind("c", "B", "C"), kind("d", "F", "D"), kind("e", "BF", "E"))
    assert explicit(of_error_and_latency(*ways, kind("b", "A", "B"), kind("f", "A", "F"))) == {"b/in0", "f/in0"}
    assert explicit(of_error_and_latency(*ways, kind("b", "A", "B"), kind("f", gives="F"))) == set()
    stated = OutputPort("x", "", (Contribution("e", QualityRule.SET, 3),))
    assert explicit(of_error_and_latency(*ways, kind("b", "A", "B", output=stated), kind("f", "A", "F"))) == set()


@pytest.mark.parametrize(
    ("stated", "apart"),
    [
        (states(5, QualityRule.ADD), set()),
        (states(5, QualityRule.LIMIT), set()),
        (states(5, QualityRule.SET), {"there/in0", "out/in0"}),  # what feeds `back` does not count
        (states(MICRO // 2, QualityRule.SCALE), {"there/in0", "back/in0", "out/in0"}),
        (states(2 * MICRO, QualityRule.SCALE), set()),
    ],
)
def test_only_inputs_in_a_ring_that_makes_streams_better_are_told_apart(stated: OutputPort, apart: set[str]) -> None:
    cycle = (kind("there", "A", "B", output=states(1, QualityRule.ADD)), kind("back", "B", "A", output=stated))
    after = (kind("s", gives="A", output=states(9)), kind("out", "A", "C"), kind("last", "C", "D"))
    target = Target("D", "D", "/D", quality=(Wish("q", 60),))
    assert explicit(world((target,), *cycle, *after, qualities=(LOW,))) == apart


def test_what_is_distinct_required_or_a_feedback_input_tells_no_other_input_apart() -> None:
    sensors = tuple(kind(label, gives="A", output=states(at)) for label, at in (("s", 1), ("t", 2)))
    fused = kind("fused", "AA", "B", distinct=(0, 1))
    looped = kind("looped", "BC", "C", feedback=(1,), required=True)
    target = Target("D", "D", "/D", quality=(Wish("q", 60),))
    found = explicit(world((target,), *sensors, fused, looped, kind("last", "C", "D"), qualities=(LOW,)))
    assert found == {"fused/in0", "fused/in1", "looped/in1", "last/in0"}
