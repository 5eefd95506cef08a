"""Lenses with distortion: against OpenCV's own projection, there and back, and what folds back is not seen."""

from __future__ import annotations

import dataclasses
import math
import pickle
from collections.abc import Callable
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from tests.geometry.strategies import lenses, reals, vectors
from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.lenses import FisheyeLens, Lens, OpenCVLens, Pinhole, lens_of

WIDE = Pinhole.from_hfov(90.0, 1600, 900)
ODD = Pinhole(500.0, 470.0, 640.0, 300.0, 1200, 700)
SMALL_CIRCLE = Pinhole(250.0, 260.0, 790.0, 440.0, 1600, 900)

STRONG: dict[str, Lens] = {
    "barrel": lens_of(WIDE, "opencv", [-0.2, 0.05, 0, 0]),
    "barrel that ends in the picture": lens_of(WIDE, "opencv", [-0.4, 0, 0, 0]),
    "real": lens_of(WIDE, "opencv", [-0.31, 0.12, 4e-4, -2e-4, -0.02]),
    "decentred, ends in the picture": lens_of(ODD, "opencv", [-0.4, 0.0, 0.01, -0.02]),
    "wide and decentred, ends in the picture": lens_of(WIDE, "opencv", [-0.4, 0.0, 0.01, -0.02]),
    "pincushion": lens_of(ODD, "opencv", [0.3, 0.1, 1e-3, 2e-3, 0.05]),
    "rational": lens_of(WIDE, "opencv", [0.5, 0.2, 1e-4, 1e-4, 0.01, 0.8, 0.3, 0.02]),
    "pole": lens_of(WIDE, "opencv", [0.1, 0, 0, 0, 0, -0.9, 0, 0]),
    "prism": lens_of(ODD, "opencv", [-0.2, 0.05, 1e-3, -1e-3, 0.01, 0, 0, 0, 0.01, -0.002, 0.005, 0.001]),
    "tilted": lens_of(WIDE, "opencv", [-0.2, 0.05, 1e-3, -1e-3, 0, 0, 0, 0, 0, 0, 0, 0, 0.05, -0.08]),
    "tilted by much": lens_of(ODD, "opencv", [0.0] * 12 + [-0.5, 0.3]),
    "fisheye of 117 degrees": lens_of(WIDE, "fisheye", [-0.02, 0.003, -0.001, 1e-4]),
    "fisheye of 177 degrees": lens_of(
        Pinhole(480, 480, 799.5, 449.5, 1600, 900), "fisheye", [0.05, -0.01, 2e-3, -3e-4]
    ),
    "fisheye, equidistant, of 229 degrees": lens_of(
        Pinhole(400, 400, 799.5, 449.5, 1600, 900), "fisheye", [0, 0, 0, 0]
    ),
    "fisheye, a whole circle": lens_of(SMALL_CIRCLE, "fisheye", [-0.03, -0.004, 0, 0]),
    "fisheye of everything": lens_of(Pinhole(100, 100, 399.5, 399.5, 800, 800), "fisheye", [0, 0, 0, 0]),
}
BLANK_CORNERS = {
    STRONG[name]
    for name in (
        "barrel that ends in the picture",
        "real",
        "decentred, ends in the picture",
        "wide and decentred, ends in the picture",
        "fisheye, a whole circle",
        "fisheye of everything",
    )
}
each_lens = pytest.mark.parametrize("lens", STRONG.values(), ids=STRONG)


def by_opencv(lens: Lens, points_cam: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) as cv2 projects points (n, 3) that lie ahead."""
    project = cv2.fisheye.projectPoints if lens.model == "fisheye" else cv2.projectPoints
    nothing = np.zeros(3)
    pixels, _ = project(points_cam[:, None], nothing, nothing, lens.matrix, np.array(lens.coefficients))
    return pixels[:, 0]


def unit(vectors_: np.ndarray) -> np.ndarray:
    return vectors_ / np.linalg.norm(vectors_, axis=-1, keepdims=True)


def off_axis(rays: np.ndarray) -> np.ndarray:
    return np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])


def every_pixel(lens: Lens, step: int = 7) -> np.ndarray:
    """Every `step`-th pixel, the outer borders included."""
    u = np.append(np.arange(-0.5, lens.width_px - 0.5, step), lens.width_px - 0.5)
    v = np.append(np.arange(-0.5, lens.height_px - 0.5, step), lens.height_px - 0.5)
    return np.stack(np.meshgrid(u, v), axis=-1)


def everywhere(count: int, seed: int = 0) -> np.ndarray:
    """Unit rays (n, 3) all round, half of them within a radian or so of the axis."""
    random = np.random.default_rng(seed)
    rays = random.normal(size=(count, 3))
    rays[::2] += [0, 0, 2.5]
    return unit(rays)


def is_centred(lens: Pinhole) -> bool:
    return bool(lens.contains(np.array([lens.cx_px, lens.cy_px])))


def made(pinhole: Pinhole, model: str, coefficients: list[float]) -> Lens:
    try:
        return lens_of(pinhole, model, coefficients)
    except GeometryError:  # folds back near the principal point
        reject()


@st.composite
def opencv_lenses(draw: st.DrawFn) -> Lens:
    """Plausible to strong distortion of any pinhole that sees at most 140 degrees."""
    pinhole = draw(lenses().filter(lambda lens: max(lens.hfov_deg, lens.vfov_deg) < 140 and is_centred(lens)))
    k = [draw(reals(-0.3, 0.3)), draw(reals(-0.1, 0.1)), draw(reals(-5e-3, 5e-3)), draw(reals(-5e-3, 5e-3))]
    k += [draw(reals(-0.03, 0.03))]
    k += draw(st.sampled_from([[], [draw(reals(-0.2, 0.2)), draw(reals(-0.05, 0.05)), draw(reals(-0.01, 0.01))]]))
    if len(k) == 8:
        k += draw(st.sampled_from([[], [draw(reals(-5e-3, 5e-3)) for _ in range(4)]]))
    if len(k) == 12:
        k += draw(st.sampled_from([[], [draw(reals(-0.1, 0.1)), draw(reals(-0.1, 0.1))]]))
    return made(pinhole, "opencv", k)


@st.composite
def fisheye_lenses(draw: st.DrawFn) -> Lens:
    pinhole = draw(lenses().filter(is_centred))
    k = [draw(reals(-0.1, 0.1)), draw(reals(-0.02, 0.02)), draw(reals(-5e-3, 5e-3)), draw(reals(-1e-3, 1e-3))]
    return made(pinhole, "fisheye", k)


any_lens = st.one_of(opencv_lenses(), fisheye_lenses())


# --- where points fall -------------------------------------------------------------------------------


@each_lens
def test_project_agrees_with_opencv_wherever_a_point_is_seen(lens: Lens) -> None:
    points = everywhere(20_000) * np.random.default_rng(1).uniform(0.1, 100, (20_000, 1))
    points = points[(points[:, 2] > 0)]
    pixels, inside = lens.project(points)
    assert np.count_nonzero(inside) > 1000
    np.testing.assert_allclose(pixels[inside], by_opencv(lens, points[inside]), atol=1e-7)


@given(any_lens, vectors(3, 10.0).filter(lambda p: p[2] > 0.1))
def test_project_agrees_with_opencv_for_any_lens(lens: Lens, point: np.ndarray) -> None:
    pixel, inside = lens.project(point)
    if np.isfinite(pixel).all():  # in the model's field, though perhaps beside the picture
        np.testing.assert_allclose(pixel, by_opencv(lens, point[None])[0], rtol=1e-9, atol=1e-7)
    else:
        assert not inside


def test_an_equidistant_fisheye_by_hand() -> None:
    """f theta = 400 theta: 60 degrees to the right, 90 down, 100 to the left, and straight behind."""
    lens = STRONG["fisheye, equidistant, of 229 degrees"]
    angles = np.radians([60, 90, 100])
    s, c = np.sin(angles), np.cos(angles)
    points = 5 * np.array([[s[0], 0, c[0]], [0, s[1], c[1]], [-s[2], 0, c[2]], [0, 0, -1]])
    pixels, inside = lens.project(points)
    expected = [[799.5 + 400 * angles[0], 449.5], [799.5, 449.5 + 400 * angles[1]], [799.5 - 400 * angles[2], 449.5]]
    np.testing.assert_allclose(pixels[:3], expected, atol=1e-9)
    np.testing.assert_array_equal(inside, [True, False, True, False])  # 90 degrees down is below the picture
    assert np.isnan(pixels[3]).all()
    assert lens.hfov_deg == pytest.approx(np.degrees(1600 / 400))
    assert lens.vfov_deg == pytest.approx(np.degrees(900 / 400))


@given(lenses().filter(is_centred), vectors(3, 10.0))
def test_no_distortion_is_the_pinhole(pinhole: Pinhole, point: np.ndarray) -> None:
    lens = OpenCVLens(*dataclasses.astuple(pinhole), (0.0,) * 5)
    expected, inside = pinhole.project(point)
    pixel, valid = lens.project(point)
    assert valid == inside
    if inside:
        np.testing.assert_allclose(pixel, expected, rtol=1e-14)
        np.testing.assert_allclose(lens.unproject(pixel), pinhole.unproject(pixel), atol=1e-14)
    assert (lens.hfov_deg, lens.vfov_deg) == (pytest.approx(pinhole.hfov_deg), pytest.approx(pinhole.vfov_deg))
    assert lens_of(pinhole, "opencv", (0.0,) * 8) is pinhole


# --- there and back ----------------------------------------------------------------------------------


@each_lens
def test_every_pixel_has_its_ray_or_none(lens: Lens) -> None:
    """All over the picture, its border included: the ray leads back, is of length 1, and is seen."""
    pixels = every_pixel(lens)
    rays = lens.unproject(pixels)
    has_ray = np.isfinite(rays).all(axis=-1)
    assert has_ray[rays.shape[0] // 2, rays.shape[1] // 2]
    assert np.isnan(rays[~has_ray]).all()
    back, inside = lens.project(rays * 7.0)
    np.testing.assert_array_equal(inside, has_ray)
    np.testing.assert_allclose(back[has_ray], pixels[has_ray], atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(rays[has_ray], axis=-1), 1.0, atol=1e-12)
    assert has_ray.all() == (lens not in BLANK_CORNERS)


@given(any_lens, reals(0.0, 1.0), reals(0.0, 1.0))
def test_project_undoes_unproject(lens: Lens, across: float, down: float) -> None:
    pixel = np.array([across * lens.width_px - 0.5, down * lens.height_px - 0.5])
    ray = lens.unproject(pixel)
    back, inside = lens.project(ray * 3.0)
    assert inside == np.isfinite(ray).all()
    if inside:
        np.testing.assert_allclose(back, pixel, atol=1e-8)


@each_lens
def test_unproject_undoes_project(lens: Lens) -> None:
    """To 1e-10, but for rays so near to the fold that pixels no longer tell them apart."""
    rays = everywhere(20_000)
    pixels, inside = lens.project(rays)
    clear = inside & (off_axis(rays) < lens.limit_rad - 0.01)  # type: ignore[attr-defined]
    np.testing.assert_allclose(lens.unproject(pixels[clear]), rays[clear], atol=1e-10)


def test_shapes() -> None:
    lens = STRONG["real"]
    assert [part.shape for part in lens.project(np.array([0.1, 0.2, 3.0]))] == [(2,), ()]
    assert [part.shape for part in lens.project(np.ones((2, 3, 3)))] == [(2, 3, 2), (2, 3)]
    assert lens.unproject(np.array([3, 4])).shape == (3,)
    assert lens.unproject(np.ones((0, 2))).shape == (0, 3)
    assert lens.border_sine(np.ones((2, 5, 3))).shape == (2, 5)
    assert lens.border_sine(np.ones(3)).shape == ()


# --- where the model ends ----------------------------------------------------------------------------


def test_what_folds_back_is_not_seen() -> None:
    """k1 = -0.4: r (1 - 0.4 r^2) turns at r = sqrt(1 / 1.2) = 0.913, at 0.609 of the half width of 800 pixels.

    Farther out a point falls on the other points' pixels again: OpenCV puts it well inside the picture.
    """
    lens = STRONG["barrel that ends in the picture"]
    turn = math.sqrt(1 / 1.2)
    r = np.array([0.5, turn - 1e-6, turn + 1e-6, 1.0, 1.3, 1.58, 1.7])
    points = np.stack([r, np.zeros_like(r), np.ones_like(r)], axis=-1)
    folded = by_opencv(lens, points)
    assert WIDE.contains(folded).all()
    pixels, inside = lens.project(points)
    np.testing.assert_array_equal(inside, r < turn)
    np.testing.assert_allclose(pixels[inside], folded[inside], atol=1e-9)
    assert np.isnan(pixels[~inside]).all()
    radius = 800 * turn * (1 - 0.4 * turn**2)
    rays = lens.unproject(np.array([[799.5 + radius - 0.01, 449.5], [799.5 + radius + 0.01, 449.5]]))
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1]).all()
    assert lens.hfov_deg == pytest.approx(2 * np.degrees(np.arctan(turn)))


def test_nothing_is_seen_beyond_a_pole() -> None:
    """1 - 0.9 r^2 in the denominator: from r = 1.054 on the picture would be upside down."""
    lens = STRONG["pole"]
    r = np.array([0.3, 0.6, 1.06, 2.0, 5.0, 100.0])
    inside = lens.project(np.stack([r, 0 * r, 1 + 0 * r], axis=-1))[1]
    np.testing.assert_array_equal(inside, [True, True, False, False, False, False])


@each_lens
def test_no_two_rays_share_a_pixel(lens: Lens) -> None:
    """What the picture says of a ray that is seen is that ray."""
    rays = everywhere(50_000, seed=3)
    pixels, inside = lens.project(rays)
    away = np.linalg.norm(lens.unproject(pixels[inside]) - rays[inside], axis=-1)
    assert away.max() < 1e-5


@each_lens
def test_points_behind_an_opencv_lens_and_at_its_centre_are_not_seen(lens: Lens) -> None:
    rays = everywhere(5000)
    if lens.model == "opencv":
        assert not lens.project(rays[rays[:, 2] <= 0])[1].any()
    else:
        sees_behind = bool((lens.unproject(every_pixel(lens))[..., 2] < 0).any())
        assert lens.project(rays[rays[:, 2] <= 0])[1].any() == sees_behind
    assert not lens.project(np.zeros(3))[1]
    assert not lens.project(np.array([0.0, 0.0, -1.0]))[1]


@pytest.mark.filterwarnings("error")
@each_lens
def test_extreme_points_raise_no_warnings(lens: Lens) -> None:
    points = np.array([[1e300, 0, 1e-300], [0, 0, 5e-324], [1e-320, 0, 1], [0, 1, 0], [1e200, 1e200, -1e200]])
    lens.project(points)
    lens.unproject(np.array([[1e9, 0], [lens.cx_px, lens.cy_px], [-1e9, -1e9]]))


# --- angle to the border -----------------------------------------------------------------------------


def border_of(lens: Lens) -> np.ndarray:
    """The border of the field as a crowd of unit rays: the picture's sides, and the fold where it is inside."""
    left, top, right, bottom = -0.5, -0.5, lens.width_px - 0.5, lens.height_px - 0.5
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
    steps = np.linspace(0, 1, 8001)[:, None]
    sides = lens.unproject(np.concatenate([a + steps * (b - a) for a, b in pairwise(corners)]))
    angle, azimuth = lens.limit_rad - 1e-7, np.linspace(0, 2 * np.pi, 8001)  # type: ignore[attr-defined]
    rim = np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.full_like(azimuth, np.cos(angle))], -1
    )
    return np.concatenate([sides[np.isfinite(sides[:, 0])], rim[lens.project(rim)[1]]])


@each_lens
def test_border_sine_is_the_angle_to_the_nearest_border(lens: Lens) -> None:
    """Found by trying a crowd of rays on the border; within 1 %, and 1e-3 where that is nothing."""
    border, rays = border_of(lens), everywhere(400)
    chord = np.array([np.linalg.norm(border - ray, axis=1).min() for ray in rays])
    expected = np.sin(np.minimum(2 * np.arcsin(chord / 2), np.pi / 2))
    found = lens.border_sine(rays * 12.5)
    np.testing.assert_allclose(np.abs(found), expected, rtol=0.01, atol=1e-3)
    np.testing.assert_array_equal(found > 0, lens.project(rays)[1])


@each_lens
def test_border_sine_vanishes_on_the_border(lens: Lens) -> None:
    assert np.abs(lens.border_sine(border_of(lens)[::5])).max() < 2e-4


@given(any_lens, reals(0.0, 1.0), st.sampled_from(["left", "right", "top", "bottom"]))
def test_border_sine_vanishes_on_the_sides_of_any_lens(lens: Lens, along: float, side: str) -> None:
    across, down = {"left": (0, along), "right": (1, along), "top": (along, 0), "bottom": (along, 1)}[side]
    ray = lens.unproject(np.array([across * lens.width_px - 0.5, down * lens.height_px - 0.5]))
    if np.isfinite(ray).all():
        assert abs(lens.border_sine(ray)) < 1e-3


@each_lens
def test_border_sine_is_continuous(lens: Lens) -> None:
    """Along great circles in steps of 0.2 mrad it changes by no more than that, in and out of the field."""
    step, random = 2e-4, np.random.default_rng(2)
    for _ in range(4):
        start, other = unit(random.normal(size=(2, 3)) * 0.6 + [0, 0, 1])
        across = unit(other - (other @ start) * start)
        angles = np.arange(-1.5, 1.5, step)[:, None]
        sine = lens.border_sine(np.cos(angles) * start + np.sin(angles) * across)
        assert np.abs(np.diff(sine)).max() < step + 2e-4


@given(any_lens, vectors(3, 10.0))
@settings(max_examples=50)
def test_the_sign_of_border_sine_is_what_project_says(lens: Lens, point: np.ndarray) -> None:
    sine, inside = float(lens.border_sine(point)), bool(lens.project(point)[1])
    assert abs(sine) <= 1
    assert (sine > 0) == inside or sine == 0


@given(lenses().filter(is_centred), vectors(3, 10.0))
@settings(max_examples=50)
def test_without_distortion_border_sine_inside_is_the_pinholes(pinhole: Pinhole, point: np.ndarray) -> None:
    lens = OpenCVLens(*dataclasses.astuple(pinhole), (0.0,) * 4)
    if pinhole.project(point)[1]:
        assert lens.border_sine(point) == pytest.approx(pinhole.border_sine(point), abs=1e-5)


# --- birth -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "coefficients", "sentence"),
    [
        ("opencv", [0.1, 0, 0], "4, 5, 8, 12, 14 coefficients .* got 3"),
        ("opencv", [0.1] * 6, "got 6"),
        ("opencv", [0.0] * 13, "got 13"),
        ("opencv", [0.0] * 13 + [1.1], r"tilted by at most 1 radian .* got \(0.0, 1.1\)"),
        ("opencv", [0.1, np.nan, 0, 0], "finite"),
        ("opencv", [0.1, "x", 0, 0], "numbers"),
        ("opencv", [-50, 0, 0, 0], r"folds back 4.67 degrees off the axis, 43.5 pixels .* k1 k2 p1 p2"),
        ("opencv", [0, 0, 5.0, 0], "folds back"),
        ("opencv", [0, 0, 1e10, 0], "at most 1e.09, got 1e.10"),
        ("fisheye", [0.1, 0, 0, 0, 0], "4 coefficients .* got 5"),
        ("fisheye", [np.inf, 0, 0, 0], "finite"),
        ("fisheye", [-50, 0, 0, 0], "folds back"),
        ("fish", [0, 0, 0, 0], "opencv or fisheye, got 'fish'. Did you mean fisheye?"),
        ("", [], "opencv or fisheye"),
    ],
)
def test_what_is_no_lens_is_refused(model: str, coefficients: list, sentence: str) -> None:
    with pytest.raises(GeometryError, match=sentence) as caught:
        lens_of(WIDE, model, coefficients)
    assert str(caught.value).endswith((".", "?"))


def test_distortion_needs_its_principal_point_in_the_picture() -> None:
    with pytest.raises(GeometryError, match=r"principal point \(-20, 50\) .* 100x100"):
        lens_of(Pinhole(100.0, 100.0, -20.0, 50.0, 100, 100), "opencv", [0.1, 0, 0, 0])


@pytest.mark.parametrize("make", [OpenCVLens, FisheyeLens])
def test_the_intrinsics_are_checked_as_a_pinholes(make: Callable[..., Lens]) -> None:
    with pytest.raises(GeometryError, match="positive"):
        make(0.0, 1.0, 1.0, 1.0, 10, 10, (0.0,) * 4)
    with pytest.raises(GeometryError, match="whole number"):
        make(1.0, 1.0, 1.0, 1.0, 10.0, 10, (0.0,) * 4)


def test_lenses_are_values() -> None:
    """Equal and hashable by their numbers, however many zeros were written, and the same in another process."""
    short, long = lens_of(WIDE, "opencv", [-0.2, 0, 0, 0]), lens_of(WIDE, "opencv", [-0.2] + [0] * 13)
    assert short == long
    assert hash(short) == hash(long)
    assert short != lens_of(WIDE, "opencv", [-0.2, 0, 0, 1e-9])
    short.border_sine(np.ones(3))
    copy = pickle.loads(pickle.dumps(short))
    assert copy == short
    np.testing.assert_array_equal(copy.unproject(np.array([3, 4])), short.unproject(np.array([3, 4])))
    with pytest.raises(dataclasses.FrozenInstanceError):
        short.fx_px = 1.0  # type: ignore[misc]
