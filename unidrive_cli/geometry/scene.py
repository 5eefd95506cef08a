"""The assumed scene surface: a ball round the virtual camera, cut by the ground (UniDrive eqs. 1 and 2)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Bool, Float, finite_array, read_only


def _up() -> Float:
    return np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """The ground in the ego frame: the points p with normal . p = offset_m.

    Attributes:
        offset_m: distance of the plane from the ego origin along the normal, metres;
            with the default normal it is the ground's height.
        normal: (3,) unit vector, pointing up.
    """

    offset_m: float = 0.0
    normal: Float = field(default_factory=_up)

    def __post_init__(self) -> None:
        finite_array(self.offset_m, (), "ground height")
        normal = finite_array(self.normal, (3,), "ground normal")
        if abs(float(np.linalg.norm(normal)) - 1.0) > 1e-6 or normal[2] <= 0:
            raise GeometryError(f"ground normal must be a unit vector that points up, got {normal.tolist()}.")
        object.__setattr__(self, "normal", read_only(normal))

    def height_m(self, points_ego: Float) -> Float:
        """Signed height (...) of points (..., 3) above the plane, metres."""
        height: Float = points_ego @ self.normal - self.offset_m
        return height


@dataclass(frozen=True, eq=False)
class HalfBall:
    """The convex region within `radius_m` of the virtual camera's centre and above the ground.

    Its boundary is where the warp assumes the scene to be. A ray that starts inside leaves it
    exactly once, so the same surface serves both directions of the warp.

    Attributes:
        centre_ego: (3,) optical centre o of the virtual camera, ego frame, metres.
        radius_m: D0 of UniDrive eq. 2.
        ground: the ground plane in the same frame.
    """

    centre_ego: Float
    radius_m: float
    ground: GroundPlane

    def __post_init__(self) -> None:
        centre = finite_array(self.centre_ego, (3,), "virtual camera centre")
        finite_array(self.radius_m, (), "depth limit")
        height = float(self.ground.height_m(centre))
        if height <= 0:
            place = f"is {-height:g} m below the ground" if height < 0 else "is on the ground"
            raise GeometryError(f"the virtual camera {place}; it must be above it.")
        if self.radius_m <= height:
            raise GeometryError(
                f"the depth limit ({self.radius_m:g} m) must be larger than the virtual camera's height "
                f"above the ground ({height:g} m), or no ground would be left."
            )
        object.__setattr__(self, "centre_ego", read_only(centre))

    def contains(self, points_ego: Float, *, tolerance_m: float = 1e-9) -> Bool:
        """Where points (..., 3) lie in the closed region, to `tolerance_m`."""
        distance = np.linalg.norm(points_ego - self.centre_ego, axis=-1)
        inside: Bool = (distance <= self.radius_m + tolerance_m) & (self.ground.height_m(points_ego) >= -tolerance_m)
        return inside

    def exit_distance_m(self, origins_ego: Float, directions_ego: Float) -> Float:
        """Distance (...) along unit rays from points inside the region to its boundary.

        Args:
            origins_ego: (..., 3) points inside the region, metres.
            directions_ego: (..., 3) unit vectors; broadcast against the origins.

        Returns:
            min(t_ground, t_sphere) of geometry.md; from the centre itself this is UniDrive
            eqs. 1 and 2 with the test of Algorithm 1, for a camera of any pitch and roll.
        """
        descent = -(directions_ego @ self.ground.normal)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t_ground = np.where(descent > 0, self.ground.height_m(origins_ego) / descent, np.inf)
        offset = origins_ego - self.centre_ego
        half_b = np.sum(offset * directions_ego, axis=-1)
        c = np.sum(offset * offset, axis=-1) - self.radius_m**2
        t_sphere = -half_b + np.sqrt(np.maximum(half_b * half_b - c, 0.0))
        return np.minimum(t_ground, t_sphere)

    def surface_points(self, origins_ego: Float, directions_ego: Float) -> Float:
        """Where unit rays (..., 3) from points inside meet the boundary: (..., 3), ego frame, metres."""
        return origins_ego + self.exit_distance_m(origins_ego, directions_ego)[..., None] * directions_ego
