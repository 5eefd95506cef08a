"""The search space: what numbers make of a rig, and spaces that cannot be."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.optimize.fleet import pair
from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.optimize.space import Parameter, SearchSpace
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig

LEFT, RIGHT = "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"
MIRROR = {RIGHT: LEFT, "CAM_BACK_RIGHT": "CAM_BACK_LEFT"}


def space(*parameters: Parameter, start: Rig | None = None, mirror: dict[str, str] | None = None) -> SearchSpace:
    return SearchSpace(start or load_gallery_rig("roof-6x70"), 50.0, parameters, mirror or {})


def placed(rig: Rig) -> dict[str, list[float]]:
    """x, y, z, yaw, pitch, roll, hfov of each camera."""
    return {
        camera.channel: [*camera.centre_ego, *camera.yaw_pitch_roll_deg, camera.lens.hfov_deg]
        for camera in rig.cameras
    }


def test_the_start_itself_is_the_start_s_rig() -> None:
    start = load_gallery_rig("roof-6x70")
    whole = space(Parameter("x", (LEFT,), -1, 2, 0.1), Parameter("depth_limit", (), 20, 80, 1), mirror=MIRROR)
    assert whole.start_values.tolist() == [1.4, 50.0]
    rig = whole.rig(whole.start_values.tolist())
    assert rig.digest == start.digest
    assert rig.depth_limit_m == 50.0


def test_each_quantity_goes_where_it_belongs() -> None:
    quantities = ("x", "y", "z", "yaw", "pitch", "roll", "hfov")
    values = [0.5, 0.4, 1.7, 50.0, -3.0, 2.0, 80.0]
    parameters = [Parameter(of, (LEFT,), -90, 90, 0) for of in quantities[:-1]]
    rig = space(*parameters, Parameter("hfov", (LEFT,), 50, 90, 0)).rig(values)
    before = placed(load_gallery_rig("roof-6x70"))
    for channel, numbers in placed(rig).items():
        assert numbers == pytest.approx(values if channel == LEFT else before[channel], abs=1e-9)


def test_a_picture_s_height_is_cut_or_grows_about_the_middle() -> None:
    free = (Parameter("height", (LEFT,), 400, 1000, 2), Parameter("hfov", (LEFT,), 50, 90, 1))
    whole = space(*free, mirror=MIRROR)
    assert whole.start_values.tolist() == pytest.approx([900, 70])
    lenses = {camera.channel: camera.lens for camera in whole.rig([560.0, 70.0]).cameras}
    before = load_gallery_rig("roof-6x70").cameras[0].pinhole
    for channel in (LEFT, RIGHT):
        lens = lenses[channel]
        assert (lens.width_px, lens.height_px, lens.cy_px) == (1600, 560, 279.5)
        assert lens.fx_px == lens.fy_px == pytest.approx(before.fx_px)
    assert lenses["CAM_FRONT"] == before


def test_a_mirror_image_follows_left_for_right() -> None:
    parameters = (
        Parameter("y", (LEFT,), 0, 1, 0.01),
        Parameter("yaw", (LEFT,), 30, 80, 1),
        Parameter("pitch", (LEFT,), -10, 10, 1),
        Parameter("roll", (LEFT,), -10, 10, 1),
        Parameter("hfov", (LEFT,), 50, 90, 1),
    )
    found = placed(space(*parameters, mirror=MIRROR).rig([0.3, 44, -2, 5, 66]))
    assert found[LEFT] == pytest.approx([1.4, 0.3, 1.6, 44, -2, 5, 66])
    assert found[RIGHT] == pytest.approx([1.4, -0.3, 1.6, -44, -2, -5, 66])


def test_a_mirrored_principal_point_changes_sides() -> None:
    start = load_gallery_rig("roof-6x70")
    lens = Pinhole(1200, 1100, 700, 460, 1600, 900)
    cameras = tuple(
        camera if camera.channel != LEFT else type(camera)(LEFT, lens, camera.ego_from_cam)
        for camera in start.cameras
    )
    rig = space(Parameter("x", (LEFT,), 0, 2, 0.1), start=Rig("odd", "", cameras), mirror=MIRROR).rig([1.0])
    lenses = {camera.channel: camera.lens for camera in rig.cameras}
    assert lenses[LEFT] == lens
    assert lenses[RIGHT] == Pinhole(1200, 1100, 1599 - 700, 460, 1600, 900)


def test_shared_numbers_replace_and_relative_ones_are_added() -> None:
    shared = space(Parameter("x", (LEFT, "CAM_BACK"), -1, 3, 0.1))
    assert shared.start_values.tolist() == pytest.approx([0.7])  # the mean of 1.4 and 0
    found = placed(shared.rig([0.9]))
    assert (found[LEFT][0], found["CAM_BACK"][0]) == pytest.approx((0.9, 0.9))
    added = space(Parameter("x", (LEFT, "CAM_BACK"), -1, 1, 0.1, relative=True))
    assert added.start_values.tolist() == [0.0]
    found = placed(added.rig([0.2]))
    assert (found[LEFT][0], found["CAM_BACK"][0]) == pytest.approx((1.6, 0.2))


def test_the_depth_limit_is_its_own_number_or_a_change() -> None:
    assert space(Parameter("depth_limit", (), 20, 80, 1)).depth_limit_m([33.0]) == 33.0
    assert space(Parameter("depth_limit", (), -20, 20, 1, relative=True)).depth_limit_m([5.0]) == 55.0
    assert space(Parameter("x", (LEFT,), 0, 2, 0.1)).depth_limit_m([1.0]) == 50.0
    assert space(Parameter("depth_limit", (), -20, 20, 1, relative=True)).lowest_depth_limit_m == 30.0


def test_the_reach_holds_every_candidate() -> None:
    whole = space(Parameter("y", (LEFT,), 0.1, 0.7, 0.1), Parameter("z", (LEFT,), 1.2, 2.0, 0.1), mirror=MIRROR)
    low, high = whole.reach_m()
    assert low.tolist() == pytest.approx([0.0, -0.7, 1.2])
    assert high.tolist() == pytest.approx([1.5, 0.7, 2.0])


def test_the_dust_of_a_grid_goes() -> None:
    grid = space(Parameter("x", (LEFT,), -0.5, 2.5, 0.1))
    assert grid.on_grid(np.array([-0.5 + 19 * 0.1])).tolist() == [1.4]
    assert grid.on_grid(np.array([2.6])).tolist() == [2.5]


def test_a_bound_beside_the_grid_is_never_taken() -> None:
    grid = space(Parameter("height", (LEFT,), 800, 1001, 20), Parameter("x", (LEFT,), 1.0, 2.05, 0.1))
    assert grid.on_grid(np.array([1010.0, 2.1])).tolist() == [1000.0, 2.0]
    assert [parameter.highest for parameter in grid.parameters] == [1000.0, 2.0]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ([], "nothing is free"),
        ([Parameter("x", (), 0, 1, 0.1)], "x needs cameras"),
        ([Parameter("depth_limit", (LEFT,), 20, 60, 1)], "depth_limit has none"),
        ([Parameter("x", ("CAM_FRON",), 0, 1, 0.1)], "x of CAM_FRON: roof-6x70 has no camera CAM_FRON"),
        (
            [Parameter("x", (RIGHT,), 0, 2, 0.1)],
            "CAM_FRONT_RIGHT is a mirror image of CAM_FRONT_LEFT; free that one",
        ),
        ([Parameter("x", (LEFT,), 2, 1, 0.1)], "the lower bound 2 must be below the upper 1"),
        ([Parameter("x", (LEFT,), 1.4, 1.4, 0)], "must be below"),
        ([Parameter("x", (LEFT,), 1, 2, 5)], "the step 5 does not fit"),
        ([Parameter("x", (LEFT,), 1, 2, -0.1)], "the step -0.1 does not fit"),
        ([Parameter("hfov", (LEFT,), 0, 90, 1)], "inside (0, 180) degrees, got 0 to 90"),
        ([Parameter("hfov", (LEFT,), -80, 20, 1, relative=True)], "got -10 to 90"),
        ([Parameter("height", (LEFT,), 0, 900, 2)], "min and step must be even and positive, got 0 and 2"),
        ([Parameter("height", (LEFT,), 400, 900, 0)], "must be even and positive, got 400 and 0"),
        ([Parameter("height", (LEFT,), 401, 900, 2)], "must be even and positive, got 401 and 2"),
        ([Parameter("height", (LEFT,), -5, 4, 2, relative=True)], "got 895 and 2"),
        ([Parameter("depth_limit", (), 0, 90, 1)], "must be a positive number of metres"),
        ([Parameter("depth_limit", (), -60, 60, 1, relative=True)], "must be a positive number of metres, got -10"),
        ([Parameter("x", (LEFT,), 2, 3, 0.1)], "roof-6x70 starts at 1.4, outside of the bounds 2 to 3"),
        (
            [Parameter("x", (LEFT,), 0, 2, 0.1), Parameter("x", (LEFT,), 0, 3, 0.1)],
            "x of CAM_FRONT_LEFT is free twice",
        ),
        ([Parameter("depth_limit", (), 20, 60, 1)] * 2, "depth_limit is free twice"),
    ],
)
def test_spaces_that_cannot_be(parameters: list[Parameter], words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        space(*parameters, mirror=MIRROR)


def test_heights_of_several_cameras_stay_even() -> None:
    cameras = list(load_gallery_rig("roof-6x70").cameras)
    cameras[0] = replace(cameras[0], lens=Pinhole.from_hfov(70, 1600, 901))
    start = replace(load_gallery_rig("roof-6x70"), cameras=tuple(cameras))
    with pytest.raises(UsageError, match="must be even and positive, got 801 and 2"):
        space(Parameter("height", (LEFT, "CAM_FRONT"), -100, 100, 2, relative=True), start=start)


def test_a_lens_of_its_own_has_no_single_field_of_view() -> None:
    with pytest.raises(UsageError, match="has intrinsics of its own"):
        space(Parameter("hfov", ("CAM_FRONT",), 50, 90, 1), start=load_gallery_rig("unidrive-released-6x60"))


@pytest.mark.parametrize(
    ("mirror", "words"),
    [
        ({"CAM_BACK": "CAM_FRONT", "CAM_FRONT": "CAM_BACK"}, "CAM_BACK follows CAM_FRONT, which follows CAM_BACK"),
        ({"CAM_BACK": "CAM_BACK"}, "CAM_BACK follows CAM_BACK"),
        ({"CAM_LEFT": "CAM_FRONT"}, "pair has no camera CAM_LEFT"),
        ({"CAM_BACK": "CAM_LEFT"}, "pair has no camera CAM_LEFT"),
    ],
)
def test_mirrors_that_cannot_be(mirror: dict[str, str], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        space(Parameter("x", ("CAM_FRONT",), 0, 2, 0.1), start=pair(), mirror=mirror)
