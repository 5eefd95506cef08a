"""The own car in source pictures: what is hidden is never sampled, whatever else sees it takes its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.geometry.test_distorted_lenses import each_lens
from tests.warp.test_fused import drawn as draw_luma
from tests.warp.test_reduction import HEIGHT, WIDTH, camera, photograph, renderer_of, toolchain, written
from tests.warp.test_remap import cameras, source_of, view_of
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.rig.model import Camera
from unidrive_cli.warp.own_car import OwnCar, hidden_of
from unidrive_cli.warp.pictures import Picture
from unidrive_cli.warp.remap import Source, build_patches, coverage
from unidrive_cli.warp.render import Toolchain

__all__ = ["toolchain"]
MAGENTA, GREEN = (255, 0, 255), (60, 140, 60)


def bonnet(width: int, height: int) -> Bool:
    """A round bonnet below, and a mirror on the left."""
    mask = np.zeros((height, width), np.uint8)
    cv2.ellipse(mask, (width // 2, height), (width // 3, height // 4), 0, 0, 360, 1, -1)
    mask[height // 3 : height // 2, : width // 9] = 1
    return mask > 0


def with_car(source: Source, mask: Bool) -> Source:
    return replace(source, own_car=OwnCar.of(mask))


def drawn(toolchain: Toolchain, virtual: Camera, paths: list[Path], sources: list[Source]) -> tuple[Picture, Bool]:
    (picture,) = renderer_of(toolchain, virtual).render(paths, sources, 100, "")
    return simplejpeg.decode_jpeg(picture.jpeg, colorspace="BGR"), picture.mask > 0


@pytest.mark.parametrize("shape", [(45, 80), (1, 1), (33, 7)])
def test_a_mask_is_packed_whole(shape: tuple[int, int]) -> None:
    mask = np.random.default_rng(0).random(shape) < 0.3
    np.testing.assert_array_equal(OwnCar.of(mask).mask, mask)


@pytest.mark.parametrize(("n", "reach"), [(1.0, 3), (1.25, 4), (2.0, 6)])
def test_what_a_sample_of_colour_would_touch_is_hidden_too(n: float, reach: int) -> None:
    mask = np.zeros((45, 80), bool)
    mask[20, 0] = mask[30, 40] = True
    wide = np.zeros_like(mask)
    wide[20 - reach : 21 + reach, : 1 + reach] = True
    wide[30 - reach : 31 + reach, 40 - reach : 41 + reach] = True
    pixels = np.stack(np.meshgrid(np.arange(80), np.arange(45)), axis=-1)
    for aside in (-0.49, 0.0, 0.49):
        np.testing.assert_array_equal(hidden_of(OwnCar.of(mask), n).holds(pixels + aside), wide)


def test_alone_it_leaves_a_black_hole_and_nothing_else_changes(tmp_path: Path, toolchain: Toolchain) -> None:
    """The virtual camera is the source: each pixel shows the one with its own coordinates."""
    source, mask = source_of(camera()), bonnet(WIDTH, HEIGHT)
    path = written(tmp_path / "s.png", photograph((HEIGHT, WIDTH), 3))
    whole, _ = drawn(toolchain, camera(), [path], [source])
    holed, covered = drawn(toolchain, camera(), [path], [with_car(source, mask)])
    expected = cv2.dilate(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) == 0
    np.testing.assert_array_equal(covered, expected)
    blocks = cv2.dilate((~expected).astype(np.uint8), np.ones((33, 33), np.uint8)) > 0  # JPEG's
    assert np.array_equal(holed[~blocks], whole[~blocks])
    assert blocks.mean() < 0.9
    deep = cv2.erode((~expected).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert holed[deep].max() <= 40


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_its_colour_is_nowhere_and_another_source_takes_its_place(
    tmp_path: Path, toolchain: Toolchain, factor: float
) -> None:
    source = source_of(camera(factor, hfov_deg=75, yaw_deg=3))
    mask = bonnet(source.lens.width_px, source.lens.height_px)
    car = np.full((*mask.shape, 3), GREEN, np.uint8)
    car[mask] = MAGENTA
    paths = [written(tmp_path / "car.png", car)]
    alone, covered = drawn(toolchain, camera(), paths, [with_car(source, mask)])
    assert 0.1 < 1 - covered.mean() < 0.9
    paths.append(written(tmp_path / "green.png", np.full((HEIGHT, WIDTH, 3), GREEN, np.uint8)))
    both, covered = drawn(toolchain, camera(), paths, [with_car(source, mask), source_of(camera())])
    assert covered.all()
    assert np.abs(both.astype(int) - GREEN).max() <= 4
    assert (alone[..., 0] <= 255 * 0.5).all()
    assert (alone[..., 2] <= 255 * 0.5).all()


def test_a_mask_that_hides_nothing_changes_no_byte(tmp_path: Path, toolchain: Toolchain) -> None:
    path = written(tmp_path / "s.png", photograph((HEIGHT, WIDTH), 3))
    files = [
        next(iter(renderer_of(toolchain, camera()).render([path], [source], 95, ""))).jpeg
        for source in (source_of(camera()), with_car(source_of(camera()), np.zeros((HEIGHT, WIDTH), bool)))
    ]
    assert files[0] == files[1]


@each_lens
def test_a_lens_with_distortion_hides_the_same(lens: Lens) -> None:
    source = Source(lens, source_of(camera()).cam_from_ego)
    view = view_of(camera(4, hfov_deg=90, yaw_deg=5))
    bare = coverage(view, build_patches(view, [source], "angular"))
    mask = np.roll(bonnet(lens.width_px, lens.height_px), -lens.height_px * 2 // 5, axis=0)
    source = with_car(source, mask)
    exact = coverage(view, build_patches(view, [source], "angular"))
    assert np.count_nonzero(bare != exact) > 500
    luma = np.full((lens.height_px, lens.width_px), 150, np.uint8)
    canvas = draw_luma(view, [source], [luma], blend="angular")
    assert np.count_nonzero(canvas.mask != exact) <= 20  # of 230,400: float32 places by the mask's edge


def test_halfway_between_two_pixels_the_kernels_agree() -> None:
    """The source is a row shorter than the virtual camera: every pixel falls exactly between two of its rows."""
    virtual = Camera("V", Pinhole(37.3, 37.3, 9.5, 11.0, 20, 23), camera().ego_from_cam)
    mask = np.zeros((22, 20), bool)
    mask[11, 8:12] = True
    source = with_car(replace(source_of(virtual), lens=Pinhole(37.3, 37.3, 9.5, 10.5, 20, 22)), mask)
    view = view_of(virtual)
    exact = coverage(view, build_patches(view, [source], "angular"))
    canvas = draw_luma(view, [source], [np.full((22, 20), 150, np.uint8)], blend="angular")
    np.testing.assert_array_equal(canvas.mask, exact)
    assert (exact == 0).any()


@settings(max_examples=60, deadline=None)
@given(cameras(), st.lists(cameras(), min_size=1, max_size=3), st.integers(0, 2**32 - 1), st.data())
def test_the_kernels_cover_the_same(virtual: Camera, real: list[Camera], seed: int, data: st.DataObject) -> None:
    """Any pose, any size, masks of any form, some sources without one."""
    rng, sources = np.random.default_rng(seed), []
    for one in real:
        source, lens = source_of(one), one.lens
        if data.draw(st.booleans()):
            coarse = rng.random((5, 6)) < data.draw(st.floats(0, 0.5))
            size = lens.width_px, lens.height_px
            grown = cv2.resize(coarse.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
            source = with_car(source, grown > 0)
        sources.append(source)
    view = view_of(virtual)
    mask = coverage(view, build_patches(view, sources, "angular"))
    lumas = [np.full((s.lens.height_px, s.lens.width_px), 150, np.uint8) for s in sources]
    canvas = draw_luma(view, sources, lumas, blend="angular")
    assert np.count_nonzero(canvas.mask != mask) <= 2  # a place that is rounded the other way
    np.testing.assert_array_equal(canvas.planes[0], np.where(canvas.mask > 0, 150, 0))
