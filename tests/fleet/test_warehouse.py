"""The warehouse of `models/fleet`: what cameras see, what is found in pictures, and how right the map is."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations, islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cfgplan_runtime import Runtime, subscribe
from cfgplan_runtime.children.unit_code import find_source
from hypothesis import given
from hypothesis import strategies as st
from warehouse import hall, seeing
from warehouse.hall import CRATE_M, Crate, Pose
from warehouse.picture import Photographer

import cfgplan
from cfgplan.domain import ChangeSet, Environment, Stream
from cfgplan.figures import qualities_of_targets

FLEET = Path(__file__).parents[2] / "models" / "fleet"
START = 1_800_000_000 * 10**9
POSE = Pose(-5.0, 0.0, 0.0)
NEAR, ASIDE, FAR = Crate(-1.2, -0.2, 0), Crate(-1.0, 1.3, 0), Crate(1.3, -0.4, 1)

poses = st.builds(Pose, st.floats(-6, 6), st.floats(-4, 4), st.floats(-3.1, 3.1))


def unit_code(name: str) -> Any:
    return find_source(f"units.py:{name}", str(FLEET))


@given(poses, st.floats(1.7, 8), st.floats(-0.5, 0.5))
def test_a_place_on_the_floor_is_taken_to_its_pixel_and_back(pose: Pose, distance: float, aside: float) -> None:
    x, y = (pose.x + distance * math.cos(pose.heading + aside), pose.y + distance * math.sin(pose.heading + aside))
    pixel = hall.pixel(pose, x, y, 0.0)
    assert pixel is not None
    assert hall.on_floor(pose, *pixel) == pytest.approx((x, y, distance), abs=1e-6)


def test_above_the_horizon_no_pixel_shows_the_floor() -> None:
    assert hall.on_floor(POSE, 160, 5) is None


@given(st.integers(0, 10**12))
def test_crates_keep_apart_and_robots_look_at_them(after_ns: int) -> None:
    crates = hall.crates(START + after_ns)
    assert all(math.hypot(a.x - b.x, a.y - b.y) > 1.0 for a, b in combinations(crates, 2))
    for robot in ("r1", "r2"):
        pose = hall.pose(robot, START + after_ns)
        seen = [hall.pixel(pose, crate.x, crate.y, CRATE_M / 2) for crate in crates]
        inside = [p for p in seen if p and 0 < p[0] < hall.WIDTH and 0 < p[1] < hall.HEIGHT]
        assert len(inside) >= 2


def test_a_robot_that_is_not_in_the_hall_is_refused() -> None:
    with pytest.raises(ValueError, match="no robot 'r3' is in the hall, only r1, r2"):
        hall.pose("r3", START)


def test_a_crate_is_drawn_where_the_camera_model_puts_it_and_nowhere_else() -> None:
    picture = Photographer(1).picture(POSE, [FAR, NEAR]).astype(int)
    assert picture.shape == (240, 320, 3)
    warmth = picture[..., 0] - picture[..., 2]
    for crate, sign in ((NEAR, 1), (FAR, -1)):
        pixel = hall.pixel(POSE, crate.x, crate.y, CRATE_M)
        assert pixel is not None
        u, v = map(round, pixel)
        assert (sign * warmth[v - 1 : v + 2, u - 1 : u + 2] > 80).all()
        rows, columns = np.nonzero(sign * warmth > 80)
        assert 50 < len(rows) < 3000
        assert max(abs(rows - v).max(), abs(columns - u).max()) < 45


def test_every_two_pictures_are_noisy_in_another_way_and_no_colour_overflows() -> None:
    photographer = Photographer(1)
    one, other = (photographer.picture(POSE, hall.crates(START)).astype(int) for _ in range(2))
    assert 4 < np.std(one - other) < 8
    assert abs(one - other).max() < 50


@pytest.mark.parametrize(("grain", "limit_m"), [(1, 0.12), (4, 0.35)])
@pytest.mark.parametrize("ahead", [2.5, 3.4, 4.6, 6.0])
@pytest.mark.parametrize("aside", [-0.7, 0.0, 0.5])
def test_a_crate_is_found_where_it_stands(ahead: float, aside: float, grain: int, limit_m: float) -> None:
    crate = Crate(POSE.x + ahead, POSE.y + aside, 0)
    (found,) = seeing.obstacles(seeing.boxes(Photographer(1).picture(POSE, [crate]), grain), POSE)
    assert math.hypot(found["x"] - crate.x, found["y"] - crate.y) < limit_m
    assert found["error"] < limit_m


@pytest.mark.parametrize("grain", [1, 4])
def test_nothing_is_found_where_nothing_stands(grain: int) -> None:
    for number in range(10):
        assert seeing.boxes(Photographer(number).picture(replace(POSE, heading=0.6 * number), []), grain) == []


@pytest.mark.parametrize("grain", [1, 4])
def test_a_crate_that_another_hides_or_the_edge_cuts_off_is_left_out(grain: int) -> None:
    def count(*crates: Crate) -> int:
        return len(seeing.boxes(Photographer(1).picture(POSE, crates), grain))

    assert count(NEAR, ASIDE, Crate(1.3, -1.4, 1)) == 3
    assert count(NEAR, ASIDE, Crate(-0.2, -0.3, 1)) == 2
    assert count(NEAR, Crate(-3.3, 1.0, 0)) == 1
    assert count(Crate(-3.6, 0.0, 0)) == 0


def test_two_crates_that_touch_in_the_picture_are_no_obstacle() -> None:
    boxes = seeing.boxes(Photographer(1).picture(POSE, [NEAR, Crate(NEAR.x, NEAR.y + CRATE_M, 0)]), 1)
    assert len(boxes) == 1
    assert seeing.obstacles(boxes, POSE) == []


def test_what_both_robots_see_is_in_the_map_once_nearer_to_who_sees_it_better() -> None:
    sure, unsure = {"x": 1.0, "y": 0.0, "error": 0.1}, {"x": 1.3, "y": 0.0, "error": 0.2}
    alone = {"x": -1.0, "y": 2.0, "error": 0.1}
    merge = unit_code("merge_obstacles")
    assert merge(one=[sure], other=[alone, unsure]) == [{"x": 1.06, "y": 0.0, "error": 0.089}, alone]
    assert merge(one=[sure, alone], other=[]) == [sure, alone]


@pytest.mark.parametrize("source", ["Camera", "Localiser"])
def test_no_frame_is_given_before_its_time_and_none_twice(source: str) -> None:
    given = (one for one in unit_code(source)(robot="r1") if one is not None)
    late_ns = [(one.time_ns, time.time_ns() - one.time_ns) for one in islice(given, 4)]
    assert all(earlier < later for (earlier, _), (later, _) in pairwise(late_ns))
    assert all(late >= 0 for _, late in late_ns)


def value_of(stream: Stream, environment: Environment, codes: Mapping[str, Any], time_ns: int) -> Any:
    """What a stream gives for a moment, by hand: units are called with what feeds them."""
    code = codes[stream.unit]
    feeds = {unit.id: unit.feeds for unit in environment.units}[stream.unit]
    if feeds:
        return code(**{port: value_of(feed, environment, codes, time_ns) for port, (feed,) in feeds.items()})
    return code.picture(time_ns) if stream.port == "image" else code.pose(time_ns)


@pytest.mark.parametrize(
    ("stage", "robots", "least_found"), [("1-start", 1, 0.5), ("2-better-map", 2, 0.8), ("3-best-map", 1, 0.5)]
)
def test_the_planned_units_find_the_crates_with_the_error_that_is_promised(
    stage: str, robots: int, least_found: float
) -> None:
    problem = cfgplan.match(cfgplan.load(FLEET / f"{stage}.yaml"))
    change_set = cfgplan.plan(problem).change_set
    assert change_set is not None
    after = problem.environment.update(change_set)
    promised_m = qualities_of_targets(after, after.units)["obstacles"]["error"] / 1e6
    library = after.transformation
    codes = {}
    for unit in after.units:
        code = find_source(library[unit.transformation].source or "", str(FLEET))
        codes[unit.id] = code(**library[unit.transformation].params) if isinstance(code, type) else code
    assert sum(unit.transformation.startswith("camera") for unit in after.units) == robots
    (stream,) = (Stream(unit.id, p.port) for unit in after.units for p in unit.publications)
    errors, crates_found, crates_there = [], 0, 0
    for number in range(40):
        time_ns = hall.time_of_frame(15 * START // 10**9 + 97 * number, 15)
        crates = hall.crates(time_ns)
        nearest = [
            min((math.hypot(one["x"] - crate.x, one["y"] - crate.y), index) for index, crate in enumerate(crates))
            for one in value_of(stream, after, codes, time_ns)
        ]
        errors += [distance for distance, _ in nearest]
        crates_found += len({index for _, index in nearest})
        crates_there += len(crates)
        assert len(nearest) == len({index for _, index in nearest})
    assert math.sqrt(np.mean(np.square(errors))) < promised_m
    assert max(errors) < 0.5
    assert crates_found > least_found * crates_there


def test_the_map_comes_from_units_that_run_as_processes_of_one_computer() -> None:
    problem = cfgplan.match(cfgplan.load(FLEET / "2-better-map.yaml"))
    change_set = cfgplan.plan(problem).change_set
    assert change_set is not None
    here = [replace(unit, host=None) for unit in change_set.started]
    targets = [replace(target, host=None, quality=()) for target in problem.environment.targets]
    with Runtime(problem.environment.library, targets, folder=FLEET) as runtime:
        runtime.apply(ChangeSet(started=tuple(here)))
        with subscribe("/obstacles", run=runtime.id, timeout_s=30) as subscription:
            for received in islice(subscription, 8):
                crates = hall.crates(received.time_ns)
                assert len(received.value) >= 2
                for one in received.value:
                    assert min(math.hypot(one["x"] - crate.x, one["y"] - crate.y) for crate in crates) < 0.5
