"""The renderer on OpenCV's kernels: fixed-point remap tables, blendLinear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.common import CommonMasks, blanks_of
from unidrive_cli.warp.exposure import Exposure, even_out
from unidrive_cli.warp.pictures import Picture, encode_jpeg, read_picture
from unidrive_cli.warp.reduction import Copies, Reductions
from unidrive_cli.warp.remap import (
    Mask,
    Patch,
    Source,
    VirtualView,
    bounds,
    build_patches,
    coverage,
    strips,
    virtual_views,
)
from unidrive_cli.warp.render import VirtualPicture

_BAND_ROWS = 64
"""Rows drawn at once: their warped pixels stay in the processor's cache until they are mixed."""
_NO_SECOND_MAP = np.empty(0, dtype=np.float32)


class OpenCVRenderer:
    """Renders with OpenCV's kernels from remap tables of the picture's size.

    The tables of the last frame are kept, so frames with the same calibrations and no motion
    between the cameras (or with the motion left out) share them.
    """

    def __init__(self, rig: Rig, choices: WarpChoices, common: CommonMasks | None = None) -> None:
        """
        Args:
            common: blackens what is not common.

        Raises:
            RigError: a virtual camera below the ground, or a depth limit below its height.
        """
        self.views = virtual_views(rig, choices.depth_limit_m, choices.ground_height_m)
        self._blend = choices.blend
        self._blanks = blanks_of(common, len(self.views))
        self._exposure = Exposure(self.views) if choices.exposure == "gain" else None
        self._reductions = Reductions(self.views, anti_alias=choices.anti_alias)
        self._tables: tuple[object, list[ViewTables]] | None = None

    def render(
        self, paths: Sequence[Path], sources: Sequence[Source], quality: int, hint: str
    ) -> Iterator[VirtualPicture]:
        """See `unidrive_cli.warp.render.Renderer`."""
        pictures = [
            read_picture(path, (source.lens.width_px, source.lens.height_px), hint)
            for path, source in zip(paths, sources, strict=True)
        ]
        if self._exposure:
            even_out(self._exposure, sources, pictures)
        copies = Copies(pictures)
        for tables, blanks in zip(self.tables(sources), self._blanks, strict=True):
            picture = tables.render(copies)
            if blanks:
                blanks.cover(tables.mask)
                blanks.blank(picture)
            yield VirtualPicture(encode_jpeg(picture, quality), tables.mask, cv2.countNonZero(tables.mask))

    def tables(self, sources: Sequence[Source]) -> list[ViewTables]:
        """The remap tables of all virtual cameras for these sources."""
        key = tuple(
            (source.lens, source.cam_from_ego.tobytes(), source.calibrated.tobytes(), source.own_car)
            for source in sources
        )
        if self._tables is None or self._tables[0] != key:
            self._tables = None
            built = [
                ViewTables(view, build_patches(view, sources, self._blend, reductions), reductions)
                for view, reductions in zip(self.views, self._reductions.of(sources), strict=True)
            ]
            self._tables = (key, built)
        return self._tables[1]


class ViewTables:
    """The remap tables of one virtual camera, in the form that OpenCV's kernels take."""

    def __init__(self, view: VirtualView, patches: Sequence[Patch], reductions: Sequence[float]) -> None:
        """
        Args:
            reductions: of which copy each source's pixels are taken, see `unidrive_cli.warp.reduction`.
        """
        lens = view.camera.lens
        self._shape = (lens.height_px, lens.width_px, 3)
        self.mask: Mask = coverage(view, patches)
        done = np.zeros(self._shape[:2], dtype=np.float32)
        self.sources = [patch.source for patch in patches]
        bands = [band for patch in patches for band in strips(patch, _BAND_ROWS)]
        self._steps = [_Step.after(done, band, reductions[band.source]) for band in bands]
        self._scratch_bytes = max((3 * band.valid.size for band in bands), default=0)

    def render(self, pictures: Copies) -> Picture:
        """The virtual picture (H, W, 3) uint8 of the sources' pictures; black where none sees the pixel."""
        canvas = np.zeros(self._shape, dtype=np.uint8)
        scratch = np.empty(self._scratch_bytes, dtype=np.uint8)
        for step in self._steps:
            step.draw(pictures.of(step.source, step.reduction), canvas, scratch)
        return canvas


@dataclass(frozen=True, eq=False)
class _Mix:
    """The pixels of a step that sources before it have drawn too.

    Attributes:
        box: rows and columns, inside the step's own box.
        where: (h, w) uint8, non-zero on those pixels.
        weight_before, weight: (h, w) float32 weights of the running result and of this source.
    """

    box: tuple[slice, slice]
    where: Mask
    weight_before: npt.NDArray[np.float32]
    weight: npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Step:
    """One source drawn over what the sources before it have drawn.

    The running result and this source are mixed in the ratio of their summed weights, so after the
    last source every pixel is the weighted mean of all (UniDrive eq. 3).

    Attributes:
        source: index of the source.
        reduction: which copy of its picture is drawn.
        box: rows and columns of the virtual picture.
        whole, fraction: coordinates in that copy, in OpenCV's fixed-point form (1/32 pixel).
        fresh: (h, w) uint8, non-zero where this source is the first; None where it is so everywhere.
        mix: the pixels where it is not.
    """

    source: int
    reduction: float
    box: tuple[slice, slice]
    whole: npt.NDArray[np.int16]
    fraction: npt.NDArray[np.uint16]
    fresh: Mask | None
    mix: _Mix | None

    @classmethod
    def after(cls, done: npt.NDArray[np.float32], patch: Patch, reduction: float) -> _Step:
        """The step of `patch` after the summed weights `done` (H, W), which it adds its own to."""
        before = done[patch.box]
        overlap = patch.valid & (before > 0)
        fresh = patch.valid & ~overlap
        mix = None
        box = bounds(overlap)
        if box is not None:
            mix = _Mix(box, overlap[box].astype(np.uint8), before[box].copy(), patch.weight[box].copy())
        pixels = (
            patch.pixels
            if reduction == 1
            else (patch.pixels + np.float32(0.5)) / np.float32(reduction) - np.float32(0.5)
        )
        whole, fraction = cv2.convertMaps(pixels, _NO_SECOND_MAP, cv2.CV_16SC2)
        done[patch.box] += patch.weight
        return cls(
            patch.source,
            reduction,
            patch.box,
            np.asarray(whole, dtype=np.int16),
            np.asarray(fraction, dtype=np.uint16),
            None if fresh.all() else fresh.astype(np.uint8),
            mix,
        )

    def draw(self, picture: Picture, canvas: Picture, scratch: Picture) -> None:
        """Draws the source `picture` (h, w, 3) into its part of `canvas` (H, W, 3).

        `scratch` is memory (n,) for the warped part: taking it anew for every source costs page faults.
        """
        target = canvas[self.box]
        alone = self.fresh is None and self.mix is None
        warped = target if alone else scratch[: target.size].reshape(target.shape)
        cv2.remap(picture, self.whole, self.fraction, cv2.INTER_LINEAR, dst=warped, borderMode=cv2.BORDER_REPLICATE)
        if self.mix is not None:
            shared = target[self.mix.box]
            mixed = cv2.blendLinear(shared, warped[self.mix.box], self.mix.weight_before, self.mix.weight)
            cv2.copyTo(mixed, self.mix.where, shared)
        if self.fresh is not None:
            cv2.copyTo(warped, self.fresh, target)
