"""Rewrites a painted dataset, in place, into the layouts of other families."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

from tests.datasets import Row
from tests.painted import FIELDS, FIRST_SAMPLE_US

Tables = dict[str, list[Row]]
UTM_M = (600_000.0, 5_000_000.0)
"""How far east and north TruckScenes' coordinates begin here."""
NOWHERE = "f" * 64


def nuscenes_test(root: Path) -> Path:
    """nuScenes' test split: no instances, no annotations."""
    tables = _taken(root)
    tables["instance"], tables["sample_annotation"] = [], []
    return _put(root, "v1.0-test", tables)


def lyft(root: Path) -> Path:
    """Lyft Level 5, an extract: folders of one name, flat files, 64-digit tokens, float times, open lists."""
    tables = _renamed_tokens(_taken(root), lambda token: token * 2)
    for row in tables["sample_data"]:
        flat = "images" if row["fileformat"] == "jpg" else "lidar"
        name = PurePosixPath(row["filename"]).name.replace(".jpg", ".jpeg").replace(".pcd.bin", ".bin")
        _move(root, row, f"{flat}/{name}")
        row["fileformat"] = "jpeg" if flat == "images" else "bin"
        if flat == "lidar":
            del row["width"], row["height"]
    for table in ("sample", "sample_data", "ego_pose"):
        for row in tables[table]:
            row["timestamp"] = row["timestamp"] + 0.25
    for row in tables["sample_annotation"]:
        row.update(visibility_token="", num_lidar_pts=-1)
    for row in tables["calibrated_sensor"]:
        if row["camera_intrinsic"]:
            row["camera_intrinsic"][0][1] = 0
    log = tables["log"][0]
    tables["log"] = [{**log, "token": scene["token"], "logfile": ""} for scene in tables["scene"]]
    tables["map"][0].update(log_tokens=[scene["token"] for scene in tables["scene"]])
    for scene in tables["scene"]:
        scene.update(log_token=scene["token"], nbr_samples=126, last_sample_token=NOWHERE)
    ends = [row for row in tables["sample"] if not row["next"]]
    for row in (*ends, *(row for row in tables["sample_data"] if not row["next"])):
        row["next"] = NOWHERE
    tables["instance"][0].update(nbr_annotations=103, last_annotation_token=NOWHERE)
    inner = root / "v1.01-train"
    inner.mkdir()
    for name in ("images", "lidar", "maps"):
        (root / name).rename(inner / name)
    return _put(inner, "v1.01-train", tables).parent


def t4(root: Path) -> Path:
    """T4: `annotation/`, `data/CH/`, levels by name, more tables and fields; CAM_FRONT's first picture is void."""
    tables = _taken(root)
    channels = _channels(tables)
    numbers: dict[str, int] = {}
    for row in sorted(tables["sample_data"], key=lambda row: row["timestamp"]):
        channel = channels[row["calibrated_sensor_token"]]
        numbers[channel] = number = numbers.get(channel, -1) + 1
        suffix = ".jpg" if row["fileformat"] == "jpg" else ".pcd.bin"
        _move(root, row, f"data/{channel}/{number:05d}{suffix}")
        row.update(fileformat=suffix[1:], is_valid=(channel, number) != ("CAM_FRONT", 0), info_filename=None)
        if not row["is_key_frame"]:
            row["sample_token"] = ""
        if channel == "LIDAR_TOP":
            row["info_filename"] = f"data/LIDAR_TOP_INFO/{number:05d}.json"
            _write(root / row["info_filename"], {"stamp": number})
    levels = dict(zip("1234", ("none", "partial", "most", "full"), strict=True))
    tables["visibility"] = [
        {"token": hashlib.md5(name.encode()).hexdigest(), "level": name, "description": ""}
        for name in levels.values()
    ]
    tokens = {row["level"]: row["token"] for row in tables["visibility"]}
    for row in tables["sample_annotation"]:
        row.update(
            visibility_token=tokens[levels[row["visibility_token"]]], velocity=None, automatic_annotation=True
        )
    for row in tables["calibrated_sensor"]:
        row["camera_distortion"] = [0.0] * 5 if row["camera_intrinsic"] else []
    for row in tables["ego_pose"]:
        row.update(twist=None, acceleration=None, geocoordinate=None)
    for row in tables["instance"]:
        row["instance_name"] = f"thing-{row['token'][:4]}"
    for row in tables["log"]:
        row["data_captured"] = row.pop("date_captured")
    shutil.rmtree(root / "maps")
    tables["map"][0]["filename"] = "map/lanelet2_map.osm"
    (root / "map").mkdir()
    (root / "map" / "lanelet2_map.osm").write_text("<osm/>\n")
    _write(root / "status.json", {"status": "ready"})
    picture = next(row for row in tables["sample_data"] if row["fileformat"] == "jpg")
    tables["object_ann"] = [{"token": "a", "sample_data_token": picture["token"], "bbox": [1, 2, 3, 4]}]
    tables["surface_ann"] = []
    tables["vehicle_state"] = [{"token": "b", "timestamp": FIRST_SAMPLE_US, "shift_state": "FORWARD"}]
    return _put(root, "annotation", tables)


def truckscenes(root: Path) -> Path:
    """MAN TruckScenes: no logs and maps, motion in tables of its own, levels as numbers, UTM coordinates."""
    tables = _taken(root)
    del tables["log"], tables["map"]
    shutil.rmtree(root / "maps")
    for row in tables["scene"]:
        row["log_token"] = ""
    for row in (*tables["ego_pose"], *tables["sample_annotation"]):
        row["translation"] = [
            *(a + b for a, b in zip(row["translation"], UTM_M, strict=False)),
            row["translation"][2],
        ]
    for index, row in enumerate(tables["category"]):
        row["index"] = index
    for row in tables["visibility"]:
        row["level"] = int(row["token"])
    tables["sample_annotation"][0]["visibility_token"] = ""
    motion = {"token": "c", "timestamp": FIRST_SAMPLE_US, "vx": 9.0, "yaw_rate": 0.05}
    tables["ego_motion_cabin"], tables["ego_motion_chassis"] = [motion], [motion]
    tables["weather_annotation"] = [{"token": "d", "scene_token": tables["scene"][0]["token"], "rain": 0}]
    return _put(root, "v1.1-mini", tables)


def carla(root: Path) -> Path:
    """carla_nuscenes: `progress.json` a mapping, scenes from time zero in tenths of microseconds, no map picture."""
    tables = _taken(root)
    scenes = {row["token"]: row["scene_token"] for row in tables["sample"]}
    starts: dict[str, int] = {}
    for row in tables["sample_data"]:
        scene = scenes[row["sample_token"]]
        starts[scene] = min(starts.get(scene, row["timestamp"]), row["timestamp"])
    moments = {row["ego_pose_token"]: starts[scenes[row["sample_token"]]] for row in tables["sample_data"]}
    for row in tables["ego_pose"]:
        row["timestamp"] = (row["timestamp"] - moments[row["token"]]) * 10
    for row in tables["sample_data"]:
        row["timestamp"] = (row["timestamp"] - starts[scenes[row["sample_token"]]]) * 10
    for row in tables["sample"]:
        row["timestamp"] = (row["timestamp"] - starts[row["scene_token"]]) * 10
    shutil.rmtree(root / "maps")
    (root / "maps").mkdir()
    put = _put(root, "v1.14", tables)
    _write(root / "v1.14" / "progress.json", {"current_world_index": 1, "current_scene_count": len(tables["scene"])})
    return put


def numbered(root: Path) -> Path:
    """UniDrive's own: tokens are numbers, and all sensors of a frame have the pose of its lidar."""
    tables = _taken(root)
    poses = {row["token"]: row for row in tables["ego_pose"]}
    channels = _channels(tables)
    lidars = {
        row["sample_token"]: poses[row["ego_pose_token"]]
        for row in tables["sample_data"]
        if channels[row["calibrated_sensor_token"]] == "LIDAR_TOP" and row["is_key_frame"]
    }
    for row in tables["sample_data"]:
        if row["is_key_frame"]:
            pose = lidars[row["sample_token"]]
            poses[row["ego_pose_token"]].update({name: pose[name] for name in ("translation", "rotation")})
    numbers = {row["token"]: str(number + 1) for number, row in enumerate(tables["sample"])}
    for table, rows in tables.items():
        if table not in ("sample", "visibility"):
            for row in rows:
                numbers.setdefault(row["token"], str(301 * 10**29 + 1 + len(numbers)))
    return _put(root, "v1.0-trainval", _renamed_tokens(tables, lambda token: numbers.get(token, token)))


def _taken(root: Path) -> Tables:
    """The tables of a painted dataset, whose version folder is gone."""
    tables = {name: json.loads((root / "v1.0-mini" / f"{name}.json").read_text()) for name in FIELDS}
    shutil.rmtree(root / "v1.0-mini")
    return tables


def _put(root: Path, version: str, tables: Tables) -> Path:
    for name, rows in tables.items():
        _write(root / version / f"{name}.json", rows)
    return root


def _write(path: Path, document: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1))


def _move(root: Path, row: Row, name: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / row["filename"]).rename(root / name)
    row["filename"] = name


def _channels(tables: Tables) -> dict[str, str]:
    """Channels by calibrated_sensor token."""
    channels = {row["token"]: row["channel"] for row in tables["sensor"]}
    return {row["token"]: channels[row["sensor_token"]] for row in tables["calibrated_sensor"]}


def _renamed_tokens(tables: Tables, rename: Callable[[str], str]) -> Tables:
    """All tokens of 32 hexadecimal digits, wherever they stand, renamed."""

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: renamed(one) for name, one in value.items()}
        if isinstance(value, list):
            return [renamed(one) for one in value]
        is_token = isinstance(value, str) and len(value) == 32 and set(value) <= set("0123456789abcdef")
        return rename(value) if is_token else value

    return {name: renamed(rows) for name, rows in tables.items()}
