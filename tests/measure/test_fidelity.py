"""The comparison of two pictures, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.frames import psnr_db
from unidrive_cli.measure.fidelity import Tally, compare, near_seams, ssim_map

SHAPE = (40, 60)
EVERYWHERE = np.ones(SHAPE, dtype=bool)


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(20, 200, (*SHAPE, 3), dtype=np.uint8)


def left_half() -> np.ndarray:
    return np.broadcast_to(np.arange(SHAPE[1]) < SHAPE[1] // 2, SHAPE).copy()


@pytest.mark.parametrize("levels", [1, 5, 51])
def test_a_constant_offset(levels: int) -> None:
    truth = noise()
    tally = compare(truth + np.uint8(levels), truth, EVERYWHERE, {"all": EVERYWHERE})["all"]
    assert tally.pixels == 40 * 60
    assert tally.psnr_db == pytest.approx(20 * math.log10(255 / levels), abs=1e-12)


def test_an_offset_of_one_channel_counts_a_third() -> None:
    truth = noise()
    picture = truth.copy()
    picture[..., 1] += 10
    tally = compare(picture, truth, EVERYWHERE, {"all": EVERYWHERE})["all"]
    assert tally.psnr_db == pytest.approx(10 * math.log10(255**2 / (100 / 3)), abs=1e-12)


def test_the_ssim_of_flat_pictures() -> None:
    """Without structure only the luminance term is left: (2 a b + C1) / (a^2 + b^2 + C1), C1 = (0.01 L)^2."""
    dark, light = (np.full((*SHAPE, 3), level, dtype=np.uint8) for level in (100, 150))
    tally = compare(light, dark, EVERYWHERE, {"all": EVERYWHERE})["all"]
    c1 = (0.01 * 255) ** 2
    assert tally.ssim == pytest.approx((2 * 100 * 150 + c1) / (100**2 + 150**2 + c1), abs=1e-12)


def test_identical_pictures() -> None:
    tally = compare(noise(), noise(), EVERYWHERE, {"all": EVERYWHERE})["all"]
    assert tally.psnr_db == math.inf
    assert tally.ssim == pytest.approx(1, abs=1e-12)


def test_regions_are_told_apart_and_cut_by_the_coverage() -> None:
    """Left 5 levels off, right 20; the lower half is not covered, whatever is there."""
    truth, left, covered = noise(), left_half(), EVERYWHERE.copy()
    covered[20:] = False
    picture = truth + np.where(left, 5, 20).astype(np.uint8)[..., None]
    picture[20:] = 255
    tallies = compare(picture, truth, covered, {"left": left, "right": ~left, "all": EVERYWHERE})
    assert [tallies[name].pixels for name in ("left", "right", "all")] == [600, 600, 1200]
    assert tallies["left"].psnr_db == pytest.approx(20 * math.log10(255 / 5))
    assert tallies["right"].psnr_db == pytest.approx(20 * math.log10(255 / 20))
    assert tallies["all"].psnr_db == pytest.approx(10 * math.log10(255**2 / ((25 + 400) / 2)))
    assert tallies["left"] + tallies["right"] == Tally(
        1200, tallies["all"].squared_error, pytest.approx(tallies["all"].similarity)
    )


def test_what_is_not_covered_does_not_reach_into_ssim() -> None:
    truth, covered = noise(), left_half()
    torn = np.where(covered[..., None], truth, noise(1))
    assert compare(torn, truth, covered, {"all": covered})["all"].ssim == pytest.approx(1, abs=1e-12)
    assert ssim_map(torn, truth)[covered].mean() < 0.99


def test_no_pixels_have_no_figures() -> None:
    tally = compare(noise(), noise(), EVERYWHERE, {"none": ~EVERYWHERE})["none"]
    assert (tally.pixels, tally.psnr_db, tally.ssim) == (0, None, None)


def test_sums_are_of_all_pixels_and_no_mean_of_means() -> None:
    """One picture is perfect: a mean of its infinite PSNR and the other's would be infinite."""
    good = compare(noise(), noise(), EVERYWHERE, {"all": EVERYWHERE})["all"]
    bad = compare(noise(1), noise(2), EVERYWHERE, {"all": EVERYWHERE})["all"]
    both = psnr_db(np.concatenate([noise(), noise(1)]), np.concatenate([noise(), noise(2)]))
    assert (good + bad).psnr_db == pytest.approx(both)
    assert (good + bad).ssim == pytest.approx((1 + bad.ssim) / 2)


def test_a_black_and_white_picture_does_not_overflow() -> None:
    black, white = np.zeros((*SHAPE, 3), np.uint8), np.full((*SHAPE, 3), 255, np.uint8)
    assert compare(black, white, EVERYWHERE, {"all": EVERYWHERE})["all"].psnr_db == pytest.approx(0)


# --- seams ------------------------------------------------------------------------------------------------------


def test_a_straight_seam_is_eight_pixels_on_either_side() -> None:
    near = near_seams(np.where(left_half(), 3, 1).astype(np.int32))
    assert np.array_equal(near.any(axis=0), near.all(axis=0))
    assert np.flatnonzero(near[0]).tolist() == list(range(30 - 8, 30 + 8))


def test_a_level_seam() -> None:
    dominant = np.zeros(SHAPE, dtype=np.int32)
    dominant[25:] = 2
    assert np.flatnonzero(near_seams(dominant)[:, 0]).tolist() == list(range(25 - 8, 25 + 8))


def test_the_border_of_the_coverage_is_no_seam() -> None:
    assert not near_seams(np.where(left_half(), 3, -1).astype(np.int32)).any()
    assert not near_seams(np.zeros(SHAPE, dtype=np.int32)).any()
