"""Conditions in a state: true, false, or unknown, and what is told about values that do not suit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from cfgplan_runtime.reasoning.conditions import Evaluator
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.program import compiled
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.regions import region_from
from cfgplan_runtime.reasoning.truth import Verdict

REGIONS = {"goal": region_from({"circle": [4, 0], "radius": 1}), "field": region_from({"box": [-4, -3, 5, 3]})}
KNOWN = Vocabulary({"ball", "robot"}, REGIONS)
STATE: dict[str, object] = {
    "ball": {"x": 3.5, "y": 0, "seen": True, "hull": [[3, -1], [5, -1], [5, 1], [3, 1]], "nan": float("nan")},
    "robot": {"at": np.array([1.0, 0.0]), "state": "play", "hands": [{"open": np.bool_(False)}], "none": None},
}


def decide(text: str, state: Mapping[str, object] = STATE) -> tuple[Verdict, list[str]]:
    told: list[str] = []
    program = compiled(parse(text, KNOWN))
    evaluator = Evaluator(program, REGIONS, told.append)
    evaluator.truths(state)
    return Monitor(program).step(0, evaluator.truths(state)), told


@pytest.mark.parametrize(
    "text",
    [
        "ball.x > 3 and ball.y == 0",
        "(ball.x - 0.5) * 2 / 3 == 2 and abs(-ball.x) > 3 and -2 < ball.y",
        "ball.seen",
        "ball.seen == true",
        "not robot.hands[0].open",
        "robot.state == 'play' and robot.state != 'set'",
        "in(ball, goal) and not in(robot.at, goal)",
        "distance(ball, robot.at) == 2.5",
        "robot.at[0] == 1",
        "in(robot.at, field)",
        "in(ball, ball.hull) and tpp(ball.hull, field)",
        "EQ(goal, goal) and ntpp(goal, goal) -> dc(goal, field)",
    ],
)
def test_conditions_that_hold(text: str) -> None:
    assert decide(text) == (Verdict.TRUE, [])


def test_a_condition_that_does_not_hold_is_false() -> None:
    assert decide("ball.x < 3") == (Verdict.FALSE, [])


@pytest.mark.parametrize("text", ["ball.nan > 3", "robot.none > 3", "in(robot.none, goal)"])
def test_a_value_that_is_not_there_is_unknown(text: str) -> None:
    assert decide(text) == (Verdict.UNKNOWN, [])


def test_a_feature_without_a_value_is_unknown_and_decides_only_what_depends_on_it() -> None:
    assert decide("ball.x > 3", {}) == (Verdict.UNKNOWN, [])
    assert decide("ball.x > 3 or robot.state == 'play'", {"robot": STATE["robot"]}) == (Verdict.TRUE, [])
    assert decide("ball.x > 3 and robot.state == 'set'", {"robot": STATE["robot"]}) == (Verdict.FALSE, [])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("ball.z > 3", "ball has no field `z`; it has hull, nan, seen, x, y"),
        ("ball.x.z > 3", "ball.x is 3.5 and has no field `z`"),
        ("robot.hands[2].open", "robot.hands has only 1 members"),
        ("ball[0] > 3", "ball is a dict, not a list"),
        ("ball.seen > 3", "True and 3.0 are compared by >"),
        ("robot.state + 1 > 3", 'robot.state is "play", not a number'),
        ("robot.state > 1", '"play" and 1.0 are compared by >'),
        ("robot.state", 'robot.state is "play", not true or false'),
        ("1 / ball.y > 3", "ball.y is 0"),
        ("in(robot.state, goal)", "robot.state is no point: it has neither x and y nor two numbers"),
        ("in(ball, ball.x)", "ball.x is not a region: a polygon is a list of three or more points"),
        ("ec(robot.at, goal)", "robot.at is not a region"),
    ],
)
def test_a_value_that_does_not_suit_is_unknown_and_told_once(text: str, told: str) -> None:
    truth, heard = decide(text)
    assert truth is Verdict.UNKNOWN
    (one,) = heard
    assert told in one


def test_a_mapping_without_fields_has_none_to_compare() -> None:
    truth, (told,) = decide("ball > 3", {"ball": {}})
    assert (truth, told) == (Verdict.UNKNOWN, "ball > 3 is unknown where a dict and 3.0 are compared by >")
