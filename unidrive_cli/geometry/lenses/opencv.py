"""OpenCV's standard lens: radial (also rational), tangential and thin-prism distortion, and a tilted sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Bool, Float, lengths
from unidrive_cli.geometry.lenses.distorted import DistortedLens
from unidrive_cli.geometry.lenses.increasing import first_positive_root, inverse_of_increasing

_WIDEST_RAD = math.radians(89.9)
_LARGEST_TILT_RAD = 1.0
_NODES = 1024
_DIRECTIONS = 128
_NEWTON_STEPS = 40
_RESIDUAL = 1e-13
"""Newton stops here, in focal lengths; rays that end above a hundred times this are none."""


@dataclass(frozen=True)
class OpenCVLens(DistortedLens):
    """A lens after `cv2.projectPoints`: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]].

    With x = X/Z, y = Y/Z and s = x^2 + y^2 a point falls, in focal lengths from the principal point, on

        x g(s) + 2 p1 x y + p2 (s + 2 x^2) + s1 s + s2 s^2
        y g(s) + p1 (s + 2 y^2) + 2 p2 x y + s3 s + s4 s^2
        g(s) = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)

    A sensor that is tilted by tau_x and tau_y (radians) about its axes is a homography after that.
    `coefficients` always holds the first twelve of them, and the angles where there are any.
    """

    model = "opencv"
    counts = (4, 5, 8, 12, 14)
    names = "k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]]"

    def _checked(self, given: Sequence[float]) -> tuple[float, ...]:
        checked = super()._checked(given)
        if max(map(abs, checked[12:]), default=0.0) > _LARGEST_TILT_RAD:
            raise GeometryError(
                f"a sensor is tilted by at most {_LARGEST_TILT_RAD:g} radian (tau_x and tau_y), got {checked[12:]}."
            )
        return checked if any(checked[12:]) else (*checked[:12], *[0.0] * (12 - len(checked)))

    @cached_property
    def tilt(self) -> Float | None:
        """The homography (3, 3) from the sensor's place without tilt to the tilted sensor; None without tilt."""
        if not self.coefficients[12:]:
            return None
        (sin_x, sin_y), (cos_x, cos_y) = np.sin(self.coefficients[12:]), np.cos(self.coefficients[12:])
        about_x = np.array([[1, 0, 0], [0, cos_x, sin_x], [0, -sin_x, cos_x]])
        about_y = np.array([[cos_y, 0, -sin_y], [0, 1, 0], [sin_y, 0, cos_y]])
        turn = about_y @ about_x
        onto: Float = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]) @ turn
        return onto

    @cached_property
    def _is_radial(self) -> bool:
        return not any(self.coefficients[2:4] + self.coefficients[8:12])

    @cached_property
    def _radial(self) -> tuple[Float, Float]:
        """Numerator and denominator (4,) of g, ascending powers of s."""
        k1, k2, _, _, k3, k4, k5, k6 = self.coefficients[:8]
        return np.array([1, k1, k2, k3]), np.array([1, k4, k5, k6])

    @cached_property
    def _limit(self) -> float:
        """Tangent of `limit_rad`: the largest |(x, y)| that is in the model."""
        top, bottom = self._radial
        twice = 2.0 * np.arange(4)  # 2 s d/ds multiplies the power s^n by 2 n
        # the derivative of r g(r^2), times the denominator squared
        slope = np.convolve(top * (1 + twice), bottom) - np.convolve(top, bottom * twice)
        pole = first_positive_root(bottom) * (1 - 1e-9)
        fold = math.sqrt(min(first_positive_root(slope), pole))
        limit = min(fold, math.tan(_WIDEST_RAD))
        return limit if self._is_radial else self._one_to_one_until(limit)

    def _one_to_one_until(self, limit: float) -> float:
        """The largest |(x, y)| within which the Jacobian is positive in every direction."""
        azimuth = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
        directions = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)

        def folds(angle_rad: Float) -> Bool:
            jacobian = self._jacobian((np.tan(angle_rad)[:, None, None] * directions).reshape(-1, 2))
            determinant = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]
            least = determinant.reshape(-1, _DIRECTIONS).min(axis=1)
            where: Bool = least <= 0
            return where

        angles = np.linspace(0, math.atan(limit), _NODES // 2)
        first = int(np.argmax(folds(angles)))
        if first == 0:
            return limit
        low, high = angles[first - 1], angles[first]
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (low, middle) if folds(np.array([middle]))[0] else (middle, high)
        return 0.999 * math.tan(low)  # directions between the sampled ones fold a trifle earlier

    @cached_property
    def limit_rad(self) -> float:
        return math.atan(self._limit)

    @cached_property
    def _nodes(self) -> Float:
        nodes: Float = np.tan(np.linspace(0, self.limit_rad, _NODES))
        nodes[-1] = self._limit
        return nodes

    def radius_at(self, angle_rad: float) -> float:
        return float(self._profile(np.array([math.tan(angle_rad)]))[0][0])

    def _g(self, s: Float) -> tuple[Float, Float]:
        """g and dg/ds at s (...)."""
        (_, k1, k2, k3), (_, k4, k5, k6) = self._radial
        top = 1 + s * (k1 + s * (k2 + s * k3))
        d_top = k1 + s * (2 * k2 + s * (3 * k3))
        if not (k4 or k5 or k6):
            return top, d_top
        bottom = 1 + s * (k4 + s * (k5 + s * k6))
        d_bottom = k4 + s * (2 * k5 + s * (3 * k6))
        g = top / bottom
        return g, (d_top - g * d_bottom) / bottom

    def _profile(self, r: Float) -> tuple[Float, Float]:
        """r g(r^2) (n,) and its derivative (n,)."""
        s = r * r
        g, slope = self._g(s)
        return r * g, g + 2 * s * slope

    def _bend(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Where (...) the undistorted x, y fall, in focal lengths."""
        s = x * x + y * y
        g, _ = self._g(s)
        if self._is_radial:
            return x * g, y * g
        p1, p2 = self.coefficients[2:4]
        s1, s2, s3, s4 = self.coefficients[8:12]
        return (
            x * g + 2 * p1 * x * y + p2 * (s + 2 * x * x) + s * (s1 + s2 * s),
            y * g + p1 * (s + 2 * y * y) + 2 * p2 * x * y + s * (s3 + s4 * s),
        )

    def _jacobian(self, xy: Float) -> tuple[Float, Float, Float, Float]:
        """d u/dx, d u/dy, d v/dx, d v/dy (n,) of `_bend` at (n, 2)."""
        x, y = xy[:, 0], xy[:, 1]
        p1, p2 = self.coefficients[2:4]
        s1, s2, s3, s4 = self.coefficients[8:12]
        s: Float = np.square(x) + np.square(y)
        g, slope = self._g(s)
        shared = 2 * (x * y * slope + p1 * x + p2 * y)
        prism_u, prism_v = 2 * (s1 + 2 * s2 * s), 2 * (s3 + 2 * s4 * s)
        return (
            g + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + x * prism_u,
            shared + y * prism_u,
            shared + x * prism_v,
            g + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + y * prism_v,
        )

    def _distort(self, points_cam: Float) -> tuple[Float, Bool]:
        x, y, z = np.moveaxis(points_cam, -1, 0)
        depth = np.where(z > 0, z, 1.0)
        with np.errstate(over="ignore"):
            x, y = x / depth, y / depth
            in_model = (z > 0) & (x * x + y * y < self._limit**2)
        x, y = np.where(in_model, x, 0.0), np.where(in_model, y, 0.0)
        plane = np.stack(self._bend(x, y), axis=-1)
        if self.tilt is not None:
            plane, before = _mapped(self.tilt, plane)
            in_model &= before
        return plane, in_model

    def _undistort(self, plane: Float) -> Float:
        if self.tilt is None:
            return self._undistort_level(plane)
        level, before = _mapped(np.linalg.inv(self.tilt), plane)
        rays = self._undistort_level(level)
        rays[~before] = np.nan
        return rays

    def _undistort_level(self, plane: Float) -> Float:
        """As `_undistort`, of a sensor without tilt."""
        radius = np.hypot(plane[:, 0], plane[:, 1])
        r = inverse_of_increasing(self._profile, self._nodes, radius)
        xy = plane * (r / np.where(radius > 0, radius, 1.0))[:, None]
        if self._is_radial:
            xy[~(r < self._limit)] = np.nan
        else:
            xy = self._straightened(plane, xy)
        rays = np.concatenate([xy, np.ones_like(xy[:, :1])], axis=1)
        unit: Float = rays / lengths(rays)[:, None]
        return unit

    @cached_property
    def _farthest(self) -> float:
        """How far from the principal point, in focal lengths, the rim of the model's field falls at most."""
        azimuth = np.linspace(0, 2 * np.pi, 4096)
        rim = np.stack(self._bend(self._limit * np.cos(azimuth), self._limit * np.sin(azimuth)), axis=-1)
        return float(lengths(rim).max()) * (1 + 1e-5)

    def _straightened(self, plane: Float, start: Float) -> Float:
        """The x, y (n, 2) that fall on `plane` (n, 2): Newton's method from `start`, NaN where there is none.

        A step that does not bring a point nearer is halved; none leaves the model's field.
        """
        result = np.full_like(plane, np.nan)
        scale = 1 + lengths(plane)
        at = np.flatnonzero(scale <= 1 + self._farthest)
        xy, target = start[at], plane[at]
        residual = np.stack(self._bend(xy[:, 0], xy[:, 1]), axis=-1) - target
        share = np.ones(len(xy))
        for _ in range(_NEWTON_STEPS):
            a, b, c, d = self._jacobian(xy)
            determinant = a * d - b * c
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.stack(
                    [d * residual[:, 0] - b * residual[:, 1], a * residual[:, 1] - c * residual[:, 0]], axis=-1
                )
                better = xy - step * (share / determinant)[:, None]
                outside = np.maximum(lengths(better) / self._limit, 1.0)
                better /= outside[:, None]
            new_residual = np.stack(self._bend(better[:, 0], better[:, 1]), axis=-1) - target
            nearer = lengths(new_residual) < lengths(residual)
            xy = np.where(nearer[:, None], better, xy)
            residual = np.where(nearer[:, None], new_residual, residual)
            share = np.where(nearer, 1.0, share / 2)
            done = lengths(residual) <= _RESIDUAL * scale[at]
            result[at[done]] = xy[done]
            going = ~done & (share > 1e-6)
            stuck = ~done & ~going & (lengths(residual) <= 100 * _RESIDUAL * scale[at])
            result[at[stuck]] = xy[stuck]
            if not going.any():
                break
            at, xy, target, residual, share = at[going], xy[going], target[going], residual[going], share[going]
        result[~(lengths(result) < self._limit)] = np.nan
        return result


def _mapped(homography: Float, plane: Float) -> tuple[Float, Bool]:
    """Points (..., 2) of a plane through a homography (3, 3), and which (...) stay on this side of it."""
    x, y, depth = np.moveaxis(plane @ homography[:, :2].T + homography[:, 2], -1, 0)
    before: Bool = depth > 0
    depth = np.where(before, depth, 1.0)
    return np.stack([x / depth, y / depth], axis=-1), before
