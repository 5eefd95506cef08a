"""What lenses with distortion share: the model's field, and the picture's border in it."""

from __future__ import annotations

import abc
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Bool, Float, finite_array, lengths
from unidrive_cli.geometry.lenses.base import Intrinsics
from unidrive_cli.geometry.lenses.border import BorderCurve, border_curves, chords_to_border

_CHUNK = 1 << 15
_LARGEST_COEFFICIENT = 1e9
_SMALLEST_FIELD = 0.25
"""Share of the picture's shorter side that the model must reach off the principal point."""


@dataclass(frozen=True)
class DistortedLens(Intrinsics, abc.ABC):
    """Intrinsics and a distortion polynomial, valid inside a cone about the optical axis.

    The model's field is the widest cone (`limit_rad`) within which the polynomial has not folded back.
    Points outside it have no pixel (NaN) and are invalid, also where the folded polynomial would put them
    into the picture; pixels that it does not reach have no ray (NaN). A picture may hold such pixels, as the
    black corners of a fisheye are; a lens whose field ends near the principal point is refused.

    Attributes:
        coefficients: of the model, in OpenCV's order.
    """

    coefficients: tuple[float, ...]

    model: ClassVar[str]
    counts: ClassVar[tuple[int, ...]]
    names: ClassVar[str]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "coefficients", self._checked(self.coefficients))
        if not self.contains(np.array([self.cx_px, self.cy_px])):
            raise GeometryError(
                f"the principal point ({self.cx_px:g}, {self.cy_px:g}) lies outside of the "
                f"{self.width_px}x{self.height_px} picture; distortion needs it inside."
            )
        reach_px = self.radius_at(self.limit_rad) * min(self.fx_px, self.fy_px)
        if not reach_px >= _SMALLEST_FIELD * min(self.width_px, self.height_px):
            raise GeometryError(
                f"the distortion folds back {np.rad2deg(self.limit_rad):.3g} degrees off the axis, {reach_px:.3g} "
                f"pixels from the principal point: not even the middle of the picture has rays "
                f"(the order is {self.names})."
            )

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled by its numbers: what was worked out for a lens is found again where it is known already."""
        k = self
        intrinsics = k.fx_px, k.fy_px, k.cx_px, k.cy_px, k.width_px, k.height_px
        return known_lens, (type(self), *intrinsics, self.coefficients)

    def _checked(self, given: Sequence[float]) -> tuple[float, ...]:
        """The coefficients as the lens keeps them."""
        if len(given) not in self.counts:
            wanted = ", ".join(map(str, self.counts))
            raise GeometryError(
                f"the lens model {self.model} has {wanted} coefficients ({self.names}), got {len(given)}."
            )
        array = finite_array(given, (None,), f"{self.model} coefficients")
        if np.abs(array).max() > _LARGEST_COEFFICIENT:
            raise GeometryError(
                f"{self.model} coefficients must be at most {_LARGEST_COEFFICIENT:g}, got {np.abs(array).max():g}."
            )
        return tuple((array + 0.0).tolist())

    @property
    @abc.abstractmethod
    def limit_rad(self) -> float:
        """Half the opening angle of the model's field; rays that far off the axis are just outside."""

    @abc.abstractmethod
    def radius_at(self, angle_rad: float) -> float:
        """How far from the principal point, in focal lengths, a ray falls that is so far off the axis."""

    @abc.abstractmethod
    def _distort(self, points_cam: Float) -> tuple[Float, Bool]:
        """Where (..., 2) points (..., 3) fall, in focal lengths, and which (...) are in the model's field."""

    @abc.abstractmethod
    def _undistort(self, plane: Float) -> Float:
        """Unit rays (n, 3) that fall on `plane` (n, 2), in focal lengths; NaN where there is none."""

    def project(self, points_cam: Float) -> tuple[Float, Bool]:
        plane, in_model = self._distort(points_cam)
        pixels = plane * [self.fx_px, self.fy_px] + [self.cx_px, self.cy_px]
        pixels[~in_model] = np.nan
        return pixels, in_model & self.contains(pixels)

    def unproject(self, pixels: Float) -> Float:
        plane = ((pixels - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px]).reshape(-1, 2)
        rays = np.empty((len(plane), 3))
        for start in range(0, len(plane), _CHUNK):
            rays[start : start + _CHUNK] = self._undistort(plane[start : start + _CHUNK])
        return rays.reshape(*pixels.shape[:-1], 3)

    def border_sine(self, points_cam: Float) -> Float:
        """As `Lens.border_sine`, right to some 1e-5 (1e-4 by a fold); 1 and -1 stand for 90 degrees and more."""
        distance = lengths(points_cam)
        rays = (points_cam / np.where(distance > 0, distance, 1.0)[..., None]).reshape(-1, 3)
        chord = chords_to_border(self._border, rays).reshape(distance.shape)
        half_sine = np.minimum(chord / 2, np.sqrt(0.5))
        sine = 2 * half_sine * np.sqrt(1 - half_sine**2)
        signed: Float = np.where(distance > 0, np.where(self.project(points_cam)[1], sine, -sine), 0.0)
        return signed

    @property
    def hfov_deg(self) -> float:
        """Angle between the left and the right border in the principal point's row, in degrees.

        Where the model's field ends inside the picture, up to there.
        """
        return self._field_deg([[-0.5, self.cy_px], [self.width_px - 0.5, self.cy_px]])

    @property
    def vfov_deg(self) -> float:
        """Angle between the upper and the lower border in the principal point's column, as `hfov_deg`."""
        return self._field_deg([[self.cx_px, -0.5], [self.cx_px, self.height_px - 0.5]])

    def _field_deg(self, pixels: list[list[float]]) -> float:
        rays = self.unproject(np.array(pixels))
        off_axis = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
        return float(np.rad2deg(np.where(np.isnan(off_axis), self.limit_rad, off_axis).sum()))

    @cached_property
    def _border(self) -> list[BorderCurve]:
        """The sides of the picture as far as they have rays, and the rim of the model's field inside it."""
        left, top, right, bottom = -0.5, -0.5, self.width_px - 0.5, self.height_px - 0.5
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
        curves: list[BorderCurve] = []
        for quarter in range(4):
            corner, next_corner = corners[quarter], corners[quarter + 1]
            side = functools.partial(self._side, corner, next_corner - corner)
            curves.extend(border_curves(side, functools.partial(_are_rays, side)))
            rim = functools.partial(self._rim, quarter, self.limit_rad)
            just_inside = functools.partial(self._rim, quarter, self.limit_rad - 1e-9)
            curves.extend(border_curves(rim, functools.partial(self._sees, just_inside)))
        return curves

    def _side(self, corner: Float, along: Float, place: Float) -> Float:
        """Rays (n, 3) at places (n,) of a side of the picture, 0 and 1 being its ends."""
        return self.unproject(corner + place[:, None] * along)

    def _sees(self, curve: Callable[[Float], Float], place: Float) -> Bool:
        return self.project(curve(place))[1]

    @staticmethod
    def _rim(quarter: int, angle_rad: float, place: Float) -> Float:
        """Rays (n, 3) so far off the axis, at places (n,) of a quarter circle."""
        azimuth = (quarter + place) * (np.pi / 2)
        sine, cosine = np.sin(angle_rad), np.full_like(place, np.cos(angle_rad))
        return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)


@functools.lru_cache(maxsize=256)
def known_lens(
    kind: type[DistortedLens],
    fx_px: float,
    fy_px: float,
    cx_px: float,
    cy_px: float,
    width_px: int,
    height_px: int,
    coefficients: tuple[float, ...],
) -> DistortedLens:
    """A lens, and the same one for the same numbers: its field and its border are worked out once.

    Raises:
        GeometryError: numbers that are no such lens.
    """
    return kind(fx_px, fy_px, cx_px, cy_px, width_px, height_px, coefficients)


def _are_rays(curve: Callable[[Float], Float], place: Float) -> Bool:
    finite: Bool = np.isfinite(curve(place)[:, 0])
    return finite
