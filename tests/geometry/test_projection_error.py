"""The projection error of points: where it must be zero, how it must change, and against two other ways to it.

The other ways are a scalar implementation of the formulas, written down from their definition, and the warp's own
remap tables, inverted by Newton's method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.geometry.strategies import poses, units
from tests.geometry.test_distorted_lenses import STRONG
from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.blending import BORDER_FLOOR, PARALLAX_FLOOR
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.geometry.poses import EGO_FROM_LEVEL_CAM, inverse, pose, relative, transform
from unidrive_cli.geometry.projection_error import PointErrors, point_errors, sight
from unidrive_cli.geometry.scene import GroundPlane, HalfBall
from unidrive_cli.rig.model import Camera
from unidrive_cli.warp.remap import Source, VirtualView, build_patches

seeds = st.integers(0, 2**32 - 1)
WIDE = Pinhole.from_hfov(100.0, 800, 600)


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Rotation (3, 3) of ego_from_cam by yaw, pitch (up) and roll, degrees."""
    cosines, sines = np.cos(np.radians([yaw, pitch, roll])), np.sin(np.radians([yaw, pitch, roll]))
    about_z = np.array([[cosines[0], -sines[0], 0], [sines[0], cosines[0], 0], [0, 0, 1]])
    about_y = np.array([[cosines[1], 0, -sines[1]], [0, 1, 0], [sines[1], 0, cosines[1]]])
    about_x = np.array([[1, 0, 0], [0, cosines[2], -sines[2]], [0, sines[2], cosines[2]]])
    return about_z @ about_y @ about_x @ EGO_FROM_LEVEL_CAM


def driven(yaw: float, x_m: float, y_m: float) -> np.ndarray:
    """Pose (4, 4) of the car a moment later, seen from where it was."""
    return pose(turned(yaw) @ EGO_FROM_LEVEL_CAM.T, [x_m, y_m, 0.0])


@dataclass(frozen=True)
class Setting:
    """Sources (lens, cam_from_ego) round one virtual camera, and points of which they see some."""

    sources: list[tuple[Lens, np.ndarray]]
    lens: Pinhole
    ego_from_cam: np.ndarray
    ball: HalfBall
    points: np.ndarray

    def errors(self, points: np.ndarray | None = None) -> PointErrors:
        points = self.points if points is None else points
        sightings = [sight(points, *source) for source in self.sources]
        return point_errors(points, sightings, self.lens, self.ego_from_cam, self.ball)


def random_setting(seed: int, lenses: Sequence[Lens] = ()) -> Setting:
    """Cameras of a car: one to five sources, heights of 1 to 2.5 m, a ground that leans by a few degrees, and points
    ahead of the virtual camera, some under the ground and some beyond the ball."""
    rng = np.random.default_rng(seed)
    normal = np.array([*rng.normal(0, 0.03, 2), 1.0])
    ground = GroundPlane(rng.normal(0, 0.2), normal / np.linalg.norm(normal))

    def stand(yaw_deg: float) -> np.ndarray:
        place = np.array([*rng.uniform(-2, 2, 2), rng.uniform(1.0, 2.5)]) + ground.offset_m * ground.normal
        return pose(turned(yaw_deg, rng.normal(0, 8), rng.normal(0, 5)), place)

    def lens() -> Pinhole:
        width, height = (int(size) for size in rng.integers(200, 2000, 2))
        focal = width * rng.uniform(0.3, 0.9)
        centre = np.array([width, height]) * rng.uniform(0.4, 0.6, 2)
        return Pinhole(focal, focal * rng.uniform(0.9, 1.1), *centre, width, height)

    yaw_deg = rng.uniform(-180, 180)
    ego_from_cam = stand(yaw_deg)
    sources: list[tuple[Lens, np.ndarray]] = [
        (lenses[index % len(lenses)] if lenses else lens(), inverse(stand(yaw_deg + rng.normal(0, 30))))
        for index in range(int(rng.integers(1, 6)))
    ]
    depth = rng.uniform(1, 100, 60)
    points = np.stack([depth * rng.uniform(-1, 1, 60), rng.uniform(-6, 3, 60), depth], axis=-1)
    ball = HalfBall(ego_from_cam[:3, 3], rng.uniform(10, 80), ground)
    return Setting(sources, lens(), ego_from_cam, ball, transform(ego_from_cam, points))


# --- where it is zero -------------------------------------------------------------------------------------------


@given(seeds)
@settings(max_examples=60)
def test_zero_on_the_ground_within_the_limit(seed: int) -> None:
    setting = random_setting(seed)
    ball = setting.ball
    heights = ball.ground.height_m(setting.points)
    points = setting.points - heights[:, None] * ball.ground.normal
    points = points[np.linalg.norm(points - ball.centre_ego, axis=1) < ball.radius_m]
    found = setting.errors(points)
    assert (found.error_m_rad < 1e-9).all()
    assert found.behind == 0


@given(seeds)
@settings(max_examples=60)
def test_zero_at_the_limit_above_the_ground(seed: int) -> None:
    setting = random_setting(seed)
    ball = setting.ball
    rays = setting.points - ball.centre_ego
    points = ball.centre_ego + ball.radius_m * rays / np.linalg.norm(rays, axis=1)[:, None]
    points = points[ball.ground.height_m(points) > 0]
    found = setting.errors(points)
    assert (found.error_m_rad < 1e-8).all()
    np.testing.assert_allclose(found.distance_m, ball.radius_m)


def test_the_two_tests_above_look_at_something() -> None:
    counts = [len(random_setting(seed).errors().point) for seed in range(20)]
    assert np.mean(counts) > 10


@given(seeds)
@settings(max_examples=60)
def test_zero_where_the_virtual_camera_is_the_source(seed: int) -> None:
    setting = random_setting(seed)
    sources: list[tuple[Lens, np.ndarray]] = [(setting.lens, inverse(setting.ego_from_cam))]
    found = Setting(sources, setting.lens, setting.ego_from_cam, setting.ball, setting.points).errors()
    in_view = setting.lens.project(transform(inverse(setting.ego_from_cam), setting.points))[1]
    assert len(found.point) == np.count_nonzero(in_view) > 0
    assert (found.error_m_rad < 1e-9).all()
    np.testing.assert_allclose(found.share, 1)


@pytest.mark.parametrize("lens", STRONG.values(), ids=STRONG)
def test_zero_where_a_distorted_source_shares_the_centre(lens: Lens) -> None:
    """Whatever the lens does, its rays are those of the virtual camera."""
    ego_from_cam = pose(turned(20, -3, 1), [1.5, 0.2, 1.6])
    source = pose(turned(28, 2, -2), [1.5, 0.2, 1.6])
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 90, 400)
    points = transform(source, np.stack([depth * rng.uniform(-1, 1, 400), rng.uniform(-4, 1, 400), depth], axis=-1))
    ball = HalfBall(ego_from_cam[:3, 3], 40.0, GroundPlane())
    found = Setting([(lens, inverse(source))], WIDE, ego_from_cam, ball, points).errors()
    assert len(found.point) > 50
    assert (found.error_m_rad < 1e-9).all()


# --- how it changes ---------------------------------------------------------------------------------------------


@given(seeds, units(3))
@settings(max_examples=60)
def test_it_does_not_shrink_as_the_baseline_grows(seed: int, way: np.ndarray) -> None:
    """The source moves away from the virtual camera along a line, and keeps seeing the points."""
    setting = random_setting(seed)
    sees_all = Pinhole.from_hfov(170.0, 3000, 3000)
    before = np.zeros(len(setting.points))
    compared = 0
    for baseline_m in (0.0, 0.1, 0.25, 0.5, 0.8, 1.2, 1.9):
        ego_from_cam = setting.ego_from_cam.copy()
        ego_from_cam[:3, 3] += baseline_m * way
        if not setting.ball.contains(ego_from_cam[:3, 3]):
            break
        one: list[tuple[Lens, np.ndarray]] = [(sees_all, inverse(ego_from_cam))]
        found = Setting(one, setting.lens, setting.ego_from_cam, setting.ball, setting.points).errors()
        after = np.full(len(setting.points), np.nan)
        after[found.point] = found.error_m_rad
        both = np.isfinite(before) & np.isfinite(after)
        assert (after[both] >= before[both] - 1e-9).all()
        before, compared = after, compared + int(both.sum())
    assert compared


@given(seeds)
@settings(max_examples=60)
def test_a_mirrored_scene_has_the_same_errors(seed: int) -> None:
    """Left and right change places, in the ego frame and in every picture."""
    setting = random_setting(seed)
    of_ego, of_cam = np.diag([1.0, -1.0, 1.0, 1.0]), np.diag([-1.0, 1.0, 1.0, 1.0])

    def lens(one: Lens) -> Pinhole:
        centre_px = one.width_px - 1 - one.cx_px
        return Pinhole(one.fx_px, one.fy_px, centre_px, one.cy_px, one.width_px, one.height_px)

    ball = setting.ball
    ground = GroundPlane(ball.ground.offset_m, of_ego[:3, :3] @ ball.ground.normal)
    mirrored = Setting(
        [(lens(one), of_cam @ cam_from_ego @ of_ego) for one, cam_from_ego in setting.sources],
        lens(setting.lens),
        of_ego @ setting.ego_from_cam @ of_cam,
        HalfBall(of_ego[:3, :3] @ ball.centre_ego, ball.radius_m, ground),
        setting.points @ of_ego[:3, :3],
    )
    here, there = setting.errors(), mirrored.errors()
    np.testing.assert_array_equal(here.point, there.point)
    np.testing.assert_allclose(here.error_m_rad, there.error_m_rad, atol=1e-9)
    np.testing.assert_allclose(here.share, there.share, rtol=1e-6)


@given(seeds, poses(bound_m=50.0))
@settings(max_examples=40)
def test_poses_of_the_size_of_utm_give_the_same(seed: int, global_from_ego: np.ndarray) -> None:
    """The boxes and two moments of the car in a frame whose origin is 5,000 km away."""
    setting = random_setting(seed)
    moved = driven(3, 0.4, 0.02)
    found = []
    for origin in (np.zeros(3), np.array([403_000.0, 4_987_000.0, 120.0])):
        at_reference = global_from_ego.copy()
        at_reference[:3, 3] += origin
        at_source = at_reference @ moved
        at_source[:3, 3] = global_from_ego[:3, :3] @ moved[:3, 3] + global_from_ego[:3, 3] + origin
        points = transform(global_from_ego, setting.points) + origin
        there = Setting(
            [(lens, cam @ relative(at_source, at_reference)) for lens, cam in setting.sources],
            setting.lens,
            setting.ego_from_cam,
            setting.ball,
            (points - at_reference[:3, 3]) @ at_reference[:3, :3],
        )
        found.append(there.errors())
    assume(np.array_equal(found[0].point, found[1].point))
    np.testing.assert_allclose(found[0].error_m_rad, found[1].error_m_rad, atol=1e-6)


# --- by other ways ----------------------------------------------------------------------------------------------


def scalar_project(lens: Pinhole, point_cam: np.ndarray) -> tuple[float, float] | None:
    x, y, z = (float(value) for value in point_cam)
    if z <= 0:
        return None
    u, v = lens.fx_px * x / z + lens.cx_px, lens.fy_px * y / z + lens.cy_px
    inside = -0.5 - 1e-6 <= u <= lens.width_px - 0.5 + 1e-6 and -0.5 - 1e-6 <= v <= lens.height_px - 0.5 + 1e-6
    return (u, v) if inside else None


def scalar_border(lens: Pinhole, point_cam: np.ndarray) -> float:
    """Sine of the angle from the ray to the nearest of the planes through the centre and a side of the picture."""
    x, y, z = point_cam / math.sqrt(sum(value * value for value in point_cam))
    sides = []
    for along, focal, centre, size in (
        (x, lens.fx_px, lens.cx_px, lens.width_px),
        (y, lens.fy_px, lens.cy_px, lens.height_px),
    ):
        for sign, reach in ((1, centre + 0.5), (-1, size - 0.5 - centre)):
            sides.append((sign * along + z * reach / focal) * math.cos(math.atan(reach / focal)))
    return min(sides)


def scalar_surface(ball: HalfBall, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    fall = float(np.dot(direction, ball.ground.normal))
    height = float(np.dot(origin, ball.ground.normal)) - ball.ground.offset_m
    t_ground = -height / fall if fall < 0 else math.inf
    offset = origin - ball.centre_ego
    b, c = 2 * float(np.dot(offset, direction)), float(np.dot(offset, offset)) - ball.radius_m**2
    return origin + min(t_ground, (-b + math.sqrt(b * b - 4 * c)) / 2) * direction


def scalar_weight(source: tuple[Lens, np.ndarray], place: np.ndarray, virtual_centre: np.ndarray) -> float:
    """Weight of a source at a scene point; 0 where it does not see it."""
    lens, cam_from_ego = source
    assert isinstance(lens, Pinhole)
    in_cam = cam_from_ego[:3, :3] @ place + cam_from_ego[:3, 3]
    if scalar_project(lens, in_cam) is None:
        return 0.0
    to_virtual = virtual_centre - place
    to_source = -cam_from_ego[:3, :3].T @ cam_from_ego[:3, 3] - place
    angle = math.atan2(float(np.linalg.norm(np.cross(to_virtual, to_source))), float(to_virtual @ to_source))
    border = max(scalar_border(lens, in_cam), BORDER_FLOOR)
    return border**4 / (2 * math.sin(angle / 2) + PARALLAX_FLOOR) ** 2


def scalar_errors(setting: Setting) -> tuple[dict[tuple[int, int], tuple[float, float, float]], set[int], int]:
    """(point, source): error, share, distance; the points that both sides see; the pairs that end up behind."""
    lens, centre = setting.lens, setting.ego_from_cam[:3, 3]
    to_cam = setting.ego_from_cam[:3, :3].T
    found, seen, behind = {}, set(), 0
    for index, point in enumerate(setting.points):
        straight = to_cam @ (point - centre)
        pixel = scalar_project(lens, straight)
        if pixel is None:
            continue
        for number, (source_lens, cam_from_ego) in enumerate(setting.sources):
            assert isinstance(source_lens, Pinhole)
            if scalar_project(source_lens, cam_from_ego[:3, :3] @ point + cam_from_ego[:3, 3]) is None:
                continue
            seen.add(index)
            origin = -cam_from_ego[:3, :3].T @ cam_from_ego[:3, 3]
            place = scalar_surface(setting.ball, origin, (point - origin) / math.dist(point, origin))
            warped = to_cam @ (place - centre)
            if warped[2] <= 0:
                behind += 1
                continue
            u, v = lens.fx_px * warped[0] / warped[2] + lens.cx_px, lens.fy_px * warped[1] / warped[2] + lens.cy_px
            theta, phi = math.atan((v - lens.cy_px) / lens.fy_px), math.atan((u - lens.cx_px) / lens.fx_px)
            true_theta = math.atan((pixel[1] - lens.cy_px) / lens.fy_px)
            true_phi = math.atan((pixel[0] - lens.cx_px) / lens.fx_px)
            distance = math.dist(straight, (0, 0, 0))
            weights = [scalar_weight(source, place, centre) for source in setting.sources]
            error = distance * (abs(theta - true_theta) + abs(phi - true_phi))
            found[index, number] = error, weights[number] / sum(weights), distance
    return found, seen, behind


@given(seeds)
@settings(max_examples=80)
def test_it_is_what_the_formulas_say(seed: int) -> None:
    setting = random_setting(seed)
    expected, seen, behind = scalar_errors(setting)
    found = setting.errors()
    assert set(found.seen.tolist()) == seen
    assert found.behind == behind
    keys = list(zip(found.point.tolist(), found.source.tolist(), strict=True))
    assert keys == sorted(expected, key=lambda key: key[::-1])
    for values, column in zip((found.error_m_rad, found.share, found.distance_m), range(3), strict=True):
        np.testing.assert_allclose(values, [expected[key][column] for key in keys], atol=1e-9, rtol=1e-9)
    points, blended = found.blended()
    for point, error in zip(points.tolist(), blended.tolist(), strict=True):
        own = [value for key, value in expected.items() if key[0] == point]
        mean = sum(error * share for error, share, _ in own) / sum(share for _, share, _ in own)
        assert error == pytest.approx(mean, abs=1e-9)
    assert set(points.tolist()) == {point for point, _ in expected}


@given(seeds)
@settings(max_examples=30)
def test_points_of_several_moments_are_those_of_each(seed: int) -> None:
    """With a pose for every point, errors are those of one call per moment."""
    setting = random_setting(seed)
    rng = np.random.default_rng(seed)
    moments = np.sort(rng.integers(0, 3, len(setting.points)))
    moved = [
        pose(turned(rng.normal(0, 2))[:, [2, 0, 1]] * [1, -1, -1], [*rng.normal(0, 0.3, 2), 0]) for _ in range(3)
    ]
    sources = [(lens, np.array([cam @ motion for motion in moved])[moments]) for lens, cam in setting.sources]
    sightings = [sight(setting.points, lens, cams) for lens, cams in sources]
    at_once = point_errors(setting.points, sightings, setting.lens, setting.ego_from_cam, setting.ball)
    for moment, motion in enumerate(moved):
        of_moment = np.flatnonzero(moments == moment)
        then: list[tuple[Lens, np.ndarray]] = [(lens, cam @ motion) for lens, cam in setting.sources]
        points = setting.points[of_moment]
        alone = Setting(then, setting.lens, setting.ego_from_cam, setting.ball, points).errors()
        mine = np.isin(at_once.point, of_moment)
        np.testing.assert_array_equal(at_once.point[mine], of_moment[alone.point])
        np.testing.assert_array_equal(at_once.source[mine], alone.source)
        np.testing.assert_allclose(at_once.error_m_rad[mine], alone.error_m_rad, atol=1e-10)
        np.testing.assert_allclose(at_once.share[mine], alone.share, atol=1e-10)


def inverted(table: np.ndarray, pixel: np.ndarray, start: np.ndarray) -> np.ndarray | None:
    """Where (row, column) a table (h, w, 2) of pixels holds a pixel, between its entries; None where it bends,
    as along the seam of ground and ball, or ends."""
    at = start
    for _ in range(30):
        row, column = (int(value) for value in np.clip(np.floor(at), 1, np.array(table.shape[:2]) - 3))
        round_it = table[row - 1 : row + 3, column - 1 : column + 3].astype(np.float64)
        if max(np.abs(np.diff(round_it, 2, axis=axis)).max() for axis in (0, 1)) > 0.02:
            return None
        cell = round_it[1:3, 1:3]
        down, right = at - (row, column)
        value = cell[0, 0] * (1 - down) * (1 - right) + cell[0, 1] * (1 - down) * right
        value += cell[1, 0] * down * (1 - right) + cell[1, 1] * down * right
        by_row = (cell[1, 0] - cell[0, 0]) * (1 - right) + (cell[1, 1] - cell[0, 1]) * right
        by_column = (cell[0, 1] - cell[0, 0]) * (1 - down) + (cell[1, 1] - cell[1, 0]) * down
        step = np.linalg.solve(np.stack([by_row, by_column], axis=-1), pixel - value)
        at = at + step
        if np.abs(step).max() < 1e-6:
            within = ((at > (row - 0.01, column - 0.01)) & (at < (row + 1.01, column + 1.01))).all()
            return at if within else None
    return None


@pytest.mark.parametrize("name", ["pinhole", "real", "fisheye of 177 degrees"])
def test_it_is_what_the_remap_tables_show(name: str) -> None:
    """The pixel of the virtual picture that shows a corner's source pixel, from the tables that make the picture."""
    lens: Lens = {**STRONG, "pinhole": Pinhole.from_hfov(75.0, 1600, 900)}[name]
    camera = Camera("CAM", Pinhole.from_hfov(70.0, 800, 450), pose(turned(12, -2, 1), [1.5, 0.3, 1.7]))
    view = VirtualView(camera, 30.0, GroundPlane(0.1))
    source = pose(turned(2, 1, -1), [1.9, -0.2, 1.4])
    (patch,) = build_patches(view, [Source(lens, inverse(source))], "angular")
    rng = np.random.default_rng(1)
    depth = rng.uniform(5, 80, 300)
    points = np.stack([depth * rng.uniform(-0.7, 0.7, 300), rng.uniform(-6, 1.5, 300), depth], axis=-1)
    points = transform(camera.ego_from_cam, points)
    setting = Setting([(lens, inverse(source))], camera.pinhole, camera.ego_from_cam, view.half_ball, points)
    found = setting.errors()
    compared = 0
    for index, error, distance in zip(found.point, found.error_m_rad, found.distance_m, strict=True):
        true = camera.pinhole.project(transform(inverse(camera.ego_from_cam), points[index]))[0]
        pixel = lens.project(transform(inverse(source), points[index]))[0]
        corner = np.array([patch.box[0].start, patch.box[1].start])
        place = inverted(patch.pixels, pixel, true[::-1] - corner)
        if place is None:
            continue
        shown = (place + corner)[::-1]
        centre, focal = np.array([camera.pinhole.cx_px, camera.pinhole.cy_px]), camera.pinhole.fx_px
        angles = np.abs(np.arctan((shown - centre) / focal) - np.arctan((true - centre) / focal)).sum()
        assert abs(error / distance - angles) * focal < 0.02
        compared += 1
    assert compared > 60


# --- its edges --------------------------------------------------------------------------------------------------


def test_a_point_that_ends_up_behind_is_counted_apart() -> None:
    """A source that faces the virtual camera sees a point between them against what is behind the virtual one."""
    ball = HalfBall(np.array([0.0, 0.0, 1.5]), 30.0, GroundPlane())
    ahead, facing = pose(turned(0), [0, 0, 1.5]), pose(turned(180), [2.0, 0, 1.5])
    points = np.array([[0.5, 0.1, 1.5], [1.0, 0.0, 0.0]])
    lens = Pinhole.from_hfov(120.0, 800, 800)
    found = Setting([(lens, inverse(facing))], lens, ahead, ball, points).errors()
    assert found.behind == 1
    assert found.seen.tolist() == [0, 1]
    assert found.point.tolist() == [1]
    assert found.blended()[0].tolist() == [1]


def test_nothing_seen_is_nothing() -> None:
    found = random_setting(0).errors(np.empty((0, 3)))
    assert [len(found.seen), len(found.point), found.behind, len(found.blended()[0])] == [0, 0, 0, 0]


@pytest.mark.parametrize("place", [[1.5, 0.0, -0.3], [40.0, 0.0, 1.5]], ids=["below the ground", "too far"])
@pytest.mark.parametrize("several", [False, True])
def test_a_source_outside_of_the_half_ball_is_refused(place: list[float], several: bool) -> None:
    ball = HalfBall(np.array([0.0, 0.0, 1.5]), 30.0, GroundPlane())
    points = np.array([[60.0, 0.0, 1.0]])
    cam_from_ego = inverse(pose(turned(0), place))
    sightings = [sight(points, WIDE, np.array([cam_from_ego]) if several else cam_from_ego)]
    with pytest.raises(GeometryError, match=r"source 0 stands outside .* \(radius 30 m\)"):
        point_errors(points, sightings, WIDE, pose(turned(0), [0, 0, 1.5]), ball)
