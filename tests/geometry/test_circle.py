"""The horizon: which parts of the circle cameras see, in degrees known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyquaternion import Quaternion

from unidrive_cli.geometry.circle import arcs_deg, azimuths_deg, horizon_seen
from unidrive_cli.geometry.lenses import Pinhole

LEVEL = Quaternion(0.5, -0.5, 0.5, -0.5)


def camera(
    yaw: float, pitch: float = 0.0, hfov: float = 90.0, place: tuple = (0, 0, 1.5)
) -> tuple[Pinhole, np.ndarray]:
    turn = Quaternion(axis=[0, 0, 1], degrees=yaw) * Quaternion(axis=[0, 1, 0], degrees=-pitch) * LEVEL
    pose = turn.transformation_matrix
    pose[:3, 3] = place
    return Pinhole.from_hfov(hfov, 1600, 900), pose


def seen_arcs(*cameras: tuple[Pinhole, np.ndarray]) -> list[tuple[float, float]]:
    return arcs_deg(horizon_seen(cameras).any(axis=0))


def test_azimuths_are_the_middles_of_3600_steps() -> None:
    azimuths = azimuths_deg()
    assert azimuths.shape == (3600,)
    assert (azimuths[0], azimuths[-1]) == (pytest.approx(-179.95), pytest.approx(179.95))
    np.testing.assert_allclose(np.diff(azimuths), 0.1)


@pytest.mark.parametrize(
    ("cameras", "arcs"),
    [
        ([camera(0)], [(-45, 45)]),
        ([camera(90)], [(45, 135)]),  # positive yaw is left, positive azimuth too
        ([camera(-60, hfov=70)], [(-95, -25)]),
        ([camera(180)], [(135, 225)]),  # one arc across the seam at 180, not two
        ([camera(0, place=(9, -9, 1))], [(-45, 45)]),  # positions do not matter at infinity
        ([camera(0), camera(90)], [(-45, 135)]),
        ([camera(0), camera(180)], [(-45, 45), (135, 225)]),
        ([camera(yaw) for yaw in (0, 90, 180, -90)], [(-180, 180)]),
        ([camera(0, pitch=90)], []),  # looks at the sky
        ([camera(0, pitch=10)], [(-44.6, 44.6)]),  # tan(azimuth) = cos(10 degrees) at the border: 44.56
    ],
)
def test_arcs_of_cameras(cameras: list, arcs: list) -> None:
    assert seen_arcs(*cameras) == arcs


def test_one_row_per_camera() -> None:
    seen = horizon_seen([camera(0), camera(180, hfov=60)])
    assert seen.shape == (2, 3600)
    np.testing.assert_array_equal(seen.sum(axis=1), [900, 600])


@given(st.lists(st.integers(0, 3599), unique=True, min_size=2, max_size=12).filter(lambda cuts: len(cuts) % 2 == 0))
def test_arcs_give_the_mask_back(cuts: list[int]) -> None:
    """Any circular mask, those that run across the seam included."""
    cuts = sorted(cuts)
    mask = np.cumsum(np.isin(np.arange(3600), cuts)) % 2 == 1
    for circular in (mask, ~mask):
        rebuilt = np.zeros(3600, dtype=int)
        for start, end in arcs_deg(circular):
            assert -180 <= start < 180
            assert start < end <= start + 360
            steps = np.arange(round((start + 180) * 10), round((end + 180) * 10)) % 3600
            rebuilt[steps] += 1
        np.testing.assert_array_equal(rebuilt, circular.astype(int))


@pytest.mark.parametrize(("value", "arcs"), [(False, []), (True, [(-180.0, 180.0)])])
def test_nothing_and_everything(value: bool, arcs: list) -> None:
    assert arcs_deg(np.full(3600, value)) == arcs
