"""Common coverage: the virtual pixels that every car of a fleet can fill, the same for every frame."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.own_car import hidden_of
from unidrive_cli.warp.remap import Mask, Source, VirtualView, candidate_box

DEFAULT_SWEEP_M = 1.0
"""How far a car drives between a camera's moment and the reference, at most."""
_ROWS = 64
_GRID = 128


@dataclass(frozen=True, eq=False)
class CommonMasks:
    """What every rig of a fleet fills of each virtual picture, packed for the way to the workers.

    Attributes:
        shapes: (height, width) of each virtual picture, in the rig's order.
        packed: their masks, one bit a pixel, compressed.
        shares: how much of each picture is common.
    """

    shapes: tuple[tuple[int, int], ...]
    packed: tuple[bytes, ...]
    shares: tuple[float, ...]

    @classmethod
    def of(cls, masks: Sequence[Bool]) -> CommonMasks:
        """Packs masks (H, W) bool."""
        return cls(
            tuple((mask.shape[0], mask.shape[1]) for mask in masks),
            tuple(zlib.compress(np.packbits(mask).tobytes()) for mask in masks),
            tuple(_share(mask) for mask in masks),
        )

    def masks(self) -> list[Mask]:
        """(H, W) uint8 each: 255 where the pixel is common, 0 elsewhere."""
        found = []
        for (height, width), packed in zip(self.shapes, self.packed, strict=True):
            bits = np.unpackbits(np.frombuffer(zlib.decompress(packed), dtype=np.uint8), count=height * width)
            found.append((bits * np.uint8(255)).reshape(height, width))
        return found


def common_masks(views: Sequence[VirtualView], rigs: Sequence[Rig], sweep_m: float) -> CommonMasks:
    """The pixels of each virtual picture that every rig fills, wherever its cameras stood when they fired.

    A camera that fires before the reference moment stood up to `sweep_m` farther back, seen from there. A pixel
    counts as filled by a rig if one of its cameras sees it from both ends of that stretch: a pinhole, whose
    field is convex, then sees it from everywhere between, and it does not matter which camera fires when.

    Args:
        views: the virtual cameras.
        rigs: the fleet's, at their calibrated places.
        sweep_m: length of the stretch in metres; 0 leaves the calibrated places.

    Raises:
        UsageError: nothing is common, or a stretch that is no length.
    """
    masks = [_common(view, rigs, _checked(sweep_m)) for view in views]
    if not any(mask.any() for mask in masks):
        names = ", ".join(rig.name for rig in rigs)
        raise UsageError(f"no virtual pixel can be filled by all of {names}: nothing would be left.")
    return CommonMasks.of(masks)


class Blanks:
    """The pixels of one virtual picture that are not common: black and not covered, as where no source sees."""

    def __init__(self, common: Mask) -> None:
        """
        Args:
            common: (H, W) uint8, 255 or 0.
        """
        self._common = common
        self._pixels = common == 0
        padded = np.pad(common, [(0, side % 2) for side in common.shape], mode="edge")
        blocks = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2)
        self._chroma = blocks.max(axis=(1, 3)) == 0

    def cover(self, mask: Mask) -> None:
        """Takes the pixels out of a coverage mask (H, W)."""
        cv2.bitwise_and(mask, self._common, dst=mask)

    def blank(self, picture: npt.NDArray[np.uint8]) -> None:
        """Blackens the pixels of a picture (H, W, 3)."""
        picture[self._pixels] = 0

    def blank_planes(self, planes: Sequence[npt.NDArray[np.uint8]]) -> None:
        """Blackens the pixels of 4:2:0 planes; a chroma sample where all its pixels are black."""
        luma, *chroma = planes
        cv2.bitwise_and(luma, self._common, dst=luma)
        for plane in chroma:
            np.copyto(plane, 128, where=self._chroma)


def blanks_of(common: CommonMasks | None, count: int) -> list[Blanks | None]:
    """What is to be blackened in each of so many virtual pictures."""
    return [None] * count if common is None else [Blanks(mask) for mask in common.masks()]


@dataclass(frozen=True)
class Fill:
    """How much of each virtual picture rigs fill.

    Attributes:
        by_rig: for each virtual camera the shares of the rigs, their cameras at their calibrated places.
        common: for each virtual camera what is common, as `common_masks` has it.
        sweep_m: its stretch.
    """

    by_rig: tuple[tuple[float, ...], ...]
    common: tuple[float, ...]
    sweep_m: float


def fill(views: Sequence[VirtualView], rigs: Sequence[Rig], sweep_m: float) -> Fill:
    """How much of each virtual picture rigs fill, each alone and in common.

    Raises:
        UsageError: a stretch that is no length.
    """
    by_rig = tuple(tuple(_share(_filled(view, rig, 0.0)) for rig in rigs) for view in views)
    common = tuple(_share(_common(view, rigs, _checked(sweep_m))) for view in views)
    return Fill(by_rig, common, sweep_m)


def covered_share(view: VirtualView, sources: Sequence[Source], common: Mask | None = None) -> float:
    """Share of a virtual picture's pixels that at least one source sees, from a grid of 128 x 128 of them.

    Args:
        common: (H, W) the pixels that are not blackened.
    """
    lens = view.camera.lens
    rows, columns = (
        np.unique(((np.arange(_GRID) + 0.5) * side / _GRID).astype(np.intp))
        for side in (lens.height_px, lens.width_px)
    )
    seen: Bool = np.zeros((len(rows), len(columns)), dtype=bool)
    for source in sources:
        pixels, valid = source.lens.project(view.points(source.cam_from_ego, rows, columns))
        if source.own_car:
            valid = valid & ~hidden_of(source.own_car, 1.0).holds(np.where(valid[..., None], pixels, 0))
        seen |= valid
    if common is not None:
        seen &= common[np.ix_(rows, columns)] > 0
    return float(seen.mean())


def _checked(sweep_m: float) -> float:
    if not 0 <= sweep_m <= 100:
        raise UsageError(f"--common-sweep must be from 0 to 100 metres, got {sweep_m:g}.")
    return sweep_m


def _share(mask: Bool) -> float:
    return round(float(mask.mean()), 6)


def _common(view: VirtualView, rigs: Sequence[Rig], sweep_m: float) -> Bool:
    """(H, W) where every rig fills the pixel."""
    common: Bool = np.ones((view.camera.lens.height_px, view.camera.lens.width_px), dtype=bool)
    for rig in rigs:
        common &= _filled(view, rig, sweep_m)
    return common


def _filled(view: VirtualView, rig: Rig, sweep_m: float) -> Bool:
    """(H, W) where some camera of a rig sees the pixel from both ends of its stretch."""
    lens = view.camera.lens
    filled = np.zeros((lens.height_px, lens.width_px), dtype=bool)
    for camera in rig.cameras:
        cam_from_ego = inverse(camera.ego_from_cam)
        ends = [Source(camera.lens, cam_from_ego)]
        if sweep_m:
            ahead = np.eye(4)
            ahead[0, 3] = sweep_m
            ends.append(Source(camera.lens, cam_from_ego @ ahead))
        boxes = [candidate_box(view, end) for end in ends]
        if any(box is None for box in boxes):
            continue
        rows, columns = (
            slice(max(box[axis].start for box in boxes if box), min(box[axis].stop for box in boxes if box))
            for axis in range(2)
        )
        for start in range(rows.start, rows.stop, _ROWS):
            band = slice(start, min(start + _ROWS, rows.stop)), columns
            open_pixels = ~filled[band]
            if open_pixels.any():
                filled[band] |= open_pixels & _seen_from_all(view, ends, band)
    return filled


def _seen_from_all(view: VirtualView, ends: Sequence[Source], box: tuple[slice, slice]) -> Bool:
    seen: Bool = np.ones((box[0].stop - box[0].start, box[1].stop - box[1].start), dtype=bool)
    for end in ends:
        seen &= end.lens.project(view.points(end.cam_from_ego, *box))[1]
    return seen
