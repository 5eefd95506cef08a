"""OpenCV's fisheye (Kannala-Brandt): a polynomial in the angle off the axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses.distorted import DistortedLens
from unidrive_cli.geometry.lenses.increasing import first_positive_root, inverse_of_increasing

_WIDEST_RAD = math.radians(179)
_NODES = 512


@dataclass(frozen=True)
class FisheyeLens(DistortedLens):
    """A fisheye after `cv2.fisheye`: k1 k2 k3 k4.

    A ray theta off the axis falls theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
    from the principal point, in focal lengths. Rays beside and behind the camera are seen where theta_d
    still increases there, up to 179 degrees off the axis.
    """

    model = "fisheye"
    counts = (4,)
    names = "k1 k2 k3 k4"

    @cached_property
    def limit_rad(self) -> float:
        k1, k2, k3, k4 = self.coefficients
        fold = first_positive_root([1, 3 * k1, 5 * k2, 7 * k3, 9 * k4])
        return min(math.sqrt(fold), _WIDEST_RAD)

    @cached_property
    def _nodes(self) -> Float:
        return np.linspace(0, self.limit_rad, _NODES)

    def radius_at(self, angle_rad: float) -> float:
        return float(self._profile(np.array([angle_rad]))[0][0])

    def _profile(self, theta: Float) -> tuple[Float, Float]:
        """theta_d (n,) and its derivative (n,)."""
        k1, k2, k3, k4 = self.coefficients
        t: Float = np.square(theta)
        value = theta * (1 + t * (k1 + t * (k2 + t * (k3 + t * k4))))
        slope = 1.0 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * (9 * k4))))
        return value, slope

    def _distort(self, points_cam: Float) -> tuple[Float, Bool]:
        x, y, z = np.moveaxis(points_cam, -1, 0)
        off_axis = np.hypot(x, y)
        theta = np.arctan2(off_axis, z)
        in_model = (theta < self.limit_rad) & ((off_axis > 0) | (z > 0))
        stretch = self._profile(np.where(in_model, theta, 0.0))[0] / np.where(off_axis > 0, off_axis, 1.0)
        return np.stack([x * stretch, y * stretch], axis=-1), in_model

    def _undistort(self, plane: Float) -> Float:
        radius = np.hypot(plane[:, 0], plane[:, 1])
        theta = inverse_of_increasing(self._profile, self._nodes, radius)
        stretch = np.sin(theta) / np.where(radius > 0, radius, 1.0)
        rays: Float = np.stack([plane[:, 0] * stretch, plane[:, 1] * stretch, np.cos(theta)], axis=-1)
        rays[~(theta < self.limit_rad)] = np.nan
        return rays
