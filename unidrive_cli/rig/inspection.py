"""What a person wants to know of a rig before using it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from unidrive_cli.geometry.circle import STEP_DEG, arcs_deg, horizon_seen
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.rig.model import Rig


@dataclass(frozen=True)
class CameraFacts:
    """One camera in the units of the rig file.

    Attributes:
        lens: `pinhole`, or the model of its distortion.
        blank_share: share of the picture beyond the distortion model's field, where pixels have no ray.
    """

    channel: str
    width_px: int
    height_px: int
    hfov_deg: float
    vfov_deg: float
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    position_m: tuple[float, float, float]
    lens: str = "pinhole"
    blank_share: float = 0.0


@dataclass(frozen=True)
class RigFacts:
    """A rig's cameras and what they see of the far horizon.

    Attributes:
        covered_deg: how much of the circle at least one camera sees.
        overlaps_deg: (channel, channel, degrees) of cameras that see the same part.
        blind_arcs_deg: (start, end), counter-clockwise; 0 is straight ahead, 90 is left.
    """

    name: str
    description: str
    digest: str
    depth_limit_m: float | None
    ground_height_m: float | None
    cameras: list[CameraFacts]
    covered_deg: float
    overlaps_deg: list[tuple[str, str, float]]
    blind_arcs_deg: list[tuple[float, float]]


def inspect_rig(rig: Rig) -> RigFacts:
    """The facts of a rig."""
    cameras = []
    for camera in rig.cameras:
        lens = camera.lens
        yaw, pitch, roll = (round(angle, 3) + 0.0 for angle in camera.yaw_pitch_roll_deg)
        x, y, z = (round(float(value), 4) + 0.0 for value in camera.centre_ego)
        cameras.append(
            CameraFacts(
                camera.channel,
                lens.width_px,
                lens.height_px,
                round(lens.hfov_deg, 3),
                round(lens.vfov_deg, 3),
                yaw,
                pitch,
                roll,
                (x, y, z),
                lens.model,
                _blank_share(lens),
            )
        )
    seen = horizon_seen([(camera.lens, camera.ego_from_cam) for camera in rig.cameras])
    overlaps = []
    for first, second in combinations(range(len(rig.cameras)), 2):
        degrees = round(STEP_DEG * int(np.count_nonzero(seen[first] & seen[second])), 1)
        if degrees:
            overlaps.append((rig.channels[first], rig.channels[second], degrees))
    anything = seen.any(axis=0)
    return RigFacts(
        rig.name,
        rig.description,
        rig.digest,
        rig.depth_limit_m,
        rig.ground_height_m,
        cameras,
        round(STEP_DEG * int(np.count_nonzero(anything)), 1),
        overlaps,
        arcs_deg(~anything),
    )


def _blank_share(lens: Lens) -> float:
    """Share of a picture whose pixels have no ray, from some forty thousand of them."""
    if isinstance(lens, Pinhole):
        return 0.0
    places = (np.arange(200) + 0.5) / 200
    pixels = np.stack(np.meshgrid(places * lens.width_px - 0.5, places * lens.height_px - 0.5), axis=-1)
    return round(float(np.isnan(lens.unproject(pixels)[..., 0]).mean()), 3)
