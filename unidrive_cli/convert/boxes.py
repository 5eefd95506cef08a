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
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import inverse, transform
from unidrive_cli.rig.model import Camera

NEAR_M = 0.1
_GRID = box_geometry.volume_grid(5)
_MIN_SHARE = 1e-3


class Box2d(msgspec.Struct, frozen=True, array_like=True):
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
    sources: Sequence[tuple[Lens, Float]],
    views: Sequence[tuple[Camera, npt.NDArray[np.uint8]]],
) -> tuple[list[float], list[Box2d]]:
    """What the virtual rig shows of each box, beside what the source cameras saw.

    The shares are of a box's volume, on a regular grid of 125 points; occlusion is not known here.

    Args:
        ego_from_box: (n, 4, 4) box poses in the reference ego frame.
        sizes_wlh_m: (n, 3).
        sources: lens and `cam_from_ego` of each source picture.
        views: virtual cameras with their coverage masks.

    Returns:
        Per box, (seen by the virtual rig) / (seen by the sources), at most 1, and 0 only where no
        covered virtual pixel shows the box; and the 2D boxes on covered pixels.
    """
    count = len(sizes_wlh_m)
    if not count:
        return [], []
    points = box_geometry.grid(ego_from_box, sizes_wlh_m, _GRID)
    corners = box_geometry.corners(ego_from_box, sizes_wlh_m)
    by_sources = np.zeros(points.shape[:2], dtype=bool)
    for lens, cam_from_ego in sources:
        by_sources |= lens.project(transform(cam_from_ego, points))[1]
    by_views = np.zeros(points.shape[:2], dtype=bool)
    boxes: list[Box2d] = []
    for index, (camera, mask) in enumerate(views):
        cam_from_ego = inverse(camera.ego_from_cam)
        by_views |= _on_covered_pixels(camera.lens, transform(cam_from_ego, points), mask)
        for annotation, bounds in _bounds_2d(camera, transform(cam_from_ego, corners), mask):
            boxes.append(Box2d(index, annotation, *(round(side, 3) for side in bounds)))
    shown_anywhere = {box.annotation for box in boxes}
    virtual, source = by_views.sum(axis=1), by_sources.sum(axis=1)
    share = np.minimum(virtual / np.maximum(source, 1), 1.0)
    shown = [
        max(round(float(share[annotation]), 4), _MIN_SHARE) if annotation in shown_anywhere else 0.0
        for annotation in range(count)
    ]
    return shown, boxes


def _on_covered_pixels(lens: Lens, points_cam: Float, mask: npt.NDArray[np.uint8]) -> Bool:
    pixels, inside = lens.project(points_cam)
    columns, rows = np.rint(np.where(inside[..., None], pixels, 0)).astype(np.intp).reshape(-1, 2).T
    rows, columns = np.clip(rows, 0, lens.height_px - 1), np.clip(columns, 0, lens.width_px - 1)
    covered: Bool = inside & (mask[rows, columns].reshape(inside.shape) > 0)
    return covered


def _bounds_2d(
    camera: Camera, corners_cam: Float, mask: npt.NDArray[np.uint8]
) -> Iterator[tuple[int, tuple[float, float, float, float]]]:
    """(index, left, top, right, bottom) of the boxes (n, 8, 3) that show on covered pixels of a picture."""
    lens = camera.lens
    canvas = np.array([lens.width_px, lens.height_px])
    depth = corners_cam[..., 2]
    for index in np.flatnonzero(depth.max(axis=1) >= NEAR_M):
        whole = depth[index].min() >= NEAR_M
        points = corners_cam[index] if whole else box_geometry.clipped_outline(corners_cam[index], NEAR_M)
        pixels = points[:, :2] / points[:, 2:] * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px]
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        if (high <= 0).any() or (low >= canvas).any():
            continue
        outline = shapely.convex_hull(shapely.multipoints(pixels))
        if (low < 0).any() or (high > canvas).any():
            outline = shapely.intersection(outline, shapely.box(0, 0, *canvas))
        if not isinstance(outline, shapely.Polygon) or outline.is_empty:
            continue
        left, top, right, bottom = outline.bounds
        if _touches(mask, outline):
            yield int(index), (left, top, right, bottom)


def _touches(mask: npt.NDArray[np.uint8], outline: shapely.Polygon) -> bool:
    left, top, right, bottom = (int(side) for side in outline.bounds)
    part = mask[top : bottom + 1, left : right + 1]
    if part.all() or not part.any():
        return bool(part.any())
    inside = np.zeros(part.shape, dtype=np.uint8)
    polygon = np.rint(shapely.get_coordinates(outline) - [left, top]).astype(np.int32)
    cv2.fillConvexPoly(inside, polygon, (1,))
    return bool((inside & part).any())
