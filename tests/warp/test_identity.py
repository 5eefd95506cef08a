"""A dataset converted to its own rig gives its pictures back: same pose, so the assumed depth cancels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.frames import psnr_db, render_samples
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.rig_of_dataset import rig_of_dataset

SCENES = [("nuscenes-onekeyframe", ()), ("dgp-tri-2scenes", ("scene_01",))]


@pytest.mark.parametrize(("folder", "scenes"), SCENES)
def test_each_camera_alone_gives_its_picture_back_everywhere(
    shared_data: Path, folder: str, scenes: tuple[str, ...]
) -> None:
    root = shared_data / folder
    rig, _ = rig_of_dataset(open_dataset(root), scenes)
    for camera in rig.cameras:
        channel, alone = camera.channel, replace(rig, cameras=(camera,))
        frame = render_samples(root, alone, ego_motion=False, cameras=(channel,), scenes=scenes)[0]
        assert frame.tables[channel].mask.all()
        assert psnr_db(frame.pictures[channel], frame.sources[channel]) >= 50


@pytest.mark.parametrize(("folder", "scenes"), SCENES)
def test_pixels_without_a_neighbour_come_back_unmixed(
    shared_data: Path, folder: str, scenes: tuple[str, ...]
) -> None:
    root = shared_data / folder
    rig, _ = rig_of_dataset(open_dataset(root), scenes)
    frame = render_samples(root, rig, ego_motion=False, scenes=scenes)[0]
    for camera in rig.cameras:
        channel, one = camera.channel, replace(rig, cameras=(camera,))
        others = tuple(other for other in rig.channels if other != channel)
        neighbours = render_samples(root, one, ego_motion=False, cameras=others, scenes=scenes)[0]
        alone = neighbours.tables[channel].mask == 0
        assert alone.mean() > 0.4
        assert psnr_db(frame.pictures[channel][alone], frame.sources[channel][alone]) >= 50
