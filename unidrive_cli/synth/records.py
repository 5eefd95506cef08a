"""The tables of a synthetic drive, from the receipts of its samples."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import quaternion_from_rotation
from unidrive_cli.rig.model import Rig
from unidrive_cli.synth.firing import ego_from_lidar
from unidrive_cli.synth.names import log_name, map_name, token
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.stage import FIRST_ACTOR_ID
from unidrive_cli.synth.units import Receipt, Record, Sighting
from unidrive_cli.synth.visibility import level_of
from unidrive_cli.tables.dataset import LIDAR_REFERENCE
from unidrive_cli.tables.schema import NUSCENES_VISIBILITY

CATEGORIES = {
    "car": "vehicle.car",
    "bus": "vehicle.bus.rigid",
    "truck": "vehicle.truck",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "pedestrian": "human.pedestrian.adult",
}
ATTRIBUTES = (
    "vehicle.moving",
    "vehicle.stopped",
    "vehicle.parked",
    "cycle.with_rider",
    "cycle.without_rider",
    "pedestrian.moving",
    "pedestrian.standing",
)
INSTANCE_IDS = "instance_ids"
SPLITS = "splits"


@dataclass(frozen=True, eq=False)
class SceneTables:
    """Rows of one scene, by table, and its counts."""

    rows: dict[str, list[bytes]]
    annotations: int


def fixed_tables(options: SynthOptions, rig: Rig) -> dict[str, list[bytes]]:
    """Rows that no scene adds to: sensors, calibrations, categories, attributes, visibility levels."""
    rows: dict[str, list[bytes]] = {
        "category": [
            _row(token=token(options, "category", name), name=name, description="") for name in CATEGORIES.values()
        ],
        "attribute": [
            _row(token=token(options, "attribute", name), name=name, description="") for name in ATTRIBUTES
        ],
        "visibility": [msgspec.json.encode(row) for row in NUSCENES_VISIBILITY],
        "sensor": [],
        "calibrated_sensor": [],
    }
    lidar_pose = ego_from_lidar()
    sensors: list[tuple[str, str, Any, dict[str, Any]]] = [
        (LIDAR_REFERENCE, "lidar", lidar_pose, {"camera_intrinsic": []})
    ]
    for camera in rig.cameras:
        sensors.append((camera.channel, "camera", camera.ego_from_cam, calibration_of(camera.lens)))
    for channel, modality, pose, more in sensors:
        sensor = token(options, "sensor", channel)
        rows["sensor"].append(_row(token=sensor, channel=channel, modality=modality))
        rows["calibrated_sensor"].append(
            _row(
                token=_calibration_token(options, rig, channel),
                sensor_token=sensor,
                translation=pose[:3, 3].tolist(),
                rotation=quaternion_from_rotation(pose[:3, :3]).tolist(),
                **more,
            )
        )
    return rows


def scene_tables(options: SynthOptions, rig: Rig, scene: int, name: str, receipts: Sequence[Receipt]) -> SceneTables:
    """Rows of one scene.

    Args:
        name: the scene's name.
        receipts: of all its samples, in order.
    """
    rows: dict[str, list[bytes]] = defaultdict(list)
    log, scene_token = token(options, "log", scene), token(options, "scene", scene)
    rows["log"].append(
        _row(
            token=log,
            logfile=log_name(options, scene),
            vehicle="unidrive",
            date_captured="2026-01-01",
            location=f"unidrive-town-{options.seed}-{scene}",
        )
    )
    rows["map"].append(
        _row(
            category="semantic_prior",
            token=token(options, "map", scene),
            filename=map_name(options, scene),
            log_tokens=[log],
        )
    )
    samples = [token(options, "sample", scene, receipt.sample) for receipt in receipts]
    rows["scene"].append(
        _row(
            token=scene_token,
            log_token=log,
            nbr_samples=len(samples),
            first_sample_token=samples[0],
            last_sample_token=samples[-1],
            name=name,
            description="Synthetic drive by unidrive synth",
        )
    )
    for place, (receipt, own) in enumerate(zip(receipts, samples, strict=True)):
        key = next(record for record in receipt.records if record.channel == LIDAR_REFERENCE and record.is_key_frame)
        rows["sample"].append(
            _row(token=own, timestamp=key.timestamp_us, **_links(samples, place), scene_token=scene_token)
        )
    by_channel: dict[str, list[tuple[str, Record]]] = defaultdict(list)
    for receipt, own in zip(receipts, samples, strict=True):
        for record in receipt.records:
            by_channel[record.channel].append((own, record))
    sizes = {camera.channel: (camera.lens.width_px, camera.lens.height_px) for camera in rig.cameras}
    for channel, entries in by_channel.items():
        _sensor_rows(rows, options, rig, scene, channel, sizes.get(channel, (0, 0)), entries)
    annotations = _annotation_rows(rows, options, scene, scene_token, receipts, samples)
    return SceneTables(rows, annotations)


def calibration_of(lens: Lens) -> dict[str, Any]:
    """What a calibrated_sensor row says of a lens; a distorted one in the fields that T4 uses, and its model."""
    calibration: dict[str, Any] = {"camera_intrinsic": lens.matrix.tolist()}
    if lens.coefficients:
        calibration |= {"camera_distortion": list(lens.coefficients), "camera_model": lens.model}
    return calibration


def _sensor_rows(
    rows: dict[str, list[bytes]],
    options: SynthOptions,
    rig: Rig,
    scene: int,
    channel: str,
    size_px: tuple[int, int],
    entries: Sequence[tuple[str, Record]],
) -> None:
    """sample_data and ego_pose rows of one sensor in one scene, with (sample token, record) in order of time."""
    whose = () if channel == LIDAR_REFERENCE else (rig.digest,)
    tokens = [token(options, "sample_data", *whose, scene, channel, record.timestamp_us) for _, record in entries]
    for place, (sample_token, record) in enumerate(entries):
        own = tokens[place]
        rows["ego_pose"].append(
            _row(token=own, timestamp=record.timestamp_us, rotation=record.rotation, translation=record.translation)
        )
        rows["sample_data"].append(
            _row(
                token=own,
                sample_token=sample_token,
                ego_pose_token=own,
                calibrated_sensor_token=_calibration_token(options, rig, channel),
                timestamp=record.timestamp_us,
                fileformat="pcd" if channel == LIDAR_REFERENCE else "jpg",
                is_key_frame=record.is_key_frame,
                height=size_px[1],
                width=size_px[0],
                filename=record.filename,
                **_links(tokens, place),
            )
        )


def _annotation_rows(
    rows: dict[str, list[bytes]],
    options: SynthOptions,
    scene: int,
    scene_token: str,
    receipts: Sequence[Receipt],
    samples: Sequence[str],
) -> int:
    tracks: dict[int, list[tuple[int, Sighting]]] = defaultdict(list)
    for place, receipt in enumerate(receipts):
        for sighting in receipt.sightings:
            tracks[sighting.actor].append((place, sighting))
    by_sample: dict[int, list[bytes]] = defaultdict(list)
    count = 0
    for actor in sorted(tracks):
        track = _annotated(tracks[actor])
        if not track:
            continue
        kind = track[0][1].kind
        instance = token(options, "instance", scene, actor)
        tokens = [token(options, "sample_annotation", scene, place, actor) for place, _ in track]
        count += len(tokens)
        rows["instance"].append(
            _row(
                token=instance,
                category_token=token(options, "category", CATEGORIES[kind]),
                nbr_annotations=len(tokens),
                first_annotation_token=tokens[0],
                last_annotation_token=tokens[-1],
            )
        )
        rows[INSTANCE_IDS].append(
            _row(instance_token=instance, scene_token=scene_token, value=FIRST_ACTOR_ID + actor)
        )
        for index, (place, sighting) in enumerate(track):
            by_sample[place].append(
                _row(
                    token=tokens[index],
                    sample_token=samples[place],
                    instance_token=instance,
                    visibility_token=level_of(sighting.visible),
                    attribute_tokens=[token(options, "attribute", sighting.attribute)],
                    translation=sighting.translation,
                    size=sighting.size_wlh_m,
                    rotation=sighting.rotation,
                    **_links(tokens, index),
                    num_lidar_pts=sighting.lidar_points,
                    num_radar_pts=0,
                )
            )
    for place in sorted(by_sample):
        rows["sample_annotation"].extend(by_sample[place])
    return count


def _annotated(track: Sequence[tuple[int, Sighting]]) -> list[tuple[int, Sighting]]:
    """From the first to the last sample in which the lidar hits the actor; those between stay, as in nuScenes."""
    hit = [index for index, (_, sighting) in enumerate(track) if sighting.lidar_points]
    return list(track[hit[0] : hit[-1] + 1]) if hit else []


def _calibration_token(options: SynthOptions, rig: Rig, channel: str) -> str:
    whose = () if channel == LIDAR_REFERENCE else (rig.digest,)
    return token(options, "calibrated_sensor", *whose, channel)


def _links(tokens: Sequence[str], place: int) -> dict[str, str]:
    return {
        "prev": tokens[place - 1] if place else "",
        "next": tokens[place + 1] if place + 1 < len(tokens) else "",
    }


def _row(**fields: Any) -> bytes:
    return msgspec.json.encode(fields)


def scene_names(options: SynthOptions) -> dict[str, list[str]]:
    """Names of the scenes by split, in order: nuScenes' own, because many loaders know no others.

    Raises:
        UsageError: more scenes than the version's splits have names.
    """
    from nuscenes.utils import splits

    mini = options.version == "v1.0-mini"
    names = (
        {"mini_train": splits.mini_train, "mini_val": splits.mini_val}
        if mini
        else {
            "train": splits.train,
            "val": splits.val,
        }
    )
    train, val = names
    held_out = round(options.scenes * options.val_share)
    if options.scenes > 1 and options.val_share > 0:
        held_out = max(held_out, 1)
    held_out = min(held_out, len(names[val]))
    if options.scenes - held_out > len(names[train]):
        raise UsageError(
            f"{options.version} has names for {len(names[train])} training and {len(names[val])} validation "
            f"scenes, but --scenes {options.scenes} with --val-share {options.val_share:g} wants "
            f"{options.scenes - held_out} and {held_out}.",
            hint="Use --version v1.0-trainval, fewer scenes, or another --val-share.",
        )
    return {train: names[train][: options.scenes - held_out], val: names[val][:held_out]}
