"""The smallest nuScenes-format tables that are whole: one scene, three samples, a camera, a lidar, one car."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

Tables = dict[str, list[dict[str, Any]]]
VERSION = "v1.0-mini"


def tables() -> Tables:
    """All 13 tables; every token says what it is."""
    names = ["s0", "s1", "s2"]
    links = list(zip(names, ["", *names], [*names[1:], ""], strict=False))
    made: Tables = {
        "sensor": [
            {"token": "cam", "channel": "CAM_FRONT", "modality": "camera"},
            {"token": "lidar", "channel": "LIDAR_TOP", "modality": "lidar"},
        ],
        "calibrated_sensor": [
            {
                "token": f"calibrated-{sensor}",
                "sensor_token": sensor,
                "translation": [1.5, 0.0, 1.6],
                "rotation": [0.5, -0.5, 0.5, -0.5],
                "camera_intrinsic": [[800, 0, 799.5], [0, 800, 449.5], [0, 0, 1]] if sensor == "cam" else [],
            }
            for sensor in ("cam", "lidar")
        ],
        "scene": [
            {
                "token": "scene",
                "name": "scene-0001",
                "description": "",
                "log_token": "log",
                "nbr_samples": 3,
                "first_sample_token": "s0",
                "last_sample_token": "s2",
            }
        ],
        "instance": [
            {
                "token": "car",
                "category_token": "vehicle.car",
                "nbr_annotations": 3,
                "first_annotation_token": "car-s0",
                "last_annotation_token": "car-s2",
            }
        ],
        "category": [{"token": "vehicle.car", "name": "vehicle.car", "description": ""}],
        "attribute": [],
        "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
        "log": [{"token": "log", "logfile": "n0", "vehicle": "", "date_captured": "", "location": ""}],
        "map": [{"token": "map", "log_tokens": ["log"], "category": "semantic_prior", "filename": "maps/a.png"}],
        **{name: [] for name in ("sample", "sample_data", "ego_pose", "sample_annotation")},
    }
    for index, (name, before, after) in enumerate(links):
        time = 1_000_000 + 500_000 * index
        made["sample"].append(
            {"token": name, "timestamp": time, "scene_token": "scene", "prev": before, "next": after}
        )
        made["ego_pose"].append(
            {"token": f"ego-{name}", "timestamp": time, "translation": [5.0 * index, 0, 0], "rotation": [1, 0, 0, 0]}
        )
        for sensor, folder, size in (("cam", "CAM_FRONT", (1600, 900)), ("lidar", "LIDAR_TOP", (None, None))):
            made["sample_data"].append(
                {
                    "token": f"{sensor}-{name}",
                    "sample_token": name,
                    "ego_pose_token": f"ego-{name}",
                    "calibrated_sensor_token": f"calibrated-{sensor}",
                    "timestamp": time,
                    "fileformat": "jpg" if sensor == "cam" else "pcd",
                    "is_key_frame": True,
                    "width": size[0],
                    "height": size[1],
                    "filename": f"samples/{folder}/{name}",
                    "prev": before and f"{sensor}-{before}",
                    "next": after and f"{sensor}-{after}",
                }
            )
        made["sample_annotation"].append(
            {
                "token": f"car-{name}",
                "sample_token": name,
                "instance_token": "car",
                "translation": [30.0, 2.0, 0.8],
                "size": [2.0, 4.5, 1.6],
                "rotation": [1, 0, 0, 0],
                "prev": before and f"car-{before}",
                "next": after and f"car-{after}",
                "visibility_token": "4",
                "attribute_tokens": [],
                "num_lidar_pts": 9,
                "num_radar_pts": 0,
            }
        )
    return made


def write(root: Path, made: Tables | None = None, version: str = VERSION) -> Path:
    """Writes the tables below root/version and returns the root."""
    folder = root / version
    folder.mkdir(parents=True)
    for name, rows in (tables() if made is None else made).items():
        (folder / f"{name}.json").write_text(json.dumps(rows))
    return root
