"""One scene of the drive: its town, its traffic, its light, and where everything is at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from unidrive_cli.errors import RigError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.poses import EGO_FROM_LEVEL_CAM, rotation_from_yaw_pitch_roll
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.stage import Day, Stage
from unidrive_cli.synth.streets import make_street_plan
from unidrive_cli.synth.terrain import Terrain
from unidrive_cli.synth.textures import make_textures
from unidrive_cli.synth.town import Town, make_town
from unidrive_cli.synth.traffic import (
    EGO_LENGTH_M,
    EGO_WIDTH_M,
    NEIGHBOURHOOD_M,
    Traffic,
    ego_track,
    make_traffic,
    pose_over_ground,
)

_REAR_OVERHANG_M = 0.75
_BONNET_M, _ROOF_M = 0.95, 1.45
"""Heights of the ego car's body where it has a bonnet, and where it has a cabin."""
_CABIN_M = (-0.45, 2.1)
"""Ego x from the cabin's back to the middle of its windscreen."""
SHOWN_WITHIN_M = 130.0
"""Actors farther than this from the ego car are left out of pictures and clouds."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that is in one scene, in one frame of metres (x east, y north, z up) that is the global frame.

    Attributes:
        index: number of the scene, from 0.
        options: of the whole drive.
        terrain, town, traffic, day: what it is made of.
        start_us: timestamp of the first key frame.
    """

    index: int
    options: SynthOptions
    terrain: Terrain
    town: Town
    traffic: Traffic
    day: Day
    tilt_phase: tuple[float, float]
    texture_seed: int
    start_us: int

    @cached_property
    def stage(self) -> Stage:
        """What renderers draw."""
        return Stage(
            self.town.ground,
            self.town.structures,
            tuple(actor.model.mesh for actor in self.traffic.actors),
            make_textures(self.texture_seed),
            self.day,
        )

    def seconds(self, timestamp_us: int) -> float:
        """Seconds since the first key frame."""
        return (timestamp_us - self.start_us) / 1e6

    def global_from_ego(self, timestamp_us: int) -> Float:
        """(4, 4) pose of the ego car: the origin on the road under its rear axle.

        With `ego_tilt_deg` its body pitches and rolls over the road, about its origin.
        """
        seconds = self.seconds(timestamp_us)
        pose = pose_over_ground(self.traffic.ego, self.terrain, seconds, 0.0)
        if self.options.ego_tilt_deg:
            pitch = self.options.ego_tilt_deg * np.sin(2 * np.pi * 0.41 * seconds + self.tilt_phase[0])
            roll = self.options.ego_tilt_deg * np.sin(2 * np.pi * 0.27 * seconds + self.tilt_phase[1])
            pose[:3, :3] @= rotation_from_yaw_pitch_roll(0.0, pitch, roll) @ EGO_FROM_LEVEL_CAM.T
        return pose

    def global_from_actors(self, timestamp_us: int) -> Float:
        """(n, 4, 4) poses of all actors' boxes."""
        poses = self._global_from_resting.copy()
        for index in self._moving:
            poses[index] = self._global_from_actor(index, self.seconds(timestamp_us))
        return poses

    @cached_property
    def _moving(self) -> tuple[int, ...]:
        """Numbers of the actors that do not stand for the whole scene."""
        return tuple(i for i, actor in enumerate(self.traffic.actors) if np.ptp(actor.track.along_m) > 0)

    @cached_property
    def _global_from_resting(self) -> Float:
        """(n, 4, 4) poses of all actors' boxes at the start: right at any time for those that never move."""
        return np.array([self._global_from_actor(i, 0.0) for i in range(len(self.traffic.actors))]).reshape(-1, 4, 4)

    def _global_from_actor(self, index: int, seconds: float) -> Float:
        actor = self.traffic.actors[index]
        return pose_over_ground(actor.track, self.terrain, seconds, actor.model.size_wlh_m[2] / 2)

    def check_camera(self, where: str, global_from_cam: Float) -> None:
        """Refuses a camera that could see nothing sensible.

        Args:
            where: how a sentence names the camera and the moment.

        Raises:
            RigError: it is below the ground, or inside a building.
        """
        x, y, z = global_from_cam[:3, 3]
        height_m = z - float(self.terrain.height_m(np.array([x, y])))
        if height_m <= 0:
            raise RigError(
                f"is {-height_m:.2f} m below the ground; it must stand above it.",
                where=where,
                hint="Raise the camera, or lower --slope or --ego-tilt.",
            )
        for building in self.town.buildings:
            if height_m < building.height_m and building.footprint.contains(shapely.Point(x, y)):
                raise RigError("is inside a building.", where=where, hint="Move the camera nearer to the car.")


def inside_ego_car(centre_ego: Float) -> bool:
    """Whether a point (3,) of the ego frame is inside the ego car's body."""
    x, y, z = centre_ego
    beside = abs(y) > EGO_WIDTH_M / 2 or not -_REAR_OVERHANG_M < x < EGO_LENGTH_M - _REAR_OVERHANG_M
    low = z < _BONNET_M or (z < _ROOF_M and _CABIN_M[0] < x < _CABIN_M[1])
    return not beside and low


def make_scene(options: SynthOptions, index: int) -> Scene:
    """The scene of that number; it depends on the seed, its number and the drive's options alone."""
    world, people, light = (
        np.random.default_rng(np.random.SeedSequence([options.seed, index, part])) for part in range(3)
    )
    terrain = Terrain(options.slope_percent / 100)
    seconds = (options.keyframes - 1) / 2
    blocks = 4 if seconds < 60 else 6
    plan = make_street_plan(world, blocks)
    ego = ego_track(people, plan, seconds)
    way = shapely.LineString(ego.line.at(np.arange(ego.along_m[0], ego.along_m[-1] + 5, 4.0)))
    town = make_town(world, plan, terrain, way.buffer(NEIGHBOURHOOD_M + 15))
    traffic = make_traffic(people, town, ego)
    day = make_day(light)
    phases = (float(light.uniform(0, 6)), float(light.uniform(0, 6)))
    start_us = _FIRST_SCENE_US + index * _SCENE_EVERY_US
    return Scene(index, options, terrain, town, traffic, day, phases, int(light.integers(2**31)), start_us)


_FIRST_SCENE_US = 1_767_268_800_000_000
"""2026-01-01 12:00:00 UTC."""
_SCENE_EVERY_US = 3_600_000_000


def make_day(rng: np.random.Generator) -> Day:
    """A random hour and weather: clear, hazy or overcast; the sun stands 22 to 62 degrees high."""
    weather = str(rng.choice(["clear", "clear", "fair", "fair", "overcast"]))
    azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(22, 62))
    to_sun = (
        float(np.cos(azimuth) * np.cos(height)),
        float(np.sin(azimuth) * np.cos(height)),
        float(np.sin(height)),
    )
    warmth = float(np.clip((np.deg2rad(50) - height) / np.deg2rad(40), 0, 1))
    if weather == "overcast":
        sun, zenith, horizon = (0.16, 0.155, 0.15), (0.50, 0.53, 0.58), (0.66, 0.68, 0.70)
        cloud, haze = 1.0, rng.uniform(350, 700)
    else:
        bright = 1.0 if weather == "clear" else 0.85
        sun = (1.05 * bright, (0.98 - 0.16 * warmth) * bright, (0.88 - 0.36 * warmth) * bright)
        zenith = (0.13, 0.24, 0.50)
        horizon = (0.55 + 0.1 * warmth, 0.64, 0.76 - 0.1 * warmth)
        cloud, haze = (0.25, rng.uniform(900, 1800)) if weather == "clear" else (0.65, rng.uniform(500, 1000))
    return Day(to_sun, sun, zenith, horizon, cloud, float(haze))
