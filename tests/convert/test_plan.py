"""The plan: which moment a virtual picture has, what it is called, what is said beforehand."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.painted import nuscenes_like_cameras, write_painted
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import Plan, make_plan
from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.rig_of_dataset import rig_of_dataset

Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("painted") / "drive"
    write_painted(root, cameras=nuscenes_like_cameras(scale=0.05), samples_per_scene=2)
    return root


@pytest.fixture
def drive(painted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(painted, tmp_path / "drive"))


def edit(root: Path, table: str, change: Callable[[Rows], Rows | None]) -> None:
    path = root / "v1.0-mini" / f"{table}.json"
    rows = json.loads(path.read_text())
    path.write_text(json.dumps(change(rows) or rows))


def plan_of(root: Path, rig: str = "roof-6x70", **options: Any) -> Plan:
    return make_plan(open_dataset(root), load_gallery_rig(rig), Options(**options))


def reference_channels(plan: Plan) -> set[str]:
    return {plan.dataset.sensor_of(unit.reference).channel for unit in plan.units}


def rename_lidar(rows: Rows) -> None:
    next(row for row in rows if row["channel"] == "LIDAR_TOP")["channel"] = "LIDAR_ROOF"


def test_the_moment_is_that_of_the_lidar(drive: Path) -> None:
    assert reference_channels(plan_of(drive)) == {"LIDAR_TOP"}
    edit(drive, "sensor", rename_lidar)
    assert reference_channels(plan_of(drive)) == {"LIDAR_ROOF"}


def test_without_a_lidar_it_is_that_of_the_camera_nearest_in_time(drive: Path) -> None:
    edit(drive, "sample_data", lambda rows: [row for row in rows if "LIDAR" not in row["filename"]])
    assert reference_channels(plan_of(drive)) == {"CAM_BACK_LEFT"}


def test_sources_stand_where_the_car_was_when_they_fired(drive: Path) -> None:
    """At 9 m/s, 43.1 ms before the reference, CAM_FRONT_LEFT was 0.388 m farther back."""
    still, moving = plan_of(drive, ego_motion=False), plan_of(drive)
    channels = [still.dataset.sensor_of(row).channel for row in still.units[0].sources]
    place = channels.index("CAM_FRONT_LEFT")
    centres = []
    for plan in (still, moving):
        cam_from_ego = plan.frame(plan.units[0]).sources[place].cam_from_ego
        centres.append(-cam_from_ego[:3, :3].T @ cam_from_ego[:3, 3])
    np.testing.assert_allclose(centres[1] - centres[0], [-0.388, 0, 0], atol=0.01)


def test_utm_sized_coordinates_change_nothing(drive: Path) -> None:
    """Within 0.02 px at 1266 px focal length and 3 m: 5e-5 m; doubles at 5e6 m are good to 1e-9 m."""
    before = plan_of(drive).frame(plan_of(drive).units[0])

    def move(rows: Rows) -> None:
        for row in rows:
            row["translation"] = [
                row["translation"][0] + 600_000,
                row["translation"][1] + 5_000_000,
                row["translation"][2],
            ]

    edit(drive, "ego_pose", move)
    edit(drive, "sample_annotation", move)
    after = plan_of(drive).frame(plan_of(drive).units[0])
    for old, new in zip(before.sources, after.sources, strict=True):
        np.testing.assert_allclose(new.cam_from_ego, old.cam_from_ego, atol=1e-8)
    np.testing.assert_allclose(after.ego_from_box, before.ego_from_box, atol=1e-8)


def test_names_follow_nuscenes_and_never_collide(drive: Path) -> None:
    names = [name for unit in plan_of(drive).units for name in unit.pictures]
    assert names[0].startswith("samples/CAM_FRONT/n0")
    assert "__CAM_FRONT__" in names[0]

    def same_time(rows: Rows) -> None:
        for row in rows:
            row["timestamp"] = rows[0]["timestamp"]

    edit(drive, "sample_data", same_time)
    edit(drive, "log", lambda rows: [{**row, "logfile": "../../evil log\0"} for row in rows])
    names = [name for unit in plan_of(drive).units for name in unit.pictures]
    assert len(set(names)) == len(names) == 12
    assert all(name.count("/") == 2 and ".." not in name for name in names)


def test_odd_channel_names_of_the_source_do_no_harm_but_cannot_be_a_rig(drive: Path) -> None:
    def rename(rows: Rows) -> None:
        next(row for row in rows if row["channel"] == "CAM_FRONT")["channel"] = "../front camera"

    edit(drive, "sensor", rename)
    plan = plan_of(drive)
    assert len(plan.frame(plan.units[0]).sources) == 6
    with pytest.raises(DatasetError, match=r"sensor\.json.*field channel.*'../front camera' is not a channel name"):
        rig_of_dataset(plan.dataset)


def test_the_visibility_refers_to_all_cameras_whatever_is_rendered_from(drive: Path) -> None:
    plan = plan_of(drive, cameras=("CAM_FRONT",))
    frame = plan.frame(plan.units[0])
    assert (len(frame.sources), len(frame.witnesses)) == (1, 6)


def test_an_own_rig_of_five_cameras_is_said_to_break_trainers(drive: Path) -> None:
    assert any("5 cameras" in note and "mmdetection3d" in note for note in plan_of(drive, "5x75").notes)
    assert plan_of(drive).notes == []


def test_a_camera_below_the_ground_or_beyond_the_ball_is_said(drive: Path) -> None:
    edit(drive, "calibrated_sensor", lambda rows: [{**row, "translation": [0.0, 0.0, -0.2]} for row in rows])
    (note,) = plan_of(drive).notes
    assert "CAM_FRONT" in note
    assert "below the ground" in note


def test_the_estimate_is_of_the_right_size(drive: Path) -> None:
    """12 pictures of 1.44 Mpixel: nuScenes' real keyframe takes 0.21 bytes a pixel at quality 95."""
    assert plan_of(drive).estimated_bytes() == pytest.approx(12 * 1.44e6 * 0.21, rel=0.1)
    assert plan_of(drive, quality=80).estimated_bytes() < 0.6 * plan_of(drive).estimated_bytes()


def test_the_digest_names_what_the_output_depends_on_and_nothing_else(drive: Path) -> None:
    digest = plan_of(drive).digest
    assert plan_of(drive, jobs=4, verify="full", on_error="skip").digest == digest
    others = [
        plan_of(drive, depth_limit_m=35.0),
        plan_of(drive, blend="nearest"),
        plan_of(drive, "6x70"),
        plan_of(drive, ego_motion=False),
        plan_of(drive, quality=90),
        plan_of(drive, link="copy"),
        plan_of(drive, cameras=("CAM_FRONT",)),
    ]
    edit(drive, "log", lambda rows: [{**row, "vehicle": "another"} for row in rows])
    others.append(plan_of(drive))
    assert len({digest, *(plan.digest for plan in others)}) == 1 + len(others)


@pytest.mark.parametrize(
    "options", [{"quality": 0}, {"depth_limit_m": -1.0}, {"jobs": -1}, {"depth_limit_m": float("nan")}]
)
def test_options_that_cannot_be(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="--"):
        Options(**options)
