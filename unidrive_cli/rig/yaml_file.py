"""The rig file (YAML), read with one clear sentence per mistake."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import YAMLError

from unidrive_cli.errors import GeometryError, RigError, did_you_mean
from unidrive_cli.geometry.lenses import DISTORTED_LENSES, MAX_SIDE_PX, Lens, Pinhole, lens_of
from unidrive_cli.geometry.poses import pose, rotation_from_quaternion, rotation_from_yaw_pitch_roll
from unidrive_cli.geometry.scene import GroundPlane
from unidrive_cli.rig.model import CHANNEL_NAME, NO_CHANNEL_NAME, Camera, Rig

MAX_FILE_BYTES = 1_000_000
MAX_CAMERAS = 64
MAX_NUMBER = 1e9
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
_DISTORTION_KEYS = ("model", "coefficients")
_DISTORTION_FORM = f"{{model: {' or '.join(DISTORTED_LENSES)}, coefficients: [...]}}"
_ORIGINS = ("rear_axle", "vehicle_centre")


def load_rig(path: Path) -> Rig:
    """The rig of a YAML file in the format of docs/rig-files.md.

    Raises:
        RigError: the file is missing, too large, not YAML, or not a rig; the sentence names the
            file, the line, the camera and the key.
    """
    return parse_rig(_read_text(path), str(path))


def parse_rig(text: str, source: str) -> Rig:
    """The rig of a YAML text; `source` is what error sentences call it.

    Raises:
        RigError: as `load_rig`.
    """
    document = _parse_yaml(text, source)
    if not isinstance(document, CommentedMap):
        raise RigError(
            "a rig file must be a mapping with the keys name and cameras.",
            where=source,
            hint="Its format is in docs/rig-files.md.",
        )
    _check_keys(document, _RIG_KEYS, ("name", "cameras"), source)
    offset_x_m = _origin_offset(document, source)
    ground_height_m = _optional_number(document, "ground_height", source)
    depth_limit_m = _optional_number(document, "depth_limit", source)
    if depth_limit_m is not None and depth_limit_m <= 0:
        raise _error(document, "depth_limit", source, f"must be a positive number of metres, got {depth_limit_m:g}.")
    entries = document["cameras"]
    if not isinstance(entries, CommentedMap) or not entries:
        raise _error(document, "cameras", source, "must map channel names to cameras, and hold at least one.")
    if len(entries) > MAX_CAMERAS:
        raise _error(
            document, "cameras", source, f"holds {len(entries)} cameras; at most {MAX_CAMERAS} are accepted."
        )
    ground = GroundPlane(ground_height_m or 0.0)
    cameras = tuple(_camera(entries, channel, offset_x_m, ground, source) for channel in entries)
    return Rig(
        _text(document, "name", source),
        _text(document, "description", source) if "description" in document else "",
        cameras,
        depth_limit_m,
        ground_height_m,
    )


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise RigError(f"cannot be read: {error.strerror}.", where=str(path)) from error
    if len(data) > MAX_FILE_BYTES:
        raise RigError(f"is larger than {MAX_FILE_BYTES} bytes; that is no rig file.", where=str(path))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RigError(
            f"is not UTF-8 text (byte {error.start}); a YAML rig file was expected.", where=str(path)
        ) from error


def _parse_yaml(text: str, source: str) -> Any:
    try:
        return YAML(typ="rt").load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{source}, line {mark.line + 1}" if mark is not None else source
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        if type(error).__name__ == "DuplicateKeyError":
            key = re.search(r'key "(.*?)"', str(problem))
            what = f"{key.group(1) if key else 'a key'} is given twice; channels and keys must be unique."
            raise RigError(what, where=place) from error
        raise RigError(f"is not valid YAML: {problem}.", where=place) from error
    except (ValueError, RecursionError, AttributeError, TypeError, LookupError) as error:
        raise RigError("is not valid YAML for a rig.", where=source) from error


def _camera(entries: CommentedMap, channel: object, offset_x_m: float, ground: GroundPlane, source: str) -> Camera:
    if not isinstance(channel, str) or not CHANNEL_NAME.fullmatch(channel):
        raise _error(entries, channel, source, NO_CHANNEL_NAME)
    where = f"{source}, camera {channel}"
    entry = entries[channel]
    if not isinstance(entry, CommentedMap):
        raise RigError("must be a mapping with width, height, hfov, position and yaw.", where=where)
    _check_keys(entry, _CAMERA_KEYS, ("width", "height", "position"), where)
    position = _numbers(entry, "position", 3, where)
    position[0] += offset_x_m
    camera = Camera(
        channel, _distorted(entry, _pinhole(entry, where), where), pose(_rotation(entry, where), position)
    )
    height_m = float(ground.height_m(camera.centre_ego))
    if height_m <= 0:
        raise _error(
            entry, "position", where, f"puts the camera at {height_m:g} m over the ground; it must stand above it."
        )
    return camera


def _pinhole(entry: CommentedMap, where: str) -> Pinhole:
    width, height = (_whole_number(entry, key, where) for key in ("width", "height"))
    if width * height > MAX_PICTURE_PIXELS:
        raise _error(
            entry,
            "width",
            where,
            f"and height give {width * height:,} pixels; at most {MAX_PICTURE_PIXELS:,}.",
        )
    _exactly_one(entry, "hfov", ("intrinsics",), where)
    if "hfov" in entry:
        with _named(entry, "hfov", where):
            return Pinhole.from_hfov(_number(entry, "hfov", where), width, height)
    fx, fy, cx, cy = _numbers(entry, "intrinsics", 4, where)
    with _named(entry, "intrinsics", where):
        return Pinhole(fx, fy, cx, cy, width, height)


def _distorted(entry: CommentedMap, pinhole: Pinhole, where: str) -> Lens:
    """The camera's lens: the pinhole of its intrinsics, with its distortion where it has one."""
    if "distortion" not in entry:
        return pinhole
    distortion = entry["distortion"]
    if not isinstance(distortion, CommentedMap):
        raise _error(entry, "distortion", where, f"must be a mapping {_DISTORTION_FORM}, got {distortion!r:.60}.")
    _check_keys(distortion, _DISTORTION_KEYS, (), f"{where}, distortion")
    for key in _DISTORTION_KEYS:
        if key not in distortion:
            raise _error(entry, "distortion", where, f"lacks the key {key}; it is a mapping {_DISTORTION_FORM}.")
    where = f"{where}, distortion"
    model, values = distortion["model"], distortion["coefficients"]
    if not isinstance(model, str) or model not in DISTORTED_LENSES:
        guess = did_you_mean(str(model)[:60], DISTORTED_LENSES)
        known = " or ".join(DISTORTED_LENSES)
        raise _error(distortion, "model", where, f"must be {known}, got {model!r:.60}. {guess}".rstrip())
    if not isinstance(values, list):
        raise _error(distortion, "coefficients", where, f"must be a list of numbers, got {values!r:.60}.")
    numbers = [_as_number(value, distortion, "coefficients", where) for value in values]
    with _named(distortion, "coefficients", where, "do not fit"):
        return lens_of(pinhole, model, numbers)


def _rotation(entry: CommentedMap, where: str) -> Any:
    _exactly_one(entry, "yaw", ("rotation",), where)
    if "rotation" in entry:
        for key in ("pitch", "roll"):
            if key in entry:
                raise _error(entry, key, where, "cannot be given beside rotation, which already says it.")
        with _named(entry, "rotation", where):
            return rotation_from_quaternion(_numbers(entry, "rotation", 4, where), unit_tolerance=1e-3)
    pitch, roll = (_optional_number(entry, key, where) or 0.0 for key in ("pitch", "roll"))
    return rotation_from_yaw_pitch_roll(_number(entry, "yaw", where), pitch, roll)


def _origin_offset(document: CommentedMap, source: str) -> float:
    origin = document.get("origin", "rear_axle")
    if origin not in _ORIGINS:
        raise _error(document, "origin", source, f"must be {' or '.join(_ORIGINS)}, got {origin!r}.")
    if origin == "rear_axle":
        if "rear_axle_to_centre" in document:
            raise _error(document, "rear_axle_to_centre", source, "only goes with origin: vehicle_centre.")
        return 0.0
    if "rear_axle_to_centre" not in document:
        raise RigError("origin: vehicle_centre needs rear_axle_to_centre, in metres.", where=source)
    return _number(document, "rear_axle_to_centre", source)


def _check_keys(mapping: CommentedMap, known: Iterable[str], needed: Iterable[str], where: str) -> None:
    known = tuple(known)
    if mapping.tag.value not in (None, "tag:yaml.org,2002:map"):
        raise RigError(f"holds the tag {mapping.tag.value}; a rig file has none.", where=where)
    for key in mapping:
        if key not in known:
            guess = did_you_mean(str(key), known) or f"Known keys are {', '.join(known)}."
            raise _error(mapping, key, where, f"is not a known key. {guess}")
    for key in needed:
        if key not in mapping:
            raise RigError(f"the key {key} is missing.", where=where)


def _exactly_one(entry: CommentedMap, key: str, others: tuple[str, ...], where: str) -> None:
    given = [name for name in (key, *others) if name in entry]
    if len(given) != 1:
        names = " or ".join((key, *others))
        what = "one is missing" if not given else "both are given"
        line = f", line {entry.lc.line}"
        raise RigError(f"exactly one of {names} must be given; {what}.", where=f"{where}{line}")


@contextlib.contextmanager
def _named(mapping: CommentedMap, key: str, where: str, verb: str = "does not fit") -> Iterator[None]:
    """Gives an error of the geometry the key, file and line that its numbers came from."""
    try:
        yield
    except GeometryError as error:
        raise _error(mapping, key, where, f"{verb}: {error.what}") from error


def _error(mapping: Mapping[Any, Any], key: object, where: str, what: str) -> RigError:
    line = ""
    with contextlib.suppress(AttributeError, KeyError, TypeError):
        line = f", line {mapping.lc.key(key)[0] + 1}"  # type: ignore[attr-defined]
    return RigError(f"{key} {what}", where=f"{where}{line}")


def _text(mapping: CommentedMap, key: str, where: str) -> str:
    value = mapping[key]
    if not isinstance(value, str | int | float) or isinstance(value, bool) or not str(value).strip():
        raise _error(mapping, key, where, f"must be a text, got {value!r:.60}.")
    text = str(value)
    if not text.isprintable():
        raise _error(mapping, key, where, f"must be a text of printable characters, got {text!r:.60}.")
    return text


def _number(mapping: CommentedMap, key: str, where: str) -> float:
    return _as_number(mapping[key], mapping, key, where)


def _as_number(value: object, mapping: CommentedMap, key: str, where: str) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        number = float(value) if is_number else math.nan  # type: ignore[arg-type]
    except OverflowError:
        number = math.nan
    if not abs(number) <= MAX_NUMBER:
        raise _error(mapping, key, where, f"must be a finite number of at most {MAX_NUMBER:g}, got {value!r:.60}.")
    return number


def _optional_number(mapping: CommentedMap, key: str, where: str) -> float | None:
    return _number(mapping, key, where) if key in mapping else None


def _whole_number(mapping: CommentedMap, key: str, where: str) -> int:
    number = _number(mapping, key, where)
    if number != int(number) or not 1 <= number <= MAX_SIDE_PX:
        raise _error(
            mapping, key, where, f"must be a whole number of pixels from 1 to {MAX_SIDE_PX}, got {number:g}."
        )
    return int(number)


def _numbers(mapping: CommentedMap, key: str, count: int, where: str) -> list[float]:
    values = mapping[key]
    if not isinstance(values, list) or len(values) != count:
        raise _error(mapping, key, where, f"must be a list of {count} numbers, got {values!r:.60}.")
    return [_as_number(value, mapping, key, where) for value in values]
