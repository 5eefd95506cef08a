"""The rig file (YAML), read with one clear sentence per mistake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap

from unidrive_cli.errors import RigError, did_you_mean
from unidrive_cli.geometry.lenses import DISTORTED_LENSES, Lens, Pinhole, lens_of
from unidrive_cli.geometry.poses import pose, rotation_from_quaternion, rotation_from_yaw_pitch_roll
from unidrive_cli.geometry.scene import GroundPlane
from unidrive_cli.rig.model import CHANNEL_NAME, NO_CHANNEL_NAME, Camera, Rig
from unidrive_cli.rig.yaml_reading import (
    as_number,
    check_keys,
    error_at,
    exactly_one,
    named,
    number_of,
    numbers_of,
    optional_number,
    parse_yaml,
    read_text,
    text_of,
    whole_number,
)

MAX_CAMERAS = 64
MAX_PICTURE_PIXELS = 64_000_000
_RIG_KEYS = (
    "name",
    "description",
    "cameras",
    "origin",
    "rear_axle_to_centre",
    "depth_limit",
    "ground_height",
)
_CAMERA_KEYS = (
    "width",
    "height",
    "hfov",
    "intrinsics",
    "position",
    "yaw",
    "pitch",
    "roll",
    "rotation",
    "distortion",
)
DISTORTION_KEYS = ("model", "coefficients")
_DISTORTION_FORM = f"{{model: {' or '.join(DISTORTED_LENSES)}, coefficients: [...]}}"
_ORIGINS = ("rear_axle", "vehicle_centre")


def load_rig(path: Path) -> Rig:
    """The rig of a YAML file in the format of docs/rig-files.md.

    Raises:
        RigError: the file is missing, too large, not YAML, or not a rig; the sentence names the
            file, the line, the camera and the key.
    """
    return parse_rig(read_text(path), str(path))


def parse_rig(text: str, source: str) -> Rig:
    """The rig of a YAML text; `source` is what error sentences call it.

    Raises:
        RigError: as `load_rig`.
    """
    document = parse_yaml(text, source)
    if not isinstance(document, CommentedMap):
        raise RigError(
            "a rig file must be a mapping with the keys name and cameras.",
            where=source,
            hint="Its format is in docs/rig-files.md.",
        )
    check_keys(document, _RIG_KEYS, ("name", "cameras"), source)
    offset_x_m = _origin_offset(document, source)
    ground_height_m = optional_number(document, "ground_height", source)
    depth_limit_m = optional_number(document, "depth_limit", source)
    if depth_limit_m is not None and depth_limit_m <= 0:
        raise error_at(
            document, "depth_limit", source, f"must be a positive number of metres, got {depth_limit_m:g}."
        )
    entries = document["cameras"]
    if not isinstance(entries, CommentedMap) or not entries:
        raise error_at(document, "cameras", source, "must map channel names to cameras, and hold at least one.")
    if len(entries) > MAX_CAMERAS:
        raise error_at(
            document, "cameras", source, f"holds {len(entries)} cameras; at most {MAX_CAMERAS} are accepted."
        )
    ground = GroundPlane(ground_height_m or 0.0)
    cameras = tuple(_camera(entries, channel, offset_x_m, ground, source) for channel in entries)
    return Rig(
        text_of(document, "name", source),
        text_of(document, "description", source) if "description" in document else "",
        cameras,
        depth_limit_m,
        ground_height_m,
    )


def _camera(entries: CommentedMap, channel: object, offset_x_m: float, ground: GroundPlane, source: str) -> Camera:
    if not isinstance(channel, str) or not CHANNEL_NAME.fullmatch(channel):
        raise error_at(entries, channel, source, NO_CHANNEL_NAME)
    where = f"{source}, camera {channel}"
    entry = entries[channel]
    if not isinstance(entry, CommentedMap):
        raise RigError("must be a mapping with width, height, hfov, position and yaw.", where=where)
    check_keys(entry, _CAMERA_KEYS, ("width", "height", "position"), where)
    position = numbers_of(entry, "position", 3, where)
    position[0] += offset_x_m
    camera = Camera(
        channel, _distorted(entry, _pinhole(entry, where), where), pose(_rotation(entry, where), position)
    )
    height_m = float(ground.height_m(camera.centre_ego))
    if height_m <= 0:
        raise error_at(
            entry, "position", where, f"puts the camera at {height_m:g} m over the ground; it must stand above it."
        )
    return camera


def _pinhole(entry: CommentedMap, where: str) -> Pinhole:
    width, height = (whole_number(entry, key, where) for key in ("width", "height"))
    if width * height > MAX_PICTURE_PIXELS:
        raise error_at(
            entry,
            "width",
            where,
            f"and height give {width * height:,} pixels; at most {MAX_PICTURE_PIXELS:,}.",
        )
    exactly_one(entry, "hfov", ("intrinsics",), where)
    if "hfov" in entry:
        with named(entry, "hfov", where):
            return Pinhole.from_hfov(number_of(entry, "hfov", where), width, height)
    fx, fy, cx, cy = numbers_of(entry, "intrinsics", 4, where)
    with named(entry, "intrinsics", where):
        return Pinhole(fx, fy, cx, cy, width, height)


def _distorted(entry: CommentedMap, pinhole: Pinhole, where: str) -> Lens:
    """The camera's lens: the pinhole of its intrinsics, with its distortion where it has one."""
    if "distortion" not in entry:
        return pinhole
    distortion = entry["distortion"]
    if not isinstance(distortion, CommentedMap):
        raise error_at(entry, "distortion", where, f"must be a mapping {_DISTORTION_FORM}, got {distortion!r:.60}.")
    check_keys(distortion, DISTORTION_KEYS, (), f"{where}, distortion")
    for key in DISTORTION_KEYS:
        if key not in distortion:
            raise error_at(entry, "distortion", where, f"lacks the key {key}; it is a mapping {_DISTORTION_FORM}.")
    where = f"{where}, distortion"
    model, numbers = distortion_of(distortion, where)
    with named(distortion, "coefficients", where, "do not fit"):
        return lens_of(pinhole, model, numbers)


def distortion_of(distortion: CommentedMap, where: str) -> tuple[str, list[float]]:
    """Model and coefficients of a mapping that has both.

    Raises:
        RigError: an unknown model, or no list of numbers.
    """
    model, values = distortion["model"], distortion["coefficients"]
    if not isinstance(model, str) or model not in DISTORTED_LENSES:
        guess = did_you_mean(str(model)[:60], DISTORTED_LENSES)
        known = " or ".join(DISTORTED_LENSES)
        raise error_at(distortion, "model", where, f"must be {known}, got {model!r:.60}. {guess}".rstrip())
    if not isinstance(values, list):
        raise error_at(distortion, "coefficients", where, f"must be a list of numbers, got {values!r:.60}.")
    return model, [as_number(value, distortion, "coefficients", where) for value in values]


def _rotation(entry: CommentedMap, where: str) -> Any:
    exactly_one(entry, "yaw", ("rotation",), where)
    if "rotation" in entry:
        for key in ("pitch", "roll"):
            if key in entry:
                raise error_at(entry, key, where, "cannot be given beside rotation, which already says it.")
        with named(entry, "rotation", where):
            return rotation_from_quaternion(numbers_of(entry, "rotation", 4, where), unit_tolerance=1e-3)
    pitch, roll = (optional_number(entry, key, where) or 0.0 for key in ("pitch", "roll"))
    return rotation_from_yaw_pitch_roll(number_of(entry, "yaw", where), pitch, roll)


def _origin_offset(document: CommentedMap, source: str) -> float:
    origin = document.get("origin", "rear_axle")
    if origin not in _ORIGINS:
        raise error_at(document, "origin", source, f"must be {' or '.join(_ORIGINS)}, got {origin!r}.")
    if origin == "rear_axle":
        if "rear_axle_to_centre" in document:
            raise error_at(document, "rear_axle_to_centre", source, "only goes with origin: vehicle_centre.")
        return 0.0
    if "rear_axle_to_centre" not in document:
        raise RigError("origin: vehicle_centre needs rear_axle_to_centre, in metres.", where=source)
    return number_of(document, "rear_axle_to_centre", source)
