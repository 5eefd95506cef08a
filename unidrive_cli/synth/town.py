"""A seeded town: what stands and lies along its streets, as polygons and as meshes. Metres, z up."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import mapbox_earcut
import numpy as np
import shapely
import trimesh

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh, merged, mesh_of
from unidrive_cli.synth.streets import HALF_ROAD_M, JUNCTION_M, LANE_M, PAVEMENT_M, Line, StreetPlan
from unidrive_cli.synth.terrain import CELL_M, Terrain
from unidrive_cli.synth.textures import layer

KERB_M = 0.12
"""Height of pavements and verges over the road."""
CROSSING_M = (JUNCTION_M - 4.2, JUNCTION_M - 1.2)
"""From a junction's middle to a zebra crossing's near and far side."""
_PAINT_M = 0.005
_STOREY_M = 3.2
_FACADES = {  # texture layer: metres that one repeat covers (width, height), tints, storeys
    "facade_flats": ((12.8, 12.8), ((0.75, 0.70, 0.62), (0.62, 0.64, 0.66), (0.78, 0.62, 0.45)), (4, 9)),
    "facade_old": (
        (12.8, 12.8),
        ((0.72, 0.60, 0.45), (0.66, 0.42, 0.30), (0.60, 0.62, 0.52), (0.7, 0.66, 0.6)),
        (3, 5),
    ),
    "facade_office": ((12.8, 12.8), ((0.6, 0.6, 0.6), (0.7, 0.66, 0.58), (0.42, 0.44, 0.48)), (4, 12)),
    "facade_glass": ((12.8, 12.8), ((0.55, 0.62, 0.68), (0.45, 0.55, 0.55)), (6, 14)),
    "brick": ((3.2, 3.2), ((0.62, 0.30, 0.20), (0.50, 0.26, 0.18)), (2, 3)),
}


@dataclass(frozen=True, eq=False)
class Building:
    """A building: its plan and its height over the pavement."""

    footprint: shapely.Polygon
    height_m: float


@dataclass(frozen=True, eq=False)
class Town:
    """What a scene's world holds besides traffic.

    Attributes:
        plan: its streets.
        road: where vehicles may drive.
        buildings: what no camera may be inside of.
        obstacles: (n, 3) x, y, radius of trunks and poles, which nobody walks through.
        ground, structures: meshes.
    """

    plan: StreetPlan
    road: shapely.Geometry
    buildings: tuple[Building, ...]
    obstacles: Float
    ground: Mesh
    structures: Mesh


def make_town(rng: np.random.Generator, plan: StreetPlan, terrain: Terrain, near: shapely.Geometry) -> Town:
    """Builds along a street plan; the same generator state gives the same town.

    Args:
        near: where small things (trees, lamps, hedges, markings) are worth having.
    """
    shapely.prepare(near)
    props = _Props(rng)
    road = shapely.union_all([shapely.LineString(s.middle.points).buffer(HALF_ROAD_M) for s in plan.streets])
    road = road.buffer(6.0).buffer(-6.0)
    outside = shapely.box(-20, -20, plan.side_m + 20, plan.side_m + 20)
    paved = road.buffer(PAVEMENT_M)
    shapely.prepare(paved)
    blocks = [block for block in _polygons(outside - paved) if block.area > 60]
    buildings: list[Building] = []
    walls: list[Mesh] = []
    for block in blocks:
        for building, mesh in _buildings(rng, block, paved):
            buildings.append(building)
            walls.append(mesh)
    furniture, obstacles = _furniture(rng, plan, road, near, props)
    gardens, trees = _gardens(rng, blocks, buildings, near, props)
    ground = [
        _flat(outside.buffer(400) - outside, KERB_M - 0.01, "grass", terrain, tile_m=6.0, cell_m=60.0),
        _flat(outside - paved.buffer(-0.5), KERB_M - 0.01, "grass", terrain, tile_m=6.0),
        _flat(paved - road.buffer(0.3), KERB_M, "paving", terrain, tile_m=3.0),
        _flat(road.buffer(0.3) - road, KERB_M, "concrete", terrain, tile_m=4.0, albedo=(1.15, 1.13, 1.1)),
        _kerbs(road),
        _flat(road, 0.0, "asphalt", terrain, tile_m=7.0),
        *_repairs(rng, plan, near),
        *_markings(plan, near),
    ]
    return Town(
        plan,
        road,
        tuple(buildings),
        np.array(obstacles).reshape(-1, 3),
        terrain.raised(merged(ground)),
        terrain.raised(merged([*walls, *furniture, *gardens, *trees, *_skyline(rng, plan.side_m)])),
    )


def _polygons(geometry: Any) -> list[shapely.Polygon]:
    return [part for part in shapely.get_parts(geometry) if isinstance(part, shapely.Polygon)]


def _triangulated(polygon: shapely.Polygon) -> tuple[Float, Any]:
    """Vertices (n, 2) and counter-clockwise triangles (m, 3) of a polygon with holes."""
    polygon = shapely.geometry.polygon.orient(polygon)
    rings = [np.asarray(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
    points = np.concatenate(rings)
    triangles = mapbox_earcut.triangulate_float64(points, np.cumsum([len(ring) for ring in rings]).astype(np.uint32))
    triangles = triangles.reshape(-1, 3).astype(np.int64)
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[twice < 0] = triangles[twice < 0][:, ::-1]
    return points, triangles[np.abs(twice) > 1e-9]


def _flat(
    area: Any,
    z_m: float,
    texture: str,
    terrain: Terrain,
    *,
    tile_m: float,
    albedo: Any = (1.0, 1.0, 1.0),
    cell_m: float = CELL_M,
) -> Mesh:
    """A level area with a texture that repeats every `tile_m` metres; in cells where the terrain is not flat."""
    meshes = []
    for polygon in terrain.cells(_polygons(shapely.simplify(area, 0.02)), cell_m):
        points, triangles = _triangulated(polygon)
        height = np.full((len(points), 1), z_m)
        up = np.broadcast_to([0.0, 0.0, 1.0], (len(points), 3))
        meshes.append(
            mesh_of(
                np.hstack([points, height]),
                triangles,
                layer=layer(texture),
                albedo=albedo,
                uv=points / tile_m,
                normals=up,
            )
        )
    return merged(meshes)


def _kerbs(road: Any) -> Mesh:
    """The kerb's face round the road."""
    meshes = []
    for polygon in _polygons(shapely.simplify(road, 0.02)):
        polygon = shapely.geometry.polygon.orient(polygon)
        for ring in (polygon.exterior, *polygon.interiors):
            points = shapely.get_coordinates(shapely.segmentize(ring, 4.0))
            meshes.append(_wall(points[::-1], -0.02, KERB_M, "concrete", (4.0, 4.0), (0.85, 0.84, 0.82)))
    return merged(meshes)


def _wall(
    points: Float, low_m: float, high_m: float, texture: str, tile_m: Any, albedo: Any, gloss: float = 0.0
) -> Mesh:
    """A wall along a polyline (n, 2), seen from its right-hand side; the texture's v counts from `low_m` up."""
    start, end = points[:-1], points[1:]
    along = np.append(0.0, np.cumsum(np.linalg.norm(end - start, axis=1)))
    count = len(start)
    positions = np.zeros((count, 4, 3))
    positions[:, [0, 3], :2], positions[:, [1, 2], :2] = start[:, None], end[:, None]
    positions[:, :2, 2], positions[:, 2:, 2] = low_m, high_m
    uv = np.zeros((count, 4, 2))
    uv[:, [0, 3], 0], uv[:, [1, 2], 0] = along[:-1, None] / tile_m[0], along[1:, None] / tile_m[0]
    uv[:, 2:, 1] = (high_m - low_m) / tile_m[1]
    quads = 4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return mesh_of(
        positions.reshape(-1, 3),
        quads.reshape(-1, 3),
        layer=layer(texture),
        albedo=albedo,
        uv=uv.reshape(-1, 2),
        gloss=gloss,
    )


def _strip(left: Float, right: Float, z_m: float, texture: str, tile_m: float, albedo: Any) -> Mesh:
    """A ribbon between two polylines (n, 2) of equal length."""
    count = len(left)
    points = np.concatenate([left, right])
    index = np.arange(count - 1)
    triangles = np.concatenate(
        [np.stack([index, index + count, index + 1], 1), np.stack([index + 1, index + count, index + count + 1], 1)]
    )
    positions = np.hstack([points, np.full((2 * count, 1), z_m)])
    up = np.broadcast_to([0.0, 0.0, 1.0], positions.shape)
    return mesh_of(positions, triangles, layer=layer(texture), albedo=albedo, uv=points / tile_m, normals=up)


def _line_marking(line: Line, start_m: float, end_m: float, left_m: float, width_m: float) -> Mesh:
    piece = line.part(start_m, end_m)
    left, right = (piece.beside(left_m + sign * width_m / 2) for sign in (1, -1))
    count = max(2, min(len(left.points), len(right.points)))
    at = np.linspace(0, 1, count)
    return _strip(
        left.at(at * left.length_m), right.at(at * right.length_m), _PAINT_M, "marking", 2.0, (1.0, 1.0, 1.0)
    )


def _markings(plan: StreetPlan, near: Any) -> Iterator[Mesh]:
    """Centre lines, parking lines, stop lines and zebra crossings."""
    for street in plan.streets:
        start, end = street.open_m
        if end - start < 4 or not near.intersects(shapely.LineString(street.middle.points)):
            continue
        for at in np.arange(start + 1.0, end - 3.0, 6.0):
            yield _line_marking(street.middle, at, at + 3.0, 0.0, 0.14)
        for side in (1, -1):
            yield _line_marking(street.middle, start + 2, end - 2, side * LANE_M, 0.10)
        for junction in (street.start, street.end):
            if len(plan.streets_at(junction)) < 2:
                continue
            line = street.from_junction(junction)
            yield _line_marking(line, JUNCTION_M - 0.2, JUNCTION_M + 0.2, LANE_M / 2, LANE_M - 0.3)  # who arrives
            for left in np.arange(-HALF_ROAD_M + 0.6, HALF_ROAD_M - 0.3, 1.0):
                yield _line_marking(line, *CROSSING_M, left, 0.5)


def _repairs(rng: np.random.Generator, plan: StreetPlan, near: Any) -> Iterator[Mesh]:
    """Patches of newer and older asphalt, and manhole covers."""
    for street in plan.streets:
        line = street.middle
        if not near.intersects(shapely.LineString(line.points)):
            continue
        for _ in range(int(line.length_m / 14)):
            along, left = rng.uniform(4, line.length_m - 12), rng.uniform(-4.5, 4.5)
            shade = rng.uniform(0.55, 0.8) if rng.random() < 0.7 else rng.uniform(1.15, 1.3)
            piece = line.part(along, along + rng.uniform(1.5, 8.0))
            half = rng.uniform(0.3, 1.2)
            a, b = piece.beside(left + half), piece.beside(left - half)
            at = np.linspace(0, 1, 8)
            yield _strip(a.at(at * a.length_m), b.at(at * b.length_m), 0.002, "asphalt", 5.0, (shade, shade, shade))
        for _ in range(int(line.length_m / 30)):
            along, left = rng.uniform(2, line.length_m - 2), rng.uniform(-2.5, 2.5)
            centre = line.beside(left).at(np.array(along))
            yield _disc(centre, 0.33, 0.003, (0.10, 0.095, 0.09))


def _disc(centre: Float, radius_m: float, z_m: float, albedo: Any) -> Mesh:
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    rim = centre + radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = np.vstack([centre, rim])
    index = np.arange(20)
    triangles = np.stack([np.zeros(20, int), 1 + index, 1 + (index + 1) % 20], axis=1)
    positions = np.hstack([points, np.full((21, 1), z_m)])
    return mesh_of(positions, triangles, layer=layer("concrete"), albedo=albedo, uv=points)


def _buildings(rng: np.random.Generator, block: shapely.Polygon, paved: Any) -> Iterator[tuple[Building, Mesh]]:
    """Houses along the streets round a block; gaps between some of them."""
    setback_m = float(rng.choice([0.9, 0.9, 1.5, 3.0]))
    inner = block.buffer(-setback_m, join_style="mitre")
    allowed = shapely.prepared.prep(inner.buffer(0.8))
    taken: list[shapely.Polygon] = []
    for part in _polygons(inner):
        outline = shapely.geometry.polygon.orient(part.simplify(0.5))
        for ring in (outline.exterior, *outline.interiors):
            line = Line(np.asarray(ring.coords))
            along = rng.uniform(0, 4)
            while along < line.length_m - 6:
                width = rng.uniform(9, 22)
                corner, far = line.at(np.array([along, along + width]))
                edge = far - corner
                unit = edge / max(float(np.linalg.norm(edge)), 1e-6)
                inward = np.array([-unit[1], unit[0]])
                depth = rng.uniform(9, 13)
                footprint = shapely.Polygon([corner, far, far + depth * inward, corner + depth * inward])
                fits = np.linalg.norm(edge) > 7 and shapely.dwithin(paved, footprint, setback_m + 2)
                if not fits or not allowed.contains(footprint) or any(map(footprint.intersects, taken)):
                    along += 2.5
                    continue
                taken.append(footprint)
                along += width + (0.02 if rng.random() < 0.75 else rng.uniform(3, 9))
                yield _building(rng, footprint, shops=setback_m < 2)


def _building(rng: np.random.Generator, footprint: shapely.Polygon, *, shops: bool) -> tuple[Building, Mesh]:
    style = str(rng.choice(list(_FACADES)))
    tile, tints, storeys = _FACADES[style]
    height = _STOREY_M * int(rng.integers(*storeys, endpoint=True))
    tint = np.array(tints[int(rng.integers(len(tints)))]) * rng.uniform(0.85, 1.1)
    points = np.asarray(footprint.exterior.coords)
    base = KERB_M
    gloss = 0.25 if style == "facade_glass" else 0.0
    meshes = []
    first = base + _STOREY_M * 1.1
    if shops and style != "brick" and rng.random() < 0.65:
        meshes.append(
            _wall(points, base - 0.3, first, "shops", (12.8, _STOREY_M * 1.1 + 0.3), np.array([1.0, 1.0, 1.0]))
        )
    else:
        meshes.append(_wall(points, base - 0.3, first, style, tile, tint * 0.9, gloss))
    meshes.append(_wall(points, first, first + height, style, tile, tint, gloss))
    top = first + height
    ring = np.hstack([points[:-1], np.full((4, 1), top)])
    if style == "brick" or (style == "facade_old" and rng.random() < 0.5):
        meshes.append(_gable(ring, rng.uniform(2.0, 3.5), tint))
    else:
        parapet = shapely.Polygon(points).buffer(0.12, join_style="mitre")
        outer = np.asarray(shapely.geometry.polygon.orient(parapet).exterior.coords)
        meshes.append(_wall(outer, top - 0.4, top + 0.5, "concrete", (4.0, 4.0), tint * 0.9))
        corners = np.hstack([outer[:-1], np.full((len(outer) - 1, 1), top + 0.5)])
        meshes.append(
            mesh_of(corners, [[0, 1, 2], [0, 2, 3]], layer=layer("roof"), albedo=(0.5, 0.5, 0.5), uv=outer[:-1] / 6)
        )
    return Building(footprint, top + 4.0), merged(meshes)


def _gable(ring: Float, rise_m: float, tint: Float) -> Mesh:
    """A gabled roof on a rectangle (4, 3), ridge along its first side."""
    a, b, c, d = ring
    up = np.array([0, 0, rise_m])
    e, f = (a + d) / 2 + up, (b + c) / 2 + up
    wide, deep = np.linalg.norm(b - a) / 6, np.linalg.norm(e - a) / 6
    uv = np.array([[0, 0], [wide, 0], [wide, deep], [0, deep]])
    tiles = (0.42, 0.20, 0.14)
    roof = [
        mesh_of(quad, [[0, 1, 2], [0, 2, 3]], layer=layer("roof"), albedo=tiles, uv=uv)
        for quad in (np.array([a, b, f, e]), np.array([c, d, e, f]))
    ]
    ends = [
        mesh_of(side, [[0, 1, 2]], layer=layer("plaster"), albedo=tint)
        for side in (np.array([b, c, f]), np.array([d, a, e]))
    ]
    return merged([*roof, *ends])


class _Props:
    """Things of which a town has many: made once, then placed."""

    def __init__(self, rng: np.random.Generator) -> None:
        grey = (0.16, 0.17, 0.18)
        self.trees = [_tree(rng, height) for height in np.linspace(5.0, 11.0, 10)]
        self.lamp = merged(
            [
                _post(0.075, 7.2, grey),
                _box((0.8, 0, 7.1), (1.7, 0.07, 0.07), grey),
                _box((1.7, 0, 7.05), (0.7, 0.22, 0.1), (0.6, 0.6, 0.55)),
            ]
        )
        self.bin = _box((0, 0, 0.5), (0.5, 0.5, 1.0), (0.08, 0.14, 0.10))
        self.bollard = _post(0.06, 0.95, (0.12, 0.12, 0.13))
        self.lights = [self._light(lit) for lit in (0, 2)]
        self.signs = [
            merged([_post(0.04, 2.6, (0.35, 0.35, 0.36)), _plate(colour)])
            for colour in ((0.62, 0.05, 0.05), (0.04, 0.16, 0.55), (0.75, 0.62, 0.05))
        ]

    @staticmethod
    def _light(lit: int) -> Mesh:
        parts = [_post(0.06, 3.4, (0.1, 0.1, 0.1)), _box((0.1, 0, 3.1), (0.22, 0.3, 0.85), (0.03, 0.03, 0.03))]
        for step, colour in enumerate(((0.05, 0.6, 0.15), (0.5, 0.28, 0.02), (0.75, 0.04, 0.03))):
            lamp = trimesh.creation.icosphere(subdivisions=1, radius=0.09)
            lamp.apply_translation([0.2, 0, 2.83 + 0.27 * step])
            parts.append(_solid(lamp, "plain", np.array(colour) * (1.0 if step == lit else 0.12), smooth=True))
        return merged(parts)


def _standing(mesh: Mesh, place: Float, yaw_rad: float) -> Mesh:
    """A prop on the pavement."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    pose[:3, 3] = [*place, KERB_M]
    return mesh.placed(pose)


def _solid(shape: Any, texture: str, albedo: Any, *, smooth: bool = False) -> Mesh:
    """The mesh of a trimesh primitive."""
    if not smooth:
        return mesh_of(shape.vertices, shape.faces, layer=layer(texture), albedo=albedo)
    vertices = np.asarray(shape.vertices)
    uv = np.stack([np.arctan2(vertices[:, 1], vertices[:, 0]) / np.pi, vertices[:, 2] / 2], axis=-1)
    return mesh_of(vertices, shape.faces, layer=layer(texture), albedo=albedo, uv=uv, normals=shape.vertex_normals)


def _post(radius_m: float, height_m: float, albedo: Any) -> Mesh:
    shape = trimesh.creation.cylinder(radius=radius_m, height=height_m, sections=8)
    shape.apply_translation([0, 0, height_m / 2 - 0.05])
    return _solid(shape, "plain", albedo, smooth=True)


def _box(centre_m: Any, size_m: Any, albedo: Any) -> Mesh:
    shape = trimesh.creation.box(size_m)
    shape.apply_translation(centre_m)
    return _solid(shape, "plain", albedo)


def _plate(albedo: Any) -> Mesh:
    shape = trimesh.creation.cylinder(radius=0.32, height=0.03, sections=24)
    shape.apply_transform([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    shape.apply_translation([0.06, 0, 2.45])
    return _solid(shape, "plain", albedo)


def _tree(rng: np.random.Generator, height_m: float) -> Mesh:
    """A trunk with a crown of several lumps of leaves."""
    trunk_m = height_m * rng.uniform(0.32, 0.42)
    trunk = trimesh.creation.cone(radius=0.17 + 0.012 * height_m, height=height_m * 0.8, sections=9)
    trunk.apply_translation([0, 0, -0.05])
    parts = [_solid(trunk, "bark", (0.5, 0.42, 0.34), smooth=True)]
    spread_m = height_m * rng.uniform(0.2, 0.28)
    green = np.array([0.30, 0.42, 0.14]) * rng.uniform(0.75, 1.2) * np.array([rng.uniform(0.8, 1.35), 1.0, 1.0])
    for lump in range(6):
        ball = trimesh.creation.icosphere(subdivisions=1 if lump else 2, radius=1.0)
        unit = np.asarray(ball.vertices)
        bumps = 1 + 0.16 * np.sin(unit @ rng.normal(0, 4.2, (3, 6)) + rng.uniform(0, 6, 6)).sum(axis=1) / 2
        angle, far_m = rng.uniform(0, 2 * np.pi), spread_m * rng.uniform(0.3, 0.85) * (lump > 0)
        radius_m = spread_m * (rng.uniform(0.5, 0.8) if lump else 0.95)
        up_m = trunk_m + (height_m - trunk_m) * (rng.uniform(0.2, 0.75) if lump else 0.55)
        centre = np.array([far_m * np.cos(angle), far_m * np.sin(angle), up_m])
        local = unit * bumps[:, None] * radius_m * [1, 1, 0.85]
        shape = trimesh.Trimesh(local + centre, ball.faces, process=False)
        uv = np.stack([local[:, 0] + 0.6 * local[:, 1], local[:, 2] + 0.3 * local[:, 1]], axis=-1) / 1.7
        shade = 0.45 + 0.3 * (unit[:, 2:] + 1)
        parts.append(
            mesh_of(
                shape.vertices,
                shape.faces,
                layer=layer("leaves"),
                albedo=green * shade,
                uv=uv,
                normals=shape.vertex_normals,
            )
        )
    return merged(parts)


def _furniture(
    rng: np.random.Generator, plan: StreetPlan, road: Any, near: Any, props: _Props
) -> tuple[list[Mesh], list[list[float]]]:
    """Street trees, lamps, signs, bollards and bins on the pavements; and the circles that they stand in."""
    meshes: list[Mesh] = []
    obstacles: list[list[float]] = []
    too_near = shapely.prepared.prep(road.buffer(0.25))

    def put(mesh: Mesh, place: Float, yaw_rad: float, radius_m: float) -> None:
        if near.contains(shapely.Point(place)) and not too_near.contains(shapely.Point(place)):
            meshes.append(_standing(mesh, place, yaw_rad))
            obstacles.append([*place, radius_m])

    for street in plan.streets:
        start, end = street.open_m
        leafy = rng.random() < 0.6
        for side in (1, -1):
            edge = street.middle.beside(side * (HALF_ROAD_M + 0.75))
            for along in np.arange(start + 3, end - 1, 8.5):
                place = edge.at(np.array(along + rng.uniform(-1, 1)))
                to_road = float(edge.heading_at(np.array(along))) - side * np.pi / 2
                kind, which = rng.random(), int(rng.integers(7))
                if kind < (0.55 if leafy else 0.12):
                    put(props.trees[which], place, rng.uniform(0, 6), 0.35)
                elif kind < 0.75:
                    put(props.lamp, place, to_road, 0.15)
                elif kind < 0.82:
                    put(props.bin, place, to_road, 0.4)
                elif kind < 0.9:
                    for step in range(4):
                        put(props.bollard, edge.at(np.array(along + 1.2 * step)), 0.0, 0.1)
        for junction in (street.start, street.end):
            if len(plan.streets_at(junction)) > 2:
                line = street.from_junction(junction)  # it leads away from the junction: towards who arrives
                place = line.beside(HALF_ROAD_M + 0.7).at(np.array(JUNCTION_M + 0.4))
                kinds = props.lights if rng.random() < 0.6 else props.signs
                put(kinds[int(rng.integers(len(kinds)))], place, float(line.heading_at(np.array(JUNCTION_M))), 0.15)
    return meshes, obstacles


def _gardens(
    rng: np.random.Generator,
    blocks: Iterable[shapely.Polygon],
    buildings: list[Building],
    near: Any,
    props: _Props,
) -> tuple[list[Mesh], list[Mesh]]:
    """Hedges along open block edges, and trees inside the blocks."""
    hedges: list[Mesh] = []
    trees: list[Mesh] = []
    built = shapely.STRtree([building.footprint for building in buildings])
    for block in blocks:
        low_x, low_y, high_x, high_y = block.bounds
        for _ in range(min(40, int(block.area / 130))):
            place = np.array([rng.uniform(low_x, high_x), rng.uniform(low_y, high_y)])
            yaw_rad, which = rng.uniform(0, 6), int(rng.integers(10))
            spot = shapely.Point(place).buffer(2.6)
            if near.contains(spot) and block.contains(spot) and not len(built.query(spot, predicate="intersects")):
                trees.append(_standing(props.trees[which], place, yaw_rad))
        for polygon in _polygons(block.buffer(-0.35)):
            for ring in (polygon.exterior, *polygon.interiors):
                hedges.extend(_hedges(rng, Line(np.asarray(ring.coords)), built, near))
    return hedges, trees


def _hedges(rng: np.random.Generator, line: Line, built: shapely.STRtree, near: Any) -> Iterator[Mesh]:
    for along in np.arange(0, line.length_m - 2.2, 2.2):
        a, b = line.at(np.array([along, along + 2.2]))
        piece = shapely.LineString([a, b])
        free = rng.random() > 0.1 and near.contains(piece)
        if free and not len(built.query(piece.buffer(2.2), predicate="intersects")):
            yield _hedge(rng, a, b)


def _hedge(rng: np.random.Generator, start: Float, end: Float) -> Mesh:
    ahead = (end - start) / np.linalg.norm(end - start)
    across, over = 0.25 * np.array([-ahead[1], ahead[0]]), 0.05 * ahead
    ring = np.array([start - over - across, end + over - across, end + over + across, start - over + across])
    top_m = KERB_M + rng.uniform(0.9, 1.15)
    green = np.array([0.16, 0.30, 0.09]) * rng.uniform(0.8, 1.2)
    lid = np.hstack([ring, np.full((4, 1), top_m)])
    return merged(
        [
            _wall(np.vstack([ring, ring[:1]]), 0.0, top_m, "leaves", (1.3, 1.3), green),
            mesh_of(lid, [[0, 1, 2], [0, 2, 3]], layer=layer("leaves"), albedo=green * 1.2, uv=ring / 1.3),
        ]
    )


def _skyline(rng: np.random.Generator, side_m: float) -> Iterator[Mesh]:
    """Far buildings all round, so that no street ends in nothing."""
    middle = np.array([side_m / 2, side_m / 2])
    for angle in np.arange(0, 2 * np.pi, 0.06):
        far = side_m * 0.72 + rng.uniform(20, 120)
        place = middle + far * np.array([np.cos(angle), np.sin(angle)])
        wide, deep, high = rng.uniform(16, 34), rng.uniform(12, 20), rng.uniform(10, 38)
        style = str(rng.choice(["facade_flats", "facade_old", "facade_office"]))
        tint = np.array(_FACADES[style][1][0]) * rng.uniform(0.8, 1.1)
        across = np.array([-np.sin(angle), np.cos(angle)])
        out = np.array([np.cos(angle), np.sin(angle)])
        ring = [place - wide / 2 * across, place - wide / 2 * across + deep * out]
        ring += [place + wide / 2 * across + deep * out, place + wide / 2 * across, ring[0]]
        points = np.array(ring)
        yield _wall(points, -1.0, high, style, (12.8, 12.8), tint)
        top = np.hstack([points[:-1], np.full((4, 1), high)])
        yield mesh_of(top, [[0, 1, 2], [0, 2, 3]], layer=layer("roof"), albedo=(0.4, 0.4, 0.4), uv=points[:-1] / 6)
