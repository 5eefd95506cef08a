"""When sensors fire, and where the lidar sits: as on nuScenes' car."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.rig.model import Camera
from unidrive_cli.synth.options import SynthOptions

KEYFRAME_US = 500_000
CAMERA_SWEEPS, LIDAR_SWEEPS = 6, 10
"""Pictures (12 Hz) and clouds (20 Hz) from one key frame to the next, the key frame's own included."""
_TURN_US = 50_000
_TURN_ENDS_DEG = 104.4
"""Yaw at which the lidar's turn begins and ends; a fit to nuScenes' six cameras, to 0.1 ms."""


def ego_from_lidar() -> Float:
    """(4, 4) pose of LIDAR_TOP, rounded from nuScenes: on the roof, its x axis to the right and y ahead."""
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    pose[:3, 3] = [0.94, 0.0, 1.84]
    return pose


def fires_us(camera: Camera, options: SynthOptions) -> int:
    """When a camera fires, relative to its sample's timestamp: 0 or before.

    The lidar turns clockwise 20 times a second and ends its turn at the sample's time; a camera fires as
    the lidar's beam passes its optical axis.
    """
    if options.firing == "together":
        return 0
    yaw_deg = camera.yaw_pitch_roll_deg[0]
    return -round(((yaw_deg - _TURN_ENDS_DEG) % 360) / 360 * _TURN_US)


def moments_us(
    keyframe_us: int, sample: int, per_keyframe: int, options: SynthOptions
) -> Iterator[tuple[int, bool]]:
    """Times of a sensor that belong to a sample, in order, and whether each is the key frame's.

    Args:
        keyframe_us: when the sensor has the sample's key frame.
        sample: number of the sample in its scene; the first has no sweeps before it.
        per_keyframe: how often it fires from one key frame to the next.
    """
    sweeps = per_keyframe - 1 if options.sweeps and sample else 0
    for back in range(sweeps, 0, -1):
        yield keyframe_us - round(back * KEYFRAME_US / per_keyframe), False
    yield keyframe_us, True
