"""Exposure: gains that even out what neighbours show of the same, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simplejpeg

from tests.warp.test_reduction import HEIGHT, WIDTH, camera, toolchain, written
from tests.warp.test_remap import source_of, view_of
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp.choices import ExposureChoice, WarpChoices
from unidrive_cli.warp.exposure import GAIN_RANGE, Exposure, Luma, brighten
from unidrive_cli.warp.own_car import OwnCar
from unidrive_cli.warp.pictures import Picture
from unidrive_cli.warp.remap import Source
from unidrive_cli.warp.render import Toolchain, open_renderer

__all__ = ["toolchain"]
UNITY = 0.3
"""How much a gain's own logarithm counts against the difference of two."""
VIRTUAL = camera(4, hfov_deg=100)
LEFT, RIGHT = (source_of(camera(hfov_deg=80, yaw_deg=yaw)) for yaw in (25, -25))
BEHIND = source_of(camera(hfov_deg=80, yaw_deg=180))


def grey(*levels: float) -> list[Luma]:
    return [np.full((HEIGHT + 2, WIDTH + 2), level, np.uint8) for level in levels]


def gains_of(sources: list[Source], lumas: list[Luma]) -> np.ndarray:
    return np.asarray(Exposure([view_of(VIRTUAL)]).gains(sources, lumas))


def test_two_meet_nearly_in_the_middle() -> None:
    """x for one and -x for the other, and (2 + UNITY) x = log of the ratio."""
    expected = (120 / 80) ** (1 / (2 + UNITY))
    np.testing.assert_allclose(gains_of([LEFT, RIGHT], grey(80, 120)), [expected, 1 / expected], atol=1e-3)
    np.testing.assert_allclose(gains_of([RIGHT, LEFT], grey(80, 120)), [expected, 1 / expected], atol=1e-3)


def test_alike_sources_and_lonely_ones_stay() -> None:
    assert gains_of([LEFT, RIGHT, BEHIND], grey(90, 90, 30)).tolist() == [1, 1, 1]
    assert gains_of([BEHIND], grey(30)).tolist() == [1]
    assert gains_of([], []).tolist() == []


def test_gains_have_bounds() -> None:
    assert gains_of([LEFT, RIGHT], grey(8, 240)).tolist() == [GAIN_RANGE[1], GAIN_RANGE[0]]


def test_what_is_saturated_says_nothing() -> None:
    """The sky is white in both pictures; below it one is darker by a third."""
    lumas = grey(90, 60)
    for luma in lumas:
        luma[: HEIGHT // 2] = 255
    np.testing.assert_array_equal(gains_of([LEFT, RIGHT], lumas), gains_of([LEFT, RIGHT], grey(90, 60)))
    assert gains_of([LEFT, RIGHT], grey(255, 60)).tolist() == [1, 1]


def test_the_own_car_says_nothing() -> None:
    lumas, bonnet = grey(90, 60), np.zeros((HEIGHT, WIDTH), bool)
    bonnet[HEIGHT // 2 :] = True
    lumas[0][HEIGHT // 2 - 3 :] = 20
    hidden = [replace(LEFT, own_car=OwnCar.of(bonnet)), RIGHT]
    np.testing.assert_array_equal(gains_of(hidden, lumas), gains_of([LEFT, RIGHT], grey(90, 60)))


def test_a_colour_is_multiplied_as_a_whole() -> None:
    values = np.array([[0, 100, 128, 200, 255]], np.uint8)
    brighten(values, 1.5)
    assert values.tolist() == [[0, 150, 192, 255, 255]]
    values = np.array([[0, 100, 128, 200, 255]], np.uint8)
    brighten(values, 0.5, zero=128)
    assert values.tolist() == [[64, 114, 128, 164, 192]]


def drawn(toolchain: Toolchain, exposure: ExposureChoice, paths: list[Path], sources: list[Source]) -> Picture:
    renderer = open_renderer(toolchain, Rig("r", "", (VIRTUAL,)), WarpChoices(exposure=exposure))
    (picture,) = renderer.render(paths, sources, 100, "")
    return simplejpeg.decode_jpeg(picture.jpeg, colorspace="BGR")


@pytest.mark.parametrize("finer", [False, True])
def test_the_step_between_two_pictures_goes(tmp_path: Path, toolchain: Toolchain, finer: bool) -> None:
    """A brown wall, darker by a third on the right; copies are made of what is evened out."""
    brown = np.array([60, 90, 150])
    left, right = (source_of(camera(6 if finer else 1, hfov_deg=80, yaw_deg=yaw)) for yaw in (25, -25))
    paths = []
    for name, source, share in (("left", left, 1.0), ("right", right, 2 / 3)):
        wall = np.full((source.lens.height_px, source.lens.width_px, 3), np.rint(brown * share), np.uint8)
        paths.append(written(tmp_path / f"{name}.png", wall))
    plain, even = (drawn(toolchain, chosen, paths, [left, right]).astype(float) for chosen in ("none", "gain"))
    row, ends = 2 * HEIGHT, (80, -80)
    gain = 1.5 ** (1 / (2 + UNITY))
    for picture, factors in ((plain, (1, 2 / 3)), (even, (1 / gain, 2 / 3 * gain))):
        for end, factor in zip(ends, factors, strict=True):
            np.testing.assert_allclose(picture[row, end], brown * factor, atol=2.5)


def test_none_is_the_default_and_gains_of_one_change_no_byte(tmp_path: Path, toolchain: Toolchain) -> None:
    path = written(tmp_path / "s.png", np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
    pictures = []
    for choices in (WarpChoices(), WarpChoices(exposure="gain")):
        renderer = open_renderer(toolchain, Rig("r", "", (VIRTUAL,)), choices)
        pictures.append(next(iter(renderer.render([path], [LEFT], 95, ""))).jpeg)
    assert pictures[0] == pictures[1]
