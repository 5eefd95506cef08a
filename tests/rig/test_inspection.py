"""What inspect-rig says of rigs whose angles are known beforehand."""

from __future__ import annotations

import math

import pytest

from tests.rig.hand_made import TEXT, with_changes
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.inspection import CameraFacts, inspect_rig
from unidrive_cli.rig.yaml_file import parse_rig

WIDE = """
name: wide
description: 100 degrees ahead and to the left, 60 to the back right and up
cameras:
  AHEAD: {width: 100, height: 100, hfov: 100, position: [1, 0, 1], yaw: 0}
  LEFT: {width: 100, height: 100, hfov: 100, position: [0, 1, 1], yaw: 90}
  SKY: {width: 100, height: 100, hfov: 60, position: [0, -1, 2], yaw: -120, pitch: 90}
"""


def test_the_hand_made_rig() -> None:
    """90 degrees ahead, 90 to the back: v = 2 atan(450 / 800) and 2 atan(200 / 410)."""
    rig = parse_rig(TEXT, "car.yaml")
    facts = inspect_rig(rig)
    assert (facts.name, facts.description, facts.digest) == ("hand-made", "two cameras", rig.digest)
    assert (facts.depth_limit_m, facts.ground_height_m) == (40.0, 0.1)
    assert facts.cameras == [
        CameraFacts("CAM_FRONT", 1600, 900, 90.0, 58.716, 0.0, 0.0, 0.0, (2.8, 0.25, 1.6)),
        CameraFacts("CAM_BACK", 800, 400, 90.0, 52.007, 180.0, 0.0, 0.0, (0.8, 0.0, 1.2)),
    ]
    assert facts.covered_deg == 180.0
    assert facts.overlaps_deg == []
    assert facts.blind_arcs_deg == [(-135.0, -45.0), (45.0, 135.0)]


def test_overlap_and_a_camera_that_sees_no_horizon() -> None:
    """Ahead -50..50, left 40..140: 10 degrees twice, 190 in all, blind from 140 round the back to -50."""
    facts = inspect_rig(parse_rig(WIDE, "car.yaml"))
    assert facts.overlaps_deg == [("AHEAD", "LEFT", 10.0)]
    assert facts.covered_deg == 190.0
    assert facts.blind_arcs_deg == [(140.0, 310.0)]
    sky = facts.cameras[2]
    assert (sky.yaw_deg, sky.pitch_deg, sky.roll_deg) == (-120.0, 90.0, 0.0)
    assert (facts.depth_limit_m, facts.ground_height_m) == (None, None)


def test_distorted_cameras() -> None:
    """f theta = 400 theta: half of 800 pixels are 1 rad, half of 400 are 0.5; the other ends in its corners."""
    fisheye = "distortion: {model: fisheye, coefficients: [0, 0, 0, 0]}"
    barrel = "distortion: {model: opencv, coefficients: [-0.4, 0, 0, 0]}"
    front, back = inspect_rig(
        parse_rig(
            with_changes(
                ("[400, 410, 399.5, 199.5]", f"[400, 400, 399.5, 199.5]\n    {fisheye}"),
                ("    yaw: 0\n", f"    yaw: 0\n    {barrel}\n"),
            ),
            "car.yaml",
        )
    ).cameras
    assert (front.lens, back.lens) == ("opencv", "fisheye")
    assert (back.hfov_deg, back.vfov_deg) == (114.592, 57.296)
    assert back.blank_share == 0.0
    limit = 2 * math.degrees(
        math.atan(math.sqrt(1 / 1.2))
    )  # dr_d/dr = 1 - 1.2 r^2; r_d = 0.61 there: inside, 1 is the border
    assert front.hfov_deg == pytest.approx(limit, abs=1e-3)
    radius = math.sqrt(1 / 1.2) * (1 - 0.4 / 1.2)
    height = 900 / 1600
    segment = radius**2 * math.acos(height / radius) - height * math.sqrt(radius**2 - height**2)
    seen = (math.pi * radius**2 - 2 * segment) / (4 * height)
    assert front.blank_share == pytest.approx(1 - seen, abs=2e-3)


@pytest.mark.parametrize(
    ("name", "covered", "pairs", "overlap", "blind"),
    [
        ("roof-6x70", 360.0, 6, 10.0, 0),
        ("6x70", 360.0, 6, 10.0, 0),
        ("4x95", 360.0, 4, 5.0, 0),
        ("5x75", 360.0, 5, 3.0, 0),
        ("8x50", 360.0, 8, 5.0, 0),
        ("6x80a", 360.0, 6, 20.0, 0),
        ("6x60", 360.0, 0, None, 0),  # border to border: nothing twice, nothing left out
    ],
)
def test_regular_rigs_close_the_circle(
    name: str, covered: float, pairs: int, overlap: float | None, blind: int
) -> None:
    """n cameras of h degrees every 360 / n: neighbours share h - 360 / n."""
    facts = inspect_rig(load_gallery_rig(name))
    assert facts.covered_deg == covered
    assert len(facts.overlaps_deg) == pairs
    assert {degrees for _, _, degrees in facts.overlaps_deg} == ({overlap} if overlap else set())
    assert len(facts.blind_arcs_deg) == blind
