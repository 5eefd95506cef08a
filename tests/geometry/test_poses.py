"""Poses against pyquaternion, exact fractions and angles by hand."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyquaternion import Quaternion

from tests.geometry.strategies import poses, reals, rotations, units, vectors
from unidrive_cli.errors import GeometryError
from unidrive_cli.geometry.poses import (
    check_pose,
    inverse,
    pose,
    quaternion_from_rotation,
    relative,
    rotation_from_quaternion,
    rotation_from_yaw_pitch_roll,
    rotations_from_quaternions,
    transform,
    turn_rad,
    yaw_pitch_roll_from_rotation,
)

C30, S30 = np.sqrt(3) / 2, 0.5
RIGHT, DOWN, AHEAD = np.eye(3)  # the camera's own axes


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-5, 0.3, 2.0, np.pi])
@pytest.mark.parametrize("axis", [RIGHT, np.array([0.6, 0.0, -0.8])])
def test_turn_of_a_rotation(angle_rad: float, axis: np.ndarray) -> None:
    rotation = Quaternion(axis=axis, radians=angle_rad).rotation_matrix
    assert turn_rad(rotation) == pytest.approx(angle_rad, rel=1e-6, abs=1e-15)


# --- quaternions -------------------------------------------------------------------------------------


@given(units(4), reals(0.01, 100.0))
def test_rotation_from_quaternion_is_pyquaternions_whatever_the_norm(quaternion: np.ndarray, norm: float) -> None:
    expected = Quaternion(quaternion).rotation_matrix
    np.testing.assert_allclose(rotation_from_quaternion(quaternion * norm), expected, atol=1e-12)


@given(units(4))
def test_quaternion_round_trip_up_to_sign(quaternion: np.ndarray) -> None:
    back = quaternion_from_rotation(Quaternion(quaternion).rotation_matrix)
    assert back[0] >= 0
    assert min(np.abs(back - quaternion).max(), np.abs(back + quaternion).max()) < 1e-12


@pytest.mark.parametrize("axis", [*np.eye(3), [0.6, 0.8, 0.0], [0.0, -0.6, 0.8]])
def test_quaternion_of_half_turns_where_w_is_zero(axis: np.ndarray) -> None:
    half_turn = 2 * np.outer(axis, axis) - np.eye(3)
    back = quaternion_from_rotation(half_turn)
    assert back[0] == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(np.outer(back[1:], back[1:]), np.outer(axis, axis), atol=1e-15)


def test_nuscenes_front_camera_quaternion_is_the_level_camera() -> None:
    np.testing.assert_array_equal(
        rotation_from_quaternion([0.5, -0.5, 0.5, -0.5]), [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    )


@pytest.mark.parametrize(
    ("quaternion", "sentence"),
    [
        ([0, 0, 0, 0], "zero norm"),
        ([1e-9, 0, 0, 0], "zero norm"),
        ([1, 0, 0], r"shape 4, got 3"),
        (np.eye(3), r"shape 4, got 3x3"),
        ([1, 0, 0, np.nan], "finite"),
        ([1, 0, 0, np.inf], "finite"),
        (["a", 0, 0, 0], "numbers"),
        (None, "numbers|shape"),
    ],
)
def test_what_is_no_quaternion_is_refused(quaternion: object, sentence: str) -> None:
    with pytest.raises(GeometryError, match=sentence):
        rotation_from_quaternion(quaternion)


def test_a_quaternion_too_large_for_its_norm_is_not_taken_for_the_identity() -> None:
    """A quarter turn to the left, scaled until its norm overflows: refused, or still the quarter turn."""
    try:
        rotation = rotation_from_quaternion([1e200, 0, 0, 1e200])
    except GeometryError:
        return
    np.testing.assert_allclose(rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_unit_tolerance() -> None:
    rotation_from_quaternion([1.0009, 0, 0, 0], unit_tolerance=1e-3)
    with pytest.raises(GeometryError, match=r"norm 1, got 1\.0011"):
        rotation_from_quaternion([1.0011, 0, 0, 0], unit_tolerance=1e-3)


# --- yaw, pitch, roll --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("angles", "right", "down", "ahead"),
    [
        ((0, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0)),
        ((90, 0, 0), (1, 0, 0), (0, 0, -1), (0, 1, 0)),  # positive yaw turns left: looks along ego +y
        ((-30, 0, 0), (-S30, -C30, 0), (0, 0, -1), (C30, -S30, 0)),
        ((180, 0, 0), (0, 1, 0), (0, 0, -1), (-1, 0, 0)),
        ((0, 30, 0), (0, -1, 0), (S30, 0, -C30), (C30, 0, S30)),  # positive pitch looks up
        ((0, 90, 0), (0, -1, 0), (1, 0, 0), (0, 0, 1)),
        ((0, 0, 90), (0, 0, -1), (0, 1, 0), (1, 0, 0)),  # positive roll: the right side goes down
        ((0, 0, 30), (0, -C30, -S30), (0, S30, -C30), (1, 0, 0)),
        ((90, 30, 0), (1, 0, 0), (0, S30, -C30), (0, C30, S30)),  # pitch about the camera's own side axis
        ((90, 0, 90), (0, 0, -1), (-1, 0, 0), (0, 1, 0)),
        ((0, 30, 90), (S30, 0, -C30), (0, 1, 0), (C30, 0, S30)),
    ],
)
def test_yaw_pitch_roll_by_hand(angles: tuple, right: tuple, down: tuple, ahead: tuple) -> None:
    """Where the camera's three axes point in the ego frame (x forward, y left, z up)."""
    rotation = rotation_from_yaw_pitch_roll(*angles)
    for own_axis, expected in ((RIGHT, right), (DOWN, down), (AHEAD, ahead)):
        np.testing.assert_allclose(rotation @ own_axis, expected, atol=1e-15)


@given(reals(-360, 360), reals(-180, 180), reals(-180, 180))
def test_yaw_pitch_roll_is_the_product_of_axis_rotations(yaw: float, pitch: float, roll: float) -> None:
    turn, tilt, lean = (
        Quaternion(axis=axis, degrees=angle).rotation_matrix
        for axis, angle in (([0, 0, 1], yaw), ([0, 1, 0], -pitch), ([1, 0, 0], roll))
    )
    expected = turn @ tilt @ lean @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    np.testing.assert_allclose(rotation_from_yaw_pitch_roll(yaw, pitch, roll), expected, atol=1e-12)


@given(reals(-179.9, 180), reals(-89.9, 89.9), reals(-179.9, 180))
def test_angles_round_trip(yaw: float, pitch: float, roll: float) -> None:
    back = yaw_pitch_roll_from_rotation(rotation_from_yaw_pitch_roll(yaw, pitch, roll))
    np.testing.assert_allclose((np.subtract(back, (yaw, pitch, roll)) + 180) % 360 - 180, 0, atol=1e-8)


@given(reals(-180, 180), st.sampled_from([90.0, -90.0, 90 - 1e-9, 90 - 1e-7, 90 - 1e-5]), reals(-180, 180))
def test_straight_up_and_down_the_angles_still_give_the_same_rotation(yaw: float, pitch: float, roll: float) -> None:
    rotation = rotation_from_yaw_pitch_roll(yaw, pitch, roll)
    angles = yaw_pitch_roll_from_rotation(rotation)
    np.testing.assert_allclose(rotation_from_yaw_pitch_roll(*angles), rotation, atol=1e-7)
    if abs(pitch) == 90:
        assert angles[2] == 0.0


# --- 4x4 poses ---------------------------------------------------------------------------------------


@given(poses(), vectors(3, 100.0))
def test_transform_and_inverse(a_from_b: np.ndarray, point: np.ndarray) -> None:
    moved = transform(a_from_b, point)
    np.testing.assert_allclose(moved, (a_from_b @ [*point, 1.0])[:3], atol=1e-10)
    np.testing.assert_allclose(transform(inverse(a_from_b), moved), point, atol=1e-10)
    np.testing.assert_allclose(inverse(a_from_b), np.linalg.inv(a_from_b), atol=1e-10)


def test_transform_keeps_leading_shapes() -> None:
    points = np.arange(30.0).reshape(2, 5, 3)
    quarter_left = pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [10, 20, 30])
    moved = transform(quarter_left, points)
    assert moved.shape == (2, 5, 3)
    np.testing.assert_array_equal(moved[1, 2], [10 - 22, 20 + 21, 30 + 23])


def test_relative_of_utm_sized_poses_by_hand() -> None:
    """a stands at UTM size and is turned by the 3-4-5 angle; b is 3, 4, 0.5 m away and not turned.

    In a's frame: x = 0.6 * 3 + 0.8 * 4 = 5, y = -0.8 * 3 + 0.6 * 4 = 0. All translations are exact in
    binary, so nothing but the rotation's own rounding may remain; inv(a) @ b leaves about 1e-9.
    """
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    a = pose(turn, [448_262.25, 5_411_932.5, 512.75])
    b = pose(np.eye(3), [448_265.25, 5_411_936.5, 513.25])
    a_from_b = relative(a, b)
    np.testing.assert_allclose(a_from_b[:3, 3], [5, 0, 0.5], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(a_from_b[:3, :3], turn.T)


@given(
    st.tuples(*[st.integers(-9, 9)] * 4).filter(any),
    st.tuples(*[reals(-1e7, 1e7)] * 3),
    st.tuples(*[reals(-100, 100)] * 3),
)
def test_relative_against_exact_fractions(quaternion: tuple, place: tuple, step: tuple) -> None:
    """An integer quaternion has a rational rotation matrix, so the right answer is known exactly."""
    w, x, y, z = (Fraction(value) for value in quaternion)
    n = w * w + x * x + y * y + z * z
    exact = [
        [(w * w + x * x - y * y - z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
        [2 * (x * y + w * z) / n, (w * w - x * x + y * y - z * z) / n, 2 * (y * z - w * x) / n],
        [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, (w * w - x * x - y * y + z * z) / n],
    ]
    a = pose(np.array(exact, dtype=np.float64), place)
    b = pose(np.eye(3), np.add(place, step))
    delta = [Fraction(there) - Fraction(here) for there, here in zip(b[:3, 3], a[:3, 3], strict=True)]
    expected = [float(sum(exact[row][column] * delta[row] for row in range(3))) for column in range(3)]
    np.testing.assert_allclose(relative(a, b)[:3, 3], expected, rtol=0, atol=1e-11)


@given(poses(1e6), poses(10.0), vectors(3, 50.0))
def test_relative_takes_points_of_b_to_a(global_from_a: np.ndarray, a_from_b: np.ndarray, point: np.ndarray) -> None:
    found = relative(global_from_a, global_from_a @ a_from_b)
    np.testing.assert_allclose(transform(found, point), transform(a_from_b, point), atol=1e-6)


# --- refused -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rotation", "translation", "sentence"),
    [
        (np.diag([1, 1, -1]), [0, 0, 0], "right-handed"),
        (2 * np.eye(3), [0, 0, 0], "orthonormal"),
        ([[1, 0.001, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0], "orthonormal"),
        (np.zeros((3, 3)), [0, 0, 0], "orthonormal"),
        (np.eye(4), [0, 0, 0], "rotation matrix must have shape 3x3, got 4x4"),
        (np.full((3, 3), np.nan), [0, 0, 0], "rotation matrix must be finite"),
        (np.eye(3), [0, 0], "translation must have shape 3, got 2"),
        (np.eye(3), [0, np.inf, 0], "translation must be finite"),
        (np.eye(3), 1.0, "got one number"),
    ],
)
def test_what_is_no_pose_is_refused(rotation: object, translation: object, sentence: str) -> None:
    with pytest.raises(GeometryError, match=sentence) as caught:
        pose(rotation, translation)
    assert caught.value.exit_code == 2


@given(rotations, vectors(3, 1e6))
def test_check_pose_lets_poses_pass(rotation: np.ndarray, translation: np.ndarray) -> None:
    matrix = pose(rotation, translation)
    np.testing.assert_array_equal(check_pose(matrix.tolist(), "ego_from_cam"), matrix)


@pytest.mark.parametrize("value", [0.0, 2.0])
def test_check_pose_wants_the_last_row(value: float) -> None:
    matrix = np.diag([1.0, 1.0, 1.0, value])
    with pytest.raises(GeometryError, match="ego_from_cam must end with the row 0 0 0 1"):
        check_pose(matrix, "ego_from_cam")


@given(st.lists(units(4), min_size=1, max_size=5), reals(0.1, 10.0))
def test_rotations_of_many_quaternions(quaternions: list[np.ndarray], norm: float) -> None:
    expected = [Quaternion(quaternion).rotation_matrix for quaternion in quaternions]
    found = rotations_from_quaternions(norm * np.array(quaternions))
    np.testing.assert_allclose(found, expected, atol=1e-12)


@given(st.lists(poses(), min_size=1, max_size=4), vectors(3, 100.0))
def test_a_pose_for_each_point(many: list[np.ndarray], point: np.ndarray) -> None:
    points = np.array([point + index for index in range(len(many))])
    expected = [transform(one, place) for one, place in zip(many, points, strict=True)]
    np.testing.assert_allclose(transform(np.array(many), points), expected, atol=1e-10)
