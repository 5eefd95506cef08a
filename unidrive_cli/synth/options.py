"""What a user can choose about a synthetic drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from unidrive_cli.errors import UsageError

Firing = Literal["nuscenes", "together"]
"""When cameras fire: as the turning lidar passes them, before the lidar's time; or all at that time."""
RendererChoice = Literal["auto", "gl", "rays"]
Version = Literal["v1.0-trainval", "v1.0-mini"]
"""Version folders whose split names off-the-shelf loaders know."""
SAMPLES_PER_PIXEL = (1, 4, 16)
MAX_SCENES, MAX_KEYFRAMES = 850, 400


@dataclass(frozen=True)
class SynthOptions:
    """Options of `synth`; all but `quality` and below shape the drive, those shape its pictures.

    Attributes:
        seed: another seed, another drive.
        scenes: how many.
        keyframes: per scene, at 2 Hz.
        slope_percent: steepest rise of the streets; 0 is flat.
        ego_tilt_deg: how far the ego car's body pitches and rolls against the road.
        firing: when the cameras fire.
        sweeps: also pictures at 12 Hz and clouds at 20 Hz between the key frames.
        quality: JPEG quality.
        samples_per_pixel: 1, 4 or 16.
        instances, depth: also write instance and depth pictures.
        version: name of the version folder.
        val_share: share of the scenes that get names of the validation split.
    """

    seed: int = 0
    scenes: int = 1
    keyframes: int = 40
    slope_percent: float = 0.0
    ego_tilt_deg: float = 0.0
    firing: Firing = "nuscenes"
    sweeps: bool = False
    quality: int = 95
    samples_per_pixel: int = 4
    instances: bool = False
    depth: bool = False
    version: Version = "v1.0-trainval"
    val_share: float = 0.2

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("seed", self.seed, 0, 2**32 - 1),
            ("scenes", self.scenes, 1, MAX_SCENES),
            ("keyframes", self.keyframes, 1, MAX_KEYFRAMES),
            ("slope", self.slope_percent, 0, 15),
            ("ego-tilt", self.ego_tilt_deg, 0, 10),
            ("quality", self.quality, 1, 100),
            ("val-share", self.val_share, 0, 1),
        ):
            if not low <= value <= high:
                raise UsageError(f"--{name} must be from {low} to {high}, got {value:g}.")
        if self.samples_per_pixel not in SAMPLES_PER_PIXEL:
            raise UsageError(f"--samples-per-pixel must be 1, 4 or 16, got {self.samples_per_pixel}.")

    def identity(self) -> dict[str, Any]:
        """What the output depends on."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}
