"""Pictures through any lens: a pinhole's are rendered as they are, others rendered wide and warped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.synth.stage import SKY_ID, Depth, Instances, Picture, Renderer, View

_FACE_DEG = 92.0
"""Faces of the cube that a lens looks at overlap by a little, so that taps at their borders have neighbours."""
_MAX_FACE_PX = 4096
_TURNS = {  # face_from_cam, rows: the face's x, y and z axis in the camera frame
    "ahead": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "right": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "left": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "down": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "behind": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
}


@dataclass(frozen=True, eq=False)
class _Face:
    """One wide pinhole picture, and which pixels of the lens's picture come from it.

    Attributes:
        lens: the pinhole.
        cam_from_face: (4, 4).
        pixels: (H, W, 2) float32 where in the face each pixel lies.
        mine: (H, W) whose rays lie in this face.
        depth_ratio: (H, W) depth along the lens's axis over depth along the face's.
    """

    lens: Pinhole
    cam_from_face: Float
    pixels: npt.NDArray[np.float32]
    mine: Bool
    depth_ratio: Float


class Shots:
    """Takes pictures of one renderer's stage through any lens.

    Pixels that have no ray (the corners of a fisheye's picture) are black, sky in instance pictures, and
    infinitely deep.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._faces: dict[Any, tuple[_Face, ...]] = {}

    def picture(self, lens: Lens, global_from_cam: Float, actors: Float, shown: Bool, samples: int) -> Picture:
        """(H, W, 3) uint8 BGR; the arguments are those of `View`."""
        if isinstance(lens, Pinhole):
            return self._renderer.picture(View(lens, global_from_cam, actors, shown), samples)
        picture = np.zeros((lens.height_px, lens.width_px, 3), dtype=np.uint8)
        for face in self._faces_of(lens):
            wide = self._renderer.picture(
                View(face.lens, global_from_cam @ face.cam_from_face, actors, shown), samples
            )
            picture[face.mine] = _taken(wide, face, cv2.INTER_LINEAR)[face.mine]
        return picture

    def _faces_of(self, lens: Lens) -> tuple[_Face, ...]:
        if lens not in self._faces:
            self._faces[lens] = tuple(_faces(lens))
        return self._faces[lens]

    def instances(self, lens: Lens, global_from_cam: Float, actors: Float, shown: Bool) -> tuple[Instances, Depth]:
        """Ids, and depths along the optical axis, of what pixels' centres show, to the wide ones' nearest ray."""
        if isinstance(lens, Pinhole):
            return self._renderer.instances(View(lens, global_from_cam, actors, shown))
        ids = np.full((lens.height_px, lens.width_px), SKY_ID, dtype=np.uint16)
        depths = np.full(ids.shape, np.inf, dtype=np.float32)
        for face in self._faces_of(lens):
            found = self._renderer.instances(View(face.lens, global_from_cam @ face.cam_from_face, actors, shown))
            ids[face.mine] = _taken(found[0], face, cv2.INTER_NEAREST)[face.mine]
            along = _taken(found[1], face, cv2.INTER_NEAREST)[face.mine]
            depths[face.mine] = np.where(np.isfinite(along), along * face.depth_ratio[face.mine], np.inf)
        return ids, depths


def _taken(wide: npt.NDArray[Any], face: _Face, interpolation: int) -> npt.NDArray[Any]:
    nothing = np.empty(0, dtype=np.float32)
    return np.asarray(cv2.remap(wide, face.pixels, nothing, interpolation, borderMode=cv2.BORDER_REPLICATE))


def _faces(lens: Lens) -> Iterator[_Face]:
    """The sides of a cube that a lens sees, each as fine as the lens is at its finest."""
    u, v = np.meshgrid(np.arange(lens.width_px, dtype=np.float64), np.arange(lens.height_px, dtype=np.float64))
    rays = lens.unproject(np.stack([u, v], axis=-1))
    known = np.isfinite(rays).all(axis=-1)
    rays = np.where(known[..., None], rays, [0.0, 0.0, 1.0])
    turns = np.array(list(_TURNS.values()), dtype=np.float64)
    nearest = np.argmax(rays @ turns[:, 2].T, axis=-1)
    step = np.median(np.linalg.norm(np.diff(rays, axis=1), axis=-1)[known[:, 1:] & known[:, :-1]])
    side_px = int(min(_MAX_FACE_PX, np.ceil(2 * np.tan(np.deg2rad(_FACE_DEG / 2)) / step)))
    square = Pinhole.from_hfov(_FACE_DEG, side_px, side_px)
    for index, face_from_cam in enumerate(turns):
        mine = known & (nearest == index)
        if not mine.any():
            continue
        local = rays @ face_from_cam.T
        ahead = np.where(mine, local[..., 2], 1.0)
        x, y = (local[..., axis] / ahead * square.fx_px + square.cx_px for axis in (0, 1))
        low = np.maximum(np.floor([x[mine].min(), y[mine].min()]).astype(int) - 2, 0)
        high = np.minimum(np.ceil([x[mine].max(), y[mine].max()]).astype(int) + 3, side_px)
        cropped = Pinhole(
            square.fx_px,
            square.fy_px,
            square.cx_px - int(low[0]),
            square.cy_px - int(low[1]),
            int(high[0] - low[0]),
            int(high[1] - low[1]),
        )
        cam_from_face = np.eye(4)
        cam_from_face[:3, :3] = face_from_cam.T
        pixels = np.stack([x - low[0], y - low[1]], axis=-1).astype(np.float32)
        yield _Face(cropped, cam_from_face, pixels, mine, rays[..., 2] / ahead)
