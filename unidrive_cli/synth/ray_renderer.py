"""The renderer that casts rays on the CPU: embree finds what they meet, numpy shades it."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.synth import light
from unidrive_cli.synth.embree import ray_scene
from unidrive_cli.synth.light import Array
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.stage import (
    FIRST_ACTOR_ID,
    GROUND_ID,
    SKY_ID,
    STRUCTURE_ID,
    Depth,
    Instances,
    Picture,
    Stage,
    View,
)

RAYS_NAME = "embree (rays on the CPU)"
_BAND_ROWS = 24
"""Rows shaded at once: their values stay in the processor's cache."""
_MOST_THREADS = 8
_LIFT_M = 0.003
"""Shadow rays start so far above the surface."""
_FOLD = 2048
"""OpenCV's remap takes rows of at most 32766 pixels: long lists are folded into rows of this many."""

_NORMAL, _UV, _ALBEDO, _COLUMNS = slice(0, 3), slice(3, 5), slice(5, 8), 8


class RayRenderer:
    """Draws one stage by casting rays: no sampling noise, no shadow maps, any machine."""

    def __init__(self, stage: Stage) -> None:
        """
        Raises:
            UnidriveError: embreex is not installed.
        """
        self._light = light.Light.of(stage.day)
        chain = light.mip_chain(stage.textures)
        self._tiles = _Atlas(chain)
        self._means = light.layer_means(chain)
        self._varies = np.isin(np.arange(len(stage.textures)), light.VARIED_LAYERS)
        still = merged([stage.ground, stage.structures])
        self._still = _Surfaces.of(still)
        self._still_ids = np.full(len(still.triangles), STRUCTURE_ID, dtype=np.uint16)
        self._still_ids[: len(stage.ground.triangles)] = GROUND_ID
        self._still_scene = ray_scene(still.positions_m, still.triangles)
        self._still_blockers = ray_scene(stage.structures.positions_m, stage.structures.triangles)
        self._actors = _Crowd(stage.actors)

    @property
    def name(self) -> str:
        return RAYS_NAME

    def close(self) -> None:
        """Nothing is held."""

    def picture(self, view: View, samples: int) -> Picture:
        grid = light.GRIDS.get(samples)
        if grid is None:
            raise ValueError(f"samples must be 1, 4 or 16, got {samples}")
        lens = view.lens
        self._actors.move(view)
        picture = np.empty((lens.height_px, lens.width_px, 3), dtype=np.uint8)
        offsets = [
            ((2 * i + 1) / (2 * grid) - 0.5, (2 * j + 1) / (2 * grid) - 0.5)
            for j in range(grid)
            for i in range(grid)
        ]

        def draw(row: int) -> None:
            rows = slice(row, min(row + _BAND_ROWS, lens.height_px))
            total: Array = np.zeros((3, (rows.stop - rows.start) * lens.width_px), dtype=np.float32)
            for offset in offsets:
                total += self._colours(view, _Rays.of(view, rows, offset), 1 / grid)
            band = light.encoded(total / np.float32(len(offsets)))
            picture[rows] = band[::-1].T.reshape(-1, lens.width_px, 3)

        self._in_bands(lens.height_px, draw)
        return picture

    def instances(self, view: View) -> tuple[Instances, Depth]:
        lens = view.lens
        self._actors.move(view)
        ids = np.empty((lens.height_px, lens.width_px), dtype=np.uint16)
        depths = np.empty((lens.height_px, lens.width_px), dtype=np.float32)

        def draw(row: int) -> None:
            rows = slice(row, min(row + _BAND_ROWS, lens.height_px))
            hits = self._first_hits(_Rays.of(view, rows, (0.0, 0.0)))
            found = np.full(hits.depth_m.shape, SKY_ID, dtype=np.uint16)
            found[hits.still] = self._still_ids[hits.triangle[hits.still]]
            found[hits.moving] = self._actors.ids[hits.triangle[hits.moving]]
            ids[rows] = found.reshape(-1, lens.width_px)
            depths[rows] = hits.depth_m.reshape(-1, lens.width_px)

        self._in_bands(lens.height_px, draw)
        return ids, depths

    def _in_bands(self, height_px: int, draw: Any) -> None:
        with ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST_THREADS)) as pool:
            for _ in pool.map(draw, range(0, height_px, _BAND_ROWS)):
                pass

    def _first_hits(self, rays: _Rays) -> _Hits:
        hits = _Hits.none(len(rays.directions))
        for scene, moving in ((self._still_scene, False), (self._actors.scene, True)):
            if scene is None:
                continue
            limits = hits.depth_m.copy()  # embree writes there
            found = scene.run(rays.origins, rays.directions, dists=limits, output=True)
            hits = hits.nearer(found, moving)
        return hits

    def _blocked(self, origins: Array) -> npt.NDArray[np.bool_]:
        """(n,) where something is between places (n, 3) and the sun."""
        towards = np.ascontiguousarray(np.broadcast_to(self._light.to_sun.T, origins.shape))
        blocked = np.zeros(len(origins), dtype=np.bool_)
        for scene in (self._still_blockers, self._actors.scene):
            if scene is not None and len(origins):
                free = np.flatnonzero(~blocked)
                blocked[free] = scene.run(origins[free], towards[free], query="OCCLUDED") >= 0
        return blocked

    def _colours(self, view: View, rays: _Rays, footprint: float) -> Array:
        """(3, n) exposed linear colours of all rays."""
        hits = self._first_hits(rays)
        colours = np.empty((3, len(rays.directions)), dtype=np.float32)
        free = np.flatnonzero(~np.isfinite(hits.depth_m))
        if free.size:
            colours[:, free] = self._sky(view, rays.directions[free].T, footprint)
        met = np.flatnonzero(np.isfinite(hits.depth_m))
        if met.size:
            colours[:, met] = self._surfaces(view, rays, hits, met, footprint)
        return light.exposed(colours)

    def _sky(self, view: View, directions: Array, footprint: float) -> Array:
        length = np.sqrt(light.dot(directions, directions))
        towards = directions / length
        place = light.cloud_place(towards)
        height = np.maximum(towards[2], light.CLOUD_LOW) * length
        # The plane of the clouds is seen along the ray at 1 / height of its depth: the area of a footprint there.
        area = (footprint * light.CLOUD_SCALE * self._tiles.side) ** 2 / (view.lens.fx_px * view.lens.fy_px)
        level = light.level_of_detail(area / height**3, np.ones(1, dtype=np.float32))
        root = self._tiles.look(place, np.full(len(height), light.CLOUD_LAYER), level)[1]
        return light.sky(self._light, towards, root * root)

    def _surfaces(self, view: View, rays: _Rays, hits: _Hits, met: npt.NDArray[np.int64], footprint: float) -> Array:
        directions, depth = rays.directions[met].T, hits.depth_m[met]
        triangle, moving = hits.triangle[met], hits.moving[met]
        table = self._gathered(triangle, moving)
        values = table.values[:, :_COLUMNS] + hits.along[met, None] * table.values[:, _COLUMNS : 2 * _COLUMNS]
        values += hits.across[met, None] * table.values[:, 2 * _COLUMNS :]
        values = np.ascontiguousarray(values.T)
        own = table.own_normals.T
        length = np.sqrt(light.dot(directions, directions))
        towards = directions / length
        facing = light.dot(own, towards)
        normals = values[_NORMAL]
        normals = normals * (
            np.where(facing > 0, np.float32(-1), np.float32(1)) / np.sqrt(light.dot(normals, normals))
        )
        scale = (footprint * self._tiles.side) ** 2 / (view.lens.fx_px * view.lens.fy_px)
        facing = np.abs(facing)
        area = np.float32(scale) * depth * depth * table.density / np.maximum(facing * length, np.float32(1e-6))
        level = light.level_of_detail(area, facing)
        roots = self._tiles.look(values[_UV], table.layer, level)
        albedo = values[_ALBEDO] * (roots * roots)
        varied = np.flatnonzero(self._varies[table.layer])
        if varied.size:
            layers = table.layer[varied]
            place = light.varied_place(values[_UV][:, varied])
            look = self._tiles.look(place, layers, level[varied] + np.float32(np.log2(light.VARIED_SCALE)))[1]
            albedo[:, varied] *= light.varied(look * look, self._means[layers])
        direct = light.sunlight(self._light, normals, table.layer == light.LEAF_LAYER)
        lit = np.zeros(len(depth), dtype=np.float32)
        sunny = np.flatnonzero(direct > 0)
        if sunny.size and self._light.sun.any():
            up = own[:, sunny]
            up = up * np.where(light.dot(up, self._light.to_sun) < 0, np.float32(-_LIFT_M), np.float32(_LIFT_M))
            places = directions[:, sunny] * depth[sunny] + up
            lit[sunny] = ~self._blocked(np.ascontiguousarray(places.T) + rays.origins[met[sunny]])
        colours = light.shade(self._light, albedo, normals, towards, table.gloss, direct, lit)
        return light.haze(self._light, colours, depth * length)

    def _gathered(self, triangle: npt.NDArray[np.int32], moving: npt.NDArray[np.bool_]) -> _Surfaces:
        """The surfaces that rays met, one per ray."""
        if not moving.any():
            return self._still.taken(triangle)
        if moving.all():
            return self._actors.surfaces.taken(triangle)
        where = np.flatnonzero(moving)
        gathered = self._still.taken(np.where(moving, 0, triangle))
        gathered.put(where, self._actors.surfaces.taken(triangle[where]))
        return gathered


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays of some rows of a picture; the directions' component along the optical axis is 1.

    Attributes:
        origins, directions: (n, 3) float32, global frame.
    """

    origins: Array
    directions: Array

    @classmethod
    def of(cls, view: View, rows: slice, offset: tuple[float, float]) -> _Rays:
        lens = view.lens
        x = (np.arange(lens.width_px) + offset[0] - lens.cx_px) / lens.fx_px
        y = (np.arange(rows.start, rows.stop) + offset[1] - lens.cy_px) / lens.fy_px
        rotation = view.global_from_cam[:3, :3]
        directions = (x[:, None] * rotation[:, 0])[None] + (y[:, None] * rotation[:, 1] + rotation[:, 2])[:, None]
        directions = directions.reshape(-1, 3).astype(np.float32)
        eye = view.global_from_cam[:3, 3].astype(np.float32)
        return cls(np.ascontiguousarray(np.broadcast_to(eye, directions.shape)), directions)


@dataclass(frozen=True, eq=False)
class _Hits:
    """What rays meet first.

    Attributes:
        depth_m: (n,) along the optical axis, infinite where nothing is met.
        triangle: (n,) index, among the actors' triangles where `moving`.
        along, across: (n,) barycentric coordinates.
        moving: (n,) an actor is met.
    """

    depth_m: Array
    triangle: npt.NDArray[np.int32]
    along: Array
    across: Array
    moving: npt.NDArray[np.bool_]

    @classmethod
    def none(cls, count: int) -> _Hits:
        zeros = np.zeros(count, dtype=np.float32)
        none = np.zeros(count, dtype=np.bool_)
        return cls(np.full(count, np.inf, dtype=np.float32), np.zeros(count, dtype=np.int32), zeros, zeros, none)

    @property
    def still(self) -> npt.NDArray[np.bool_]:
        """(n,) something that does not move is met."""
        met: npt.NDArray[np.bool_] = np.isfinite(self.depth_m) & ~self.moving
        return met

    def nearer(self, found: dict[str, Any], moving: bool) -> _Hits:
        """These, or what embree has found where that is nearer."""
        better = (found["primID"] >= 0) & (found["tfar"] < self.depth_m)
        return _Hits(
            np.where(better, found["tfar"], self.depth_m),
            np.where(better, found["primID"], self.triangle),
            np.where(better, found["u"], self.along),
            np.where(better, found["v"], self.across),
            np.where(better, moving, self.moving),
        )


@dataclass(frozen=True, eq=False)
class _Surfaces:
    """What the shading needs of triangles, or of what rays met, a row each.

    Attributes:
        values: (n, 24) normal, texture place and albedo of the first corner, and the steps to the other two.
        own_normals: (n, 3) of the triangle itself.
        density: (n,) texture repeats squared per square metre.
        layer, gloss: (n,) of the last corner.
    """

    values: Array
    own_normals: Array
    density: Array
    layer: npt.NDArray[np.int32]
    gloss: Array

    @classmethod
    def of(cls, mesh: Mesh) -> _Surfaces:
        faces = mesh.triangles
        corners = mesh.positions_m.astype(np.float64)[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.maximum(np.linalg.norm(across, axis=1), 1e-20)
        uv = mesh.uv.astype(np.float64)[faces]
        first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        uv_area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        columns = np.hstack([mesh.normals, mesh.uv, mesh.albedo])[faces]
        values = np.hstack([columns[:, 0], columns[:, 1] - columns[:, 0], columns[:, 2] - columns[:, 0]])
        return cls(
            values.astype(np.float32),
            (across / area[:, None]).astype(np.float32),
            (uv_area / area).astype(np.float32),
            mesh.layer[faces[:, 2]],
            mesh.gloss[faces[:, 2]],
        )

    def taken(self, index: npt.NDArray[Any]) -> _Surfaces:
        return _Surfaces(
            *(np.take(getattr(self, name), index, axis=0) for name in ("values", "own_normals")),
            *(np.take(getattr(self, name), index) for name in ("density", "layer", "gloss")),
        )

    def put(self, index: npt.NDArray[Any], other: _Surfaces) -> None:
        """Writes the rows of `other` over these."""
        for name in ("values", "own_normals", "density", "layer", "gloss"):
            getattr(self, name)[index] = getattr(other, name)


class _Crowd:
    """The actors, moved into place for one view at a time.

    Attributes:
        scene: embree's scene of those that are shown; None where there are none.
        surfaces: of its triangles.
        ids: (t,) instance of each triangle.
    """

    def __init__(self, actors: tuple[Mesh, ...]) -> None:
        self._actors = actors
        self._key: tuple[bytes, bytes] | None = None
        self.scene: Any = None
        self.surfaces = _Surfaces.of(merged([]))
        self.ids = np.zeros(0, dtype=np.uint16)

    def move(self, view: View) -> None:
        shown = np.ones(len(self._actors), dtype=np.bool_) if view.shown is None else view.shown
        key = (shown.tobytes(), view.global_from_actor[shown].tobytes())
        if key == self._key:
            return
        self._key = key
        there = np.flatnonzero(shown).tolist()
        meshes = [self._actors[index].placed(view.global_from_actor[index]) for index in there]
        self.scene = None
        if not any(len(mesh.triangles) for mesh in meshes):
            return
        whole = merged(meshes)
        counts = [len(mesh.triangles) for mesh in meshes]
        self.ids = np.repeat(np.array(there, dtype=np.uint16) + np.uint16(FIRST_ACTOR_ID), counts)
        self.surfaces = _Surfaces.of(whole)
        self.scene = ray_scene(whole.positions_m, whole.triangles)


class _Atlas:
    """All mip levels of all textures in one picture, for OpenCV's bilinear gather.

    Attributes:
        side: of the finest level, in texels.
    """

    def __init__(self, chain: list[npt.NDArray[np.uint8]]) -> None:
        self.side = chain[0].shape[1]
        self._sides = np.array([level.shape[1] for level in chain])
        self._columns = np.cumsum(self._sides + 2) - self._sides - 1
        layers = len(chain[0])
        self._picture = np.zeros((layers * (self.side + 2), int((self._sides + 2).sum()), 3), dtype=np.uint8)
        for level, column in zip(chain, self._columns, strict=True):
            side = level.shape[1]
            ringed = np.pad(level, ((0, 0), (1, 1), (1, 1), (0, 0)), mode="wrap")
            for index in range(layers):
                row = index * (side + 2)
                self._picture[row : row + side + 2, column - 1 : column + side + 1] = ringed[index]

    def look(self, uv: Array, layers: npt.NDArray[Any], level: Array) -> Array:
        """(3, n) trilinear square roots of linear RGB at places (2, n) of layers (n,) at mip levels (n,)."""
        level = np.clip(level, 0, len(self._sides) - 1)
        lower = level.astype(np.int32)
        share = level - lower
        inside = uv - np.floor(uv)
        low = self._gather(inside, layers, lower)
        high = self._gather(inside, layers, np.minimum(lower + 1, len(self._sides) - 1))
        mixed: Array = (low + (high - low) * share) * np.float32(1 / 255)
        return mixed

    def _gather(self, inside: Array, layers: npt.NDArray[Any], level: npt.NDArray[np.int32]) -> Array:
        count = inside.shape[1]
        rows = -(-count // _FOLD)
        sides = self._sides[level].astype(np.float32)
        places = np.zeros((2, rows * _FOLD), dtype=np.float32)
        places[0, :count] = inside[0] * sides + (self._columns[level] - 0.5).astype(np.float32)
        places[1, :count] = inside[1] * sides + (layers * (sides + 2) + np.float32(0.5)).astype(np.float32)
        x, y = places.reshape(2, rows, _FOLD)
        texels = cv2.remap(self._picture, x, y, cv2.INTER_LINEAR).reshape(-1, 3)[:count]
        gathered: Array = np.ascontiguousarray(texels.T).astype(np.float32)
        return gathered
