"""Anti-aliasing: which copy is sampled, what is in it, and what comes out, with both kernels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg

from tests.frames import psnr_db
from tests.warp.test_remap import source_of, view_of
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.lenses.base import MAX_SIDE_PX
from unidrive_cli.geometry.poses import pose, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.pictures import Picture
from unidrive_cli.warp.reduction import MAX_REDUCTION, Reductions, reduced_picture, reduction_of, shrinkage
from unidrive_cli.warp.remap import Source
from unidrive_cli.warp.render import Renderer, Toolchain, open_renderer

WIDTH, HEIGHT = 160, 90
KERNELS = [Toolchain("numba", "simplejpeg"), Toolchain("opencv", "simplejpeg")]


@pytest.fixture(params=KERNELS, ids=lambda toolchain: toolchain.kernel)
def toolchain(request: pytest.FixtureRequest) -> Toolchain:
    if request.param.kernel == "numba":
        pytest.importorskip("numba", reason="the fused kernel needs numba")
    found: Toolchain = request.param
    return found


def camera(scale: float = 1, hfov_deg: float = 70, yaw_deg: float = 0) -> Camera:
    """A camera of 160x90 pixels, or of `scale` times as many along each side."""
    lens = Pinhole.from_hfov(hfov_deg, round(WIDTH * scale), round(HEIGHT * scale))
    return Camera("V", lens, pose(rotation_from_yaw_pitch_roll(yaw_deg, 0, 0), [1.5, 0.0, 1.6]))


def zoomed(factor: float) -> Source:
    """A source at the virtual camera's place whose pixels are `factor` times smaller."""
    lens = camera().pinhole
    centre = (3 * WIDTH - 1) / 2, (3 * HEIGHT - 1) / 2
    return Source(
        Pinhole(lens.fx_px * factor, lens.fy_px * factor, *centre, 3 * WIDTH, 3 * HEIGHT),
        source_of(camera()).cam_from_ego,
    )


def written(path: Path, picture: Picture) -> Path:
    """A file that keeps every pixel."""
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    return path


def rendered(renderer: Renderer, paths: list[Path], sources: list[Source]) -> Picture:
    (picture,) = renderer.render(paths, sources, 100, "")
    return simplejpeg.decode_jpeg(picture.jpeg, colorspace="BGR")


def renderer_of(toolchain: Toolchain, virtual: Camera, *, anti_alias: bool = True) -> Renderer:
    return open_renderer(toolchain, Rig("r", "", (virtual,)), WarpChoices(anti_alias=anti_alias))


# --- which copy -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "n"),
    [(0.2, 1), (1, 1), (1.94, 1), (1.95, 1.25), (2.4, 1.5), (3, 1.75), (np.sqrt(12), 2), (1e3, MAX_REDUCTION)],
)
def test_the_copy_is_smaller_by_the_root_of_three_in_whole_quarters(factor: float, n: float) -> None:
    assert reduction_of(factor) == n


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.5, 2.4, 3.0])
def test_a_source_at_the_same_place_is_shrunk_by_the_ratio_of_the_focal_lengths(factor: float) -> None:
    """Whatever the scene is: both see it along the same rays."""
    assert shrinkage(view_of(camera()), zoomed(factor)) == pytest.approx(factor, rel=1e-9)


def test_off_the_axis_pixels_of_a_turned_source_are_as_large_as_their_angle_says() -> None:
    """A narrow view 40 degrees off a source's axis: a pixel's area there is cos^-3 times that on the axis."""
    narrow = camera(hfov_deg=1)
    wide = camera(scale=4, hfov_deg=100, yaw_deg=40)
    on_axis = wide.pinhole.fx_px / narrow.pinhole.fx_px
    expected = on_axis * np.cos(np.radians(40)) ** -1.5
    assert shrinkage(view_of(narrow), source_of(wide)) == pytest.approx(expected, rel=1e-3)


def test_what_a_source_does_not_see_counts_for_nothing() -> None:
    assert shrinkage(view_of(camera()), source_of(camera(scale=5, yaw_deg=180))) == 1


def test_motion_between_the_cameras_does_not_change_the_copy() -> None:
    """A source at the threshold: 1.4 m ahead it would be another copy, and the picture would flicker."""
    view, still = view_of(camera()), zoomed(1.92)
    ahead = np.eye(4)
    ahead[0, 3] = -1.4
    moved = Source(still.lens, still.cam_from_ego @ ahead, still.cam_from_ego)
    assert reduction_of(shrinkage(view, Source(still.lens, moved.cam_from_ego))) == 1.25
    reductions = Reductions([view], anti_alias=True)
    assert reductions.of([still]) == reductions.of([moved]) == [(1,)]
    assert reductions.of([zoomed(3)]) == [(1.75,)]
    assert Reductions([view], anti_alias=False).of([zoomed(3)]) == [(1,)]


# --- what is in it ----------------------------------------------------------------------------------------------


def means(plane: np.ndarray, n: float) -> np.ndarray:
    """Of n x n, in float64, from 4 x 4 quarters of each pixel; the last row and column go on beyond the picture."""
    quarters = np.repeat(np.repeat(plane.astype(np.float64), 4, axis=0), 4, axis=1)
    side = int(4 * n)
    grown = np.pad(quarters, [(0, -length % side) for length in quarters.shape], mode="edge")
    return grown.reshape(grown.shape[0] // side, side, grown.shape[1] // side, side).mean(axis=(1, 3))


@pytest.mark.parametrize("n", [1.25, 1.5, 1.75, 2, 2.25, 3, 7.75, 64])
@pytest.mark.parametrize("size", [(64, 48), (61, 35), (3, 2), (1, 1)])
def test_a_copy_holds_the_means(size: tuple[int, int], n: float) -> None:
    plane = np.random.default_rng(int(4 * n)).integers(0, 256, size[::-1], dtype=np.uint8)
    exact = means(plane, n)
    copy = reduced_picture(np.repeat(plane[..., None], 3, axis=2), n)
    assert copy.shape == (*exact.shape, 3)
    assert np.abs(copy - exact[..., None]).max() <= 0.5 + 1e-4
    fused = pytest.importorskip("unidrive_cli.warp.fused", reason="the fused kernel needs numba")
    reduced = np.zeros((exact.shape[0] + 2, exact.shape[1] + 2), np.uint8)
    fused.reduce_plane(plane, *plane.shape, int(4 * n), *np.zeros((2, plane.shape[1] + 66), np.uint32), reduced)
    np.testing.assert_array_equal(reduced[: exact.shape[0], : exact.shape[1]], np.floor(exact + 0.5))


def test_the_widest_plane_that_there_can_be_is_summed_right() -> None:
    """Its sums do not fit 32 bits."""
    fused = pytest.importorskip("unidrive_cli.warp.fused", reason="the fused kernel needs numba")
    plane, reduced = np.full((64, MAX_SIDE_PX), 255, np.uint8), np.zeros((1, 512), np.uint8)
    fused.reduce_plane(plane, *plane.shape, 256, *np.zeros((2, MAX_SIDE_PX + 66), np.uint32), reduced)
    assert (reduced == 255).all()


# --- what comes out ---------------------------------------------------------------------------------------------


def stripes(shape: tuple[int, int]) -> Picture:
    """Columns of 0 and 255 in turn."""
    row = np.where(np.arange(shape[1]) % 2, 255, 0).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(row[None, :, None], (*shape, 3)))


def waves(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Levels at source pixels (u, v), so smooth that the mean of 3 x 3 pixels is 0.1 levels off at most."""
    return np.asarray(128 + 60 * np.sin(u / 23) + 50 * np.cos(v / 19))


def test_stripes_finer_than_the_virtual_pixels_turn_grey(tmp_path: Path, toolchain: Toolchain) -> None:
    """At three to one every bilinear sample falls on one stripe."""
    path = written(tmp_path / "s.png", stripes((3 * HEIGHT, 3 * WIDTH)))
    plain, smooth = (
        rendered(renderer_of(toolchain, camera(), anti_alias=chosen), [path], [zoomed(3)]).astype(float)
        for chosen in (False, True)
    )
    assert plain.std() >= 120
    assert smooth.std() <= 20
    assert smooth.mean() == pytest.approx(127.5, abs=2)


def test_where_nothing_is_shrunk_the_bytes_are_the_same(tmp_path: Path, toolchain: Toolchain) -> None:
    path = written(tmp_path / "s.png", stripes((3 * HEIGHT, 3 * WIDTH)))
    plain, smooth = (
        next(iter(renderer_of(toolchain, camera(), anti_alias=chosen).render([path], [zoomed(1.9)], 95, ""))).jpeg
        for chosen in (False, True)
    )
    assert plain == smooth


@pytest.mark.parametrize("factor", [1.0, 2.0, 2.4, 3.0])
@pytest.mark.parametrize("odd", [0, 1])
def test_a_copy_shows_everything_where_the_picture_shows_it(
    tmp_path: Path, toolchain: Toolchain, factor: float, odd: int
) -> None:
    """Waves survive averaging; half a source pixel aside is up to 1.3 levels."""
    source = zoomed(factor)
    lens = source.lens
    assert isinstance(lens, Pinhole)
    cut = replace(lens, width_px=lens.width_px - odd, height_px=lens.height_px - odd)
    drawn = waves(*np.meshgrid(np.arange(cut.width_px), np.arange(cut.height_px)))
    path = written(tmp_path / "s.png", np.repeat(np.rint(drawn).astype(np.uint8)[..., None], 3, axis=2))
    picture = rendered(renderer_of(toolchain, camera()), [path], [Source(cut, source.cam_from_ego)]).astype(float)
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    own = camera().pinhole
    u, v = lens.cx_px + (columns - own.cx_px) * factor, lens.cy_px + (rows - own.cy_px) * factor
    inside = (u > 8) & (u < cut.width_px - 9) & (v > 8) & (v < cut.height_px - 9)
    error = (picture[..., 1] - waves(u, v))[inside]
    slopes = np.stack([60 / 23 * np.cos(u / 23), -50 / 19 * np.sin(v / 19), np.ones_like(u)], axis=-1)[inside]
    aside_px = np.linalg.lstsq(slopes, error, rcond=None)[0][:2]
    assert np.abs(aside_px).max() <= 0.03
    assert np.abs(error).max() <= 3  # roundings and JPEG


def photograph(shape: tuple[int, int], seed: int) -> Picture:
    """Structure of all sizes."""
    rng = np.random.default_rng(seed)
    height, width = shape
    picture = sum(
        cv2.resize(rng.normal(0, 9, (height // step + 2, width // step + 2, 3)), (width, height)) * np.sqrt(step)
        for step in (1, 4, 16, 48)
    )
    return np.clip(128 + picture, 0, 255).astype(np.uint8)


def test_the_kernels_agree_where_sources_of_several_sizes_meet(tmp_path: Path) -> None:
    pytest.importorskip("numba", reason="the fused kernel needs numba")
    real = [camera(5, 75, 25), camera(1, 75, -25), camera(3, 80, 0)]
    sources = [source_of(one) for one in real]
    assert Reductions([view_of(camera())], anti_alias=True).of(sources) == [(2.5, 1, 1.5)]
    pictures = [photograph((s.lens.height_px, s.lens.width_px), seed) for seed, s in enumerate(sources)]
    paths = [written(tmp_path / f"{index}.png", picture) for index, picture in enumerate(pictures)]
    fast, slow = (rendered(renderer_of(chosen, camera()), paths, sources) for chosen in KERNELS)
    grey = [cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in (fast, slow)]
    assert psnr_db(*grey) >= 42


@pytest.mark.parametrize("order", [(1, 3, 1), (3, 2, 3)])
def test_what_was_rendered_before_leaves_no_trace(
    tmp_path: Path, toolchain: Toolchain, order: tuple[int, ...]
) -> None:
    path = written(tmp_path / "s.png", photograph((3 * HEIGHT, 3 * WIDTH), 0))
    renderer = renderer_of(toolchain, camera())
    seen = [rendered(renderer, [path], [zoomed(factor)]) for factor in order]
    np.testing.assert_array_equal(seen[0], seen[2])
    alone = rendered(renderer_of(toolchain, camera()), [path], [zoomed(order[1])])
    np.testing.assert_array_equal(seen[1], alone)
