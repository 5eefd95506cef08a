"""What a rig sees of the horizon, all the way round."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import Lens

STEP_DEG = 0.1


def azimuths_deg() -> Float:
    """(3600,) azimuths from -180, counter-clockwise (left of the car is +90), at the middle of each step."""
    return -180 + STEP_DEG * (np.arange(round(360 / STEP_DEG)) + 0.5)


def horizon_seen(cameras: Sequence[tuple[Lens, Float]]) -> Bool:
    """(n, 3600) where each camera sees the far horizon at each of `azimuths_deg`.

    Args:
        cameras: lens and `ego_from_cam` (4, 4); positions do not matter at infinity.
    """
    azimuth = np.deg2rad(azimuths_deg())
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    return np.stack([lens.project(directions @ ego_from_cam[:3, :3])[1] for lens, ego_from_cam in cameras])


def arcs_deg(where: Bool) -> list[tuple[float, float]]:
    """The arcs (start, end) in degrees, counter-clockwise, of a (3600,) circular mask; start in [-180, 180)."""
    if where.all():
        return [(-180.0, 180.0)]
    starts = np.flatnonzero(where & ~np.roll(where, 1))
    arcs = []
    for start in starts:
        length = int(np.argmin(np.roll(where, -start)))
        arcs.append((round(-180 + STEP_DEG * float(start), 1), round(-180 + STEP_DEG * float(start + length), 1)))
    return arcs
