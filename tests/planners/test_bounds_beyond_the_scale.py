"""Bounds that no value can miss, and bounds that none can keep: they lie beyond the attribute's scale."""

from __future__ import annotations

import pytest

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status
from cfgplan.qualities import Better, Contribution, Over, QualityAttribute, QualityRule, Wish, worst_allowed
from cfgplan.validity import plan_violations

LOW = QualityAttribute("q", Better.LOWER, worst=3_300_000, best=100_000)
HIGH = QualityAttribute("q", Better.HIGHER, worst=100_000, best=3_300_000)

AMPLIFIERS = [
    (7_000, 8_000, [], "T1", QualityRule.SCALE, 5_919_679, Over.BEST),
    (11_000, 34_000, ["T1"], "T0", QualityRule.ADD, 5_834_209, Over.WORST),
    (20_000, 34_000, ["T2", "T0"], "T0", QualityRule.SET, 3_012_414, Over.SUM),
    (47_000, 15_000, [], "T1", QualityRule.SCALE, 3_175_374, Over.SUM),
    (48_000, 27_000, ["T2"], "T0", QualityRule.ADD, 2_101_190, Over.MEAN),
    (13_000, 19_000, ["T1"], "T1", QualityRule.SET, 134_195, Over.SUM),
]
RING = [
    (10_000, 24_000, [], "T0", QualityRule.SET, 296_146, Over.WORST),
    (10_000, 24_000, ["T2"], "T1", QualityRule.SCALE, 5_973_295, Over.BEST),
    (14_000, 32_000, ["T2"], "T0", QualityRule.LIMIT, 2_395_719, Over.MEAN),
    (22_000, 9_000, ["T1"], "T2", QualityRule.SET, 980_365, Over.SUM),
    (0, 17_000, [], "T2", QualityRule.ADD, 3_177_458, Over.WORST),
    (48_000, 15_000, ["T1"], "T0", QualityRule.ADD, 4_939_513, Over.BEST),
]
Row = tuple[int, int, list[str], str, QualityRule, int, Over]


def asking(rows: list[Row], horizon_s: int, wishes: dict[str, Wish], attribute: QualityAttribute = LOW) -> Problem:
    """Each row a transformation: labor, upkeep, demanded tags, the tag given, what is stated; a target for each tag."""
    library = tuple(
        Transformation(
            f"t{i}",
            tuple(InputPort(f"i{n}", tag) for n, tag in enumerate(demanded)),
            (OutputPort("o", given, (Contribution("q", rule, value, over),)),),
            labor_us=labor_us,
            upkeep_us=upkeep_us,
        )
        for i, (labor_us, upkeep_us, demanded, given, rule, value, over) in enumerate(rows)
    )
    targets = tuple(Target(tag, tag, f"/{tag}", quality=(wish,)) for tag, wish in wishes.items())
    similarity = Similarity({tag: frozenset({tag}) for tag in ("T0", "T1", "T2")})
    return Problem(Environment((), library, targets, qualities=(attribute,)), similarity, horizon_s)


@pytest.mark.parametrize(
    ("problem", "cost_us"),
    [
        (asking(AMPLIFIERS, 1, {"T1": Wish("q", 4_210_106, 1_000_000)}), 81_195),
        (asking(RING, 7, {"T2": Wish("q", 5_168_054, 1_000_000), "T0": Wish("q", 3_359_278)}), 1_415_365),
    ],
    ids=["amplifiers", "ring"],
)
@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
def test_what_every_value_keeps_leaves_out_nothing(planner: str, problem: Problem, cost_us: int) -> None:
    plan = PLANNERS[planner](problem)
    assert plan_violations(problem, plan) == []
    assert (plan.status, plan.cost_us, plan.ties_proven) == (Status.OPTIMAL, cost_us, True)


@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
def test_what_runs_is_kept_where_a_bound_asks_for_nothing(planner: str) -> None:
    """The detector's five seconds count as the worst of the scale, 3.3; the target bears 4."""
    latency = QualityAttribute("latency", Better.LOWER, worst=3_300_000, best=0)
    image, map_ = (
        OutputPort("image", "Image", (Contribution("latency", QualityRule.LIMIT, 500_000),)),
        OutputPort("map", "Map", (Contribution("latency", QualityRule.LIMIT, 5_000_000),)),
    )
    library = (
        Transformation("camera", (), (image,), upkeep_us=100_000),
        Transformation("detector", (InputPort("image", "Image"),), (map_,), upkeep_us=100_000),
    )
    feed = Subscription("image", Stream("camera.1", "image"))
    units = (ComputationUnit("camera.1", "camera"), ComputationUnit("detector.1", "detector", (feed,)))
    target = Target("t", "Map", "/t", quality=(Wish("latency", 4_000_000, 1_000_000),))
    similarity = Similarity({tag: frozenset({tag}) for tag in ("Image", "Map")})
    plan = PLANNERS[planner](Problem(Environment(units, library, (target,), qualities=(latency,)), similarity, 60))
    assert (plan.status, plan.cost_us, plan.ties_proven) == (Status.OPTIMAL, 15_300_000, True)


@pytest.mark.parametrize(("attribute", "bound"), [(LOW, 99_999), (HIGH, 3_300_001)])
@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
def test_nothing_keeps_a_bound_that_is_better_than_the_best(
    planner: str, attribute: QualityAttribute, bound: int
) -> None:
    best: Row = (1, 1, [], "T1", QualityRule.SET, attribute.best, Over.WORST)
    assert PLANNERS[planner](asking([best], 1, {"T1": Wish("q", attribute.best)}, attribute)).status is Status.OPTIMAL
    refused = PLANNERS[planner](asking([best], 1, {"T1": Wish("q", bound)}, attribute))
    assert (refused.status, [*refused.reasons]) == (Status.INFEASIBLE, ["T1"])


@pytest.mark.parametrize(
    ("attribute", "bound", "worst"),
    [
        (LOW, None, 3_300_000),
        (LOW, 3_300_000, 3_300_000),
        (LOW, 5_000_000, 3_300_000),
        (LOW, 2, 2),
        (HIGH, 0, 100_000),
        (HIGH, 100_000, 100_000),
        (HIGH, 4_000_000, 4_000_000),
    ],
)
def test_the_worst_allowed_is_no_worse_than_the_scale(
    attribute: QualityAttribute, bound: int | None, worst: int
) -> None:
    assert worst_allowed(attribute, Wish("q", bound)) == worst
