"""Common coverage: what rigs fill, known beforehand, and pixels blackened as if nobody had seen them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unidrive_cli.errors import UsageError
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.warp.common import Blanks, CommonMasks, common_masks, covered_share, fill
from unidrive_cli.warp.remap import Mask, Source, VirtualView, build_patches, coverage, virtual_views


def ring(count: int, hfov: float, *, x: float = 1.0, width: int = 161, height: int = 90, leave_out: int = -1) -> Rig:
    """Cameras at one place, all the way round."""
    size = f"width: {width}, height: {height}, hfov: {hfov}"
    lines = [
        f"  CAM_{n}: {{{size}, position: [{x}, 0, 1.5], yaw: {n * 360 / count}}}"
        for n in range(count)
        if n != leave_out
    ]
    return parse_rig("\n".join([f"name: ring-{count}-{hfov:g}", "cameras:", *lines]) + "\n", "ring.yaml")


def views_of(rig: Rig) -> list[VirtualView]:
    return virtual_views(rig, 50.0, 0.0)


def static_coverage(view: VirtualView, rig: Rig) -> Mask:
    sources = [Source(camera.lens, inverse(camera.ego_from_cam)) for camera in rig.cameras]
    return coverage(view, build_patches(view, sources, "angular"))


def test_six_60_degree_cameras_at_one_place_fill_each_other_whole() -> None:
    rig = ring(6, 60)
    for mask in common_masks(views_of(rig), [rig], 0.0).masks():
        assert (mask == 255).all()


def test_a_camera_less_blanks_its_sector_and_nothing_else() -> None:
    whole, less = ring(6, 60), ring(6, 60, leave_out=2)
    found = common_masks(views_of(whole), [whole, less], 0.0)
    assert found.shares == (1, 1, 0, 1, 1, 1)


@pytest.mark.parametrize("names", [["5x70+110"], ["4x95", "8x50"], ["6x80b", "nuscenes-like", "5x75"]])
def test_without_a_stretch_common_is_the_and_of_the_static_coverages(names: list[str]) -> None:
    rigs = [load_gallery_rig(name) for name in names]
    virtual = ring(4, 80, width=200, height=112)
    for view, mask in zip(views_of(virtual), common_masks(views_of(virtual), rigs, 0.0).masks(), strict=True):
        expected = np.minimum.reduce([static_coverage(view, rig) for rig in rigs])
        np.testing.assert_array_equal(mask, expected)


@settings(max_examples=6)
@given(st.floats(0.01, 3), st.floats(0, 1), st.sampled_from(["5x70+110", "6x60", "nuscenes-like"]))
def test_what_is_common_is_filled_from_wherever_the_cameras_stood(stretch_m: float, part: float, name: str) -> None:
    virtual, rig = ring(3, 70, width=120, height=80), load_gallery_rig(name)
    moved = []
    for index, camera in enumerate(rig.cameras):
        pose = np.array(camera.ego_from_cam)
        pose[0, 3] -= stretch_m * (part if index % 2 else 1 - part)
        moved.append(replace(camera, ego_from_cam=pose))
    there = replace(rig, cameras=tuple(moved))
    swept = common_masks(views_of(virtual), [rig], stretch_m).masks()
    still = common_masks(views_of(virtual), [rig], 0.0).masks()
    for view, mask, unmoved in zip(views_of(virtual), swept, still, strict=True):
        assert (mask <= unmoved).all()
        assert (mask <= static_coverage(view, there)).all()


def test_each_rig_alone_and_in_common() -> None:
    virtual = ring(4, 50)
    shares = fill(views_of(virtual), [ring(6, 60), ring(6, 60, leave_out=0)], 0.5)
    for by_rig, common in zip(shares.by_rig, shares.common, strict=True):
        assert by_rig[0] == 1
        assert common <= by_rig[1]
    assert shares.common[0] == shares.by_rig[0][1] == 0
    assert shares.common[2] > 0.9


@pytest.mark.parametrize("name", ["5x70+110", "nuscenes-like"])
def test_the_share_of_a_grid_is_that_of_all_pixels(name: str) -> None:
    virtual, rig = ring(4, 80, width=400, height=240), load_gallery_rig(name)
    sources = [Source(camera.lens, inverse(camera.ego_from_cam)) for camera in rig.cameras]
    for view in views_of(virtual):
        whole = static_coverage(view, rig)
        assert covered_share(view, sources) == pytest.approx((whole > 0).mean(), abs=0.005)
        left = np.zeros_like(whole)
        left[:, :200] = 255
        assert covered_share(view, sources, left) == pytest.approx((whole[:, :200] > 0).mean() / 2, abs=0.005)


def test_the_grid_of_a_small_picture_is_all_of_it() -> None:
    view = views_of(ring(1, 60, width=64, height=36))[0]
    one = ring(6, 20)
    sources = [Source(camera.lens, inverse(camera.ego_from_cam)) for camera in one.cameras]
    assert covered_share(view, sources) == (static_coverage(view, one) > 0).mean()
    assert covered_share(view, []) == 0


def test_nothing_in_common_is_refused() -> None:
    front, back = (replace(ring(2, 60, leave_out=n), name=name) for n, name in ((1, "front"), (0, "back")))
    with pytest.raises(UsageError, match="no virtual pixel can be filled by all of front, back"):
        common_masks(views_of(ring(6, 60)), [front, back], 0.0)


@pytest.mark.parametrize("sweep_m", [-0.1, 101, float("nan")])
def test_stretches_that_are_no_length(sweep_m: float) -> None:
    with pytest.raises(UsageError, match="--common-sweep must be from 0 to 100 metres"):
        common_masks(views_of(ring(6, 60)), [ring(6, 60)], sweep_m)


@settings(max_examples=25)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_masks_come_back_from_their_pack(width: int, height: int, seed: int) -> None:
    masks = [np.random.default_rng(seed).integers(0, 2, (height, width)).astype(bool)] * 2
    packed = CommonMasks.of(masks)
    assert packed.shares == (pytest.approx(masks[0].mean(), abs=1e-6),) * 2
    for mask, found in zip(masks, packed.masks(), strict=True):
        np.testing.assert_array_equal(found, mask * 255)


def test_blanked_planes_are_black_where_nothing_is_common_and_untouched_elsewhere() -> None:
    common = np.full((5, 7), 255, dtype=np.uint8)
    common[1, 3] = common[4, 6] = 0  # one of four pixels of a chroma sample; the only pixel of another
    common[2:4, 0:2] = 0
    luma, *chroma = (np.full(shape, 77, dtype=np.uint8) for shape in ((5, 7), (3, 4), (3, 4)))
    blanks = Blanks(common)
    blanks.blank_planes((luma, *chroma))
    np.testing.assert_array_equal(luma, np.where(common, 77, 0))
    for plane in chroma:
        assert (plane[1, 0], plane[2, 3]) == (128, 128)
        assert np.count_nonzero(plane == 77) == 10
    picture, mask = np.full((5, 7, 3), 77, dtype=np.uint8), np.full((5, 7), 255, dtype=np.uint8)
    mask[0, 0] = 0
    blanks.blank(picture)
    blanks.cover(mask)
    np.testing.assert_array_equal(picture, np.where(common[..., None], [77] * 3, 0))
    assert np.count_nonzero(mask) == 35 - 6 - 1
