"""The camera, its images, and what is found in them."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import units
from football import field, seeing
from football.camera import HEIGHT, WIDTH, Camera, Pose
from football.field import BALL_RADIUS_M
from football.rendering import Renderer
from hypothesis import given
from hypothesis import strategies as st

poses = st.builds(Pose, st.floats(-4, 4), st.floats(-3, 3), st.floats(-3, 3))
cameras = st.builds(Camera, poses, st.floats(0.3, 0.6), st.floats(0.2, 0.6), st.floats(-0.1, 0.1))
NOWHERE = (40.0, 40.0)


@given(cameras, st.floats(0, WIDTH - 1), st.floats(HEIGHT / 2, HEIGHT - 1), st.floats(0, 0.1))
def test_a_pixel_is_taken_to_the_field_and_back(camera: Camera, u: float, v: float, height: float) -> None:
    place = camera.point_at_height(u, v, height)
    assert place is not None
    assert camera.pixel(np.array([*place, height])) == pytest.approx((u, v), abs=1e-6)


@given(cameras, st.floats(0.5, 4), st.floats(-1, 1))
def test_the_homography_of_the_ground_is_the_projection(camera: Camera, ahead: float, aside: float) -> None:
    pose = camera.pose
    x = pose.x + ahead * math.cos(pose.heading) - aside * math.sin(pose.heading)
    y = pose.y + ahead * math.sin(pose.heading) + aside * math.cos(pose.heading)
    u, v, scale = camera.from_ground @ (x, y, 1.0)
    assert camera.pixel(np.array([x, y, 0.0])) == pytest.approx((u / scale, v / scale), abs=1e-6)


@given(cameras, st.floats(0, WIDTH - 1))
def test_above_the_horizon_no_ray_meets_the_ground(camera: Camera, u: float) -> None:
    horizon = camera.horizon(u)
    assert camera.point_at_height(u, horizon - 1, 0.0) is None
    assert camera.point_at_height(u, horizon + 1, 0.0) is not None


def luma(camera: Camera, picture: field.Bytes, x: float, y: float) -> float:
    """How bright the image is where a point of the ground is seen; the noise is averaged away."""
    pixel = camera.pixel(np.array([x, y, 0.0]))
    assert pixel is not None
    u, v = round(pixel[0]), round(pixel[1])
    return float(picture[v - 1 : v + 2, u - 1 : u + 2, 0].mean())


def test_lines_carpet_and_floor_are_where_the_camera_model_puts_them() -> None:
    camera = Camera(Pose(-1.2, -0.2, 0.1))
    picture = Renderer(1).picture(camera, NOWHERE)
    assert luma(camera, picture, 0.0, 0.2) == pytest.approx(field.WHITE[0], abs=12)
    assert luma(camera, picture, -0.2, 0.2) == pytest.approx(field.GREEN[0], abs=12)
    sideways = Camera(Pose(-1.2, 2.4, math.pi / 2))
    assert luma(sideways, Renderer(1).picture(sideways, NOWHERE), -1.2, 3.9) == pytest.approx(field.FLOOR[0], abs=12)


def test_images_are_yuyv_and_every_two_are_noisy_in_another_way() -> None:
    renderer, camera = Renderer(1), Camera(Pose(0, 0, 0))
    one, other = (renderer.picture(camera, (1.0, 0.0)) for _ in range(2))
    assert one.shape == (480, 640, 2)
    assert 3 < np.std(one[..., 0].astype(int) - other[..., 0]) < 8
    u, v = one[300, 0::2, 1], one[300, 1::2, 1]
    assert np.median(u) == field.GREEN[1]
    assert np.median(v) == field.GREEN[2]


def test_the_subsampler_gives_three_channels_in_five_sizes() -> None:
    camera = Camera(Pose(0, 0, 0))
    sizes = units.Subsampler()(image=Renderer(1).picture(camera, (1.0, 0.0)))
    widths = (640, 320, 160, 80, 40)
    assert {name: image.shape for name, image in sizes.items()} == {
        f"{channel}{width}": (width * 3 // 4, width) for channel in "yuv" for width in widths
    }
    for channel in "yuv":
        means = [float(sizes[f"{channel}{width}"].mean()) for width in widths]
        assert means == pytest.approx([means[0]] * 5, abs=1)


def hull_of(camera: Camera) -> seeing.Points:
    sizes = units.Subsampler()(image=Renderer(1).picture(camera, NOWHERE))
    hull = units.Segmenter()(y=sizes["y80"], v=sizes["v80"])
    assert hull is not None
    return hull


def test_the_hull_holds_the_carpet_and_nothing_beyond_it() -> None:
    camera = Camera(Pose(-1.2, 1.9, 1.2))
    hull = hull_of(camera)
    for x in (-1.2, -0.8, -0.4):
        edge = camera.pixel(np.array([x, 3.7, 0.0]))
        assert edge is not None
        assert cv2.pointPolygonTest(hull, edge, measureDist=True) == pytest.approx(0, abs=10)
        assert cv2.pointPolygonTest(hull, (edge[0], edge[1] + 20), measureDist=False) == 1
        assert cv2.pointPolygonTest(hull, (edge[0], edge[1] - 15), measureDist=False) == -1


def test_where_nothing_is_green_there_is_no_hull() -> None:
    grey = np.full((60, 80), 128, np.uint8)
    assert units.Segmenter()(y=grey, v=grey) is None


def detected(camera: Camera, ball: tuple[float, float], seed: int = 1) -> dict[str, float] | None:
    sizes = units.Subsampler()(image=Renderer(seed).picture(camera, ball))
    hull = units.Segmenter()(y=sizes["y80"], v=sizes["v80"])
    assert hull is not None
    return units.BallDetector()(hull=hull, fine=sizes["y640"], coarse=sizes["y320"])


@pytest.mark.parametrize("aside", [-0.3, 0.0, 0.25])
@pytest.mark.parametrize("ahead", [0.7, 1.1, 1.9, 3.0])
def test_a_ball_is_found_where_it_is(ahead: float, aside: float) -> None:
    camera = Camera(Pose(-1.0, 0.3, 0.0))
    ball = (-1.0 + ahead, 0.3 + aside)
    found, truth = detected(camera, ball), camera.pixel(np.array([*ball, BALL_RADIUS_M]))
    assert found is not None
    assert truth is not None
    assert math.hypot(found["u"] - truth[0], found["v"] - truth[1]) < 2.5


def test_lines_are_no_ball() -> None:
    for step in range(12):
        assert detected(Camera(Pose(-0.8, 0.2, 0.5 * step)), NOWHERE, seed=step) is None


def test_a_ball_beside_the_field_is_not_the_ball() -> None:
    x, y = field.SPARE_BALLS[0]
    camera = Camera(Pose(x, y - 1.5, math.pi / 2))
    assert camera.pixel(np.array([x, y, BALL_RADIUS_M])) is not None
    assert detected(camera, NOWHERE) is None
    whole_image = np.array([[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]], np.float32)
    sizes = units.Subsampler()(image=Renderer(1).picture(camera, NOWHERE))
    assert units.BallDetector()(hull=whole_image, fine=sizes["y640"], coarse=sizes["y320"]) is not None
