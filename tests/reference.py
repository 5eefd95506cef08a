"""A second, independent implementation of the warp: the oracle of the tests.

Written from the project's geometry page alone. It imports nothing of the package, uses no remapping
library, and prefers plain float64 arithmetic to speed.

Frames: ego (x forward, y left, z up, metres, origin on the ground under the rear axle), camera (x right,
y down, z along the optical axis), global. ``a_from_b`` is a 4x4 that takes points of frame b to frame a.
Pixels: integers are pixel centres, the image covers [-0.5, W-0.5] x [-0.5, H-0.5].
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

PIXEL_TOLERANCE = 1e-6  # pixels; rounding allowed at the border of a source picture
BLOCK_ROWS = 64  # virtual rows worked on at once by reference_view

# Axes of a level camera that looks along ego +x: columns are its x, y and z axis in the ego frame.
LEVEL_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


# --- poses -------------------------------------------------------------------------------------------


def quaternion_matrix(quaternion: Any) -> np.ndarray:
    """Rotation matrix (3, 3) of a quaternion (w, x, y, z), normalised first."""
    w, x, y, z = np.asarray(quaternion, dtype=np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def yaw_pitch_roll_matrix(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Rotation (3, 3) of ego_from_cam: Rz(yaw) Ry(-pitch) Rx(roll) R0, degrees; positive is left, up."""
    a, b, c = math.radians(yaw), math.radians(-pitch), math.radians(roll)
    rz = np.array([[math.cos(a), -math.sin(a), 0.0], [math.sin(a), math.cos(a), 0.0], [0.0, 0.0, 1.0]])
    ry = np.array([[math.cos(b), 0.0, math.sin(b)], [0.0, 1.0, 0.0], [-math.sin(b), 0.0, math.cos(b)]])
    rx = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(c), -math.sin(c)], [0.0, math.sin(c), math.cos(c)]])
    return rz @ ry @ rx @ LEVEL_CAMERA


def pose(rotation: np.ndarray, translation: Any) -> np.ndarray:
    """The 4x4 of a rotation (3, 3) and a translation (3,) in metres."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def inverse_pose(a_from_b: np.ndarray) -> np.ndarray:
    """b_from_a of a rigid a_from_b (4, 4)."""
    rotation = a_from_b[:3, :3].T
    return pose(rotation, -rotation @ a_from_b[:3, 3])


def transform(a_from_b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) of frame b, metres, in frame a."""
    return points @ a_from_b[:3, :3].T + a_from_b[:3, 3]


# --- a dataset's tables ------------------------------------------------------------------------------


def load_sample(root: Path, version: str, sample_token: str) -> dict[str, Any]:
    """The camera keyframes of one sample and its reference pose, read from the JSON tables of root/version.

    Returns ``reference_global_from_ego`` (4, 4) and ``reference_timestamp`` (us): those of the lidar
    keyframe (LIDAR_TOP before other lidars), else of the camera keyframe nearest in time to the sample; and
    ``cameras``, one dict per camera keyframe, in table order: channel, K (3, 3), width, height (pixels),
    ego_from_cam (4, 4), global_from_ego (4, 4) at its own time, timestamp (us), path.
    """

    def table(name: str) -> dict[str, dict[str, Any]]:
        rows = json.loads((Path(root) / version / f"{name}.json").read_text(encoding="utf-8"))
        return {row["token"]: row for row in rows}

    samples, sample_data, ego_poses = table("sample"), table("sample_data"), table("ego_pose")
    calibrated_sensors, sensors = table("calibrated_sensor"), table("sensor")

    sample_time = samples[sample_token]["timestamp"]
    cameras, lidars = [], []
    for row in sample_data.values():
        if row["sample_token"] != sample_token or not row["is_key_frame"]:
            continue
        calibration = calibrated_sensors[row["calibrated_sensor_token"]]
        sensor = sensors[calibration["sensor_token"]]
        ego = ego_poses[row["ego_pose_token"]]
        item = {
            "channel": sensor["channel"],
            "global_from_ego": pose(quaternion_matrix(ego["rotation"]), ego["translation"]),
            "timestamp": row["timestamp"],
            "path": Path(root) / row["filename"],
        }
        if sensor["modality"] == "lidar":
            lidars.append(item)
        elif sensor["modality"] == "camera":
            item["K"] = np.array(calibration["camera_intrinsic"], dtype=np.float64)
            item["width"], item["height"] = row["width"], row["height"]
            item["ego_from_cam"] = pose(quaternion_matrix(calibration["rotation"]), calibration["translation"])
            cameras.append(item)

    def nearness(item: dict[str, Any]) -> tuple[float, str]:
        return abs(item["timestamp"] - sample_time), item["channel"]

    if lidars:
        reference = min(lidars, key=lambda item: (item["channel"] != "LIDAR_TOP", *nearness(item)))
    else:
        reference = min(cameras, key=nearness)
    return {
        "reference_global_from_ego": reference["global_from_ego"],
        "reference_timestamp": reference["timestamp"],
        "cameras": cameras,
    }


# --- the projection ----------------------------------------------------------------------------------


def half_ball_points(
    K: np.ndarray,
    width: int,
    height: int,
    ego_from_cam: np.ndarray,
    depth_limit: float,
    ground_z: float = 0.0,
    every: int = 1,
) -> np.ndarray:
    """Points (H, W, 3), ego frame, metres, where the rays of all pixels leave the half-ball.

    With ``every`` only each ``every``-th row and column is looked at: the shape is smaller by so much.

    The half-ball is the ball of radius ``depth_limit`` about the camera, cut by the plane z = ``ground_z``.
    A camera that is not above the ground, or not below ``depth_limit`` above it, is a ValueError.
    """
    origin = ego_from_cam[:3, 3]
    if not 0.0 < origin[2] - ground_z < depth_limit:
        raise ValueError(f"camera {origin[2] - ground_z} m above the ground, depth limit {depth_limit} m")

    u, v = np.meshgrid(np.arange(0.0, width, every), np.arange(0.0, height, every))
    pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
    directions = pixels @ np.linalg.inv(K).T @ ego_from_cam[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)

    t_ground = np.full(u.shape, np.inf)
    down = directions[..., 2] < 0.0
    t_ground[down] = (ground_z - origin[2]) / directions[..., 2][down]
    t_sphere = depth_limit  # unit directions from the ball's own centre
    return origin + np.minimum(t_ground, t_sphere)[..., np.newaxis] * directions


def project_source(
    points_ego: np.ndarray,
    source: dict[str, Any],
    reference_global_from_ego: np.ndarray,
    ego_motion: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels u, v (...) of points (..., 3) in a pinhole source camera, and whether each one is valid.

    Points are in the reference's ego frame, metres. With ``ego_motion`` they go through the source's own
    ego pose, else the source is taken to have fired at the reference's time. u and v are NaN where z <= 0.
    """
    cam_from_ego = inverse_pose(source["ego_from_cam"])
    if ego_motion:
        source_ego_from_ego = inverse_pose(source["global_from_ego"]) @ reference_global_from_ego
        cam_from_ego = cam_from_ego @ source_ego_from_ego
    points = transform(cam_from_ego, points_ego)

    front = points[..., 2] > 0.0
    z = np.where(front, points[..., 2], np.nan)
    homogeneous = points @ source["K"].T
    u, v = homogeneous[..., 0] / z, homogeneous[..., 1] / z

    low = -0.5 - PIXEL_TOLERANCE
    right, bottom = source["width"] - 0.5 + PIXEL_TOLERANCE, source["height"] - 0.5 + PIXEL_TOLERANCE
    valid = front & (u >= low) & (u <= right) & (v >= low) & (v <= bottom)  # NaN compares false
    return u, v, valid


def bilinear(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values (..., 3), float64, of an image (H, W, 3) at finite pixels u, v (...); taps clamped to it."""
    height, width = image.shape[:2]
    u, v = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    left, top = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    right_share, bottom_share = u - left, v - top

    total = np.zeros((*u.shape, image.shape[2]))
    for dy in (0, 1):
        for dx in (0, 1):
            weight = (right_share if dx else 1.0 - right_share) * (bottom_share if dy else 1.0 - bottom_share)
            rows = np.clip(top + dy, 0, height - 1)
            columns = np.clip(left + dx, 0, width - 1)
            total += weight[..., np.newaxis] * image[rows, columns].astype(np.float64)
    return total


def reference_view(
    virtual_camera: dict[str, Any],
    sources: list[dict[str, Any]],
    reference_global_from_ego: np.ndarray,
    pictures: dict[str, np.ndarray],
    depth_limit: float,
    ground_z: float,
    ego_motion: bool,
    every: int = 1,
) -> dict[str, np.ndarray]:
    """What is certain about one virtual picture, whatever the blending weights are.

    ``count`` (H, W): sources that see each pixel; ``low``, ``high`` (H, W, 3): the least and greatest value
    among them per channel, 0 (black) where there is none; ``single`` (H, W, 3): the picture where exactly
    one source sees the pixel, NaN elsewhere. ``virtual_camera`` has width, height, K, ego_from_cam;
    ``pictures`` maps a source's channel to its (H, W, 3) picture; depth_limit and ground_z in metres.
    With ``every`` H and W are those of each ``every``-th row and column.
    """
    width, height = virtual_camera["width"], virtual_camera["height"]
    points = half_ball_points(
        virtual_camera["K"], width, height, virtual_camera["ego_from_cam"], depth_limit, ground_z, every
    )
    height, width = points.shape[:2]
    count = np.zeros((height, width), dtype=np.int64)
    low = np.full((height, width, 3), np.inf)
    high = np.full((height, width, 3), -np.inf)
    for first in range(0, height, BLOCK_ROWS):
        rows = slice(first, min(first + BLOCK_ROWS, height))
        for source in sources:
            u, v, valid = project_source(points[rows], source, reference_global_from_ego, ego_motion)
            values = bilinear(pictures[source["channel"]], u[valid], v[valid])
            count[rows][valid] += 1
            low[rows][valid] = np.minimum(low[rows][valid], values)
            high[rows][valid] = np.maximum(high[rows][valid], values)
    low[count == 0] = 0.0
    high[count == 0] = 0.0
    single = np.where((count == 1)[..., np.newaxis], low, np.nan)
    return {"count": count, "single": single, "low": low, "high": high}


# --- a rig file --------------------------------------------------------------------------------------


def read_yaml(path: Path) -> Any:
    """The content of a YAML file as plain dicts, lists and numbers."""
    text = Path(path).read_text(encoding="utf-8")
    try:
        from ruamel.yaml import YAML
    except ImportError:
        import yaml

        return yaml.safe_load(text)
    return YAML(typ="safe", pure=True).load(text)


def rig_from_yaml(path: Path) -> list[dict[str, Any]]:
    """The cameras of a rig file in its order: channel, width, height, K (3, 3), ego_from_cam (4, 4).

    The ego frame is nuScenes' (rear axle): with origin ``vehicle_centre`` x grows by rear_axle_to_centre.
    ``rotation`` is the quaternion (w, x, y, z) of ego_from_cam. No validation: the rig is taken to be sound.
    """
    rig = read_yaml(path)
    shift = {"rear_axle": 0.0, "vehicle_centre": rig.get("rear_axle_to_centre")}[rig["origin"]]
    cameras = []
    for channel, camera in rig["cameras"].items():
        width, height = camera["width"], camera["height"]
        if "hfov" in camera:
            focal = width / (2.0 * math.tan(math.radians(camera["hfov"]) / 2.0))
            fx, fy, cx, cy = focal, focal, (width - 1) / 2.0, (height - 1) / 2.0
        else:
            fx, fy, cx, cy = camera["intrinsics"]
        if "rotation" in camera:
            rotation = quaternion_matrix(camera["rotation"])
        else:
            rotation = yaw_pitch_roll_matrix(camera["yaw"], camera.get("pitch", 0.0), camera.get("roll", 0.0))
        x, y, z = camera["position"]
        cameras.append(
            {
                "channel": channel,
                "width": width,
                "height": height,
                "K": np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
                "ego_from_cam": pose(rotation, [x + shift, y, z]),
            }
        )
    return cameras
