"""The judge on quality, hosts, conflicts, instances and failures: each rule broken on purpose once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cfgplan.domain import (
    ALL,
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Link,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.drawing import Mark, picture
from cfgplan.errors import InvalidValueError
from cfgplan.figures import cost_parts, qualities_of_targets
from cfgplan.planning import Failures, Plan, Problem, Status
from cfgplan.qualities import Better, Contribution, QualityAttribute, QualityRule, Wish
from cfgplan.validity import Rule as Broken
from cfgplan.validity import plan_violations, violations

ERROR = QualityAttribute("error", Better.LOWER, worst=9_000_000)
IMAGE = OutputPort(
    "out", "Image", (Contribution("error", QualityRule.ADD, 200_000),), rate_uhz=2_500_000, size_bytes=1_000_000
)
CAMERA = Transformation("camera", (), (IMAGE,), labor_us=5, upkeep_us=4, host="robot", memory_mb=30, standby_us=1)
BALL = OutputPort("ball", "Ball", (Contribution("error", QualityRule.SCALE, 500_000),))
DETECTOR = Transformation(
    "detector",
    (InputPort("image", "Image"),),
    (BALL,),
    labor_us=3,
    upkeep_us=2,
    hosts=("base", "robot"),
    memory_mb=20,
)
TARGET = Target("ball", "Ball", "/ball", quality=(Wish("error", 100_000, weight_us=1_000_000),), host="base")
SIMILARITY = Similarity({"Image": frozenset({"Image"}), "Ball": frozenset({"Ball"})})
HOSTS = (Host("robot", 5, 50), Host("base", None, None))

camera = ComputationUnit("camera.1", "camera", host="robot")
detector = ComputationUnit(
    "detector.1",
    "detector",
    (Subscription("image", Stream("camera.1", "out")),),
    (Publication("ball", "/ball"),),
    "base",
)
VALID = Environment((camera, detector), (CAMERA, DETECTOR), (TARGET,), HOSTS, (ERROR,), transfer_us=3)


def rules(environment: Environment, survive: Failures | None = None) -> set[Broken]:
    return {violation.rule for violation in violations(environment, SIMILARITY, survive)}


def with_library(*library: Transformation) -> Environment:
    return replace(VALID, library=library)


def test_a_fleet_that_keeps_all_rules_has_no_violation() -> None:
    assert violations(VALID, SIMILARITY) == []


def test_a_stream_that_is_worse_than_the_target_asks_is_refused() -> None:
    strict = replace(TARGET, quality=(Wish("error", 99_999),))
    assert rules(replace(VALID, targets=(strict,))) == {Broken.QUALITY}


def test_a_unit_needs_a_host_that_is_there_and_that_its_transformation_allows() -> None:
    for host in (None, "moon", "base"):
        assert rules(replace(VALID, units=(replace(camera, host=host), detector))) == {Broken.PLACED}


def test_a_host_that_takes_more_than_it_has_is_overloaded() -> None:
    there = (camera, replace(detector, host="robot"))
    assert rules(replace(VALID, units=there)) == {Broken.CAPACITY}
    roomy = replace(VALID, units=there, hosts=(Host("robot", 6, 49), HOSTS[1]))
    assert rules(roomy) == {Broken.CAPACITY}
    assert rules(replace(roomy, hosts=(Host("robot", 6, 50), HOSTS[1]))) == set()


def test_energy_has_to_last_for_the_horizon() -> None:
    hosts = (Host("robot", energy=80), HOSTS[1])
    powered = replace(VALID, hosts=hosts, library=(replace(CAMERA, needs={"power": 8}), DETECTOR))
    assert violations(powered, SIMILARITY, horizon_s=10) == []
    assert {v.rule for v in violations(powered, SIMILARITY, horizon_s=11)} == {Broken.CAPACITY}
    plan = Problem(replace(powered, units=()), SIMILARITY, horizon_s=11)
    assert Broken.CAPACITY in {v.rule for v in plan_violations(plan, PLAN)}


def test_memory_that_is_not_stated_is_the_most_that_a_unit_may_take() -> None:
    assert replace(CAMERA, memory_mb=None, run=replace(CAMERA.run, memory_mb=70)).needs_mb == 70
    assert replace(CAMERA, memory_mb=None).needs_mb == 0


def test_conflicting_transformations_are_not_there_together_whoever_says_so() -> None:
    assert rules(with_library(CAMERA, replace(DETECTOR, conflicts=("camera",)))) == {Broken.APART}
    assert rules(with_library(replace(CAMERA, conflicts=("detector",)), DETECTOR)) == {Broken.APART}
    assert rules(with_library(replace(CAMERA, conflicts=("other",)), DETECTOR)) == set()


def test_too_few_and_too_many_instances_are_refused() -> None:
    assert rules(with_library(replace(CAMERA, min_instances=2), DETECTOR)) == {Broken.INSTANCES}
    assert rules(with_library(replace(CAMERA, max_instances=0), DETECTOR)) == {Broken.INSTANCES}


def test_too_many_units_on_one_host_are_refused() -> None:
    two = Environment(tuple(ComputationUnit(f"s.{n}", "s", host="h") for n in (1, 2)), (), (), (Host("h"), Host("i")))
    for most, broken in ((1, {Broken.INSTANCES}), (2, set())):
        here = replace(two, library=(Transformation("s", min_instances=2, per_host=most),))
        assert rules(here) == broken
        assert rules(replace(here, units=(two.units[0], replace(two.units[1], host="i")))) == set()
        without = replace(here, units=tuple(replace(unit, host=None) for unit in two.units), hosts=())
        assert rules(without) == broken


def test_too_many_units_on_the_hosts_that_a_selector_chooses_are_refused() -> None:
    hosts = (Host("h", labels=("spot",)), Host("i", labels=("spot", "old")), Host("j"))
    of = Transformation("s", min_instances=2, max_instances=2)
    two = Environment(tuple(ComputationUnit(f"s.{n}", "s", host="hi"[n]) for n in (0, 1)), (of,), (), hosts)
    for at_most, broken in (
        ({"spot": 1}, {Broken.INSTANCES}),
        ({"spot": 2}, set()),
        ({"spot and not old": 1, "j": 0}, set()),
        ({"old": 0}, {Broken.INSTANCES}),
    ):
        assert rules(replace(two, library=(replace(of, at_most=at_most),))) == broken
    elsewhere = replace(two, units=(two.units[0], replace(two.units[1], host="j")))
    assert rules(replace(elsewhere, library=(replace(of, at_most={"spot": 1}),))) == set()
    spare = replace(two, units=(two.units[0], replace(two.units[1], standby=True)))
    one = replace(of, at_most={"spot": 1}, min_instances=1, standby_us=1)
    assert Broken.INSTANCES in rules(replace(spare, library=(one,)))


def test_transformations_that_conflict_on_a_host_are_on_different_ones_whoever_says_so() -> None:
    roomy = replace(VALID, hosts=(Host("robot"), HOSTS[1]))
    for library in (
        (CAMERA, replace(DETECTOR, conflicts_on_host=("camera",))),
        (replace(CAMERA, conflicts_on_host=("detector",)), DETECTOR),
    ):
        assert rules(replace(roomy, library=library)) == set()
        beside = replace(roomy, library=library, units=(camera, replace(detector, host="robot")))
        assert rules(beside) == {Broken.APART}


DRIVER = Transformation("driver", standby_us=1)


def test_a_unit_runs_with_its_company_which_is_not_needless() -> None:
    library, driver = (replace(CAMERA, beside=("driver",)), DETECTOR, DRIVER), ComputationUnit("d.1", "driver")
    here, there = replace(driver, host="robot"), replace(driver, id="d.2", host="base")
    alone = replace(VALID, library=library)
    assert rules(alone) == {Broken.BESIDE}
    assert rules(replace(alone, units=(camera, detector, here))) == set()
    assert rules(replace(alone, units=(camera, detector, there))) == {Broken.BESIDE, Broken.LEAN}
    assert rules(replace(alone, units=(camera, detector, here, there))) == {Broken.LEAN}
    assert rules(replace(alone, units=(camera, detector, here, replace(here, id="d.3")))) == {Broken.LEAN}
    assert rules(replace(alone, units=(camera, detector, replace(here, standby=True)))) == {Broken.BESIDE, Broken.LEAN}


def test_the_failure_of_its_company_is_a_unit_s_own() -> None:
    camera_kind = replace(CAMERA, beside=("driver",), host=None, memory_mb=0)
    detectors = tuple(replace(detector, id=f"detector.{n}", publications=detector.publications[n:]) for n in (0, 1))
    cameras = tuple(replace(camera, id=f"camera.{n}") for n in (1, 2))
    driver = ComputationUnit("d.1", "driver", host="robot")
    two = replace(VALID, library=(camera_kind, DETECTOR, DRIVER), hosts=(Host("robot"), Host("base")))
    one_driver = replace(two, units=(*cameras, *detectors, driver))
    assert "if unit d.1 fails" in str([v.text for v in violations(one_driver, SIMILARITY, Failures.UNITS)])
    on_each = (cameras[0], replace(cameras[1], host="base"), *detectors, driver, replace(driver, id="d.2", host="base"))
    assert rules(replace(two, units=on_each), Failures.UNITS) == set()


def test_a_unit_that_is_asked_for_by_number_is_not_needless() -> None:
    second = replace(camera, id="camera.2", host="robot")
    two = replace(VALID, units=(camera, second, detector), hosts=(Host("robot"), HOSTS[1]))
    assert rules(two) == {Broken.LEAN}
    assert rules(replace(two, library=(replace(CAMERA, min_instances=2), DETECTOR))) == set()


def test_what_no_single_failure_may_break_needs_spares() -> None:
    assert rules(VALID, Failures.UNITS) == {Broken.SURVIVES}
    spares = (
        ComputationUnit("camera.2", "camera", host="robot", standby=True),
        ComputationUnit("detector.2", "detector", host="base", standby=True),
    )
    roomy = replace(VALID, units=(camera, detector, *spares), hosts=(Host("robot"), Host("base")))
    assert rules(roomy, Failures.UNITS) == set()
    assert rules(roomy, Failures.HOSTS) == {Broken.SURVIVES}


def test_after_a_failure_inputs_take_as_many_streams_as_before() -> None:
    several = replace(DETECTOR, inputs=(InputPort("image", "Image", count=2),), standby_us=1)
    spare = ComputationUnit("detector.2", "detector", host="base", standby=True)
    cameras = [replace(camera, id=f"camera.{number}") for number in (1, 2, 3)]
    feeds = tuple(Subscription("image", Stream(f"camera.{number}", "out")) for number in (1, 2))
    two = replace(
        VALID,
        units=(*cameras[:2], replace(detector, subscriptions=feeds), spare),
        library=(CAMERA, several),
        hosts=(Host("robot"), Host("base")),
    )
    assert rules(two) == {Broken.LEAN}
    assert rules(two, Failures.UNITS) == {Broken.SURVIVES}
    assert rules(replace(two, units=(*two.units, cameras[2])), Failures.UNITS) == set()


@pytest.mark.parametrize(
    ("serves", "expected"),
    [
        (1, [f"if unit detector.{n} fails, the remaining units can't be wired to meet all targets" for n in (1, 2)]),
        (2, []),
    ],
)
def test_after_a_failure_no_stream_serves_more_than_it_may(serves: int, expected: list[str]) -> None:
    targets = tuple(replace(TARGET, label=f"t{n}", topic=f"/{n}", quality=()) for n in (1, 2))
    scarce = replace(DETECTOR, outputs=(replace(BALL, serves=serves),))
    cameras = (camera, ComputationUnit("camera.2", "camera", host="robot", standby=True))
    detectors = (
        replace(detector, id=f"detector.{n}", publications=(Publication("ball", f"/{n}"),), host="base") for n in (1, 2)
    )
    hosts = (Host("robot"), Host("base"))
    environment = replace(VALID, units=(*cameras, *detectors), library=(CAMERA, scarce), targets=targets, hosts=hosts)
    assert [str(violation) for violation in violations(environment, SIMILARITY, Failures.UNITS)] == expected


def test_what_closes_a_cycle_with_an_input_that_takes_all_does_not_run_after_a_failure() -> None:
    def kind(label: str, takes: str, gives: str, **said: int) -> Transformation:
        inputs = tuple(InputPort("i", tag, **said) for tag in takes)
        return Transformation(label, inputs, tuple(OutputPort(tag, tag) for tag in gives), standby_us=1)

    library = (kind("bell", "", "A"), kind("log", "A", "L", count=ALL), kind("echo", "L", "AE"), kind("wire", "", "L"))
    offers = Similarity({tag: frozenset({tag}) for tag in "ALE"})
    units = (
        ComputationUnit("wire.1", "wire"),
        ComputationUnit("echo.1", "echo", (Subscription("i", Stream("wire.1", "L")),), (Publication("E", "/e"),)),
        *(ComputationUnit(f"{label}.2", label, standby=True) for label in ("bell", "log", "echo")),
    )

    def said(*more: ComputationUnit) -> list[str]:
        environment = Environment((*units, *more), library, (Target("e", "E", "/e"),))
        found = violations(environment, offers, Failures.UNITS)
        return [str(violation) for violation in found if violation.rule is Broken.SURVIVES]

    assert said() == ["if unit wire.1 fails, the remaining units can't be wired to meet all targets"]
    assert said(ComputationUnit("wire.2", "wire", standby=True)) == []


def test_a_spare_that_no_failure_needs_is_needless() -> None:
    spare = ComputationUnit("camera.2", "camera", host="robot", standby=True)
    roomy = replace(VALID, units=(camera, detector, spare), hosts=(Host("robot"), Host("base")))
    assert rules(roomy) == {Broken.LEAN}


def test_nothing_is_asked_of_a_target_whose_host_has_failed() -> None:
    at_robot = replace(TARGET, host="robot")
    only = replace(VALID, units=(camera, replace(detector, host="robot")), targets=(at_robot,), hosts=(Host("robot"),))
    lost = [v.text for v in violations(only, SIMILARITY, Failures.HOSTS)]
    assert lost and not any("host robot fails" in text for text in lost)


def test_a_cold_spare_gives_no_stream_and_can_not_be_wired() -> None:
    spare = ComputationUnit("camera.1", "camera", host="robot", standby=True)
    assert Broken.FED in rules(replace(VALID, units=(spare, detector)))
    with pytest.raises(InvalidValueError, match="in standby"):
        replace(detector, standby=True)


PROBLEM = Problem(replace(VALID, units=()), SIMILARITY, horizon_s=10)
# Labor 5 + 3, upkeep 6 x 10, 2.5 MB/s x 10 s x 3, and 0.1 x 1 s for what the ball's error misses.
COST = 8 + 60 + 75 + 100_000
PLAN = Plan("test", Status.OPTIMAL, ChangeSet(started=(camera, detector)), COST, COST)


def test_a_link_has_its_price_and_bears_no_more_than_its_bandwidth() -> None:
    labelled = (replace(HOSTS[0], labels=("mobile",)), HOSTS[1])
    dearer, usual = Link(("base", "mobile"), 2_500_000, 4), Link(("⊤", "⊤"), 0, 9)
    linked = replace(VALID, hosts=labelled, links=(dearer, usual))
    assert rules(linked) == set()
    assert rules(replace(linked, links=(replace(dearer, bandwidth=2_499_999),))) == {Broken.CAPACITY}
    assert rules(replace(linked, links=(usual,))) == {Broken.CAPACITY}
    assert rules(replace(linked, links=(Link(("base", "base"), 0),))) == set(), "a link of others"
    gone = replace(linked, library=(DETECTOR,), links=(replace(dearer, bandwidth=0),))
    assert Broken.CAPACITY not in rules(gone), "the rate of a unit that has left the library is unknown"
    cost = COST + 10 * 5 // 2
    problem = Problem(replace(linked, units=()), SIMILARITY, horizon_s=10)
    assert plan_violations(problem, replace(PLAN, cost_us=cost, bound_us=cost)) == []
    assert cost_parts(problem, linked.units).total_us == cost


@pytest.mark.parametrize(("where", "reached"), [("base", 110_000), ("robot", 120_000)])
def test_a_link_adds_its_latency_to_what_it_carries_to_inputs_and_targets(where: str, reached: int) -> None:
    link = Link(("robot", "base"), latency=20_000, adds="error")
    roomy = (Host("robot"), HOSTS[1])
    late = replace(VALID, hosts=roomy, links=(link,), units=(camera, replace(detector, host=where)))
    assert rules(replace(late, links=())) == set()
    assert rules(late) == {Broken.QUALITY}
    assert qualities_of_targets(late, late.units) == {"ball": {"error": reached}}
    wish = replace(TARGET.quality[0], bound=reached)
    assert rules(replace(late, targets=(replace(TARGET, quality=(wish,)),))) == set()


@pytest.mark.parametrize(("seen_on", "reached"), [({"base": 50_000}, 100_000), ({"robot": 20_000}, 110_000)])
def test_a_stream_has_the_quality_that_was_learned_on_the_host_of_its_unit(
    seen_on: dict[str | None, int], reached: int
) -> None:
    (output,) = CAMERA.outputs
    taught = replace(CAMERA, outputs=(replace(output, quality=tuple(each.taught(seen_on) for each in output.quality)),))
    after = replace(VALID, library=tuple(taught if t.label == CAMERA.label else t for t in VALID.library))
    assert qualities_of_targets(after, after.units) == {"ball": {"error": reached}}
    wishes = [replace(TARGET.quality[0], bound=reached - by) for by in (0, 1)]
    met, missed = (rules(replace(after, targets=(replace(TARGET, quality=(wish,)),))) for wish in wishes)
    assert (met, missed) == (set(), {Broken.QUALITY})


def test_a_link_adds_to_an_attribute_of_which_less_is_better() -> None:
    with pytest.raises(InvalidValueError, match="names the attribute"):
        Link(("robot", "base"), latency=1)
    link = Link(("robot", "base"), latency=1, adds="error")
    for qualities in ((), (replace(ERROR, better=Better.HIGHER, worst=0, best=9_000_000),)):
        with pytest.raises(InvalidValueError, match="a link adds to error"):
            Environment(hosts=HOSTS, qualities=qualities, links=(link,))


def test_the_cost_counts_the_rent_of_hosts_where_something_is() -> None:
    hosts = (Host("robot", 5, 50, rent_us=2), Host("base", rent_us=30), Host("empty", rent_us=500))
    rented = replace(PROBLEM, environment=replace(PROBLEM.environment, hosts=hosts))
    dearer = COST + 10 * (2 + 30)
    assert plan_violations(rented, replace(PLAN, cost_us=dearer, bound_us=dearer)) == []
    assert cost_parts(rented, VALID.units).rent_us == 320
    assert cost_parts(rented, VALID.units).total_us == dearer


def test_the_cost_counts_transfers_and_missed_quality() -> None:
    assert plan_violations(PROBLEM, PLAN) == []
    wrong = replace(PLAN, status=Status.FEASIBLE, cost_us=COST - 1, bound_us=0)
    assert [v.rule for v in plan_violations(PROBLEM, wrong)] == [Broken.COST]


def test_a_stream_is_carried_once_to_each_host_and_not_to_its_own() -> None:
    second = ComputationUnit("detector.2", "detector", (Subscription("image", Stream("camera.1", "out")),), (), "base")
    two = replace(PLAN, change_set=ChangeSet(started=(camera, detector, second)), cost_us=COST + 23, bound_us=COST + 23)
    assert [v.rule for v in plan_violations(PROBLEM, two)] == [Broken.LEAN]


def test_a_cold_spare_costs_its_standby_and_no_labor() -> None:
    spares = (
        ComputationUnit("camera.2", "camera", host="robot", standby=True),
        replace(detector, id="detector.2", publications=()),
    )
    roomy = replace(PROBLEM, environment=replace(PROBLEM.environment, hosts=(Host("robot"), Host("base"))))
    cost = COST + 10 + 3 + 20
    plan = replace(PLAN, change_set=ChangeSet(started=(camera, detector, *spares)), cost_us=cost, bound_us=cost)
    assert plan_violations(replace(roomy, survive=Failures.UNITS), plan) == []


def test_rewiring_moves_no_unit() -> None:
    running = Problem(VALID, SIMILARITY, horizon_s=10)
    moved = replace(PLAN, change_set=ChangeSet(rewired=(replace(detector, host="robot"),)))
    assert Broken.CONSISTENT in {v.rule for v in plan_violations(running, moved)}


def test_units_are_placed_only_where_there_are_hosts() -> None:
    with pytest.raises(InvalidValueError, match="has no hosts"):
        Environment((camera,), (CAMERA,))
    with pytest.raises(InvalidValueError, match="no hosts are declared"):
        Problem(Environment(), SIMILARITY, 1, survive=Failures.HOSTS)


def chain(length: int) -> tuple[Problem, Plan]:
    """Units in a row on two hosts, the last of which meets a target that asks for quality; the plan starts them all."""
    error = QualityAttribute("error", Better.LOWER, worst=2 * length)
    tags = [f"T{i}" for i in range(length)]
    library = [
        Transformation(
            f"t{i}",
            (InputPort("in", tags[i - 1]),) if i else (),
            (OutputPort("out", tag, (Contribution("error", QualityRule.ADD, 1),)),),
            labor_us=1,
            pinned=i == 0,
        )
        for i, tag in enumerate(tags)
    ]
    units = [
        ComputationUnit(
            f"t{i}.1",
            f"t{i}",
            (Subscription("in", Stream(f"t{i - 1}.1", "out")),) if i else (),
            (Publication("out", "/t"),) if i == length - 1 else (),
            host="left" if i < length // 2 else "right",
        )
        for i in range(length)
    ]
    target = Target("t", tags[-1], "/t", quality=(Wish("error", length, 1_000_000),))
    environment = Environment((), tuple(library), (target,), (Host("left"), Host("right")), (error,), transfer_us=3)
    cost_us = 2 * length
    plan = Plan("by hand", Status.OPTIMAL, environment.change_to(units), cost_us, cost_us)
    return Problem(environment, Similarity({tag: frozenset({tag}) for tag in tags}), 0), plan


def test_a_row_of_thousands_of_units_is_judged_and_drawn() -> None:
    problem, plan = chain(2_000)
    assert plan.change_set is not None
    assert plan_violations(problem, plan) == []
    after = problem.environment.update(plan.change_set)
    assert qualities_of_targets(after, after.units) == {"t": {"error": 2_000}}
    assert "error 0.002" in picture(problem.environment, plan.change_set).dot()
    stopped = replace(plan, change_set=ChangeSet(stopped=("t1999.1",)))
    assert Broken.MET in {v.rule for v in plan_violations(replace(problem, environment=after), stopped)}
    refused = Plan("by hand", Status.INFEASIBLE, reasons={"elsewhere": "no"})
    assert [v.rule for v in plan_violations(problem, refused)] == [Broken.MET, Broken.MET]


def test_what_is_in_a_ring_or_behind_one_has_the_worst_value() -> None:
    loop = Transformation("loop", (InputPort("i", "Image"), InputPort("b", "Ball")), (BALL,), hosts=("base",))
    ring = [
        replace(detector, id="detector.1", subscriptions=(Subscription("image", Stream("camera.1", "out")),)),
        ComputationUnit(
            "loop.1",
            "loop",
            (Subscription("i", Stream("camera.1", "out")), Subscription("b", Stream("loop.1", "ball"))),
            (),
            "base",
        ),
    ]
    behind = replace(
        VALID,
        units=(
            camera,
            replace(ring[0], publications=()),
            replace(ring[1], publications=(Publication("ball", "/ball"),)),
        ),
        library=(CAMERA, DETECTOR, loop),
    )
    found = [v for v in violations(behind, SIMILARITY) if v.rule is Broken.QUALITY]
    assert ["but its stream has 9" in str(v) for v in found] == [True]


def test_the_picture_has_an_arrow_from_a_unit_to_the_target_that_wants_it() -> None:
    environment = Environment((), (Transformation("screen"),), (Target("shown", run="screen"),))
    assert "(not met)" in picture(environment).mermaid()
    drawn = picture(environment, ChangeSet(started=(ComputationUnit("screen.1", "screen"),)))
    assert [(arrow.tail, arrow.head, arrow.mark) for arrow in drawn.arrows] == [
        ("screen.1", "target shown", Mark.STARTED)
    ]
    assert "a unit of screen" in drawn.mermaid()
    assert "(not met)" not in drawn.mermaid()


def test_a_stream_that_ends_is_drawn_otherwise_where_both_its_units_run_on() -> None:
    provider, user = (
        Transformation("giver", (), (OutputPort("o", "Raw"),)),
        Transformation("user", (InputPort("i", "Raw"),)),
    )

    def fed(name: str) -> ComputationUnit:
        return ComputationUnit("user.1", "user", (Subscription("i", Stream(name, "o")),))

    providers = [ComputationUnit(f"giver.{n}", "giver") for n in (1, 2)]
    change = ChangeSet(rewired=(fed("giver.2"),))
    both_stay = picture(Environment((*providers, fed("giver.1")), (provider, user)), change)
    assert {arrow.tail: arrow.mark for arrow in both_stay.arrows} == {"giver.1": Mark.CUT, "giver.2": Mark.STARTED}
    one_goes = picture(
        Environment((*providers, fed("giver.1")), (provider, user)), replace(change, stopped=("giver.1",))
    )
    assert {arrow.tail: arrow.mark for arrow in one_goes.arrows}["giver.1"] is Mark.STOPPED


def test_a_picture_says_what_is_not_fed_how_many_streams_an_input_takes_and_what_is_a_service() -> None:
    provider = Transformation("giver", (), (OutputPort("o", "Raw", serves=2),))
    inputs = (
        InputPort("i", "Raw", count=2),
        InputPort("ask", "Raw", service=True),
        InputPort("more", "No", optional=True),
    )
    user = Transformation("user", inputs, (OutputPort("out", "Out"),))
    fed = [Subscription(port, Stream(f"giver.{n}", "o")) for port, n in (("i", 1), ("i", 2), ("ask", 1))]
    units = (
        *(ComputationUnit(f"giver.{n}", "giver", host="h") for n in (1, 2)),
        ComputationUnit("user.1", "user", tuple(fed), host="h"),
    )
    hosts = (Host("h", labels=("gpu", "robot"), rent_us=500_000),)
    drawn = picture(Environment(units, (provider, user), hosts=hosts))
    assert drawn.mermaid().splitlines()[1:8] == [
        '  subgraph h1["h (gpu, robot), rent 0.5 s/s"]',
        '  n0["giver.1"]:::kept',
        '  n1["giver.2"]:::kept',
        '  n2["user.1<br/>(more: not fed)"]:::kept',
        "  end",
        '  n0 <-->|"o → ask (serves 2)"| n2',
        '  n0 -->|"o → i (serves 2, one of 2)"| n2',
    ]
    assert "style=dotted" in drawn.dot()
