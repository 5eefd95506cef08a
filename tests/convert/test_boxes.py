"""What a virtual rig shows of annotated boxes, and its 2D boxes: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from unidrive_cli.convert.boxes import seen_boxes
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse, pose, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.model import Camera
from unidrive_cli.warp.remap import Source

# A level 90-degree camera at 1.5 m that looks ahead: at x metres its picture is 2x wide and x high.
AHEAD = Camera("V", Pinhole.from_hfov(90, 800, 400), pose(rotation_from_yaw_pitch_roll(0, 0, 0), [0.0, 0, 1.5]))
ALL = np.full((400, 800), 255, dtype=np.uint8)


def shown(
    centre_m: list[float], size_wlh_m: list[float], mask: np.ndarray = ALL, source: Camera = AHEAD
) -> tuple[float, list[tuple[float, float, float, float]]]:
    boxes_pose = pose(np.eye(3), centre_m)[None]
    sources = [Source(source.lens, inverse(source.ego_from_cam))]
    share, _, boxes = seen_boxes(boxes_pose, np.array([size_wlh_m]), sources, [(AHEAD, mask)])
    return share[0], [(box.left, box.top, box.right, box.bottom) for box in boxes]


def turned(yaw_deg: float, hfov_deg: float = 90) -> Camera:
    return Camera(
        "S",
        Pinhole.from_hfov(hfov_deg, 800, 400),
        pose(rotation_from_yaw_pitch_roll(yaw_deg, 0, 0), [0.0, 0, 1.5]),
    )


def test_a_box_in_full_view() -> None:
    """2 m wide and 1 m high, its near face 10 m ahead: 400 px per unit of x / z."""
    share, ((left, top, right, bottom),) = shown([10.5, 0, 1.5], [2.0, 1.0, 1.0])
    assert share == 1
    assert (left, right) == pytest.approx((399.5 - 40, 399.5 + 40), abs=2e-3)
    assert (top, bottom) == pytest.approx((199.5 - 20, 199.5 + 20), abs=2e-3)


def test_half_a_box_beyond_the_border_is_shown_by_half() -> None:
    """The picture's border at 10 m is at y = 10; a wide source saw all of the box."""
    share, ((left, _, right, _),) = shown([10.0, 10.0, 1.5], [4.0, 0.01, 1.0], source=turned(30, 150))
    assert share == pytest.approx(0.5, abs=0.11)
    assert left == 0
    assert right == pytest.approx(399.5 - 400 * 8 / 10, abs=0.5)


def test_behind_and_beside_nothing_is_shown() -> None:
    for centre in ([-10.0, 0, 1.5], [2.0, 10.0, 1.5], [5.0, 0.0, 20.0]):
        assert shown(centre, [1.0, 1.0, 1.0], source=turned(90, 170)) == (0.0, [])


def test_on_uncovered_pixels_nothing_is_shown() -> None:
    mask = ALL.copy()
    mask[:, 300:500] = 0
    assert shown([10.5, 0, 1.5], [2.0, 1.0, 1.0], mask) == (0.0, [])
    mask[:, 400:] = 255
    share, boxes = shown([10.5, 0, 1.5], [2.0, 1.0, 1.0], mask)
    assert share == pytest.approx(0.5, abs=0.11)
    assert len(boxes) == 1


def test_a_sliver_between_the_grid_points_still_counts_as_shown() -> None:
    """A 40 m long wall: only its last centimetres reach into the picture, between two grid points."""
    share, boxes = shown([-19.0, 0.0, 1.5], [1.0, 40.3, 1.0])
    assert share > 0
    assert len(boxes) == 1


def test_a_box_round_the_camera_is_cut_at_the_near_plane() -> None:
    """The exporter of the devkit keeps its front corners only; the box fills the whole picture."""
    _, (bounds,) = shown([0.0, 0.0, 1.5], [4.0, 8.0, 3.0])
    assert bounds == (0, 0, 800, 400)


def test_what_no_source_saw_is_not_lowered_where_the_virtual_rig_shows_it() -> None:
    share, _ = shown([10.5, 0, 1.5], [2.0, 1.0, 1.0], source=turned(180))
    assert share == 1


def test_no_boxes() -> None:
    assert seen_boxes(np.zeros((0, 4, 4)), np.zeros((0, 3)), [], [(AHEAD, ALL)]) == ([], 0, [])
