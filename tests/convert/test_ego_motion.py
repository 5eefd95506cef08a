"""A painted ground seen by a moving car whose cameras fire one after the other: the true picture is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.frames import psnr_db, render_samples
from tests.painted import PaintedScene, nuscenes_like_cameras, paint, write_painted
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import pose, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.model import Camera, Rig

DRIVE = {"speed_mps": 20.0, "yaw_rate_deg_s": 12.0, "with_boxes": False}
RIG = Rig(
    "between",
    "cameras that look across the borders of the real ones",
    tuple(
        Camera(
            channel,
            Pinhole.from_hfov(80, 480, 270),
            pose(rotation_from_yaw_pitch_roll(yaw, -5, 0), [1.5, y, 1.6]),
        )
        for channel, yaw, y in (("CAM_FRONT_LEFT", 28, 0.3), ("CAM_FRONT_RIGHT", -28, -0.3))
    ),
)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drive")
    write_painted(root, cameras=nuscenes_like_cameras(scale=0.35), samples_per_scene=1, lidar_sweeps=0, **DRIVE)
    return root


def near_ground_psnr_db(drive: Path, *, ego_motion: bool) -> float:
    """PSNR against the painted truth on ground pixels within 25 m, over the rig's cameras."""
    (frame,) = render_samples(drive, RIG, ego_motion=ego_motion)
    scene = PaintedScene(0, samples=1, **DRIVE)
    pairs = []
    for camera in RIG.cameras:
        truth = paint(
            camera.lens.matrix,
            camera.lens.width_px,
            camera.lens.height_px,
            scene.global_from_ego(scene.start_us) @ camera.ego_from_cam,
        )
        pixels = np.stack(np.meshgrid(np.arange(camera.lens.width_px), np.arange(camera.lens.height_px)), axis=-1)
        down = (camera.lens.unproject(pixels.astype(float)) @ camera.ego_from_cam[:3, :3].T)[..., 2]
        near = (down < -1.6 / 25) & (frame.tables[camera.channel].mask > 0)
        assert near.mean() > 0.3
        pairs.append((frame.pictures[camera.channel][near], truth[near]))
    return psnr_db(np.concatenate([p for p, _ in pairs]), np.concatenate([t for _, t in pairs]))


def test_seamless_with_compensation_and_broken_without(drive: Path) -> None:
    compensated, plain = near_ground_psnr_db(drive, ego_motion=True), near_ground_psnr_db(drive, ego_motion=False)
    print(f"compensated {compensated:.1f} dB, plain {plain:.1f} dB")
    assert compensated > 43
    assert plain < 28
