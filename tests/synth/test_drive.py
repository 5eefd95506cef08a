"""A small synthetic drive through two rigs, looked at as its users would: files, tables, boxes, pictures."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import box_in_image, view_points
from nuscenes.utils.splits import create_splits_scenes

from tests.datasets import SCRIPT, in_own_mounts, unidrive
from unidrive_cli.check.validation import find_subject, validate
from unidrive_cli.geometry import poses
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse, rotation_from_yaw_pitch_roll, transform
from unidrive_cli.rig.yaml_file import load_rig, parse_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.renderers import gl_missing, open_renderer
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.synth.scene import Scene, make_scene
from unidrive_cli.synth.stage import View
from unidrive_cli.synth.traffic import EGO_CENTRE_M, EGO_LENGTH_M, EGO_WIDTH_M, overlap
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.pictures import picture_size

RIG = """
name: {name}
cameras:
  CAM_FRONT: {{width: 320, height: 180, intrinsics: [230, 236, 171.5, 83.25], position: [1.5, 0.2, 1.6], yaw: 3}}
  CAM_BACK: {{width: 320, height: 180, hfov: {hfov}, position: [0.0, 0.0, 1.6], yaw: 180, pitch: -4}}
"""
VERSION = "v1.0-trainval"
DRIVE = SynthOptions(seed=5, scenes=2, keyframes=2, instances=True, depth=True)
HILLS = replace(DRIVE, slope_percent=6.0, ego_tilt_deg=2.0)
OPTIONS = ("--scenes", "2", "--keyframes", "2", "--seed", "5", "--jobs", "0", "--instances", "--depth")


scenes_made = functools.cache(make_scene)


@pytest.fixture(autouse=True)
def scenes_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene takes seconds. Worker processes make their own, and the same bytes come of it."""
    monkeypatch.setattr("unidrive_cli.synth.units.make_scene", scenes_made)


def tree(root: Path) -> dict[str, str]:
    """SHA-256 of every file but run.json, by its name."""
    files = sorted(path for path in root.rglob("*") if path.is_file() and path.name != "run.json")
    return {path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("rigs")
    for name, hfov in (("narrow", 60), ("wide", 100)):
        (folder / f"{name}.yaml").write_text(RIG.format(name=name, hfov=hfov))
    return {path.stem: path for path in folder.iterdir()}


@pytest.fixture(scope="module")
def both(rigs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive through both rigs: one folder each."""
    root = tmp_path_factory.mktemp("drive") / "out"
    run = unidrive("synth", root, "--rig", rigs["narrow"], "--rig", rigs["wide"], *OPTIONS)
    assert run.code == 0, run.stderr
    assert "renderer: " in run.stderr
    return root


@pytest.fixture(scope="module")
def nusc(both: Path) -> NuScenes:
    return NuScenes(VERSION, str(both / "narrow"), verbose=False)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scenes_made(DRIVE, 0)


def test_the_tables_hold(both: Path) -> None:
    for name in ("narrow", "wide"):
        dataset = open_dataset(both / name)
        assert validate(find_subject(both / name, None, picture_size)).findings == []
        assert dataset.notes == []
        assert len(dataset.sample.rows) == 4
        assert {row.name for row in dataset.scene.rows} <= set(create_splits_scenes()["train"]) | set(
            create_splits_scenes()["val"]
        )
        assert json.loads((both / name / VERSION / "splits.json").read_text())["val"]
        assert len(dataset.sample_annotation.rows) > 60


def test_scenes_samples_and_annotations_agree_between_rigs(both: Path) -> None:
    narrow, wide = (open_dataset(both / name) for name in ("narrow", "wide"))
    for table in ("scene", "sample", "instance", "log", "map", "category", "attribute"):
        assert getattr(narrow, table).digest == getattr(wide, table).digest, table
    rows = [{row.token: row for row in dataset.sample_annotation.rows} for dataset in (narrow, wide)]
    assert rows[0].keys() == rows[1].keys()
    for token, row in rows[0].items():
        other = rows[1][token]
        assert (row.translation, row.size, row.num_lidar_pts) == (other.translation, other.size, other.num_lidar_pts)
    clouds = [tree(both / name / "samples" / "LIDAR_TOP") for name in ("narrow", "wide")]
    assert clouds[0] == clouds[1]
    assert narrow.sensor_of_calibration.keys() != wide.sensor_of_calibration.keys()


def test_other_rigs_jobs_and_a_stop_change_no_byte(rigs: dict[str, Path], both: Path, tmp_path: Path) -> None:
    """Ctrl-C after one of four samples; meanwhile nothing looks whole. Workers make the rest, and a lost file."""
    root = tmp_path / "out"
    plan = make_synth_plan(DRIVE, [load_rig(rigs["narrow"])], "auto")

    def stop(done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        synthesise(plan, root, progress=stop)
    assert (root / "UNFINISHED.txt").is_file()
    assert not (root / VERSION).exists()
    next((root / "samples" / "CAM_BACK").iterdir()).unlink()
    command = ("synth", root, "--rig", rigs["narrow"], *OPTIONS, "--jobs", "2")
    run = unidrive(*command)
    assert run.code == 0, run.stderr
    assert "already holds" not in run.stdout
    assert tree(root) == tree(both / "narrow")
    before = tree(root)
    again = unidrive(*command)
    assert again.code == 0
    assert "already holds this drive" in again.stdout
    assert tree(root) == before


def test_another_seed_is_another_drive(scene: Scene) -> None:
    other = make_scene(replace(DRIVE, seed=6), 0)
    assert not np.array_equal(scene.town.structures.positions_m[:50], other.town.structures.positions_m[:50])


def pictures(nusc: NuScenes) -> Iterator[tuple[dict[str, Any], Any, Pinhole, Any, Any]]:
    """(sample_data row, global_from_cam, lens, ids, depths) of every picture."""
    dataset = open_dataset(Path(nusc.dataroot))
    for row in dataset.sample_data.rows:
        if dataset.sensor_of(row).modality == "camera":
            calibration = dataset.calibrated_sensor.by_token[row.calibrated_sensor_token]
            lens = dataset.lens(calibration, row.width or 0, row.height or 0)
            pose = dataset.global_from_ego(row) @ dataset.ego_from_sensor(calibration)
            name = f"{Path(row.filename).parent.name}/{Path(row.filename).stem}.png"
            ids, depths = (
                cv2.imread(str(Path(nusc.dataroot) / kind / name), cv2.IMREAD_UNCHANGED)
                for kind in ("instances", "depth")
            )
            yield nusc.get("sample_data", row.token), pose, lens, ids, depths / 256


def test_actors_lie_inside_their_projected_boxes(nusc: NuScenes, scene: Scene) -> None:
    """At the cameras' own moments: boxes are annotated at the lidar's, so they are moved along."""
    values = {
        row["instance_token"]: row
        for row in json.loads((Path(nusc.dataroot) / VERSION / "instance_ids.json").read_text())
    }
    scenes = scene, scenes_made(DRIVE, 1)
    by_token = {nusc.scene[scene.index]["token"]: scene for scene in scenes}
    seen = 0
    for row, pose, lens, ids, _ in pictures(nusc):
        sample = nusc.get("sample", row["sample_token"])
        scene = by_token[sample["scene_token"]]
        actors = scene.global_from_actors(row["timestamp"])
        for token in sample["anns"]:
            annotation = nusc.get("sample_annotation", token)
            index = values[annotation["instance_token"]]["value"] - 16
            width, length, height = annotation["size"]
            signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, 8).T
            corners = transform(inverse(pose) @ actors[index], signs * np.array([length, width, height]) / 2)
            mine = np.argwhere(ids == index + 16)[:, ::-1]
            if not len(mine) or corners[:, 2].min() < 0.2:
                continue
            outline = corners[:, :2] / corners[:, 2:] * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px]
            hull = cv2.convexHull(outline.astype(np.float32))
            apart = [
                cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y in mine[:: max(1, len(mine) // 200)]
            ]
            assert min(apart) > -1.0
            seen += 1
    assert seen > 12


def test_unhidden_actors_reach_as_far_as_their_meshes(nusc: NuScenes, scene: Scene) -> None:
    """Triangles painted by OpenCV, at five times the size, are the silhouettes that pictures must show."""
    by_token = {nusc.scene[scene.index]["token"]: scene for scene in (scene, scenes_made(DRIVE, 1))}
    seen = 0
    for row, pose, lens, ids, _ in pictures(nusc):
        drawn = by_token[nusc.get("sample", row["sample_token"])["scene_token"]]
        poses = drawn.global_from_actors(row["timestamp"])
        for index in np.unique(ids[ids >= 16]).astype(int) - 16:
            mesh = drawn.stage.actors[index]
            points = transform(inverse(pose) @ poses[index], mesh.positions_m.astype(np.float64))
            if points[:, 2].min() < 0.2:
                continue
            places = points[:, :2] / points[:, 2:] * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px]
            low, high = places.min(axis=0), places.max(axis=0)
            if low.min() < 1 or (high > [lens.width_px - 2, lens.height_px - 2]).any():
                continue
            canvas = np.zeros((5 * lens.height_px, 5 * lens.width_px), dtype=np.uint8)
            for triangle in np.rint((5 * places + 2)[mesh.triangles]).astype(np.int32):
                cv2.fillConvexPoly(canvas, triangle, 1)
            whole, mine = canvas[2::5, 2::5] > 0, ids == index + 16
            if whole.sum() < 60 or (whole & mine).sum() < 0.97 * whole.sum():
                continue  # too small to tell, or something stands before it
            assert (mine & ~cv2.dilate(canvas, np.ones((11, 11)))[2::5, 2::5].astype(bool)).sum() == 0
            rows, columns = np.nonzero(mine)
            reach = np.array(
                [columns.min() - low[0], rows.min() - low[1], high[0] - columns.max(), high[1] - rows.max()]
            )
            assert reach.min() > -1.0
            assert reach.max() < 1.5  # tips thinner than a pixel may lie between the centres
            seen += 1
    assert seen > 5


def test_depth_pictures_put_the_road_at_its_height(nusc: NuScenes) -> None:
    for _, pose, lens, ids, depths in pictures(nusc):
        rows, columns = np.nonzero((ids == 1) & (depths > 0) & (depths < 25))
        rays = lens.unproject(np.stack([columns, rows], axis=-1).astype(float))
        height = transform(pose, rays * (depths[rows, columns] / rays[:, 2])[:, None])[:, 2]
        assert np.abs(height).max() < 0.2  # the road is at 0, the pavement at 0.12
        assert (np.abs(height) < 0.03).mean() > 0.3


def test_lidar_points_lie_in_their_boxes(nusc: NuScenes) -> None:
    compared = 0
    for sample in nusc.sample:
        row = nusc.get("sample_data", sample["data"]["LIDAR_TOP"])
        path, boxes, _ = nusc.get_sample_data(row["token"])
        cloud = np.fromfile(path, np.float32).reshape(-1, 5)
        assert set(np.unique(cloud[:, 4])) <= set(range(32))
        assert len(cloud) > 15_000
        for box in boxes:
            local = (cloud[:, :3] - box.center) @ box.rotation_matrix
            width, length, height = box.wlh
            inside = (np.abs(local) <= np.array([length, width, height]) / 2 + 1e-3).all(axis=1).sum()
            road = local[:, 2] < 0.03 - height / 2  # what is under the box may graze it
            above = (np.abs(local[~road]) <= np.array([length, width, height]) / 2 - 1e-3).all(axis=1).sum()
            stated = nusc.get("sample_annotation", box.token)["num_lidar_pts"]
            assert inside >= stated
            assert above - stated <= 1
            compared += stated > 0
    assert compared > 60


def test_visibility_says_what_the_pictures_show(nusc: NuScenes) -> None:
    values = {
        row["instance_token"]: row["value"]
        for row in json.loads((Path(nusc.dataroot) / VERSION / "instance_ids.json").read_text())
    }
    counted: dict[str, dict[int, int]] = {}
    for row, _, _, ids, _ in pictures(nusc):
        found = counted.setdefault(row["sample_token"], {})
        for value, count in zip(*np.unique(ids, return_counts=True), strict=True):
            found[int(value)] = found.get(int(value), 0) + int(count)
    levels = set()
    for annotation in nusc.sample_annotation:
        pixels = counted[annotation["sample_token"]].get(values[annotation["instance_token"]], 0)
        levels.add(annotation["visibility_token"])
        if not pixels:
            assert annotation["visibility_token"] == "1"
    assert levels == {"1", "2", "3", "4"} or len(levels) >= 3


def test_velocities_and_attributes_follow_the_tracks(nusc: NuScenes) -> None:
    moving = still = 0
    for annotation in nusc.sample_annotation:
        velocity = nusc.box_velocity(annotation["token"])
        name = nusc.get("attribute", annotation["attribute_tokens"][0])["name"]
        speed = float(np.linalg.norm(velocity[:2]))
        if name == "vehicle.parked" and np.isfinite(speed):
            assert speed < 1e-6
            still += 1
        if name == "vehicle.moving" and np.isfinite(speed):
            assert 0.05 < speed < 15
            moving += 1
    assert still > 5
    assert moving > 2


def test_boxes_project_where_the_devkit_looks(nusc: NuScenes) -> None:
    shown = 0
    for sample in nusc.sample:
        for channel in ("CAM_FRONT", "CAM_BACK"):
            _, boxes, intrinsic = nusc.get_sample_data(sample["data"][channel])
            for box in boxes:
                assert box_in_image(box, intrinsic, (320, 180))
                assert np.isfinite(view_points(box.corners(), intrinsic, normalize=True)).all()
                shown += 1
    assert shown > 20


def test_the_map_is_white_under_the_ego_car(nusc: NuScenes) -> None:
    for sample in nusc.sample:
        log = nusc.get("log", nusc.get("scene", sample["scene_token"])["log_token"])
        mask = nusc.get("map", log["map_token"])["mask"].mask()
        pose = nusc.get("ego_pose", nusc.get("sample_data", sample["data"]["LIDAR_TOP"])["ego_pose_token"])
        x, y, _ = pose["translation"]
        assert mask[mask.shape[0] - 1 - int(y / 0.1), int(x / 0.1)]
        assert 0.05 < (mask > 0).mean() < 0.6


def test_cameras_fire_as_nuscenes_do(nusc: NuScenes) -> None:
    sample = nusc.sample[0]
    offsets = {
        channel: nusc.get("sample_data", sample["data"][channel])["timestamp"] - sample["timestamp"]
        for channel in ("CAM_FRONT", "CAM_BACK", "LIDAR_TOP")
    }
    assert offsets["LIDAR_TOP"] == 0
    assert offsets["CAM_FRONT"] == pytest.approx(-35_500, abs=700)
    assert offsets["CAM_BACK"] == pytest.approx(-10_400, abs=200)


def test_sweeps_lie_between_key_frames(rigs: dict[str, Path], both: Path, tmp_path: Path) -> None:
    """12 Hz pictures and 20 Hz clouds, chained with the key frames, which stay as they are without sweeps."""
    root = tmp_path / "sweeps"
    plan = make_synth_plan(replace(DRIVE, scenes=1, sweeps=True), [load_rig(rigs["narrow"])], "auto")
    synthesise(plan, root, jobs=0)
    dataset = open_dataset(root)
    assert validate(find_subject(root, None, picture_size)).findings == []
    rows = {row.token: row for row in dataset.sample_data.rows}
    first, second = sorted(dataset.sample.rows, key=lambda row: row.timestamp)
    for channel, between, step_us in (("CAM_FRONT", 5, 83_333), ("CAM_BACK", 5, 83_333), ("LIDAR_TOP", 9, 50_000)):
        chain = [row for row in rows.values() if dataset.sensor_of(row).channel == channel]
        chain.sort(key=lambda row: row.timestamp)
        assert [row.is_key_frame for row in chain] == [True, *[False] * between, True]
        assert np.diff([row.timestamp for row in chain]) == pytest.approx(step_us, abs=1)
        assert [row.next for row in chain] == [*(row.token for row in chain[1:]), ""]
        assert [row.prev for row in chain] == ["", *(row.token for row in chain[:-1])]
        assert [row.sample_token for row in chain] == [first.token, *[second.token] * (between + 1)]
        for row in chain:
            assert row.filename.startswith(f"{'samples' if row.is_key_frame else 'sweeps'}/{channel}/")
            data = (root / row.filename).read_bytes()
            if row.is_key_frame:
                assert data == (both / "narrow" / row.filename).read_bytes()
        assert len({(root / row.filename).read_bytes() for row in chain}) == len(chain)
    NuScenes(VERSION, str(root), verbose=False)


def test_nobody_touches_anybody(scene: Scene) -> None:
    times = np.arange(-0.05, 1.0, 0.05)
    tracks = [actor.track.xy_heading(times) for actor in scene.traffic.actors]
    halves = [np.array([a.model.size_wlh_m[1], a.model.size_wlh_m[0]]) / 2 for a in scene.traffic.actors]
    place, heading = scene.traffic.ego.xy_heading(times)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    tracks.append((place + EGO_CENTRE_M * ahead, heading))
    halves.append(np.array([EGO_LENGTH_M, EGO_WIDTH_M]) / 2)
    for first in range(len(tracks)):
        for second in range(first):
            boxes = [(*tracks[index], halves[index]) for index in (first, second)]
            assert not overlap(*boxes).any(), (first, second)


def test_six_classes_are_there(scene: Scene) -> None:
    assert {actor.model.kind for actor in scene.traffic.actors} == {
        "car",
        "bus",
        "truck",
        "motorcycle",
        "bicycle",
        "pedestrian",
    }


def test_slope_and_tilt_move_the_road_against_the_car(scene: Scene) -> None:
    flat, hilly = scene, scenes_made(HILLS, 0)
    times = [flat.start_us + 60_000 * step for step in range(10)]
    assert all(flat.global_from_ego(t)[2, 2] == 1.0 for t in times)
    tilts = [np.rad2deg(np.arccos(hilly.global_from_ego(t)[2, 2])) for t in times]
    assert 0.5 < max(tilts) < 7
    place = hilly.global_from_ego(times[0])[:3, 3]
    assert place[2] == pytest.approx(float(hilly.terrain.height_m(place[:2])), abs=1e-9)
    for index, pose in enumerate(hilly.global_from_actors(times[0])):
        actor = hilly.traffic.actors[index]
        foot = pose[:3, 3] - (actor.model.size_wlh_m[2] / 2 + actor.track.floor_m) * pose[:3, 2]
        assert foot[2] == pytest.approx(float(hilly.terrain.height_m(pose[:2, 3])), abs=0.15)


BAD = {
    "inside the ego car": ("position: [1.5, 0.2, 1.6]", "position: [1.5, 0.2, 0.8]", "inside the ego car", 2),
    "below ground": ("position: [1.5, 0.2, 1.6]", "position: [1.5, 0.2, -0.3]", "above it", 2),
    "as the lidar": ("CAM_BACK:", "lidar_top:", "LIDAR_TOP and lidar_top differ only by case", 2),
    "in a building": ("position: [1.5, 0.2, 1.6]", "position: [1.5, 18, 1.6]", "inside a building", 2),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_rigs_are_one_sentence(name: str, tmp_path: Path) -> None:
    old, new, words, code = BAD[name]
    path = tmp_path / "bad.yaml"
    text = RIG.format(name="bad", hfov=60).replace(old, new)
    assert parse_rig(RIG.format(name="good", hfov=60), "good")
    path.write_text(text)
    run = unidrive("synth", tmp_path / "out", "--rig", path, *OPTIONS)
    assert run.code == code, run.stderr
    assert words in run.stderr
    assert "Traceback" not in run.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--keyframes", "0"), "--keyframes must be from 1"),
        (("--scenes", "0"), "--scenes must be from 1"),
        (("--samples-per-pixel", "3"), "1, 4 or 16"),
        (("--slope", "80"), "--slope must be from 0"),
        (("--scenes", "11", "--version", "v1.0-mini"), "has names for 8 training"),
    ],
)
def test_bad_options_are_one_sentence(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    run = unidrive("synth", tmp_path / "out", "--rig", "6x60", *arguments)
    assert run.code == 2
    assert words in run.stderr
    assert not (tmp_path / "out").exists()


def test_two_rigs_with_the_same_cameras(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.yaml" for name in ("one", "other")]
    for path in paths:
        path.write_text(RIG.format(name=path.stem, hfov=50))
    both = [word for path in paths for word in ("--rig", path)]
    run = unidrive("synth", tmp_path / "out", *both, "--keyframes", "1", "--jobs", "0")
    assert run.code == 0, run.stderr
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["one", "other"]


def test_two_rigs_of_one_name_are_refused(rigs: dict[str, Path], tmp_path: Path) -> None:
    """On some disks `narrow` and `Narrow` are one folder."""
    other = tmp_path / "other.yaml"
    other.write_text(RIG.format(name="Narrow", hfov=50))
    run = unidrive("synth", tmp_path / "out", "--rig", rigs["narrow"], "--rig", other, *OPTIONS)
    assert run.code == 2
    assert "two rigs have this name" in run.stderr


def test_a_disk_that_is_too_small_is_said_before_the_start(tmp_path: Path) -> None:
    """One key frame: six pictures of 0.3 MB, a cloud of 0.7."""
    command = f"{SCRIPT} synth disk/out --rig 6x60 --keyframes 1 --jobs 0"
    run = in_own_mounts(f"mkdir disk && mount -t tmpfs -o size=2m tmpfs disk && {command}", tmp_path)
    assert run.code == 4
    assert "will take about 0.002" in run.stderr
    assert "--no-space-check" in run.stderr


def test_a_folder_of_somebody_else_is_left_alone(tmp_path: Path, rigs: dict[str, Path]) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    run = unidrive("synth", tmp_path, "--rig", rigs["narrow"], *OPTIONS)
    assert run.code == 4
    assert "was not made by unidrive" in run.stderr
    (tmp_path / "file").write_text("")
    assert unidrive("synth", tmp_path / "file" / "out", "--rig", rigs["narrow"], *OPTIONS).code == 4


def test_missing_gl_is_said(tmp_path: Path, rigs: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("moderngl.create_context", lambda **_: (_ for _ in ()).throw(RuntimeError("no libEGL.so.1")))
    from typer.testing import CliRunner

    from unidrive_cli.cli.main import app

    run = CliRunner().invoke(app, ["synth", str(tmp_path / "out"), "--rig", str(rigs["narrow"]), "--renderer", "gl"])
    assert run.exit_code == 2
    assert "libegl1" in run.output


def test_both_renderers_draw_the_same_street(scene: Scene) -> None:
    if gl_missing():
        pytest.skip(f"no GL here: {gl_missing()}")
    lens = Pinhole(520.0, 515.0, 395.5, 221.0, 800, 450)
    time_us = scene.start_us
    actors = scene.global_from_actors(time_us)
    shown = np.linalg.norm(actors[:, :2, 3] - scene.global_from_ego(time_us)[:2, 3], axis=1) < 130
    level = poses.pose(rotation_from_yaw_pitch_roll(20.0, -3.0, 0.0), [1.2, 0.0, 1.6])
    view = View(lens, scene.global_from_ego(time_us) @ level, actors, shown)
    drawn = []
    for which in ("gl", "rays"):
        renderer = open_renderer(scene.stage, which)
        drawn.append((renderer.picture(view, 4).astype(float), *renderer.instances(view)))
        renderer.close()
    (first, ids, depths), (second, other_ids, other_depths) = drawn
    assert 10 * np.log10(255**2 / np.mean((first - second) ** 2)) >= 30
    compared = 0
    for value in np.unique(ids[ids >= 16]):
        mine, theirs = ids == value, other_ids == value
        if mine.sum() > 400:
            assert (mine & theirs).sum() / (mine | theirs).sum() >= 0.98
            compared += 1
    assert compared >= 2
    same = (ids == other_ids) & np.isfinite(depths) & np.isfinite(other_depths)
    assert np.percentile(np.abs(depths - other_depths)[same] / depths[same], 99) < 1e-3


def test_the_truth_of_a_virtual_view_is_measured(rigs: dict[str, Path], both: Path, tmp_path: Path) -> None:
    """The wide rig's pictures through the narrow rig, against the narrow rig's own."""
    late = unidrive("measure", both / "wide", "--rig", rigs["narrow"], "--truth", both / "narrow")
    assert late.code == 3
    assert "--firing together" in late.stderr  # those pictures were taken one after the other
    options = ("--keyframes", "1", "--seed", "5", "--jobs", "0", "--instances", "--firing", "together")
    root = tmp_path / "out"
    assert unidrive("synth", root, "--rig", rigs["narrow"], "--rig", rigs["wide"], *options).code == 0
    run = unidrive("measure", root / "wide", "--rig", rigs["narrow"], "--truth", root / "narrow", "--json")
    assert run.code == 0, run.stderr
    truth = run.json()["truth"]
    assert truth["by_camera"]["CAM_FRONT"]["psnr"] is None  # the same camera: the same picture
    assert truth["by_camera"]["CAM_FRONT"]["ssim"] == pytest.approx(1.0)
    back = truth["by_camera"]["CAM_BACK"]
    assert 22 < back["psnr"] < 60  # only the focal length differs: resampling is all that is lost
    assert back["ground"]["pixels"] > 1000
