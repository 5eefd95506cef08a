"""The renderer against a second implementation, on real pictures of three cars."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests import reference
from tests.frames import psnr_db, render_samples
from unidrive_cli.rig.gallery import gallery_folder
from unidrive_cli.rig.yaml_file import load_rig

TILTED = """
name: tilted
origin: rear_axle
cameras:
  CAM_FRONT:
    {width: 1280, height: 720, hfov: 85, position: [1.2, 0.1, 1.9], yaw: 20, pitch: -12, roll: 7}
  CAM_BACK:
    {width: 1280, height: 720, hfov: 60, position: [0.2, -0.3, 1.4], yaw: -160, pitch: 9, roll: -15}
  CAM_LEFT:
    {width: 900, height: 1000, intrinsics: [700, 760, 400, 560], position: [0.8, 0.4, 1.7], yaw: 95, roll: 90}
"""

CARS = {
    "nuscenes": ("nuscenes-onekeyframe", "v1.0-mini", "ca9a282c9e77460f8360f564131a8af5"),
    "tri-6-cameras": ("dgp-tri-2scenes", "v1.0-dgp", "801b6ee8df4be277cfbbe534b24ff9c0"),
    "tri-3-cameras": ("dgp-tri-2scenes", "v1.0-dgp", "264bfb02a13029e162864ee0ddd8e35e"),
}


EVERY = 3
"""Rows and columns that are compared; the reference takes seconds for every picture."""


@pytest.fixture
def rig_path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param != "tilted":
        return gallery_folder() / f"{request.param}.yaml"
    path = tmp_path / "tilted.yaml"
    path.write_text(TILTED)
    return path


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("rig_path", ["roof-6x70", "tilted", "8x50"], indirect=True)
def test_same_pictures_and_masks_as_the_second_implementation(shared_data: Path, car: str, rig_path: Path) -> None:
    folder, version, token = CARS[car]
    root = shared_data / folder
    sample = reference.load_sample(root, version, token)
    (ours,) = render_samples(root, load_rig(rig_path), token=token, depth_limit_m=45.0, anti_alias=False)
    for camera in reference.rig_from_yaml(rig_path):
        theirs = reference.reference_view(
            camera,
            sample["cameras"],
            sample["reference_global_from_ego"],
            ours.sources,
            depth_limit=45.0,
            ground_z=0.0,
            ego_motion=True,
            every=EVERY,
        )
        picture, mask = (
            whole[::EVERY, ::EVERY]
            for whole in (ours.pictures[camera["channel"]], ours.tables[camera["channel"]].mask > 0)
        )
        count = theirs["count"]
        assert np.mean(mask != (count > 0)) <= 1e-3
        assert not picture[~mask].any()
        single = (count == 1) & mask
        if single.any():
            assert psnr_db(picture[single], theirs["single"][single]) >= 55
        # taps at 1/32 pixel, and a rounding for each source that is mixed: three grey levels
        mixed = count > 1
        assert (picture[mixed] >= theirs["low"][mixed] - 3).all()
        assert (picture[mixed] <= theirs["high"][mixed] + 3).all()
