"""3D boxes as nuScenes annotates them: centre, size (width, length, height) and rotation."""

from __future__ import annotations

import numpy as np

from unidrive_cli.geometry.arrays import Float

_CORNER_SIGNS = np.array(
    [[x, y, z] for x in (1, -1) for y, z in ((1, 1), (-1, 1), (-1, -1), (1, -1))], dtype=np.float64
)
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
"""Pairs of corner indices of `corners` that a box's twelve edges join."""


def corners(global_from_box: Float, size_wlh_m: Float) -> Float:
    """(..., 8, 3) corners in the frame of the poses (..., 4, 4); the first four are the front, in nuscenes-devkit's
    order."""
    return grid(global_from_box, size_wlh_m, _CORNER_SIGNS)


def grid(global_from_box: Float, size_wlh_m: Float, unit_points: Float) -> Float:
    """Points (n, 3) of [-1, 1]^3 (x forward, y left, z up) placed in boxes.

    Args:
        global_from_box: (..., 4, 4) poses of the boxes' centres.
        size_wlh_m: (..., 3) width, length, height in metres (nuScenes order).
        unit_points: (n, 3).

    Returns:
        (..., n, 3) in the frame of the poses, metres.
    """
    half_xyz = size_wlh_m[..., [1, 0, 2]] / 2
    local = unit_points * half_xyz[..., None, :]
    placed: Float = np.matmul(local, np.swapaxes(global_from_box[..., :3, :3], -1, -2))
    placed += global_from_box[..., None, :3, 3]
    return placed


def volume_grid(steps: int) -> Float:
    """(steps^3, 3) regular points of [-1, 1]^3, borders included."""
    axis = np.linspace(-1.0, 1.0, steps)
    points: Float = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return points


def clipped_outline(corners_cam: Float, near_m: float) -> Float:
    """Points (n, 3) whose convex hull is the part of a box (8, 3) with z >= near_m; n = 0 if none is."""
    points = [corner for corner in corners_cam if corner[2] >= near_m]
    for start, end in EDGES:
        a, b = corners_cam[start], corners_cam[end]
        if (a[2] < near_m) != (b[2] < near_m):
            points.append(a + (b - a) * ((near_m - a[2]) / (b[2] - a[2])))
    outline: Float = np.array(points, dtype=np.float64).reshape(-1, 3)
    return outline
