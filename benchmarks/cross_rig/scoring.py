"""nuScenes' own detection score of what a detector found."""

from __future__ import annotations

import io
import json
import tempfile
from collections import Counter
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from nuscenes import NuScenes
from nuscenes.eval.common.config import config_factory
from nuscenes.eval.detection.evaluate import DetectionEval
from pyquaternion import Quaternion

from benchmarks.cross_rig.config import CLASSES, RANGE_M
from benchmarks.cross_rig.frames import VERSION, Frame
from benchmarks.cross_rig.targets import Float32, Found

ATTRIBUTE = {
    "car": "vehicle.parked",
    "truck": "vehicle.moving",
    "bus": "vehicle.moving",
    "pedestrian": "pedestrian.moving",
    "motorcycle": "cycle.with_rider",
    "bicycle": "cycle.with_rider",
}
"""No attribute is learned: these are said of every box."""
LEAST_BOXES = 20
"""Classes of fewer boxes within reach are not counted."""


def score(root: Path, frames: list[Frame], found: list[Found]) -> dict[str, Any]:
    """mAP, NDS and per-class figures by nuscenes-devkit's DetectionEval, boxes within RANGE_M, all scenes of `val`.

    The devkit's ten classes become those of CLASSES of which enough boxes are there.
    """
    config = config_factory("detection_cvpr_2019")
    config.class_range = dict.fromkeys(config.class_range, RANGE_M)
    with tempfile.TemporaryDirectory() as folder, redirect_stderr(io.StringIO()):  # the devkit's progress bars
        nuscenes = NuScenes(VERSION, str(root), verbose=False)
        result = Path(folder) / "result.json"
        results = {frame.token: _boxes(frame, *said) for frame, said in zip(frames, found, strict=True)}
        result.write_text(json.dumps({"meta": {"use_camera": True}, "results": results}))
        evaluation = DetectionEval(nuscenes, config, str(result), "val", folder, verbose=False)
        boxes = Counter(box.detection_name for box in evaluation.gt_boxes.all)
        config.class_names = [name for name in CLASSES if boxes[name] >= LEAST_BOXES]
        metrics, _ = evaluation.evaluate()
    return {
        "mAP": metrics.mean_ap,
        "NDS": metrics.nd_score,
        "AP": {name: metrics.mean_dist_aps[name] for name in config.class_names},
        "errors": metrics.tp_errors,
        "boxes": dict(boxes),
    }


def _boxes(frame: Frame, classes: npt.NDArray[np.int64], scores: Float32, boxes: Float32) -> list[dict[str, Any]]:
    """One frame's findings as the devkit wants them, in the global frame."""
    ego = Quaternion(matrix=frame.global_from_ego, rtol=1e-5, atol=1e-5)
    centres = boxes[:, :3] @ frame.global_from_ego[:3, :3].T + frame.global_from_ego[:3, 3]
    return [
        {
            "sample_token": frame.token,
            "translation": centre.tolist(),
            "size": box[3:6].tolist(),
            "rotation": (ego * Quaternion(axis=[0, 0, 1], angle=float(box[6]))).elements.tolist(),
            "velocity": [0.0, 0.0],
            "detection_name": CLASSES[kind],
            "detection_score": float(said),
            "attribute_name": ATTRIBUTE[CLASSES[kind]],
        }
        for kind, said, box, centre in zip(classes, scores, boxes, centres, strict=True)
    ]
