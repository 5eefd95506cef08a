"""Boxes against nuscenes-devkit, and their part in front of a plane against linear programming."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from nuscenes.utils.data_classes import Box
from pyquaternion import Quaternion
from scipy.optimize import linprog

from tests.geometry.strategies import poses, reals, units, vectors
from unidrive_cli.geometry.boxes import EDGES, clipped_outline, corners, grid, volume_grid

sizes = vectors(3, 1.0).map(lambda v: 0.1 + 5 * np.abs(v))  # width, length, height
CUBE = np.array(list(product((-1.0, 1.0), repeat=3)))


def pose_of(quaternion: np.ndarray, centre: np.ndarray) -> np.ndarray:
    matrix = Quaternion(quaternion).transformation_matrix
    matrix[:3, 3] = centre
    return matrix


@given(units(4), vectors(3, 100.0), sizes)
def test_corners_are_nuscenes_devkits_in_its_order(q: np.ndarray, centre: np.ndarray, size: np.ndarray) -> None:
    expected = Box(centre.tolist(), size.tolist(), Quaternion(q)).corners().T
    np.testing.assert_allclose(corners(pose_of(q, centre), size), expected, atol=1e-10)


def test_corners_by_hand() -> None:
    """2 m wide, 4 m long, 1.5 m high, turned left by 90 degrees at (10, 20, 30): the front is at y = 22."""
    turned = pose_of(np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)]), np.array([10.0, 20.0, 30.0]))
    found = corners(turned, np.array([2.0, 4.0, 1.5]))
    np.testing.assert_allclose(found[:4, 1], 22)
    np.testing.assert_allclose(found[4:, 1], 18)
    np.testing.assert_allclose(found[0], [9, 22, 30.75])  # front, left, top
    np.testing.assert_allclose(np.ptp(found, axis=0), [2, 4, 1.5])


def test_edges_are_the_twelve_of_a_box() -> None:
    found = corners(np.eye(4), np.array([2.0, 4.0, 1.5]))
    spans = np.abs([found[a] - found[b] for a, b in EDGES])
    assert len({frozenset(edge) for edge in EDGES}) == 12
    assert (np.count_nonzero(spans, axis=1) == 1).all()
    np.testing.assert_array_equal(np.count_nonzero(spans, axis=0), [4, 4, 4])


def test_grid_places_many_boxes_at_once() -> None:
    many = np.stack([pose_of(np.array([1.0, 0, 0, 0]), np.array([i, 0.0, 0.0])) for i in range(3)])
    size = np.array([[2.0, 4.0, 6.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    found = grid(many, size, np.array([[1.0, 1.0, 1.0], [0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(
        found, [[[2, 1, 3], [0, 0, -3]], [[1.5, 0.5, 0.5], [1, 0, -0.5]], [[2, 0, 0], [2, 0, 0]]]
    )


def test_volume_grid() -> None:
    points = volume_grid(3)
    assert sorted(map(tuple, points.tolist())) == sorted(product((-1.0, 0.0, 1.0), repeat=3))
    assert volume_grid(5).shape == (125, 3)


# --- the part in front -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("near", "expected"),
    [
        (-1.5, [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]),
        (0.5, [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0.5, 1)]),
        (1.5, []),
    ],
)
def test_a_cube_cut_across(near: float, expected: list) -> None:
    found = clipped_outline(corners(np.eye(4), np.array([2.0, 2.0, 2.0])), near)
    assert found.shape == (len(expected), 3)
    assert sorted(map(tuple, found.tolist())) == sorted(expected)


@given(poses(3.0), sizes, reals(-2.0, 2.0), units(3))
def test_the_outline_reaches_exactly_as_far_as_the_cut_box(
    cam_from_box: np.ndarray, size: np.ndarray, near: float, direction: np.ndarray
) -> None:
    """The farthest point of {box, z >= near} in any direction, by linear programming in box coordinates."""
    outline = clipped_outline(corners(cam_from_box, size), near)
    axes = cam_from_box[:3, :3] * (size[[1, 0, 2]] / 2)
    centre = cam_from_box[:3, 3]
    answer = linprog(-direction @ axes, A_ub=[-axes[2]], b_ub=[centre[2] - near], bounds=[(-1, 1)] * 3)
    if answer.status == 2:
        assert len(outline) == 0
    elif len(outline):
        assert (outline @ direction).max() == pytest.approx(direction @ centre - answer.fun, abs=1e-6)
        assert outline[:, 2].min() >= near - 1e-9
    else:  # touched by less than the solver's tolerance
        assert centre[2] + np.abs(axes[2]).sum() < near + 1e-6
