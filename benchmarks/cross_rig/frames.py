"""A nuScenes-format dataset as the arrays that a detector needs: pictures, calibration, boxes in the ego frame."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pyquaternion import Quaternion

from benchmarks.cross_rig.config import CLASSES, SEEN, STRIDE

Float32 = npt.NDArray[np.float32]
DEPTHS_M = np.arange(2.0, 34.0, 1.0, dtype=np.float32)
"""Depths that a detector may say, metres along the optical axis."""
NO_DEPTH = 255
VERSION = "v1.0-trainval"
TABLES = (
    *("sample", "sample_data", "calibrated_sensor", "sensor", "ego_pose"),
    *("sample_annotation", "instance", "category"),
)
CATEGORY = {
    "vehicle.car": "car",
    "vehicle.truck": "truck",
    "vehicle.bus": "bus",
    "human.pedestrian": "pedestrian",
    "vehicle.motorcycle": "motorcycle",
    "vehicle.bicycle": "bicycle",
}
"""Beginnings of category names, and the class that nuScenes' detection task makes of them."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Calibration of the pictures that the detector sees.

    Attributes:
        intrinsics: (C, 3, 3) pixels of SEEN.
        ego_from_cam: (C, 4, 4).
    """

    intrinsics: Float32
    ego_from_cam: Float32


@dataclass(frozen=True, eq=False)
class Frame:
    """One sample.

    Attributes:
        token: of the sample.
        pictures: (C, 3, H, W) uint8, RGB.
        depth: (C, H / STRIDE, W / STRIDE) uint8, the index in DEPTHS_M of the nearest lidar point, or NO_DEPTH.
        global_from_ego: (4, 4) float64.
        classes: (n,) index in CLASSES.
        boxes: (n, 7) x, y, z, width, length, height in metres, yaw in radians, in the ego frame.
    """

    token: str
    pictures: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.uint8]
    global_from_ego: npt.NDArray[np.float64]
    classes: npt.NDArray[np.int64]
    boxes: Float32


def read_frames(root: Path) -> tuple[Rig, list[Frame]]:
    """All samples of a dataset whose cameras all have the sample's own ego pose and one calibration.

    Boxes without lidar points are left out, as nuScenes' evaluation does.

    Raises:
        ValueError: the cameras move, or fire at other times than the sample.
    """
    tables = {name: json.loads((root / VERSION / f"{name}.json").read_text()) for name in TABLES}
    by_token = {name: {row["token"]: row for row in rows} for name, rows in tables.items()}
    pictures: dict[str, dict[str, dict[str, Any]]] = defaultdict(dict)
    for row in tables["sample_data"]:
        if (channel := _of(row, by_token)).startswith("CAM"):
            pictures[row["sample_token"]][channel] = row
    clouds = {row["sample_token"]: row for row in tables["sample_data"] if _of(row, by_token) == "LIDAR_TOP"}
    annotations: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in tables["sample_annotation"]:
        annotations[row["sample_token"]].append(row)
    rigs, frames = [], []
    for sample in tables["sample"]:
        rows = [row for _, row in sorted(pictures[sample["token"]].items())]
        poses = {row["ego_pose_token"] for row in rows}
        places = np.array([_pose(by_token["ego_pose"][pose]) for pose in poses])
        if np.ptp(places, axis=0).max() > 1e-6:
            raise ValueError(f"{root}: the cameras of sample {sample['token']} do not fire together.")
        rigs.append(_rig(rows, by_token["calibrated_sensor"]))
        global_from_ego = places[0]
        found = _boxes(annotations[sample["token"]], by_token, global_from_ego)
        seen = np.stack([_picture(root / row["filename"]) for row in rows])
        cloud = clouds[sample["token"]]
        points = np.fromfile(root / cloud["filename"], np.float32).reshape(-1, 5)[:, :3]
        lidar = _pose(by_token["calibrated_sensor"][cloud["calibrated_sensor_token"]])
        depth = _depth(points @ lidar[:3, :3].T + lidar[:3, 3], rigs[-1])
        frames.append(Frame(sample["token"], seen, depth, global_from_ego, *found))
    for rig in rigs:
        if not np.allclose(rig.ego_from_cam, rigs[0].ego_from_cam, atol=1e-6):
            raise ValueError(f"{root}: the calibration changes.")
    return rigs[0], frames


def veil(filled: npt.NDArray[np.bool_]) -> Float32:
    """(C, 1, H, W) from 0 to 1: what is left of each pixel that the detector sees where (C, H, W) is filled."""
    small = [cv2.resize(mask.astype(np.float32), SEEN, interpolation=cv2.INTER_AREA) for mask in filled]
    veils: Float32 = np.minimum(np.stack(small)[:, None], np.float32(1))
    return veils


def _pose(row: dict[str, Any]) -> npt.NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = Quaternion(row["rotation"]).rotation_matrix
    pose[:3, 3] = row["translation"]
    return pose


def _rig(rows: list[dict[str, Any]], calibrations: dict[str, dict[str, Any]]) -> Rig:
    intrinsics, poses = [], []
    for row in rows:
        calibration = calibrations[row["calibrated_sensor_token"]]
        scale = np.array([SEEN[0] / row["width"], SEEN[1] / row["height"], 1.0])
        middle = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # integer coordinates are pixel centres
        matrix = np.array(calibration["camera_intrinsic"]) + middle
        intrinsics.append(matrix * scale[:, None] - middle)
        poses.append(_pose(calibration))
    return Rig(np.array(intrinsics, np.float32), np.array(poses, np.float32))


def _picture(path: Path) -> npt.NDArray[np.uint8]:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{path} is no picture.")
    small = cv2.resize(picture, SEEN, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small[..., ::-1].transpose(2, 0, 1)).astype(np.uint8)


def _of(row: dict[str, Any], by_token: dict[str, dict[str, Any]]) -> str:
    """The channel of a key frame; empty for what is none."""
    sensor = by_token["calibrated_sensor"][row["calibrated_sensor_token"]]["sensor_token"]
    return str(by_token["sensor"][sensor]["channel"]) if row["is_key_frame"] else ""


def _depth(points: npt.NDArray[Any], rig: Rig) -> npt.NDArray[np.uint8]:
    """What the pictures' features should say about lidar points (n, 3) in the ego frame."""
    shape = (SEEN[1] // STRIDE, SEEN[0] // STRIDE)
    nearest = np.full((len(rig.intrinsics), *shape), NO_DEPTH, np.uint8)
    for level, intrinsic, ego_from_cam in zip(nearest, rig.intrinsics, rig.ego_from_cam, strict=True):
        cam = (points - ego_from_cam[:3, 3]) @ ego_from_cam[:3, :3]
        cam = cam[(cam[:, 2] > DEPTHS_M[0] - 0.5) & (cam[:, 2] < DEPTHS_M[-1] + 0.5)]
        pixel = (cam @ intrinsic.T)[:, :2] / cam[:, 2:]
        cell = np.floor((pixel + 0.5) / STRIDE).astype(np.int64)
        inside = ((cell >= 0) & (cell < [shape[1], shape[0]])).all(axis=1)
        said = np.abs(cam[inside, 2:] - DEPTHS_M).argmin(axis=1).astype(np.uint8)
        np.minimum.at(level, (cell[inside, 1], cell[inside, 0]), said)
    return nearest


def _boxes(
    rows: Iterable[dict[str, Any]], by_token: dict[str, dict[str, Any]], global_from_ego: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.int64], Float32]:
    ego_from_global = np.linalg.inv(global_from_ego)
    classes, boxes = [], []
    for row in rows:
        category = by_token["category"][by_token["instance"][row["instance_token"]]["category_token"]]["name"]
        names = list(_detection_names(category))
        if not names or not row["num_lidar_pts"] + row["num_radar_pts"]:
            continue
        pose = ego_from_global @ _pose(row)
        classes.append(CLASSES.index(names[0]))
        boxes.append([*pose[:3, 3], *row["size"], np.arctan2(pose[1, 0], pose[0, 0])])
    return np.array(classes, np.int64), np.array(boxes, np.float32).reshape(-1, 7)


def _detection_names(category: str) -> Iterator[str]:
    return (name for beginning, name in CATEGORY.items() if category.startswith(beginning))
