"""Anti-aliasing: how many times a virtual camera shrinks a source, and which reduced copy it samples therefore.

Where a source pixel is much smaller than a virtual one, a bilinear sample sees four of the many that fall into it,
and fine structure turns into noise that flickers. Such a source is sampled from a copy that is smaller by a whole
number n, each of its pixels the mean of n x n. A copy is one more picture whose pixels are
((u + 0.5) / n - 0.5, (v + 0.5) / n - 0.5); what is seen and with what share stays that of the full picture.

One n per virtual camera and source, from the calibration alone: it does not change while the car moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.poses import transform
from unidrive_cli.warp.pictures import Picture
from unidrive_cli.warp.remap import Source, VirtualView

MAX_REDUCTION = 64
"""Largest n; the means of larger blocks would not be exact in the kernel's arithmetic."""

_ROUNDING = 1e-6
_NODES = (32, 24)
_STEPS_PX = np.array([[-0.5, 0], [0.5, 0], [0, -0.5], [0, 0.5]])


class Reductions:
    """The reductions of all sources in all virtual cameras; those of the last calibrations are kept."""

    def __init__(self, views: Sequence[VirtualView], *, anti_alias: bool) -> None:
        """
        Args:
            anti_alias: False reduces nothing.
        """
        self._anti_alias = anti_alias
        self._nodes = [_node_points(view) for view in views] if anti_alias else []
        self._views = len(views)
        self._known: tuple[object, list[tuple[int, ...]]] | None = None

    def of(self, sources: Sequence[Source]) -> list[tuple[int, ...]]:
        """For each virtual camera the n of each source; 1 is the full picture."""
        if not self._anti_alias:
            return [(1,) * len(sources)] * self._views
        key = tuple((source.lens, source.calibrated.tobytes()) for source in sources)
        known = self._known
        if known is not None and known[0] == key:
            return known[1]
        found = [tuple(reduction_of(_shrinkage(nodes, source)) for source in sources) for nodes in self._nodes]
        self._known = key, found
        return found


class Copies:
    """The source pictures of a frame, and reduced copies of them, each made when it is first asked for."""

    def __init__(self, pictures: Sequence[Picture]) -> None:
        self._pictures = pictures
        self._reduced: dict[tuple[int, int], Picture] = {}

    def of(self, source: int, n: int) -> Picture:
        """The picture (H, W, 3) of a source, or its copy (H / n, W / n, 3), rounded up."""
        if n == 1:
            return self._pictures[source]
        if (source, n) not in self._reduced:
            self._reduced[source, n] = reduced_picture(self._pictures[source], n)
        return self._reduced[source, n]


def shrinkage(view: VirtualView, source: Source) -> float:
    """How many source pixels lie along a virtual one, from the calibration; 1 where the source shows nothing of it.

    The median, over a grid of the pixels that the source sees, of the square root of the area in the source of
    one virtual pixel on the assumed scene.
    """
    return _shrinkage(_node_points(view), source)


def reduction_of(shrinkage: float) -> int:
    """The n whose copy is shrunk (or enlarged) least: 1 up to a shrinkage of 1.5, 2 up to 2.5, and so on."""
    return int(np.clip(np.ceil(shrinkage - 0.5 - _ROUNDING), 1, MAX_REDUCTION))


def reduced_picture(picture: Picture, n: int) -> Picture:
    """The copy (H / n, W / n, 3), rounded up, of a picture (H, W, 3); its last row and column go on beyond it."""
    height, width = picture.shape[:2]
    more = -height % n, -width % n
    if any(more):
        picture = np.asarray(cv2.copyMakeBorder(picture, 0, more[0], 0, more[1], cv2.BORDER_REPLICATE), np.uint8)
    size = picture.shape[1] // n, picture.shape[0] // n
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _node_points(view: VirtualView) -> Float:
    """(nodes, 4, 3) ego frame, metres: scene points half a pixel to the left, right, top and bottom of a grid."""
    lens = view.camera.lens
    columns, rows = (
        (np.arange(count) + 0.5) * side / count - 0.5
        for count, side in zip(_NODES, (lens.width_px, lens.height_px), strict=True)
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 1, 2) + _STEPS_PX
    rays_ego = lens.unproject(pixels) @ view.camera.ego_from_cam[:3, :3].T
    return view.half_ball.surface_points(view.camera.centre_ego, rays_ego)


def _shrinkage(points_ego: Float, source: Source) -> float:
    pixels, seen = source.lens.project(transform(source.calibrated, points_ego))
    pixels = pixels[seen.all(axis=1)]
    if not len(pixels):
        return 1.0
    along, down = pixels[:, 1] - pixels[:, 0], pixels[:, 3] - pixels[:, 2]
    areas = np.abs(along[:, 0] * down[:, 1] - along[:, 1] * down[:, 0])
    return float(np.median(np.sqrt(areas)))
