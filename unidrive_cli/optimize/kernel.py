"""The objective's inner loops for pinhole sources (numba): what `geometry.projection_error` says, point by point.

Everything is worked out in the virtual camera's frame, where the half-ball's centre is the origin: a source at c
that sees a corner P has the ray c + t (P - c), and the scene point is where it leaves the ball or meets the
ground first. No array is made, so an evaluation costs no memory.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from unidrive_cli.warp.compiled import can_cache

Array = npt.NDArray[Any]


_OPTIONS: dict[str, Any] = {"cache": can_cache(), "error_model": "numpy", "nogil": True}

FX, FY, CX, CY, WIDTH, HEIGHT = range(6)
"""Columns of a lens."""
ERROR, UNCOVERED, PAIR_SUM, PAIRS, BEHIND = range(5)
"""Entries of what `corner_errors` gives."""
SUMS = 5


@njit(inline="always", **_OPTIONS)
def _moved(pose, x, y, z):
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@njit(inline="always", **_OPTIONS)
def _sees(lens, x, y, z, tolerance):
    """Whether a pinhole has a point of its frame in its picture, without a division."""
    if z <= 0.0:
        return False
    u, v = lens[FX] * x + lens[CX] * z, lens[FY] * y + lens[CY] * z
    low = -(0.5 + tolerance) * z
    return (
        u >= low
        and v >= low
        and u <= (lens[WIDTH] - 0.5 + tolerance) * z
        and v <= (lens[HEIGHT] - 0.5 + tolerance) * z
    )


@njit(inline="always", **_OPTIONS)
def _exit(cx, cy, cz, qx, qy, qz, ground, radius):
    """t at which c + t q, with c inside, leaves the half-ball round the origin; the ball only where it must be."""
    descent = -(ground[0] * qx + ground[1] * qy + ground[2] * qz)
    t = np.inf
    if descent > 0.0:
        t = (ground[3] + ground[0] * cx + ground[1] * cy + ground[2] * cz) / descent
        x, y, z = cx + t * qx, cy + t * qy, cz + t * qz
        if x * x + y * y + z * z <= radius * radius:
            return t
    a = qx * qx + qy * qy + qz * qz
    half_b = cx * qx + cy * qy + cz * qz
    c = cx * cx + cy * cy + cz * cz - radius * radius
    return min(t, (-half_b + math.sqrt(max(half_b * half_b - a * c, 0.0))) / a)


@njit(inline="always", **_OPTIONS)
def _weight(pose, normals, x, y, z, cx, cy, cz, border_floor, parallax_floor):
    """Blending weight of a source at the point (x, y, z) of the virtual camera's frame; c is the source's centre."""
    sx, sy, sz = _moved(pose, x, y, z)
    border = np.inf
    for side in range(4):
        border = min(border, normals[side, 0] * sx + normals[side, 1] * sy + normals[side, 2] * sz)
    to_source = math.sqrt(sx * sx + sy * sy + sz * sz)
    to_virtual = math.sqrt(x * x + y * y + z * z)
    border = max(border / to_source, border_floor)
    cosine = ((x - cx) * x + (y - cy) * y + (z - cz) * z) / (to_source * to_virtual)
    parallax = math.sqrt(max(2.0 - 2.0 * cosine, 0.0)) + parallax_floor
    return (border * border) * (border * border) / (parallax * parallax)


@njit(inline="always", **_OPTIONS)
def _sum_of_angles(up, along, other_up, other_along):
    """The sum of two angles in [0, pi], each given by its sine and cosine up to a positive factor."""
    sine = up * other_along + other_up * along
    cosine = along * other_along - up * other_up
    if 0.0 <= sine < 0.1 * cosine:
        ratio = sine / cosine
        square = ratio * ratio
        tail = 1 / 7 - square * (1 / 9 - square * (1 / 11 - square * (1 / 13 - square / 15)))
        return ratio - ratio * square * (1 / 3 - square * (1 / 5 - square * tail))
    angle = math.atan2(sine, cosine)
    return angle if angle >= 0.0 else angle + 2 * math.pi


@njit(**_OPTIONS)
def corner_errors(
    boxes,
    corners,
    seen_by,
    source_from_view,
    source_centre_view,
    source_lens,
    source_normals,
    view_from_ego,
    view_lens,
    view_normals,
    grounds,
    radius,
    constants,
):
    """Sums over the corners that sources of one rig see; float64 throughout, indices as in ERROR.

    Args:
        boxes: (b, 4) centre and half diagonal of each box, ego frame, metres.
        corners: (8 b, 3) in the same order.
        seen_by: (8 b,) uint64, a bit for each source that sees the corner.
        source_from_view: (K, J, 3, 4) from each virtual camera's frame into each source's.
        source_centre_view: (K, J, 3) the sources' centres in the virtual cameras' frames.
        source_lens, source_normals: (J, 6), and (J, 4, 3) unit normals of the border planes.
        view_from_ego, view_lens, view_normals: (K, 3, 4), (K, 6), (K, 4, 3).
        grounds: (K, 4) the ground's normal in the virtual camera's frame, and the camera's height above it.
        radius: D0.
        constants: pixel tolerance, border floor, parallax floor.

    Returns:
        (5,) sum over the corners of the blended error, averaged over the virtual cameras that see the corner,
        in metre-radians; corners that none sees; sum and number of all (corner, source, virtual) triples; and
        triples that were left out, because the warped point is behind the virtual camera.
    """
    sums = np.zeros(SUMS)
    views, sources = view_from_ego.shape[0], source_lens.shape[0]
    near = np.empty(views, dtype=np.int64)
    tolerance, border_floor, parallax_floor = constants
    for box in range(boxes.shape[0]):
        near_count = 0
        for view in range(views):
            x, y, z = _moved(view_from_ego[view], boxes[box, 0], boxes[box, 1], boxes[box, 2])
            margin = -boxes[box, 3] - 1e-3
            normals = view_normals[view]
            nearest = np.inf
            for side in range(4):
                nearest = min(nearest, normals[side, 0] * x + normals[side, 1] * y + normals[side, 2] * z)
            if nearest >= margin:
                near[near_count] = view
                near_count += 1
        for corner in range(8 * box, 8 * box + 8):
            bits = seen_by[corner]
            if bits == 0:
                continue
            several = bits & (bits - np.uint64(1)) != 0
            error, shown = 0.0, 0
            for place in range(near_count):
                view = near[place]
                px, py, pz = _moved(view_from_ego[view], corners[corner, 0], corners[corner, 1], corners[corner, 2])
                if not _sees(view_lens[view], px, py, pz, tolerance):
                    continue
                distance = math.sqrt(px * px + py * py + pz * pz)
                weighted, total = 0.0, 0.0
                for source in range(sources):
                    if (bits >> np.uint64(source)) & np.uint64(1) == 0:
                        continue
                    cx, cy, cz = source_centre_view[view, source]
                    qx, qy, qz = px - cx, py - cy, pz - cz
                    t = _exit(cx, cy, cz, qx, qy, qz, grounds[view], radius)
                    x, y, z = cx + t * qx, cy + t * qy, cz + t * qz
                    if z <= 0.0:
                        sums[BEHIND] += 1.0
                        continue
                    depths = z * pz
                    angles = _sum_of_angles(
                        abs(x * pz - px * z), depths + x * px, abs(y * pz - py * z), depths + y * py
                    )
                    sums[PAIR_SUM] += distance * angles
                    sums[PAIRS] += 1.0
                    share = 1.0
                    if several:
                        weights = 0.0
                        for other in range(sources):
                            pose = source_from_view[view, other]
                            if other != source:
                                ox, oy, oz = _moved(pose, x, y, z)
                                if not _sees(source_lens[other], ox, oy, oz, tolerance):
                                    continue
                            weight = _weight(
                                pose,
                                source_normals[other],
                                x,
                                y,
                                z,
                                source_centre_view[view, other, 0],
                                source_centre_view[view, other, 1],
                                source_centre_view[view, other, 2],
                                border_floor,
                                parallax_floor,
                            )
                            weights += weight
                            if other == source:
                                share = weight
                        share /= weights
                    weighted += share * distance * angles
                    total += share
                if total > 0.0:
                    error += weighted / total
                    shown += 1
            if shown > 0:
                sums[ERROR] += error / shown
            else:
                sums[UNCOVERED] += 1.0
    return sums


@njit(**_OPTIONS)
def filled(columns, rows, source_from_view, source_lens, rig_of_source, rigs, view_lens, grounds, radius, tolerance):
    """Which places of the virtual pictures each rig fills.

    Args:
        columns, rows: places per picture; they stand in the middle of that many equal parts.
        source_from_view, source_lens: (K, J, 3, 4) and (J, 6) of all rigs' sources, one rig after the other.
        rig_of_source: (J,) int64, ascending.
        rigs: their number.
        view_lens, grounds, radius, tolerance: as for `corner_errors`.

    Returns:
        (K, rigs + 1) float64 shares of the places of each virtual camera; the last column is what all rigs fill.
    """
    views = view_lens.shape[0]
    counts = np.zeros((views, rigs + 1))
    for view in range(views):
        lens, ground = view_lens[view], grounds[view]
        for row in range(rows):
            qy = ((row + 0.5) * lens[HEIGHT] / rows - 0.5 - lens[CY]) / lens[FY]
            for column in range(columns):
                qx = ((column + 0.5) * lens[WIDTH] / columns - 0.5 - lens[CX]) / lens[FX]
                t = _exit(0.0, 0.0, 0.0, qx, qy, 1.0, ground, radius)
                seen_by, rig_before = 0, -1
                for source in range(rig_of_source.shape[0]):
                    rig = rig_of_source[source]
                    if rig == rig_before:
                        continue
                    x, y, z = _moved(source_from_view[view, source], t * qx, t * qy, t)
                    if _sees(source_lens[source], x, y, z, tolerance):
                        counts[view, rig] += 1.0
                        seen_by += 1
                        rig_before = rig
                if seen_by == rigs:
                    counts[view, rigs] += 1.0
    return counts / (columns * rows)
