"""Typed rows of the 13 nuScenes v1.0 tables: the fields that unidrive reads.

Further fields of a row are not lost: every row is kept beside its own JSON text (`Table.raw`).
Field names and meanings are those of the nuScenes schema.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Whole = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
"""A whole number that NumPy and DuckDB can hold."""
Timestamp = Whole | float


class Row(msgspec.Struct, frozen=True, gc=False):
    """What every table row has."""

    token: str


class Sensor(Row, frozen=True, gc=False):
    channel: str
    modality: str


class CalibratedSensor(Row, frozen=True, gc=False):
    """`ego_from_sensor`: translation in metres, rotation as w, x, y, z.

    `camera_distortion` (T4's field) holds OpenCV's coefficients, `camera_model` what they are of.
    """

    sensor_token: str
    translation: Vector3
    rotation: Quaternion
    camera_intrinsic: list[list[float]]
    camera_distortion: list[float] | None = None
    camera_model: Any = None


class EgoPose(Row, frozen=True, gc=False):
    """`global_from_ego`: translation in metres, rotation as w, x, y, z."""

    timestamp: Timestamp
    translation: Vector3
    rotation: Quaternion


class Sample(Row, frozen=True, gc=False):
    timestamp: Timestamp
    scene_token: str
    prev: str
    next: str


class SampleData(Row, frozen=True, gc=False):
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    timestamp: Timestamp
    fileformat: str
    is_key_frame: bool
    filename: str
    prev: str
    next: str
    width: Whole | None = None
    height: Whole | None = None


class Scene(Row, frozen=True, gc=False):
    name: str
    log_token: str
    nbr_samples: Whole
    first_sample_token: str
    last_sample_token: str


class SampleAnnotation(Row, frozen=True, gc=False):
    """A 3D box in the global frame: centre in metres, size as width, length, height."""

    sample_token: str
    instance_token: str
    translation: Vector3
    size: Vector3
    rotation: Quaternion
    prev: str = ""
    next: str = ""
    visibility_token: str | None = ""
    attribute_tokens: list[str] = []
    num_lidar_pts: Whole = 0
    num_radar_pts: Whole = 0


class Instance(Row, frozen=True, gc=False):
    category_token: str
    nbr_annotations: Whole = 0
    first_annotation_token: str = ""
    last_annotation_token: str = ""


class Category(Row, frozen=True, gc=False):
    name: str


class Attribute(Row, frozen=True, gc=False):
    name: str


class Visibility(Row, frozen=True, gc=False):
    level: str | int


class Log(Row, frozen=True, gc=False):
    logfile: str = ""


class Map(Row, frozen=True, gc=False):
    filename: str = ""
    log_tokens: list[str] = []


TABLES: dict[str, type[Row]] = {
    "attribute": Attribute,
    "calibrated_sensor": CalibratedSensor,
    "category": Category,
    "ego_pose": EgoPose,
    "instance": Instance,
    "log": Log,
    "map": Map,
    "sample": Sample,
    "sample_annotation": SampleAnnotation,
    "sample_data": SampleData,
    "scene": Scene,
    "sensor": Sensor,
    "visibility": Visibility,
}
"""All 13 tables of nuScenes v1.0 and the type of their rows."""

NEEDED = ("sensor", "calibrated_sensor", "ego_pose", "sample", "sample_data", "scene")
"""Tables without which nothing can be converted; the others have a valid minimal form."""

NUSCENES_VISIBILITY: tuple[dict[str, Any], ...] = tuple(
    {
        "description": f"visibility of whole object is between {low} and {high}%",
        "token": token,
        "level": f"v{low}-{high}",
    }
    for token, low, high in (("1", 0, 40), ("2", 40, 60), ("3", 60, 80), ("4", 80, 100))
)
"""The visibility table of nuScenes itself."""
