"""Boxes before several cameras at once, against the lens and one box at a time."""

from __future__ import annotations

import numpy as np

from unidrive_cli.geometry import boxes
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse, pose, rotation_from_yaw_pitch_roll, transform
from unidrive_cli.geometry.sights import Sights

NEAR_M = 0.1
GRID = boxes.volume_grid(3)


def test_the_pairs_are_those_that_the_lens_shows_and_lie_where_it_shows_them() -> None:
    rng = np.random.default_rng(5)
    cameras = [
        (Pinhole.from_hfov(hfov, width, 300), inverse(pose(rotation_from_yaw_pitch_roll(yaw, 3, -2), [1.0, 0, 1.5])))
        for hfov, width, yaw in ((60, 400, 0), (100, 640, 80), (150, 500, -120))
    ]
    ego_from_box = np.array(
        [pose(rotation_from_yaw_pitch_roll(*rng.uniform(-180, 180, 3)), rng.uniform(-15, 15, 3)) for _ in range(200)]
    )
    sizes_wlh_m = rng.uniform(0.3, 6, (200, 3))
    sights = Sights(cameras, ego_from_box, sizes_wlh_m, NEAR_M)
    pixels, inside = sights.project(np.arange(len(sights.box)), GRID)
    whole, left_out = 0, 0
    for index, (lens, cam_from_ego) in enumerate(cameras):
        pairs = sights.of_camera(index)
        assert (sights.camera[pairs] == index).all()
        points = transform(cam_from_ego, boxes.grid(ego_from_box, sizes_wlh_m, GRID))
        expected, shown = lens.project(points)
        others = np.setdiff1d(np.arange(200), sights.box[pairs])
        assert not shown[others].any()
        np.testing.assert_array_equal(inside[pairs], shown[sights.box[pairs]])
        np.testing.assert_allclose(
            np.moveaxis(pixels, 0, -1)[pairs][inside[pairs]], expected[sights.box[pairs]][inside[pairs]], atol=1e-9
        )
        assert shown[sights.box[pairs][sights.whole[pairs]]].all()
        corners = transform(cam_from_ego, boxes.corners(ego_from_box, sizes_wlh_m))[sights.box[pairs]]
        np.testing.assert_allclose(sights.corners[pairs], corners @ lens.matrix.T, rtol=1e-9, atol=1e-9)
        whole, left_out = whole + int(sights.whole[pairs].sum()), left_out + len(others)
    assert whole > 20
    assert left_out > 100
