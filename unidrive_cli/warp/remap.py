"""Remap tables: for each virtual pixel, where in which source its colour comes from, and with what weight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import GeometryError, RigError
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.blending import angular_weights, parallax_chord
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import inverse, transform
from unidrive_cli.geometry.scene import GroundPlane, HalfBall
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.warp.choices import Blend
from unidrive_cli.warp.own_car import OwnCar, hidden_of

Mask = npt.NDArray[np.uint8]

MIN_SHARE = 1 / 512
"""Shares of a blend below this are dropped."""

_SEARCH_STEP_RAD = 0.014
_SEARCH_MARGIN_SINE = 0.1


@dataclass(frozen=True, eq=False)
class Source:
    """One real picture as the warp sees it.

    Attributes:
        lens: its lens, with the picture size.
        cam_from_ego: (4, 4) from the virtual picture's ego frame into the source camera, the ego
            motion between the two moments included.
        cam_from_own_ego: (4, 4) the calibration alone; None where `cam_from_ego` is just that.
        own_car: what of the picture shows the own car, and is not sampled.
    """

    lens: Lens
    cam_from_ego: Float
    cam_from_own_ego: Float | None = None
    own_car: OwnCar | None = None

    @property
    def calibrated(self) -> Float:
        """(4, 4) from the ego frame of the source's own moment into its camera."""
        return self.cam_from_ego if self.cam_from_own_ego is None else self.cam_from_own_ego

    @property
    def centre_ego(self) -> Float:
        """(3,) optical centre in the virtual picture's ego frame, metres."""
        return inverse(self.cam_from_ego)[:3, 3]


class VirtualView:
    """A virtual camera with the scene surface that its pixels are assumed to show."""

    def __init__(self, camera: Camera, depth_limit_m: float, ground: GroundPlane) -> None:
        lens = camera.pinhole
        self.camera = camera
        self.half_ball = HalfBall(camera.centre_ego, depth_limit_m, ground)
        self._x = (np.arange(lens.width_px) - lens.cx_px) / lens.fx_px
        self._y = (np.arange(lens.height_px) - lens.cy_px) / lens.fy_px

    @cached_property
    def depth_m(self) -> Float:
        """(H, W) depth along the optical axis of each pixel's scene point."""
        lens = self.camera.lens
        pixels = np.stack(np.meshgrid(np.arange(lens.width_px), np.arange(lens.height_px)), axis=-1)
        rays_cam = lens.unproject(pixels.astype(np.float64))
        rays_ego = rays_cam @ self.camera.ego_from_cam[:3, :3].T
        return self.half_ball.exit_distance_m(self.camera.centre_ego, rays_ego) * rays_cam[..., 2]

    def points(
        self, frame_from_ego: Float, rows: npt.NDArray[np.intp] | slice, columns: npt.NDArray[np.intp] | slice
    ) -> Float:
        """Scene points (h, w, 3) of a grid of pixels in another frame, metres.

        Point = t (A x + b) with the pixel's depth t and A, b of the rigid transform, so the work per
        pixel is one multiplication and two additions per axis.
        """
        frame_from_cam = frame_from_ego @ self.camera.ego_from_cam
        rotation, origin = frame_from_cam[:3, :3], frame_from_cam[:3, 3]
        x, y = self._x[columns], self._y[rows]
        depth = self.depth_m[rows][:, columns]
        planes = np.empty((3, len(y), len(x)))
        for axis in range(3):
            np.add(
                (rotation[axis, 0] * x)[None, :],
                (rotation[axis, 1] * y + rotation[axis, 2])[:, None],
                planes[axis],
            )
            planes[axis] *= depth
            planes[axis] += origin[axis]
        return np.moveaxis(planes, 0, -1)

    def points_at(self, frame_from_ego: Float, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> Float:
        """Scene points (n, 3) of single pixels in another frame, metres."""
        x, y = self._x[columns], self._y[rows]
        points_cam = np.stack([x, y, np.ones_like(x)], axis=-1) * self.depth_m[rows, columns][:, None]
        return transform(frame_from_ego @ self.camera.ego_from_cam, points_cam)


def virtual_views(rig: Rig, depth_limit_m: float, ground_height_m: float) -> list[VirtualView]:
    """The cameras of a virtual rig, each with its own scene surface.

    Raises:
        RigError: a virtual camera with lens distortion or below the ground, or a depth limit below its height.
    """
    ground = GroundPlane(ground_height_m)
    views = []
    for camera in rig.cameras:
        try:
            views.append(VirtualView(camera, depth_limit_m, ground))
        except GeometryError as error:
            raise RigError(error.what, where=f"{rig.name}, camera {camera.channel}") from error
    return views


@dataclass(eq=False)
class Patch:
    """The part of a virtual picture that one source fills.

    Attributes:
        source: index of the source.
        box: rows and columns of the part, cropped to the pixels that the source sees.
        pixels: (h, w, 2) float32 source coordinates; 0 where the source does not see the pixel.
        valid: (h, w) where it does.
        weight: (h, w) float32 share of this source in the blend: the shares of all sources sum to 1
            where any source sees the pixel.
    """

    source: int
    box: tuple[slice, slice]
    pixels: npt.NDArray[np.float32]
    valid: Bool
    weight: npt.NDArray[np.float32]


def build_patches(
    view: VirtualView, sources: Sequence[Source], blend: Blend, reductions: Sequence[float] = ()
) -> list[Patch]:
    """The remap tables of one virtual camera: one patch per source that it overlaps with.

    With `angular`, shares below 1/512 are dropped: each could change an 8-bit pixel by at most half a
    level. With `nearest`, each pixel belongs to the source with the largest weight. The patches are
    cropped to what remains.

    Args:
        reductions: which copy of each source is sampled, see `unidrive_cli.warp.reduction`; none where empty.
    """
    reductions = reductions or (1.0,) * len(sources)
    lens = view.camera.lens
    patches = [
        patch
        for index, (source, n) in enumerate(zip(sources, reductions, strict=True))
        if (patch := _project_patch(view, source, index, n)) is not None
    ]
    count = np.zeros((lens.height_px, lens.width_px), dtype=np.uint8)
    for patch in patches:
        count[patch.box] += patch.valid
    shared = count > 1
    if not shared.any():
        return patches
    for patch in patches:
        _weigh(view, sources[patch.source], patch, shared)
    if blend == "nearest":
        _keep_largest(patches, count.shape)
    else:
        total = _total_weight(patches, count.shape)
        for patch in patches:
            patch.valid &= patch.weight >= MIN_SHARE * total[patch.box]
            patch.weight[~patch.valid] = 0
    total = _total_weight(patches, count.shape)
    for patch in patches:
        np.divide(patch.weight, total[patch.box], out=patch.weight, where=patch.valid)
    return [cropped for patch in patches if (cropped := _cropped(patch)) is not None]


def _total_weight(patches: Sequence[Patch], shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    total = np.zeros(shape, dtype=np.float32)
    for patch in patches:
        total[patch.box] += patch.weight
    return total


def _keep_largest(patches: Sequence[Patch], shape: tuple[int, ...]) -> None:
    """Leaves each pixel to the source with the largest weight; the first of equals."""
    best = np.zeros(shape, dtype=np.float32)
    for patch in patches:
        np.maximum(best[patch.box], patch.weight, out=best[patch.box])
    taken = np.zeros(shape, dtype=bool)
    for patch in patches:
        patch.valid &= (patch.weight == best[patch.box]) & ~taken[patch.box]
        taken[patch.box] |= patch.valid
        patch.weight[~patch.valid] = 0


def coverage(view: VirtualView, patches: Sequence[Patch]) -> Mask:
    """(H, W) uint8: 255 where at least one source sees the virtual pixel."""
    mask = np.zeros((view.camera.lens.height_px, view.camera.lens.width_px), dtype=np.uint8)
    for patch in patches:
        mask[patch.box][patch.valid] = 255
    return mask


def dominant_sources(view: VirtualView, patches: Sequence[Patch]) -> npt.NDArray[np.int32]:
    """(H, W) index of the source with the largest share of each virtual pixel; -1 where none sees it.

    Of equal shares the first source's counts.
    """
    shape = view.camera.lens.height_px, view.camera.lens.width_px
    best = np.zeros(shape, dtype=np.float32)
    dominant = np.full(shape, -1, dtype=np.int32)
    for patch in patches:
        larger = patch.valid & (patch.weight > best[patch.box])
        best[patch.box][larger] = patch.weight[larger]
        dominant[patch.box][larger] = patch.source
    return dominant


def _project_patch(view: VirtualView, source: Source, index: int, n: float) -> Patch | None:
    box = candidate_box(view, source)
    if box is None:
        return None
    exact, valid = source.lens.project(view.points(source.cam_from_ego, *box))
    if source.own_car:
        valid &= ~hidden_of(source.own_car, n).holds(np.where(valid[..., None], exact, 0))
    pixels = exact.astype(np.float32)
    pixels[~valid] = 0
    return _cropped(Patch(index, box, pixels, valid, valid.astype(np.float32)))


def candidate_box(view: VirtualView, source: Source) -> tuple[slice, slice] | None:
    """A box that holds every pixel the source can see, from a coarse grid of the view.

    Nodes are some 0.8 degrees apart; a node within 6 degrees of the source's field counts, so a
    field border between two nodes is not lost.
    """
    lens = view.camera.lens
    step = int(np.clip(_SEARCH_STEP_RAD * min(lens.fx_px, lens.fy_px), 1, 16))
    rows = np.append(np.arange(0, lens.height_px - 1, step), lens.height_px - 1)
    columns = np.append(np.arange(0, lens.width_px - 1, step), lens.width_px - 1)
    near = source.lens.border_sine(view.points(source.cam_from_ego, rows, columns)) > -_SEARCH_MARGIN_SINE
    hits = bounds(near)
    if hits is None:
        return None
    row_box, column_box = hits
    return (
        slice(int(rows[max(row_box.start - 1, 0)]), int(rows[min(row_box.stop, len(rows) - 1)]) + 1),
        slice(
            int(columns[max(column_box.start - 1, 0)]),
            int(columns[min(column_box.stop, len(columns) - 1)]) + 1,
        ),
    )


def _weigh(view: VirtualView, source: Source, patch: Patch, shared: Bool) -> None:
    rows, columns = np.nonzero(patch.valid & shared[patch.box])
    at = rows + patch.box[0].start, columns + patch.box[1].start
    points_ego = view.points_at(np.eye(4), *at)
    border_sine = source.lens.border_sine(transform(source.cam_from_ego, points_ego))
    chord = parallax_chord(points_ego, view.camera.centre_ego, source.centre_ego)
    patch.weight[rows, columns] = angular_weights(border_sine, chord)


def strips(patch: Patch, rows: int) -> Iterator[Patch]:
    """Cuts a patch into bands of some rows, each cropped anew: borders that slant waste fewer pixels."""
    height = len(patch.valid)
    for start in range(0, height, rows):
        band = slice(start, min(start + rows, height)), slice(0, patch.valid.shape[1])
        strip = _part(patch, band)
        if (cropped := _cropped(strip)) is not None:
            yield cropped


def _cropped(patch: Patch) -> Patch | None:
    box = bounds(patch.valid)
    return None if box is None else _part(patch, box)


def _part(patch: Patch, box: tuple[slice, slice]) -> Patch:
    """The rows and columns `box` of a patch."""
    rows, columns = box
    top, left = patch.box[0].start, patch.box[1].start
    return Patch(
        patch.source,
        (slice(top + rows.start, top + rows.stop), slice(left + columns.start, left + columns.stop)),
        np.ascontiguousarray(patch.pixels[box]),
        np.ascontiguousarray(patch.valid[box]),
        np.ascontiguousarray(patch.weight[box]),
    )


def bounds(mask: Bool) -> tuple[slice, slice] | None:
    """The smallest box (rows, columns) that holds every true pixel of a mask (h, w); None if there is none."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
