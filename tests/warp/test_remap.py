"""Remap tables: nothing lost by cropping, weights that sum to one, few remaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.frames import render_samples
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse, pose, rotation_from_yaw_pitch_roll
from unidrive_cli.geometry.scene import GroundPlane
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.opencv_kernel import OpenCVRenderer
from unidrive_cli.warp.pictures import Picture
from unidrive_cli.warp.reduction import Copies
from unidrive_cli.warp.remap import Source, VirtualView, build_patches, coverage, dominant_sources


@st.composite
def cameras(draw: st.DrawFn, channel: str = "CAM") -> Camera:
    width, height = draw(st.integers(20, 160)), draw(st.integers(20, 120))
    angles = draw(st.floats(-180, 180)), draw(st.floats(-40, 40)), draw(st.floats(-180, 180))
    place = [draw(st.floats(-2, 2)), draw(st.floats(-1, 1)), draw(st.floats(0.8, 2.5))]
    lens = Pinhole.from_hfov(draw(st.floats(30, 120)), width, height)
    return Camera(channel, lens, pose(rotation_from_yaw_pitch_roll(*angles), place))


def source_of(camera: Camera) -> Source:
    return Source(camera.lens, inverse(camera.ego_from_cam))


def view_of(camera: Camera, depth_limit_m: float = 30.0) -> VirtualView:
    return VirtualView(camera, depth_limit_m, GroundPlane())


@settings(max_examples=150, deadline=None)
@given(cameras(), cameras())
def test_cropping_to_the_overlap_loses_no_pixel(virtual: Camera, real: Camera) -> None:
    view, source = view_of(virtual), source_of(real)
    patches = build_patches(view, [source], "angular")
    pixels, valid = source.lens.project(view.points(source.cam_from_ego, slice(None), slice(None)))
    found = np.zeros_like(valid)
    for patch in patches:
        found[patch.box] = patch.valid
        np.testing.assert_allclose(patch.pixels[patch.valid], pixels[patch.box][patch.valid], atol=1e-3)
        assert patch.valid.any(axis=0)[[0, -1]].all()
        assert patch.valid.any(axis=1)[[0, -1]].all()
    np.testing.assert_array_equal(found, valid)


@settings(max_examples=60, deadline=None)
@given(cameras(), st.lists(cameras(), min_size=2, max_size=4), st.sampled_from(["angular", "nearest"]))
def test_several_sources_cover_what_each_covers(virtual: Camera, real: list[Camera], blend: str) -> None:
    """Shares that are dropped, and pixels that another source wins, stay covered."""
    view, sources = view_of(virtual), [source_of(camera) for camera in real]
    alone = [coverage(view, build_patches(view, [source], "angular")) for source in sources]
    np.testing.assert_array_equal(coverage(view, build_patches(view, sources, blend)), np.max(alone, axis=0))


@settings(max_examples=60, deadline=None)
@given(cameras(), st.lists(cameras(), min_size=1, max_size=4), st.sampled_from(["angular", "nearest"]))
def test_weights_sum_to_one_where_covered(virtual: Camera, real: list[Camera], blend: str) -> None:
    view = view_of(virtual)
    patches = build_patches(view, [source_of(camera) for camera in real], blend)
    total = np.zeros((virtual.lens.height_px, virtual.lens.width_px))
    for patch in patches:
        assert (patch.weight[~patch.valid] == 0).all()
        total[patch.box] += patch.weight
    covered = coverage(view, patches) > 0
    np.testing.assert_allclose(total[covered], 1, atol=1e-5)
    assert not total[~covered].any()


@settings(max_examples=40, deadline=None)
@given(cameras(), st.lists(cameras(), min_size=2, max_size=4))
def test_nearest_gives_each_pixel_to_the_source_with_the_largest_weight(virtual: Camera, real: list[Camera]) -> None:
    view, sources = view_of(virtual), [source_of(camera) for camera in real]
    shape = (len(real), virtual.lens.height_px, virtual.lens.width_px)
    mixed, owner = np.zeros(shape), np.zeros(shape)
    for patch in build_patches(view, sources, "angular"):
        mixed[patch.source][patch.box] = patch.weight
    for patch in build_patches(view, sources, "nearest"):
        owner[patch.source][patch.box] = patch.valid
    covered = mixed.any(axis=0)
    np.testing.assert_array_equal(owner.sum(axis=0), covered)
    assert (mixed.max(axis=0)[covered] <= (mixed * owner).sum(axis=0)[covered] + 1e-6).all()


@settings(max_examples=40, deadline=None)
@given(cameras(), st.lists(cameras(), min_size=1, max_size=4), st.sampled_from(["angular", "nearest"]))
def test_the_dominant_source_is_the_one_with_the_largest_weight(
    virtual: Camera, real: list[Camera], blend: str
) -> None:
    view = view_of(virtual)
    patches = build_patches(view, [source_of(camera) for camera in real], blend)
    weight = np.zeros((len(real), virtual.lens.height_px, virtual.lens.width_px), dtype=np.float32)
    for patch in patches:
        weight[patch.source][patch.box] = patch.weight
    expected = np.where(coverage(view, patches) > 0, weight.argmax(axis=0), -1)
    np.testing.assert_array_equal(dominant_sources(view, patches), expected)


def test_weights_have_no_step_where_a_source_begins() -> None:
    """Two level 90-degree cameras, 60 degrees apart, half a metre apart, seen by one between them."""
    at = {yaw: Camera("C", Pinhole.from_hfov(90, 800, 600), _level(yaw, y)) for yaw, y in ((30, 0.25), (-30, -0.25))}
    virtual = Camera("V", Pinhole.from_hfov(80, 1600, 900), _level(0, 0.0))
    patches = build_patches(view_of(virtual, 50.0), [source_of(camera) for camera in at.values()], "angular")
    weight = np.zeros((2, 900, 1600))
    for patch in patches:
        weight[patch.source][patch.box] = patch.weight
    both = (weight > 0).all(axis=0)
    assert both.mean() > 0.2
    inside = both[:, 1:] | both[:, :-1]
    covered = weight.any(axis=0)
    step = np.abs(np.diff(weight[0], axis=1))[inside & covered[:, 1:] & covered[:, :-1]]
    assert step.max() < 0.02


def test_cameras_that_just_touch_leave_no_black_columns() -> None:
    """Six 60-degree cameras at one place cover the circle exactly; a view across their borders is whole."""
    rig = load_gallery_rig("6x60")
    between = Camera("V", Pinhole.from_hfov(100, 1000, 200), rig.cameras[0].ego_from_cam @ _turn(30))
    view = view_of(between, 50.0)
    assert coverage(view, build_patches(view, [source_of(camera) for camera in rig.cameras], "angular")).all()


def test_above_the_horizon_no_pixel_takes_ground_from_behind() -> None:
    """Eq. 1 alone puts such pixels on a ground point behind the camera (geometry.md): only the camera
    that looks back sees the ground there, and it must not show in a view ahead."""
    ahead = Camera("V", Pinhole.from_hfov(70, 320, 180), _level(0, 0.0))
    back = Camera("B", Pinhole.from_hfov(120, 320, 180), _level(180, 0.0))
    view = view_of(ahead)
    assert not build_patches(view, [source_of(back)], "angular")
    points = view.points(np.eye(4), slice(None), slice(None))
    assert (points[:90, :, 2] >= 1.6).all()
    assert (points[..., 0] > 0).all()


def test_remaps_only_where_pairs_overlap(shared_data: Path) -> None:
    """16 of the 36 (virtual, source) pairs of the real keyframe overlap; every one costs a remap."""
    (frame,) = render_samples(shared_data / "nuscenes-onekeyframe", load_gallery_rig("roof-6x70"))
    assert sum(len(view.sources) for view in frame.tables.values()) == 16


def test_tables_are_kept_while_nothing_moves() -> None:
    rig = Rig("r", "", (Camera("V", Pinhole.from_hfov(70, 160, 90), _level(0, 0.0)),))
    renderer = OpenCVRenderer(rig, WarpChoices())
    still = [source_of(rig.cameras[0])]
    first = renderer.tables(still)
    assert renderer.tables([source_of(rig.cameras[0])]) is first
    moved = [Source(rig.cameras[0].lens, inverse(_level(1, 0.0)))]
    assert renderer.tables(moved) is not first


@pytest.mark.parametrize(("blend", "middle"), [("angular", (90, 110)), ("nearest", (50, 50, 150, 150))])
def test_two_grey_sources_mix_or_decide(blend: str, middle: tuple[int, ...]) -> None:
    """Left and right camera are mirror images: half and half in the middle, one of them beside it."""
    real = [Camera("C", Pinhole.from_hfov(90, 400, 300), _level(yaw, 0.0)) for yaw in (30, -30)]
    rig = Rig("r", "", (Camera("V", Pinhole.from_hfov(80, 400, 200), _level(0, 0.0)),))
    grey: list[Picture] = [np.full((300, 400, 3), level, dtype=np.uint8) for level in (50, 150)]
    (view,) = OpenCVRenderer(rig, WarpChoices(blend=blend)).tables([source_of(camera) for camera in real])
    picture = view.render(Copies(grey))
    assert (picture[100, 0] == 50).all()
    assert (picture[100, -1] == 150).all()
    assert set(picture[100, 199:201].ravel()) <= set(range(middle[0], middle[-1] + 1))
    if blend == "nearest":
        assert set(np.unique(picture)) == {50, 150}


def _level(yaw_deg: float, y_m: float) -> np.ndarray:
    return pose(rotation_from_yaw_pitch_roll(yaw_deg, 0, 0), [0.0, y_m, 1.6])


def _turn(yaw_deg: float) -> np.ndarray:
    """cam_from_cam of a turn to the left round the camera's own vertical."""
    angle = np.deg2rad(-yaw_deg)
    c, s = np.cos(angle), np.sin(angle)
    return pose(np.array([[c, 0, s], [0, 1.0, 0], [-s, 0, c]]), [0.0, 0, 0])
