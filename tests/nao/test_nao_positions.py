"""Times, poses, and the ball's position on the field."""

from __future__ import annotations

import math

import numpy as np
import pytest
import units
from football import scenario
from football.camera import Camera, Pose
from football.field import BALL_RADIUS_M
from football.locating import BallPosition, fused, located
from hypothesis import given
from hypothesis import strategies as st

START = 1_800_000_000 * 1_000_000_000


def test_frames_of_late_and_jittering_ticks_are_all_given_in_order() -> None:
    random = np.random.default_rng(1)
    clock = scenario.FrameClock()
    late_ns = [int(late) for late in random.exponential(0.03, 1000) * 1e9]
    asked = sorted(START + tick * 10**9 // 30 + late for tick, late in enumerate(late_ns))
    times = [time for now in asked if (time := clock.frame(now)) is not None]
    first = times[0] * 15 // 10**9
    assert len(times) > 490
    assert times == [scenario.time_of_frame(first + number) for number in range(len(times))]


def test_no_frame_is_given_before_its_time_and_none_twice() -> None:
    clock = scenario.FrameClock()
    times = [clock.frame(START + microsecond * 1000) for microsecond in range(20)]
    assert times == [START, *[None] * 19]


def test_frames_that_are_long_overdue_are_left_out() -> None:
    clock = scenario.FrameClock()
    clock.frame(START)
    assert clock.frame(START + 10**9) == START + 10**9


@given(st.integers(0, 10**12))
def test_the_robots_keep_the_ball_before_them(after_ns: int) -> None:
    ball = scenario.ball(START + after_ns)
    for robot in ("piff", "puff"):
        pose = scenario.pose(robot, START + after_ns)
        assert 0.85 < math.dist((pose.x, pose.y), ball) < 2.35
        pixel = Camera(pose).pixel(np.array([*ball, BALL_RADIUS_M]))
        assert pixel is not None
        assert 60 < pixel[0] < 580
        assert 30 < pixel[1] < 450


def test_a_robot_that_is_not_on_the_field_is_refused() -> None:
    with pytest.raises(ValueError, match="no robot 'paff' is on the field, only piff, puff"):
        scenario.pose("paff", START)


@given(
    st.builds(Pose, st.floats(-4, 4), st.floats(-3, 3), st.floats(-3, 3)),
    st.floats(0.5, 4),
    st.floats(-0.5, 0.5),
)
def test_a_true_pixel_and_a_true_pose_give_the_true_position(pose: Pose, distance: float, aside: float) -> None:
    ball = pose.x + distance * math.cos(pose.heading + aside), pose.y + distance * math.sin(pose.heading + aside)
    pixel = Camera(pose).pixel(np.array([*ball, BALL_RADIUS_M]))
    assert pixel is not None
    found = located(*pixel, pose)
    assert found is not None
    assert (found.x, found.y) == pytest.approx(ball, abs=1e-6)


def test_the_expected_error_grows_with_the_distance_and_most_of_it_along_the_view() -> None:
    near, far = (located(319.5, v, Pose(0, 0, 0)) for v in (300, 120))
    assert near is not None
    assert far is not None
    assert np.linalg.det(near.covariance) < np.linalg.det(far.covariance)
    assert far.covariance[0, 0] > far.covariance[1, 1]


def test_a_ray_above_the_horizon_gives_no_position() -> None:
    assert located(320, 5, Pose(0, 0, 0)) is None


def test_fusion_trusts_each_where_it_is_sure() -> None:
    sure_of_x = BallPosition(1.0, 0.0, np.diag([0.01, 1.0]))
    sure_of_y = BallPosition(0.0, 2.0, np.diag([1.0, 0.01]))
    both = fused(sure_of_x, sure_of_y)
    assert (both.x, both.y) == pytest.approx((0.99, 1.98), abs=0.001)
    assert np.all(np.diag(both.covariance) < 0.01)


def test_with_both_robots_the_position_is_better_than_with_either() -> None:
    cameras = {robot: units.BottomCam(robot) for robot in ("piff", "puff")}
    poses = {robot: units.SelfLocalization(robot) for robot in cameras}
    subsample, segment, detect = units.Subsampler(), units.Segmenter(), units.BallDetector()
    squares: dict[str, list[float]] = {"piff": [], "puff": [], "fused": []}
    for number in range(120):
        time_ns = scenario.time_of_frame(97 * number)
        found = {}
        for robot, camera in cameras.items():
            sizes = subsample(image=camera.picture(time_ns))
            hull = segment(y=sizes["y80"], v=sizes["v80"])
            assert hull is not None
            pixel = detect(hull=hull, fine=sizes["y640"], coarse=sizes["y320"])
            if pixel is not None:
                found[robot] = units.BallLocalization()(pixel=pixel, pose=poses[robot].pose(time_ns))
        if len(found) == 2:
            found["fused"] = units.FuseBallPos()(first=found["piff"], second=found["puff"])
        for stream, position in found.items():
            assert position is not None
            squares[stream].append(math.dist((position["x"], position["y"]), scenario.ball(time_ns)) ** 2)
    assert all(len(one) >= 115 for one in squares.values())
    errors = {stream: math.sqrt(sum(one) / len(one)) for stream, one in squares.items()}
    assert max(errors["piff"], errors["puff"]) < 0.15
    assert errors["fused"] < 0.8 * min(errors["piff"], errors["puff"])
