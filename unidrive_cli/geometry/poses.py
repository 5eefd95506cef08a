"""Rigid poses (SE3) as 4x4 matrices, and the rotations they are given by."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Float, finite_array, lengths

EGO_FROM_LEVEL_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""(3, 3) camera axes, in the ego frame, of a level camera that looks along ego +x."""

_ORTHONORMAL_TOLERANCE = 1e-6


def pose(rotation: Any, translation_m: Any) -> Float:
    """The 4x4 pose of a rotation matrix (3, 3) and a translation (3,) in metres.

    Raises:
        GeometryError: wrong shapes, non-finite numbers, or a matrix that is not a rotation.
    """
    rotation = finite_array(rotation, (3, 3), "rotation matrix")
    check_rotation(rotation)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = finite_array(translation_m, (3,), "translation")
    return matrix


def check_rotation(rotation: Float) -> None:
    """Raises GeometryError unless `rotation` (3, 3) is orthonormal and right-handed to 1e-6."""
    residual = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if residual > _ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) < 0:
        raise GeometryError(
            f"rotation matrix must be orthonormal and right-handed (off by {residual:.2g}, "
            f"determinant {np.linalg.det(rotation):.3f})."
        )


def check_pose(matrix: Any, name: str) -> Float:
    """`matrix` as a 4x4 rigid pose.

    Raises:
        GeometryError: not 4x4, not finite, last row not 0 0 0 1, or not a rotation.
    """
    checked = finite_array(matrix, (4, 4), name)
    if not np.array_equal(checked[3], [0.0, 0.0, 0.0, 1.0]):
        raise GeometryError(f"{name} must end with the row 0 0 0 1, got {checked[3].tolist()}.")
    check_rotation(checked[:3, :3])
    return checked


def inverse(a_from_b: Float) -> Float:
    """`b_from_a`, the inverse of a rigid pose (4, 4)."""
    rotation_transposed = a_from_b[:3, :3].T
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = rotation_transposed
    b_from_a[:3, 3] = -rotation_transposed @ a_from_b[:3, 3]
    return b_from_a


def relative(global_from_a: Float, global_from_b: Float) -> Float:
    """`a_from_b` of two poses (4, 4) in one global frame.

    The translations are subtracted before anything is rotated, so UTM-sized coordinates
    (1e6 m) keep their nanometres.
    """
    rotation_transposed = global_from_a[:3, :3].T
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation_transposed @ global_from_b[:3, :3]
    a_from_b[:3, 3] = rotation_transposed @ (global_from_b[:3, 3] - global_from_a[:3, 3])
    return a_from_b


def transform(a_from_b: Float, points_b: Float) -> Float:
    """Points (..., 3) of frame b in frame a, metres; the pose is (4, 4), or (..., 4, 4) with one for each point."""
    if a_from_b.ndim > 2:
        moved: Float = np.einsum("...ij,...j->...i", a_from_b[..., :3, :3], points_b)
        moved += a_from_b[..., :3, 3]
        return moved
    points_a: Float = points_b @ a_from_b[:3, :3].T + a_from_b[:3, 3]
    return points_a


def turn_rad(rotation: Float) -> float:
    """Angle of a rotation matrix (3, 3) about its axis, 0 to pi, accurate for small angles too."""
    half_sine = np.linalg.norm(rotation - np.eye(3)) / math.sqrt(8)
    return 2 * math.asin(min(float(half_sine), 1.0))


def rotation_from_quaternion(quaternion: Any, *, unit_tolerance: float | None = None) -> Float:
    """Rotation matrix (3, 3) of a quaternion (4,) in the order w, x, y, z (nuScenes schema).

    The quaternion is normalised first; `unit_tolerance` refuses norms farther than that from one.

    Raises:
        GeometryError: not four finite numbers, zero norm, or outside the tolerance.
    """
    quaternion = finite_array(quaternion, (4,), "rotation quaternion (w, x, y, z)")
    norm = float(np.linalg.norm(quaternion))
    if not np.isfinite(norm):
        raise GeometryError(f"rotation quaternion {quaternion.tolist()} is far from norm 1.")
    if norm < 1e-6:
        raise GeometryError("rotation quaternion has zero norm; four numbers w, x, y, z of norm 1 were expected.")
    if unit_tolerance is not None and abs(norm - 1.0) > unit_tolerance:
        raise GeometryError(f"rotation quaternion must have norm 1, got {norm:.6g}.")
    w, x, y, z = quaternion / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotations_from_quaternions(quaternions: Float) -> Float:
    """Rotation matrices (n, 3, 3) of finite quaternions (n, 4), w, x, y, z, of norms above zero."""
    w, x, y, z = (quaternions / lengths(quaternions)[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def quaternion_from_rotation(rotation: Float) -> Float:
    """Unit quaternion (4,) w, x, y, z with w >= 0 of a rotation matrix (3, 3).

    The largest of the four components is computed first, so no division is by a small number.
    """
    r = rotation
    squares = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    cross = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], squares[2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[3]],
        ]
    )
    row = cross[int(np.argmax(squares))]
    quaternion: Float = row / np.linalg.norm(row)
    return -quaternion if quaternion[0] < 0 else quaternion


def rotation_from_yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Float:
    """`ego_from_cam` rotation (3, 3) of a rig file's angles in degrees: Rz(yaw) Ry(-pitch) Rx(roll) R0.

    Positive yaw turns left, positive pitch looks up. The product is written out in plain floats, so
    that every processor gives the same bits.
    """
    (cy, sy), (cp, sp), (cr, sr) = (
        (math.cos(math.radians(angle)), math.sin(math.radians(angle))) for angle in (yaw_deg, pitch_deg, roll_deg)
    )
    forward = (cy * cp, sy * cp, sp)
    left = (-sy * cr - cy * sp * sr, cy * cr - sy * sp * sr, cp * sr)
    up = (sy * sr - cy * sp * cr, -cy * sr - sy * sp * cr, cp * cr)
    return np.array([[-le, -u, f] for le, u, f in zip(left, up, forward, strict=True)])


def yaw_pitch_roll_from_rotation(rotation: Float) -> tuple[float, float, float]:
    """Yaw, pitch, roll in degrees of an `ego_from_cam` rotation (3, 3); roll is 0 at pitch +-90."""
    body = rotation @ EGO_FROM_LEVEL_CAM.T
    pitch = np.arctan2(body[2, 0], np.hypot(body[2, 1], body[2, 2]))
    if np.hypot(body[2, 1], body[2, 2]) < 1e-9:
        yaw, roll = np.arctan2(-body[0, 1], body[1, 1]), 0.0
    else:
        yaw, roll = np.arctan2(body[1, 0], body[0, 0]), np.arctan2(body[2, 1], body[2, 2])
    return float(np.rad2deg(yaw)), float(np.rad2deg(pitch)), float(np.rad2deg(roll))
