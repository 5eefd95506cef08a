"""Anti-aliasing: how many times a virtual camera shrinks a source, and which reduced copy it samples therefore.

Where a source pixel is much smaller than a virtual one, a bilinear sample sees four of the many that fall into it,
and fine structure turns into noise that flickers. Such a source is sampled from a copy that is n times smaller,
each of its pixels the mean of n x n. A copy is one more picture whose pixels are
((u + 0.5) / n - 0.5, (v + 0.5) / n - 0.5); what is seen and with what share stays that of the full picture.

The bilinear sample of a copy is a mean itself, with the spread (variance) n^2 / 4 along each axis of the picture; a
virtual pixel that is s source pixels wide has s^2 / 12. They are equal for n = s / sqrt(3): a copy as small as s
would be blurred, and is farther from the truth than no copy (docs/fidelity.md).

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

STEPS = 4
"""n is a whole number of quarters: copies for several virtual cameras are often the same one."""
MAX_REDUCTION = 64.0
"""Largest n: the sums of larger squares do not fit the kernel's numbers."""

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
        self._known: tuple[object, list[tuple[float, ...]]] | None = None

    def of(self, sources: Sequence[Source]) -> list[tuple[float, ...]]:
        """For each virtual camera the n of each source; 1 is the full picture."""
        if not self._anti_alias:
            return [(1.0,) * len(sources)] * self._views
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
        self._reduced: dict[tuple[int, float], Picture] = {}

    def of(self, source: int, n: float) -> Picture:
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


def reduction_of(shrinkage: float) -> float:
    """The n of the copy whose bilinear samples spread as far as virtual pixels; 1, the picture, up to 1.95."""
    n = np.floor(shrinkage / np.sqrt(3) * STEPS + 0.5) / STEPS
    return float(np.clip(n, 1, MAX_REDUCTION))


def reduced_size(size_px: int, n: float) -> int:
    """Pixels of a copy along a side of that many: the last may reach beyond it."""
    return int(np.ceil(size_px / n))


def reduced_picture(picture: Picture, n: float) -> Picture:
    """The copy (H / n, W / n, 3), rounded up, of a picture (H, W, 3); its last row and column go on beyond it."""
    sides = [reduced_size(side, n) for side in picture.shape[:2]]
    more = [int(np.ceil(copy * n)) - side for copy, side in zip(sides, picture.shape[:2], strict=True)]
    grown = cv2.copyMakeBorder(picture, 0, more[0], 0, more[1], cv2.BORDER_REPLICATE)
    reduced = cv2.resize(grown, None, fx=1 / n, fy=1 / n, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(reduced[: sides[0], : sides[1]], dtype=np.uint8)


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
