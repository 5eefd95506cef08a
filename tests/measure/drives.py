"""For the tests of `measure`: a painted drive, a virtual rig, and the drive painted through that rig."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tests.painted import LOGFILE, SAMPLE_US, PaintedCamera, PaintedScene, nuscenes_like_cameras, write_painted
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig

SAMPLES = 2
SIZE = (192, 108)
RIG = """\
name: between
cameras:
  CAM_FRONT_LEFT: {width: 192, height: 108, hfov: 80, position: [1.5, 0.3, 1.6], yaw: 28, pitch: -5}
  CAM_FRONT_RIGHT: {width: 192, height: 108, hfov: 80, position: [1.5, -0.3, 1.6], yaw: -28, pitch: -5}
  CAM_BACK: {width: 192, height: 108, hfov: 100, position: [0.2, 0.0, 1.6], yaw: 180, pitch: -5}
"""
CHANNELS = ("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK")


def rig() -> Rig:
    return parse_rig(RIG, "rig.yaml")


def painted_cameras(fires_us: int = 0) -> tuple[PaintedCamera, ...]:
    """The virtual rig, to paint through: all cameras at once, `fires_us` after the samples' time."""
    return tuple(
        PaintedCamera(
            camera.channel,
            camera.lens.width_px,
            camera.lens.height_px,
            camera.lens.matrix,
            np.array(camera.ego_from_cam),
            fires_us,
        )
        for camera in rig().cameras
    )


def paint_source(root: Path) -> Path:
    """The drive through the real cameras, which fire one after the other."""
    write_painted(root, cameras=nuscenes_like_cameras(0.2), samples_per_scene=SAMPLES)
    return root


def paint_truth(root: Path, *, fires_us: int = 0, picture_suffix: str = ".jpg") -> Path:
    """The same drive through the virtual rig, with instance pictures: boxes from 16 on, the ground 1, the sky 0."""
    cameras = painted_cameras(fires_us)
    write_painted(root, cameras=cameras, samples_per_scene=SAMPLES, picture_suffix=picture_suffix)
    scene = PaintedScene(0, SAMPLES)
    for camera in cameras:
        folder = root / "instances" / camera.channel
        folder.mkdir(parents=True)
        for index in range(SAMPLES):
            time_us = scene.start_us + index * SAMPLE_US + fires_us
            numbers = instances_of(camera, scene, time_us)
            assert cv2.imwrite(str(folder / f"{LOGFILE}__{camera.channel}__{time_us}.png"), numbers)
    return root


def instances_of(camera: PaintedCamera, scene: PaintedScene, time_us: int) -> np.ndarray:
    """What the ray through each pixel's centre meets first."""
    global_from_cam = scene.global_from_ego(time_us) @ camera.ego_from_cam
    pixels = np.stack(
        [*np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), np.ones(SIZE[::-1])], axis=-1
    )
    origin, rays = global_from_cam[:3, 3], pixels @ np.linalg.inv(camera.intrinsic).T @ global_from_cam[:3, :3].T
    depth = np.where(rays[..., 2] < 0, -origin[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    numbers = (rays[..., 2] < 0).astype(np.uint16)
    for index, box in enumerate(scene.boxes(time_us)):
        enters, _ = box.enter(origin, rays)
        numbers[enters < depth] = 16 + index
        depth = np.minimum(depth, enters)
    return numbers
