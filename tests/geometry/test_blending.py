"""What eq. 3's weights must do, whatever their formula: steady, positive, decided, and gone at the border."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from tests.geometry.strategies import reals, vectors
from unidrive_cli.geometry.blending import angular_weights, parallax_chord
from unidrive_cli.geometry.lenses import Pinhole

sines = reals(-1.0, 1.0)
chords = reals(0.0, 2.0)


def weight(sine: float, chord: float) -> float:
    return float(angular_weights(np.array(sine), np.array(chord)))


def share(first: tuple[float, float], second: tuple[float, float]) -> float:
    """What the first of two sources (border sine, chord) adds to the mix."""
    return weight(*first) / (weight(*first) + weight(*second))


@given(sines, chords)
def test_positive_and_finite_everywhere(sine: float, chord: float) -> None:
    assert 0 < weight(sine, chord) < np.inf


@given(sines, sines, chords, chords)
def test_monotone_in_both_factors(sine_a: float, sine_b: float, chord_a: float, chord_b: float) -> None:
    low, high = sorted((sine_a, sine_b))
    near, far = sorted((chord_a, chord_b))
    assert weight(low, far) <= weight(high, far) <= weight(high, near)


@given(sines, chords)
def test_continuous(sine: float, chord: float) -> None:
    """A step of 1e-9 in either factor moves the weight by less than a millionth of it."""
    here = weight(sine, chord)
    assert abs(weight(sine + 1e-9, chord) - here) <= 1e-4 * here
    assert abs(weight(sine, chord + 1e-9) - here) <= 1e-4 * here


@given(reals(0.01, 1.0), reals(0.01, 1.0), reals(0.0, 2.0), reals(0.0, 2.0))
def test_falls_to_almost_nothing_at_the_border(
    inside: float, other: float, chord: float, other_chord: float
) -> None:
    """Even against a source that sees the point at a grazing angle and from the worst place."""
    assert share((0.0, chord), (max(inside, 0.05), other_chord)) < 0.02
    assert weight(0.0, chord) < 1e-6 * weight(max(other, 0.05), chord)


@given(reals(0.1, 1.0), reals(0.05, 2.0))
def test_a_source_at_the_virtual_cameras_own_place_all_but_wins(sine: float, chord: float) -> None:
    assert share((sine, 0.0), (sine, chord)) > 0.99


def test_equal_sources_share_equally() -> None:
    assert share((0.3, 0.1), (0.3, 0.1)) == 0.5


def test_no_step_across_the_overlap_of_two_real_cameras() -> None:
    """Two 70-degree cameras 55 degrees apart, a walk along the horizon from one picture into the other.

    The blend of a white and a black picture goes from white to black, never back, and a twentieth of a
    degree never moves it by more than 2 of 100; at each picture's own border that picture is gone.
    """
    lens = Pinhole.from_hfov(70.0, 1600, 900)
    azimuth = np.deg2rad(np.linspace(20.0, 35.0, 301))  # degrees to the right; B looks 55 to the right
    points = 30.0 * np.stack([np.sin(azimuth), np.zeros_like(azimuth), np.cos(azimuth)], axis=-1)
    turn = np.deg2rad(55.0)
    b_from_a = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    place_a, place_b, virtual = np.zeros(3), np.array([0.5, 0.0, -0.2]), np.array([0.25, 0.0, -0.1])
    in_b = (points - place_b) @ b_from_a.T
    white = angular_weights(lens.border_sine(points), parallax_chord(points, virtual, place_a))
    black = angular_weights(lens.border_sine(in_b), parallax_chord(points, virtual, place_b))
    mix = np.where(lens.project(points)[1], white, 0) / (white + black)
    both = lens.project(points)[1] & lens.project(in_b)[1]
    assert both.sum() > 200
    mix = mix[both]
    assert mix[0] > 0.9999
    assert mix[-1] < 0.0001
    assert (np.diff(mix) <= 0).all()
    assert np.abs(np.diff(mix)).max() < 0.02


# --- parallax ----------------------------------------------------------------------------------------


def test_parallax_chord_by_hand() -> None:
    """Seen from (0, 0, 0) and (1, 0, 0), the point (0, 1, 0) has 45 degrees of parallax; (0, 0, 1) too."""
    points = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = parallax_chord(points, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(found, 2 * np.sin(np.deg2rad(22.5)), rtol=1e-12)
    np.testing.assert_array_equal(points, [[0, 1, 0], [0, 0, 1]])


@given(vectors(3, 50.0), vectors(3, 2.0), vectors(3, 2.0))
def test_parallax_chord_is_twice_the_sine_of_half_the_angle(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
    point = point + np.array([0.0, 0.0, 60.0])
    to_a, to_b = a - point, b - point
    angle = np.arctan2(np.linalg.norm(np.cross(to_a, to_b)), to_a @ to_b)
    assert abs(parallax_chord(point, a, b) - 2 * np.sin(angle / 2)) < 1e-7  # the weight adds 2e-3 to it


def test_no_parallax_from_one_place() -> None:
    assert parallax_chord(np.array([[3.0, 4.0, 5.0]]), np.ones(3), np.ones(3)) < 1e-7
