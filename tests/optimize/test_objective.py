"""The objective: its parts in cases that are known beforehand, and the compiled kernel against plain arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.cross_rig.config import PAPER_RIGS
from tests.optimize.fleet import boxes_around, gallery_cars, pair
from unidrive_cli.errors import GeometryError, RigError, UsageError
from unidrive_cli.geometry.lenses import Pinhole, lens_of
from unidrive_cli.geometry.poses import pose, rotation_from_yaw_pitch_roll
from unidrive_cli.optimize.objective import Car, Cost, Objective, Penalties, RigCost
from unidrive_cli.rig.gallery import gallery_names, load_gallery_rig
from unidrive_cli.rig.model import Camera, Rig

both_ways = pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "plain"])


@pytest.fixture(autouse=True)
def _numba(request: pytest.FixtureRequest) -> None:
    if "compiled" in request.node.name:
        pytest.importorskip("numba", reason="the extra `fast` is not installed")


@both_ways
@pytest.mark.parametrize("name", ["6x60", "5x70+110", "4x95"])
def test_the_own_rig_costs_nothing_where_no_cameras_overlap_and_little_elsewhere(name: str, compiled: bool) -> None:
    """Each virtual camera has a source at its own place; only the blend of another source adds an error."""
    (car,) = gallery_cars(name)
    cost = Objective([car], Penalties(), 0.0, compiled=compiled)(car.rig, 50.0)
    assert cost.uncovered == cost.not_common == cost.rigs[0].unfilled == 0
    assert cost.error_m_rad == pytest.approx(0, abs=1e-9 if name == "6x60" else 0.02)
    assert cost.total == pytest.approx(1.5 * cost.error_m_rad)  # the only car is the worst too, at half weight


@both_ways
def test_seeing_less_lowers_the_bare_sum_and_raises_the_objective(compiled: bool) -> None:
    (car,) = gallery_cars("5x75")
    objective = Objective([car], Penalties(), 0.0, compiled=compiled)
    wide, narrow = objective(pair(hfov=110), 50.0), objective(pair(hfov=50), 50.0)
    assert narrow.rigs[0].pair_sum_m_rad < wide.rigs[0].pair_sum_m_rad / 2
    assert narrow.uncovered > wide.uncovered
    assert narrow.total > wide.total


@both_ways
def test_a_rig_that_sees_nothing_costs_the_whole_penalty(compiled: bool) -> None:
    (car,) = gallery_cars("6x60")
    up = Camera("CAM_UP", Pinhole.from_hfov(60, 320, 180), pose(rotation_from_yaw_pitch_roll(0, 85, 0), [1, 0, 1.5]))
    cost = Objective([car], Penalties(3.0, 0.5, worst=0.0), 0.0, compiled=compiled)(Rig("up", "", (up,)), 50.0)
    assert (cost.error_m_rad, cost.uncovered, cost.rigs[0].pairs) == (0, 1, 0)
    assert cost.total == pytest.approx(3.0 + 0.5 * cost.not_common)
    assert cost.not_common > 0.9


@both_ways
def test_what_is_common_shrinks_with_each_car(compiled: bool) -> None:
    cars = gallery_cars("6x80a", "6x60", "8x50", count=20)
    virtual = load_gallery_rig("roof-6x70")
    costs = [Objective(cars[: n + 1], Penalties(), 0.0, compiled=compiled)(virtual, 50.0) for n in range(3)]
    assert costs[0].not_common < costs[1].not_common < costs[2].not_common
    for cost in costs:
        assert cost.not_common >= max(rig.unfilled for rig in cost.rigs)
    assert costs[0].not_common == pytest.approx(costs[0].rigs[0].unfilled)


def test_the_total_and_the_worst_are_made_of_their_parts() -> None:
    penalties = Penalties(uncovered=2.0, unfilled=0.5, worst=0.25)
    good, bad = RigCost("good", 0.1, 0.0, 0.2, 100, 10.0, 90), RigCost("bad", 0.3, 0.1, 0.4, 50, 20.0, 40)
    cost = Cost((good, bad), 0.45, penalties)
    assert cost.worst is bad
    assert bad.total(penalties) == pytest.approx(0.3 + 0.2 + 0.2)
    assert cost.total == pytest.approx(0.2 + 2.0 * 0.05 + 0.5 * 0.45 + 0.25 * 0.7)


numbers = st.floats(-1, 1, allow_nan=False)


@settings(max_examples=10)
@given(
    st.lists(st.tuples(*[numbers] * 7), min_size=1, max_size=6),
    st.floats(12, 120),
    st.floats(-0.3, 0.3),
    st.sampled_from([name for name in gallery_names() if name not in ("roof-6x70",)]),
    st.booleans(),
)
def test_compiled_and_plain_agree(
    draws: list[tuple[float, ...]], depth_limit_m: float, ground_m: float, name: str, common: bool
) -> None:
    pytest.importorskip("numba", reason="the extra `fast` is not installed")
    virtual = Rig(
        "drawn",
        "",
        tuple(
            Camera(
                f"CAM_{index}",
                Pinhole.from_hfov(70 + 40 * draw[0], 320, 200 + 8 * index),
                pose(
                    rotation_from_yaw_pitch_roll(180 * draw[1], 20 * draw[2], 10 * draw[3]),
                    [1 + draw[4], 0.6 * draw[5], 1.5 + 0.4 * draw[6]],
                ),
            )
            for index, draw in enumerate(draws)
        ),
    )
    fleet = [load_gallery_rig(each) for each in (name, "6x80b")]
    cars = [Car(rig, boxes_around(60, seed), fleet if common else ()) for seed, rig in enumerate(fleet)]
    compiled, plain = (
        Objective(cars, Penalties(worst=0.3), ground_m, compiled=way)(virtual, depth_limit_m)
        for way in (True, False)
    )
    assert compiled.not_common == pytest.approx(plain.not_common, abs=1e-12)
    for one, other in zip(compiled.rigs, plain.rigs, strict=True):
        assert (one.corners, one.pairs) == (other.corners, other.pairs)
        for part in ("error_m_rad", "uncovered", "unfilled", "pair_sum_m_rad"):
            assert getattr(one, part) == pytest.approx(getattr(other, part), rel=1e-9, abs=1e-12)


@both_ways
def test_of_common_corners_only_those_count_that_every_car_sees(compiled: bool) -> None:
    front, both = Rig("front", "", pair().cameras[:1]), pair()
    corners = boxes_around(100)
    ahead = (corners[..., 0] > 1.0) & (np.abs(corners[..., 1]) <= corners[..., 0] - 1.0)
    car = Car(both, corners, [both, front])
    assert car.count == Car(front, corners).count <= np.count_nonzero(ahead) < Car(both, corners).count
    back = Rig("back", "", pair().cameras[1:])
    with pytest.raises(UsageError, match="all cars together see none of the 100 boxes of pair"):
        Car(both, corners, [front, back])
    cost = Objective([car], Penalties(), 0.0, compiled=compiled)
    assert cost(front, 50.0).rigs[0].uncovered == 0
    assert cost(back, 50.0).rigs[0].uncovered == 1


def test_all_of_the_paper_s_cars_fill_the_fleet_s_rig() -> None:
    cars = gallery_cars(*PAPER_RIGS)
    rig = load_gallery_rig("unidrive-fleet-6")
    assert rig.depth_limit_m is not None
    objective = Objective(cars, Penalties(), 0.0)
    assert objective(rig, rig.depth_limit_m).not_common < 0.02
    assert objective(load_gallery_rig("intuitive-6"), 50.0).not_common > 0.3


def test_sources_with_distortion_are_worked_out_without_the_kernel() -> None:
    rig = load_gallery_rig("6x60")
    barely = tuple(
        replace(camera, lens=lens_of(camera.pinhole, "opencv", (1e-9, 0, 0, 0))) for camera in rig.cameras
    )
    bent = Car(Rig("bent", "", barely), boxes_around(50))
    straight = Car(rig, boxes_around(50))
    virtual = load_gallery_rig("roof-6x70")
    objective = Objective([bent], Penalties(), 0.0)
    assert not objective.compiled
    found, expected = objective(virtual, 50.0), Objective([straight], Penalties(), 0.0)(virtual, 50.0)
    assert found.total == pytest.approx(expected.total, abs=1e-6)


def test_cars_without_boxes_or_without_sight_of_them() -> None:
    with pytest.raises(UsageError, match="there are no boxes for pair"):
        Car(pair(), np.empty((0, 8, 3)))
    with pytest.raises(UsageError, match="no camera of pair sees any of the 4 boxes"):
        Car(pair(), boxes_around(4) + np.array([0, 0, 500]))


@both_ways
def test_a_rig_that_cannot_be(compiled: bool) -> None:
    objective = Objective(gallery_cars("6x60", count=5), Penalties(), 0.0, compiled=compiled)
    with pytest.raises(RigError, match="pair, camera CAM_FRONT: the depth limit"):
        objective(pair(), 1.2)


def test_a_source_outside_of_the_half_ball_is_refused_without_the_kernel() -> None:
    objective = Objective(gallery_cars("6x60", count=5), Penalties(), 0.0, compiled=False)
    with pytest.raises(GeometryError, match="outside of the virtual camera's half-ball"):
        objective(pair(x=9.0), 3.0)
