"""A rig file whose every number is known, one key a line, so that tests know the lines too."""

from __future__ import annotations

TEXT = """\
name: hand-made
description: two cameras
cameras:
  CAM_FRONT:
    width: 1600
    height: 900
    hfov: 90
    position: [1.5, 0.25, 1.6]
    yaw: 0
  CAM_BACK:
    width: 800
    height: 400
    intrinsics: [400, 410, 399.5, 199.5]
    position: [-0.5, 0.0, 1.2]
    rotation: [0.5, -0.5, -0.5, 0.5]
origin: vehicle_centre
rear_axle_to_centre: 1.3
depth_limit: 40
ground_height: 0.1
"""


def with_changes(*changes: tuple[str, str]) -> str:
    """The text with each `old` replaced by `new`; `old` must be there exactly once."""
    text = TEXT
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} is {text.count(old)} times in the hand-made rig"
        text = text.replace(old, new)
    return text
