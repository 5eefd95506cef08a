"""Exposure: a gain for each source, so that neighbours are equally bright where they show the same.

Cameras choose their exposure by themselves, and where two meet a step in brightness shows. The mean luma of each
pair of sources over the scene points that both see gives a ratio; the gains are the least squares of its logarithm
over all pairs, each counted by its points, and of their own logarithms: pictures that differ much stay a little
different instead of turning white or black, and what is common to all sources stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.poses import transform
from unidrive_cli.warp.own_car import hidden_of
from unidrive_cli.warp.pictures import Picture
from unidrive_cli.warp.remap import Source, VirtualView

Luma = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.intp]

GAIN_RANGE = (0.5, 2.0)
STEPS = 1024
"""Gains are whole numbers of 1 / STEPS: what processors differ by is rounded away."""

_NODES = (200, 112)
_LEAST_POINTS = 64
_USABLE_LUMA = (6, 249)
_UNITY = 0.3


@dataclass(frozen=True, eq=False)
class _Overlap:
    """Scene points that two sources see.

    Attributes:
        sources: their indices.
        places: for each the rows and columns of its pixels, (2, n).
    """

    sources: tuple[int, int]
    places: tuple[Indices, Indices]


class Exposure:
    """The gains of sources; the places in their pictures that are compared are kept while calibrations stay."""

    def __init__(self, views: Sequence[VirtualView]) -> None:
        self._points_ego = np.concatenate([_grid_points(view) for view in views])
        self._known: tuple[object, list[_Overlap]] | None = None

    def gains(self, sources: Sequence[Source], lumas: Sequence[Luma]) -> Float:
        """(n,) a gain for each source, within GAIN_RANGE; 1 for sources that overlap with no other.

        Args:
            lumas: planes that begin with the luma (height, width) of each picture.
        """
        system, target = np.zeros((len(sources), len(sources))), np.zeros(len(sources))
        for overlap in self._overlaps(sources):
            one, other = (
                lumas[source][tuple(places)] for source, places in zip(overlap.sources, overlap.places, strict=True)
            )
            low, high = _USABLE_LUMA
            usable = (np.minimum(one, other) >= low) & (np.maximum(one, other) <= high)
            points = np.count_nonzero(usable)
            if points < _LEAST_POINTS:
                continue
            ratio = np.log(one[usable].sum(dtype=np.int64) / other[usable].sum(dtype=np.int64))
            i, j = overlap.sources
            for at, beside, sign in ((i, j, -1), (j, i, 1)):
                system[at, at] += points * (1 + _UNITY)
                system[at, beside] -= points
                target[at] += sign * points * ratio
        alone = np.diagonal(system) == 0
        system[alone, alone] = 1
        gains = np.exp(np.linalg.solve(system, target)).clip(*GAIN_RANGE)
        rounded: Float = np.rint(gains * STEPS) / STEPS
        return rounded

    def _overlaps(self, sources: Sequence[Source]) -> list[_Overlap]:
        key = tuple((source.lens, source.calibrated.tobytes(), source.own_car) for source in sources)
        if self._known is None or self._known[0] != key:
            self._known = key, list(_overlaps(self._points_ego, sources))
        return self._known[1]


def brighten(values: npt.NDArray[np.uint8], gain: float, zero: int = 0) -> None:
    """Multiplies what values of a picture or plane are away from `zero`, in place; they stay within 0 to 255."""
    table = np.clip(np.rint(zero + (np.arange(256) - zero) * gain), 0, 255).astype(np.uint8)
    cv2.LUT(values, table, dst=values)


def even_out(exposure: Exposure, sources: Sequence[Source], pictures: Sequence[Picture]) -> None:
    """Multiplies the colours of pictures (H, W, 3), BGR, by their gains, in place."""
    lumas = [np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8) for picture in pictures]
    for picture, gain in zip(pictures, exposure.gains(sources, lumas), strict=True):
        brighten(picture, gain)


def _grid_points(view: VirtualView) -> Float:
    """(n, 3) ego frame, metres: what a virtual camera shows on a grid."""
    lens = view.camera.lens
    columns, rows = (
        (np.arange(count) + 0.5) * side / count - 0.5
        for count, side in zip(_NODES, (lens.width_px, lens.height_px), strict=True)
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays_ego = lens.unproject(pixels) @ view.camera.ego_from_cam[:3, :3].T
    return view.half_ball.surface_points(view.camera.centre_ego, rays_ego)


def _overlaps(points_ego: Float, sources: Sequence[Source]) -> list[_Overlap]:
    seen, places = [], []
    for source in sources:
        pixels, valid = source.lens.project(transform(source.calibrated, points_ego))
        pixels = np.where(valid[:, None], pixels, 0)
        if source.own_car:
            valid = valid & ~hidden_of(source.own_car, 1.0).holds(pixels)
        last = source.lens.width_px - 1, source.lens.height_px - 1
        seen.append(valid)
        places.append(np.rint(pixels).astype(np.intp).clip(0, last).T[::-1])
    overlaps = []
    for i in range(len(sources)):
        for j in range(i + 1, len(sources)):
            both = seen[i] & seen[j]
            if np.count_nonzero(both) >= _LEAST_POINTS:
                overlaps.append(_Overlap((i, j), (places[i][:, both], places[j][:, both])))
    return overlaps
