"""Road users: each fills its box exactly, is closed and lit from outside, and no two seeds look the same."""

from __future__ import annotations

from collections import Counter
from functools import lru_cache

import numpy as np
import pytest

from unidrive_cli.errors import UnidriveError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.actors import KINDS, ActorModel, make_actor
from unidrive_cli.synth.mesh import Mesh
from unidrive_cli.synth.textures import LAYERS

SEEDS = range(12)
VARIANTS = [
    *((kind, True, True) for kind in KINDS),
    *((kind, False, True) for kind in ("motorcycle", "bicycle")),
    ("pedestrian", True, False),
]
BUDGET = {"car": 3000, "bus": 3000, "truck": 3000, "motorcycle": 2500, "bicycle": 2500, "pedestrian": 1500}
SIZES_WLH = {  # ridden, walking
    "car": ((1.7, 2.1), (3.9, 5.0), (1.4, 1.9)),
    "bus": ((2.5, 2.9), (10.0, 12.5), (2.9, 3.5)),
    "truck": ((2.2, 2.6), (6.0, 10.0), (2.6, 3.6)),
    "motorcycle": ((0.7, 0.85), (2.0, 2.2), (1.4, 1.95)),
    "bicycle": ((0.55, 0.65), (1.65, 1.85), (1.55, 2.0)),
    "pedestrian": ((0.5, 0.75), (0.5, 0.9), (1.55, 1.95)),
}
PARKED_HEIGHT = {"motorcycle": (1.0, 1.35), "bicycle": (0.95, 1.15)}


@lru_cache
def actor(kind: str, rider: bool, walking: bool, seed: int) -> ActorModel:
    return make_actor(kind, np.random.default_rng(seed), rider=rider, walking=walking)


def models(kind: str, rider: bool, walking: bool) -> list[ActorModel]:
    return [actor(kind, rider, walking, seed) for seed in SEEDS]


def facing(mesh: Mesh) -> tuple[Float, Float]:
    """Unit normals of the triangles by the right-hand rule, and their areas."""
    corners = mesh.positions_m.astype(np.float64)[mesh.triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(crosses, axis=1)
    return crosses / np.maximum(doubled, 1e-15)[:, None], doubled / 2


@pytest.mark.parametrize(("kind", "rider", "walking"), VARIANTS)
class TestEveryActor:
    def test_fills_its_box_to_the_last_bit(self, kind: str, rider: bool, walking: bool) -> None:
        for model in models(kind, rider, walking):
            width, length, height = model.size_wlh_m
            half = np.array([length, width, height]) / 2
            np.testing.assert_allclose(model.mesh.positions_m.max(axis=0), half, rtol=0, atol=1e-6)
            np.testing.assert_allclose(model.mesh.positions_m.min(axis=0), -half, rtol=0, atol=1e-6)

    def test_only_wheels_and_feet_touch_the_ground(self, kind: str, rider: bool, walking: bool) -> None:
        for model in models(kind, rider, walking):
            low = model.mesh.positions_m[:, 2] < -model.size_wlh_m[2] / 2 + 0.01
            assert low.any()
            spread = np.ptp(model.mesh.positions_m[low, 0])
            assert spread > (0.1 if kind == "pedestrian" else 0.4 * model.size_wlh_m[1])

    def test_keeps_to_its_budget(self, kind: str, rider: bool, walking: bool) -> None:
        for model in models(kind, rider, walking):
            assert 500 < len(model.mesh.triangles) <= BUDGET[kind], model.look

    def test_is_a_sound_mesh(self, kind: str, rider: bool, walking: bool) -> None:
        for model in models(kind, rider, walking):
            mesh = model.mesh
            count = len(mesh.positions_m)
            assert mesh.positions_m.dtype == mesh.normals.dtype == mesh.albedo.dtype == np.float32
            assert mesh.triangles.dtype == mesh.layer.dtype == np.int32
            assert mesh.positions_m.shape == mesh.normals.shape == mesh.albedo.shape == (count, 3)
            assert mesh.uv.shape == (count, 2)
            assert mesh.layer.shape == mesh.gloss.shape == (count,)
            assert mesh.triangles.min() == 0
            assert mesh.triangles.max() == count - 1
            assert len(np.unique(mesh.triangles)) == count  # no vertex that no triangle uses
            for array in (mesh.positions_m, mesh.normals, mesh.uv, mesh.albedo, mesh.gloss):
                assert np.isfinite(array).all()
            np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
            assert mesh.albedo.min() >= 0
            assert mesh.albedo.max() <= 1
            assert mesh.gloss.min() >= 0
            assert mesh.gloss.max() <= 1
            assert set(mesh.layer) <= set(range(len(LAYERS)))

    def test_normals_are_those_of_the_triangles_nearly(self, kind: str, rider: bool, walking: bool) -> None:
        for model in models(kind, rider, walking):
            normals, areas = facing(model.mesh)
            agree = np.sum(normals[:, None] * model.mesh.normals[model.mesh.triangles], axis=2)
            assert areas.min() > 1e-10
            assert (agree > 0).mean() > 0.995
            assert np.sum(areas[:, None] * (agree > 0.3)) > 0.97 * 3 * areas.sum()

    def test_triangles_look_outwards(self, kind: str, rider: bool, walking: bool) -> None:
        """By the divergence theorem; lamps and windows are open pieces on top, so it is a volume only roughly."""
        for model in models(kind, rider, walking):
            corners = model.mesh.positions_m.astype(np.float64)[model.mesh.triangles]
            crosses = np.cross(corners[:, 1], corners[:, 2])
            volume = float(np.sum(corners[:, 0] * crosses)) / 6
            assert 0.004 < volume / np.prod(model.size_wlh_m) < 1.5

    def test_nothing_looks_hollow(self, kind: str, rider: bool, walking: bool) -> None:
        """From four sides and two corners, what is seen first shows its outer face."""
        towards = np.array([(1, 0, 0.1), (-1, 0, 0.1), (0.1, 1, 0.1), (0.1, 0.1, 1), (1, -1, 0.4), (-1, -1, 0.4)])
        for model in models(kind, rider, walking)[:1]:
            for direction in towards:
                assert inner_share(model.mesh, direction / np.linalg.norm(direction)) < 0.015, (
                    model.look,
                    direction,
                )

    def test_same_seed_same_bytes(self, kind: str, rider: bool, walking: bool) -> None:
        for seed in SEEDS[:3]:
            first = actor(kind, rider, walking, seed)
            again = make_actor(kind, np.random.default_rng(seed), rider=rider, walking=walking)
            assert (again.kind, again.look, again.size_wlh_m) == (first.kind, first.look, first.size_wlh_m)
            for name in ("positions_m", "normals", "uv", "albedo", "layer", "gloss", "triangles"):
                assert getattr(again.mesh, name).tobytes() == getattr(first.mesh, name).tobytes()

    def test_seeds_differ(self, kind: str, rider: bool, walking: bool) -> None:
        many = models(kind, rider, walking)
        assert len({model.size_wlh_m for model in many}) == len(many)
        assert len({model.look for model in many}) > 1
        assert len({model.mesh.albedo.tobytes() for model in many}) == len(many)

    def test_sizes_are_in_range_and_in_whole_millimetres(self, kind: str, rider: bool, walking: bool) -> None:
        limits = list(SIZES_WLH[kind])
        if not rider:
            limits[2] = PARKED_HEIGHT[kind]
        for model in models(kind, rider, walking):
            assert model.kind == kind
            for side, (low, high) in zip(model.size_wlh_m, limits, strict=True):
                assert low <= side <= high, (model.look, model.size_wlh_m)
                assert side == round(side, 3)


def inner_share(mesh: Mesh, direction: Float, side_px: int = 48) -> float:
    """Share of a picture of a mesh, seen along a direction without perspective, that shows inner faces.

    A painter's depth buffer of side_px x side_px pixels, filled triangle by triangle.
    """
    right = np.cross(direction, (0.0, 0.0, 1.0) if abs(direction[2]) < 0.9 else (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, direction), direction], axis=1)
    seen = mesh.positions_m.astype(np.float64) @ axes
    low, high = seen.min(axis=0), seen.max(axis=0)
    flat = (seen[:, :2] - low[:2]) / (high - low)[:2] * side_px
    nearest, inner = np.full((side_px, side_px), -np.inf), np.zeros((side_px, side_px), dtype=bool)
    normals, _ = facing(mesh)
    away = normals @ direction < -1e-3
    for face, triangle in enumerate(mesh.triangles):
        a, b, c = flat[triangle]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-9:
            continue
        first = np.maximum(np.floor(flat[triangle].min(axis=0) - 0.5).astype(int), 0)
        last = np.minimum(np.ceil(flat[triangle].max(axis=0)).astype(int), side_px)
        x, y = np.meshgrid(np.arange(first[0], last[0]) + 0.5, np.arange(first[1], last[1]) + 0.5)
        second = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        third = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        depth = (
            seen[triangle[0], 2] * (1 - second - third)
            + seen[triangle[1], 2] * second
            + seen[triangle[2], 2] * third
        )
        part = slice(first[1], last[1]), slice(first[0], last[0])
        front = (second >= 0) & (third >= 0) & (second + third <= 1) & (depth > nearest[part])
        nearest[part] = np.where(front, depth, nearest[part])
        inner[part] = np.where(front, away[face], inner[part])
    return float(inner.sum() / np.isfinite(nearest).sum())


def test_cars_come_in_the_colours_of_the_road() -> None:
    """White, grey, black and silver are the most of them, but not all."""
    spreads = []
    for seed in range(40):
        mesh = actor("car", True, True, seed).mesh
        body = mesh.albedo[(mesh.gloss > 0.105) & (mesh.gloss < 0.115)]
        paint = np.median(body, axis=0)
        spreads.append((paint.max() - paint.min()) / paint.max())
    coloured = np.mean(np.array(spreads) > 0.3)
    assert 0.1 < coloured < 0.6


def test_all_looks_of_cars_turn_up() -> None:
    looks = Counter(actor("car", True, True, seed).look for seed in range(40))
    assert set(looks) == {"hatchback", "saloon", "estate", "suv", "van"}


@pytest.mark.parametrize("kind", ["motorcycle", "bicycle"])
def test_a_rider_sits_on_top(kind: str) -> None:
    for seed in SEEDS:
        ridden, parked = actor(kind, True, True, seed), actor(kind, False, True, seed)
        assert ridden.look == parked.look
        assert ridden.size_wlh_m[:2] == parked.size_wlh_m[:2]
        assert ridden.size_wlh_m[2] > parked.size_wlh_m[2] + 0.25


def test_who_walks_takes_more_room_than_who_stands() -> None:
    for seed in SEEDS:
        assert (
            actor("pedestrian", True, True, seed).size_wlh_m[1]
            > actor("pedestrian", True, False, seed).size_wlh_m[1]
        )


def test_an_unknown_class_is_an_error_sentence() -> None:
    with pytest.raises(UnidriveError, match=r"There is no class of actors 'busses'\. Did you mean bus\?"):
        make_actor("busses", np.random.default_rng(0))
    with pytest.raises(UnidriveError, match=r"Use one of car, bus, truck"):
        make_actor("zeppelin", np.random.default_rng(0))
