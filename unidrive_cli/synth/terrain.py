"""The lie of the land: flat, or gentle hills that make the flat-ground assumption false."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import shapely

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh

_WAVES = ((61.0, 0.4, 0.9, 0.6), (83.0, 2.0, 2.6, 0.4))
"""Wavelength m, direction rad, phase rad, share of the slope."""
CELL_M = 6.0
"""Longest side of a piece of ground that follows the hills."""


@dataclass(frozen=True)
class Terrain:
    """Heights h(x, y) of the ground, a sum of waves.

    Attributes:
        slope: largest rise per metre, such as 0.05; 0 is flat.
    """

    slope: float = 0.0

    def height_m(self, xy_m: Float) -> Float:
        """Heights (...) of the road at places (..., 2)."""
        total = np.zeros(np.shape(xy_m)[:-1])
        for wave_m, direction, phase, share in _WAVES if self.slope else ():
            k = 2 * np.pi / wave_m * np.array([np.cos(direction), np.sin(direction)])
            total = total + self.slope * share * wave_m / (2 * np.pi) * np.sin(xy_m @ k + phase)
        return total

    def gradient(self, xy_m: Float) -> Float:
        """Rise per metre (..., 2) along x and y at places (..., 2)."""
        total = np.zeros(np.shape(xy_m))
        for wave_m, direction, phase, share in _WAVES if self.slope else ():
            unit = np.array([np.cos(direction), np.sin(direction)])
            k = 2 * np.pi / wave_m * unit
            total = total + self.slope * share * np.cos(xy_m @ k + phase)[..., None] * unit
        return total

    def pose_on(self, xy_m: Float, heading_rad: float, above_m: float) -> Float:
        """`global_from_body` (4, 4) of a body that stands on the ground, its z axis along the ground's normal.

        Args:
            xy_m: (2,) where.
            heading_rad: direction of its x axis, seen from above.
            above_m: height of its origin over the ground, along the normal.
        """
        rise = self.gradient(xy_m)
        up = np.array([-rise[0], -rise[1], 1.0]) / np.sqrt(1 + rise @ rise)
        level = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
        ahead = level - (level @ up) * up
        ahead /= np.linalg.norm(ahead)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([ahead, np.cross(up, ahead), up], axis=1)
        pose[:3, 3] = np.array([*xy_m, float(self.height_m(xy_m))]) + above_m * up
        return pose

    def raised(self, mesh: Mesh) -> Mesh:
        """A mesh of flat land laid on this one; each vertex is lifted by the height under it."""
        if not self.slope:
            return mesh
        places = mesh.positions_m[:, :2].astype(np.float64)
        positions = mesh.positions_m.copy()
        positions[:, 2] += self.height_m(places).astype(np.float32)
        return replace(mesh, positions_m=positions)

    def cells(self, polygons: Iterable[shapely.Polygon], cell_m: float = CELL_M) -> Iterator[shapely.Polygon]:
        """The polygons; cut into cells of a few metres where the land is not flat."""
        for polygon in polygons:
            yield from _halved(polygon, cell_m) if self.slope else [polygon]


def _halved(polygon: shapely.Polygon, cell_m: float) -> Iterator[shapely.Polygon]:
    """Pieces of a polygon that are at most `cell_m` long, cut at multiples of it."""
    low_x, low_y, high_x, high_y = polygon.bounds
    across = high_x - low_x >= high_y - low_y
    low, high = (low_x, high_x) if across else (low_y, high_y)
    first, last = int(np.floor(low / cell_m + 1e-6)), int(np.ceil(high / cell_m - 1e-6))
    if last - first <= 1:
        yield polygon
        return
    cut = (first + last) // 2 * cell_m
    halves = (
        ((low_x, low_y, cut, high_y), (cut, low_y, high_x, high_y))
        if across
        else ((low_x, low_y, high_x, cut), (low_x, cut, high_x, high_y))
    )
    for half in halves:
        for piece in shapely.get_parts(shapely.clip_by_rect(polygon, *half)):
            if isinstance(piece, shapely.Polygon) and piece.area > 1e-6:
                yield from _halved(piece, cell_m)
