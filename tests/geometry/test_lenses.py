"""The pinhole against closed forms, and its border angle against the picture's border walked in small steps."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.geometry.strategies import lenses, reals, vectors
from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.lenses import MAX_SIDE_PX, PIXEL_TOLERANCE, Pinhole

share = reals(0.0, 1.0)


def place(lens: Pinhole, across: float, down: float) -> np.ndarray:
    """The pixel at these shares of the picture, 0 and 1 being its borders."""
    return np.array([across * lens.width_px - 0.5, down * lens.height_px - 0.5])


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle in radians between vectors (..., 3)."""
    cosine = np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    return np.arccos(np.clip(cosine, -1, 1))


# --- there and back ----------------------------------------------------------------------------------


@given(lenses(), share, share, reals(0.01, 1000.0))
def test_project_undoes_unproject_all_over_the_picture(lens: Pinhole, across: float, down: float, d: float) -> None:
    pixel = place(lens, across, down)
    ray = lens.unproject(pixel)
    assert np.linalg.norm(ray) == pytest.approx(1.0, abs=1e-12)
    back, inside = lens.project(ray * d)
    np.testing.assert_allclose(back, pixel, atol=1e-8)
    assert inside


@given(lenses(), vectors(3, 10.0).filter(lambda p: p[2] > 0.01))
def test_unproject_gives_the_direction_that_was_projected(lens: Pinhole, point: np.ndarray) -> None:
    pixel, _ = lens.project(point)
    np.testing.assert_allclose(lens.unproject(pixel), point / np.linalg.norm(point), atol=1e-10)


def test_projection_by_hand() -> None:
    lens = Pinhole(1000.0, 500.0, 799.5, 449.5, 1600, 900)
    points = np.array([[[1.0, 2.0, 10.0], [-1.0, -2.0, 10.0]], [[0.0, 0.0, 5.0], [4.0, 0.0, 2.0]]])
    pixels, inside = lens.project(points)
    np.testing.assert_allclose(pixels, [[[899.5, 549.5], [699.5, 349.5]], [[799.5, 449.5], [2799.5, 449.5]]])
    np.testing.assert_array_equal(inside, [[True, True], [True, False]])
    np.testing.assert_array_equal(lens.matrix, [[1000, 0, 799.5], [0, 500, 449.5], [0, 0, 1]])


@given(lenses(), share, share)
def test_a_point_behind_is_never_inside_though_its_mirror_image_is(
    lens: Pinhole, across: float, down: float
) -> None:
    ray = lens.unproject(place(lens, across, down))
    assert lens.project(ray)[1]
    assert not lens.project(-ray)[1]
    assert not lens.project(ray * [1, 1, 0])[1]


# --- what the picture covers -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pixel", "inside"),
    [
        ((-0.5, -0.5), True),  # the outer corner of the first pixel, not its centre
        ((1599.5, 899.5), True),
        ((-0.5 - PIXEL_TOLERANCE / 2, 0), True),  # rounding is forgiven
        ((-0.5 - 2 * PIXEL_TOLERANCE, 0), False),
        ((1599.5 + 2 * PIXEL_TOLERANCE, 0), False),
        ((0, -0.5 - 2 * PIXEL_TOLERANCE), False),
        ((0, 899.5 + 2 * PIXEL_TOLERANCE), False),
        ((0, 899.5 + PIXEL_TOLERANCE / 2), True),
    ],
)
def test_the_picture_covers_half_a_pixel_round_the_outer_centres(pixel: tuple, inside: bool) -> None:
    lens = Pinhole(1000.0, 1000.0, 799.5, 449.5, 1600, 900)
    assert lens.contains(np.array(pixel, dtype=np.float64)) == inside
    assert lens.project(lens.unproject(np.array(pixel)) * 8.0)[1] == inside


# --- field of view -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hfov", "focal"), [(90, 800.0), (60, 800 * np.sqrt(3)), (120, 800 / np.sqrt(3)), (45, 800 * (1 + np.sqrt(2)))]
)
def test_from_hfov_in_closed_form(hfov: float, focal: float) -> None:
    lens = Pinhole.from_hfov(hfov, 1600, 900)
    assert (lens.fx_px, lens.fy_px) == (pytest.approx(focal, rel=1e-14), pytest.approx(focal, rel=1e-14))
    assert (lens.cx_px, lens.cy_px) == (799.5, 449.5)


@given(reals(0.5, 179.5), st.integers(1, 5000), st.integers(1, 5000))
def test_rays_at_the_side_borders_are_half_the_field_off_the_axis(hfov: float, width: int, height: int) -> None:
    lens = Pinhole.from_hfov(hfov, width, height)
    left, right = lens.unproject(np.array([[-0.5, (height - 1) / 2], [width - 0.5, (height - 1) / 2]]))
    half = np.deg2rad(hfov) / 2
    np.testing.assert_allclose(left, [-np.sin(half), 0, np.cos(half)], atol=1e-12)
    np.testing.assert_allclose(right, [np.sin(half), 0, np.cos(half)], atol=1e-12)
    assert lens.hfov_deg == pytest.approx(hfov, rel=1e-10)
    assert np.tan(np.deg2rad(lens.vfov_deg) / 2) == pytest.approx(np.tan(half) * height / width, rel=1e-9)


def test_the_field_of_an_off_centre_camera_is_the_sum_of_both_sides() -> None:
    """The axis through the left border: nothing to its left, atan(W / f) = 45 degrees to its right."""
    lens = Pinhole(200.0, 100.0, -0.5, 49.5, 200, 100)
    assert lens.hfov_deg == pytest.approx(45.0)
    assert lens.vfov_deg == pytest.approx(2 * np.rad2deg(np.arctan(0.5)))


# --- angle to the border -----------------------------------------------------------------------------

ODD_LENS = Pinhole(700.0, 760.0, 400.0, 560.0, 900, 1000)


@given(lenses(), share, st.sampled_from(["left", "right", "top", "bottom"]))
def test_border_sine_is_zero_on_the_border(lens: Pinhole, along: float, side: str) -> None:
    across, down = {"left": (0, along), "right": (1, along), "top": (along, 0), "bottom": (along, 1)}[side]
    assert lens.border_sine(lens.unproject(place(lens, across, down))) == pytest.approx(0.0, abs=1e-12)


@given(lenses(), vectors(3, 10.0).filter(lambda p: abs(p[2]) > 0.01))
def test_border_sine_is_positive_inside_and_negative_outside(lens: Pinhole, point: np.ndarray) -> None:
    sine, inside = float(lens.border_sine(point)), bool(lens.project(point)[1])
    assert abs(sine) <= 1
    if abs(sine) > 1e-6:  # farther from the border than PIXEL_TOLERANCE reaches
        assert (sine > 0) == inside


@pytest.mark.parametrize("u", [0.0, 10.0, 150.0, 300.0, 449.5, 600.0, 899.0])
def test_border_sine_on_the_middle_row_is_the_angle_between_two_rays(u: float) -> None:
    """In a tall picture the nearest border of the middle row is its own left or right end."""
    lens = Pinhole(700.0, 700.0, 449.5, 1999.5, 900, 4000)
    ray, left, right = lens.unproject(np.array([[u, 1999.5], [-0.5, 1999.5], [899.5, 1999.5]]))
    assert lens.border_sine(ray) == pytest.approx(np.sin(min(angle(ray, left), angle(ray, right))), abs=1e-12)


@settings(max_examples=25)
@given(reals(0.02, 0.98), reals(0.02, 0.98), reals(0.1, 100.0))
def test_border_sine_is_the_smallest_angle_to_any_border_pixel(across: float, down: float, distance: float) -> None:
    """Found by walking round the border in steps of 0.05 pixel: no plane, no normal, only arccos."""
    steps = np.linspace(0, 1, 20001)[:, None]
    corners = np.array([place(ODD_LENS, *corner) for corner in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))])
    border = np.concatenate([a + steps * (b - a) for a, b in pairwise(corners)])
    ray = ODD_LENS.unproject(place(ODD_LENS, across, down))
    nearest = angle(ODD_LENS.unproject(border), ray).min()
    assert ODD_LENS.border_sine(ray * distance) == pytest.approx(np.sin(nearest), abs=1e-6)


def test_border_sine_of_the_camera_centre_is_a_number() -> None:
    assert ODD_LENS.border_sine(np.zeros(3)) == 0.0


# --- birth -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hfov", [0, 180, -5, 181, np.nan, np.inf])
def test_from_hfov_refuses_what_is_no_field_of_view(hfov: float) -> None:
    with pytest.raises(GeometryError, match=r"inside \(0, 180\)"):
        Pinhole.from_hfov(hfov, 1600, 900)


@pytest.mark.parametrize(
    ("numbers", "sentence"),
    [
        ((0.0, 1.0, 1.0, 1.0, 10, 10), "positive"),
        ((1.0, -1.0, 1.0, 1.0, 10, 10), "positive"),
        ((np.nan, 1.0, 1.0, 1.0, 10, 10), "finite"),
        ((1.0, 1.0, np.inf, 1.0, 10, 10), "finite"),
        ((1.0, 1.0, 1.0, 1.0, 0, 10), "width .* got 0"),
        ((1.0, 1.0, 1.0, 1.0, 10, -1), "height .* got -1"),
        ((1.0, 1.0, 1.0, 1.0, 10.0, 10), "width .* whole number"),
        ((1.0, 1.0, 1.0, 1.0, True, 10), "width .* whole number"),
        ((1.0, 1.0, 1.0, 1.0, 10, MAX_SIDE_PX + 1), "height .* 32766"),
    ],
)
def test_what_is_no_pinhole_is_refused(numbers: tuple, sentence: str) -> None:
    with pytest.raises(GeometryError, match=sentence):
        Pinhole(*numbers)


def test_from_matrix_reads_nuscenes_intrinsics() -> None:
    lens = Pinhole.from_matrix([[1266.4, 0, 816.3], [0, 1265.9, 491.5], [0, 0, 1]], 1600, 900)
    assert lens == Pinhole(1266.4, 1265.9, 816.3, 491.5, 1600, 900)


@pytest.mark.parametrize(
    ("matrix", "sentence"),
    [
        ([[1266, 3, 816], [0, 1266, 491], [0, 0, 1]], "must be"),
        ([[1266, 0, 816], [0, 1266, 491], [0, 0, 2]], "must be"),
        ([[1266, 0, 0], [0, 1266, 0], [816, 491, 1]], "must be"),  # transposed
        ([[1266, 0, 816], [0, 1266, np.nan], [0, 0, 1]], "finite"),
        ([[1266, 0, 816], [0, 1266, 491]], "shape 3x3, got 2x3"),
        ([], "shape 3x3"),
        ([[1, 2, 3], [4, 5], [6]], "array of numbers"),
    ],
)
def test_what_is_no_camera_matrix_is_refused(matrix: list, sentence: str) -> None:
    with pytest.raises(GeometryError, match=f"camera_intrinsic.*{sentence}"):
        Pinhole.from_matrix(matrix, 1600, 900)


def test_a_lens_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        ODD_LENS.fx_px = 1.0  # type: ignore[misc]
