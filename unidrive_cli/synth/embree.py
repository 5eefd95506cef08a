"""Rays against meshes, by embree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import UnidriveError
from unidrive_cli.geometry.arrays import Float, lengths
from unidrive_cli.synth.mesh import Mesh


def ray_scene(positions_m: npt.NDArray[np.float32], triangles: npt.NDArray[np.int32]) -> Any:
    """embree's scene of a mesh; None of an empty one.

    Raises:
        UnidriveError: embreex is not installed.
    """
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise UnidriveError(
            f"casting rays needs the Python package embreex ({error}).", hint="Install it: pip install embreex."
        ) from error
    if not len(triangles):
        return None
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(positions_m), np.ascontiguousarray(triangles))
    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # the first query builds the tree
    return scene


class Bodies:
    """Rays against single actors, each in its own frame; equal meshes share one tree."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        self._meshes = meshes
        self._scenes: dict[int, Any] = {}
        self.half_m = np.array([np.abs(mesh.positions_m).max(axis=0) for mesh in meshes]).reshape(-1, 3)
        """(n, 3) half extents of each body's box, metres."""

    def cast(self, index: int, cam_from_actor: Float, directions_cam: Float) -> dict[str, npt.NDArray[Any]]:
        """What rays (n, 3) from a sensor's centre meet of one body: embree's answer, with primID -1 for nothing."""
        mesh = self._meshes[index]
        scene = self._scenes.get(id(mesh))
        if scene is None:
            scene = self._scenes[id(mesh)] = ray_scene(mesh.positions_m, mesh.triangles)
        rotation = cam_from_actor[:3, :3]
        origin = (-cam_from_actor[:3, 3] @ rotation).astype(np.float32)
        directions = np.ascontiguousarray((directions_cam @ rotation).astype(np.float32))
        found: dict[str, npt.NDArray[Any]] = scene.run(
            np.ascontiguousarray(np.broadcast_to(origin, directions.shape)), directions, output=True
        )
        return found

    def aimed(self, index: int, cam_from_actor: Float, directions_cam: Float) -> npt.NDArray[np.int64]:
        """Numbers of the unit rays (n, 3) that may meet a body: those towards the ball round its box."""
        offset = cam_from_actor[:3, 3]
        distance, radius = float(lengths(offset)), float(lengths(self.half_m[index]))
        if distance <= radius:
            return np.arange(len(directions_cam))
        edge = np.sqrt(1 - (radius / distance) ** 2)
        return np.flatnonzero(directions_cam @ (offset / distance) > edge - 1e-6)
