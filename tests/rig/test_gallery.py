"""The shipped rigs against the numbers of the design page, typed here a second time."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from unidrive_cli.errors import RigError
from unidrive_cli.rig.gallery import gallery_names, load_gallery_rig
from unidrive_cli.rig.model import Rig

SIX = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"]
R8 = 0.4 * np.sqrt(0.5)

PAPER = {  # channel: (yaw, x, y, z, hfov); relative to the vehicle's centre, right-handed
    "4x95": {
        "CAM_FRONT": (0, 0.3, 0, 1.6, 95), "CAM_LEFT": (90, 0, 0.5, 1.6, 95),
        "CAM_RIGHT": (-90, 0, -0.5, 1.6, 95), "CAM_BACK": (180, -0.3, 0, 1.6, 95),
    },
    "5x75": {
        "CAM_FRONT": (0, 0.5, 0, 1.6, 75),
        "CAM_FRONT_LEFT": (72, 0.15, 0.48, 1.6, 75), "CAM_FRONT_RIGHT": (-72, 0.15, -0.48, 1.6, 75),
        "CAM_BACK_LEFT": (144, -0.40, 0.29, 1.6, 75), "CAM_BACK_RIGHT": (-144, -0.40, -0.29, 1.6, 75),
    },
    "6x80a": {
        "CAM_FRONT": (0, 0.39, 0, 1.5, 80), "CAM_BACK": (180, -1.2, 0, 1.5, 80),
        "CAM_FRONT_LEFT": (60, 0.2, 0.4, 1.5, 80), "CAM_FRONT_RIGHT": (-60, 0.2, -0.4, 1.5, 80),
        "CAM_BACK_LEFT": (120, -0.4, 0.6, 1.5, 80), "CAM_BACK_RIGHT": (-120, -0.4, -0.6, 1.5, 80),
    },
    "6x80b": {  # named as the authors named them, not by direction
        "CAM_FRONT_LEFT": (30, 0.2, 0.4, 1.5, 80), "CAM_FRONT_RIGHT": (-30, 0.2, -0.4, 1.5, 80),
        "CAM_BACK_LEFT": (90, -0.4, 0.6, 1.5, 80), "CAM_BACK_RIGHT": (-90, -0.4, -0.6, 1.5, 80),
        "CAM_BACK": (150, -1.2, 0.4, 1.5, 80), "CAM_FRONT": (-150, -1.2, -0.4, 1.5, 80),
    },
    "6x70": {
        "CAM_FRONT": (0, 0.5, 0, 1.5, 70), "CAM_BACK": (180, -0.5, 0, 1.5, 70),
        "CAM_FRONT_LEFT": (60, 0.25, 0.43, 1.5, 70), "CAM_FRONT_RIGHT": (-60, 0.25, -0.43, 1.5, 70),
        "CAM_BACK_LEFT": (120, -0.25, 0.43, 1.5, 70), "CAM_BACK_RIGHT": (-120, -0.25, -0.43, 1.5, 70),
    },
    "6x60": dict(zip(SIX, [(yaw, 0, 0, 1.6, 60) for yaw in (0, 60, -60, 180, 120, -120)], strict=True)),
    "8x50": {  # every 45 degrees on a circle of 0.4 m
        "CAM_FRONT": (0, 0.4, 0, 1.6, 50), "CAM_FRONT_LEFT": (45, R8, R8, 1.6, 50),
        "CAM_LEFT": (90, 0, 0.4, 1.6, 50), "CAM_BACK_LEFT": (135, -R8, R8, 1.6, 50),
        "CAM_BACK": (180, -0.4, 0, 1.6, 50), "CAM_BACK_RIGHT": (-135, -R8, -R8, 1.6, 50),
        "CAM_RIGHT": (-90, 0, -0.4, 1.6, 50), "CAM_FRONT_RIGHT": (-45, R8, -R8, 1.6, 50),
    },
    "5x70+110": {
        "CAM_FRONT": (0, 0.47, 0, 1.5, 70), "CAM_BACK": (180, -1.2, 0, 1.5, 110),
        "CAM_FRONT_LEFT": (55, 0.32, 0.5, 1.5, 70), "CAM_FRONT_RIGHT": (-55, 0.32, -0.5, 1.5, 70),
        "CAM_BACK_LEFT": (110, -0.21, 0.5, 1.5, 70), "CAM_BACK_RIGHT": (-110, -0.21, -0.5, 1.5, 70),
    },
}  # fmt: skip

NUSCENES_LIKE = {  # channel: (f, yaw, x, y, z); relative to the rear axle
    "CAM_FRONT": (1266, 0, 1.70, 0.02, 1.51),
    "CAM_FRONT_LEFT": (1272, 55, 1.52, 0.49, 1.51),
    "CAM_FRONT_RIGHT": (1261, -56, 1.55, -0.49, 1.50),
    "CAM_BACK_LEFT": (1257, 109, 1.04, 0.48, 1.59),
    "CAM_BACK_RIGHT": (1260, -111, 1.01, -0.48, 1.56),
    "CAM_BACK": (809, 180, 0.03, 0, 1.58),
}


def level_pose(yaw: float, x: float, y: float, z: float) -> np.ndarray:
    """Ego from a level camera: its x axis is to the right of where it looks, its y axis down."""
    c, s = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
    return np.array([[s, 0, c, x], [-c, 0, s, y], [0, -1, 0, z], [0, 0, 0, 1]])


def cameras_of(rig: Rig, height_px: int = 900) -> dict:
    assert all((camera.lens.width_px, camera.lens.height_px) == (1600, height_px) for camera in rig.cameras)
    return {camera.channel: camera for camera in rig.cameras}


FLAT_AND_NOT = (("intuitive-6", 900), ("intuitive-flat-6", 580))


def test_the_gallery_is_complete() -> None:
    ours = {
        "nuscenes-like",
        "roof-6x70",
        "unidrive-released-6x60",
        "intuitive-6",
        "intuitive-flat-6",
        "unidrive-optimised-6",
        "unidrive-fleet-6",
    }
    assert set(gallery_names()) == {*PAPER, *ours}


def test_all_cameras_of_the_intuitive_rig_stand_at_the_centre_of_the_roof() -> None:
    cameras = cameras_of(load_gallery_rig("intuitive-6"))
    assert {camera.channel for camera in cameras.values()} == set(cameras_of(load_gallery_rig("roof-6x70")))
    for camera in cameras.values():
        np.testing.assert_allclose(camera.centre_ego, [1.3, 0, 1.6])


def test_the_flat_intuitive_rig_differs_in_shape_alone() -> None:
    plain, flat = (cameras_of(load_gallery_rig(name), px) for name, px in FLAT_AND_NOT)
    assert plain.keys() == flat.keys()
    for channel, camera in plain.items():
        np.testing.assert_array_equal(camera.ego_from_cam, flat[channel].ego_from_cam)
        assert camera.lens.hfov_deg == pytest.approx(flat[channel].lens.hfov_deg)
    assert load_gallery_rig("intuitive-flat-6").depth_limit_m == load_gallery_rig("unidrive-fleet-6").depth_limit_m


@pytest.mark.parametrize(("name", "height_px"), [("unidrive-optimised-6", 900), ("unidrive-fleet-6", 580)])
def test_the_rigs_that_were_found_are_the_same_left_and_right(name: str, height_px: int) -> None:
    rig = load_gallery_rig(name)
    cameras = cameras_of(rig, height_px)
    assert rig.depth_limit_m is not None
    for left, right in (("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"), ("CAM_BACK_LEFT", "CAM_BACK_RIGHT")):
        one, other = cameras[left], cameras[right]
        np.testing.assert_allclose(one.centre_ego * [1, -1, 1], other.centre_ego, atol=1e-9)
        np.testing.assert_allclose(
            np.multiply(one.yaw_pitch_roll_deg, [-1, 1, -1]), other.yaw_pitch_roll_deg, atol=1e-6
        )
        assert one.lens == other.lens


@pytest.mark.parametrize("name", gallery_names())
def test_a_shipped_rig_is_named_like_its_file_and_says_what_it_is(name: str) -> None:
    rig = load_gallery_rig(name)
    assert rig.name == name
    assert rig.description


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_rigs(name: str) -> None:
    """The rear axle is 1.3 m behind the vehicle's centre, so every x is 1.3 m larger."""
    cameras = cameras_of(load_gallery_rig(name))
    assert set(cameras) == set(PAPER[name])
    for channel, (yaw, x, y, z, hfov) in PAPER[name].items():
        camera = cameras[channel]
        np.testing.assert_allclose(camera.ego_from_cam, level_pose(yaw, x + 1.3, y, z), atol=5e-5)
        focal = 800 / np.tan(np.deg2rad(hfov / 2))
        found = (camera.lens.fx_px, camera.lens.fy_px, camera.lens.cx_px, camera.lens.cy_px)
        assert found == pytest.approx((focal, focal, 799.5, 449.5), rel=1e-12)


def test_the_nuscenes_like_rig() -> None:
    cameras = cameras_of(load_gallery_rig("nuscenes-like"))
    assert set(cameras) == set(NUSCENES_LIKE)
    for channel, (focal, *place) in NUSCENES_LIKE.items():
        lens = cameras[channel].lens
        np.testing.assert_allclose(cameras[channel].ego_from_cam, level_pose(*place), atol=1e-12)
        assert (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px) == (focal, focal, 799.5, 449.5)


def test_the_rig_of_the_released_code() -> None:
    """f = 800 / tan 30 degrees = 800 sqrt 3 about the principal point (800, 450), which is not quite hfov 60."""
    cameras = cameras_of(load_gallery_rig("unidrive-released-6x60"))
    assert list(cameras) == SIX
    for camera, yaw in zip(cameras.values(), (0, 60, -60, 180, 120, -120), strict=True):
        np.testing.assert_allclose(camera.ego_from_cam, level_pose(yaw, 0, 0, 1.5), atol=1e-12)
        lens = camera.lens
        assert (lens.fx_px, lens.fy_px) == pytest.approx((800 * np.sqrt(3),) * 2, abs=5e-5)
        assert (lens.cx_px, lens.cy_px) == (800, 450)


def test_the_default_roof_rig_stands_near_the_nuscenes_cameras() -> None:
    """Every 60 degrees, mirrored left and right, each within 0.25 m of the real camera of its name."""
    cameras = cameras_of(load_gallery_rig("roof-6x70"))
    assert list(cameras) == SIX
    for (channel, camera), yaw in zip(cameras.items(), (0, 60, -60, 180, 120, -120), strict=True):
        np.testing.assert_allclose(camera.ego_from_cam, level_pose(yaw, *camera.centre_ego), atol=1e-12)
        assert camera.lens.hfov_deg == pytest.approx(70)
        assert np.linalg.norm(camera.centre_ego - NUSCENES_LIKE[channel][2:]) < 0.25
    for left in ("CAM_FRONT_LEFT", "CAM_BACK_LEFT"):
        mirrored = cameras[left].centre_ego * [1, -1, 1]
        np.testing.assert_array_equal(mirrored, cameras[left.replace("LEFT", "RIGHT")].centre_ego)


@pytest.mark.parametrize(("asked", "guess"), [("6x7", "6x70"), ("roof", None), ("nuscene-like", "nuscenes-like")])
def test_an_unknown_name_is_refused_with_a_guess_and_the_list(asked: str, guess: str | None) -> None:
    with pytest.raises(RigError) as caught:
        load_gallery_rig(asked)
    sentence = str(caught.value)
    assert sentence.startswith(f"{asked}: ")
    assert caught.value.exit_code == 2
    assert all(name in sentence for name in gallery_names())
    assert guess is None or f"Did you mean {guess}?" in sentence


@pytest.mark.parametrize("name", ["", "..", "../rigs/6x70", "6x70.yaml", "6X70"])
def test_only_the_names_themselves_are_names(name: str) -> None:
    with pytest.raises(RigError):
        load_gallery_rig(name)


def test_every_processor_gives_the_same_digests() -> None:
    """A dataset begun on one machine is finished on another: their widest vector units round differently."""
    code = "from unidrive_cli.rig.gallery import *; print([load_gallery_rig(n).digest for n in gallery_names()])"
    plain = {**os.environ, "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX2 FMA3"}
    here, there = (
        subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True).stdout
        for env in (dict(os.environ), plain)
    )
    assert here == there


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("4x95", "fb9587f62f8aaff3"),
        ("5x70+110", "0761f87c8745bbed"),
        ("5x75", "07fd12b2f76f7847"),
        ("6x60", "fb26f46bfe941f9f"),
        ("6x70", "95fa72003b921d91"),
        ("6x80a", "bef4336a85e710af"),
        ("6x80b", "f5730c545d5b1efa"),
        ("8x50", "f4fcc8f8dbbe6d46"),
        ("nuscenes-like", "17d164d363166e0c"),
        ("roof-6x70", "614cc544d60d9e0e"),
        ("unidrive-released-6x60", "7152e7b7c8ea6e77"),
    ],
)
def test_digests_stay(name: str, digest: str) -> None:
    """Tokens and plans of converted datasets hang on them."""
    assert load_gallery_rig(name).digest.startswith(digest)
