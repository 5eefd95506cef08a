"""The genuine nuScenes keyframe, converted: what the devkit and a consumer find in the output."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import BoxVisibility

from tests import reference
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.convert.run import convert
from unidrive_cli.rig.gallery import gallery_folder, load_gallery_rig
from unidrive_cli.tables.dataset import open_dataset

VERSION = "v1.0-mini"
SAMPLE = "ca9a282c9e77460f8360f564131a8af5"
RIG = "roof-6x70"


def run(source: Path, destination: Path, **options: object) -> Path:
    convert(make_plan(open_dataset(source), load_gallery_rig(RIG), Options(**options)), destination)
    return destination


@pytest.fixture(scope="module")
def keyframe(shared_data: Path) -> Path:
    return shared_data / "nuscenes-onekeyframe"


@pytest.fixture(scope="module")
def converted(keyframe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(keyframe, tmp_path_factory.mktemp("converted") / "out")


@pytest.fixture(scope="module")
def nusc(converted: Path) -> NuScenes:
    return NuScenes(version=VERSION, dataroot=str(converted), verbose=False)


def table(root: Path, name: str) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = json.loads((root / VERSION / f"{name}.json").read_text())
    return rows


def tree_digest(root: Path, apart: tuple[str, ...] = ("run.json",)) -> dict[str, str]:
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.relative_to(root).as_posix() not in apart
    }


def test_tokens_of_what_is_annotated_stay(keyframe: Path, converted: Path) -> None:
    for name in ("scene", "sample", "instance", "category", "attribute", "log", "map", "visibility"):
        assert table(converted, name) == table(keyframe, name)
    before, after = table(keyframe, "sample_annotation"), table(converted, "sample_annotation")
    assert len(after) == 69
    for old, new in zip(before, after, strict=True):
        assert {**old, "visibility_token": ""} == {**new, "visibility_token": ""}
        assert new["visibility_token"] <= old["visibility_token"]


def test_cameras_are_the_virtual_ones_only(keyframe: Path, converted: Path) -> None:
    sensors = table(converted, "sensor")
    cameras = [row for row in sensors if row["modality"] == "camera"]
    assert sorted(row["channel"] for row in cameras) == sorted(load_gallery_rig(RIG).channels)
    old_tokens = {
        row["token"] for name in ("sensor", "calibrated_sensor", "sample_data") for row in table(keyframe, name)
    }
    lidar = [row for row in table(converted, "sample_data") if "LIDAR_TOP" in row["filename"]]
    new = [row for row in table(converted, "sample_data") if row not in lidar]
    assert lidar == [row for row in table(keyframe, "sample_data") if "LIDAR_TOP" in row["filename"]]
    assert len(new) == 6
    assert not old_tokens & {row["token"] for row in [*cameras, *new]}
    for row in new:
        assert (row["timestamp"], row["is_key_frame"], row["width"], row["height"]) == (
            1532402927647951,
            True,
            1600,
            900,
        )
        channel = row["filename"].split("/")[1]
        stem = f"n015-2018-07-24-11-22-45+0800__{channel}__1532402927647951"
        assert row["filename"] == f"samples/{channel}/{stem}.jpg"
        mask = cv2.imread(str(converted / f"masks/{channel}/{stem}.png"), cv2.IMREAD_UNCHANGED)
        picture = cv2.imread(str(converted / row["filename"]))
        assert mask.shape == picture.shape[:2] == (900, 1600)
        black = cv2.erode((mask == 0).astype(np.uint8), np.ones((33, 33))) > 0
        assert picture[black].max(initial=0) <= 2
    poses = {row["token"]: row for row in table(converted, "ego_pose")}
    assert {json.dumps(poses[row["ego_pose_token"]]["translation"]) for row in new} == {
        json.dumps(poses[lidar[0]["ego_pose_token"]]["translation"])
    }
    assert len(poses) == 7


def test_the_devkit_opens_it_and_its_boxes_project_to_where_they_should(nusc: NuScenes, keyframe: Path) -> None:
    sample = nusc.sample[0]
    assert len(sample["anns"]) == 69
    truth = reference.load_sample(keyframe, VERSION, SAMPLE)
    ego_from_global = reference.inverse_pose(truth["reference_global_from_ego"])
    cameras = {camera["channel"]: camera for camera in reference.rig_from_yaml(gallery_folder() / f"{RIG}.yaml")}
    annotations = {row["token"]: row for row in table(keyframe, "sample_annotation")}
    projected = 0
    for channel, camera in cameras.items():
        _, boxes, intrinsic = nusc.get_sample_data(sample["data"][channel], box_vis_level=BoxVisibility.ANY)
        for box in boxes:
            by_devkit = intrinsic @ box.center
            centre_ego = reference.transform(ego_from_global, np.array(annotations[box.token]["translation"]))
            centre_cam = reference.transform(reference.inverse_pose(camera["ego_from_cam"]), centre_ego)
            by_hand = camera["K"] @ centre_cam
            np.testing.assert_allclose(by_devkit[:2] / by_devkit[2], by_hand[:2] / by_hand[2], atol=1e-3)
            projected += 1
    assert projected > 60


def test_the_devkit_renders_the_sample(nusc: NuScenes, tmp_path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    nusc.render_sample(SAMPLE, out_path=str(tmp_path / "sample.png"), verbose=False)
    assert cv2.imread(str(tmp_path / "sample.png")) is not None


def test_lidar_and_map_go_along(keyframe: Path, converted: Path, nusc: NuScenes) -> None:
    for pattern in ("samples/LIDAR_TOP/*", "maps/*"):
        (source,) = keyframe.glob(pattern)
        assert (converted / source.relative_to(keyframe)).read_bytes() == source.read_bytes()
    assert nusc.map[0]["mask"].mask().any()


def test_2d_boxes_have_the_devkits_form_and_lie_in_their_pictures(converted: Path) -> None:
    boxes = table(converted, "image_annotations")
    pictures = {row["token"]: row["filename"] for row in table(converted, "sample_data")}
    assert len({row["sample_annotation_token"] for row in boxes}) > 40
    for row in boxes:
        left, top, right, bottom = row["bbox_corners"]
        assert 0 <= left < right <= 1600
        assert 0 <= top < bottom <= 900
        assert row["filename"] == pictures[row["sample_data_token"]]
        assert row["category_name"]


def test_2d_boxes_are_those_of_the_devkits_own_exporter(converted: Path, nusc: NuScenes) -> None:
    """Where a box lies in front of the camera as a whole; nearer ones the exporter cuts at its corners."""
    from nuscenes.scripts import export_2d_annotations_as_json as exporter

    exporter.nusc = nusc
    ours = {
        (row["sample_data_token"], row["sample_annotation_token"]): row
        for row in table(converted, "image_annotations")
    }
    compared = 0
    for channel in load_gallery_rig(RIG).channels:
        token = nusc.sample[0]["data"][channel]
        for theirs in exporter.get_2d_boxes(token, ["", "1", "2", "3", "4"]):
            key = (token, theirs["sample_annotation_token"])
            if key in ours:
                assert set(ours[key]) == set(theirs)
                np.testing.assert_allclose(ours[key]["bbox_corners"], theirs["bbox_corners"], atol=0.01)
                compared += 1
    assert compared > 60


@pytest.mark.parametrize("jobs", [0, 2])
def test_a_second_run_gives_the_same_bytes(keyframe: Path, converted: Path, tmp_path: Path, jobs: int) -> None:
    assert tree_digest(run(keyframe, tmp_path / "again", jobs=jobs)) == tree_digest(converted)


def test_no_trace_of_the_work_is_left(converted: Path) -> None:
    assert sorted(path.name for path in converted.iterdir()) == [
        "TRAINING.md",
        "maps",
        "masks",
        "run.json",
        "samples",
        "unidrive.json",
        "v1.0-mini",
    ]


def test_provenance_names_source_rig_and_options(converted: Path) -> None:
    document = json.loads((converted / "unidrive.json").read_text())
    assert document["rig"]["digest"] == load_gallery_rig(RIG).digest
    assert document["plan"]["options"]["depth_limit_m"] == 50
    assert document["counts"]["annotations"] == 69
    assert document["failures"] == []
    assert str(converted) not in json.dumps(document)


def test_both_tri_cars_in_one_run(shared_data: Path, tmp_path: Path) -> None:
    """Scenes with other cars and channels, one with a sweep; an empty map name and attribute table."""
    destination = run(shared_data / "dgp-tri-2scenes", tmp_path / "out", jobs=2, masks="camera", sweeps=True)
    nusc = NuScenes(version="v1.0-dgp", dataroot=str(destination), verbose=False)
    assert (len(nusc.sample), len(nusc.sample_annotation)) == (5, 229)
    cameras = [row for row in nusc.sample_data if row["sensor_modality"] == "camera"]
    assert len(cameras) == 36
    lidar = [row for row in nusc.sample_data if row["channel"] == "LIDAR"]
    for scene, key_frames in (("scene_02", [True, True, True]), ("scene_01", [True, False, True])):
        first = nusc.get("scene", nusc.field2token("scene", "name", scene)[0])["first_sample_token"]
        for channel in load_gallery_rig(RIG).channels:
            token, chain = nusc.get("sample", first)["data"][channel], []
            while token:
                chain.append(nusc.get("sample_data", token))
                token = chain[-1]["next"]
            assert [row["is_key_frame"] for row in chain] == key_frames
            assert {row["timestamp"] for row in chain} == {
                row["timestamp"] for row in lidar if Path(row["filename"]).name.startswith(scene)
            }
            assert all((destination / row["filename"]).is_file() for row in chain)
    assert sorted(path.name for path in (destination / "sweeps").iterdir()) == sorted(
        ["LIDAR", *load_gallery_rig(RIG).channels]
    )
    behind = next((destination / "sweeps/CAM_BACK").iterdir())
    assert not cv2.imread(str(behind)).any(), "scene_01 has no camera that looks back"
    assert sorted(path.name for path in (destination / "masks").iterdir()) == sorted(
        f"{channel}.png" for channel in load_gallery_rig(RIG).channels
    )
    assert {row["visibility_token"] for row in nusc.sample_annotation} <= {"1", "2", "3", "4"}
