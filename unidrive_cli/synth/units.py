"""The unit of work: one sample of one scene, rendered through every rig; tables are made of its receipts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Bool, Float, lengths
from unidrive_cli.geometry.poses import quaternion_from_rotation
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.synth.embree import Bodies
from unidrive_cli.synth.firing import (
    CAMERA_SWEEPS,
    KEYFRAME_US,
    LIDAR_SWEEPS,
    ego_from_lidar,
    fires_us,
    moments_us,
)
from unidrive_cli.synth.lenses import Shots
from unidrive_cli.synth.lidar import Lidar
from unidrive_cli.synth.map_mask import drivable_mask
from unidrive_cli.synth.names import cloud_name, depth_name, log_name, map_name, picture_name
from unidrive_cli.synth.options import RendererChoice, SynthOptions
from unidrive_cli.synth.renderers import open_renderer
from unidrive_cli.synth.scene import SHOWN_WITHIN_M, Scene, make_scene
from unidrive_cli.synth.stage import Depth
from unidrive_cli.synth.visibility import Silhouettes
from unidrive_cli.tables.converted import WORK
from unidrive_cli.tables.destination import RECEIPTS, Destination
from unidrive_cli.tables.instances import instance_name
from unidrive_cli.warp.pictures import encode_jpeg, encode_mask

ANNOTATED_WITHIN_M = 80.0
DEPTH_PER_M = 256
"""Depth pictures hold metres times this (0: nothing, or farther than they can say), as KITTI's do."""


class Record(msgspec.Struct, frozen=True, array_like=True):
    """One picture or cloud: what its sample_data and ego_pose rows say."""

    channel: str
    timestamp_us: int
    is_key_frame: bool
    filename: str
    size: int
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


class Sighting(msgspec.Struct, frozen=True, array_like=True):
    """One actor within reach at a sample's time."""

    actor: int
    kind: str
    attribute: str
    size_wlh_m: tuple[float, float, float]
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    lidar_points: int
    visible: float


class Receipt(msgspec.Struct, frozen=True):
    """What a finished sample leaves behind, per rig."""

    scene: int
    sample: int
    records: list[Record]
    sightings: list[Sighting]


@dataclass(frozen=True, eq=False)
class Target:
    """A rig and where its dataset goes."""

    rig: Rig
    destination: Destination


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples of one scene that one worker renders one after the other.

    Attributes:
        samples: number of each sample, with the targets that lack it.
    """

    options: SynthOptions
    renderer: RendererChoice
    scene: int
    samples: tuple[tuple[int, tuple[Target, ...]], ...]


def receipt_name(scene: int, sample: int) -> str:
    """The receipt of a sample, below DST."""
    return f"{WORK}/{RECEIPTS}/{scene:04d}-{sample:04d}.json"


def read_receipt(destination: Destination, scene: int, sample: int) -> Receipt | None:
    """The receipt of a finished sample; None where it is missing, or a file of it is missing or of another size."""
    root = destination.root
    try:
        receipt = msgspec.json.decode((root / receipt_name(scene, sample)).read_bytes(), type=Receipt)
        whole = all((root / record.filename).stat().st_size == record.size for record in receipt.records)
    except (OSError, msgspec.DecodeError):
        return None
    return receipt if whole else None


def run_batch(batch: Batch) -> Iterator[int]:
    """Renders a batch; yields the number of each sample that is done.

    Raises:
        RigError: a camera is inside a building or below the ground.
        OutputError: a file cannot be written.
        UsageError: the renderer that was asked for cannot be had.
    """
    scene = make_scene(batch.options, batch.scene)
    _check_cameras(scene, batch)
    with closing(open_renderer(scene.stage, batch.renderer)) as renderer:
        bodies = Bodies(scene.stage.actors)
        studio = _Studio(scene, Shots(renderer), bodies, Lidar(scene.stage, bodies))
        for sample, targets in batch.samples:
            studio.shoot(sample, targets)
            yield sample


def _check_cameras(scene: Scene, batch: Batch) -> None:
    for sample, targets in batch.samples:
        for target in targets:
            for camera in target.rig.cameras:
                fired_us = scene.start_us + sample * KEYFRAME_US + fires_us(camera, batch.options)
                when = f"scene {scene.index}, {scene.seconds(fired_us):.2f} s"
                global_from_cam = scene.global_from_ego(fired_us) @ camera.ego_from_cam
                scene.check_camera(f"{target.rig.name}, camera {camera.channel}, {when}", global_from_cam)


@dataclass(frozen=True, eq=False)
class _Studio:
    scene: Scene
    shots: Shots
    bodies: Bodies
    lidar: Lidar

    def shoot(self, sample: int, targets: Sequence[Target]) -> None:
        """One sample for all targets; the lidar's turns are cast once."""
        time_us = self.scene.start_us + sample * KEYFRAME_US
        actors, shown = self._actors_at(time_us)
        clouds = []
        points = np.zeros(len(shown), dtype=np.int64)
        for moment_us, key in moments_us(time_us, sample, LIDAR_SWEEPS, self.scene.options):
            global_from_lidar = self.scene.global_from_ego(moment_us) @ ego_from_lidar()
            cloud, actor = self.lidar.cloud(global_from_lidar, *self._actors_at(moment_us))
            clouds.append((moment_us, key, cloud.tobytes()))
            if key:
                points = np.bincount(actor[actor >= 0], minlength=len(shown))
        for target in targets:
            records = [self._write(target, "LIDAR_TOP", *cloud) for cloud in clouds]
            silhouettes = Silhouettes(self.bodies)
            for camera in target.rig.cameras:
                fired_us = time_us + fires_us(camera, self.scene.options)
                for moment_us, key in moments_us(fired_us, sample, CAMERA_SWEEPS, self.scene.options):
                    records.append(self._picture(target, camera, moment_us, key, silhouettes))
            if not sample:
                mask = encode_mask(drivable_mask(self.scene.town))
                target.destination.write(map_name(self.scene.options, self.scene.index), mask)
            receipt = Receipt(
                self.scene.index, sample, records, self._sightings(time_us, actors, points, silhouettes.visible())
            )
            target.destination.write(receipt_name(self.scene.index, sample), msgspec.json.encode(receipt))

    def _actors_at(self, moment_us: int) -> tuple[Float, Bool]:
        """Poses of all actors, and which of them are near enough to be there."""
        actors = self.scene.global_from_actors(moment_us)
        ego = self.scene.global_from_ego(moment_us)
        return actors, lengths(actors[:, :2, 3] - ego[:2, 3]) < SHOWN_WITHIN_M

    def _picture(
        self, target: Target, camera: Camera, moment_us: int, key: bool, silhouettes: Silhouettes
    ) -> Record:
        options = self.scene.options
        actors, shown = self._actors_at(moment_us)
        pose = self.scene.global_from_ego(moment_us) @ camera.ego_from_cam
        picture = self.shots.picture(camera.lens, pose, actors, shown, options.samples_per_pixel)
        record = self._write(target, camera.channel, moment_us, key, encode_jpeg(picture, options.quality))
        if key or options.instances or options.depth:
            ids, depth_m = self.shots.instances(camera.lens, pose, actors, shown)
            if key:
                silhouettes.add(camera.lens, pose, actors, shown, ids)
            if options.instances:
                target.destination.write(instance_name(record.filename), _png(ids))
            if options.depth:
                target.destination.write(depth_name(record.filename), _png(_depth_levels(depth_m)))
        return record

    def _write(self, target: Target, channel: str, moment_us: int, key: bool, data: bytes) -> Record:
        log = log_name(self.scene.options, self.scene.index)
        namer = cloud_name if channel == "LIDAR_TOP" else picture_name
        name = namer(log, channel, moment_us, key)
        target.destination.write(name, data)
        pose = self.scene.global_from_ego(moment_us)
        return Record(channel, moment_us, key, name, len(data), *_translation_rotation(pose))

    def _sightings(
        self, time_us: int, actors: Float, points: npt.NDArray[np.int64], visible: Float
    ) -> list[Sighting]:
        place = self.scene.global_from_ego(time_us)[:2, 3]
        near = np.flatnonzero(lengths(actors[:, :2, 3] - place) < ANNOTATED_WITHIN_M)
        found = []
        for index in near:
            actor = self.scene.traffic.actors[index]
            found.append(
                Sighting(
                    int(index),
                    actor.model.kind,
                    actor.attribute(self.scene.seconds(time_us)),
                    actor.model.size_wlh_m,
                    *_translation_rotation(actors[index]),
                    int(points[index]),
                    round(float(visible[index]), 6),
                )
            )
        return found


def _translation_rotation(
    pose: Float,
) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Translation in metres and rotation w, x, y, z of a pose (4, 4)."""
    x, y, z = pose[:3, 3].tolist()
    w, i, j, k = quaternion_from_rotation(pose[:3, :3]).tolist()
    return (x, y, z), (w, i, j, k)


def _depth_levels(depth_m: Depth) -> npt.NDArray[np.uint16]:
    levels = np.rint(np.where(np.isfinite(depth_m), depth_m, 0.0) * DEPTH_PER_M)
    return np.where(levels > np.iinfo(np.uint16).max, 0, levels).astype(np.uint16)


def _png(picture: npt.NDArray[np.uint16]) -> bytes:
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not done:
        raise RuntimeError(f"OpenCV could not encode a PNG picture of shape {picture.shape}.")
    return bytes(data)
