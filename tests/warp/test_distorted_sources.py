"""Sources with lens distortion: pixels where the lens puts them, and nothing of what folds back."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.frames import psnr_db
from tests.geometry.test_distorted_lenses import STRONG, any_lens, each_lens
from tests.warp.test_fused import drawn, exact, moved_sources, texture
from tests.warp.test_remap import cameras, source_of, view_of
from unidrive_cli.geometry.lenses import Lens, Pinhole, lens_of
from unidrive_cli.geometry.poses import pose, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.opencv_kernel import OpenCVRenderer, ViewTables
from unidrive_cli.warp.reduction import Copies, shrinkage
from unidrive_cli.warp.remap import Source, VirtualView, build_patches, coverage

numba = pytest.importorskip("numba", reason="the fused kernel needs numba")

from unidrive_cli.warp import fused  # noqa: E402
from unidrive_cli.warp.lens_numbers import lens_numbers, numbers_of_all  # noqa: E402
from unidrive_cli.warp.planar import Canvas, PlanarRenderer, source_models  # noqa: E402

Float = npt.NDArray[np.float64]
AHEAD = [1.4, 0.0, 1.6]


@numba.njit
def placed(xs, xs32, ys, scene, models, layout, lenses, hidden, runs, seen, floats, places, out):  # type: ignore[no-untyped-def]
    """(H, W, 2) pixels of one source as the kernel places them; NaN where it says that it does not see them."""
    out[:] = np.nan
    sources = np.zeros(1, np.int64)
    for row in range(ys.size):
        count = fused._runs(
            xs, xs32, ys[row], scene, models, layout, lenses, hidden, sources, 1, runs, seen, floats, places
        )
        for k in range(count):
            for i in range(runs[k, 0], runs[k, 1]):
                out[row, i, 0], out[row, i, 1] = places[0, i], places[1, i]


def placed_by_kernel(view: VirtualView, source: Source) -> Float:
    canvas, (lenses, _) = Canvas(view), numbers_of_all((source.lens,))
    xs, ys = canvas.xs[0], canvas.ys[0]
    out = np.empty((len(ys), len(xs), 2))
    runs, _, _, _, seen, _, _, floats, places = fused.scratch(len(xs), 1)
    xs32 = np.append(xs, np.zeros(fused.LANES)).astype(np.float32)
    models = source_models(view, [source], (1.0,), np.zeros((1, 5), np.int64))
    layout, hidden = np.zeros((1, fused.LAYOUT_COLUMNS), np.int64), np.zeros(1, np.uint8)
    placed(xs, xs32, ys, canvas.scene, models, layout, lenses, hidden, runs, seen, floats, places, out)
    return out


def camera(lens: Lens, yaw_deg: float, pitch_deg: float = 0.0, at: list[float] | None = None) -> Camera:
    return Camera("CAM", lens, pose(rotation_from_yaw_pitch_roll(yaw_deg, pitch_deg, 0.0), at or AHEAD))


WIDE_VIEWS = [
    view_of(camera(Pinhole.from_hfov(110, 800, 450), 0, -8, [1.6, 0.2, 1.5])),
    view_of(camera(Pinhole.from_hfov(120, 800, 450), 95, 3, [1.0, 0.5, 1.7])),
    view_of(camera(Pinhole.from_hfov(40, 800, 450), 30, -20)),
]


@each_lens
def test_every_pixel_looks_where_the_lens_says(lens: Lens) -> None:
    """All pixels of three views, from a camera elsewhere: to 0.001 px (asked: 0.1), and seen exactly where seen."""
    source, compared = source_of(camera(lens, 3, 2)), 0
    for view in WIDE_VIEWS:
        found = placed_by_kernel(view, source)
        pixels, inside = lens.project(view.points(source.cam_from_ego, slice(None), slice(None)))
        np.testing.assert_array_equal(np.isfinite(found[..., 0]), inside)
        compared += int(inside.sum())
        if inside.any():
            assert np.abs(found[inside] - pixels[inside]).max() <= 1e-3
    assert compared > 150_000


@settings(max_examples=30, deadline=None)
@given(any_lens, cameras(), st.floats(-180, 180), st.floats(-40, 40))
def test_pixels_of_any_lens(lens: Lens, virtual: Camera, yaw_deg: float, pitch_deg: float) -> None:
    """The kernel's single precision is checked for each lens, and not used where it would not do."""
    view, source = view_of(virtual), source_of(camera(lens, yaw_deg, pitch_deg))
    mask = coverage(view, build_patches(view, [source], "angular"))
    if lens.model == "pinhole":
        return
    found = placed_by_kernel(view, source)
    np.testing.assert_array_equal(np.isfinite(found[..., 0]), mask > 0)
    pixels, inside = lens.project(view.points(source.cam_from_ego, slice(None), slice(None)))
    assert np.abs(found[inside] - pixels[inside]).max(initial=0) <= 0.1


def test_a_lens_that_single_precision_does_not_do_for_is_worked_out_in_float64() -> None:
    assert lens_numbers(STRONG["fisheye of everything"]).row[fused.EXACT]
    assert not lens_numbers(STRONG["real"]).row[fused.EXACT]


MIXED = ("real", "fisheye of 177 degrees", "rational", "prism", "barrel that ends in the picture", "pincushion")


def mixed_sources() -> list[Source]:
    """Six cameras all round, each with another lens, from a car that drives and turns."""
    rig = load_gallery_rig("6x80a")
    bent = [replace(one, lens=STRONG[name]) for one, name in zip(rig.cameras, MIXED, strict=True)]
    return moved_sources(replace(rig, cameras=tuple(bent)))


def test_luma_of_blended_sources_is_the_exact_luma() -> None:
    sources = mixed_sources()
    lumas = [texture((s.lens.width_px, s.lens.height_px), seed) for seed, s in enumerate(sources)]
    for view in WIDE_VIEWS[:2]:
        patches = build_patches(view, sources, "angular")
        canvas = drawn(view, sources, lumas, blend="angular")
        np.testing.assert_array_equal(canvas.mask, coverage(view, patches))
        assert psnr_db(canvas.planes[0], exact(view, sources, lumas, patches)) >= 50


@pytest.mark.parametrize("model", ["opencv", "fisheye"])
@pytest.mark.parametrize("size", [(401, 251), (151, 95)])
def test_both_kernels_draw_the_same_picture_of_files(tmp_path: Path, model: str, size: tuple[int, int]) -> None:
    """Colours included: two cameras that overlap, of an odd size; shrunk so much that copies are sampled, or not."""
    bent = [0.1, -0.02, 1e-3, -2e-3, 0.01] if model == "opencv" else [-0.05, 0.01, -2e-3, 1e-4]
    lens = lens_of(Pinhole(260.0, 255.0, 198.0, 131.0, 401, 251), model, bent)
    x, y = np.meshgrid(np.linspace(0, 1, 401), np.linspace(0, 1, 251))
    picture = np.stack([60 + 120 * x, 90 + 80 * y, 160 - 100 * x * y], axis=-1).astype(np.uint8)
    picture[90:130, 100:210] += 40
    paths = [tmp_path / "left.png", tmp_path / "right.png"]
    for path in paths:
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    sources = [source_of(camera(lens, yaw)) for yaw in (20, -20)]
    rig = Rig("r", "", (camera(Pinhole.from_hfov(95, *size), 0, -3, [1.5, 0.1, 1.6]),))
    assert (shrinkage(view_of(rig.cameras[0]), sources[0]) > 1.95) == (size[0] < 200)
    (fast,) = PlanarRenderer(rig, WarpChoices(), "simplejpeg").render(paths, sources, 95, "")
    mask = fast.mask.copy()
    (slow,) = OpenCVRenderer(rig, WarpChoices()).render(paths, sources, 95, "")
    np.testing.assert_array_equal(mask, slow.mask)
    assert mask.mean() > 128
    pictures = [cv2.imdecode(np.frombuffer(one.jpeg, np.uint8), cv2.IMREAD_COLOR) for one in (fast, slow)]
    assert psnr_db(*pictures) >= 38


# --- what folds back ---------------------------------------------------------------------------------

FOLD_DEG = 95.0
"""f theta (1 - k theta^2) turns at 3 k theta^2 = 1: a field of 190 degrees."""
FOLDING = lens_of(
    Pinhole(240.0, 240.0, 499.5, 499.5, 1000, 1000), "fisheye", [-1 / (3 * math.radians(FOLD_DEG) ** 2), 0, 0, 0]
)
PER_PX = 0.6
"""Grey levels to a pixel of the source's radius: the picture says how far from its centre it was sampled."""


def cones() -> npt.NDArray[np.uint8]:
    """Grey 20 + 0.6 r, and white beyond the circle that the lens's field ends at."""
    across, down = np.meshgrid(np.arange(1000) - 499.5, np.arange(1000) - 499.5)
    radius = np.hypot(across, down)
    rim = FOLDING.radius_at(math.radians(FOLD_DEG)) * 240  # type: ignore[attr-defined]
    assert rim < 275
    return np.where(radius > rim + 2, 255, 20 + PER_PX * radius).round().astype(np.uint8)


@pytest.mark.parametrize("kernel", ["numba", "opencv"])
@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(0, 0), (90, 0), (-60, 30), (0, 85), (150, 10), (180, 0)])
def test_at_190_degrees_nothing_folds_back(kernel: str, yaw_deg: float, pitch_deg: float) -> None:
    """From the source's own place a virtual ray is off its axis by an angle known in closed form.

    Up to 95 degrees the pixel has the grey that the polynomial gives; beyond, where the folded polynomial would
    give the same greys in reverse, it is black and not covered.
    """
    virtual = camera(Pinhole.from_hfov(100, 300, 220), yaw_deg, pitch_deg)
    view, source = view_of(virtual), source_of(camera(FOLDING, 0))
    x, y = np.meshgrid((np.arange(300) - 149.5), (np.arange(220) - 109.5))
    rays = np.stack([x / virtual.lens.fx_px, y / virtual.lens.fx_px, np.ones_like(x)], axis=-1)
    forward = rays @ virtual.ego_from_cam[0, :3] / np.linalg.norm(rays, axis=-1)
    theta = np.arccos(np.clip(forward, -1, 1))
    if kernel == "numba":
        canvas = drawn(view, [source], [cones()], blend="angular")
        picture, mask = canvas.planes[0], canvas.mask
    else:
        tables = ViewTables(view, build_patches(view, [source], "angular"), (1.0,))
        pictures = Copies([np.repeat(cones()[..., None], 3, axis=2)])
        picture, mask = tables.render(pictures)[..., 1], tables.mask
    limit = math.radians(FOLD_DEG)
    clear = np.abs(theta - limit) > 1e-6
    np.testing.assert_array_equal(mask[clear] > 0, theta[clear] < limit)
    radius = 240 * theta * (1 - theta**2 / (3 * limit**2))
    seen = mask > 0
    assert not picture[~seen].any()
    assert np.abs(picture[seen] - (20 + PER_PX * radius[seen])).max(initial=0) <= 1.5
    folded = ~seen & (radius > 0) & (radius < 275)
    assert folded.any() == (yaw_deg != 0 or pitch_deg == 85)  # the wrong pictures would be there to see
