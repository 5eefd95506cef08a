"""The fused kernel against the float64 geometry, pixel by pixel."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.warp.test_remap import cameras, source_of, view_of
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.geometry.poses import inverse, pose, rotation_from_quaternion
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import Blend
from unidrive_cli.warp.pictures import read_picture
from unidrive_cli.warp.remap import (
    Patch,
    Source,
    VirtualView,
    build_patches,
    coverage,
    dominant_sources,
    virtual_views,
)

numba = pytest.importorskip("numba", reason="the fused kernel needs numba")

from unidrive_cli.warp import fused  # noqa: E402
from unidrive_cli.warp.planar import Atlas, Canvas, source_models  # noqa: E402

Float = npt.NDArray[np.float64]
Luma = npt.NDArray[np.uint8]
DEPTH_LIMIT_M = 45.0


@numba.njit
def coordinates(xs, xs32, ys, scene, models, layout, j, out):  # type: ignore[no-untyped-def]
    """(H, W, 2) source pixels of one source as the kernel computes them, taken from its own tap indices."""
    width = xs.size
    ints, floats = np.empty((2, xs32.size), np.int32), np.empty((8, xs32.size), np.float32)
    for row in range(ys.size):
        fused._inverse_depth(xs32, 0, width, ys[row], scene, floats)
        fused._project(xs32, floats, 0, width, ys[row], models, layout, j, 0, ints, 0)
        for i in range(width):
            v, u = divmod(ints[0, i], layout[j, fused.STRIDES])
            out[row, i, 0] = u + (ints[1, i] & 255) / 256
            out[row, i, 1] = v + (ints[1, i] >> 8) / 256


def moved_sources(rig: Rig) -> list[Source]:
    """A rig's cameras as sources that fire one after the other from a car that drives and turns."""
    sources = []
    for index, camera in enumerate(rig.cameras):
        share = index / len(rig.cameras)
        turn = rotation_from_quaternion([np.cos(0.01 * share), 0, 0, np.sin(0.01 * share)])
        ego_now_from_then = pose(turn, [0.5 * share, -0.05 * share, 0.01])
        sources.append(Source(camera.lens, inverse(ego_now_from_then @ camera.ego_from_cam)))
    return sources


def drawn(view: VirtualView, sources: list[Source], lumas: list[npt.NDArray[np.uint8]], *, blend: Blend) -> Canvas:
    """The view drawn from sources that have only luma."""
    atlas = Atlas(tuple((source.lens.width_px, source.lens.height_px) for source in sources))
    for row, luma in zip(atlas.layout, lumas, strict=True):
        start, stride = row[fused.PLANES], row[fused.STRIDES]
        rows = atlas.memory[start : start + stride * (luma.shape[0] + 1)].reshape(-1, stride)
        rows[: luma.shape[0], : luma.shape[1]] = luma
    canvas = Canvas(view)
    canvas.draw(atlas, sources, nearest=blend == "nearest")
    return canvas


def bilinear(picture: npt.NDArray[np.uint8], pixels: Float) -> Float:
    """Float64 samples (n,) of a picture at pixels (n, 2), taps clamped at the border."""
    height, width = picture.shape
    u, v = np.clip(pixels[:, 0], 0, width - 1), np.clip(pixels[:, 1], 0, height - 1)
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = u - left, v - top
    upper = picture[top, left] * (1 - x) + picture[top, right] * x
    lower = picture[bottom, left] * (1 - x) + picture[bottom, right] * x
    return upper * (1 - y) + lower * y


def exact(
    view: VirtualView, sources: list[Source], lumas: list[npt.NDArray[np.uint8]], patches: list[Patch]
) -> Float:
    """The blended luma (H, W) in float64."""
    lens = view.camera.lens
    result = np.zeros((lens.height_px, lens.width_px))
    for patch in patches:
        source = sources[patch.source]
        rows, columns = np.nonzero(patch.valid)
        at = rows + patch.box[0].start, columns + patch.box[1].start
        pixels, _ = source.lens.project(view.points_at(source.cam_from_ego, *at))
        result[at] += patch.weight[rows, columns] * bilinear(lumas[patch.source], pixels)
    return result


def texture(size_px: tuple[int, int], seed: int) -> npt.NDArray[np.uint8]:
    """Structure of several scales, with edges, over the whole range of grey."""
    width, height = size_px
    rng = np.random.default_rng(seed)
    noise = sum(
        cv2.GaussianBlur(rng.normal(0, scale, (height, width)), (0, 0), scale) * scale for scale in (2, 8, 30)
    )
    blocks = cv2.resize(rng.uniform(-60, 60, (height // 40, width // 40)), size_px, interpolation=cv2.INTER_NEAREST)
    return np.clip(128 + 12 * noise + blocks, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("real", "virtual"), [("5x70+110", "roof-6x70"), ("6x60", "8x50"), ("4x95", "5x75")])
def test_every_pixel_looks_where_the_geometry_says(real: str, virtual: str) -> None:
    """All pixels of three rigs with ego motion: coordinates to 0.02 px (asked: 0.1), masks exactly.

    So are those in copies that are smaller by 1.25 and 2, in their pixels.
    """
    sources = moved_sources(load_gallery_rig(real))
    worst, compared = 0.0, 0
    for view in virtual_views(load_gallery_rig(virtual), DEPTH_LIMIT_M, 0.0):
        patches = build_patches(view, sources, "angular")
        canvas = drawn(view, sources, [np.zeros((s.lens.height_px, s.lens.width_px), np.uint8) for s in sources],
                       blend="angular")  # fmt: skip
        np.testing.assert_array_equal(canvas.mask, coverage(view, patches))
        assert not (canvas.planes[0] > 0).any()
        reductions = [(1.0, 1.25, 2.0)[index % 3] for index in range(len(sources))]
        models = source_models(view, sources, reductions, np.zeros((len(sources), 5), np.int64))
        copies = tuple((index, n) for index, n in enumerate(reductions) if n > 1)
        atlas = Atlas(tuple((s.lens.width_px, s.lens.height_px) for s in sources), copies)
        layout = atlas.layout_of(reductions)
        out = np.empty((*canvas.mask.shape, 2))
        xs, ys = canvas.xs[0], canvas.ys[0]
        for patch in patches:
            n = reductions[patch.source]
            coordinates(xs, np.append(xs, np.zeros(8)).astype(np.float32), ys, canvas.scene, models, layout,
                        patch.source, out)  # fmt: skip
            in_copy = (patch.pixels + 0.5) / n - 0.5
            at_border = np.clip(in_copy, 0, layout[patch.source, fused.SIZES : fused.SIZES + 2] - 1)
            error = np.abs(out[patch.box] - at_border)[patch.valid]
            worst, compared = max(worst, float(error.max())), compared + len(error)
    assert compared > 4_000_000
    assert worst <= 0.02, worst


@pytest.mark.parametrize("virtual", ["roof-6x70", "8x50"])
def test_luma_is_the_exact_luma(virtual: str) -> None:
    sources = moved_sources(load_gallery_rig("5x70+110"))
    lumas = [texture((s.lens.width_px, s.lens.height_px), seed) for seed, s in enumerate(sources)]
    for view in virtual_views(load_gallery_rig(virtual), DEPTH_LIMIT_M, 0.0)[:3]:
        patches = build_patches(view, sources, "angular")
        truth = exact(view, sources, lumas, patches)
        luma = drawn(view, sources, lumas, blend="angular").planes[0]
        assert 10 * np.log10(255**2 / np.mean((luma - truth) ** 2)) >= 55
        assert np.abs(luma - truth).max() <= 6


def test_luma_of_the_real_keyframe_is_the_exact_luma(shared_data: Path) -> None:
    rig = load_gallery_rig("roof-6x70")
    plan = make_plan(open_dataset(shared_data / "nuscenes-onekeyframe"), rig, Options())
    frame = plan.frame(plan.units[0])
    sources = list(frame.sources)
    lumas = [
        cv2.cvtColor(read_picture(Path(path), (s.lens.width_px, s.lens.height_px)), cv2.COLOR_BGR2GRAY)
        for path, s in zip(frame.paths, sources, strict=True)
    ]
    for view in virtual_views(rig, 50.0, 0.0):
        truth = exact(view, sources, lumas, build_patches(view, sources, "angular"))
        luma = drawn(view, sources, lumas, blend="angular").planes[0]
        assert 10 * np.log10(255**2 / np.mean((luma - truth) ** 2)) >= 55


def test_nearest_takes_the_source_with_the_largest_share() -> None:
    sources = moved_sources(load_gallery_rig("6x80a"))
    levels = np.array([40 * index + 20 for index in range(len(sources))])
    lumas = [np.full((s.lens.height_px, s.lens.width_px), v, np.uint8) for s, v in zip(sources, levels, strict=True)]
    for view in virtual_views(load_gallery_rig("roof-6x70"), DEPTH_LIMIT_M, 0.0)[:2]:
        owner = dominant_sources(view, build_patches(view, sources, "nearest"))
        luma = drawn(view, sources, lumas, blend="nearest").planes[0]
        wrong = luma != np.where(owner < 0, 0, levels[owner])
        assert np.count_nonzero(wrong) <= 50  # float32 weights may tip where two are equal to the sixth digit


@settings(max_examples=80, deadline=None)
@given(cameras(), st.lists(cameras(), min_size=1, max_size=4), st.sampled_from(["angular", "nearest"]))
def test_masks_and_levels_of_any_sources(virtual: Camera, real: list[Camera], blend: Blend) -> None:
    """Any pose, any size (odd ones too), upside down: the mask is the exact one, and a grey world stays grey."""
    view, sources = view_of(virtual), [source_of(camera) for camera in real]
    lumas = [np.full((s.lens.height_px, s.lens.width_px), 150, np.uint8) for s in sources]
    canvas = drawn(view, sources, lumas, blend=blend)
    mask = coverage(view, build_patches(view, sources, "angular"))
    np.testing.assert_array_equal(canvas.mask, mask)
    assert canvas.covered_px == np.count_nonzero(mask)
    np.testing.assert_array_equal(canvas.planes[0], np.where(mask > 0, 150, 0))


def test_memory_that_was_used_leaves_no_trace() -> None:
    sources = moved_sources(load_gallery_rig("5x70+110"))
    other = moved_sources(load_gallery_rig("6x60"))
    view = virtual_views(load_gallery_rig("8x50"), DEPTH_LIMIT_M, 0.0)[0]
    lumas = [texture((s.lens.width_px, s.lens.height_px), seed) for seed, s in enumerate(sources)]
    canvas = drawn(view, sources, lumas, blend="angular")
    first = canvas.planes[0].copy(), canvas.mask.copy()
    atlas = Atlas(tuple((s.lens.width_px, s.lens.height_px) for s in other))
    atlas.memory[:] = 255
    canvas.draw(atlas, other, nearest=False)
    again = drawn(view, sources, lumas, blend="angular")
    np.testing.assert_array_equal(again.planes[0], first[0])
    np.testing.assert_array_equal(again.mask, first[1])
