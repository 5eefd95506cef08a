"""The search space: a virtual rig whose free numbers lie in bounds, on a grid."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import pose, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.model import Camera, Rig

Quantity = Literal["x", "y", "z", "yaw", "pitch", "roll", "hfov", "height", "depth_limit"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
"""What may be free: metres for x, y, z and depth_limit, pixels for the picture's height, degrees for the others."""

_MIRRORED = ("y", "yaw", "roll")
"""Change sign from a camera to its mirror image on the other side of the car."""
_LENS = ("hfov", "height")
"""What makes another lens: square pixels, the width of the start, the principal point in the middle."""
_GRID_DIGITS = 9


@dataclass(frozen=True)
class Parameter:
    """One free number of a search, which several cameras may share.

    Attributes:
        of: what it is; `depth_limit` belongs to the whole rig.
        cameras: channels that take it; empty for `depth_limit`.
        low, high: its bounds.
        step: of its grid, which starts at `low`; 0 leaves it continuous.
        relative: whether it is added to each camera's own start instead of replacing it.
    """

    of: Quantity
    cameras: tuple[str, ...]
    low: float
    high: float
    step: float
    relative: bool = False

    @property
    def highest(self) -> float:
        """The upper bound, or the last step below it."""
        if not self.step:
            return self.high
        steps = math.floor((self.high - self.low) / self.step + 1e-9)
        return round(self.low + steps * self.step, _GRID_DIGITS)

    @property
    def name(self) -> str:
        """Such as `yaw of CAM_FRONT_LEFT`."""
        return f"{self.of} of {', '.join(self.cameras)}" if self.cameras else self.of


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """A start, and what may change about it.

    Attributes:
        start: the rig that the search starts at; what is not free stays as it is there.
        start_depth_limit_m: D0 at the start.
        parameters: the free numbers.
        mirror: channel of a camera -> channel that it is the mirror image of, left for right.
    """

    start: Rig
    start_depth_limit_m: float
    parameters: tuple[Parameter, ...]
    mirror: Mapping[str, str]

    def __post_init__(self) -> None:
        if not self.parameters:
            raise UsageError("nothing is free: a search needs at least one parameter.")
        self._check_mirror()
        taken: set[tuple[str, str]] = set()
        for parameter in self.parameters:
            self._check(parameter)
            for channel in parameter.cameras or ("",):
                if (parameter.of, channel) in taken:
                    raise UsageError(f"{parameter.of}{f' of {channel}' if channel else ''} is free twice.")
                taken.add((parameter.of, channel))

    def _check_mirror(self) -> None:
        for follower, leader in self.mirror.items():
            for channel in (follower, leader):
                if channel not in self.start.channels:
                    raise UsageError(f"mirror: {self.start.name} has no camera {channel}.")
            if leader in self.mirror:
                raise UsageError(f"mirror: {follower} follows {leader}, which follows {self.mirror[leader]}.")

    def _check(self, parameter: Parameter) -> None:
        name = parameter.name
        if bool(parameter.cameras) == (parameter.of == "depth_limit"):
            raise UsageError(f"{parameter.of} needs cameras; depth_limit has none.")
        for channel in parameter.cameras:
            if channel not in self.start.channels:
                raise UsageError(f"{name}: {self.start.name} has no camera {channel}.")
            if channel in self.mirror:
                raise UsageError(f"{name}: {channel} is a mirror image of {self.mirror[channel]}; free that one.")
            if parameter.of in _LENS and not _is_centred(self._cameras[channel].pinhole):
                raise UsageError(
                    f"{name}: {channel} of {self.start.name} has intrinsics of its own, so its field of view "
                    "is no single number."
                )
        if not parameter.low < parameter.high:
            raise UsageError(
                f"{name}: the lower bound {parameter.low:g} must be below the upper {parameter.high:g}."
            )
        if parameter.step and not 0 < parameter.step <= parameter.high - parameter.low:
            raise UsageError(f"{name}: the step {parameter.step:g} does not fit between the bounds.")
        low, high = self.range_of(parameter)
        if parameter.of == "hfov" and not (low > 0 and high < 180):
            raise UsageError(f"{name}: a field of view lies inside (0, 180) degrees, got {low:g} to {high:g}.")
        if parameter.of == "height":
            for height in self._lowest(parameter):
                if height < 2 or parameter.step <= 0 or height % 2 or parameter.step % 2:
                    raise UsageError(
                        f"{name}: a picture's height is an even number of pixels; min and step must be even and "
                        f"positive, got {height:g} and {parameter.step:g}."
                    )
        if parameter.of == "depth_limit" and low <= 0:
            raise UsageError(f"{name}: must be a positive number of metres, got {low:g}.")
        value = self._start_of(parameter)
        if not parameter.low <= value <= parameter.high:
            raise UsageError(
                f"{name}: {self.start.name} starts at {value:g}, outside of the bounds {parameter.low:g} to "
                f"{parameter.high:g}."
            )

    def range_of(self, parameter: Parameter) -> tuple[float, float]:
        """The smallest and the largest value that the quantity itself can take in any of its cameras."""
        lowest = self._lowest(parameter)
        return min(lowest), max(lowest) + parameter.high - parameter.low

    def _lowest(self, parameter: Parameter) -> list[float]:
        """The smallest value that the quantity itself can take in each camera."""
        if not parameter.relative:
            return [parameter.low]
        if parameter.of == "depth_limit":
            return [self.start_depth_limit_m + parameter.low]
        return [self._start_numbers(channel)[parameter.of] + parameter.low for channel in parameter.cameras]

    @cached_property
    def _cameras(self) -> dict[str, Camera]:
        return dict(zip(self.start.channels, self.start.cameras, strict=True))

    def _start_numbers(self, channel: str) -> dict[str, float]:
        camera = self._cameras[channel]
        yaw, pitch, roll = camera.yaw_pitch_roll_deg
        x, y, z = camera.centre_ego.tolist()
        lens = camera.lens
        numbers = {"x": x, "y": y, "z": z, "yaw": yaw, "pitch": pitch, "roll": roll, "hfov": lens.hfov_deg}
        numbers["height"] = lens.height_px
        return {name: round(value, _GRID_DIGITS) for name, value in numbers.items()}

    def _start_of(self, parameter: Parameter) -> float:
        if parameter.of == "depth_limit":
            return 0.0 if parameter.relative else self.start_depth_limit_m
        if parameter.relative:
            return 0.0
        starts = [self._start_numbers(channel)[parameter.of] for channel in parameter.cameras]
        return float(np.mean(starts))

    @property
    def start_values(self) -> Float:
        """(n,) where the search starts; of cameras that share a number, their mean."""
        return np.array([self._start_of(parameter) for parameter in self.parameters])

    def on_grid(self, values: Float) -> Float:
        """`values` (n,) without the dust of floating point, inside the bounds."""
        low, high = (np.array([getattr(p, side) for p in self.parameters]) for side in ("low", "highest"))
        clean: Float = np.clip(np.round(values, _GRID_DIGITS), low, high) + 0.0
        return clean

    def depth_limit_m(self, values: Sequence[float]) -> float:
        """D0 of the free numbers (n,)."""
        for parameter, value in zip(self.parameters, values, strict=True):
            if parameter.of == "depth_limit":
                return self.start_depth_limit_m + float(value) if parameter.relative else float(value)
        return self.start_depth_limit_m

    def rig(self, values: Sequence[float], name: str = "", description: str = "") -> Rig:
        """The virtual rig of the free numbers (n,), D0 included."""
        numbers = {channel: self._start_numbers(channel) for channel in self.start.channels}
        changed = set()
        for parameter, value in zip(self.parameters, values, strict=True):
            for channel in parameter.cameras:
                base = numbers[channel][parameter.of] if parameter.relative else 0.0
                numbers[channel][parameter.of] = base + float(value)
                changed.add((channel, parameter.of in _LENS))
        cameras = []
        for channel, start in self._cameras.items():
            leader = self.mirror.get(channel, channel)
            own, lens = numbers[leader], self._cameras[leader].pinhole
            if (leader, True) in changed:
                lens = Pinhole.from_hfov(own["hfov"], lens.width_px, round(own["height"]))
            if leader != channel:
                own = {key: -value if key in _MIRRORED else value for key, value in own.items()}
                lens = dataclasses.replace(lens, cx_px=lens.width_px - 1 - lens.cx_px)
            elif (channel, False) not in changed:
                cameras.append(Camera(channel, lens, start.ego_from_cam))
                continue
            rotation = rotation_from_yaw_pitch_roll(own["yaw"], own["pitch"], own["roll"])
            cameras.append(Camera(channel, lens, pose(rotation, [own["x"], own["y"], own["z"]])))
        return Rig(
            name or self.start.name,
            description or self.start.description,
            tuple(cameras),
            self.depth_limit_m(values),
            self.start.ground_height_m,
        )

    @property
    def lowest_depth_limit_m(self) -> float:
        """The smallest D0 that a candidate can have."""
        ranges = [self.range_of(parameter)[0] for parameter in self.parameters if parameter.of == "depth_limit"]
        return min(ranges, default=self.start_depth_limit_m)

    def reach_m(self) -> tuple[Float, Float]:
        """Corners (3,), (3,) of a box in the ego frame that holds the centres of all candidates' cameras."""
        lows, highs = [], []
        for channel in self.start.channels:
            leader = self.mirror.get(channel, channel)
            numbers = self._start_numbers(leader)
            low = np.array([numbers[axis] for axis in "xyz"])
            high = low.copy()
            for parameter in self.parameters:
                if leader in parameter.cameras and parameter.of in ("x", "y", "z"):
                    axis = "xyz".index(parameter.of)
                    base = numbers[parameter.of] if parameter.relative else 0.0
                    low[axis], high[axis] = base + parameter.low, base + parameter.high
            if leader != channel:
                low[1], high[1] = -high[1], -low[1]
            lows.append(low)
            highs.append(high)
        return np.min(lows, axis=0), np.max(highs, axis=0)


def _is_centred(lens: Pinhole) -> bool:
    """Whether a lens is given by its field of view alone, to 1e-6."""
    centred = Pinhole.from_hfov(lens.hfov_deg, lens.width_px, lens.height_px)
    return bool(np.allclose(lens.matrix, centred.matrix, rtol=0, atol=1e-6))
