"""Distorted pictures, against the closed form: a stage whose colour says where a ray goes."""

from __future__ import annotations

import numpy as np
import pytest

from unidrive_cli.geometry.lenses import Lens, Pinhole, lens_of
from unidrive_cli.geometry.poses import pose, rotation_from_yaw_pitch_roll, transform
from unidrive_cli.synth.actors import make_actor
from unidrive_cli.synth.lenses import Shots
from unidrive_cli.synth.mesh import merged
from unidrive_cli.synth.ray_renderer import RayRenderer
from unidrive_cli.synth.stage import FIRST_ACTOR_ID, SKY_ID, Day, Stage, View
from unidrive_cli.synth.textures import make_textures

BASE = Pinhole(300.0, 310.0, 161.3, 118.2, 320, 240)
STRONG = (
    lens_of(BASE, "opencv", [-0.32, 0.11, 0.001, -0.002, 0.0]),
    lens_of(Pinhole(110.0, 112.0, 160.0, 119.0, 320, 240), "fisheye", [0.02, -0.01, 0.0, 0.0]),
)
CAMERA = pose(rotation_from_yaw_pitch_roll(10, -3, 2), [0.0, 0.0, 1.6])


@pytest.fixture(scope="module")
def stage() -> Stage:
    rng = np.random.default_rng(0)
    day = Day((0.3, 0.2, 0.9), (1, 1, 1), (0.3, 0.4, 0.6), (0.6, 0.6, 0.7), 0.0, 1e6)
    cars = tuple(make_actor("car", rng).mesh for _ in range(4))
    return Stage(cars[0].placed(np.diag([1.0, 1, 1, 1]) * 1.0), merged([]), cars, make_textures(0), day)


def poses() -> np.ndarray:
    placed = np.tile(np.eye(4), (4, 1, 1))
    placed[:, :3, 3] = [[9, 1, 0.8], [4, 6, 0.8], [3, -7, 0.8], [-8, 2, 0.8]]
    return placed


@pytest.mark.parametrize("lens", STRONG, ids=["opencv", "fisheye"])
def test_what_a_pixel_shows_projects_back_into_it(stage: Stage, lens: Lens) -> None:
    ids, depths = Shots(RayRenderer(stage)).instances(lens, CAMERA, poses(), np.ones(4, dtype=bool))
    rows, columns = np.nonzero(ids >= FIRST_ACTOR_ID)
    assert len(rows) > 2000
    rays = lens.unproject(np.stack([columns, rows], axis=-1).astype(float))
    points = transform(CAMERA, rays * (depths[rows, columns] / rays[:, 2])[:, None])
    for number, placed in enumerate(poses()):
        mine = ids[rows, columns] == FIRST_ACTOR_ID + number
        half = np.abs(stage.actors[number].positions_m).max(axis=0)
        if mine.any():
            apart = np.abs(transform(np.linalg.inv(placed), points[mine])) - half
            assert apart.max() < 0.06  # half a pixel of the wide picture, at the cars' distance


def test_the_fisheye_sees_what_is_beside_and_its_corners_are_dark(stage: Stage) -> None:
    lens = lens_of(Pinhole(70.0, 70.0, 159.5, 119.5, 320, 240), "fisheye", [0.0, 0.0, 0.0, -0.003])
    shots = Shots(RayRenderer(stage))
    ids, depths = shots.instances(lens, CAMERA, poses(), np.ones(4, dtype=bool))
    assert {FIRST_ACTOR_ID, FIRST_ACTOR_ID + 1, FIRST_ACTOR_ID + 2} <= set(np.unique(ids).tolist())
    blank = ~np.isfinite(
        lens.unproject(np.stack(np.meshgrid(range(320), range(240)), axis=-1).astype(float))[..., 0]
    )
    picture = shots.picture(lens, CAMERA, poses(), np.ones(4, dtype=bool), 1)
    assert (picture[blank] == 0).all()
    assert (ids[blank] == SKY_ID).all()
    assert np.isinf(depths[blank]).all()


def test_no_distortion_gives_the_pinhole_picture(stage: Stage) -> None:
    renderer = RayRenderer(stage)
    nearly = lens_of(BASE, "opencv", [1e-12, 0.0, 0.0, 0.0])
    shown = np.ones(4, dtype=bool)
    straight = renderer.picture(View(BASE, CAMERA, poses(), shown), 4).astype(float)
    warped = Shots(renderer).picture(nearly, CAMERA, poses(), shown, 4).astype(float)
    assert 10 * np.log10(255**2 / np.mean((straight - warped) ** 2)) > 28
