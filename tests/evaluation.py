"""nuscenes-devkit's own evaluation, with the ground truth as the prediction."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from nuscenes.eval.common.config import config_factory
from nuscenes.eval.detection.evaluate import DetectionEval
from nuscenes.eval.detection.utils import category_to_detection_name
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.splits import get_scenes_of_split

from tests.datasets import VERSION


def average_precisions(root: Path, split: str, work: Path, version: str = VERSION) -> dict[str, float]:
    """Mean average precision of every class that is left after the evaluation's own filters.

    Args:
        split: name of one of nuScenes' own splits, or of one in `splits.json`.
        work: a folder for what the evaluation writes.
    """
    nusc = NuScenes(version=version, dataroot=str(root), verbose=False)
    scenes = set(get_scenes_of_split(split, nusc))
    results: dict[str, list[dict[str, object]]] = {}
    for sample in nusc.sample:
        if nusc.get("scene", sample["scene_token"])["name"] in scenes:
            results[sample["token"]] = [box for token in sample["anns"] for box in _predicted(nusc, token)]
    meta = {f"use_{kind}": kind == "lidar" for kind in ("camera", "lidar", "radar", "map", "external")}
    (work / "results.json").write_text(json.dumps({"meta": meta, "results": results}))
    config = config_factory("detection_cvpr_2019")
    evaluation = DetectionEval(nusc, config, str(work / "results.json"), split, str(work), verbose=False)
    metrics, _ = evaluation.evaluate()
    found = metrics.mean_dist_aps
    return {name: found[name] for name in sorted({box.detection_name for box in evaluation.gt_boxes.all})}


def _predicted(nusc: NuScenes, token: str) -> list[dict[str, object]]:
    row = nusc.get("sample_annotation", token)
    name = category_to_detection_name(row["category_name"])
    if name is None or not row["num_lidar_pts"] + row["num_radar_pts"]:
        return []  # not evaluated
    return [
        {
            "sample_token": row["sample_token"],
            **{field: row[field] for field in ("translation", "size", "rotation")},
            "velocity": np.nan_to_num(nusc.box_velocity(token)[:2]).tolist(),
            "detection_name": name,
            "detection_score": 1.0,
            "attribute_name": "".join(nusc.get("attribute", each)["name"] for each in row["attribute_tokens"]),
        }
    ]
