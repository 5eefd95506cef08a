"""A nuScenes-format dataset whose pictures are painted in closed form, for the tests and for `make demo`.

Independent of unidrive_cli on purpose: what it paints is the truth that the converter is measured against.
Frames as in nuScenes: global and ego x forward, y left, z up; camera x right, y down, z forward. Metres,
microseconds, pixel centres at integer coordinates; `a_from_b` takes points in b to a. The world: the plane
z = 0 with a ring road (traffic keeps left), a sky that depends on the direction alone, solid boxes.

    python -m tests.painted DIR [--scenes N] [--samples N] [--scale S]
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pyquaternion import Quaternion

Floats = NDArray[np.floating[Any]]
Row = dict[str, Any]

SCENE_NAMES = tuple(f"scene-{n:04d}" for n in (61, 103, 553, 655, 757, 796, 916, 1077, 1094, 1100))
LOGFILE = "n000-2026-01-01-12-00-00+0000"
FIRST_SAMPLE_US = 1_767_268_800_047_951  # 2026-01-01 12:00:00 UTC and a bit
SAMPLE_US = 500_000  # keyframes at 2 Hz
ANNOTATED_WITHIN_M = 50.0
FIELDS = {  # of the 13 tables, in nuScenes' order
    "attribute": "token name description",
    "calibrated_sensor": "token sensor_token translation rotation camera_intrinsic",
    "category": "token name description",
    "ego_pose": "token timestamp rotation translation",
    "instance": "token category_token nbr_annotations first_annotation_token last_annotation_token",
    "log": "token logfile vehicle date_captured location",
    "map": "category token filename log_tokens",
    "sample": "token timestamp prev next scene_token",
    "sample_annotation": "token sample_token instance_token visibility_token attribute_tokens translation "
    "size rotation prev next num_lidar_pts num_radar_pts",
    "sample_data": "token sample_token ego_pose_token calibrated_sensor_token timestamp fileformat "
    "is_key_frame height width filename prev next",
    "scene": "token log_token nbr_samples first_sample_token last_sample_token name description",
    "sensor": "token channel modality",
    "visibility": "description token level",
}
CAR, TRUCK, BUS = "vehicle.car", "vehicle.truck", "vehicle.bus.rigid"
PERSON, CONE = "human.pedestrian.adult", "movable_object.trafficcone"
PARKED, MOVING, STOPPED = "vehicle.parked", "vehicle.moving", "vehicle.stopped"
WALKING, STANDING = "pedestrian.moving", "pedestrian.standing"

# fmt: off
# The ground, colours in BGR. "Left" is metres to the left of the middle of the ego car's lane.
ROAD_CURVATURE = np.radians(3.0) / 9.0  # 1/m, to the left: what the default speed and yaw rate drive
GRASS, PATH, PARKING, ASPHALT = np.array(
    [(72, 128, 104), (142, 164, 178), (112, 100, 100), (98, 94, 92)], np.float32)
EDGES = ((-10.0, PATH - GRASS), (-7.5, PARKING - PATH), (-5.25, ASPHALT - PARKING),  # left, change of colour
         (1.75, PARKING - ASPHALT), (4.0, PATH - PARKING), (6.5, GRASS - PATH))
WAVES = np.array([  # wavelength m, direction degrees, phase, amplitude of blue, green, red
    (2.1, 20, 0.3, 5, 6, 8), (2.4, 110, 1.9, 8, 5, 5), (2.9, 65, 4.0, 7, 9, 3), (3.7, 155, 2.2, 3, 8, 10),
    (5.3, 40, 5.1, 12, 3, 6), (7.9, 130, 0.9, 4, 10, 8), (11, 85, 3.3, 9, 4, 14), (15, 175, 1.2, 12, 9, 6),
], np.float32)
# What moves, and what stands alone: category, attribute, metres ahead of the ego car at mid-scene, left,
# degrees turned, speed m/s (None: the ego car's), size w l h, colour (None: one of PAINTS, by scene).
TRAFFIC: tuple[tuple[Any, ...], ...] = (
    (CAR, MOVING, 15, 0.0, 0, None, (1.9, 4.5, 1.6), None),
    (CAR, MOVING, -13, 0.1, 0, None, (1.85, 4.2, 1.55), None),
    (CAR, MOVING, -6, -3.6, 180, 8.0, (1.9, 4.6, 1.5), None),
    (TRUCK, MOVING, 27, -3.5, 180, 7.0, (2.5, 7.5, 3.2), (150, 120, 62)),
    (BUS, MOVING, -34, -3.5, 180, 6.0, (2.9, 11.0, 3.4), (60, 160, 214)),
    (PERSON, WALKING, 10, 5.0, 180, 1.3, (0.65, 0.6, 1.75), (60, 60, 190)),
    (PERSON, WALKING, 13, -8.6, 0, 1.4, (0.6, 0.55, 1.7), (190, 130, 50)),
    (PERSON, STANDING, 1.5, 5.6, 0, 0.0, (0.65, 0.6, 1.8), (60, 170, 190)),
    (PERSON, WALKING, -9, 4.9, 0, 1.2, (0.65, 0.6, 1.75), (160, 70, 130)),
    (PERSON, STANDING, -16, -8.4, 0, 0.0, (0.7, 0.6, 1.85), (90, 160, 60)),
    *((CONE, "", 6 + 2.5 * i, 2.1 + 0.4 * i, 0, 0.0, (0.4, 0.4, 0.75), (30, 90, 236)) for i in range(4)),
)
PAINTS = ((178, 96, 36), (40, 172, 226), (214, 214, 208), (52, 44, 188), (70, 150, 60), (90, 84, 84))
# fmt: on


def _step(x: Floats) -> Floats:
    """A soft step: nearly the normal distribution function (x in standard deviations)."""
    return 0.5 + 0.5 * np.tanh(0.8 * x)


def _within(x: Floats, half_width: float, sigma: Any) -> Floats:
    """1 for |x| below half_width, else 0, blurred with a standard deviation sigma."""
    return _step((x + half_width) / sigma) - _step((x - half_width) / sigma)


def ground_colour(xy_m: Floats, step_u_m: Any = 0.0, step_v_m: Any = 0.0) -> Floats:
    """BGR (..., 3), not rounded, of the points xy (..., 2) of the global plane z = 0.

    step_u_m, step_v_m (..., 2): how far the point moves from one pixel to the next to the right and down. The
    colour is the mean over that parallelogram, to first order (sines fade, edges soften), as a pixel has it:
    without it the far ground would be moire; near the camera it changes nothing.
    """
    p, x, y = xy_m.astype(np.float32), xy_m[..., 0], xy_m[..., 1]
    east, north = ROAD_CURVATURE * x, 1.0 - ROAD_CURVATURE * y  # the ring's centre is at (0, 1 / curvature)
    ring = np.hypot(east, north)
    left = ((1.0 - ring) / ROAD_CURVATURE).astype(np.float32)
    along = (np.arctan2(east, north) / ROAD_CURVATURE).astype(np.float32)
    cos, sin = (north / ring).astype(np.float32), (east / ring).astype(np.float32)  # of the road's heading
    su, sv = (np.broadcast_to(np.asarray(s, np.float32), p.shape) for s in (step_u_m, step_v_m))

    def variance(kx: Any, ky: Any) -> Floats:
        """Of kx x + ky y over the pixel."""
        return ((kx * su[..., 0] + ky * su[..., 1]) ** 2 + (kx * sv[..., 0] + ky * sv[..., 1]) ** 2) / 12

    def stripes(value: Floats, spread: Floats, period: float) -> Floats:
        """Soft stripes, 0 to 1, that cover half; 0.5 where a pixel is larger than they are."""
        wave = np.tanh(4 * np.cos(value * (2 * np.pi / period)))
        return 0.5 + 0.5 * wave * np.exp(-0.5 * spread * (2 * np.pi / period) ** 2)

    lengthwise, crosswise = variance(cos, sin), variance(-sin, cos)
    colour = np.broadcast_to(GRASS, (*p.shape[:-1], 3)).copy()
    for edge, change in EDGES:
        colour += _step((left - edge) / np.sqrt(0.12**2 + crosswise))[..., None] * change
    for length, degrees, phase, *bgr in WAVES:
        kx, ky = (2 * np.pi / length * f(np.radians(degrees)) for f in (np.cos, np.sin))
        wave = np.sin(kx * p[..., 0] + ky * p[..., 1] + phase) * np.exp(-0.5 * variance(kx, ky))
        colour += wave[..., None] * np.asarray(bgr)
    sigma = np.sqrt(0.05**2 + crosswise)
    lines = _within(left + 5.25, 0.1, sigma) + _within(left - 1.75, 0.1, sigma)
    lines += _within(left + 1.75, 0.1, sigma) * stripes(along, lengthwise, 6.0)
    crossing = _within((along + 10.0) % 45.0 - 22.5, 1.6, np.sqrt(0.05**2 + lengthwise))
    lines += crossing * _within(left + 1.75, 3.0, sigma) * stripes(left, crosswise, 1.0)
    return colour + np.clip(0.8 * lines, 0, 0.85)[..., None] * (235 - colour)


def sky_colour(directions: Floats) -> Floats:
    """BGR (..., 3), not rounded, along global directions (..., 3): a gradient, clouds and far hills."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float32), -1, 0)
    height, azimuth = np.degrees(np.arctan2(z, np.hypot(x, y))), np.arctan2(y, x)
    up = np.clip(height / 60, 0, 1)[..., None] ** 0.6
    colour = np.array([236, 226, 212], np.float32) - up * np.array([30, 76, 120], np.float32)
    for n, at, width, phase in ((3, 9, 3, 0.4), (4, 15, 4, 2.0), (7, 12, 3, 4.1), (5, 22, 6, 3.0)):
        wave = np.exp(2.5 * (np.cos(n * azimuth + phase + 0.9 * np.sin(2 * azimuth)) - 1))
        cloud = 0.7 * wave * np.exp(-(((height - at) / width) ** 2))
        colour += cloud[..., None] * (250 - colour)
    for middle, swing, n, phase, *hill in (4, 1.6, 3, 0.2, 176, 158, 140), (2.2, 1.2, 5, 1.3, 138, 140, 112):
        crest = middle + swing * (np.sin(n * azimuth + phase) + 0.4 * np.sin((2 * n + 1) * azimuth))
        colour += _step((crest - height) / 0.6)[..., None] * (np.array(hill, np.float32) - colour)
    return colour


def _pose(translation: Sequence[float], yaw_rad: float, then: Any = None) -> Floats:
    """Pose (4, 4): a turn about z, with the rotation `then` (3, 3) on its right, and the translation (m)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ (np.eye(3) if then is None else then)
    pose[:3, 3] = translation
    return pose


@dataclass(frozen=True)
class PaintedBox:
    """A solid box on the ground, in the global frame; x of its own frame points to its front."""

    name: str
    category: str
    attribute: str  # "" for none
    centre_m: tuple[float, float, float]
    yaw_rad: float
    size_wlh_m: tuple[float, float, float]
    colour_bgr: tuple[int, int, int]
    velocity_mps: tuple[float, float] = (0.0, 0.0)

    def at(self, seconds: float) -> PaintedBox:
        """The box `seconds` later."""
        (x, y, z), (vx, vy) = self.centre_m, self.velocity_mps
        return replace(self, centre_m=(x + vx * seconds, y + vy * seconds, z))

    @property
    def global_from_box(self) -> Floats:
        """Pose (4, 4)."""
        return _pose(self.centre_m, self.yaw_rad)

    @property
    def half_lwh_m(self) -> Floats:
        """Half the extent along x, y and z of the box's own frame."""
        return np.array(self.size_wlh_m)[[1, 0, 2]] / 2

    def local(self, points: Floats) -> Floats:
        """Global points (..., 3) in the box's own frame."""
        return (points - np.array(self.centre_m)) @ self.global_from_box[:3, :3]

    def corners(self, margin_m: float = 0.0) -> Floats:
        """(8, 3) global corners of the box, grown by a margin on all sides."""
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, 8).T
        return signs * (self.half_lwh_m + margin_m) @ self.global_from_box[:3, :3].T + np.array(self.centre_m)

    def enter(self, origin: Floats, directions: Floats) -> tuple[Floats, NDArray[np.int8]]:
        """Where global rays from origin (3,) along directions (..., 3) go in: t (inf: they miss, or start
        inside) and the axis of the box (0, 1, 2) that the face is across."""
        o, d = self.local(origin), directions @ self.global_from_box[:3, :3]
        first, last = np.full(d.shape[:-1], -np.inf), np.full(d.shape[:-1], np.inf)
        axis = np.zeros(d.shape[:-1], np.int8)
        for i, half in enumerate(self.half_lwh_m):
            inverse = 1.0 / np.where(d[..., i] == 0, 1e-12, d[..., i])
            middle, reach = -o[i] * inverse, half * np.abs(inverse)
            axis[middle - reach > first] = i
            first, last = np.maximum(first, middle - reach), np.minimum(last, middle + reach)
        return np.where((first > 0) & (first <= last), first, np.inf), axis

    def colour(self, points: Floats, axis: NDArray[np.int8]) -> Floats:
        """BGR (N, 3) of global surface points (N, 3) on faces across the given axes (N,)."""
        (hx, hy, hz), local = self.half_lwh_m, self.local(points).astype(np.float32)
        x, y, z = local.T
        colour = np.tile(np.asarray(self.colour_bgr, np.float32), (len(x), 1))

        def cover(mask: Floats, *bgr: float) -> None:
            colour[:] += mask[:, None] * (np.asarray(bgr, np.float32) - colour)

        if self.category == PERSON:
            cover(_step((-0.1 * hz - z) / 0.03), 84, 60, 50)
            cover(_step((z - 0.72 * hz) / 0.03), 128, 160, 204)
        elif self.category == CONE:
            cover(_within(z - 0.2 * hz, 0.25 * hz, 0.02), 240, 240, 240)
        else:
            end, side, closed = axis == 0, axis == 1, self.category == TRUCK
            glass = end * _within(y, hy - 0.15, 0.03) * ~(closed & (x < 0))
            glass = glass + side * _within(x, hx - 0.35, 0.03) * (not closed)
            cover(glass * _within(z - 0.5 * hz, 0.32 * hz, 0.03), 96, 74, 58)
            cover(side * _step((0.34 - np.hypot(np.abs(x) - 0.62 * hx, z + hz - 0.3)) / 0.03), 38, 36, 36)
            lamp = end * _within(np.abs(y) - hy + 0.3, 0.18, 0.03) * _within(z + 0.25 * hz, 0.1, 0.03)
            cover(lamp * (x > 0), 190, 240, 250)
            cover(lamp * (x < 0), 40, 30, 210)
        sun = np.array([0.35, 0.55, 0.75]) @ self.global_from_box[:3, :3]
        light = 0.72 + 0.3 * sun[axis] * np.sign(local[np.arange(len(x)), axis])
        return colour * light[:, None]


def paint(
    intrinsic: Floats,
    width_px: int,
    height_px: int,
    global_from_cam: Floats,
    boxes: Sequence[PaintedBox] = (),
    *,
    supersample: int = 2,
) -> NDArray[np.uint8]:
    """Picture (height, width, 3), uint8 BGR, of a pinhole camera above the ground: each pixel is the mean of
    supersample x supersample rays. A box that the camera is inside of is not drawn."""
    intrinsic, turn = np.asarray(intrinsic, np.float64), np.asarray(global_from_cam, np.float64)[:3, :3]
    origin, n = np.asarray(global_from_cam, np.float64)[:3, 3], supersample
    if origin[2] <= 0:
        raise ValueError(f"the camera is {-origin[2]:.2f} m below the ground")
    ray = turn @ np.linalg.inv(intrinsic)  # of a pixel (u, v, 1), with depth 1: t below is the depth
    u, v = ((np.arange(size * n) + 0.5) / n - 0.5 for size in (width_px, height_px))
    near, placed = 0.05, []
    for box in boxes:  # the subpixels that it and its shadow can cover: what is in front, projected
        seen = (box.corners(0.8) - origin) @ turn
        front, behind = seen[seen[:, 2] > near], seen[seen[:, 2] <= near]
        share = (front[:, None, 2:] - near) / (front[:, None, 2:] - behind[:, 2:])
        cut = front[:, None] + share * (behind - front[:, None])
        pixels = np.concatenate([front, cut.reshape(-1, 3)]) @ intrinsic.T
        if len(pixels):
            pixels /= pixels[:, 2:]
            (left, high), (right, low) = pixels[:, :2].min(0), pixels[:, :2].max(0)
            placed.append((box, np.searchsorted(v, (high, low)), np.searchsorted(u, (left, right))))
    picture = np.empty((height_px, width_px, 3), np.uint8)
    for top in range(0, height_px * n, 32 * n):
        rows = v[top : top + 32 * n]
        rays = u[:, None] * ray[:, 0] + (rows[:, None] * ray[:, 1] + ray[:, 2])[:, None]
        ground = rays[..., 2] < -1e-9
        depth = np.where(ground, -origin[2] / np.where(ground, rays[..., 2], 1.0), np.inf)
        colour = np.empty(rays.shape, np.float32)
        colour[~ground] = sky_colour(rays[~ground])
        down, t = rays[ground], depth[ground][:, None]
        steps = (t / n * (k[:2] - down[:, :2] * (k[2] / down[:, 2:])) for k in ray.T[:2])
        colour[ground] = ground_colour(origin[:2] + t * down[:, :2], *steps)
        parts = [(b, (slice(*np.clip(vs - top, 0, len(rows))), slice(*us))) for b, vs, us in placed]
        for box, part in parts:  # the soft shadow on the ground round it
            below = ground[part]
            foot = box.local(origin + depth[part][below][:, None] * rays[part][below])
            apart = np.maximum(np.abs(foot[:, :2]) - box.half_lwh_m[:2] + 0.1, 0)
            colour[part][below] *= 1 - 0.6 * np.exp(-(apart**2).sum(-1, keepdims=True) / 0.3**2)
        for box, part in parts:
            enters, axis = box.enter(origin, rays[part])
            hit = enters < depth[part]
            depth[part][hit] = enters[hit]
            colour[part][hit] = box.colour(origin + enters[hit][:, None] * rays[part][hit], axis[hit])
        mean = cv2.resize(colour, (width_px, len(rows) // n), interpolation=cv2.INTER_AREA)
        picture[top // n : top // n + 32] = np.clip(np.rint(mean), 0, 255)
    return picture


def _drive(start: Floats, distance: float, turn: float) -> Floats:
    """Pose (4, 4) after an arc of a length (m) that turns by `turn` radians, from the pose `start`."""
    chord = distance * np.sinc(turn / (2 * np.pi))
    return start @ _pose((chord * np.cos(turn / 2), chord * np.sin(turn / 2), 0.0), turn)


@dataclass(frozen=True)
class PaintedScene:
    """Where everything is in one scene: timestamps in microseconds, poses and boxes in the global frame."""

    index: int = 0
    samples: int = 2
    speed_mps: float = 9.0
    yaw_rate_deg_s: float = 3.0
    with_boxes: bool = True

    @property
    def start_us(self) -> int:
        """Timestamp of the first sample."""
        return FIRST_SAMPLE_US + self.index * (self.samples * SAMPLE_US + 60_000_000)

    def global_from_ego(self, timestamp_us: int) -> Floats:
        """Ego pose (4, 4) on an arc that begins along the lane; the default speed and yaw rate stay in it."""
        seconds = (timestamp_us - self.start_us) / 1e6
        turn = np.radians(self.yaw_rate_deg_s) * seconds
        return _drive(self._on_road(60.0 + 105.0 * self.index), self.speed_mps * seconds, turn)

    def boxes(self, timestamp_us: int) -> tuple[PaintedBox, ...]:
        """Every box at a time. The moving ones go straight, and are in their lanes at mid-scene."""
        half_s = (self.samples - 1) * SAMPLE_US / 2e6
        travel = self.speed_mps * half_s
        middle = 60.0 + 105.0 * self.index + travel  # of the ego car's way, in metres along the road
        things = list(TRAFFIC)
        for i in range(int(middle - travel - 40) // 8, int(middle + travel + 55) // 8):  # along both kerbs
            jitter, ahead, paint = (i * 0.618034) % 1.0, 8 * i - middle, PAINTS[(5 * i + self.index) % 6]
            size = (1.75 + 0.2 * jitter, 4.0 + 0.9 * jitter, 1.45 + 0.35 * ((i * 0.3819) % 1.0))
            if i % 5 != 1 and not 1 < ahead < 20:  # the cones need room
                things.append((CAR, PARKED, ahead + jitter, 2.95, 2 - 4 * jitter, 0.0, size, paint))
            if i % 4 != 2:
                things.append((CAR, PARKED, ahead + 3 - jitter, -6.45, 180, 0.0, size, PAINTS[(i + 2) % 6]))
        boxes = []
        for i, (category, attribute, ahead, left, turned, speed, size, bgr) in enumerate(things):
            speed = self.speed_mps if speed is None else speed
            attribute = STOPPED if attribute == MOVING and speed == 0 else attribute
            pose = self._on_road(middle + ahead) @ _pose((0.0, left, size[2] / 2), np.radians(turned))
            place, yaw = tuple(pose[:3, 3].tolist()), float(np.arctan2(pose[1, 0], pose[0, 0]))
            velocity = (speed * np.cos(yaw), speed * np.sin(yaw))
            bgr = PAINTS[(i + self.index) % 6] if bgr is None else bgr
            box = PaintedBox(f"box-{i}", category, attribute, place, yaw, size, bgr, velocity)
            boxes.append(box.at((timestamp_us - self.start_us) / 1e6 - half_s))
        return tuple(boxes) if self.with_boxes else ()

    def _on_road(self, along_m: float) -> Floats:
        """Pose (4, 4) in the middle of the ego car's lane, heading along it."""
        return _drive(np.eye(4), along_m, ROAD_CURVATURE * along_m)


@dataclass(frozen=True, eq=False)
class PaintedCamera:
    """A pinhole camera of the rig; it fires `fires_us` after the sample's timestamp (negative: before)."""

    channel: str
    width_px: int
    height_px: int
    intrinsic: Floats  # (3, 3), pixels
    ego_from_cam: Floats  # (4, 4), metres
    fires_us: int = 0


def nuscenes_like_cameras(scale: float = 0.5) -> tuple[PaintedCamera, ...]:
    """The six cameras of the rounded nuScenes rig, 1600x900 times `scale`; firing times as in nuScenes."""
    level = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # ego_from_cam of a camera that looks ahead
    cx, cy = (1600 * scale - 1) / 2, (900 * scale - 1) / 2  # the full size's (c + 0.5) * scale - 0.5
    cameras = []
    for channel, focal, yaw_deg, place, fires_us in (
        ("CAM_FRONT", 1266.0, 0.0, (1.70, 0.02, 1.51), -35_500),
        ("CAM_FRONT_RIGHT", 1261.0, -56.0, (1.55, -0.49, 1.50), -27_600),
        ("CAM_BACK_RIGHT", 1260.0, -111.0, (1.01, -0.48, 1.56), -20_000),
        ("CAM_BACK", 809.0, 180.0, (0.03, 0.0, 1.58), -10_400),
        ("CAM_BACK_LEFT", 1257.0, 109.0, (1.04, 0.48, 1.59), -500),
        ("CAM_FRONT_LEFT", 1272.0, 55.0, (1.52, 0.49, 1.51), -43_100),
    ):
        intrinsic = np.array([[focal * scale, 0, cx], [0, focal * scale, cy], [0, 0, 1]])
        pose, size = _pose(place, np.radians(yaw_deg), level), (round(1600 * scale), round(900 * scale))
        cameras.append(PaintedCamera(channel, *size, intrinsic, pose, fires_us))
    return tuple(cameras)


EGO_FROM_LIDAR = _pose((0.94, 0.0, 1.84), -np.pi / 2)  # the lidar's x to the right, y ahead, as in nuScenes


def lidar_cloud(global_from_lidar: Floats, boxes: Sequence[PaintedBox]) -> NDArray[np.float32]:
    """(N, 5) x, y, z (lidar frame, metres), intensity, ring: what 16 beams x 720 directions hit within 80 m.
    A point on a box lies 2 cm behind its surface: inside it, whatever the rounding."""
    ring = np.arange(16)
    beams = np.radians(2.0 - 28.0 * (1 - ring / 15) ** 1.7)  # -26 to 2 degrees, dense near the horizon
    azimuth, beam = np.meshgrid(np.radians(np.arange(0, 360, 0.5)), beams, indexing="ij")
    rays = np.stack([np.sin(azimuth) * np.cos(beam), np.cos(azimuth) * np.cos(beam), np.sin(beam)], -1)
    origin, turned = global_from_lidar[:3, 3], rays @ global_from_lidar[:3, :3].T
    reach = np.where(turned[..., 2] < 0, -origin[2] / np.minimum(turned[..., 2], -1e-9), 1e9)
    intensity = np.full(reach.shape, 12.0)
    for i, box in enumerate(boxes):
        t, _ = box.enter(origin, turned)
        intensity[t < reach] = 40 + 7 * (i % 20)
        reach = np.where(t < reach, t + 0.02, reach)
    cloud = np.concatenate([rays * reach[..., None], np.stack(np.broadcast_arrays(intensity, ring), -1)], -1)
    return cloud[reach < 80].astype(np.float32)


def _token(*names: object) -> str:
    """The same 32 hexadecimal digits for the same names."""
    return hashlib.sha256("/".join(map(str, names)).encode()).hexdigest()[:32]


def _quaternion(pose: Floats) -> list[float]:
    """w, x, y, z of the rotation of a pose (4, 4)."""
    return list(Quaternion(matrix=pose[:3, :3]).elements.tolist())


class _Tables(dict[str, list[Row]]):
    """The 13 tables, from the start with the rows that no scene adds to."""

    def __init__(self, cameras: Sequence[PaintedCamera]) -> None:
        super().__init__({table: [] for table in FIELDS})
        for name in (MOVING, STOPPED, PARKED, WALKING, STANDING):
            self.add("attribute", _token("attribute", name), name, "")
        for name in (CAR, TRUCK, BUS, PERSON, CONE):
            self.add("category", _token("category", name), name, "")
        for i, (low, high) in enumerate(((0, 40), (40, 60), (60, 80), (80, 100)), 1):
            text = f"visibility of whole object is between {low} and {high}%"
            self.add("visibility", text, str(i), f"v{low}-{high}")
        self.add("log", _token("log"), LOGFILE, "n000", "2026-01-01", "singapore-onenorth")
        self.add("map", "semantic_prior", _token("map"), f"maps/{_token('map')}.png", [_token("log")])
        sensors = [(c.channel, "camera", c.ego_from_cam, np.asarray(c.intrinsic).tolist()) for c in cameras]
        for channel, modality, pose, matrix in [*sensors, ("LIDAR_TOP", "lidar", EGO_FROM_LIDAR, [])]:
            sensor, token = _token("sensor", channel), _token("calibrated_sensor", channel)
            self.add("sensor", sensor, channel, modality)
            self.add("calibrated_sensor", token, sensor, pose[:3, 3].tolist(), _quaternion(pose), matrix)

    def add(self, table: str, *values: Any) -> Row:
        """Appends a row, values in the order of FIELDS."""
        self[table].append(dict(zip(FIELDS[table].split(), values, strict=True)))
        return self[table][-1]


def _link(rows: Sequence[Row]) -> None:
    """Fills prev and next of rows in the order of time."""
    for before, after in pairwise(rows):
        before["next"], after["prev"] = after["token"], before["token"]


def write_painted(
    root: Path,
    *,
    version: str = "v1.0-mini",
    scenes: int = 1,
    samples_per_scene: int = 2,
    cameras: Sequence[PaintedCamera] | None = None,
    speed_mps: float = 9.0,
    yaw_rate_deg_s: float = 3.0,
    with_boxes: bool = True,
    supersample: int = 2,
    picture_suffix: str = ".jpg",
    lidar_sweeps: int = 1,
    camera_sweeps: int = 0,
) -> None:
    """Writes the dataset: 13 tables, pictures, lidar keyframes, `lidar_sweeps` and `camera_sweeps` sweeps of each
    sensor in each gap between them, a map mask. The same arguments give the same bytes. Every sensor
    has its own ego pose at its own time; annotations (boxes within 50 m of the ego car) are at the sample's time,
    which is the lidar's."""
    if not 1 <= scenes <= len(SCENE_NAMES) or samples_per_scene < 1 or picture_suffix not in (".jpg", ".png"):
        raise ValueError(f"1 to {len(SCENE_NAMES)} scenes, 1 sample or more each, .jpg or .png pictures")
    cameras = nuscenes_like_cameras() if cameras is None else cameras
    tables = _Tables(cameras)
    pictures: list[tuple[Path, PaintedCamera, Floats, tuple[PaintedBox, ...]]] = []

    def record(channel: str, time_us: int, sample: Row, camera: PaintedCamera | None = None) -> Row:
        """A sample_data row with its ego pose; writes the cloud, or puts the picture down to be painted."""
        token, pose = _token("sample_data", scene.index, channel, time_us), scene.global_from_ego(time_us)
        tables.add("ego_pose", token, time_us, _quaternion(pose), pose[:3, 3].tolist())
        key = time_us == sample["timestamp"] + (camera.fires_us if camera else 0)
        suffix, form = (picture_suffix, picture_suffix[1:]) if camera else (".pcd.bin", "pcd")
        name = f"{'samples' if key else 'sweeps'}/{channel}/{LOGFILE}__{channel}__{time_us}{suffix}"
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        if camera:
            pictures.append((root / name, camera, pose @ camera.ego_from_cam, scene.boxes(time_us)))
        else:
            lidar_cloud(pose @ EGO_FROM_LIDAR, scene.boxes(time_us)).tofile(root / name)
        height_width = (camera.height_px, camera.width_px) if camera else (0, 0)
        links = sample["token"], token, _token("calibrated_sensor", channel)
        return tables.add("sample_data", token, *links, time_us, form, key, *height_width, name, "", "")

    for index in range(scenes):
        scene = PaintedScene(index, samples_per_scene, speed_mps, yaw_rate_deg_s, with_boxes)
        token = _token("scene", index)
        times = [scene.start_us + i * SAMPLE_US for i in range(samples_per_scene)]
        samples = [tables.add("sample", _token("sample", index, t), t, "", "", token) for t in times]
        first_last, text = (samples[0]["token"], samples[-1]["token"]), "Painted: ring road, parked cars, bus"
        tables.add("scene", token, _token("log"), len(samples), *first_last, SCENE_NAMES[index], text)
        _link(samples)
        for camera in cameras:
            shots = []
            for i, sample in enumerate(samples):
                for k in range(camera_sweeps if i else 0, -1, -1):
                    time_us = times[i] + camera.fires_us - k * SAMPLE_US // (camera_sweeps + 1)
                    shots.append(record(camera.channel, time_us, sample, camera))
            _link(shots)
        lidar = []
        for i, sample in enumerate(samples):  # a sweep belongs to the sample that follows it
            for k in range(lidar_sweeps if i else 0, -1, -1):
                lidar.append(record("LIDAR_TOP", times[i] - k * SAMPLE_US // (lidar_sweeps + 1), sample))
        _link(lidar)
        instances: dict[str, list[Row]] = {}
        for sample, row in zip(samples, (row for row in lidar if row["is_key_frame"]), strict=True):
            ego = scene.global_from_ego(sample["timestamp"])
            cloud = np.fromfile(root / row["filename"], np.float32).reshape(-1, 5)[:, :3].astype(np.float64)
            cloud = (cloud @ EGO_FROM_LIDAR[:3, :3].T + EGO_FROM_LIDAR[:3, 3]) @ ego[:3, :3].T + ego[:3, 3]
            for box in scene.boxes(sample["timestamp"]):
                if np.linalg.norm(np.array(box.centre_m) - ego[:3, 3]) > ANNOTATED_WITHIN_M:
                    continue
                instance = _token("instance", index, box.name)
                keys = _token("annotation", sample["token"], box.name), sample["token"], instance, "4"
                attributes = [_token("attribute", box.attribute)] if box.attribute else []
                shape = [*box.centre_m], [*box.size_wlh_m], _quaternion(box.global_from_box)
                points = int((np.abs(box.local(cloud)) <= box.half_lwh_m).all(1).sum())
                row = tables.add("sample_annotation", *keys, attributes, *shape, "", "", points, 0)
                instances.setdefault(instance, []).append(row)
                if len(instances[instance]) == 1:
                    tables.add("instance", instance, _token("category", box.category), 0, "", "")
        for entry in tables["instance"][-len(instances) :] if instances else ():
            rows = instances[entry["token"]]
            _link(rows)
            ends = {"first_annotation_token": rows[0]["token"], "last_annotation_token": rows[-1]["token"]}
            entry.update(nbr_annotations=len(rows), **ends)

    def draw(order: tuple[Path, PaintedCamera, Floats, tuple[PaintedBox, ...]]) -> None:
        path, camera, pose, boxes = order
        size = camera.width_px, camera.height_px
        picture = paint(camera.intrinsic, *size, pose, boxes, supersample=supersample)
        options = [cv2.IMWRITE_JPEG_QUALITY, 95] if picture_suffix == ".jpg" else []
        path.write_bytes(cv2.imencode(picture_suffix, picture, options)[1].tobytes())

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(draw, pictures))
    (root / "maps").mkdir(exist_ok=True)
    mask = np.repeat(np.array([[0, 255, 0]], np.uint8), (24, 16, 24), axis=1).repeat(64, axis=0)
    (root / tables["map"][0]["filename"]).write_bytes(cv2.imencode(".png", mask)[1].tobytes())
    (root / version).mkdir(exist_ok=True)
    for table, rows in tables.items():
        (root / version / f"{table}.json").write_text(json.dumps(rows, indent=0) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Paints a small nuScenes-format dataset into a new or empty folder."""
    parser = argparse.ArgumentParser("python -m tests.painted", description=main.__doc__)
    parser.add_argument("folder", metavar="DIR", type=Path, help="new or empty folder")
    parser.add_argument("--scenes", type=int, default=1, help=f"1 (default) to {len(SCENE_NAMES)}")
    parser.add_argument("--samples", type=int, default=2, help="keyframes per scene, at 2 Hz (default 2)")
    parser.add_argument("--scale", type=float, default=0.5, help="picture size over 1600x900 (default 0.5)")
    given = parser.parse_args(arguments)
    if given.folder.exists() and (not given.folder.is_dir() or any(given.folder.iterdir())):
        parser.error(f"{given.folder} exists and is not an empty folder; name a new one")
    if not 1 <= given.scenes <= len(SCENE_NAMES) or given.samples < 1 or not 0.02 <= given.scale <= 2:
        parser.error(f"--scenes must be 1 to {len(SCENE_NAMES)}, --samples 1 or more, --scale 0.02 to 2")
    cameras = nuscenes_like_cameras(given.scale)
    write_painted(given.folder, scenes=given.scenes, samples_per_scene=given.samples, cameras=cameras)
    print(f"{given.folder}: scenes {given.scenes}, samples in each {given.samples}, cameras {len(cameras)}")


if __name__ == "__main__":
    main()
