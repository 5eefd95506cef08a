"""Annotations seen through the virtual rig: what it still shows of each box, and 2D boxes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import shapely

from unidrive_cli.geometry import boxes as box_geometry
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse, transform
from unidrive_cli.geometry.sights import Sights
from unidrive_cli.rig.model import Camera
from unidrive_cli.warp.remap import Mask, Source

NEAR_M = 0.1
_GRID = box_geometry.volume_grid(5)
_MIN_SHARE = 1e-3


class Box2d(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """The part of a box inside a virtual picture: indices of camera and annotation, then pixels."""

    camera: int
    annotation: int
    left: float
    top: float
    right: float
    bottom: float


def seen_boxes(
    ego_from_box: Float,
    sizes_wlh_m: Float,
    witnesses: Sequence[Source],
    views: Sequence[tuple[Camera, Mask]],
) -> tuple[list[float], int, list[Box2d]]:
    """What the virtual rig shows of each box, beside what the real cameras saw.

    The shares are of a box's volume, on a regular grid of 125 points; occlusion is not known here.

    Args:
        ego_from_box: (n, 4, 4) box poses in the reference ego frame.
        sizes_wlh_m: (n, 3).
        witnesses: the real cameras that took a picture.
        views: virtual cameras with their coverage masks.

    Returns:
        Per box, (seen by the virtual rig) / (seen by the real cameras), at most 1, and 0 only where no
        covered virtual pixel shows the box; how many boxes no real camera saw; and the 2D boxes on
        covered pixels.
    """
    count = len(sizes_wlh_m)
    if not count:
        return [], 0, []
    by_sources, by_views = np.zeros((2, count, len(_GRID)), dtype=bool)
    pinholes = [(source.lens, source.cam_from_ego) for source in witnesses if isinstance(source.lens, Pinhole)]
    real = len(pinholes)
    pinholes += [(camera.pinhole, inverse(camera.ego_from_cam)) for camera, _ in views]
    sights = Sights(pinholes, ego_from_box, sizes_wlh_m, NEAR_M)
    bounds, shows, full = _bounds_2d(sights, real, views)
    seen = np.ones((len(sights.box), len(_GRID)), dtype=bool)
    unknown = np.flatnonzero(~(sights.whole & full))
    pixels, seen[unknown] = sights.project(unknown, _GRID)
    for index in range(len(pinholes)):
        pairs = sights.of_camera(index)
        if index < real:
            by_sources[sights.box[pairs]] |= seen[pairs]
        else:
            start, end = np.searchsorted(unknown, [pairs.start, pairs.stop])
            seen[unknown[start:end]] &= _covered_at(views[index - real][1], pixels[:, start:end])
            by_views[sights.box[pairs]] |= seen[pairs]
    for source in witnesses:
        if not isinstance(source.lens, Pinhole):
            depth_m = transform(source.cam_from_ego, box_geometry.corners(ego_from_box, sizes_wlh_m))[..., 2]
            ahead = np.flatnonzero(depth_m.max(axis=1) >= NEAR_M)
            points = box_geometry.grid(source.cam_from_ego @ ego_from_box[ahead], sizes_wlh_m[ahead], _GRID)
            by_sources[ahead] |= source.lens.project(points)[1]
    boxes = [
        Box2d(camera - real, annotation, *(round(side, 3) for side in sides))
        for camera, annotation, sides in zip(
            sights.camera[shows].tolist(), sights.box[shows].tolist(), bounds[shows].tolist(), strict=True
        )
    ]
    shown_anywhere = {box.annotation for box in boxes}
    virtual, witnessed = by_views.sum(axis=1), by_sources.sum(axis=1)
    share = np.minimum(virtual / np.maximum(witnessed, 1), 1.0).tolist()
    shown = [
        max(round(share[annotation], 4), _MIN_SHARE) if annotation in shown_anywhere else 0.0
        for annotation in range(count)
    ]
    return shown, int(np.count_nonzero(witnessed == 0)), boxes


def _covered_at(mask: Mask, pixels: Float) -> Bool:
    """Whether a mask holds the pixels next to (2, ...); those beside the picture count as its border."""
    height_px, width_px = mask.shape
    columns, rows = np.rint(pixels).clip(0, [[[width_px - 1]], [[height_px - 1]]]).astype(np.intp)
    covered: Bool = mask[rows, columns] > 0
    return covered


def _bounds_2d(sights: Sights, first: int, views: Sequence[tuple[Camera, Mask]]) -> tuple[Float, Bool, Bool]:
    """Where boxes are in the pictures of the cameras from `first` on.

    Returns:
        (p, 4) left, top, right, bottom; (p,) whether the box shows on covered pixels; and (p,) whether it is
        another camera's, or lies within the picture with all pixels round it covered.
    """
    whole = sights.corners[..., 2].min(axis=1) >= NEAR_M
    pixels = _pixels(np.where(whole[:, None, None], sights.corners, 1.0))
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    bounds = np.concatenate([low, high], axis=1)
    shows, full = np.zeros(len(bounds), dtype=bool), np.ones(len(bounds), dtype=bool)
    cut_by_canvas: dict[tuple[int, int], list[npt.NDArray[np.intp]]] = {}
    for index, (camera, mask) in enumerate(views):
        canvas = camera.lens.width_px, camera.lens.height_px
        pairs = sights.of_camera(first + index)
        within = whole[pairs] & ((low[pairs] >= 0) & (high[pairs] <= canvas)).all(axis=1)
        within[within] = [_is_full(_covered(mask, *sides)) for sides in bounds[pairs][within].tolist()]
        shows[pairs] = full[pairs] = within
        beside = whole[pairs] & ((high[pairs] <= 0) | (low[pairs] >= canvas)).any(axis=1)
        cut_by_canvas.setdefault(canvas, []).append(pairs.start + np.flatnonzero(~(within | beside)))
    for canvas, cuts in cut_by_canvas.items():
        cut = np.concatenate(cuts)
        if not len(cut):
            continue
        outlines = [
            pixels[pair] if whole[pair] else _pixels(box_geometry.clipped_outline(sights.corners[pair], NEAR_M))
            for pair in cut
        ]
        owners = np.repeat(np.arange(len(cut)), [len(outline) for outline in outlines])
        hulls = shapely.convex_hull(shapely.multipoints(np.concatenate(outlines), indices=owners))
        parts = shapely.clip_by_rect(hulls, 0, 0, *canvas)
        bounds[cut] = shapely.bounds(parts)
        areas = (shapely.get_type_id(parts) == shapely.GeometryType.POLYGON) & ~shapely.is_empty(parts)
        for pair, part in zip(cut[areas], parts[areas], strict=True):
            shows[pair] = _touches(views[sights.camera[pair] - first][1], part, bounds[pair])
    return bounds, shows, full


def _pixels(homogeneous: Float) -> Float:
    """Pixels (..., 2) of u z, v z, z (..., 3) with z > 0."""
    pixels: Float = homogeneous[..., :2] / homogeneous[..., 2:]
    return pixels


def _covered(mask: Mask, left: float, top: float, right: float, bottom: float) -> Mask:
    """The part of a mask that holds every pixel of a box within the picture, whether cut or rounded to one."""
    return mask[int(top) : round(bottom) + 1, int(left) : round(right) + 1]


def _is_full(mask: Mask) -> bool:
    return cv2.countNonZero(mask) == mask.size


def _touches(mask: Mask, outline: shapely.Polygon, bounds: Float) -> bool:
    """Whether an outline inside the picture holds a pixel of a mask."""
    left, top, right, bottom = bounds.astype(int)
    part = mask[top : bottom + 1, left : right + 1]
    count = cv2.countNonZero(part)
    if count in (0, part.size):
        return count > 0
    inside = np.zeros(part.shape, dtype=np.uint8)
    cv2.fillConvexPoly(inside, np.rint(shapely.get_coordinates(outline) - [left, top]).astype(np.int32), (1,))
    return bool((inside & part).any())
