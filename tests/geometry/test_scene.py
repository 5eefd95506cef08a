"""The half-ball against the paper's equations, points by hand, and the symmetries of the world.

side view:      . - ~ ~ - .            o virtual camera, D0 the radius
             .'      o      '.         a ray that starts inside leaves once:
ground  ____/________|________\\____    through the ball (eq. 2) or through the ground (eq. 1)
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.geometry.strategies import balls_with_inner_points, half_balls, lenses, poses, reals, rotations, units
from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.scene import GroundPlane, HalfBall

LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # ego from a level camera that looks ahead
TURNED_OVER = np.diag([1.0, -1.0, -1.0])
D0 = 50.0


def level_camera_points(lens: Pinhole, height: float, radius: float, pixels: np.ndarray) -> np.ndarray:
    """The scene points of pixels, in the frame of a level camera `height` above flat ground."""
    centre = np.array([1.0, 2.0, height])
    ball = HalfBall(centre, radius, GroundPlane())
    points = ball.surface_points(centre, lens.unproject(np.asarray(pixels, dtype=np.float64)) @ LEVEL.T)
    return (points - centre) @ LEVEL


def eq_1(lens: Pinhole, height: float, u: float, v: float) -> np.ndarray:
    """UniDrive eq. 1 taken literally: the ground point of a pixel of a level camera, in the camera's frame."""
    depth = lens.fy_px * height / (v - lens.cy_px)
    return np.array([(u - lens.cx_px) / lens.fx_px * depth, height, depth])


# --- equations 1 and 2 -------------------------------------------------------------------------------


def test_equation_1_by_hand() -> None:
    """150 px below the horizon at f 1000 and 1.5 m up: 10 m ahead; 200 px to the right: 2 m to the right."""
    lens = Pinhole(1000.0, 1000.0, 799.5, 449.5, 1600, 900)
    np.testing.assert_allclose(level_camera_points(lens, 1.5, D0, [[999.5, 599.5]]), [[2.0, 1.5, 10.0]], atol=1e-12)


@given(lenses(), reals(0.5, 3.0), reals(5.0, 100.0), reals(0, 1), reals(0, 1))
def test_a_level_camera_follows_equations_1_and_2(
    lens: Pinhole, height: float, radius: float, a: float, b: float
) -> None:
    """Below the horizon: eq. 1 where the ground is nearer than D0, else eq. 2. Above it: eq. 2."""
    u, v = a * lens.width_px - 0.5, b * lens.height_px - 0.5
    ray = np.array([(u - lens.cx_px) / lens.fx_px, (v - lens.cy_px) / lens.fy_px, 1.0])
    expected = radius * ray / np.linalg.norm(ray)
    if v - lens.cy_px > 1e-6 and np.linalg.norm(eq_1(lens, height, u, v)) < radius:
        expected = eq_1(lens, height, u, v)
    np.testing.assert_allclose(level_camera_points(lens, height, radius, [[u, v]])[0], expected, atol=1e-7)


def test_ground_and_ball_meet_at_d0_without_a_step() -> None:
    lens = Pinhole(1000.0, 1000.0, 799.5, 449.5, 1600, 900)
    v_seam = 449.5 + 1000 * 1.5 / np.sqrt(D0**2 - 1.5**2)
    below, at, above = level_camera_points(lens, 1.5, D0, [[799.5, v_seam + d] for d in (1e-9, 0, -1e-9)])
    assert np.linalg.norm(at) == pytest.approx(D0, abs=1e-9)
    np.testing.assert_allclose([below, above], [at, at], atol=1e-5)


def test_a_pixel_above_the_horizon_never_lands_on_the_ground_behind_the_camera() -> None:
    """What eq. 1 alone would give, and what the half-ball gives, 150 px above the horizon."""
    lens = Pinhole(1000.0, 1000.0, 799.5, 449.5, 1600, 900)
    literal = eq_1(lens, 1.5, 999.5, 299.5)
    np.testing.assert_allclose(literal, [-2.0, 1.5, -10.0])  # on the ground, 10 m BEHIND the camera,
    assert np.linalg.norm(literal) < D0  # and near enough to pass the D < D0 test of Algorithm 1
    (point,) = level_camera_points(lens, 1.5, D0, [[999.5, 299.5]])
    np.testing.assert_allclose(point, D0 * np.array([0.2, -0.15, 1]) / np.linalg.norm([0.2, -0.15, 1]), atol=1e-12)


@given(half_balls(), units(3))
def test_a_ray_that_does_not_descend_ends_on_the_ball_in_front(ball: HalfBall, ray: np.ndarray) -> None:
    """The same for a camera of any pitch and roll on any ground."""
    up = ray if ray @ ball.ground.normal >= 0 else -ray
    assert ball.exit_distance_m(ball.centre_ego, up) == pytest.approx(ball.radius_m, rel=1e-12)


# --- inside ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("origin", "direction", "distance"),
    [
        ((3, 0, 2), (1, 0, 0), 2),  # 3 m off the centre of a 5 m ball: 5 - 3
        ((3, 0, 2), (-1, 0, 0), 8),
        ((3, 0, 2), (0, 1, 0), 4),  # 3-4-5
        ((3, 0, 2), (0, 0, 1), 4),
        ((3, 0, 2), (0, 0, -1), 2),  # the ground
        ((3, 0, 1), (0, 0, -1), 1),
        ((0, 0, 2), (0.6, 0, -0.8), 2.5),  # 2 m down along a 3-4-5 slope
        ((5, 0, 2), (1, 0, 0), 0),  # on the ball, leaving it
        ((1, 0, 0), (0, 0, -1), 0),  # on the ground, leaving it
        ((1, 0, 0), (0, 0.6, 0.8), 1.6 + np.sqrt(1.6**2 + 20)),
    ],
)
def test_rays_from_inside_by_hand(origin: tuple, direction: tuple, distance: float) -> None:
    """Centre (0, 0, 2), D0 5 m, flat ground. The last: |(1, 0, -2) + t d| = 5, so t^2 - 3.2 t - 20 = 0."""
    ball = HalfBall(np.array([0.0, 0.0, 2.0]), 5.0, GroundPlane())
    found = ball.exit_distance_m(np.array(origin, dtype=np.float64), np.array(direction, dtype=np.float64))
    assert found == pytest.approx(distance, abs=1e-12)


@given(balls_with_inner_points(), units(3))
def test_a_ray_from_inside_stays_inside_until_it_leaves_once(
    ball_and_origin: tuple[HalfBall, np.ndarray], direction: np.ndarray
) -> None:
    ball, origin = ball_and_origin
    distance = float(ball.exit_distance_m(origin, direction))
    assert distance >= 0
    on_the_way = origin + np.linspace(0, 1, 9)[:, None] * distance * direction
    assert ball.contains(on_the_way, tolerance_m=1e-9).all()
    exit_point = ball.surface_points(origin, direction)
    off_the_ball = ball.radius_m - np.linalg.norm(exit_point - ball.centre_ego)
    off_the_ground = exit_point @ ball.ground.normal - ball.ground.offset_m
    assert min(abs(off_the_ball), abs(off_the_ground)) < 1e-9
    beyond = origin + (distance + np.array([0.01, 0.1, 1, 10]) * ball.radius_m)[:, None] * direction
    assert not ball.contains(beyond, tolerance_m=0).any()


def test_shapes_broadcast() -> None:
    ball = HalfBall(np.array([0.0, 0.0, 2.0]), 5.0, GroundPlane())
    rays = np.broadcast_to([0.0, 0.0, -1.0], (4, 6, 3))
    assert ball.surface_points(ball.centre_ego, rays).shape == (4, 6, 3)
    origins = np.array([[0.0, 0, 1], [0, 0, 2], [0, 0, 3]])
    np.testing.assert_array_equal(ball.exit_distance_m(origins, np.array([0.0, 0, -1])), [1, 2, 3])
    np.testing.assert_array_equal(
        ball.contains(np.array([[0.0, 0, -1], [0, 0, 8], [0, 0, 7]])), [False, False, True]
    )


# --- any ground --------------------------------------------------------------------------------------


def test_ground_height_lifts_the_plane() -> None:
    ball = HalfBall(np.array([0.0, 0.0, 2.0]), 50.0, GroundPlane(0.5))
    np.testing.assert_allclose(ball.surface_points(ball.centre_ego, np.array([0.6, 0, -0.8])), [1.125, 0, 0.5])


@pytest.mark.parametrize(
    ("direction", "point"),
    [
        ((0, 0, -1), (0, 0, 0)),  # the slope passes through the ego origin
        ((1, 0, 0), (8 / 3, 0, 2)),  # a LEVEL ray runs into a rising road
        ((-1, 0, 0), (-50, 0, 2)),  # and never into a falling one
        ((-0.6, 0, 0.8), (-30, 0, 42)),  # straight away from the road
    ],
)
def test_a_road_that_rises_three_in_four(direction: tuple, point: tuple) -> None:
    """Plane z = 3/4 x, normal (-0.6, 0, 0.8), camera 2 m above the origin."""
    ball = HalfBall(np.array([0.0, 0.0, 2.0]), 50.0, GroundPlane(0.0, np.array([-0.6, 0, 0.8])))
    found = ball.surface_points(ball.centre_ego, np.array(direction, dtype=np.float64))
    np.testing.assert_allclose(found, point, atol=1e-12)


@given(
    balls_with_inner_points(),
    poses(10.0),
    rotations,
    lenses(),
    st.lists(st.tuples(reals(0, 1), reals(0, 1)), min_size=1),
)
def test_moving_the_whole_world_changes_nothing(
    ball_and_origin: tuple[HalfBall, np.ndarray],
    new_from_old: np.ndarray,
    ego_from_cam: np.ndarray,
    lens: Pinhole,
    shares: list[tuple[float, float]],
) -> None:
    """Camera, plane and ball turned and shifted together: in the camera's own frame all points are the same."""
    ball, origin = ball_and_origin
    turn, shift = new_from_old[:3, :3], new_from_old[:3, 3]
    normal = turn @ ball.ground.normal
    if normal[2] < 0:  # the road must stay below: turn the world over
        turn, normal = TURNED_OVER @ turn, TURNED_OVER @ normal
    assume(normal[2] > 0.01)
    moved = HalfBall(
        turn @ ball.centre_ego + shift, ball.radius_m, GroundPlane(ball.ground.offset_m + normal @ shift, normal)
    )
    rays = lens.unproject(np.array(shares) * [lens.width_px, lens.height_px] - 0.5) @ ego_from_cam.T
    for start in (ball.centre_ego, origin):
        here = ball.surface_points(start, rays) - start
        there = moved.surface_points(turn @ start + shift, rays @ turn.T) - (turn @ start + shift)
        np.testing.assert_allclose(there @ turn @ ego_from_cam, here @ ego_from_cam, atol=1e-6)


# --- refused -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "radius", "ground", "sentence"),
    [
        (-0.5, 50.0, GroundPlane(), r"is 0\.5 m below the ground"),
        (1.0, 50.0, GroundPlane(1.2), r"is 0\.2 m below the ground"),
        (0.0, 50.0, GroundPlane(), "above"),
        (1.6, 1.6, GroundPlane(), r"depth limit \(1\.6 m\) must be larger than .*height .*\(1\.6 m\)"),
        (1.6, 1.0, GroundPlane(), "depth limit"),
        (1.6, -50.0, GroundPlane(), "depth limit"),
        (1.6, 1.2, GroundPlane(0.5), None),  # only 1.1 m above its ground
        (1.6, np.nan, GroundPlane(), "depth limit must be finite"),
        (1.6, np.inf, GroundPlane(), "depth limit must be finite"),
        (np.nan, 50.0, GroundPlane(), "centre must be finite"),
    ],
)
def test_a_camera_below_the_ground_or_above_d0_is_refused(
    height: float, radius: float, ground: GroundPlane, sentence: str | None
) -> None:
    if sentence is None:
        HalfBall(np.array([0.0, 0.0, height]), radius, ground)
        return
    with pytest.raises(GeometryError, match=sentence) as caught:
        HalfBall(np.array([0.0, 0.0, height]), radius, ground)
    assert caught.value.exit_code == 2


def test_a_camera_on_the_ground_is_not_minus_zero_metres_below_it() -> None:
    with pytest.raises(GeometryError) as caught:
        HalfBall(np.zeros(3), 50.0, GroundPlane())
    assert "-0 m" not in str(caught.value)


@pytest.mark.parametrize(
    ("offset", "normal"),
    [
        (0.0, [0, 0, 2]),
        (0.0, [0, 0, -1]),
        (0.0, [1, 0, 0]),
        (0.0, [0, 0]),
        (np.nan, [0, 0, 1]),
        (0.0, [0, 0, np.nan]),
    ],
)
def test_what_is_no_ground_is_refused(offset: float, normal: list) -> None:
    with pytest.raises(GeometryError, match="ground"):
        GroundPlane(offset, np.array(normal, dtype=np.float64))


def test_a_half_ball_keeps_its_own_numbers() -> None:
    centre = np.array([0.0, 0.0, 2.0])
    ball = HalfBall(centre, 5.0, GroundPlane())
    centre[2] = -7.0
    assert ball.centre_ego[2] == 2.0
    with pytest.raises(ValueError, match="read-only"):
        ball.centre_ego[0] = 1.0
