"""The virtual projection error of points (UniDrive section 3.3, eqs. 5 and 6), in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.arrays import Float, lengths
from unidrive_cli.geometry.blending import angular_weights
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.geometry.poses import inverse, transform
from unidrive_cli.geometry.scene import HalfBall

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Sighting:
    """What one source camera sees of a set of points.

    Attributes:
        lens: of the source.
        cam_from_ego: (4, 4), or (n, 4, 4) one for each of the n points, from the virtual pictures' ego frame
            into the source, the motion between the two moments included.
        centre_ego: (3,) or (n, 3) optical centre, metres.
        points: (m,) indices of the points it sees, ascending.
        directions_ego: (m, 3) unit vectors from the centre to them.
        border_sine: (m,) sine of the angle from those rays to the picture's border.
    """

    lens: Lens
    cam_from_ego: Float
    centre_ego: Float
    points: Indices
    directions_ego: Float
    border_sine: Float

    def stand(self, points: Indices) -> tuple[Float, Float]:
        """`cam_from_ego` and `centre_ego` for points (m,) of the n: one of each, or m."""
        if self.cam_from_ego.ndim == 2:
            return self.cam_from_ego, self.centre_ego
        return self.cam_from_ego[points], self.centre_ego[points]


@dataclass(frozen=True, eq=False)
class PointErrors:
    """Errors of one virtual camera: one entry for each (point, source) that sees what the virtual camera sees.

    Attributes:
        seen: (k,) indices of the points that the virtual camera and at least one source see, ascending.
        point, source: (m,) indices; entries are in the order of the sources, then of the points.
        error_m_rad: (m,) UniDrive's D (|theta - theta'| + |phi - phi'|), metre-radians.
        share: (m,) the source's normalised blending weight at the pixel where the warp puts the point.
        distance_m: (m,) D, from the virtual camera to the point.
        behind: entries left out, because the warp puts their points behind the virtual camera.
    """

    seen: Indices
    point: Indices
    source: Indices
    error_m_rad: Float
    share: Float
    distance_m: Float
    behind: int

    def blended(self) -> tuple[Indices, Float]:
        """Points (b,), ascending, and the mean (b,) of each one's errors by the sources' shares, metre-radians."""
        points, place = np.unique(self.point, return_inverse=True)
        total = np.bincount(place, self.share, len(points))
        errors: Float = np.bincount(place, self.share * self.error_m_rad, len(points)) / total
        return points, errors


def sight(points_ego: Float, lens: Lens, cam_from_ego: Float) -> Sighting:
    """What a source camera sees of points (n, 3) of the virtual pictures' ego frame, metres.

    Args:
        cam_from_ego: (4, 4); or (n, 4, 4) where the points are of several moments, in each of which the
            source stands elsewhere.
    """
    points_cam = transform(cam_from_ego, points_ego)
    seen = np.flatnonzero(lens.project(points_cam)[1])
    centre: Float = -np.einsum("...ji,...j->...i", cam_from_ego[..., :3, :3], cam_from_ego[..., :3, 3])
    rays = points_ego[seen] - (centre if centre.ndim == 1 else centre[seen])
    rays /= lengths(rays)[:, None]
    return Sighting(lens, cam_from_ego, centre, seen, rays, lens.border_sine(points_cam[seen]))


def point_errors(
    points_ego: Float, sightings: Sequence[Sighting], lens: Pinhole, ego_from_cam: Float, half_ball: HalfBall
) -> PointErrors:
    """The error of each (point, source) pair in one virtual camera.

    Where the warp puts a point: the source's ray through it meets the half-ball's boundary, and that scene
    point is what the virtual picture shows there. No map is inverted.

    Args:
        points_ego: (n, 3) points, such as box corners, metres.
        sightings: of the sources, made from the same points.
        lens, ego_from_cam: the virtual camera.
        half_ball: the scene surface that its pixels are assumed to show.

    Raises:
        GeometryError: a source stands outside of the half-ball, so its rays have no single scene point.
    """
    cam_from_ego, centre = inverse(ego_from_cam), half_ball.centre_ego
    points_cam = transform(cam_from_ego, points_ego)
    in_view = lens.project(points_cam)[1]
    seen_by_source = np.zeros(len(points_ego), dtype=bool)
    parts: list[tuple[Indices, Indices, Float, Float]] = []
    behind = 0
    for index, sighting in enumerate(sightings):
        shown = np.flatnonzero(in_view[sighting.points])
        point = sighting.points[shown]
        source_ego = sighting.stand(point)[1]
        if not half_ball.contains(source_ego).all():
            raise GeometryError(
                f"source {index} stands outside of the virtual camera's half-ball (radius {half_ball.radius_m:g} m)."
            )
        seen_by_source[point] = True
        scene_points = half_ball.surface_points(source_ego, sighting.directions_ego[shown])
        warped = transform(cam_from_ego, scene_points)
        ahead = warped[:, 2] > 0
        if not ahead.all():
            behind += int(np.count_nonzero(~ahead))
            shown, point, scene_points, warped = shown[ahead], point[ahead], scene_points[ahead], warped[ahead]
        true = points_cam[point]
        share = _shares(sightings, index, point, sighting.border_sine[shown], scene_points, centre)
        parts.append((point, np.full(len(point), index), _angle_between(warped, true), share))
    point, source, angles, share = (np.concatenate(part) for part in zip(*parts, strict=True))
    distance = lengths(points_cam[point])
    return PointErrors(np.flatnonzero(seen_by_source), point, source, distance * angles, share, distance, behind)


def _angle_between(warped_cam: Float, true_cam: Float) -> Float:
    """|theta - theta'| + |phi - phi'| (m,) of points (m, 3) in front of a camera, radians.

    Of each pair of tangents one arc is taken: that of their difference, exact where both nearly agree.
    """
    a, b = warped_cam[:, :2] / warped_cam[:, 2:], true_cam[:, :2] / true_cam[:, 2:]
    angles: Float = np.arctan2(np.abs(a - b), 1 + a * b).sum(axis=1)
    return angles


def _shares(
    sightings: Sequence[Sighting],
    own: int,
    points: Indices,
    own_border_sine: Float,
    scene_points_ego: Float,
    centre_ego: Float,
) -> Float:
    """Normalised weights (m,) of one source at the scene points (m, 3) that its rays through `points` (m,) meet."""
    to_virtual = scene_points_ego - centre_ego
    to_virtual /= lengths(to_virtual)[:, None]

    def weight(source_ego: Float, border_sine: Float, at: Indices | slice) -> Float:
        to_source = scene_points_ego[at] - source_ego
        to_source /= lengths(to_source)[:, None]
        return angular_weights(border_sine, lengths(to_source - to_virtual[at]))

    mine = weight(sightings[own].stand(points)[1], own_border_sine, slice(None))
    total = mine.copy()
    for index, other in enumerate(sightings):
        if index == own:
            continue
        points_cam = transform(other.stand(points)[0], scene_points_ego)
        at = np.flatnonzero(other.lens.project(points_cam)[1])
        total[at] += weight(other.stand(points[at])[1], other.lens.border_sine(points_cam[at]), at)
    share: Float = mine / total
    return share
