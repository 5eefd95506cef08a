"""How much of an actor the cameras of a rig show: from instance pictures, beside its whole silhouette."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unidrive_cli.geometry import boxes
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import relative, transform
from unidrive_cli.synth.embree import Bodies
from unidrive_cli.synth.stage import FIRST_ACTOR_ID, Instances

_NEAR_M = 0.1
_RAYS = 1500
"""About so many rays measure a silhouette."""
_GRID = boxes.volume_grid(5)


class Silhouettes:
    """Sums up, over the cameras of one sample, what they show of each actor."""

    def __init__(self, bodies: Bodies) -> None:
        count = len(bodies.half_m)
        self._bodies = bodies
        self._shown_px = np.zeros(count)
        self._whole_px = np.zeros(count)
        self._in_field = np.zeros((count, len(_GRID)), dtype=bool)

    def add(self, lens: Lens, global_from_cam: Float, global_from_actor: Float, shown: Bool, ids: Instances) -> None:
        """Takes in one camera.

        Args:
            global_from_actor: (n, 4, 4) at the camera's moment, and `shown` (n,): which of them are there.
            ids: (H, W) its instance picture.
        """
        counts = np.bincount(ids.ravel(), minlength=FIRST_ACTOR_ID + len(shown))[FIRST_ACTOR_ID:]
        self._shown_px += counts[: len(shown)]
        indices = np.flatnonzero(shown)
        poses = [relative(global_from_cam, global_from_actor[index]) for index in indices]
        points = np.array(
            [transform(pose, _GRID * self._bodies.half_m[index]) for pose, index in zip(poses, indices, strict=True)]
        ).reshape(-1, len(_GRID), 3)
        pixels, inside = lens.project(points)
        self._in_field[indices] |= inside
        for which in np.flatnonzero(inside.any(axis=1) | (counts[indices] > 0)):
            index = int(indices[which])
            self._whole_px[index] += self._silhouette_px(index, lens, poses[which], points[which], pixels[which])

    def visible(self) -> Float:
        """(n,) share of each actor that the rig shows, 0 to 1.

        The product of two: pixels in the instance pictures over pixels of the whole silhouettes in the same
        pictures, and the share of the box's volume (a grid of 125 points) that is in any picture's field.
        """
        unhidden = np.minimum(self._shown_px / np.maximum(self._whole_px, 1), 1.0)
        share: Float = unhidden * self._in_field.mean(axis=1)
        return share

    def _silhouette_px(self, index: int, lens: Lens, cam_from_actor: Float, points: Float, pixels: Float) -> float:
        """Pixels that the actor would fill in the picture if nothing hid it."""
        low, high = np.zeros(2), np.array([lens.width_px - 1.0, lens.height_px - 1.0])
        if (points[:, 2] > _NEAR_M).all() and np.isfinite(pixels).all():
            low = np.maximum(low, np.floor(pixels.min(axis=0)))
            high = np.minimum(high, np.ceil(pixels.max(axis=0)))
        if (high < low).any():
            return 0.0
        step = max(1.0, float(np.sqrt(np.prod(high - low + 1) / _RAYS)))
        u, v = np.meshgrid(np.arange(low[0], high[0] + 1, step), np.arange(low[1], high[1] + 1, step))
        rays = lens.unproject(np.stack([u.ravel(), v.ravel()], axis=-1))
        rays = rays[np.isfinite(rays).all(axis=1)]
        return float((self._bodies.cast(index, cam_from_actor, rays)["primID"] >= 0).sum()) * step**2


def level_of(share: float, limits: Sequence[float] = (0.4, 0.6, 0.8)) -> str:
    """nuScenes' visibility token, "1" to "4", of a share."""
    return str(1 + int(np.searchsorted(limits, share, side="right")))
