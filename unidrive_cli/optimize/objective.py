"""What a virtual rig costs the cars that are to share it: projection error, corners lost, pixels unfilled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.arrays import Float, lengths
from unidrive_cli.geometry.blending import BORDER_FLOOR, PARALLAX_FLOOR
from unidrive_cli.geometry.lenses import PIXEL_TOLERANCE, Pinhole
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.geometry.projection_error import Sighting, point_errors, sight
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.compiled import has_numba
from unidrive_cli.warp.remap import VirtualView, virtual_views

GRID = (40, 24)
"""Places, across and down, at which it is seen what a rig fills of a virtual picture."""
_MOST_SOURCES = 64
_CORNERS = 8


@dataclass(frozen=True)
class Penalties:
    """What corners and pixels cost beside the error, in metre-radians.

    Attributes:
        uncovered: a corner that a rig's cameras see and no virtual camera does: as if it were shown a radian
            off, at 30 m.
        unfilled: all virtual pixels, if some car filled none of them; in proportion otherwise.
        worst: weight of the worst rig's own cost beside the mean of all.
    """

    uncovered: float = 30.0
    unfilled: float = 0.2
    worst: float = 0.5


@dataclass(frozen=True)
class RigCost:
    """What a virtual rig costs one car.

    Attributes:
        name: of the car's rig.
        error_m_rad: mean over the corners that count: of those that virtual cameras see too, the blended error,
            averaged over those cameras; 0 for the others.
        uncovered: share of the corners that no virtual camera sees.
        unfilled: share of the virtual pixels that the car cannot fill.
        corners: how many count: those that the car's cameras see, or that those of every car see.
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
    """A rig that is to share the virtual one, and the corners of boxes that its cameras see, and that count."""

    def __init__(self, rig: Rig, corners_ego: Float, fleet: Sequence[Rig] = ()) -> None:
        """
        Args:
            rig: the real cameras at their calibrated places.
            corners_ego: (b, 8, 3) corners of boxes in the ego frame, metres.
            fleet: corners count only where these rigs see them too.

        Raises:
            UsageError: no boxes, or none that a camera sees.
        """
        if not len(corners_ego):
            raise UsageError(f"there are no boxes for {rig.name}: the error needs some.")
        if len(rig.cameras) > _MOST_SOURCES:
            raise UsageError(f"{rig.name} has {len(rig.cameras)} cameras; at most {_MOST_SOURCES} are accepted.")
        self.rig = rig
        seen_by = _seen_by(rig, corners_ego)
        if not seen_by.any():
            raise UsageError(f"no camera of {rig.name} sees any of the {len(corners_ego)} boxes.")
        for other in fleet:
            seen_by[_seen_by(other, corners_ego) == 0] = 0
        kept = seen_by.any(axis=1)
        if not kept.any():
            raise UsageError(f"all cars together see none of the {len(corners_ego)} boxes of {rig.name}.")
        corners_ego, self.seen_by = corners_ego[kept], seen_by[kept].reshape(-1)
        centre = corners_ego.mean(axis=1)
        self.boxes = np.column_stack([centre, lengths(corners_ego - centre[:, None]).max(axis=1)])
        self.points = np.ascontiguousarray(corners_ego.reshape(-1, 3))
        self.count = int(np.count_nonzero(self.seen_by))  # corners of kept boxes that do not count have no bits
        self.cam_from_ego = np.array([inverse(camera.ego_from_cam) for camera in rig.cameras])
        pinholes = [camera.lens for camera in rig.cameras if isinstance(camera.lens, Pinhole)]
        self.all_pinholes = len(pinholes) == len(rig.cameras)
        self.packed_lenses, self.packed_normals = _packed(pinholes)

    @cached_property
    def sightings(self) -> list[Sighting]:
        """What each camera sees of the corners that count, for the path without compiled code."""
        sightings = []
        for camera, cam_from_ego in zip(self.rig.cameras, self.cam_from_ego, strict=True):
            whole = sight(self.points, camera.lens, cam_from_ego)
            counts = self.seen_by[whole.points] > 0
            sightings.append(
                replace(
                    whole,
                    points=whole.points[counts],
                    directions_ego=whole.directions_ego[counts],
                    border_sine=whole.border_sine[counts],
                )
            )
        return sightings


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
        possible = all(car.all_pinholes for car in self.cars)
        self.compiled = possible and has_numba() if compiled is None else compiled

    def __call__(self, rig: Rig, depth_limit_m: float) -> Cost:
        """The cost of a virtual rig.

        Raises:
            RigError: a virtual camera below the ground, or D0 below its height.
            GeometryError: a source outside of a virtual camera's half-ball.
        """
        views = virtual_views(rig, depth_limit_m, self.ground_height_m)
        filled = self.filled(views)
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
            for car, share, (error, uncovered, pair_sum, pairs, _) in zip(
                self.cars, shares[:-1], self.corner_sums(views), strict=True
            )
        )
        return Cost(costs, float(1 - shares[-1]), self.penalties)

    def corner_sums(self, views: Sequence[VirtualView]) -> Float:
        """(cars, 5) sums over each car's corners, see `kernel.corner_errors`."""
        if not self.compiled:
            return np.array([_corner_sums(car, views) for car in self.cars])
        from unidrive_cli.optimize import kernel

        packed = _PackedViews(views)
        return np.array(
            [
                kernel.corner_errors(
                    car.boxes,
                    car.points,
                    car.seen_by,
                    *packed.of_sources(car.cam_from_ego),
                    car.packed_lenses,
                    car.packed_normals,
                    packed.from_ego,
                    packed.lenses,
                    packed.normals,
                    packed.grounds,
                    packed.radius_m,
                    (PIXEL_TOLERANCE, BORDER_FLOOR, PARALLAX_FLOOR),
                )
                for car in self.cars
            ]
        )

    def filled(self, views: Sequence[VirtualView]) -> Float:
        """(views, cars + 1) shares of each virtual picture that each car fills, and that all of them do."""
        if not self.compiled:
            return np.array([_filled(self.cars, view) for view in views])
        from unidrive_cli.optimize import kernel

        packed = _PackedViews(views)
        owners = [[index] * len(car.rig.cameras) for index, car in enumerate(self.cars)]
        shares: Float = kernel.filled(
            *GRID,
            packed.of_sources(np.concatenate([car.cam_from_ego for car in self.cars]))[0],
            np.concatenate([car.packed_lenses for car in self.cars]),
            np.concatenate(owners),
            len(self.cars),
            packed.lenses,
            packed.grounds,
            packed.radius_m,
            PIXEL_TOLERANCE,
        )
        return shares


class _PackedViews:
    """Virtual cameras as the kernel takes them."""

    def __init__(self, views: Sequence[VirtualView]) -> None:
        cameras = [view.camera for view in views]
        self.lenses, self.normals = _packed([camera.pinhole for camera in cameras])
        self.from_ego = np.array([inverse(camera.ego_from_cam)[:3] for camera in cameras])
        self.radius_m = views[0].half_ball.radius_m
        self._ego_from = np.array([camera.ego_from_cam for camera in cameras])
        grounds = [view.half_ball.ground for view in views]
        self.grounds = np.array(
            [
                [*(ground.normal @ camera.ego_from_cam[:3, :3]), float(ground.height_m(camera.centre_ego))]
                for ground, camera in zip(grounds, cameras, strict=True)
            ]
        )

    def of_sources(self, cam_from_ego: Float) -> tuple[Float, Float]:
        """Poses (K, J, 3, 4) from the views into sources (J, 4, 4), and the sources' centres (K, J, 3)."""
        source_from_view = np.ascontiguousarray((cam_from_ego[None] @ self._ego_from[:, None])[:, :, :3])
        centres = -np.einsum("vsji,vsj->vsi", source_from_view[..., :3], source_from_view[..., 3])
        return source_from_view, centres


def _seen_by(rig: Rig, corners_ego: Float) -> npt.NDArray[np.uint64]:
    """(b, 8) uint64: a bit for each camera that sees the corner."""
    bits = np.zeros(corners_ego.shape[:2], dtype=np.uint64)
    flat = bits.reshape(-1)
    for index, camera in enumerate(rig.cameras):
        seen = sight(corners_ego.reshape(-1, 3), camera.lens, inverse(camera.ego_from_cam))
        flat[seen.points] |= np.uint64(1 << index)
    return bits


def _packed(lenses: Sequence[Pinhole]) -> tuple[Float, Float]:
    """Lenses (n, 6) and unit normals (n, 4, 3) of their border planes, as the kernel takes them."""
    numbers = [[lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.width_px, lens.height_px] for lens in lenses]
    return np.array(numbers, dtype=np.float64), np.array([lens.border_normals() for lens in lenses])


def _corner_sums(car: Car, views: Sequence[VirtualView]) -> Float:
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
