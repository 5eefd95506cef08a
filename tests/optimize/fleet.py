"""Cars and spaces that the tests of `optimize` share."""

from __future__ import annotations

import numpy as np

from unidrive_cli.geometry import boxes
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.optimize.objective import Car
from unidrive_cli.optimize.space import Parameter, SearchSpace
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig

PAIR = """\
name: pair
cameras:
  CAM_FRONT: {{width: 320, height: 180, hfov: {hfov}, position: [{x}, 0, {z}], yaw: 0}}
  CAM_BACK: {{width: 320, height: 180, hfov: {hfov}, position: [{x}, 0, {z}], yaw: 180}}
"""


def pair(x: float = 1.0, z: float = 1.5, hfov: float = 90) -> Rig:
    """A camera to the front and one to the back at the same place."""
    return parse_rig(PAIR.format(x=x, z=z, hfov=hfov), "pair.yaml")


def boxes_around(count: int, seed: int = 0) -> Float:
    """(count, 8, 3) corners of cars, buses and people on the ground, all round, 4 to 60 m away."""
    random = np.random.default_rng(seed)
    distance, azimuth, yaw = random.uniform(4, 60, count), *random.uniform(-np.pi, np.pi, (2, count))
    sizes = np.array([[1.9, 4.5, 1.6], [2.6, 11.0, 3.2], [0.7, 0.7, 1.8]])[random.integers(0, 3, count)]
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, :2] = np.stack([np.cos(yaw), -np.sin(yaw)], axis=1)
    poses[:, 1, :2] = np.stack([np.sin(yaw), np.cos(yaw)], axis=1)
    poses[:, :3, 3] = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), sizes[:, 2] / 2], axis=1)
    return boxes.corners(poses, sizes)


def gallery_cars(*names: str, count: int = 200) -> list[Car]:
    """Shipped rigs that see the same boxes."""
    return [Car(load_gallery_rig(name), boxes_around(count)) for name in names]


def place_space(start: Rig, *, step: float = 0.1) -> SearchSpace:
    """x of both cameras from 0 to 2, and their height from 1 to 2."""
    return SearchSpace(
        start,
        50.0,
        (
            Parameter("x", start.channels, 0.0, 2.0, step),
            Parameter("z", start.channels, 1.0, 2.0, step),
        ),
        {},
    )
