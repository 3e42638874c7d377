"""The judge: each rule broken on purpose once, and not otherwise."""

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
    Objective,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planning import Measured, Plan, PlannerFaultError, Problem, Status
from cfgplan.validity import Rule, kept_us, plan_violations, violations

CAMERA = Transformation("camera", (), (OutputPort("out", "Image"),), labor_us=5, upkeep_us=1)
DETECTOR = Transformation(
    "detector",
    (InputPort("image", "Image"), InputPort("old", "Ball", feedback=True)),
    (OutputPort("ball", "Ball"),),
    labor_us=3,
    upkeep_us=2,
)
TARGET = Target("ball", "Ball", "/ball")
SIMILARITY = Similarity({"Image": frozenset({"Image"}), "Ball": frozenset({"Ball"})})


def fed(port: str, stream: str) -> Subscription:
    return Subscription(port, Stream.parse(stream))


camera = ComputationUnit("camera.1", "camera")
detector = ComputationUnit(
    "detector.1",
    "detector",
    (fed("image", "camera.1/out"), fed("old", "detector.1/ball")),
    (Publication("ball", "/ball"),),
)
VALID = Environment((camera, detector), (CAMERA, DETECTOR), (TARGET,))


def rules(environment: Environment) -> set[Rule]:
    return {violation.rule for violation in violations(environment, SIMILARITY)}


def with_detector(**changes: object) -> Environment:
    return replace(VALID, units=(camera, replace(detector, **changes)))  # type: ignore[arg-type]


def test_a_valid_configuration_has_no_violation_even_with_a_unit_on_its_own_feedback_input() -> None:
    assert violations(VALID, SIMILARITY) == []


def test_a_unit_of_a_transformation_that_left_the_library_is_unknown() -> None:
    assert Rule.KNOWN in rules(replace(VALID, library=(DETECTOR,)))


def test_an_input_without_a_subscription_is_a_gap() -> None:
    assert rules(with_detector(subscriptions=(fed("image", "camera.1/out"),))) == {Rule.FED}


def test_a_stream_of_a_dead_unit_feeds_nothing() -> None:
    feeds = (fed("image", "camera.7/out"), fed("old", "detector.1/ball"))
    assert Rule.FED in rules(with_detector(subscriptions=feeds))


def test_an_input_takes_one_stream() -> None:
    second = replace(camera, id="camera.2")
    both = (fed("image", "camera.1/out"), fed("image", "camera.2/out"), fed("old", "detector.1/ball"))
    units = (camera, second, replace(detector, subscriptions=both))
    assert [str(v) for v in violations(replace(VALID, units=units), SIMILARITY)] == [
        "input image of unit detector.1 takes one stream, but has 2: camera.1/out, camera.2/out"
    ]


def second_camera(**said: object) -> Environment:
    """Two cameras, and a detector whose input of images has something said about it."""
    port = replace(DETECTOR.input["image"], **said)  # type: ignore[arg-type]
    kind = replace(DETECTOR, inputs=(port, DETECTOR.input["old"]))
    return replace(VALID, units=(camera, replace(camera, id="camera.2"), detector), library=(CAMERA, kind))


@pytest.mark.parametrize(
    ("said", "feeds", "expected"),
    [
        ({"count": 2}, ["camera.1/out", "camera.2/out"], []),
        ({"count": 2}, ["camera.1/out"], ["input image of unit detector.1 takes 2 streams, but has 1: camera.1/out"]),
        ({"count": ALL}, ["camera.1/out", "camera.2/out"], []),
        (
            {"count": ALL},
            ["camera.1/out"],
            [
                "input image of unit detector.1 takes all that matches, but not camera.2/out",
                "unit camera.2 runs, but no target needs it",
            ],
        ),
        ({"count": ALL}, [], ["input image of unit detector.1 is not connected"]),
        ({"optional": True, "worth_us": 1}, ["camera.1/out"], ["unit camera.2 runs, but no target needs it"]),
        ({"optional": True}, ["camera.1/out"], ["unit camera.1 runs, but no target needs it"]),
        (
            {"optional": True},
            [],
            ["optional input image of unit detector.1 is not fed, but camera.1/out could feed it"],
        ),
    ],
)
def test_the_judge_knows_how_many_streams_an_input_takes(
    said: dict[str, object], feeds: list[str], expected: list[str]
) -> None:
    environment = second_camera(**said)
    fed_detector = replace(detector, subscriptions=(*(fed("image", s) for s in feeds), fed("old", "detector.1/ball")))
    wired = replace(environment, units=(*environment.units[:2], fed_detector))
    assert set(expected) <= {str(violation) for violation in violations(wired, SIMILARITY)}
    if not expected:
        assert violations(wired, SIMILARITY) == []


def test_an_input_that_takes_all_streams_does_not_take_its_own_unit_s() -> None:
    hears = replace(DETECTOR, inputs=(DETECTOR.input["image"], replace(DETECTOR.input["old"], count=ALL)))
    alone = replace(VALID, library=(CAMERA, hears))
    assert [str(v) for v in violations(alone, SIMILARITY)] == [
        "input old of unit detector.1 takes the streams of other units, not its own"
    ]
    first, second = (
        replace(
            detector, id=f"detector.{n}", subscriptions=(fed("image", "camera.1/out"), fed("old", f"detector.{m}/ball"))
        )
        for n, m in ((1, 2), (2, 1))
    )
    assert rules(replace(alone, units=(camera, first, replace(second, publications=())))) == set()


def test_an_input_that_takes_several_streams_takes_them_of_different_units() -> None:
    environment = second_camera(count=2)
    both_eyes = replace(CAMERA, outputs=(OutputPort("out", "Image"), OutputPort("other", "Image")))

    def said(number: int, *streams: str) -> list[str]:
        feeds = (*(fed("image", stream) for stream in streams), fed("old", "detector.1/ball"))
        units = (*environment.units[:number], replace(detector, subscriptions=feeds))
        wired = replace(environment, library=(both_eyes, environment.library[1]), units=units)
        return [str(violation) for violation in violations(wired, SIMILARITY)]

    assert said(2, "camera.1/out", "camera.2/other") == []
    assert said(1, "camera.1/out", "camera.1/other") == [
        "input image of unit detector.1 takes streams of different units"
    ]


@pytest.mark.parametrize(
    ("more", "camera_serves", "feeder"),
    [
        (InputPort("more", "Image"), None, "camera.1/out"),
        (InputPort("more", "Image"), 2, "camera.1/out"),
        (InputPort("more", "Image"), 1, None),
        (InputPort("more", "Image", distinct="ears"), None, "camera.1/out"),
        (InputPort("more", "Image", distinct="eyes"), None, None),
        (InputPort("more", "Ball", feedback=True), None, "detector.1/ball"),
        (InputPort("more", "Ball"), None, None),
    ],
)
def test_an_optional_input_stays_unfed_only_where_no_running_unit_can_feed_it(
    more: InputPort, camera_serves: int | None, feeder: str | None
) -> None:
    """It is not fed by a stream that serves no more, by a feeder of its distinct group, nor in a cycle."""
    image = replace(DETECTOR.input["image"], distinct="eyes")
    library = (
        replace(CAMERA, outputs=(replace(CAMERA.outputs[0], serves=camera_serves),)),
        replace(DETECTOR, inputs=(image, DETECTOR.input["old"], replace(more, optional=True))),
    )
    said = f"optional input more of unit detector.1 is not fed, but {feeder} could feed it"
    found = [str(violation) for violation in violations(replace(VALID, library=library), SIMILARITY)]
    assert found == ([said] if feeder else [])


def test_a_stream_that_more_take_than_it_serves_is_refused() -> None:
    scarce = replace(CAMERA, outputs=(replace(CAMERA.outputs[0], serves=1),))
    more = replace(detector, id="detector.2", publications=())
    units = (camera, detector, more)
    assert rules(replace(VALID, library=(scarce, DETECTOR))) == set()
    assert Rule.SERVES in rules(replace(VALID, units=units, library=(scarce, DETECTOR)))


SHOWN = Target("shown", run="screen")
SCREEN = Transformation("screen", (InputPort("image", "Image"),))


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        (1, []),
        (0, ["no unit of screen runs, which target shown wants"]),
        (2, ["unit screen.2 runs, but no target needs it"]),
    ],
)
def test_a_target_that_wants_a_unit_needs_one_that_runs_and_what_feeds_it(units: int, expected: list[str]) -> None:
    screens = [ComputationUnit(f"screen.{n + 1}", "screen", (fed("image", "camera.1/out"),)) for n in range(units)]
    environment = Environment((camera, *screens)[: 3 * units], (CAMERA, SCREEN), (SHOWN,))
    assert [str(violation) for violation in violations(environment, SIMILARITY)] == expected


def test_a_cold_spare_is_no_unit_that_a_target_wants() -> None:
    spare = ComputationUnit("screen.1", "screen", standby=True)
    assert Rule.MET in rules(Environment((spare,), (CAMERA, SCREEN), (SHOWN,)))


def test_an_optional_input_that_is_unfed_costs_its_worth() -> None:
    environment = second_camera(optional=True, worth_us=7)
    assert kept_us(environment, 10) == 40
    unfed = replace(environment, units=(replace(detector, subscriptions=(fed("old", "detector.1/ball"),)),))
    assert kept_us(unfed, 10) == 90


def test_a_subscription_at_no_port_is_refused() -> None:
    feeds = (*detector.subscriptions, fed("nothing", "camera.1/out"))
    assert rules(with_detector(subscriptions=feeds)) == {Rule.FED}


def test_a_stream_must_match_what_the_input_needs() -> None:
    feeds = (fed("image", "camera.1/out"), fed("old", "camera.1/out"))
    assert rules(with_detector(subscriptions=feeds)) == {Rule.MATCHING}


def test_a_stream_must_match_what_the_target_wants() -> None:
    seen = replace(camera, publications=(Publication("out", "/ball"),))
    assert Rule.MATCHING in rules(replace(VALID, units=(seen, replace(detector, publications=()))))


def test_a_target_without_a_stream_is_not_met() -> None:
    assert Rule.MET in rules(with_detector(publications=()))


def test_a_target_with_two_streams_is_not_met_by_exactly_one() -> None:
    second = replace(detector, id="detector.2")
    assert rules(replace(VALID, units=(camera, detector, second))) == {Rule.MET}


def test_a_ring_of_ordinary_inputs_is_not_grounded() -> None:
    relay = Transformation("relay", (InputPort("in", "Ball"),), (OutputPort("ball", "Ball"),))
    ring = (
        ComputationUnit("relay.1", "relay", (fed("in", "relay.2/ball"),), (Publication("ball", "/ball"),)),
        ComputationUnit("relay.2", "relay", (fed("in", "relay.1/ball"),)),
    )
    assert rules(Environment(ring, (relay,), (TARGET,))) == {Rule.GROUNDED}


def test_inputs_of_one_distinct_group_must_not_share_a_transformation() -> None:
    ports = (InputPort("left", "Image", distinct="eyes"), InputPort("right", "Image", distinct="eyes"))
    stereo = Transformation("stereo", ports, (OutputPort("ball", "Ball"),))
    units = (
        camera,
        replace(camera, id="camera.2"),
        ComputationUnit(
            "stereo.1",
            "stereo",
            (fed("left", "camera.1/out"), fed("right", "camera.2/out")),
            (Publication("ball", "/ball"),),
        ),
    )
    assert rules(Environment(units, (CAMERA, stereo), (TARGET,))) == {Rule.DISTINCT}
    feeds = (fed("left", "camera.1/out"), fed("right", "other.1/out"))
    other = (camera, ComputationUnit("other.1", "other"), replace(units[2], subscriptions=feeds))
    library = (CAMERA, replace(CAMERA, label="other"), stereo)
    assert rules(Environment(other, library, (TARGET,))) == set()
    assert rules(Environment((camera, other[2]), library, (TARGET,))) == {Rule.FED}, (
        "a unit that has gone feeds nothing"
    )


def test_each_input_of_a_distinct_group_finds_a_transformation_of_its_own_if_there_is_one() -> None:
    """Two inputs that take the same tag need two transformations; one that takes another tag as well gives way."""
    ports = tuple(InputPort(name, tag, distinct="eyes") for name, tag in (("a", "Image"), ("b", "Ball"), ("c", "Ball")))
    both = replace(CAMERA, label="both", outputs=(OutputPort("out", "Image"), OutputPort("ball", "Ball")))
    library = (CAMERA, both, Transformation("stereo", ports, (OutputPort("seen", "Seen"),)))
    offers = Similarity({tag: frozenset({tag}) for tag in ("Image", "Ball", "Seen")})
    refused = Plan("by hand", Status.INFEASIBLE, reasons={"seen": "no"})
    for more, untrue in (((), set()), ((replace(both, label="third"),), {Rule.MET})):
        environment = Environment((), (*library, *more), (Target("seen", "Seen", "/seen"),))
        assert plan_rules(refused, Problem(environment, offers, horizon_s=1)) == untrue


def test_a_unit_that_no_target_needs_is_too_much() -> None:
    idle = replace(camera, id="camera.2")
    assert rules(replace(VALID, units=(*VALID.units, idle))) == {Rule.LEAN}


def test_a_pinned_unit_needs_no_target() -> None:
    pinned = replace(CAMERA, pinned=True)
    idle = replace(camera, id="camera.2")
    assert rules(replace(VALID, units=(*VALID.units, idle), library=(pinned, DETECTOR))) == set()


def test_a_topic_that_no_target_names_is_not_published() -> None:
    topics = (Publication("ball", "/ball"), Publication("ball", "/elsewhere"))
    assert rules(with_detector(publications=topics)) == {Rule.PUBLISHED}


def test_an_output_that_does_not_exist_is_not_published() -> None:
    assert Rule.PUBLISHED in rules(with_detector(publications=(Publication("nothing", "/ball"),)))


EMPTY = Problem(replace(VALID, units=()), SIMILARITY, horizon_s=10)
GOOD = Plan("by hand", Status.OPTIMAL, EMPTY.environment.change_to(VALID.units), cost_us=38, bound_us=38)


def plan_rules(plan: Plan, problem: Problem = EMPTY) -> set[Rule]:
    return {violation.rule for violation in plan_violations(problem, plan)}


def test_a_truthful_plan_has_no_violation() -> None:
    assert plan_violations(EMPTY, GOOD) == []


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"cost_us": 37}, Rule.COST),
        ({"bound_us": 37}, Rule.BOUND),
        ({"bound_us": 39}, Rule.BOUND),
        ({"change_set": None}, Rule.CONSISTENT),
        ({"change_set": ChangeSet(stopped=("nobody.1",))}, Rule.CONSISTENT),
        ({"status": Status.INFEASIBLE, "change_set": None}, Rule.MET),
        ({"status": Status.INFEASIBLE, "change_set": None, "reasons": {"ball": "no"}}, Rule.MET),
        ({"status": Status.TOO_EXPENSIVE, "change_set": None}, Rule.BOUND),
        ({"unused_required": ("camera",)}, Rule.REQUIRED),
    ],
)
def test_a_plan_that_says_something_untrue_is_found_out(changes: dict[str, object], rule: Rule) -> None:
    assert rule in plan_rules(replace(GOOD, **changes))  # type: ignore[arg-type]


def test_a_feasible_plan_has_a_lower_bound() -> None:
    assert plan_rules(replace(GOOD, status=Status.FEASIBLE, bound_us=0)) == set()
    assert plan_rules(replace(GOOD, status=Status.FEASIBLE, bound_us=37)) == set()


def test_a_bound_of_0_claims_nothing_even_of_a_plan_that_costs_0() -> None:
    keeps = Plan("by hand", Status.FEASIBLE, ChangeSet(), cost_us=0, bound_us=0)
    problem = replace(EMPTY, environment=VALID, horizon_s=0)
    assert plan_rules(keeps, problem) == plan_rules(replace(keeps, status=Status.OPTIMAL), problem) == set()
    assert PlannerFaultError("a fault", replace(keeps, status=Status.OPTIMAL)).plan.status is Status.FEASIBLE


@pytest.mark.parametrize("changes", [{"bound_us": 38}, {"bound_us": 39}, {"bound_us": 37, "ties_proven": True}])
def test_a_feasible_plan_proves_neither_its_cost_nor_more_nor_its_ties(changes: dict[str, object]) -> None:
    plan = replace(GOOD, status=Status.FEASIBLE, **changes)  # type: ignore[arg-type]
    assert plan_rules(plan) == {Rule.BOUND}


def test_what_a_plan_claims_of_all_plans_is_held_against_what_runs() -> None:
    other = replace(CAMERA, label="other", labor_us=0)
    required = replace(CAMERA, required=True)
    feeds = (fed("image", "other.1/out"), fed("old", "detector.1/ball"))
    units = (ComputationUnit("other.1", "other"), replace(detector, subscriptions=feeds))

    def found(library: tuple[Transformation, ...], **claims: object) -> set[Rule]:
        environment = replace(VALID, library=library)
        changes = environment.change_to(units)
        unused = tuple(t.label for t in library if t.required)
        plan = Plan("by hand", Status.FEASIBLE, changes, 30, 0, unused_required=unused)
        return plan_rules(replace(plan, **claims), replace(EMPTY, environment=environment))  # type: ignore[arg-type]

    optimal = {"status": Status.OPTIMAL, "bound_us": 30}
    assert found((CAMERA, DETECTOR, other)) == found((required, DETECTOR, other)) == set()
    assert found((required, DETECTOR, other), required_proven=True) == {Rule.REQUIRED}
    assert found((CAMERA, DETECTOR, other), **optimal) == set()
    assert found((CAMERA, DETECTOR, other), **optimal, ties_proven=True) == {Rule.BOUND}
    cheaper = replace(CAMERA, upkeep_us=CAMERA.upkeep_us - 1)
    assert found((cheaper, DETECTOR, other), **optimal) == {Rule.BOUND}


def test_a_plan_over_the_largest_cost_is_found_out() -> None:
    assert plan_rules(GOOD, replace(EMPTY, max_cost_us=37)) == {Rule.COST}


def test_a_plan_must_leave_library_and_targets_alone() -> None:
    assert GOOD.change_set is not None
    change_set = replace(GOOD.change_set, added_targets=(Target("image", "Image", "/image"),))
    assert Rule.CONSISTENT in plan_rules(replace(GOOD, change_set=change_set))


def test_a_rewired_unit_that_stays_as_it_is_is_found_out() -> None:
    plan = Plan("by hand", Status.OPTIMAL, ChangeSet(rewired=(camera,)), cost_us=30, bound_us=30)
    assert plan_rules(plan, replace(EMPTY, environment=VALID)) == {Rule.CONSISTENT}


def test_a_new_unit_must_not_take_the_id_of_a_dead_one_that_is_still_subscribed_to() -> None:
    problem = replace(EMPTY, environment=replace(VALID, units=(detector,)))
    plan = Plan("by hand", Status.OPTIMAL, problem.environment.change_to(VALID.units), cost_us=35, bound_us=35)
    assert plan_rules(plan, problem) == {Rule.CONSISTENT}


def test_a_pinned_unit_that_can_be_fed_must_not_be_stopped() -> None:
    logger = Transformation("logger", (InputPort("image", "Image"),), (), pinned=True)
    running = ComputationUnit("logger.1", "logger", (fed("image", "camera.1/out"),))
    environment = Environment((*VALID.units, running), (CAMERA, DETECTOR, logger), (TARGET,))
    plan = Plan("by hand", Status.OPTIMAL, ChangeSet(stopped=("logger.1",)), cost_us=30, bound_us=30)
    assert plan_rules(plan, replace(EMPTY, environment=environment)) == {Rule.PINNED}


def test_a_pinned_unit_that_nothing_can_feed_may_be_stopped() -> None:
    logger = Transformation("logger", (InputPort("sound", "Sound"),), (), pinned=True)
    running = ComputationUnit("logger.1", "logger", (fed("sound", "microphone.1/out"),))
    environment = Environment((*VALID.units, running), (CAMERA, DETECTOR, logger), (TARGET,))
    plan = Plan("by hand", Status.OPTIMAL, ChangeSet(stopped=("logger.1",)), cost_us=30, bound_us=30)
    assert plan_rules(plan, replace(EMPTY, environment=environment)) == set()


def test_a_unit_is_in_standby_only_if_its_transformation_says_what_that_costs() -> None:
    spare = ComputationUnit("camera.2", "camera", standby=True)
    for standby_us, broken in ((None, {Rule.LEAN, Rule.COST}), (0, {Rule.LEAN})):
        library = (replace(CAMERA, standby_us=standby_us), DETECTOR)
        problem = replace(EMPTY, environment=replace(EMPTY.environment, library=library))
        plan = replace(GOOD, change_set=problem.environment.change_to((*VALID.units, spare)))
        assert plan_rules(plan, problem) == broken


def test_a_plan_whose_bound_depends_on_open_pairs_is_not_optimal() -> None:
    undecided = (("Image", "Ball"),)
    assert plan_rules(replace(GOOD, undecided=undecided)) == {Rule.BOUND}
    assert plan_rules(replace(GOOD, status=Status.FEASIBLE, undecided=undecided)) == set()


def test_a_required_transformation_that_is_not_used_must_be_named() -> None:
    library = (CAMERA, DETECTOR, Transformation("radar", (), (OutputPort("out", "Image"),), required=True))
    problem = replace(EMPTY, environment=replace(EMPTY.environment, library=library))
    assert plan_rules(GOOD, problem) == {Rule.REQUIRED}
    assert plan_rules(replace(GOOD, unused_required=("radar",), required_proven=True), problem) == set()


def test_a_plan_is_optimal_only_with_the_proof_that_none_uses_more_of_what_is_required() -> None:
    library = (CAMERA, DETECTOR, Transformation("radar", (), (OutputPort("out", "Image"),), required=True))
    problem = replace(EMPTY, environment=replace(EMPTY.environment, library=library))
    unproven = replace(GOOD, unused_required=("radar",))
    assert plan_rules(unproven, problem) == {Rule.REQUIRED}
    assert plan_rules(replace(unproven, status=Status.FEASIBLE), problem) == set()
    assert plan_rules(replace(unproven, status=Status.FEASIBLE, required_proven=True), problem) == {Rule.BOUND}


def test_the_targets_that_can_not_be_met_must_be_named_exactly() -> None:
    problem = replace(EMPTY, environment=replace(EMPTY.environment, library=(DETECTOR,)))
    refusal = Plan("by hand", Status.INFEASIBLE, reasons={"ball": "no image"})
    assert plan_rules(refusal, problem) == set()
    assert plan_rules(replace(refusal, reasons={}), problem) == {Rule.MET}


ORDERED = replace(EMPTY, environment=replace(EMPTY.environment, minimise=(Objective.UNITS, Objective.COST)))
IN_ORDER = replace(GOOD, objectives=(Measured(Objective.UNITS, 2, 2), Measured(Objective.COST, 38, 38)))


def test_a_plan_that_tells_its_objectives_truly_has_no_violation() -> None:
    assert plan_violations(ORDERED, IN_ORDER) == []


@pytest.mark.parametrize(
    ("units", "cost", "expected"),
    [
        (Measured(Objective.HOSTS, 2, 2), Measured(Objective.COST, 38, 38), {Rule.CONSISTENT}),
        (Measured(Objective.UNITS, 1, 1), Measured(Objective.COST, 38, 38), {Rule.COST}),
        (Measured(Objective.UNITS, 2, 3), Measured(Objective.COST, 38, 38), {Rule.BOUND}),
        (Measured(Objective.UNITS, 2, 1), Measured(Objective.COST, 38, 38), {Rule.BOUND}),
        (Measured(Objective.UNITS, 2, 2), Measured(Objective.COST, 38, 37), {Rule.COST, Rule.BOUND}),
    ],
)
def test_a_plan_that_tells_an_objective_wrongly_is_found_out(
    units: Measured, cost: Measured, expected: set[Rule]
) -> None:
    assert plan_rules(replace(IN_ORDER, objectives=(units, cost)), ORDERED) == expected


def test_what_runs_refutes_a_claim_about_all_plans_only_if_it_is_not_too_expensive() -> None:
    cheap = (replace(CAMERA, label="cheap", upkeep_us=0), replace(DETECTOR, label="small", labor_us=0, upkeep_us=0))
    minimise = (Objective.STARTED, Objective.COST)
    environment = replace(VALID, library=(*VALID.library, *cheap), minimise=minimise)
    feeds = (fed("image", "cheap.1/out"), fed("old", "small.1/ball"))
    small = replace(detector, id="small.1", transformation="small", subscriptions=feeds)
    changes = environment.change_to((ComputationUnit("cheap.1", "cheap"), small))
    objectives = (Measured(Objective.STARTED, 2, 2), Measured(Objective.COST, 5, 5))
    plan = Plan("by hand", Status.OPTIMAL, changes, 5, 5, objectives=objectives)
    for max_cost_us, found in ((None, {Rule.BOUND}), (30, {Rule.BOUND}), (29, set())):
        problem = replace(EMPTY, environment=environment, max_cost_us=max_cost_us)
        assert plan_rules(plan, problem) == found, "what runs costs 30, and starts nothing"


def test_too_expensive_is_no_answer_where_a_target_can_not_be_met_at_all() -> None:
    impossible = replace(EMPTY.environment, library=(DETECTOR,))
    problem = replace(EMPTY, environment=impossible, max_cost_us=10)
    refusal = Plan("by hand", Status.TOO_EXPENSIVE, bound_us=11)
    assert [one.rule for one in plan_violations(problem, refusal)] == [Rule.MET]
    assert plan_violations(replace(EMPTY, max_cost_us=10), refusal) == []
    assert {one.rule for one in plan_violations(replace(EMPTY, max_cost_us=11), refusal)} == {Rule.BOUND}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"transformation": "camera"}, "unit detector.1 can't change its transformation"),
        ({"host": "r1"}, "unit detector.1 can't be moved, started or put in standby by rewiring it"),
    ],
)
def test_rewiring_changes_neither_what_a_unit_is_nor_where_it_runs(changes: dict[str, str], text: str) -> None:
    moved = replace(VALID.unit["detector.1"], **changes)  # type: ignore[arg-type]
    plan = replace(GOOD, change_set=ChangeSet(rewired=(moved,)))
    found = plan_violations(replace(EMPTY, environment=replace(VALID, hosts=(Host("r1"),))), plan)
    assert any(text in str(one) for one in found)
