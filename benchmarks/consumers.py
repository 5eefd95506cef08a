"""Whether off-the-shelf readers take a converted dataset: nuscenes-devkit, mmdetection3d, vis4d.

    python -m benchmarks.consumers DATASET

DATASET has the version folder v1.0-trainval and scenes of nuScenes' own train and val splits. Each reader works in a
process of its own, on a folder of links, because most write beside the tables. Says for each `accepted` and what it
read, `refused` and why, or `skipped` where it is not installed; the exit code is 1 where one refused.
`make consumers` makes a dataset and an environment for it.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import types
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nuscenes.nuscenes import NuScenes

from tests.evaluation import average_precisions

VERSION, SPLITS = "v1.0-trainval", ("train", "val")
CLASSES = (
    "car", "truck", "trailer", "bus", "construction_vehicle", "bicycle", "motorcycle", "pedestrian", "traffic_cone",
    "barrier",
)  # fmt: skip


def detection_eval(root: Path) -> str:
    """nuscenes-devkit's DetectionEval with the ground truth as the prediction."""
    lines = []
    for split in SPLITS:
        with tempfile.TemporaryDirectory() as work:
            found = average_precisions(root, split, Path(work), VERSION)
        wrong = {name: value for name, value in found.items() if value < 0.9999}
        assert found, f"no boxes of {split} are left to evaluate"
        assert not wrong, f"average precision below 1 in {split}: {wrong}"
        lines.append(f"{split}: {', '.join(found)}")
    return "AP 1 for " + "; ".join(lines)


def export_2d(root: Path) -> str:
    """The devkit's export_2d_annotations_as_json; it takes every picture for one of 1600x900."""
    script = ["-m", "nuscenes.scripts.export_2d_annotations_as_json"]
    options = ["--dataroot", str(root), "--version", VERSION, "--filename", "exported.json"]
    subprocess.run(
        [sys.executable, *script, *options], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    boxes = json.loads((root / VERSION / "exported.json").read_text())
    sizes = {
        row["token"]: (row["width"], row["height"])
        for row in NuScenes(VERSION, str(root), verbose=False).sample_data
    }
    for box in boxes:
        left, top, right, bottom = box["bbox_corners"]
        width, height = sizes[box["sample_data_token"]]
        assert 0 <= left <= right <= width, box
        assert 0 <= top <= bottom <= height, box
    assert boxes
    return f"{len(boxes)} boxes, none outside its picture"


def mmdetection3d(root: Path) -> str:
    """create_data of mmdetection3d 1.4, then its NuScenesDataset with all cameras and boxes."""
    _without_compiled_operations()
    mmdet3d = Path(str(importlib.import_module("mmdet3d").__file__)).parent
    sys.path.insert(0, str(mmdet3d / ".mim"))
    sys.path.insert(0, str(mmdet3d / ".mim" / "tools"))
    (root / "data").mkdir()
    (root / "data" / "nuscenes").symlink_to(root)  # where a part of it always looks
    os.chdir(root)
    converter = importlib.import_module("dataset_converters.nuscenes_converter")
    newer = importlib.import_module("dataset_converters.update_infos_to_v2")
    converter.create_nuscenes_infos(str(root), "nuscenes", version=VERSION, max_sweeps=1)
    importlib.import_module("mmengine.registry").init_default_scope("mmdet3d")
    dataset_class = importlib.import_module("mmdet3d.datasets").NuScenesDataset
    expected = _boxes_with_points(root)
    lines = []
    for split in SPLITS:
        name = f"nuscenes_infos_{split}.pkl"
        newer.update_pkl_infos("nuscenes", out_dir=str(root), pkl_path=str(root / name))
        dataset = dataset_class(
            data_root=f"{root}/",
            ann_file=name,
            pipeline=[
                {"type": "LoadMultiViewImageFromFiles", "num_views": 6},
                {"type": "LoadAnnotations3D", "with_bbox_3d": True, "with_label_3d": True},
            ],
            data_prefix={"pts": "samples/LIDAR_TOP", **{camera: f"samples/{camera}" for camera in _cameras(root)}},
            modality={"use_camera": True, "use_lidar": False},
            metainfo={"classes": CLASSES},
            filter_empty_gt=False,
            use_valid_flag=True,
        )
        boxes = 0
        for index in range(len(dataset)):
            item = dataset[index]
            assert len(item["img"]) == 6, len(item["img"])
            boxes += len(item["gt_bboxes_3d"])
        assert boxes == expected[split], f"{boxes} boxes of {split}; the tables have {expected[split]}"
        lines.append(f"{len(dataset)} samples of {split} with {boxes} boxes")
    return "; ".join(lines)


def vis4d(root: Path) -> str:
    """vis4d's NuScenes: all sensors of all samples."""
    (root / "can_bus").mkdir(exist_ok=True)  # it asks for the folder, not for anything in it
    nuscenes = importlib.import_module("vis4d.data.datasets.nuscenes").NuScenes
    lines = []
    for split in SPLITS:
        dataset = nuscenes(str(root), version=VERSION, split=split)
        boxes = 0
        for index in range(len(dataset)):
            item = dataset[index]
            boxes += len(item["LIDAR_TOP"]["boxes3d"])
            for camera in _cameras(root):
                assert item[camera]["images"].shape[1:3] == (900, 1600), item[camera]["images"].shape
        assert boxes, f"no boxes in {split}"
        lines.append(f"{len(dataset)} samples of {split} with {boxes} boxes")
    return "; ".join(lines)


READERS: dict[str, tuple[Callable[[Path], str], tuple[str, ...]]] = {
    "nuscenes-devkit DetectionEval": (detection_eval, ()),
    "nuscenes-devkit export_2d_annotations_as_json": (export_2d, ()),
    "mmdetection3d 1.4 create_data, NuScenesDataset": (mmdetection3d, ("mmdet3d", "mmcv", "mmdet")),
    "vis4d NuScenes": (vis4d, ("vis4d",)),
}


def _without_compiled_operations() -> None:
    """mmcv-lite has no compiled operations; datasets import, but do not call, them."""

    class Operations(types.ModuleType):
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):
                raise AttributeError(name)
            return None

    sys.modules["mmcv._ext"] = Operations("mmcv._ext")


def _cameras(root: Path) -> list[str]:
    rows = json.loads((root / VERSION / "sensor.json").read_text())
    return [row["channel"] for row in rows if row["modality"] == "camera"]


def _boxes_with_points(root: Path) -> Counter[str]:
    """By split: boxes of the detection classes that hold a lidar or radar point."""
    from nuscenes.eval.detection.utils import category_to_detection_name
    from nuscenes.utils.splits import create_splits_scenes

    nusc, splits, found = NuScenes(VERSION, str(root), verbose=False), create_splits_scenes(), Counter[str]()
    for row in nusc.sample_annotation:
        scene = nusc.get("scene", nusc.get("sample", row["sample_token"])["scene_token"])["name"]
        if category_to_detection_name(row["category_name"]) and row["num_lidar_pts"] + row["num_radar_pts"]:
            found.update(split for split in SPLITS if scene in splits[split])
    return found


def linked(dataset: Path, root: Path) -> Path:
    """A folder of links to a dataset, with tables of its own."""
    for entry in dataset.resolve().iterdir():
        if entry.name == VERSION:
            shutil.copytree(entry, root / VERSION)
        elif entry.is_dir() and not entry.name.startswith("."):
            (root / entry.name).symlink_to(entry)
        elif entry.is_file():
            shutil.copy(entry, root)
    return root


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--here", choices=READERS, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.here:
        with tempfile.TemporaryDirectory() as folder:
            print(READERS[chosen.here][0](linked(chosen.dataset, Path(folder))), file=sys.stderr)
        return 0
    refused = 0
    for name, (_, needed) in READERS.items():
        missing = [module for module in needed if importlib.util.find_spec(module) is None]
        if missing:
            print(f"skipped   {name}: {', '.join(missing)} cannot be imported")
            continue
        command = [sys.executable, "-m", "benchmarks.consumers", str(chosen.dataset), "--here", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        print(f"{'refused ' if done.returncode else 'accepted'}  {name}: {last}", flush=True)
        refused += bool(done.returncode)
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
