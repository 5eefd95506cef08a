"""The two renderers against closed forms, and against each other."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from unidrive_cli.errors import GeometryError, UnidriveError, UsageError
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import EGO_FROM_LEVEL_CAM
from unidrive_cli.synth import gl_renderer, light
from unidrive_cli.synth.gl_renderer import GlRenderer, gl_missing
from unidrive_cli.synth.mesh import Mesh, merged, mesh_of
from unidrive_cli.synth.ray_renderer import RayRenderer
from unidrive_cli.synth.renderers import open_renderer, renderer_name
from unidrive_cli.synth.stage import FIRST_ACTOR_ID, GROUND_ID, SKY_ID, STRUCTURE_ID, Day, Renderer, Stage, View
from unidrive_cli.synth.textures import LAYERS, SIDE_PX, layer, make_textures

LENS = Pinhole(514.2, 521.8, 322.3, 171.6, 641, 359)
"""Odd sizes, an off-centre principal point, two focal lengths."""
TO_SUN = tuple(np.array([-0.5, -0.42, 0.62]) / np.linalg.norm([-0.5, -0.42, 0.62]))
DAY = Day(TO_SUN, (1.0, 0.92, 0.78), (0.16, 0.30, 0.62), (0.62, 0.70, 0.80), 0.5, 700.0)


def gl_or_skip(stage: Stage) -> Renderer:
    missing = gl_missing()
    if missing is not None:
        pytest.skip(missing)
    return GlRenderer(stage)


def opened(which: str, stage: Stage) -> Renderer:
    return gl_or_skip(stage) if which == "gl" else RayRenderer(stage)


def cam_at(x: float, y: float, z: float, yaw_deg: float = 0, pitch_deg: float = 0) -> Any:
    """global_from_cam of a camera that looks along x, then turned left and up."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    left = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    up = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
    pose = np.eye(4)
    pose[:3, :3] = left @ up @ EGO_FROM_LEVEL_CAM
    pose[:3, 3] = x, y, z
    return pose


def at(x: float, y: float, z: float, yaw_deg: float = 0) -> Any:
    pose = np.eye(4)
    yaw = np.radians(yaw_deg)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = x, y, z
    return pose


def no_actors() -> Any:
    return np.zeros((0, 4, 4))


def plate(low: Any, high: Any, z: float, name: str = "asphalt", albedo: Any = 0.4) -> Mesh:
    """A level rectangle, seen from above."""
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]], dtype=float)
    positions = np.column_stack([corners, np.full(4, z)])
    return mesh_of(positions, [[0, 1, 2], [0, 2, 3]], layer=layer(name), albedo=np.full(3, albedo), uv=corners / 4)


def block(low: Any, high: Any, name: str = "plain", albedo: Any = (1, 1, 1), gloss: float = 0.0) -> Mesh:
    """A box with textures on all sides."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    faces = []
    for axis in range(3):
        for side in (0, 1):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            corners = np.zeros((4, 3))
            corners[:, axis] = (low, high)[side][axis]
            corners[:, a] = [low[a], high[a], high[a], low[a]]
            corners[:, b] = [low[b], low[b], high[b], high[b]]
            if not side:
                corners = corners[::-1]
            faces.append(
                mesh_of(
                    corners,
                    [[0, 1, 2], [0, 2, 3]],
                    layer=layer(name),
                    albedo=albedo,
                    uv=corners[:, [a, b]] / 4,
                    gloss=gloss,
                )
            )
    return merged(faces)


def ball(radius_m: float, size: Any = (1, 1, 1), steps: int = 4, **material: Any) -> Mesh:
    """A smooth ball of triangles, stretched to `size`."""
    trimesh = pytest.importorskip("trimesh")
    sphere = trimesh.creation.icosphere(subdivisions=steps)
    positions = sphere.vertices * radius_m * np.asarray(size)
    normals = sphere.vertices / np.asarray(size)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return mesh_of(positions, sphere.faces, normals=normals, uv=positions[:, :2], **material)


def rough(mesh: Mesh, seed: int) -> Mesh:
    """A ball turned into a crown of leaves: dented, with flat sides."""
    rng = np.random.default_rng(seed)
    positions = mesh.positions_m * rng.uniform(0.8, 1.25, (len(mesh.positions_m), 1))
    return mesh_of(positions, mesh.triangles, layer=layer("leaves"), albedo=(0.25, 0.5, 0.15))


def moved(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    return mesh.placed(at(x, y, z))


@pytest.fixture(scope="module")
def textures() -> Any:
    return make_textures(0)


@pytest.fixture(scope="module")
def street(textures: Any) -> tuple[Stage, View]:
    """A street with all that the shading knows (varied ground, gloss, leaves, clouds), 300 m from the origin."""
    x0, y0 = 300.0, -200.0
    ground = [plate((x0 - 100, y0 - 100), (x0 + 300, y0 + 100), 0)]
    ground += [plate((x0 + x, y0 + 1.7), (x0 + x + 3, y0 + 1.85), 0.005, "marking", 0.9) for x in range(-60, 150, 6)]
    ground += [
        plate((x0 - 100, y0 + side - 2), (x0 + 300, y0 + side + 2), 0.06, "paving", 0.5) for side in (-10, 10)
    ]
    structures = []
    for number, x in enumerate(range(-40, 160, 20)):
        names = ("brick", "plaster", "facade_flats", "facade_glass")
        gloss = 0.08 if number % 4 == 3 else 0.0
        for side in (-1, 1):
            low, high = sorted((side * 12.0, side * 24.0))
            tall = 7 + 5 * ((number * 7 + side) % 4)
            structures.append(
                block(
                    (x0 + x, y0 + low, 0), (x0 + x + 17, y0 + high, tall), names[number % 4], (0.8, 0.75, 0.7), gloss
                )
            )
    for number, x in enumerate(range(-30, 120, 15)):
        for side in (-9, 9):
            trunk = block((-0.15, -0.15, 0), (0.15, 0.15, 3), "bark", (0.4, 0.3, 0.2))
            crown = rough(ball(1.6, steps=2, layer=0), 100 + 20 * number + side)
            structures += [moved(trunk, x0 + x, y0 + side, 0), moved(crown, x0 + x, y0 + side, 4)]
    rng = np.random.default_rng(5)
    actors, poses = [], []
    for number in range(9):
        size = (2.2, 0.9, 0.75) if number % 3 else (0.3, 0.3, 0.87)
        gloss = 0.06 if number % 3 else 0.0
        actors.append(ball(1.0, size, 3, layer=layer("plain"), albedo=rng.uniform(0.05, 0.8, 3), gloss=gloss))
        poses.append(at(x0 + 6 + 3.6 * number, y0 + rng.uniform(-5, 5), size[2], rng.uniform(-180, 180)))
    stage = Stage(merged(ground), merged(structures), tuple(actors), textures, DAY)
    return stage, View(LENS, cam_at(x0 - 3, y0 + 0.4, 1.6, 4, -1), np.array(poses))


@pytest.fixture(scope="module")
def pair(street: tuple[Stage, View]) -> Iterator[tuple[Renderer, Renderer]]:
    """Both renderers of the street."""
    both = gl_or_skip(street[0]), RayRenderer(street[0])
    yield both
    for renderer in both:
        renderer.close()


def psnr_db(a: Any, b: Any) -> float:
    error = a.astype(float) - b.astype(float)
    return float(10 * np.log10(255**2 / np.mean(error * error)))


def outline_centre(lens: Pinhole, centre_cam: Any, radius_m: float) -> Any:
    """Centre of the ellipse that a sphere's outline is in the picture.

    The rays r that touch the sphere make the cone (c . r)^2 = (|c|^2 - radius^2) |r|^2; seen through K it is
    a conic, whose centre is where its gradient is zero.
    """
    cone = np.outer(centre_cam, centre_cam) - (centre_cam @ centre_cam - radius_m**2) * np.eye(3)
    back = np.linalg.inv(lens.matrix)
    conic = back.T @ cone @ back
    return np.linalg.solve(conic[:2, :2], -conic[:2, 2])


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_markers_lie_where_the_closed_form_puts_them(which: str, textures: Any) -> None:
    """Black balls before an even sky: how dark a pixel is says how much of it the ball covers."""
    rng = np.random.default_rng(1)
    camera = cam_at(701.37, -433.21, 1.62, 123.4, -2.5)
    centres, radii = [], []
    for column in range(8):
        for row in range(5):
            pixel = np.array([45 + 78 * column, 36 + 70 * row]) + rng.uniform(-9, 9, 2)
            depth = float(rng.choice([0.8, 2.5, 9.0, 40.0, 160.0]))
            centres.append(depth * np.append((pixel - [LENS.cx_px, LENS.cy_px]) / [LENS.fx_px, LENS.fy_px], 1))
            radii.append(depth * 0.012)
    actors = tuple(ball(radius, layer=0, albedo=(0.0, 0.0, 0.0)) for radius in radii)
    poses = np.stack([np.eye(4)] * len(radii))
    poses[:, :3, 3] = np.array(centres) @ camera[:3, :3].T + camera[:3, 3]
    even = Day((0, 0, 1), (0, 0, 0), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5), 0.0, 1e9)
    renderer = opened(which, Stage(merged([]), merged([]), actors, textures, even))
    picture = renderer.picture(View(LENS, camera, poses), 16)
    ids, depths = renderer.instances(View(LENS, camera, poses))
    renderer.close()
    steps = np.linspace(0, 1, 65536, dtype=np.float32)
    linear = np.interp(picture[..., 1], light.encoded(steps), steps)
    covered = 1 - linear / linear.max()
    for number, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        expected = outline_centre(LENS, centre, radius)
        left, top = np.rint(expected).astype(int) - 15
        box = slice(top, top + 31), slice(left, left + 31)
        rows, columns = np.mgrid[box]
        weight = covered[box]
        assert weight.sum() > 100
        found = [(columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()]
        np.testing.assert_allclose(found, expected, atol=0.03)
        mine = ids == FIRST_ACTOR_ID + number
        assert mine.sum() == pytest.approx(weight.sum(), rel=0.06)
        assert depths[mine].min() == pytest.approx(centre[2] - radius, rel=2e-3)


def test_the_two_renderers_see_the_same_things(street: tuple[Stage, View], pair: tuple[Renderer, Renderer]) -> None:
    (ids, depths), (ids_rays, depths_rays) = (renderer.instances(street[1]) for renderer in pair)
    assert ids.dtype == ids_rays.dtype == np.uint16
    assert depths.dtype == depths_rays.dtype == np.float32
    counted = 0
    for value in np.unique(ids_rays):
        here, there = ids == value, ids_rays == value
        if there.sum() > 400:
            counted += 1
            assert (here & there).sum() / (here | there).sum() > 0.99
    assert counted >= 8
    same = ids == ids_rays
    assert same.mean() > 0.999
    np.testing.assert_array_equal(np.isinf(depths[same]), ids[same] == SKY_ID)
    solid = same & (ids != SKY_ID)
    error = np.abs(depths[solid] - depths_rays[solid])
    assert np.quantile(error, 0.999) < 0.003


@pytest.mark.parametrize("samples", [1, 4, 16])
def test_the_two_renderers_draw_the_same_picture(
    street: tuple[Stage, View], pair: tuple[Renderer, Renderer], samples: int
) -> None:
    drawn, cast = (renderer.picture(street[1], samples) for renderer in pair)
    assert drawn.shape == cast.shape == (LENS.height_px, LENS.width_px, 3)
    assert drawn.dtype == cast.dtype == np.uint8
    assert psnr_db(drawn, cast) > 40


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_same_bytes_from_a_new_renderer_whatever_it_drew_before(which: str, street: tuple[Stage, View]) -> None:
    stage, view = street
    elsewhere = replace(
        view, global_from_cam=cam_at(390, -201, 1.6, 170), global_from_actor=view.global_from_actor[::-1]
    )
    used, fresh = opened(which, stage), opened(which, stage)
    used.picture(elsewhere, 1)
    used.instances(replace(view, shown=np.zeros(len(stage.actors), dtype=bool)))
    used.picture(replace(view, shown=np.zeros(len(stage.actors), dtype=bool)), 4)
    np.testing.assert_array_equal(used.picture(view, 4), fresh.picture(view, 4))
    for one, other in zip(used.instances(view), fresh.instances(view), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(used.picture(view, 1), fresh.picture(view, 1))
    used.close()
    fresh.close()


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_an_actor_that_is_not_shown_leaves_no_trace(which: str, street: tuple[Stage, View]) -> None:
    stage, view = street
    kept = np.arange(len(stage.actors)) % 2 == 1
    fewer = replace(stage, actors=tuple(actor for actor, there in zip(stage.actors, kept, strict=True) if there))
    hidden, absent = opened(which, stage), opened(which, fewer)
    fewer_view = replace(view, global_from_actor=view.global_from_actor[kept])
    hidden_view = replace(view, shown=kept)
    np.testing.assert_array_equal(hidden.picture(hidden_view, 1), absent.picture(fewer_view, 1))
    ids = hidden.instances(hidden_view)[0]
    assert set(np.unique(ids[ids >= FIRST_ACTOR_ID]) - FIRST_ACTOR_ID) <= set(np.flatnonzero(kept))
    hidden.close()
    absent.close()


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_a_marking_5_mm_above_the_road_is_whole_100_m_away(which: str, textures: Any) -> None:
    """Nothing of the road shows through, and the marking's rows are where z = 5 mm puts them."""
    marking = plate((90, -10), (110, 10), 0.005)
    stage = Stage(plate((-500, -500), (500, 500), 0), marking, (), textures, DAY)
    lens = Pinhole(1266, 1266, 799.5, 100.0, 1600, 200)
    renderer = opened(which, stage)
    ids, depths = renderer.instances(View(lens, cam_at(0, 0, 1.5), no_actors()))
    renderer.close()
    first, last = (lens.cy_px + lens.fy_px * (1.5 - 0.005) / x for x in (110, 90))
    inside = ids[int(np.ceil(first)) : int(np.floor(last)) + 1, 700:900]
    assert inside.shape[0] >= 3
    assert (inside == STRUCTURE_ID).all()
    assert (ids[int(np.floor(first)), 700:900] == GROUND_ID).all()
    assert (ids[int(np.ceil(last)), 700:900] == GROUND_ID).all()
    assert (depths[:100] == np.inf).all()
    row = int(np.ceil(last)) + 20
    np.testing.assert_allclose(depths[row], lens.fy_px * 1.5 / (row - lens.cy_px), rtol=1e-4)


def test_what_shows_through_a_slit_is_drawn_and_what_is_hidden_is_known_to_be(textures: Any) -> None:
    """A wall 10 m away with a slit 3 pixels wide; behind it a post in line with the slit, and two that it hides."""
    slit_m = 0.03
    wall = merged([block((10, low, -1), (10.3, high, 9)) for low, high in ((-30, -slit_m), (slit_m, 30))])
    posts = tuple(block((-0.4, -0.4, 0), (0.4, 0.4, 4)) for _ in range(3))
    poses = np.array([at(60, 0, 0), at(60, 9, 0), at(90, 20, 0)])
    stage = Stage(plate((-50, -200), (200, 200), 0), wall, posts, textures, DAY)
    view = View(LENS, cam_at(0, 0, 1.6), poses)
    drawn, cast = gl_or_skip(stage), RayRenderer(stage)
    (ids, depths), (ids_rays, _) = drawn.instances(view), cast.instances(view)
    picture = drawn.picture(view, 4)
    drawn.close()
    assert set(np.unique(ids)) == set(np.unique(ids_rays)) == {SKY_ID, GROUND_ID, STRUCTURE_ID, FIRST_ACTOR_ID}
    assert (ids == ids_rays).mean() > 0.999
    assert depths[ids == FIRST_ACTOR_ID].min() == pytest.approx(59.6, abs=1e-2)
    assert psnr_db(picture, cast.picture(view, 4)) > 40


def test_a_box_is_hidden_only_where_all_before_it_is_nearer() -> None:
    """Depth 0.5 in two squares of a row of three, nothing in the third."""
    deepest = np.array([[0.5, 0.5, 1.0]], dtype=np.float32)
    squares = np.array([2.5, 1.0])  # the last square reaches out of the picture
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)

    def box(left: float, right: float, near: float) -> Any:
        """Window coordinates in squares, depths 0 to 1, for a projection that divides by 1."""
        low = np.array([left / 2.5 * 2 - 1, -0.5, 2 * near - 1])
        high = np.array([right / 2.5 * 2 - 1, 0.5, 0.9])
        return (low + high) / 2 + signs * (high - low) / 2

    boxes = np.array([box(0.2, 1.8, 0.51), box(0.2, 1.8, 0.49), box(0.2, 2.2, 0.51), box(2.2, 2.4, 0.6)])
    hidden = gl_renderer._hidden(boxes, np.eye(4), squares, deepest)
    np.testing.assert_array_equal(hidden, [True, False, False, False])


@pytest.mark.parametrize("which", ["gl", "rays"])
@pytest.mark.parametrize("caster", ["structure", "actor"])
def test_shadows_lie_where_the_sun_puts_them(which: str, caster: str, textures: Any) -> None:
    """A plate 2 m above white ground: its shadow is the plate, moved by 2 m / tan(height) away from the sun."""
    cover = block((-1, -1, -0.05), (1, 1, 0.05))
    ground = plate((-50, -50), (50, 50), 0, "plain")
    pose = at(10, 0, 2.05)
    structures = cover.placed(pose) if caster == "structure" else merged([])
    actors = (cover,) if caster == "actor" else ()
    stage = Stage(ground, structures, actors, textures, replace(DAY, cloud=0.0))
    view = View(LENS, cam_at(4, 0, 6, 0, -45), np.array([pose])[: len(actors)].reshape(-1, 4, 4))
    renderer = opened(which, stage)
    picture = renderer.picture(view, 1)
    ids = renderer.instances(view)[0]
    renderer.close()
    xs, ys = np.meshgrid(np.linspace(7.5, 14.5, 60), np.linspace(-3.5, 3.5, 60))
    places = np.stack([xs.ravel(), ys.ravel(), 0 * xs.ravel()], axis=-1)
    rotation, eye = view.global_from_cam[:3, :3], view.global_from_cam[:3, 3]
    pixels, seen = LENS.project((places - eye) @ rotation)
    columns, rows = np.rint(pixels[seen]).astype(int).T
    inside_picture = (rows < LENS.height_px) & (columns < LENS.width_px)
    columns, rows, places = columns[inside_picture], rows[inside_picture], places[seen][inside_picture]
    back = places[:, :2] + 2 / TO_SUN[2] * np.array(TO_SUN[:2]) - [10, 0]
    depth = np.abs(back).max(axis=1) - 1
    on_ground = ids[rows, columns] == GROUND_ID
    brightness = picture[rows, columns].mean(axis=1)
    shaded, sunny = on_ground & (depth < -0.1), on_ground & (depth > 0.15)
    assert shaded.sum() > 50
    assert sunny.sum() > 300
    assert brightness[shaded].max() < 0.8 * brightness[sunny].min()


def test_where_the_ground_meets_a_wall_the_shadow_begins_at_once(textures: Any) -> None:
    """No light leaks under a wall in either renderer: the same picture right at its foot."""
    wall = block((5, -6, 0), (5.3, 6, 3))
    sun_behind = replace(DAY, to_sun=(0.6, 0.0, 0.8), cloud=0.0)
    stage = Stage(plate((-50, -50), (50, 50), 0, "plain"), wall, (), textures, sun_behind)
    view = View(LENS, cam_at(0, 0, 1.6, 0, -12), no_actors())
    drawn = gl_or_skip(stage)
    pictures = drawn.picture(view, 4).astype(int), RayRenderer(stage).picture(view, 4).astype(int)
    drawn.close()
    foot = int(LENS.cy_px + LENS.fy_px * np.tan(np.arctan2(1.6, 5) - np.radians(12)))
    strip = slice(foot - 6, foot + 12), slice(200, 440)
    assert np.abs(pictures[0][strip] - pictures[1][strip]).max() < 12


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_an_empty_stage_is_all_sky(which: str, textures: Any) -> None:
    stage = Stage(merged([]), merged([]), (), textures, replace(DAY, cloud=0.0))
    renderer = opened(which, stage)
    view = View(LENS, cam_at(0, 0, 1.5), no_actors())
    ids, depths = renderer.instances(view)
    picture = renderer.picture(view, 1)
    renderer.close()
    assert (ids == SKY_ID).all()
    assert np.isinf(depths).all()
    below = light.encoded(light.exposed(np.array(DAY.horizon, dtype=np.float32)))[::-1]
    away_from_the_sun = picture[LENS.height_px - 5, LENS.width_px // 2].astype(int)
    assert np.abs(away_from_the_sun - below).max() <= 1


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_sides_are_seen_from_behind_too(which: str, textures: Any) -> None:
    """Two triangles facing away are there, and lit as if they faced the camera."""
    corners = np.array([[8, -3, 0], [8, 3, 0], [8, 3, 5], [8, -3, 5]], dtype=float)
    pictures = []
    for triangles in ([[0, 1, 2], [0, 2, 3]], [[0, 2, 1], [0, 3, 2]]):
        wall = mesh_of(corners, triangles, layer=layer("plain"), albedo=(0.5, 0.5, 0.5))
        stage = Stage(merged([]), wall, (), textures, DAY)
        renderer = opened(which, stage)
        view = View(LENS, cam_at(0, 0, 1.5), no_actors())
        assert (renderer.instances(view)[0] == STRUCTURE_ID).any()
        pictures.append(renderer.picture(view, 1).astype(int))
        renderer.close()
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_two_gl_renderers_do_not_disturb_each_other(street: tuple[Stage, View]) -> None:
    stage, view = street
    one, other = gl_or_skip(stage), gl_or_skip(replace(stage, day=replace(DAY, cloud=0.9)))
    first = one.picture(view, 1)
    assert (other.picture(view, 1) != first).any()
    other.close()
    np.testing.assert_array_equal(one.picture(view, 1), first)
    one.close()


@pytest.mark.parametrize("which", ["gl", "rays"])
def test_only_1_4_or_16_samples(which: str, street: tuple[Stage, View]) -> None:
    renderer = opened(which, street[0])
    with pytest.raises(ValueError, match="1, 4 or 16"):
        renderer.picture(street[1], 2)
    renderer.close()


def test_auto_takes_gl_where_it_is(street: tuple[Stage, View]) -> None:
    if gl_missing() is not None:
        pytest.skip("no GL here")
    renderer = open_renderer(street[0])
    assert renderer.name.startswith("GL (")
    assert len(renderer.name) > 5
    assert renderer_name("auto") == renderer_name("gl") == ("gl", renderer.name)
    renderer.close()
    caster = open_renderer(street[0], "rays")
    assert caster.name.startswith("embree")
    assert renderer_name("rays") == ("rays", caster.name)


def test_without_gl_auto_casts_rays_and_gl_says_what_to_install(
    street: tuple[Stage, View], monkeypatch: pytest.MonkeyPatch
) -> None:
    moderngl = pytest.importorskip("moderngl")

    def no_library(**settings: Any) -> Any:
        raise OSError("libEGL.so.1 not loaded")

    monkeypatch.setattr(moderngl, "create_context", no_library)
    assert isinstance(open_renderer(street[0]), RayRenderer)
    assert renderer_name("auto")[0] == "rays"
    with pytest.raises(UsageError, match="apt install"):
        renderer_name("gl")
    with pytest.raises(UsageError, match=r"libEGL.so.1 not loaded.*apt install libegl1 libgl1-mesa-dri"):
        open_renderer(street[0], "gl")
    missing = gl_missing()
    assert missing is not None
    assert "apt install" in missing


def test_without_moderngl_the_package_is_named(street: tuple[Stage, View], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(UsageError, match="pip install moderngl"):
        open_renderer(street[0], "gl")
    assert isinstance(open_renderer(street[0]), RayRenderer)


def test_without_embreex_the_package_is_named(street: tuple[Stage, View], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    with pytest.raises(UnidriveError, match="pip install embreex"):
        open_renderer(street[0], "rays")


def test_broken_gl_shaders_are_not_hidden(street: tuple[Stage, View], monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a missing context makes auto cast rays; a fault of ours is an error."""
    if gl_missing() is not None:
        pytest.skip("no GL here")

    def broken(*args: Any, **switches: Any) -> Any:
        raise RuntimeError("shader")

    monkeypatch.setattr(gl_renderer, "_program", broken)
    with pytest.raises(RuntimeError, match="shader"):
        open_renderer(street[0])


# The formulas


def test_a_white_wall_facing_the_sun_returns_the_sun_and_the_sky() -> None:
    lamp = light.Light.of(DAY)
    normal = np.array(TO_SUN, dtype=np.float32)[:, None]
    one, none = np.ones(1, dtype=np.float32), np.zeros(1, dtype=np.float32)
    white = np.ones((3, 1), dtype=np.float32)
    direct = light.sunlight(lamp, normal, np.array([False]))
    assert direct[0] == pytest.approx(1, abs=1e-6)
    lit, shaded = (light.shade(lamp, white, normal, -normal, none, direct, seen) for seen in (one, none))
    np.testing.assert_allclose(lit - shaded, np.array(DAY.sun)[:, None], rtol=1e-5)
    assert (shaded > 0).all()


def test_a_leaf_lets_light_through_and_a_wall_does_not() -> None:
    lamp = light.Light.of(DAY)
    away = -np.array(TO_SUN, dtype=np.float32)[:, None]
    assert light.sunlight(lamp, away, np.array([False]))[0] == 0
    assert light.sunlight(lamp, away, np.array([True]))[0] == pytest.approx(light.LEAF_TRANSMISSION, abs=1e-6)


def test_a_full_mirror_shows_the_zenith_straight_up() -> None:
    lamp = light.Light.of(replace(DAY, to_sun=(1.0, 0.0, 0.0)))
    up = np.array([[0], [0], [1]], dtype=np.float32)
    one, none = np.ones(1, dtype=np.float32), np.zeros(1, dtype=np.float32)
    seen = light.shade(lamp, 0 * up, up, -up, one, none, one)
    np.testing.assert_allclose(seen[:, 0], DAY.zenith, rtol=1e-5)


def test_a_sun_below_the_horizon_lights_nothing() -> None:
    assert not light.Light.of(replace(DAY, to_sun=(0.8, 0.0, -0.6))).sun.any()


def test_haze_takes_1_minus_1_over_e_at_its_distance() -> None:
    lamp = light.Light.of(DAY)
    seen = light.haze(lamp, np.zeros((3, 1), dtype=np.float32), np.array([DAY.haze_m], dtype=np.float32))
    np.testing.assert_allclose(seen[:, 0], (1 - np.exp(-1)) * np.array(DAY.horizon), rtol=1e-5)


def test_clear_sky_has_no_clouds_and_closed_sky_is_all_clouds() -> None:
    up = np.array([[0, 0.6], [0, 0], [1, 0.8]], dtype=np.float32)
    density = np.array([0.9, 0.3], dtype=np.float32)
    clear = light.Light.of(replace(DAY, cloud=0.0))
    np.testing.assert_array_equal(light.sky(clear, up, density), light.sky(clear, up, 0 * density))
    closed = light.sky(light.Light.of(replace(DAY, cloud=1.0)), up, density)
    other = light.sky(light.Light.of(replace(DAY, cloud=1.0, zenith=(0.16, 0.30, 0.62))), up, density)
    np.testing.assert_array_equal(closed, other)


def test_tones_rise_and_stay_below_one() -> None:
    values = np.linspace(0, 30, 4000, dtype=np.float32)
    tones = light.exposed(values)
    assert (np.diff(tones) >= 0).all()
    assert tones.max() <= 1
    np.testing.assert_allclose(tones[values < light.SHOULDER], values[values < light.SHOULDER], rtol=1e-6)


def test_the_srgb_curve_at_known_values() -> None:
    linear = np.array([0, 0.0021, 0.2140, 0.5, 1.0, 7.0], dtype=np.float32)
    np.testing.assert_array_equal(light.encoded(linear), [0, 7, 127, 188, 255, 255])


def test_mip_levels_are_means_of_four(textures: Any) -> None:
    chain = light.mip_chain(textures)
    assert [level.shape[1] for level in chain] == [SIDE_PX >> step for step in range(SIDE_PX.bit_length())]
    mean = chain[3].astype(float).reshape(len(LAYERS), 32, 2, 32, 2, 3).mean(axis=(2, 4))
    assert np.abs(chain[4] - mean).max() <= 0.5


def test_textures_of_another_form_are_refused() -> None:
    with pytest.raises(GeometryError, match="power of two"):
        light.mip_chain(np.zeros((len(LAYERS), 48, 48, 3), dtype=np.uint8))


def test_a_footprint_of_four_texels_takes_the_second_level() -> None:
    level = light.level_of_detail(np.array([4.0, 16.0], dtype=np.float32), np.ones(2, dtype=np.float32))
    np.testing.assert_allclose(level, np.array([1, 2]) + light.LOD_BIAS, atol=1e-6)
