"""Which pictures between the key frames are one moment, and what the plan makes of them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.datasets import VERSION, Row, rows
from tests.frames import psnr_db
from tests.painted import SAMPLE_US, PaintedCamera, nuscenes_like_cameras, write_painted
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import Plan, make_plan
from unidrive_cli.convert.sweeps import nearest_pairs
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.tables import dataset as dataset_module
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.rig_of_dataset import rig_of_dataset
from unidrive_cli.tables.table import EMPTY
from unidrive_cli.warp.pictures import read_picture
from unidrive_cli.warp.render import choose_toolchain, open_renderer

STEP_US = SAMPLE_US // 5
"""Between two sweeps of a painted drive with four of them from key frame to key frame."""


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of two samples; each sensor has four sweeps between them, 100 ms apart."""
    root = tmp_path_factory.mktemp("painted") / "drive"
    cameras = nuscenes_like_cameras(0.05)
    write_painted(root, cameras=cameras, scenes=2, lidar_sweeps=4, camera_sweeps=4, supersample=1)
    return root


@pytest.fixture
def drive(painted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(painted, tmp_path / "drive"))


def edit(root: Path, change: Callable[[list[Row]], list[Row] | None]) -> None:
    """Changes the rows of sample_data."""
    found = rows(root, "sample_data")
    (root / VERSION / "sample_data.json").write_text(json.dumps(change(found) or found))


def sweeps(channel: str) -> Callable[[Row], bool]:
    return lambda row: row["filename"].startswith(f"sweeps/{channel}/")


def plan_of(root: Path, **options: Any) -> Plan:
    return make_plan(open_dataset(root), load_gallery_rig("roof-6x70"), Options(sweeps=True, **options))


def sources(plan: Plan) -> list[dict[str, float]]:
    """Of each sweep: how long before the sample's time its pictures were taken, by channel, in ms."""
    found = []
    for sweep in plan.sweeps:
        pictures = list(plan.dataset.sample_data.rows_at(np.array(sweep.rows)))
        found.append(
            {
                plan.dataset.sensor_of(row).channel: (row.timestamp - sweep.sample.timestamp) / 1000
                for row in pictures
            }
        )
    return found


def references(plan: Plan) -> list[tuple[str, float]]:
    """Of each sweep: the channel whose time and pose it takes, and how long before the sample that is, in ms."""
    indices = np.array([sweep.reference for sweep in plan.sweeps])
    return [
        (plan.dataset.sensor_of(row).channel, (row.timestamp - sweep.sample.timestamp) / 1000)
        for sweep, row in zip(plan.sweeps, plan.dataset.sample_data.rows_at(indices), strict=True)
    ]


# --- pairs ----------------------------------------------------------------------------------------------------

moments = st.lists(st.integers(0, 60), max_size=8, unique=True).map(sorted)


def test_each_has_the_nearest_that_has_it_for_its_nearest() -> None:
    times, others = np.array([0.0, 100.0, 200.0, 300.0]), np.array([-10.0, 90.0, 104.0, 260.0])
    assert nearest_pairs(times, others, 50).tolist() == [0, 2, EMPTY, 3]


@given(moments, moments, st.integers(0, 30))
def test_pairs_are_within_reach_and_none_is_used_twice(times: list[int], others: list[int], within: int) -> None:
    pairs = nearest_pairs(np.array(times, float), np.array(others, float), within).tolist()
    used = [place for place in pairs if place >= 0]
    assert used == sorted(set(used))
    for time, place in zip(times, pairs, strict=True):
        distances = sorted((abs(other - time), index) for index, other in enumerate(others))
        if place >= 0:
            assert abs(others[place] - time) == distances[0][0] <= within
            assert abs(others[place] - time) == min(abs(others[place] - other) for other in times)
        elif distances and distances[0][0] <= within:
            assert any(abs(others[distances[0][1]] - other) <= distances[0][0] for other in times if other != time)


# --- groups -------------------------------------------------------------------------------------------------------


def test_nothing_is_swept_without_the_option(painted: Path) -> None:
    plan = make_plan(open_dataset(painted), load_gallery_rig("roof-6x70"), Options())
    assert (list(plan.sweeps), plan.moments) == ([], plan.units)


def test_pictures_of_one_turn_of_the_lidar_are_one_moment(painted: Path) -> None:
    """Cameras fire up to 43 ms before the lidar's time, in the sweeps as in the key frames."""
    plan = plan_of(painted)
    lags = {camera.channel: camera.fires_us / 1000 for camera in nuscenes_like_cameras()}
    turns = [-400, -300, -200, -100] * 2
    assert sources(plan) == [{name: turn + lag for name, lag in sorted(lags.items())} for turn in turns]
    assert references(plan) == [("LIDAR_TOP", turn) for turn in turns]
    assert [sweep.timestamp for sweep in plan.sweeps] == [
        unit.timestamp + 1000 * turn for unit in plan.units[1::2] for turn in turns[:4]
    ]
    assert [sweep.sample for sweep in plan.sweeps] == [plan.units[1].sample] * 4 + [plan.units[3].sample] * 4
    assert plan.notes == []


def test_uneven_turns_are_told_apart(drive: Path) -> None:
    """20 Hz turns of which the cameras see some: two pictures 50 ms apart, the next 150 ms later.

    CAM_FRONT_LEFT fires 42.6 ms before CAM_BACK_LEFT, so the nearest picture would be that of the next turn.
    """

    def move(found: list[Row]) -> None:
        for row in found:
            if row["filename"].startswith("sweeps/CAM"):
                row["timestamp"] -= 50_000 * (_turn(row) % 2)

    edit(drive, move)
    for found in sources(plan_of(drive)):
        turns = [found[camera.channel] - camera.fires_us / 1000 for camera in nuscenes_like_cameras()]
        assert max(turns) - min(turns) < 1, turns


def test_pictures_at_12_hz_and_clouds_at_20_hz(tmp_path: Path) -> None:
    """As nuScenes has them: 83.3 ms do not divide into turns of 50 ms."""
    cameras = nuscenes_like_cameras(0.02)
    write_painted(tmp_path, cameras=cameras, lidar_sweeps=9, camera_sweeps=5, supersample=1)
    plan = plan_of(tmp_path)
    assert references(plan) == [("LIDAR_TOP", turn) for turn in (-400, -350, -250, -150, -100)]
    assert [len(found) for found in sources(plan)] == [6] * 5
    assert plan.notes == []


def test_without_lidar_sweeps_the_leading_picture_says_when_and_where(drive: Path) -> None:
    edit(drive, lambda found: [row for row in found if not sweeps("LIDAR_TOP")(row)])
    plan = plan_of(drive)
    assert references(plan) == [("CAM_BACK", turn - 10.4) for turn in (-400, -300, -200, -100)] * 2


def test_a_lidar_sweep_is_the_reference_of_one_moment(drive: Path) -> None:
    """The lidar turns at 5 Hz: every other moment is the leading picture's."""
    edit(drive, lambda found: [row for row in found if not (sweeps("LIDAR_TOP")(row) and _turn(row) in (1, 3))])
    times = [("CAM_BACK", -410.4), ("LIDAR_TOP", -300), ("CAM_BACK", -210.4), ("LIDAR_TOP", -100)] * 2
    assert references(plan_of(drive)) == times


def test_a_camera_that_is_not_there_is_black(drive: Path) -> None:
    edit(drive, lambda found: [row for row in found if not (sweeps("CAM_FRONT")(row) and _turn(row) == 2)])
    plan = plan_of(drive)
    assert [sorted(set(sources(plan)[0]) - set(found)) for found in sources(plan)] == [[], ["CAM_FRONT"], [], []] * 2
    assert any(note.startswith("2 of 8 sweeps lack some of the cameras") for note in plan.notes)


def test_the_camera_with_most_sweeps_leads(drive: Path) -> None:
    """CAM_BACK, which led by its name, has none in the second scene."""
    second = rows(drive, "sample")[2]["scene_token"]
    samples = {row["token"] for row in rows(drive, "sample") if row["scene_token"] == second}
    edit(
        drive,
        lambda found: [row for row in found if not (sweeps("CAM_BACK")(row) and row["sample_token"] in samples)],
    )
    assert [sorted(found) for found in sources(plan_of(drive))][4:] == [
        ["CAM_BACK_LEFT", "CAM_BACK_RIGHT", "CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"]
    ] * 4


@pytest.mark.parametrize(("later_ms", "left_out"), [(47, 0), (53, 1)])
def test_a_picture_farther_than_half_a_period_is_left_out_and_said(
    drive: Path, later_ms: int, left_out: int
) -> None:
    def move(found: list[Row]) -> None:
        next(row for row in found if sweeps("CAM_FRONT")(row) and _turn(row) == 4)["timestamp"] += 1000 * later_ms

    edit(drive, move)
    plan = plan_of(drive)
    assert sum(len(found) for found in sources(plan)) == 48 - left_out
    said = [f"Camera sweeps that do not fit in with others in time, and are left out: {left_out}."]
    assert [note for note in plan.notes if "left out" in note] == (said if left_out else [])


def test_no_picture_is_in_two_moments_and_no_moment_has_two_of_a_camera(drive: Path) -> None:
    def double(found: list[Row]) -> list[Row]:
        row = next(row for row in found if sweeps("CAM_FRONT")(row))
        return [*found, {**row, "token": "double", "timestamp": row["timestamp"] + 1000, "prev": "", "next": ""}]

    edit(drive, double)
    plan = plan_of(drive)
    assert [len(found) for found in sources(plan)] == [6] * 8
    assert any("left out: 1." in note for note in plan.notes)


def test_only_the_chosen_cameras_are_swept(painted: Path) -> None:
    assert [list(found) for found in sources(plan_of(painted, cameras=("CAM_FRONT",)))] == [["CAM_FRONT"]] * 8


def test_only_the_chosen_scenes_are_swept(painted: Path) -> None:
    plan = plan_of(painted, scenes=("scene-0103",))
    assert [sweep.scene.name for sweep in plan.sweeps] == ["scene-0103"] * 4


@pytest.mark.parametrize("scenes", [(), ("scene-0103",)])
def test_sweeps_that_name_no_sample_belong_to_the_next(painted: Path, drive: Path, scenes: tuple[str, ...]) -> None:
    """As in T4."""
    edit(drive, lambda found: [row | ({} if row["is_key_frame"] else {"sample_token": ""}) for row in found])
    named, nameless = plan_of(painted, scenes=scenes), plan_of(drive, scenes=scenes)
    assert [(s.token, s.sample, s.rows) for s in nameless.sweeps] == [
        (s.token, s.sample, s.rows) for s in named.sweeps
    ]


def test_a_scanned_table_gives_the_same_sweeps(painted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = plan_of(painted)
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    scanned = plan_of(painted)

    def said(plan: Plan) -> list[Any]:
        return [(s.token, s.timestamp, s.reference, s.rows, s.pictures, s.sample) for s in plan.sweeps]

    assert said(scanned) == said(read)
    for one, other in zip(scanned.sweeps, read.sweeps, strict=True):
        here, there = scanned.frame(one), read.frame(other)
        assert here.paths == there.paths
        for source, same in zip(here.sources, there.sources, strict=True):
            np.testing.assert_array_equal(source.cam_from_ego, same.cam_from_ego)


def test_names_of_sweeps_and_key_frames_never_collide(drive: Path) -> None:
    """Masks of both lie in one folder; key frames keep the names that they have without sweeps."""
    names = [Path(name).name for unit in plan_of(drive).units for name in unit.pictures]

    def same_time(found: list[Row]) -> None:
        for row in found:
            row["timestamp"] -= 10_000_000 if row["timestamp"] > found[0]["timestamp"] + 30_000_000 else 0

    edit(drive, same_time)
    plan = plan_of(drive)
    masks = [Path(name).name for moment in plan.moments for name in moment.pictures]
    assert len(set(masks)) == len(masks) == (4 + 8) * 6
    assert len(set(names)) == 24


def test_parts_have_all_moments(painted: Path) -> None:
    plan = plan_of(painted)
    assert [type(moment).__name__ for moment in plan.moments] == (["Unit"] + ["Sweep"] * 4 + ["Unit"]) * 2
    assert plan.picture_count == 12 * 6
    pictures = plan.picture_count * 1.44e6 * 0.21
    assert plan.estimated_bytes() == pytest.approx(pictures, rel=0.1)


# --- pictures -------------------------------------------------------------------------------------------------


def test_a_rig_sees_its_own_sweeps(tmp_path: Path) -> None:
    """Cameras that fire with the lidar, seen through themselves: each virtual sweep is the source's picture."""
    cameras = [
        PaintedCamera(c.channel, c.width_px, c.height_px, c.intrinsic, c.ego_from_cam)
        for c in nuscenes_like_cameras(0.1)
    ]
    write_painted(tmp_path / "src", cameras=cameras, lidar_sweeps=1, camera_sweeps=1)
    dataset = open_dataset(tmp_path / "src")
    rig, _ = rig_of_dataset(dataset)
    plan = make_plan(dataset, rig, Options(sweeps=True))
    (sweep,) = plan.sweeps
    frame = plan.frame(sweep)
    renderer = open_renderer(choose_toolchain(), rig, plan.options, None)
    rendered = renderer.render([Path(path) for path in frame.paths], frame.sources, 100, "")
    by_channel = {Path(path).parent.name: Path(path) for path in frame.paths}
    assert len(by_channel) == 6
    for camera, picture in zip(rig.cameras, rendered, strict=True):
        (tmp_path / "picture.jpg").write_bytes(picture.jpeg)
        size = (camera.lens.width_px, camera.lens.height_px)
        truth = read_picture(by_channel[camera.channel], size)
        assert psnr_db(read_picture(tmp_path / "picture.jpg", size), truth) > 30, camera.channel


def test_pictures_stand_where_the_car_was_when_they_were_taken(painted: Path) -> None:
    """At 9 m/s, 43.1 ms before the lidar's sweep, CAM_FRONT_LEFT was 0.388 m farther back."""
    centres = []
    for motion in (False, True):
        plan = plan_of(painted, ego_motion=motion)
        place = list(sources(plan)[0]).index("CAM_FRONT_LEFT")
        cam_from_ego = plan.frame(plan.sweeps[0]).sources[place].cam_from_ego
        centres.append(-cam_from_ego[:3, :3].T @ cam_from_ego[:3, 3])
    np.testing.assert_allclose(centres[1] - centres[0], [-0.388, 0, 0], atol=0.01)


def _turn(row: Row) -> int:
    """Which of the four sweeps of its gap a painted one is, 1 to 4: by its sample's time."""
    return round((row["timestamp"] - _FIRST) % SAMPLE_US / STEP_US)


_FIRST = 1_767_268_800_047_951
