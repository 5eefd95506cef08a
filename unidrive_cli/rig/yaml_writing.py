"""The rig file (YAML), written so that people can read it and `load_rig` gives the same rig."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import quaternion_from_rotation, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.model import Camera, Rig

_DIGITS = 9
_COEFFICIENT_DIGITS = 12
_COMMENT_WIDTH = 110


def dump_rig(rig: Rig, comment: str = "") -> str:
    """The text of a rig file, under the comment's paragraphs."""
    document = CommentedMap(name=rig.name)
    if rig.description:
        document["description"] = rig.description
    document["cameras"] = CommentedMap((camera.channel, _camera(camera)) for camera in rig.cameras)
    document["origin"] = "rear_axle"
    if rig.depth_limit_m is not None:
        document["depth_limit"] = _number(rig.depth_limit_m)
    if rig.ground_height_m is not None:
        document["ground_height"] = _number(rig.ground_height_m)
    yaml = YAML()
    yaml.width = 1000
    stream = io.StringIO()
    yaml.dump(document, stream)
    lines = (line for part in comment.splitlines() for line in textwrap.wrap(part, _COMMENT_WIDTH) or [""])
    return "".join(f"# {line}".rstrip() + "\n" for line in lines) + stream.getvalue()


def _camera(camera: Camera) -> CommentedMap:
    lens = camera.lens
    entry = CommentedMap(width=lens.width_px, height=lens.height_px)
    hfov_deg = round(lens.hfov_deg, _DIGITS)
    if isinstance(lens, Pinhole) and np.allclose(
        lens.matrix, Pinhole.from_hfov(hfov_deg, lens.width_px, lens.height_px).matrix, rtol=0, atol=1e-9
    ):
        entry["hfov"] = _number(hfov_deg)
    else:
        entry["intrinsics"] = _list([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px])
    if lens.coefficients:
        entry["distortion"] = CommentedMap(
            model=lens.model, coefficients=_list(lens.coefficients, _COEFFICIENT_DIGITS)
        )
    entry["position"] = _list(camera.centre_ego.tolist())
    yaw, pitch, roll = (round(angle, _DIGITS) + 0.0 for angle in camera.yaw_pitch_roll_deg)
    rotation = camera.ego_from_cam[:3, :3]
    if np.allclose(rotation, rotation_from_yaw_pitch_roll(yaw, pitch, roll), rtol=0, atol=1e-9):
        entry["yaw"] = _number(yaw)
        entry.update({name: _number(angle) for name, angle in (("pitch", pitch), ("roll", roll)) if angle})
    else:
        entry["rotation"] = _list(quaternion_from_rotation(rotation).tolist())
    return entry


def _list(numbers: Sequence[float], digits: int = _DIGITS) -> CommentedSeq:
    sequence = CommentedSeq(_number(number, digits) for number in numbers)
    sequence.fa.set_flow_style()
    return sequence


def _number(number: float, digits: int = _DIGITS) -> float | int:
    """A number without the dust of floating point, and whole where it is."""
    short = round(float(number), digits) + 0.0
    return int(short) if short.is_integer() else short
