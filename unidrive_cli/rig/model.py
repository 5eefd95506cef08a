"""Camera and Rig: frozen, checked at birth, with a digest that names their geometry."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unidrive_cli.errors import GeometryError, RigError
from unidrive_cli.geometry.arrays import Float, read_only
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.geometry.poses import check_pose, yaw_pitch_roll_from_rotation

CHANNEL_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_\-]{0,63}")
"""Channel names become folder names."""
NO_CHANNEL_NAME = "is not a channel name: letters, digits, _ and - were expected, 64 at most."
_DIGEST_DIGITS = 9
_COEFFICIENT_DIGITS = 12


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera of a rig.

    Attributes:
        channel: its nuScenes channel name, such as CAM_FRONT.
        lens: intrinsics, picture size and distortion.
        ego_from_cam: (4, 4) pose; what `calibrated_sensor` stores as translation and rotation.
    """

    channel: str
    lens: Lens
    ego_from_cam: Float

    def __post_init__(self) -> None:
        if not CHANNEL_NAME.fullmatch(self.channel):
            raise GeometryError(f"{self.channel[:80]!r} {NO_CHANNEL_NAME}")
        object.__setattr__(self, "ego_from_cam", read_only(check_pose(self.ego_from_cam, "ego_from_cam")))

    @property
    def centre_ego(self) -> Float:
        """(3,) optical centre in the ego frame, metres."""
        return self.ego_from_cam[:3, 3]

    @property
    def yaw_pitch_roll_deg(self) -> tuple[float, float, float]:
        """Angles of the rig file's convention, in degrees."""
        return yaw_pitch_roll_from_rotation(self.ego_from_cam[:3, :3])

    @property
    def pinhole(self) -> Pinhole:
        """The lens of a virtual camera.

        Raises:
            GeometryError: this camera has lens distortion, so pictures cannot be rendered for it.
        """
        if not isinstance(self.lens, Pinhole):
            raise GeometryError(f"has lens distortion ({self.lens.model}); a virtual camera is a pinhole.")
        return self.lens

    def numbers(self) -> list[object]:
        """All that a picture through this camera depends on, for digests.

        Rounded to 1e-9 (metres, pixels), so that processors whose last bits differ agree.
        """
        lens = self.lens
        intrinsics = [round(float(n), _DIGEST_DIGITS) for n in (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px)]
        pose = (np.round(self.ego_from_cam, _DIGEST_DIGITS) + 0.0).tolist()  # no negative zeros
        numbers: list[object] = [self.channel, lens.width_px, lens.height_px, intrinsics, pose]
        if not isinstance(lens, Pinhole):
            numbers.append([lens.model, [round(n, _COEFFICIENT_DIGITS) + 0.0 for n in lens.coefficients]])
        return numbers


@dataclass(frozen=True, eq=False)
class Rig:
    """A set of cameras on one vehicle.

    Attributes:
        name, description: for people; not part of the digest.
        cameras: at least one; channels are unique.
        depth_limit_m: default of `--depth-limit` for this rig, or None.
        ground_height_m: default of `--ground-height` for this rig, or None.
    """

    name: str
    description: str
    cameras: tuple[Camera, ...]
    depth_limit_m: float | None = None
    ground_height_m: float | None = None

    def __post_init__(self) -> None:
        if not self.cameras:
            raise RigError("a rig needs at least one camera.", where=self.name)
        channels = self.channels
        for channel in channels:
            if channels.count(channel) > 1:
                raise RigError(f"channel {channel} is given twice; channel names must be unique.", where=self.name)

    def check_folders(self, others: Iterable[str] = ()) -> None:
        """Refuses channels that some disks take for one folder.

        Args:
            others: channels of other sensors beside the cameras.

        Raises:
            RigError: two of all these channels differ only by case.
        """
        folders = {channel.lower(): channel for channel in others}
        for channel in self.channels:
            other = folders.setdefault(channel.lower(), channel)
            if other != channel:
                raise RigError(
                    f"the channels {other} and {channel} differ only by case; on some disks they are one folder.",
                    where=self.name,
                )

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Channel names in the rig's order."""
        return tuple(camera.channel for camera in self.cameras)

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of the cameras' channels, lenses and poses."""
        text = json.dumps([camera.numbers() for camera in self.cameras], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
