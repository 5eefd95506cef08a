"""What a virtual rig costs the cars that are to share it: projection error, corners lost, pixels unfilled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.arrays import Float, lengths
from unidrive_cli.geometry.blending import BORDER_FLOOR, PARALLAX_FLOOR
from unidrive_cli.geometry.lenses import PIXEL_TOLERANCE, Lens, Pinhole
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.geometry.projection_error import Sighting, point_errors, sight
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.remap import VirtualView, virtual_views

GRID = (40, 24)
"""Places, across and down, at which it is seen what a rig fills of a virtual picture."""
_MOST_SOURCES = 64
_CORNERS = 8


@dataclass(frozen=True)
class Penalties:
    """What corners and pixels cost beside the error, in metre-radians.

    Attributes:
        uncovered: a corner that a rig's cameras see and no virtual camera does.
        unfilled: all virtual pixels, where some rig fills none of them; in proportion otherwise.
        worst: weight of the worst rig's own cost beside the mean of all.
    """

    uncovered: float = 2.0
    unfilled: float = 1.0
    worst: float = 0.0


@dataclass(frozen=True)
class RigCost:
    """What a virtual rig costs one car.

    Attributes:
        name: of the car's rig.
        error_m_rad: mean over the corners that the car's cameras see: of corners that virtual cameras see too,
            the blended error, averaged over those cameras; 0 for the others.
        uncovered: share of the corners that no virtual camera sees.
        unfilled: share of the virtual pixels that the car cannot fill.
        corners: how many the car's cameras see.
        pair_sum_m_rad, pairs: the paper's bare sum (eq. 6) over (corner, source, virtual camera), and its terms.
    """

    name: str
    error_m_rad: float
    uncovered: float
    unfilled: float
    corners: int
    pair_sum_m_rad: float
    pairs: int

    def total(self, penalties: Penalties) -> float:
        """The car's own cost, metre-radians."""
        return self.error_m_rad + penalties.uncovered * self.uncovered + penalties.unfilled * self.unfilled


@dataclass(frozen=True)
class Cost:
    """What a virtual rig costs a fleet.

    Attributes:
        rigs: the cars.
        not_common: share of the virtual pixels that not every car can fill.
        penalties: the weights.
    """

    rigs: tuple[RigCost, ...]
    not_common: float
    penalties: Penalties

    @property
    def error_m_rad(self) -> float:
        """Mean over the cars."""
        return float(np.mean([rig.error_m_rad for rig in self.rigs]))

    @property
    def uncovered(self) -> float:
        """Mean share over the cars."""
        return float(np.mean([rig.uncovered for rig in self.rigs]))

    @property
    def worst(self) -> RigCost:
        """The car that fares worst."""
        return max(self.rigs, key=lambda rig: rig.total(self.penalties))

    @property
    def total(self) -> float:
        """The objective, metre-radians: no part of it can be had by seeing less."""
        weights = self.penalties
        return (
            self.error_m_rad
            + weights.uncovered * self.uncovered
            + weights.unfilled * self.not_common
            + weights.worst * self.worst.total(weights)
        )


class Car:
    """A rig that is to share the virtual one, and the corners of boxes that its cameras see."""

    def __init__(self, rig: Rig, corners_ego: Float) -> None:
        """
        Args:
            rig: the real cameras at their calibrated places.
            corners_ego: (b, 8, 3) corners of boxes in the ego frame, metres.

        Raises:
            UsageError: no boxes, or none that a camera sees.
        """
        if not len(corners_ego):
            raise UsageError(f"there are no boxes for {rig.name}: the error needs some.")
        if len(rig.cameras) > _MOST_SOURCES:
            raise UsageError(f"{rig.name} has {len(rig.cameras)} cameras; at most {_MOST_SOURCES} are accepted.")
        self.rig = rig
        sources = [(camera.lens, inverse(camera.ego_from_cam)) for camera in rig.cameras]
        seen_by = _seen_by(sources, corners_ego)
        kept = seen_by.any(axis=1)
        if not kept.any():
            raise UsageError(f"no camera of {rig.name} sees any of the {len(corners_ego)} boxes.")
        corners_ego, self.seen_by = corners_ego[kept], seen_by[kept].reshape(-1)
        centre = corners_ego.mean(axis=1)
        self.boxes = np.column_stack([centre, lengths(corners_ego - centre[:, None]).max(axis=1)])
        self.points = np.ascontiguousarray(corners_ego.reshape(-1, 3))
        self.count = int(np.count_nonzero(self.seen_by))
        self.cam_from_ego = np.array([cam_from_ego for _, cam_from_ego in sources])

    @property
    def pinholes(self) -> list[Pinhole] | None:
        """The cameras' lenses, or None where one has distortion."""
        lenses = [camera.lens for camera in self.rig.cameras if isinstance(camera.lens, Pinhole)]
        return lenses if len(lenses) == len(self.rig.cameras) else None

    @cached_property
    def sightings(self) -> list[Sighting]:
        """What each camera sees, for the path without compiled code."""
        return [
            sight(self.points, camera.lens, cam_from_ego)
            for camera, cam_from_ego in zip(self.rig.cameras, self.cam_from_ego, strict=True)
        ]


class Objective:
    """The cost of virtual rigs for a fleet; may be asked from several threads at once."""

    def __init__(
        self, cars: Sequence[Car], penalties: Penalties, ground_height_m: float, *, compiled: bool | None = None
    ) -> None:
        """
        Args:
            compiled: whether to use the compiled kernel; None uses it where numba is installed and all lenses
                are pinholes.
        """
        self.cars = tuple(cars)
        self.penalties = penalties
        self.ground_height_m = ground_height_m
        possible = all(car.pinholes is not None for car in self.cars)
        self.compiled = possible and _has_numba() if compiled is None else compiled

    def __call__(self, rig: Rig, depth_limit_m: float) -> Cost:
        """The cost of a virtual rig.

        Raises:
            RigError: a virtual camera below the ground, or D0 below its height.
            GeometryError: a source outside of a virtual camera's half-ball.
        """
        views = virtual_views(rig, depth_limit_m, self.ground_height_m)
        sums, filled = self._compiled(views) if self.compiled else self._plain(views)
        sizes = np.array([view.camera.lens.width_px * view.camera.lens.height_px for view in views])
        shares = (filled * sizes[:, None]).sum(axis=0) / sizes.sum()
        costs = tuple(
            RigCost(
                car.rig.name,
                float(error / car.count),
                float(uncovered / car.count),
                float(1 - share),
                car.count,
                float(pair_sum),
                int(pairs),
            )
            for car, (error, uncovered, pair_sum, pairs, _), share in zip(self.cars, sums, shares, strict=False)
        )
        return Cost(costs, float(1 - shares[-1]), self.penalties)

    def _compiled(self, views: Sequence[VirtualView]) -> tuple[Float, Float]:
        from unidrive_cli.optimize import kernel

        view_from_ego, view_lens, view_normals = _cameras(
            [view.camera.pinhole for view in views], [inverse(view.camera.ego_from_cam) for view in views]
        )
        ego_from_view = np.array([view.camera.ego_from_cam for view in views])
        grounds = np.array(
            [
                [
                    *(view.half_ball.ground.normal @ view.camera.ego_from_cam[:3, :3]),
                    float(view.half_ball.ground.height_m(view.camera.centre_ego)),
                ]
                for view in views
            ]
        )
        radius = views[0].half_ball.radius_m
        sums, poses, lenses, owners = [], [], [], []
        for index, car in enumerate(self.cars):
            _, source_lens, source_normals = _cameras(car.pinholes or [], car.cam_from_ego)
            source_from_view = np.ascontiguousarray((car.cam_from_ego[None] @ ego_from_view[:, None])[:, :, :3])
            centre_view = -np.einsum(
                "vsji,vsj->vsi", source_from_view[..., :3], source_from_view[..., 3]
            )  # of a rigid pose's inverse
            sums.append(
                kernel.corner_errors(
                    car.boxes,
                    car.points,
                    car.seen_by,
                    source_from_view,
                    centre_view,
                    source_lens,
                    source_normals,
                    view_from_ego,
                    view_lens,
                    view_normals,
                    grounds,
                    radius,
                    (PIXEL_TOLERANCE, BORDER_FLOOR, PARALLAX_FLOOR),
                )
            )
            poses.append(source_from_view)
            lenses.append(source_lens)
            owners.extend([index] * len(source_lens))
        filled = kernel.filled(
            *GRID,
            np.concatenate(poses, axis=1),
            np.concatenate(lenses),
            np.array(owners, dtype=np.int64),
            len(self.cars),
            view_lens,
            grounds,
            radius,
            PIXEL_TOLERANCE,
        )
        return np.array(sums), filled

    def _plain(self, views: Sequence[VirtualView]) -> tuple[Float, Float]:
        return (
            np.array([_corner_errors(car, views) for car in self.cars]),
            np.array([_filled(self.cars, view) for view in views]),
        )


def _seen_by(sources: Sequence[tuple[Lens, Float]], corners_ego: Float) -> npt.NDArray[np.uint64]:
    """(b, 8) uint64: a bit for each source that sees the corner."""
    bits = np.zeros(corners_ego.shape[:2], dtype=np.uint64)
    flat = bits.reshape(-1)
    for index, (lens, cam_from_ego) in enumerate(sources):
        flat[sight(corners_ego.reshape(-1, 3), lens, cam_from_ego).points] |= np.uint64(1 << index)
    return bits


def _cameras(lenses: Sequence[Pinhole], cam_from_ego: Sequence[Float] | Float) -> tuple[Float, Float, Float]:
    """Poses (n, 3, 4), lenses (n, 6) and normals of the border planes (n, 4, 3), as the kernel takes them."""
    numbers = [[lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.width_px, lens.height_px] for lens in lenses]
    return (
        np.ascontiguousarray(np.array(cam_from_ego)[:, :3]),
        np.array(numbers, dtype=np.float64),
        np.array([lens.border_normals() for lens in lenses]),
    )


def _corner_errors(car: Car, views: Sequence[VirtualView]) -> Float:
    """(5,) as `kernel.corner_errors`."""
    total, shown = np.zeros(len(car.points)), np.zeros(len(car.points))
    pair_sum, pairs, behind = 0.0, 0, 0
    for view in views:
        camera = view.camera
        errors = point_errors(car.points, car.sightings, camera.pinhole, camera.ego_from_cam, view.half_ball)
        points, blended = errors.blended()
        total[points] += blended
        shown[points] += 1
        pair_sum, pairs, behind = (
            pair_sum + errors.error_m_rad.sum(),
            pairs + len(errors.point),
            behind + errors.behind,
        )
    mean = np.divide(total, shown, out=np.zeros_like(total), where=shown > 0)
    uncovered = np.count_nonzero((car.seen_by > 0) & (shown == 0))
    return np.array([mean.sum(), uncovered, pair_sum, pairs, behind])


def _filled(cars: Sequence[Car], view: VirtualView) -> Float:
    """(rigs + 1,) shares of the places of one virtual picture, as `kernel.filled`."""
    lens = view.camera.pinhole
    columns, rows = (
        (np.arange(n) + 0.5) / n * side - 0.5 for n, side in zip(GRID, (lens.width_px, lens.height_px), strict=True)
    )
    rays = lens.unproject(np.stack(np.meshgrid(columns, rows), axis=-1)) @ view.camera.ego_from_cam[:3, :3].T
    points = view.half_ball.surface_points(view.camera.centre_ego, rays)
    fills = np.array(
        [
            np.any(
                [
                    camera.lens.project(points @ pose[:3, :3].T + pose[:3, 3])[1]
                    for camera, pose in zip(car.rig.cameras, car.cam_from_ego, strict=True)
                ],
                axis=0,
            )
            for car in cars
        ]
    )
    return np.append(fills.mean(axis=(1, 2)), fills.all(axis=0).mean())


def _has_numba() -> bool:
    try:
        metadata.version("numba")
    except metadata.PackageNotFoundError:
        return False
    return True
