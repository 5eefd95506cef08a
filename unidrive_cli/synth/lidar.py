"""The lidar: a ray-cast cloud of 32 beams, and which actor each point lies on."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Bool, Float, lengths
from unidrive_cli.geometry.poses import relative
from unidrive_cli.synth.embree import Bodies, ray_scene
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.stage import Stage

BEAMS, STEPS = 32, 1084
_LOWEST_DEG, _HIGHEST_DEG = -30.67, 10.67
"""Of the HDL-32E that nuScenes drove."""
RANGE_M = 100.0
_NEAREST_M = 1.0


def rays() -> tuple[Float, npt.NDArray[np.int64]]:
    """Unit directions (n, 3) in the lidar's frame and their beams (n,), in the order of a clockwise turn."""
    beams_rad = np.deg2rad(np.linspace(_LOWEST_DEG, _HIGHEST_DEG, BEAMS))
    turn_rad = -2 * np.pi * np.arange(STEPS) / STEPS
    azimuth, beam = np.meshgrid(turn_rad, beams_rad, indexing="ij")
    directions = np.stack(
        [np.cos(azimuth) * np.cos(beam), np.sin(azimuth) * np.cos(beam), np.sin(beam)], axis=-1
    ).reshape(-1, 3)
    return directions, np.tile(np.arange(BEAMS), STEPS)


class Lidar:
    """Casts the rays of one lidar turn into a stage, all at one moment (the cloud is free of motion)."""

    def __init__(self, stage: Stage, bodies: Bodies) -> None:
        still = merged([stage.ground, stage.structures])
        self._still = ray_scene(still.positions_m, still.triangles)
        self._still_albedo = _triangle_albedo(still)
        self._bodies = bodies
        self._body_albedo = [_triangle_albedo(mesh) for mesh in stage.actors]
        self._directions, self._beams = rays()

    def cloud(
        self, global_from_lidar: Float, global_from_actor: Float, shown: Bool
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """One turn.

        Args:
            global_from_lidar: (4, 4).
            global_from_actor: (n, 4, 4), and `shown` (n,): which of them are there.

        Returns:
            (m, 5) float32: x, y, z in the lidar's frame (metres), intensity 0 to 255, beam; nuScenes' `.pcd.bin`.
            (m,) number of the actor that each point lies on, -1 where it lies on none.
        """
        directions = np.ascontiguousarray((self._directions @ global_from_lidar[:3, :3].T).astype(np.float32))
        origins = np.broadcast_to(global_from_lidar[:3, 3].astype(np.float32), directions.shape)
        found = self._still.run(np.ascontiguousarray(origins), directions, output=True)
        hit = found["primID"] >= 0
        distance = np.where(hit, found["tfar"], np.inf)
        intensity = np.where(hit, self._still_albedo[found["primID"]] * _facing(found["Ng"], directions), 0.0)
        actor = np.full(len(directions), -1)
        for index in np.flatnonzero(shown):
            lidar_from_actor = relative(global_from_lidar, global_from_actor[index])
            if lengths(lidar_from_actor[:3, 3]) > RANGE_M + lengths(self._bodies.half_m[index]):
                continue
            aimed = self._bodies.aimed(index, lidar_from_actor, self._directions)
            found = self._bodies.cast(index, lidar_from_actor, self._directions[aimed])
            hit = (found["primID"] >= 0) & (found["tfar"] < distance[aimed])
            at = aimed[hit]
            normals = found["Ng"][hit] @ lidar_from_actor[:3, :3].T
            distance[at], actor[at] = found["tfar"][hit], index
            albedo = self._body_albedo[index][found["primID"][hit]]
            intensity[at] = albedo * _facing(normals, self._directions[at])
        kept = (distance < RANGE_M) & (distance > _NEAREST_M)
        points = self._directions[kept] * distance[kept, None]
        cloud = np.column_stack([points, np.clip(255 * intensity[kept], 0, 255), self._beams[kept]])
        return cloud.astype(np.float32), actor[kept]


def _triangle_albedo(mesh: Mesh) -> Float:
    """(t,) mean albedo of each triangle."""
    grey: Float = mesh.albedo.astype(np.float64).mean(axis=1)[mesh.triangles[:, 0]]
    return grey


def _facing(normals: Any, directions: Any) -> Float:
    """(n,) cosine of the angle between rays and the surfaces' normals (of any length)."""
    cosine: Float = np.abs((normals * directions).sum(axis=1)) / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    return cosine
