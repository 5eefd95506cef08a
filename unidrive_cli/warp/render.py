"""The renderer: source pictures in, virtual pictures and coverage masks out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.scene import GroundPlane
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.pictures import Picture, encode_mask
from unidrive_cli.warp.remap import Blend, Mask, Patch, Source, VirtualView, build_patches, coverage, fixed_point


class Renderer:
    """Renders a virtual rig from whatever sources each frame has.

    This is the seam for faster kernels: whatever takes sources and pictures and gives back one
    `Picture` and one mask per virtual camera can stand in its place.

    The tables of the last frame are kept, so frames with the same calibrations and no motion
    between the cameras (or with the motion left out) share them.
    """

    def __init__(self, rig: Rig, depth_limit_m: float, ground_height_m: float, blend: Blend) -> None:
        """
        Raises:
            GeometryError: a virtual camera below the ground, or a depth limit below its height.
        """
        ground = GroundPlane(ground_height_m)
        self.views = [VirtualView(camera, depth_limit_m, ground) for camera in rig.cameras]
        self._blend = blend
        self._tables: tuple[object, list[ViewTables]] | None = None

    def tables(self, sources: Sequence[Source]) -> list[ViewTables]:
        """The remap tables of all virtual cameras for these sources."""
        key = tuple((source.lens, source.cam_from_ego.tobytes()) for source in sources)
        if self._tables is None or self._tables[0] != key:
            self._tables = None
            built = [ViewTables(view, build_patches(view, sources, self._blend)) for view in self.views]
            self._tables = (key, built)
        return self._tables[1]


class ViewTables:
    """The remap tables of one virtual camera, in the form that OpenCV's kernels take."""

    def __init__(self, view: VirtualView, patches: Sequence[Patch]) -> None:
        lens = view.camera.lens
        self._shape = (lens.height_px, lens.width_px, 3)
        self.mask: Mask = coverage(view, patches)
        done = np.zeros(self._shape[:2], dtype=np.float32)
        self._steps = [_Step.after(done, patch) for patch in patches]

    @property
    def remaps(self) -> int:
        """How many remaps one picture takes."""
        return len(self._steps)

    @cached_property
    def mask_png(self) -> bytes:
        """The coverage mask as a 1-bit PNG file."""
        return encode_mask(self.mask)

    @cached_property
    def covered(self) -> float:
        """Share of the virtual pixels that a source sees."""
        return float(np.count_nonzero(self.mask)) / self.mask.size

    def render(self, pictures: Sequence[Picture]) -> Picture:
        """The virtual picture (H, W, 3) uint8 of the sources' pictures; black where none sees the pixel."""
        canvas = np.zeros(self._shape, dtype=np.uint8)
        for step in self._steps:
            step.draw(pictures[step.source], canvas)
        return canvas


@dataclass(eq=False)
class _Step:
    """One source drawn over what the sources before it have drawn.

    The running result and this source are mixed in the ratio of their summed weights, so after the
    last source every pixel is the weighted mean of all (UniDrive eq. 3).
    """

    source: int
    box: tuple[slice, slice]
    whole: npt.NDArray[np.int16]
    fraction: npt.NDArray[np.uint16]
    fresh: Mask | None
    mixed_box: tuple[slice, slice] | None
    mixed: Mask | None
    weight_before: npt.NDArray[np.float32] | None
    weight: npt.NDArray[np.float32] | None

    @classmethod
    def after(cls, done: npt.NDArray[np.float32], patch: Patch) -> _Step:
        """The step of `patch` after the weights `done` (H, W), which it adds its own to."""
        before = done[patch.box]
        overlap = patch.valid & (before > 0)
        fresh = patch.valid & ~overlap
        step = cls(
            patch.source,
            patch.box,
            *fixed_point(patch.pixels),
            None if fresh.all() else fresh.astype(np.uint8),
            None,
            None,
            None,
            None,
        )
        if overlap.any():
            rows, columns = np.flatnonzero(overlap.any(axis=1)), np.flatnonzero(overlap.any(axis=0))
            box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            step.mixed_box = box
            step.mixed = overlap[box].astype(np.uint8)
            step.weight_before = np.ascontiguousarray(before[box])
            step.weight = np.ascontiguousarray(patch.weight[box])
        done[patch.box] += patch.weight
        return step

    def draw(self, picture: Picture, canvas: Picture) -> None:
        target = canvas[self.box]
        warped = cv2.remap(picture, self.whole, self.fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if self.mixed_box is not None:
            mixed_target = target[self.mixed_box]
            mixed = cv2.blendLinear(
                np.ascontiguousarray(mixed_target),
                np.ascontiguousarray(warped[self.mixed_box]),
                self.weight_before,
                self.weight,
            )
            np.copyto(mixed_target, mixed, where=self.mixed[..., None].astype(bool))
        if self.fresh is None:
            target[...] = warped
        else:
            cv2.copyTo(warped, self.fresh, target)
