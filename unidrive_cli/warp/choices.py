"""Choices of the warp that commands offer; nothing heavy is imported here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from unidrive_cli.errors import UsageError

DEFAULT_DEPTH_LIMIT_M = 50.0
DEFAULT_GROUND_HEIGHT_M = 0.0

Blend = Literal["angular", "nearest"]
"""How overlapping sources are joined: mixed by weight, or the one with the largest weight."""

ExposureChoice = Literal["none", "gain"]
"""Whether sources are made equally bright where they show the same: not, or by a gain for each."""

Kernel = Literal["auto", "numba", "opencv"]
"""What warps and blends: the fused kernel on YUV planes, or OpenCV; `auto` takes the first where numba is here."""
Codec = Literal["auto", "libturbojpeg", "simplejpeg"]
"""What decodes and encodes for the fused kernel; `auto` takes libturbojpeg where the system has it."""


@dataclass(frozen=True)
class WarpChoices:
    """What the virtual pictures depend on besides the rig and the sources.

    Attributes:
        depth_limit_m: D0, the radius of the half-ball in metres.
        ground_height_m: height of the ground in the ego frame, metres.
        blend: `angular` mixes overlapping sources, `nearest` takes the one with the largest weight.
        ego_motion: whether each source's own ego pose is used; otherwise all are taken to stand at
            the reference's.
        anti_alias: whether sources that are shrunk by more than 1.95 are sampled from reduced copies.
        exposure: `gain` evens out the brightness of neighbouring sources.
    """

    depth_limit_m: float = DEFAULT_DEPTH_LIMIT_M
    ground_height_m: float = DEFAULT_GROUND_HEIGHT_M
    blend: Blend = "angular"
    ego_motion: bool = True
    anti_alias: bool = True
    exposure: ExposureChoice = "none"

    def __post_init__(self) -> None:
        if not 0 < self.depth_limit_m <= 1e6:
            raise UsageError(f"--depth-limit must be a positive number of metres, got {self.depth_limit_m:g}.")
        if not abs(self.ground_height_m) <= 1e3:
            raise UsageError(f"--ground-height must be a height in metres, got {self.ground_height_m:g}.")
