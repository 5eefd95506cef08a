"""Annotations seen through the virtual rig: what it still shows of each box, and 2D boxes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import shapely

from unidrive_cli.geometry import boxes as box_geometry
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.geometry.poses import inverse, transform
from unidrive_cli.rig.model import Camera
from unidrive_cli.warp.remap import Source

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
    views: Sequence[tuple[Camera, npt.NDArray[np.uint8]]],
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
    points = box_geometry.grid(ego_from_box, sizes_wlh_m, _GRID)
    corners = box_geometry.corners(ego_from_box, sizes_wlh_m)
    by_sources = np.zeros(points.shape[:2], dtype=bool)
    for source in witnesses:
        ahead = _ahead(source.cam_from_ego, corners)
        if isinstance(source.lens, Pinhole):
            ahead = ahead[_may_show(source.lens, transform(source.cam_from_ego, corners[ahead]))]
        by_sources[ahead] |= source.lens.project(transform(source.cam_from_ego, points[ahead]))[1]
    by_views = np.zeros(points.shape[:2], dtype=bool)
    boxes: list[Box2d] = []
    for index, (camera, mask) in enumerate(views):
        cam_from_ego = inverse(camera.ego_from_cam)
        ahead = _ahead(cam_from_ego, corners)
        corners_cam = transform(cam_from_ego, corners[ahead])
        shows = _may_show(camera.pinhole, corners_cam)
        near = ahead[shows]
        by_views[near] |= _on_covered_pixels(camera.lens, transform(cam_from_ego, points[near]), mask)
        for place, bounds in _bounds_2d(camera, corners_cam[shows], mask):
            boxes.append(Box2d(index, int(near[place]), *(round(side, 3) for side in bounds)))
    shown_anywhere = {box.annotation for box in boxes}
    virtual, source = by_views.sum(axis=1), by_sources.sum(axis=1)
    share = np.minimum(virtual / np.maximum(source, 1), 1.0)
    shown = [
        max(round(float(share[annotation]), 4), _MIN_SHARE) if annotation in shown_anywhere else 0.0
        for annotation in range(count)
    ]
    return shown, int(np.count_nonzero(source == 0)), boxes


def _ahead(cam_from_ego: Float, corners_ego: Float) -> npt.NDArray[np.intp]:
    """Indices of the boxes (n, 8, 3) that reach at least NEAR_M in front of a camera."""
    depth = corners_ego @ cam_from_ego[2, :3] + cam_from_ego[2, 3]
    return np.flatnonzero(depth.max(axis=1) >= NEAR_M)


def _may_show(lens: Pinhole, corners_cam: Float) -> Bool:
    """(n,) False where a box (n, 8, 3) lies wholly beyond one of the four planes through the picture's borders."""
    inside: Bool = ((corners_cam @ lens.border_normals().T).max(axis=1) > 0).all(axis=1)
    return inside


def _on_covered_pixels(lens: Lens, points_cam: Float, mask: npt.NDArray[np.uint8]) -> Bool:
    pixels, inside = lens.project(points_cam)
    columns, rows = np.rint(np.where(inside[..., None], pixels, 0)).astype(np.intp).reshape(-1, 2).T
    rows, columns = np.clip(rows, 0, lens.height_px - 1), np.clip(columns, 0, lens.width_px - 1)
    covered: Bool = inside & (mask[rows, columns].reshape(inside.shape) > 0)
    return covered


def _bounds_2d(
    camera: Camera, corners_cam: Float, mask: npt.NDArray[np.uint8]
) -> Iterator[tuple[int, tuple[float, float, float, float]]]:
    """(index, (left, top, right, bottom)) of the boxes (n, 8, 3) that show on covered pixels of a picture."""
    canvas = np.array([camera.lens.width_px, camera.lens.height_px])
    whole = corners_cam[..., 2].min(axis=1) >= NEAR_M
    pixels = _pixels(camera, np.where(whole[:, None, None], corners_cam, 1.0))
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    beside = (high <= 0).any(axis=1) | (low >= canvas).any(axis=1)
    inside = (low >= 0).all(axis=1) & (high <= canvas).all(axis=1)
    for index in np.flatnonzero(~(whole & beside)):
        if whole[index] and inside[index] and _is_full(_covered(mask, low[index], high[index])):
            yield int(index), (*low[index].tolist(), *high[index].tolist())
            continue
        points = pixels[index]
        if not whole[index]:
            points = _pixels(camera, box_geometry.clipped_outline(corners_cam[index], NEAR_M))
        outline = shapely.convex_hull(shapely.multipoints(points))
        outline = shapely.clip_by_rect(outline, 0, 0, *canvas)
        if isinstance(outline, shapely.Polygon) and not outline.is_empty and _touches(mask, outline):
            yield int(index), outline.bounds


def _pixels(camera: Camera, points_cam: Float) -> Float:
    """Pixels (..., 2) of points (..., 3) in front of a virtual camera, also beside its picture."""
    lens = camera.pinhole
    pixels: Float = points_cam[..., :2] / points_cam[..., 2:]
    return pixels * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px]


def _covered(mask: npt.NDArray[np.uint8], low: Float, high: Float) -> npt.NDArray[np.uint8]:
    """The part of a mask that holds the pixels from `low` to `high`, (2,) each."""
    (left, top), (right, bottom) = low.astype(int), high.astype(int)
    return mask[top : bottom + 1, left : right + 1]


def _is_full(mask: npt.NDArray[np.uint8]) -> bool:
    return cv2.countNonZero(mask) == mask.size


def _touches(mask: npt.NDArray[np.uint8], outline: shapely.Polygon) -> bool:
    """Whether an outline inside the picture holds a pixel of a mask."""
    low, high = np.array(outline.bounds).reshape(2, 2)
    part = _covered(mask, low, high)
    count = cv2.countNonZero(part)
    if count in (0, part.size):
        return count > 0
    inside = np.zeros(part.shape, dtype=np.uint8)
    polygon = np.rint(shapely.get_coordinates(outline) - low.astype(int)).astype(np.int32)
    cv2.fillConvexPoly(inside, polygon, (1,))
    return bool((inside & part).any())
