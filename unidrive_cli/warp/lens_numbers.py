"""What the fused kernel knows of a lens: its limits, its numbers, and how far from the border its pixels are."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import PIXEL_TOLERANCE, DistortedLens, FisheyeLens, Lens, OpenCVLens, Pinhole
from unidrive_cli.geometry.lenses.border import border_curves, chords_to_border
from unidrive_cli.warp import fused

Single = npt.NDArray[np.float32]

FLOAT32_PX = 0.02
"""A lens whose pixels single precision misses by more is worked out in float64, pixel by pixel."""
_SIDE = 512
_SLACK = 2e-3
_SHARE_STEP_PX = 16
_MOST_SHARE_POINTS = 256
_PAST_CORNERS = 0.1
_WIDEST_PYRAMID_RAD = np.radians(85)


@dataclass(frozen=True, eq=False)
class LensNumbers:
    """One lens.

    Attributes:
        forms: (ASIDE, 3) rows of a source's model as forms of a point in its frame, see `fused.LIMITS`.
        row: (LENS_COLUMNS,) see `fused.KIND`.
        borders: (rows, columns, 4) float32 sines to the sides of the picture, of points all over the field.
    """

    forms: Float
    row: Float
    borders: Single


@functools.lru_cache(maxsize=256)
def lens_numbers(lens: Lens) -> LensNumbers:
    """The numbers of a lens.

    Raises:
        TypeError: the kernel knows no such lens.
    """
    if isinstance(lens, Pinhole):
        return LensNumbers(_pinhole_forms(lens), np.zeros(fused.LENS_COLUMNS), np.empty((0, 0, 4), np.float32))
    if isinstance(lens, DistortedLens):
        return _of_distorted(lens)
    raise TypeError(f"the fused kernel knows no lens {lens.model}")


@functools.lru_cache(maxsize=64)
def numbers_of_all(lenses: tuple[Lens, ...]) -> tuple[Float, Single]:
    """The rows (n, LENS_COLUMNS) of several lenses, and the sines to all their borders one after the other."""
    rows, borders, start = np.zeros((len(lenses), fused.LENS_COLUMNS)), [np.zeros(1, np.float32)], 1
    for row, lens in zip(rows, lenses, strict=True):
        numbers = lens_numbers(lens)
        row[:] = numbers.row
        row[fused.SHARES] = start
        borders.append(numbers.borders.ravel())
        start += numbers.borders.size
    return rows, np.concatenate(borders)


def _pinhole_forms(lens: Pinhole) -> Float:
    u, v, depth = lens.matrix
    low = 0.5 + PIXEL_TOLERANCE
    right, bottom = lens.width_px - 0.5 + PIXEL_TOLERANCE, lens.height_px - 0.5 + PIXEL_TOLERANCE
    limits = u + low * depth, right * depth - u, v + low * depth, bottom * depth - v, depth
    chroma = 0.5 * u - 0.25 * depth, 0.5 * v - 0.25 * depth, depth
    return np.array([*limits, u, v, depth, *chroma, *lens.border_normals(), *np.eye(3)])


def _of_distorted(lens: DistortedLens) -> LensNumbers:
    rays = _border_rays(lens)
    is_fisheye = isinstance(lens, FisheyeLens)
    limit_square = np.tan(lens.limit_rad / 2 if is_fisheye else lens.limit_rad) ** 2
    seen_square = limit_square if np.isnan(rays).any() else float(_radius_squares(rays, is_fisheye).max())
    seen_square *= 1 + _SLACK
    ends_inside = seen_square >= limit_square * (1 - _SLACK)
    row = np.zeros(fused.LENS_COLUMNS)
    row[fused.KIND] = fused.FISHEYE if is_fisheye else fused.OPENCV
    row[fused.FOCAL : fused.FOCAL + 2] = lens.fx_px, lens.fy_px
    row[fused.CENTRE : fused.CENTRE + 2] = lens.cx_px, lens.cy_px
    row[fused.LOW] = -0.5 - PIXEL_TOLERANCE
    row[fused.HIGH : fused.HIGH + 2] = np.array([lens.width_px, lens.height_px]) - 0.5 + PIXEL_TOLERANCE
    row[fused.LIMIT] = lens.limit_rad if is_fisheye else limit_square
    row[fused.INSIDE] = limit_square * (1 - _SLACK) if ends_inside else seen_square
    row[fused.BEYOND] = limit_square * (1 + _SLACK) if ends_inside else seen_square
    terms = lens.coefficients[:12]
    row[fused.TERMS : fused.TERMS + len(terms)] = terms
    if isinstance(lens, OpenCVLens) and lens.tilt is not None:
        row[fused.TILT :] = lens.tilt.ravel()
    if is_fisheye:
        row[fused.SERIES_SCALE] = 2 / row[fused.BEYOND]
        row[fused.SERIES : fused.SERIES + fused.SERIES_TERMS] = _series(lens, row[fused.BEYOND])
    radius = float(np.sqrt(row[fused.BEYOND]))
    borders, grid = _border_sines(lens, radius if is_fisheye else np.tan(np.arctan(radius) / 2))
    rim = np.sin(lens.limit_rad), np.cos(lens.limit_rad)
    row[fused.SHARES + 1 : fused.TILT] = *borders.shape[1::-1], *grid, *rim
    row[fused.EXACT] = not _fits_single_precision(lens, row)
    forms = np.zeros((fused.ASIDE, 3))
    forms[fused.LIMITS : fused.LIMITS + 5] = _limits(lens, rays)
    forms[fused.POINT : fused.POINT + 3] = np.eye(3)
    return LensNumbers(forms, row, borders)


def _border_rays(lens: DistortedLens) -> Float:
    """Rays (n, 3) of the picture's border; NaN where it lies beyond the model's field."""
    across = np.linspace(-0.5, lens.width_px - 0.5, _SIDE + 1)
    down = np.linspace(-0.5, lens.height_px - 0.5, _SIDE + 1)
    sides = [np.stack([across, np.full_like(across, at)], axis=-1) for at in (down[0], down[-1])]
    sides += [np.stack([np.full_like(down, at), down], axis=-1) for at in (across[0], across[-1])]
    return lens.unproject(np.concatenate(sides))


def _radius_squares(rays: Float, is_fisheye: bool) -> Float:
    """Squares (n,) of the radius in the stereographic or in the central projection."""
    x, y, z = rays.T
    squares: Float = (x * x + y * y) / np.square(z + 1 if is_fisheye else z)
    return squares


def _limits(lens: DistortedLens, rays: Float) -> Float:
    """Five planes (5, 3) through the centre that everything seen lies within; zeros where there is none."""
    planes = np.zeros((5, 3))
    off_axis = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    widest = lens.limit_rad if np.isnan(rays).any() else float(off_axis.max())
    if widest < _WIDEST_PYRAMID_RAD:
        whole = rays[np.isfinite(rays[:, 0])]
        reach = np.full(4, np.tan(widest))
        if len(whole) == len(rays):
            x, y = whole[:, 0] / whole[:, 2], whole[:, 1] / whole[:, 2]
            reach = np.array([-x.min(), x.max(), -y.min(), y.max()])
        reach = reach + _SLACK * (1 + np.abs(reach))
        planes[:4] = [[1, 0, reach[0]], [-1, 0, reach[1]], [0, 1, reach[2]], [0, -1, reach[3]]]
    if widest < np.pi / 2 or isinstance(lens, OpenCVLens):
        planes[4] = [0, 0, 1]
    return planes


def _series(lens: DistortedLens, square: float) -> Float:
    """Ascending coefficients (SERIES_TERMS,) of theta_d / tan(theta / 2) in 2 tan(theta / 2)^2 / square - 1."""
    nodes = np.cos(np.pi * (np.arange(256) + 0.5) / 256)
    radius = np.sqrt((nodes + 1) / 2 * square)
    values = np.array([lens.radius_at(angle) for angle in 2 * np.arctan(radius)]) / radius
    degrees = np.arange(fused.SERIES_TERMS)
    terms = np.cos(degrees[:, None] * np.arccos(nodes)) @ values * (2 / len(nodes))  # in Chebyshev's polynomials
    terms[0] /= 2
    chebyshev = np.zeros((fused.SERIES_TERMS, fused.SERIES_TERMS))
    chebyshev[0, 0] = chebyshev[1, 1] = 1
    for degree in degrees[2:]:
        chebyshev[degree, 1:] = 2 * chebyshev[degree - 1, :-1]
        chebyshev[degree] -= chebyshev[degree - 2]
    series: Float = terms @ chebyshev
    return series


def _fits_single_precision(lens: DistortedLens, row: Float) -> bool:
    """Whether the kernel's arithmetic places rays all over the picture where the lens does."""
    u, v = (np.linspace(-0.5, side - 0.5, 97) for side in (lens.width_px, lens.height_px))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = lens.unproject(pixels)
    known = np.isfinite(rays[:, 0])
    placed = np.empty((int(known.sum()), 2), np.float32)
    fused.place_points(rays[known].astype(np.float32), row[None], 0, placed)
    return bool(np.abs(placed - pixels[known]).max() <= FLOAT32_PX)


def _border_sines(lens: DistortedLens, seen_radius: float) -> tuple[Single, Float]:
    """Sines to the sides of the picture, negative beyond them, on a grid of the stereographic plane.

    The sides go on beyond the picture's corners, so that the sines are smooth there.

    Args:
        seen_radius: of what is in the picture, in that plane.

    Returns:
        (rows, columns, 4) sines to the left, right, upper and lower side; and the grid's first a and b, and how
        many points there are to a unit.
    """
    step = _SHARE_STEP_PX / (2 * min(lens.fx_px, lens.fy_px))
    step = max(step, 2 * seen_radius / _MOST_SHARE_POINTS)
    count = int(np.ceil(2 * seen_radius / step)) + 3
    places = (np.arange(count) - (count - 1) / 2) * step
    a, b = np.meshgrid(places, places)
    square = a * a + b * b
    rays = np.stack([2 * a, 2 * b, 1 - square], axis=-1) / (1 + square)[..., None]
    off_axis = np.minimum(np.arctan2(np.hypot(a, b) * 2, 1 - square), lens.limit_rad * (1 - 1e-6))
    azimuth = np.arctan2(b, a)
    within = np.stack(
        [np.sin(off_axis) * np.cos(azimuth), np.sin(off_axis) * np.sin(azimuth), np.cos(off_axis)], axis=-1
    )
    pixels = lens.project(within)[0]
    width, height = lens.width_px, lens.height_px
    u, v = pixels[..., 0] + 0.5, pixels[..., 1] + 0.5
    sines = np.empty((count, count, 4), np.float32)
    for side, beside in enumerate((u, width - u, v, height - v)):
        upright, far = side < 2, side % 2
        ends = np.array([[-0.5, -0.5], [-0.5, height - 0.5]] if upright else [[-0.5, -0.5], [width - 0.5, -0.5]])
        ends[:, 0 if upright else 1] += far * (width if upright else height)
        along = (ends[1] - ends[0]) * (1 + 2 * _PAST_CORNERS)
        start = ends[0] - (ends[1] - ends[0]) * _PAST_CORNERS
        curves = list(
            border_curves(
                functools.partial(_line, lens, start, along), functools.partial(_has_rays, lens, start, along)
            )
        )
        if not curves:
            sines[..., side] = 1
            continue
        half = np.minimum(chords_to_border(curves, rays.reshape(-1, 3)).reshape(a.shape) / 2, np.sqrt(0.5))
        sines[..., side] = np.copysign(2 * half * np.sqrt(1 - half**2), beside)
    return sines, np.array([places[0], places[0], 1 / step])


def _line(lens: DistortedLens, start: Float, along: Float, place: Float) -> Float:
    """Rays (n, 3) at places (n,) of a line in the picture."""
    return lens.unproject(start + place[:, None] * along)


def _has_rays(lens: DistortedLens, start: Float, along: Float, place: Float) -> Bool:
    finite: Bool = np.isfinite(_line(lens, start, along, place)[:, 0])
    return finite
