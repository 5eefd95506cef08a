"""What every lens offers, and the intrinsics that all of them have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Bool, Float, finite_array

PIXEL_TOLERANCE = 1e-6
"""Rounding allowed, in pixels, where a point falls exactly on the picture's border."""

MAX_SIDE_PX = 32766
"""Longest picture side: OpenCV's remap addresses source pixels with 16 bits."""


class Lens(Protocol):
    """What the rig, the warp, the coverage and the error need of a lens with its picture size."""

    @property
    def model(self) -> str:
        """`pinhole`, or the name that rig files give the distortion."""

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Of the distortion; none for the pinhole."""

    @property
    def fx_px(self) -> float: ...

    @property
    def fy_px(self) -> float: ...

    @property
    def cx_px(self) -> float: ...

    @property
    def cy_px(self) -> float: ...

    @property
    def width_px(self) -> int: ...

    @property
    def height_px(self) -> int: ...

    @property
    def matrix(self) -> Float:
        """K (3, 3), in pixels."""

    @property
    def hfov_deg(self) -> float:
        """Angle between the left and the right border in the principal point's row, in degrees."""

    @property
    def vfov_deg(self) -> float:
        """Angle between the upper and the lower border in the principal point's column, in degrees."""

    def __hash__(self) -> int:
        """Lenses of the same numbers are equal, and keys of what was worked out for them."""

    def project(self, points_cam: Float) -> tuple[Float, Bool]:
        """Pixels (..., 2) of camera-frame points (..., 3), and where they are inside the picture."""

    def unproject(self, pixels: Float) -> Float:
        """Unit rays (..., 3) in the camera frame of pixels (..., 2); NaN where a pixel has none."""

    def border_sine(self, points_cam: Float) -> Float:
        """Sine (...) of the angle from each point's ray to the nearest border of the picture's field.

        Positive inside, zero on the border, negative outside.
        """


@dataclass(frozen=True)
class Intrinsics:
    """fx, fy, cx, cy and the picture size, all in pixels.

    Integer pixel coordinates are pixel centres; the picture covers [-0.5, W-0.5] x [-0.5, H-0.5].
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        finite_array([self.fx_px, self.fy_px, self.cx_px, self.cy_px], (4,), "camera intrinsics fx, fy, cx, cy")
        if self.fx_px <= 0 or self.fy_px <= 0:
            raise GeometryError(f"focal lengths must be positive, got fx {self.fx_px:g}, fy {self.fy_px:g}.")
        for name, side in (("width", self.width_px), ("height", self.height_px)):
            if isinstance(side, bool) or not isinstance(side, int) or not 1 <= side <= MAX_SIDE_PX:
                raise GeometryError(
                    f"{name} must be a whole number of pixels from 1 to {MAX_SIDE_PX}, got {side!r}."
                )

    @property
    def matrix(self) -> Float:
        """K (3, 3), in pixels."""
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1.0]])

    def contains(self, pixels: Float) -> Bool:
        """Where pixels (..., 2) lie inside the picture's whole area, to PIXEL_TOLERANCE."""
        u, v = pixels[..., 0], pixels[..., 1]
        low, high_u, high_v = -0.5 - PIXEL_TOLERANCE, self.width_px - 0.5, self.height_px - 0.5
        inside: Bool = (u >= low) & (u <= high_u + PIXEL_TOLERANCE) & (v >= low) & (v <= high_v + PIXEL_TOLERANCE)
        return inside
