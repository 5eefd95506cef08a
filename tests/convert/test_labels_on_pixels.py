"""Labels sit on pixels: a converted drive's boxes against the drive itself, rendered through the virtual rig.

The instance pictures of the truth say which pixels an actor has. The converted dataset says where its box is, in its
own tables, read by nuscenes-devkit. Nothing is trained, and no figure here depends on taste.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from nuscenes.nuscenes import NuScenes

from tests.frames import render_samples
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.convert.run import convert
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.instances import instance_name
from unidrive_cli.warp.reduction import Copies

CAMERA = "  CAM_{name}: {{width: 480, height: 270, hfov: {hfov}, position: [{x}, {y}, {z}], yaw: {yaw}}}\n"
NAMES = ("FRONT", "FRONT_LEFT", "BACK_LEFT", "BACK", "BACK_RIGHT", "FRONT_RIGHT")
DRIVE = SynthOptions(seed=11, scenes=1, keyframes=4, firing="together", instances=True, samples_per_pixel=1)
DEPTH_LIMIT_M = 35.0
BANDS_M = (0, 10, 20, 80)


def ring(name: str, hfov: float, radius_m: float, x_m: float, z_m: float) -> Rig:
    """Six cameras that look outwards from a circle."""
    text = f"name: {name}\ncameras:\n"
    for number, channel in enumerate(NAMES):
        yaw = 60 * number
        x, y = x_m + radius_m * np.cos(np.deg2rad(yaw)), radius_m * np.sin(np.deg2rad(yaw))
        text += CAMERA.format(name=channel, hfov=hfov, x=round(x, 3), y=round(y, 3), z=z_m, yaw=yaw)
    return parse_rig(text, name)


SOURCE, VIRTUAL = ring("source", 80, 0.7, 0.9, 1.55), ring("virtual", 66, 0.3, 0.5, 1.75)


@dataclass(frozen=True)
class Seen:
    """An actor in a virtual picture.

    Attributes:
        kind: its category.
        truth, warped: (H, W) its pixels in the truth, and where the warp puts the sources' pixels of it.
        corners_px: (8, 2) its projected box.
        distance_m: from the camera to the box's nearest corner.
        reach_px: how far the warp may move it. A point that is assumed behind its true place, or on the sphere
            before it, is displaced by the way between the cameras over the nearer of the two distances; the way is
            that to the second nearest source camera.
    """

    kind: str
    truth: np.ndarray
    warped: np.ndarray
    corners_px: np.ndarray
    distance_m: float
    reach_px: float


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> list[Seen]:
    """The drive through both rigs, the one converted to the other, and what is to be seen in it."""
    root = tmp_path_factory.mktemp("labels")
    synthesise(make_synth_plan(DRIVE, [SOURCE, VIRTUAL], "auto"), root)
    options = Options(depth_limit_m=DEPTH_LIMIT_M)
    convert(make_plan(open_dataset(root / "source"), VIRTUAL, options), root / "converted")
    return list(_seen(root))


def _seen(root: Path) -> Iterator[Seen]:
    """Actors whole in a virtual picture, of some size, and hidden by nothing in the truth."""
    converted, virtual, source = (
        NuScenes(DRIVE.version, str(root / name), verbose=False) for name in ("converted", "virtual", "source")
    )
    ids = json.loads((root / "source" / DRIVE.version / "instance_ids.json").read_text())
    values = {row["instance_token"]: row["value"] for row in ids}
    for rendered in render_samples(root / "source", VIRTUAL, depth_limit_m=DEPTH_LIMIT_M):
        sources = [_instances(source, rendered.sample_token, channel) for channel in rendered.sources]
        for camera in VIRTUAL.cameras:
            row = converted.get("sample", rendered.sample_token)["data"][camera.channel]
            truth = _instances(virtual, rendered.sample_token, camera.channel)
            _, boxes, intrinsic = converted.get_sample_data(row)
            for box in boxes:
                corners = box.corners()
                if corners[2].min() < 0.5:
                    continue
                annotation = converted.get("sample_annotation", box.token)
                value = values[annotation["instance_token"]]
                corners_px = (intrinsic @ (corners / corners[2]))[:2].T
                mine, size = truth == value, [truth.shape[1] - 2, truth.shape[0] - 2]
                if corners_px.min() < 1 or (corners_px > size).any() or mine.sum() < 60:
                    continue
                if annotation["visibility_token"] != "4":
                    continue
                layers = [np.repeat(255 * (ids == value)[..., None], 3, axis=2).astype(np.uint8) for ids in sources]
                warped = rendered.tables[camera.channel].render(Copies(layers))[..., 0] >= 128
                distance_m = float(np.linalg.norm(corners, axis=0).min())
                ways_m = sorted(np.linalg.norm(other.centre_ego - camera.centre_ego) for other in SOURCE.cameras)
                reach_px = intrinsic[0, 0] * ways_m[1] / min(distance_m - ways_m[1], DEPTH_LIMIT_M)
                yield Seen(box.name, mine, warped, corners_px, distance_m, reach_px)


def _instances(nusc: NuScenes, sample_token: str, channel: str) -> np.ndarray:
    """The instance picture (H, W) of a sample's camera."""
    row = nusc.get("sample_data", nusc.get("sample", sample_token)["data"][channel])
    picture = cv2.imread(str(Path(nusc.dataroot) / instance_name(row["filename"])), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return picture


def rectangle(points: np.ndarray) -> np.ndarray:
    """Left, top, right, bottom of points (n, 2)."""
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def of_mask(mask: np.ndarray) -> np.ndarray:
    """Left, top, right, bottom of the pixel areas of a mask."""
    return rectangle(np.argwhere(mask)[:, ::-1]) + np.array([-0.5, -0.5, 0.5, 0.5])


def iou(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two rectangles."""
    sides = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    shared = float(np.prod(np.maximum(sides, 0)))
    return shared / (np.prod(one[2:] - one[:2]) + np.prod(other[2:] - other[:2]) - shared)


def test_every_pixel_of_an_actor_lies_in_its_box(seen: list[Seen]) -> None:
    """The converted tables' calibration, poses and boxes, against what a camera there would see."""
    assert len(seen) > 30
    for actor in seen:
        hull = cv2.convexHull(actor.corners_px.astype(np.float32))
        for x, y in np.argwhere(actor.truth)[:, ::-1].tolist():
            assert cv2.pointPolygonTest(hull, (x, y), True) > -0.1, actor.kind


def test_boxes_are_no_larger_than_what_is_seen(seen: list[Seen]) -> None:
    """The outline of eight corners is wider than a rounded body, by a share that does not grow with distance."""
    cars = [actor for actor in seen if actor.kind == "vehicle.car"]
    overlaps = np.array([iou(rectangle(actor.corners_px), of_mask(actor.truth)) for actor in cars])
    assert len(cars) > 15
    assert overlaps.min() > 0.65
    assert np.median(overlaps) > 0.75


def test_the_warp_moves_actors_no_farther_than_the_way_between_the_cameras(seen: list[Seen]) -> None:
    for actor in seen:
        assert actor.warped.any()
        moved = np.argwhere(actor.warped).mean(axis=0) - np.argwhere(actor.truth).mean(axis=0)
        assert np.linalg.norm(moved) < actor.reach_px + 1


def test_boxes_lie_on_what_the_converted_pictures_show_in_every_distance(seen: list[Seen]) -> None:
    """As well as on the truth, whose overlap with a box is what an exact picture would have."""
    bands = defaultdict(list)
    for actor in seen:
        box = rectangle(actor.corners_px)
        overlaps = iou(box, of_mask(actor.warped)), iou(box, of_mask(actor.truth))
        bands[int(np.searchsorted(BANDS_M, actor.distance_m))].append(overlaps)
    assert len(bands) == len(BANDS_M) - 1
    for overlaps in bands.values():
        warped, truth = np.mean(overlaps, axis=0)
        assert warped > truth - 0.05
