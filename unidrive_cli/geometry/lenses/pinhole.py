"""The pinhole: what a rectified picture, and every virtual one, was taken with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Bool, Float, finite_array, lengths
from unidrive_cli.geometry.lenses.base import Intrinsics


@dataclass(frozen=True)
class Pinhole(Intrinsics):
    """A rectified camera: fx, fy, cx, cy and the picture size, all in pixels."""

    @classmethod
    def from_hfov(cls, hfov_deg: float, width_px: int, height_px: int) -> Pinhole:
        """A centred camera with square pixels and the given horizontal field of view in degrees.

        Raises:
            GeometryError: a field of view outside (0, 180).
        """
        if not 0 < hfov_deg < 180:
            raise GeometryError(f"horizontal field of view must be inside (0, 180) degrees, got {hfov_deg:g}.")
        focal_px = width_px / (2 * math.tan(math.radians(hfov_deg) / 2))
        return cls(focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)

    @classmethod
    def from_matrix(cls, intrinsic: Any, width_px: int, height_px: int) -> Pinhole:
        """The lens of a nuScenes `camera_intrinsic` (3, 3).

        Raises:
            GeometryError: not 3x3 or not finite, with skew, or with a last row other than 0 0 1.
        """
        matrix = finite_array(intrinsic, (3, 3), "camera_intrinsic")
        off_diagonal = matrix[[0, 1, 2, 2], [1, 0, 0, 1]]
        if np.abs(off_diagonal).max() > 1e-9 or matrix[2, 2] != 1.0:
            raise GeometryError(
                f"camera_intrinsic must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {matrix.tolist()}."
            )
        fx, fy, cx, cy = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        return cls(fx, fy, cx, cy, width_px, height_px)

    @property
    def model(self) -> str:
        return "pinhole"

    @property
    def coefficients(self) -> tuple[float, ...]:
        return ()

    @property
    def hfov_deg(self) -> float:
        """Angle between the left and the right border, in degrees."""
        return _field_deg(self.fx_px, self.cx_px, self.width_px)

    @property
    def vfov_deg(self) -> float:
        """Angle between the upper and the lower border, in degrees."""
        return _field_deg(self.fy_px, self.cy_px, self.height_px)

    def project(self, points_cam: Float) -> tuple[Float, Bool]:
        x, y, z = np.moveaxis(points_cam, -1, 0)
        in_front = z > 0
        depth = np.where(in_front, z, 1.0)
        pixels = np.stack([self.fx_px * x / depth + self.cx_px, self.fy_px * y / depth + self.cy_px], axis=-1)
        return pixels, in_front & self.contains(pixels)

    def unproject(self, pixels: Float) -> Float:
        x = (pixels[..., 0] - self.cx_px) / self.fx_px
        y = (pixels[..., 1] - self.cy_px) / self.fy_px
        rays = np.stack([x, y, np.ones_like(x)], axis=-1)
        unit: Float = rays / lengths(rays)[..., None]
        return unit

    def border_sine(self, points_cam: Float) -> Float:
        nearest: Float = (points_cam @ self.border_normals().T).min(axis=-1)
        sine: Float = nearest / np.maximum(lengths(points_cam), np.finfo(np.float64).tiny)
        return sine

    def border_normals(self) -> Float:
        """(4, 3) unit normals, pointing inwards, of the left, right, top and bottom border planes."""
        left, right = self.cx_px + 0.5, self.width_px - 0.5 - self.cx_px
        top, bottom = self.cy_px + 0.5, self.height_px - 0.5 - self.cy_px
        normals = np.array(
            [[self.fx_px, 0, left], [-self.fx_px, 0, right], [0, self.fy_px, top], [0, -self.fy_px, bottom]]
        )
        unit: Float = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return unit


def _field_deg(focal_px: float, centre_px: float, side_px: int) -> float:
    before, after = (centre_px + 0.5) / focal_px, (side_px - 0.5 - centre_px) / focal_px
    return float(np.rad2deg(np.arctan(before) + np.arctan(after)))
