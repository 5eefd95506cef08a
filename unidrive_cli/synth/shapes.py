"""Building blocks of the actors' meshes: lofts, tubes, wheels, and patches stuck onto a surface.

All in metres, x forward, y left, z up. A `Solid` is bare geometry; `painted` makes a `Mesh` of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.textures import layer

Side = Literal["front", "rear", "left", "right", "top"]
Ints = npt.NDArray[np.int32]

RUBBER = (0.018, 0.018, 0.019)
BLACK = (0.012, 0.012, 0.013)
DARK_PLASTIC = (0.03, 0.03, 0.032)
GLASS = (0.010, 0.013, 0.016)
CHROME = (0.45, 0.45, 0.46)
STEEL = (0.22, 0.22, 0.23)
LAMP_WHITE = (0.80, 0.82, 0.85)
LAMP_RED = (0.45, 0.008, 0.012)
LAMP_AMBER = (0.70, 0.22, 0.01)
PLATE = (0.72, 0.72, 0.68)

GLASS_GLOSS = 0.2
PAINT_GLOSS = 0.11


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface: (v, 3) positions and (t, 3) triangles, counter-clockwise seen from outside."""

    positions_m: Float
    triangles: Ints


def solid(positions_m: Any, triangles: Any) -> Solid:
    """A solid, turned inside out where its signed volume says that its triangles run the wrong way."""
    positions = np.asarray(positions_m, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
    first, second, third = (positions[faces[:, corner]] - positions.mean(axis=0) for corner in range(3))
    if float(np.sum(first * np.cross(second, third))) < 0:
        faces = faces[:, ::-1]
    return Solid(positions, faces)


def loft(sections_m: Any, *, tip_m: float = 0.0) -> Solid:
    """A skin over closed rings, (n rings, m points, 3), with a fan over either end.

    Args:
        tip_m: how far the middle of each end stands out, for round ends.
    """
    sections = np.asarray(sections_m, dtype=np.float64)
    rings, points = sections.shape[:2]
    ends = sections[[0, -1]].mean(axis=1)
    if tip_m:
        beyond = ends - sections[[1, -2]].mean(axis=1)
        ends = ends + tip_m * beyond / np.maximum(np.linalg.norm(beyond, axis=1, keepdims=True), 1e-9)
    start, end = rings * points, rings * points + 1
    around = np.arange(points)
    after = (around + 1) % points
    faces = [*_quads(rings, points, wrap=True)]
    last = (rings - 1) * points
    faces.append(np.stack([np.full(points, start), after, around], axis=1))
    faces.append(np.stack([np.full(points, end), last + around, last + after], axis=1))
    return solid(np.concatenate([sections.reshape(-1, 3), ends]), np.concatenate(faces))


def _quads(rows: int, columns: int, *, wrap: bool) -> list[Ints]:
    """Triangles of a grid of vertices: first all lower halves, then all upper, row by row."""
    across = np.arange(columns if wrap else columns - 1)
    down = np.arange(rows - 1)[:, None] * columns
    right = (across + 1) % columns
    a, b, c, d = down + across, down + right, down + columns + right, down + columns + across
    low, high = np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)
    return [low.reshape(-1, 3).astype(np.int32), high.reshape(-1, 3).astype(np.int32)]


def tube(path_m: Any, radii_m: Any, sides: int, *, side: Any = (0, 1, 0), tip: float = 0.0) -> Solid:
    """A tube along a path.

    Args:
        path_m: (n, 3).
        radii_m: one number, (n,), or (n, 2): along `side` and across it.
        sides: points per ring.
        side: direction, not along the path, that the first of the two radii is measured along.
        tip: how far the ends bulge, in radii.
    """
    path = np.asarray(path_m, dtype=np.float64)
    radii = np.asarray(radii_m, dtype=np.float64)
    if radii.ndim < 2:
        radii = np.repeat(np.broadcast_to(radii, len(path))[:, None], 2, axis=1)
    along = unit(np.gradient(path, axis=0))
    first = np.asarray(side, dtype=np.float64)
    first = unit(first - (along @ first)[:, None] * along)
    second = np.cross(along, first)
    angles = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    spokes = (
        np.cos(angles)[:, None, None] * first * radii[:, :1] + np.sin(angles)[:, None, None] * second * radii[:, 1:]
    )
    return loft(path[:, None] + spokes.transpose(1, 0, 2), tip_m=tip * float(radii[0].min()))


def rod(start_m: Any, end_m: Any, radius_m: float, sides: int = 6) -> Solid:
    """A straight tube between two points."""
    along = unit(np.subtract(end_m, start_m))
    side = (0, 1, 0) if abs(along[1]) < 0.7 else (0, 0, 1)
    return tube([start_m, end_m], radius_m, sides, side=side)


def ball(centre_m: Any, radii_m: Any, rings: int = 6, sides: int = 8) -> Solid:
    """An ellipsoid with its axes along x, y and z."""
    tilt = np.pi * (np.arange(1, rings) / rings)
    turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    outline = np.stack(
        [
            np.sin(tilt)[:, None] * np.cos(turn),
            np.sin(tilt)[:, None] * np.sin(turn),
            np.repeat(-np.cos(tilt)[:, None], sides, axis=1),
        ],
        axis=-1,
    )
    radii = np.broadcast_to(np.asarray(radii_m, dtype=np.float64), 3)
    poke = float(1 - np.cos(tilt[0]))
    raw = loft(outline, tip_m=poke)
    return solid(raw.positions_m * radii + np.asarray(centre_m, dtype=np.float64), raw.triangles)


def block(low_m: Any, high_m: Any, *, bevel_m: float = 0.0) -> Solid:
    """A box between two corners; with a bevel, its edges along x and those of both ends are cut round."""
    low, high = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
    centre, half = (low + high) / 2, (high - low) / 2
    if bevel_m <= 0:
        ring = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half[1:] + centre[1:]
        return loft([[(x, y, z) for y, z in ring] for x in (low[0], high[0])])
    sections = []
    for x, shrink in ((-half[0], bevel_m), (-half[0] + bevel_m, 0.0), (half[0] - bevel_m, 0.0), (half[0], bevel_m)):
        ring = rounded_rectangle(half[1] - shrink, half[2] - shrink, bevel_m)
        sections.append(np.column_stack([np.full(len(ring), x + centre[0]), ring + centre[1:]]))
    return loft(sections)


def rounded_rectangle(half_width_m: float, half_height_m: float, radius_m: float, steps: int = 1) -> Float:
    """(4 * (steps + 1), 2) outline with cut corners (round ones with more steps)."""
    radius = min(radius_m, 0.98 * half_width_m, 0.98 * half_height_m)
    angles = np.linspace(0, np.pi / 2, steps + 1)
    corner = np.stack([np.cos(angles), np.sin(angles)], axis=1) * radius
    points = []
    for turn, (sign_y, sign_z) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        c, s = np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2)
        centre = (sign_y * (half_width_m - radius), sign_z * (half_height_m - radius))
        points.append(corner @ np.array([[c, s], [-s, c]]) + centre)
    return np.concatenate(points)


def mirrored(mesh: Mesh) -> Mesh:
    """The mesh on the other side: y becomes -y."""
    flip = np.array([1, -1, 1], dtype=np.float32)
    return replace(
        mesh,
        positions_m=mesh.positions_m * flip,
        normals=mesh.normals * flip,
        triangles=np.ascontiguousarray(mesh.triangles[:, ::-1]),
    )


def unit(vectors: Any) -> Float:
    """Vectors of length 1 along the last axis."""
    array = np.asarray(vectors, dtype=np.float64)
    result: Float = array / np.maximum(np.linalg.norm(array, axis=-1, keepdims=True), 1e-12)
    return result


def curve(at: Any, knots: Sequence[tuple[float, float]]) -> Float:
    """A smooth line through knots (rising in their first number) that does not overshoot."""
    x, y = np.array(knots, dtype=np.float64).T
    steps, slopes = np.diff(x), np.diff(y) / np.diff(x)
    tangents = np.zeros(len(x))
    tangents[[0, -1]] = slopes[[0, -1]]
    same = slopes[1:] * slopes[:-1] > 0
    before, after = 2 * steps[1:] + steps[:-1], steps[1:] + 2 * steps[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (before + after) / (before / slopes[:-1] + after / slopes[1:])
    tangents[1:-1] = np.where(same, mean, 0.0)
    where = np.clip(np.asarray(at, dtype=np.float64), x[0], x[-1])
    cell = np.clip(np.searchsorted(x, where, side="right") - 1, 0, len(x) - 2)
    t, h = (where - x[cell]) / steps[cell], steps[cell]
    result: Float = (
        (1 + 2 * t) * (1 - t) ** 2 * y[cell]
        + t * (1 - t) ** 2 * h * tangents[cell]
        + t**2 * (3 - 2 * t) * y[cell + 1]
        + t**2 * (t - 1) * h * tangents[cell + 1]
    )
    return result


def painted(shape: Solid, albedo: Any, *, gloss: Any = 0.02, crease_deg: float = 40.0) -> Mesh:
    """A mesh of a solid; edges that bend by less than the crease look round.

    Args:
        shape: the geometry.
        albedo: (3,), or (t, 3): one per triangle.
        gloss: one, or (t,): one per triangle.
    """
    positions, faces = shape.positions_m, shape.triangles
    colours = np.broadcast_to(np.asarray(albedo, dtype=np.float64), (len(faces), 3))
    glosses = np.broadcast_to(np.asarray(gloss, dtype=np.float64), len(faces))
    corners = positions[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    keep = np.linalg.norm(crosses, axis=1) > 1e-9
    faces, corners, colours, glosses = faces[keep], corners[keep], colours[keep], glosses[keep]
    facing = unit(crosses[keep])
    _, welded = np.unique(np.rint(corners.reshape(-1, 3) * 1e5).astype(np.int64), axis=0, return_inverse=True)
    normals = _corner_normals(welded.ravel(), corners, facing, np.cos(np.radians(crease_deg)))
    rows = np.column_stack(
        [
            welded.ravel()[:, None],
            np.rint(normals * 2e3),
            np.rint(np.repeat(colours, 3, axis=0) * 1e5),
            np.rint(np.repeat(glosses, 3)[:, None] * 1e5),
        ]
    ).astype(np.int64)
    _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return Mesh(
        corners.reshape(-1, 3)[first].astype(np.float32),
        normals[first].astype(np.float32),
        np.zeros((len(first), 2), dtype=np.float32),
        np.repeat(colours, 3, axis=0)[first].astype(np.float32),
        np.full(len(first), layer("plain"), dtype=np.int32),
        np.repeat(glosses, 3)[first].astype(np.float32),
        index.reshape(-1, 3).astype(np.int32),
    )


def _corner_normals(vertex: Any, corners: Float, facing: Float, cos_crease: float) -> Float:
    """(3t, 3) normals: per corner, the mean of the faces at its vertex that bend less than the crease."""
    ahead, behind = unit(np.roll(corners, -1, axis=1) - corners), unit(np.roll(corners, 1, axis=1) - corners)
    weights = np.arccos(np.clip(np.sum(ahead * behind, axis=-1), -1, 1)).ravel()
    face = np.repeat(np.arange(len(corners)), 3)
    order = np.argsort(vertex, kind="stable")
    counts = np.bincount(vertex)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    mine = np.repeat(order, counts[vertex[order]])
    inside = np.arange(len(mine)) - np.repeat(
        np.cumsum(counts[vertex[order]]) - counts[vertex[order]], counts[vertex[order]]
    )
    other = order[starts[vertex[mine]] + inside]
    near = np.sum(facing[face[mine]] * facing[face[other]], axis=1) >= cos_crease - 1e-9
    mine, other = mine[near], other[near]
    pull = facing[face[other]] * weights[other][:, None]
    total = np.stack([np.bincount(mine, pull[:, axis], minlength=len(vertex)) for axis in range(3)], axis=1)
    return unit(total)


def patch(
    target: Mesh,
    side: Side,
    low: Any,
    high: Any,
    albedo: Any,
    *,
    rows: int = 2,
    gloss: float = 0.1,
    lift_m: float = 0.006,
) -> Mesh:
    """A thin piece stuck onto a surface, seen along an axis: a lamp, a window, a plate.

    Args:
        target: the surface.
        side: where it is looked at from.
        low, high: (k, 2) two edges of the piece as seen from there: (x, z) from left or right, (y, z) from front
            or rear, (x, y) from the top.
        albedo: (3,).
        rows: quads between the two edges.
        lift_m: distance from the surface.
    """
    axis = {"front": 0, "rear": 0, "left": 1, "right": 1, "top": 2}[side]
    sign = -1.0 if side in ("rear", "right") else 1.0
    plane = [other for other in range(3) if other != axis]
    share = np.linspace(0, 1, rows + 1)[:, None, None]
    flat = np.asarray(low, dtype=np.float64) * (1 - share) + np.asarray(high, dtype=np.float64) * share
    columns = flat.shape[1]
    points = flat.reshape(-1, 2)
    corners = target.positions_m.astype(np.float64)[target.triangles]
    a, b, c = (corners[:, corner][:, plane] for corner in range(3))
    area = _cross2(b - a, c - a)
    lows, highs = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    wide = (
        (np.abs(area) > 1e-9) & (lows <= points.max(axis=0)).all(axis=1) & (highs >= points.min(axis=0)).all(axis=1)
    )
    shares = (
        np.stack(
            [
                _cross2(c[None, wide] - b[None, wide], points[:, None] - b[None, wide]),
                _cross2(a[None, wide] - c[None, wide], points[:, None] - c[None, wide]),
                _cross2(b[None, wide] - a[None, wide], points[:, None] - a[None, wide]),
            ],
            axis=-1,
        )
        / area[None, wide, None]
    )
    height = sign * np.einsum("ptk,tk->pt", shares, corners[wide][:, :, axis])
    height[(shares < -1e-7).any(axis=-1)] = -np.inf
    best = np.argmax(height, axis=1)
    row = np.arange(len(points))
    met = np.isfinite(height[row, best])
    weights = np.where(met[:, None], shares[row, best], 1 / 3)
    hit = target.triangles[wide][best]
    normals = unit(np.einsum("pk,pkd->pd", weights, target.normals.astype(np.float64)[hit]))
    positions = np.einsum("pk,pkd->pd", weights, target.positions_m.astype(np.float64)[hit]) + lift_m * normals
    faces = np.concatenate(_quads(rows + 1, columns, wrap=False))
    faces = faces[met[faces].all(axis=1)]
    at = positions[faces]
    crosses = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    outward = np.sum(crosses * normals[faces].mean(axis=1), axis=1)
    faces = np.where(outward[:, None] < 0, faces[:, ::-1], faces)[np.linalg.norm(crosses, axis=1) > 1e-8]
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(
        positions[used].astype(np.float32),
        normals[used].astype(np.float32),
        np.zeros((len(used), 2), dtype=np.float32),
        np.broadcast_to(np.asarray(albedo, dtype=np.float32), (len(used), 3)).copy(),
        np.full(len(used), layer("plain"), dtype=np.int32),
        np.full(len(used), gloss, dtype=np.float32),
        index.reshape(-1, 3).astype(np.int32),
    )


def _cross2(first: Float, second: Float) -> Float:
    result: Float = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return result


def rectangle(
    target: Mesh,
    side: Side,
    low: tuple[float, float],
    high: tuple[float, float],
    albedo: Any,
    *,
    columns: int = 2,
    rows: int = 1,
    gloss: float = 0.1,
    lift_m: float = 0.006,
) -> Mesh:
    """A rectangular patch between two corners."""
    across = np.linspace(low[0], high[0], columns + 1)
    edges = [np.column_stack([across, np.full(columns + 1, level)]) for level in (low[1], high[1])]
    return patch(target, side, edges[0], edges[1], albedo, rows=rows, gloss=gloss, lift_m=lift_m)


def number_plate(target: Mesh, side: Side, centre: tuple[float, float], paint: Any, *, wide_m: float = 0.5) -> Mesh:
    """A plate with the dark marks of its letters."""
    half, tall = wide_m / 2, 0.055
    y, z = centre
    parts = [rectangle(target, side, (y - half, z - tall), (y + half, z + tall), paint, gloss=0.05, lift_m=0.012)]
    for start, end in ((-0.84, -0.56), (-0.46, -0.18), (0.0, 0.24), (0.32, 0.84)):
        low, high = (y + start * half, z - 0.55 * tall), (y + end * half, z + 0.55 * tall)
        parts.append(rectangle(target, side, low, high, (0.10, 0.10, 0.11), columns=1, gloss=0.02, lift_m=0.017))
    return merged(parts)


def revolved(profile: Any, segments: int, centre_m: Any) -> tuple[Solid, Ints, Ints]:
    """A body turned about the y axis.

    Args:
        profile: (n, 2) of (radius, y), from one end on the axis to the other.
        segments: steps around.
        centre_m: where its middle is.

    Returns:
        The solid, and for each triangle its row in the profile and its segment.
    """
    outline = np.asarray(profile, dtype=np.float64)
    turn = 2 * np.pi * np.arange(segments) / segments
    inner = outline[1:-1]
    rings = np.stack(
        [
            inner[:, :1] * np.cos(turn),
            np.repeat(inner[:, 1:], segments, axis=1),
            inner[:, :1] * np.sin(turn),
        ],
        axis=-1,
    )
    positions = np.concatenate([rings.reshape(-1, 3), [(0, outline[0, 1], 0), (0, outline[-1, 1], 0)]])
    raw = loft(rings)
    positions = positions + np.asarray(centre_m, dtype=np.float64)
    quads = np.tile(np.arange(segments), len(inner) - 1)
    rows = np.repeat(np.arange(len(inner) - 1), segments) + 1
    ends = np.arange(segments)
    row = np.concatenate([rows, rows, np.zeros(segments, int), np.full(segments, len(inner))])
    segment = np.concatenate([quads, quads, ends, ends])
    return solid(positions, raw.triangles), row.astype(np.int32), segment.astype(np.int32)


def road_wheel(
    centre_m: Any,
    radius_m: float,
    width_m: float,
    rim: Any,
    *,
    outward: float,
    spokes: int = 5,
    segments: int = 15,
    dish: float = 0.62,
) -> Mesh:
    """A tyre on a rim with spokes.

    Args:
        centre_m: middle of the wheel.
        outward: 1 where its outer face looks to +y, -1 to -y.
        rim: linear RGB of the rim.
        spokes: bright sectors of the rim; 0: a closed disc.
        dish: where the hub is, as a share of half the width outwards; small for a deep rim.
    """
    r, w = radius_m, width_m / 2
    profile = np.array(
        [
            (0, dish * w),
            (0.17 * r, (dish + 0.04) * w),
            (0.60 * r, 0.80 * w),
            (0.66 * r, 0.97 * w),
            (0.90 * r, w),
            (r, 0.7 * w),
            (r, -0.75 * w),
            (0.85 * r, -w),
            (0, -0.9 * w),
        ]
    )
    profile[:, 1] *= outward
    shape, row, segment = revolved(profile, segments, centre_m)
    colours = np.tile(np.array(RUBBER), (len(row), 1))
    colours[row <= 2] = rim
    if spokes:
        each = segments / spokes
        colours[(row == 1) & (segment % each >= 0.62 * each)] = BLACK
    gloss = np.where(row <= 2, 0.12, 0.01)
    gloss[row >= len(profile) - 2] = 0.0
    return painted(shape, colours, gloss=gloss, crease_deg=50)


def shaded(mesh: Mesh, *, fade_m: float, darkest: float) -> Mesh:
    """Less light near the ground and on what looks down; the mesh stands on z = 0."""
    height = np.clip(mesh.positions_m[:, 2] / fade_m, 0, 1)
    light = darkest + (1 - darkest) * height * (2 - height)
    down = np.clip(-mesh.normals[:, 2], 0, 1)
    light = light * (1 - 0.45 * down)
    return replace(mesh, albedo=np.clip(mesh.albedo * light[:, None], 0, 1).astype(np.float32))


def boxed(mesh: Mesh, size_wlh_m: tuple[float, float, float]) -> Mesh:
    """The mesh stretched to fill its box to the last bit of float32, the origin at the box's centre."""
    half = np.array([size_wlh_m[1], size_wlh_m[0], size_wlh_m[2]]) / 2
    positions = mesh.positions_m.astype(np.float64)
    low, high = positions.min(axis=0), positions.max(axis=0)
    scale = 2 * half / (high - low)
    limit = half.astype(np.float32)
    placed = np.clip((((positions - low) * scale) - half).astype(np.float32), -limit, limit)
    normals = unit(mesh.normals.astype(np.float64) / scale).astype(np.float32)
    return replace(mesh, positions_m=placed, normals=normals)
