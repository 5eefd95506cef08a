"""Triangle meshes with what the shading needs, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Float

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles, counter-clockwise seen from outside; vertices are not shared across edges that look sharp.

    Attributes:
        positions_m: (v, 3) float32, metres.
        normals: (v, 3) float32 unit vectors that point outwards.
        uv: (v, 2) float32 texture coordinates, counted in repeats of the texture.
        albedo: (v, 3) float32 linear RGB, 0 to 1; multiplies the texture.
        layer: (v,) int32 index into `textures.LAYERS`.
        gloss: (v,) float32, 0 (matt) to 1 (a mirror): share of the reflected sky seen head-on.
        triangles: (t, 3) int32 vertex indices.
    """

    positions_m: Float32
    normals: Float32
    uv: Float32
    albedo: Float32
    layer: Int32
    gloss: Float32
    triangles: Int32

    def placed(self, frame_from_mesh: Float) -> Mesh:
        """The mesh moved by a rigid pose (4, 4)."""
        rotation = frame_from_mesh[:3, :3]
        positions = self.positions_m.astype(np.float64) @ rotation.T + frame_from_mesh[:3, 3]
        normals = self.normals.astype(np.float64) @ rotation.T
        return replace(self, positions_m=positions.astype(np.float32), normals=normals.astype(np.float32))


def mesh_of(
    positions_m: Any,
    triangles: Any,
    *,
    layer: int,
    albedo: Any = (1.0, 1.0, 1.0),
    uv: Any = None,
    normals: Any = None,
    gloss: float = 0.0,
) -> Mesh:
    """A mesh of one material.

    Args:
        positions_m: (v, 3).
        triangles: (t, 3), counter-clockwise seen from outside.
        layer: index into `textures.LAYERS`.
        albedo: linear RGB (3,), or (v, 3).
        uv: (v, 2); zeros where None.
        normals: (v, 3); flat shading with one normal per triangle where None (vertices are then split).
        gloss: share of the reflected sky seen head-on.
    """
    positions = np.asarray(positions_m, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
    count = len(positions)
    coordinates = np.zeros((count, 2)) if uv is None else np.asarray(uv, dtype=np.float64)
    colours = np.broadcast_to(np.asarray(albedo, dtype=np.float64), (count, 3))
    if normals is None:
        corners = positions[faces]
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
        normals = np.repeat(facing, 3, axis=0)
        positions, coordinates, colours = (array[faces.ravel()] for array in (positions, coordinates, colours))
        faces = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
        count = len(positions)
    return Mesh(
        positions.astype(np.float32),
        np.asarray(normals, dtype=np.float32),
        coordinates.astype(np.float32),
        colours.astype(np.float32),
        np.full(count, layer, dtype=np.int32),
        np.full(count, gloss, dtype=np.float32),
        faces,
    )


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles of some meshes in one; an empty mesh of none."""
    if not meshes:
        return mesh_of(np.zeros((0, 3)), np.zeros((0, 3)), layer=0)
    starts = np.cumsum([0, *(len(mesh.positions_m) for mesh in meshes[:-1])])
    names = ("positions_m", "normals", "uv", "albedo", "layer", "gloss")
    joined = {name: np.concatenate([getattr(mesh, name) for mesh in meshes]) for name in names}
    triangles = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    return Mesh(**joined, triangles=triangles.astype(np.int32))
