"""Rig and Camera: refused at birth, unchangeable, and a digest that is theirs alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.rig.hand_made import TEXT, with_changes
from unidrive_cli.errors import GeometryError, RigError
from unidrive_cli.geometry.lenses import FisheyeLens, OpenCVLens, Pinhole
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.rig.yaml_file import parse_rig

LENS = Pinhole(400.0, 410.0, 399.5, 199.5, 800, 400)
POSE = np.array([[0.0, 0, 1, 1.5], [-1, 0, 0, 0.25], [0, -1, 0, 1.6], [0, 0, 0, 1]])


def digest(text: str) -> str:
    return parse_rig(text, "car.yaml").digest


@pytest.mark.parametrize(
    "change",
    [
        ("width: 1600", "width: 1601"),
        ("height: 900", "height: 901"),
        ("hfov: 90", "hfov: 90.000001"),
        ("[1.5, 0.25, 1.6]", "[1.500001, 0.25, 1.6]"),
        ("[1.5, 0.25, 1.6]", "[1.5, 0.250001, 1.6]"),
        ("[1.5, 0.25, 1.6]", "[1.5, 0.25, 1.600001]"),
        ("    yaw: 0\n", "    yaw: 0.000001\n"),
        ("    yaw: 0\n", "    yaw: 0\n    pitch: 0.000001\n"),
        ("    yaw: 0\n", "    yaw: 0\n    roll: 0.000001\n"),
        ("width: 800", "width: 801"),
        ("[400, 410, 399.5, 199.5]", "[400.000001, 410, 399.5, 199.5]"),
        ("[400, 410, 399.5, 199.5]", "[400, 410.000001, 399.5, 199.5]"),
        ("[400, 410, 399.5, 199.5]", "[400, 410, 399.500001, 199.5]"),
        ("[400, 410, 399.5, 199.5]", "[400, 410, 399.5, 199.500001]"),
        ("[0.5, -0.5, -0.5, 0.5]", "[0.500001, -0.5, -0.5, 0.5]"),
        ("rear_axle_to_centre: 1.3", "rear_axle_to_centre: 1.300001"),
        ("  CAM_BACK:", "  CAM_BACK_LEFT:"),
    ],
)
def test_the_digest_changes_with_any_number_of_a_camera(change: tuple[str, str]) -> None:
    assert digest(with_changes(change)) != digest(TEXT)


@pytest.mark.parametrize(
    "change",
    [
        ("name: hand-made", "name: another"),
        ("description: two cameras\n", ""),
        ("depth_limit: 40\n", ""),  # options of a conversion, not part of the cameras
        ("ground_height: 0.1\n", ""),
        ("hfov: 90", "hfov: 90.0"),
        ("name: hand-made", "# comment\nname: hand-made"),
    ],
)
def test_the_digest_does_not_change_with_words(change: tuple[str, str]) -> None:
    assert digest(with_changes(change)) == digest(TEXT)


def test_the_digest_knows_the_order_of_the_cameras() -> None:
    """Tokens and file order follow it."""
    rig = parse_rig(TEXT, "car.yaml")
    assert replace(rig, cameras=rig.cameras[::-1]).digest != rig.digest


@pytest.mark.parametrize(
    ("lens", "pose"),
    [
        (Pinhole(400, 410, 399.5, 199.5, 800, 400), POSE),  # whole numbers given as int
        (LENS, np.where(POSE == 0, -0.0, POSE)),  # a zero with a sign
    ],
)
def test_equal_numbers_have_equal_digests(lens: Pinhole, pose: np.ndarray) -> None:
    assert lens == LENS
    np.testing.assert_array_equal(pose, POSE)
    assert Rig("a", "", (Camera("C", lens, pose),)).digest == Rig("b", "", (Camera("C", LENS, POSE),)).digest


def test_the_digest_knows_the_distortion() -> None:
    numbers = (400.0, 410.0, 399.5, 199.5, 800, 400)
    lenses = [
        LENS,
        OpenCVLens(*numbers, (0.1, 0.0, 0.0, 0.0)),
        OpenCVLens(*numbers, (0.100000001, 0.0, 0.0, 0.0)),
        OpenCVLens(*numbers, (0.1, 0.0, 0.0, 0.0, 0.001)),
        FisheyeLens(*numbers, (0.1, 0.0, 0.0, 0.0)),
        FisheyeLens(*numbers, (0.0, 0.0, 0.0, 0.0)),
    ]
    assert len({Rig("a", "", (Camera("C", lens, POSE),)).digest for lens in lenses}) == len(lenses)
    longer = OpenCVLens(*numbers, (0.1, 0.0, 0.0, 0.0, 0.0))  # the same lens, written with a zero more
    assert Rig("a", "", (Camera("C", longer, POSE),)).digest == Rig("a", "", (Camera("C", lenses[1], POSE),)).digest


def test_a_virtual_camera_is_a_pinhole() -> None:
    assert Camera("C", LENS, POSE).pinhole is LENS
    with pytest.raises(GeometryError, match=r"lens distortion \(fisheye\); a virtual camera is a pinhole"):
        _ = Camera("C", FisheyeLens(400.0, 410.0, 399.5, 199.5, 800, 400, (0.0,) * 4), POSE).pinhole


def test_a_rig_needs_cameras_with_names_of_their_own() -> None:
    camera = Camera("CAM_FRONT", LENS, POSE)
    with pytest.raises(RigError, match=r"empty: .*at least one"):
        Rig("empty", "", ())
    with pytest.raises(RigError, match=r"twins: .*CAM_FRONT is given twice"):
        Rig("twins", "", (camera, camera))


@pytest.mark.parametrize("pose", [np.eye(3), 2 * np.eye(4), np.diag([1, 1, -1, 1.0]), np.full((4, 4), np.nan), None])
def test_a_camera_needs_a_pose(pose: object) -> None:
    with pytest.raises(GeometryError):
        Camera("CAM_FRONT", LENS, pose)  # type: ignore[arg-type]


def test_a_camera_keeps_its_own_numbers() -> None:
    given = POSE.copy()
    camera = Camera("CAM_FRONT", LENS, given)
    given[0, 3] = 99.0
    np.testing.assert_array_equal(camera.centre_ego, [1.5, 0.25, 1.6])
    with pytest.raises(ValueError, match="read-only"):
        camera.ego_from_cam[0, 3] = 99.0
    assert camera.yaw_pitch_roll_deg == pytest.approx((0, 0, 0))
