"""`unidrive measure --rig`: the projection error over datasets, on a painted drive and on real ones."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests import reference
from tests.datasets import VERSION, Bench, Row, Run, paint, rows, tree, unidrive
from tests.geometry.test_projection_error import Setting, scalar_errors
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.scene import GroundPlane, HalfBall
from unidrive_cli.measure.projection import measure_projection
from unidrive_cli.rig.gallery import gallery_folder, load_gallery_rig
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import WarpChoices

RIG = "roof-6x70"
SAMPLE = "ca9a282c9e77460f8360f564131a8af5"
KEYS = ["schema_version", "pairs", "blended", "uncovered", "behind", "by_camera", "by_source", "by_class"]
KEYS += ["by_dataset", "by_distance", "measured", "rig", "depth_limit_m", "ground_height_m", "ego_motion", "notes"]


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", scenes=2, samples=2)


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    return Bench(tmp_path, painted)


@pytest.fixture(scope="module")
def keyframe(shared_data: Path) -> Path:
    return shared_data / "nuscenes-onekeyframe"


@pytest.fixture(scope="module")
def two_cars(shared_data: Path) -> Path:
    return shared_data / "dgp-tri-2scenes"


def measured(*arguments: object, rig: object = RIG) -> dict[str, Any]:
    run = unidrive("measure", *arguments, "--rig", rig, "--json")
    assert run.code == 0, run.stderr
    document: dict[str, Any] = json.loads(run.stdout, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    return document


def refused(run: Run, code: int, *words: str) -> None:
    assert run.code == code, run.stdout + run.stderr
    assert run.stdout == ""
    for word in words:
        assert word in run.said, f"{word!r} is not in {run.said!r}"


# --- figures ----------------------------------------------------------------------------------------------------


def test_the_figures_of_the_real_keyframe(keyframe: Path) -> None:
    """They must not change unnoticed: one nuScenes keyframe of 69 boxes, seen by roof-6x70, with D0 = 50 m.

    552 corners; the six cameras see each (many of them through others: occlusion is not known), and in 304
    cases two at once, which makes 856 triples of 678 (corner, virtual camera). The mean of 0.073 m rad comes
    from the boxes beside and behind the car, where the baselines are largest; the median is less than half of
    it. Blending takes a sixth off, as the source with the smaller parallax has the larger share.
    `test_it_is_what_the_formulas_say_of_the_tables` comes to them in another way.
    """
    found = measured(keyframe)
    assert found["pairs"] == {
        "count": 856,
        "sum": pytest.approx(62.503805547, abs=1e-6),
        "mean": pytest.approx(0.073018464, abs=1e-8),
        "median": pytest.approx(0.030238588, abs=1e-8),
        "p90": pytest.approx(0.172585071, abs=1e-8),
    }
    assert found["blended"] == {
        "count": 678,
        "mean": pytest.approx(0.061272104, abs=1e-8),
        "median": pytest.approx(0.027995417, abs=1e-8),
        "p90": pytest.approx(0.134520913, abs=1e-8),
    }
    assert (found["uncovered"], found["behind"]) == ({"count": 0, "of": 552}, 0)
    assert found["measured"] == {"samples": 1, "boxes": 69}


@pytest.mark.parametrize("ego_motion", [True, False])
def test_it_is_what_the_formulas_say_of_the_tables(keyframe: Path, ego_motion: bool) -> None:
    """Tables, poses, corners and errors by code that shares nothing with the package."""
    truth = reference.load_sample(keyframe, VERSION, SAMPLE)
    ego_from_global = reference.inverse_pose(truth["reference_global_from_ego"])
    sources, channels = [], []
    for camera in truth["cameras"]:
        at_its_time = camera["global_from_ego"] if ego_motion else truth["reference_global_from_ego"]
        cam_from_global = reference.inverse_pose(at_its_time @ camera["ego_from_cam"])
        lens = Pinhole.from_matrix(camera["K"], camera["width"], camera["height"])
        sources.append((lens, cam_from_global @ truth["reference_global_from_ego"]))
        channels.append(camera["channel"])
    points, classes = [], []
    instances = {row["token"]: row["category_token"] for row in rows(keyframe, "instance")}
    categories = {row["token"]: row["name"] for row in rows(keyframe, "category")}
    for box in rows(keyframe, "sample_annotation"):
        half = np.array(box["size"])[[1, 0, 2]] / 2
        turned = reference.pose(reference.quaternion_matrix(box["rotation"]), box["translation"])
        for signs in np.ndindex(2, 2, 2):
            corner = reference.transform(turned, half * (2 * np.array(signs) - 1))
            points.append(reference.transform(ego_from_global, corner))
            classes.append(categories[instances[box["instance_token"]]])
    by: dict[tuple[str, str], list[float]] = defaultdict(list)
    seen: set[int] = set()
    for camera in reference.rig_from_yaml(gallery_folder() / f"{RIG}.yaml"):
        lens = Pinhole.from_matrix(camera["K"], camera["width"], camera["height"])
        ball = HalfBall(camera["ego_from_cam"][:3, 3], 50.0, GroundPlane())
        setting = Setting(sources, lens, camera["ego_from_cam"], ball, np.array(points))
        errors, shown, behind = scalar_errors(setting)
        assert behind == 0
        seen |= shown
        for (point, source), (error, _, distance) in errors.items():
            band = min(int(distance // 10), 6)
            for group, name in (
                ("all", ""), ("by_camera", camera["channel"]), ("by_source", channels[source]),
                ("by_class", classes[point]), ("by_distance", str(band)),
            ):  # fmt: skip
                by[group, name].append(error)
        for point in {point for point, _ in errors}:
            own = [value for key, value in errors.items() if key[0] == point]
            by["blended", ""].append(sum(e * share for e, share, _ in own) / sum(share for _, share, _ in own))
    found = measured(keyframe, *(() if ego_motion else ("--no-ego-motion",)))

    def same(document: dict[str, Any], errors: list[float]) -> None:
        assert document["count"] == len(errors)
        expected = [np.mean(errors), np.median(errors), np.quantile(errors, 0.9)] if errors else [None] * 3
        assert [document[key] for key in ("mean", "median", "p90")] == pytest.approx(expected, abs=1e-8)

    same(found["pairs"], by["all", ""])
    same(found["blended"], by["blended", ""])
    for group in ("by_camera", "by_source", "by_class"):
        assert set(found[group]) == {name for key, name in by if key == group}
        for name, document in found[group].items():
            same(document["pairs"], by[group, name])
    for band, document in enumerate(found["by_distance"]):
        same(document["pairs"], by["by_distance", str(band)])
    assert found["uncovered"]["count"] == found["uncovered"]["of"] - len(seen)


def test_the_motion_of_the_car_counts(keyframe: Path) -> None:
    """The cameras fire up to 43 ms before the lidar, at 9 m/s: left out, the boxes lie elsewhere for the sources."""
    with_motion, without = measured(keyframe), measured(keyframe, "--no-ego-motion")
    assert (with_motion["ego_motion"], without["ego_motion"]) == (True, False)
    assert abs(without["pairs"]["mean"] - with_motion["pairs"]["mean"]) > 1e-4


def test_the_keys_are_those_of_the_interface(keyframe: Path, two_cars: Path) -> None:
    found = measured(keyframe, two_cars)
    assert list(found) == KEYS
    assert found["schema_version"] == 1
    assert list(found["by_camera"]) == list(load_gallery_rig(RIG).channels)
    assert list(found["by_dataset"]) == [str(keyframe / VERSION), str(two_cars / "v1.0-dgp")]
    assert [(band["from_m"], band["to_m"]) for band in found["by_distance"]] == [
        (0, 10), (10, 20), (20, 30), (30, 40), (40, 50), (50, 60), (60, None),
    ]  # fmt: skip
    for group in ("by_camera", "by_class", "by_dataset"):
        for errors in found[group].values():
            assert list(errors["pairs"]) == ["count", "sum", "mean", "median", "p90"]
            assert list(errors["blended"]) == ["count", "mean", "median", "p90"]
    assert all(list(errors) == ["pairs"] for errors in found["by_source"].values())


def test_groups_add_up_to_the_whole(keyframe: Path, two_cars: Path) -> None:
    found = measured(keyframe, two_cars)
    for name in ("by_camera", "by_source", "by_class", "by_dataset", "by_distance"):
        groups = list(found[name].values() if isinstance(found[name], dict) else found[name])
        assert sum(group["pairs"]["count"] for group in groups) == found["pairs"]["count"]
        assert sum(group["pairs"]["sum"] for group in groups) == pytest.approx(found["pairs"]["sum"])
        if name != "by_source":
            assert sum(group["blended"]["count"] for group in groups) == found["blended"]["count"]
    for name in ("by_class", "by_dataset"):
        for key in ("count", "of"):
            assert sum(group["uncovered"][key] for group in found[name].values()) == found["uncovered"][key]


def test_several_datasets_are_pooled(keyframe: Path, two_cars: Path) -> None:
    both, one, other = measured(keyframe, two_cars), measured(keyframe), measured(two_cars)
    for pooled, alone in zip(both["by_dataset"].values(), (one, other), strict=True):
        assert pooled == {key: alone[key] for key in ("pairs", "blended", "uncovered", "behind")}
    assert set(both["by_source"]) == set(one["by_source"]) | set(other["by_source"])


def test_a_rig_that_is_the_source_has_no_error(painted: Path) -> None:
    """All cameras at one moment, each its own virtual camera: only what a neighbour sees is off."""
    found = measured(painted, "--no-ego-motion", "--camera", "CAM_FRONT", rig=painted)
    front = found["by_camera"]["CAM_FRONT"]
    assert front["pairs"]["count"] > 100
    assert front["pairs"]["sum"] < 1e-6


def test_what_no_virtual_camera_sees_is_uncovered(bench: Bench) -> None:
    """SMALL_RIG looks ahead and back only; of its 80 degrees nothing is to the side."""
    found = measured(bench.src, rig=bench.rig)
    share = found["uncovered"]
    assert 0 < share["count"] < share["of"] <= 8 * found["measured"]["boxes"]
    wide = measured(bench.src, rig="4x95")
    assert wide["uncovered"]["of"] == share["of"]
    assert wide["uncovered"]["count"] < share["count"]


def test_scenes_and_cameras_can_be_chosen(painted: Path) -> None:
    whole = measured(painted)
    scenes = [measured(painted, "--scene", row["name"]) for row in rows(painted, "scene")]
    assert sum(one["pairs"]["count"] for one in scenes) == whole["pairs"]["count"]
    cameras = [measured(painted, "--camera", channel) for channel in whole["by_source"]]
    assert sum(one["pairs"]["count"] for one in cameras) == whole["pairs"]["count"]
    assert all(list(one["by_source"]) == [name] for name, one in zip(whole["by_source"], cameras, strict=True))


def test_the_rigs_own_depth_limit_counts_unless_one_is_given(bench: Bench) -> None:
    bench.rig.write_text(bench.rig.read_text() + "depth_limit: 20\nground_height: 0.1\n")
    own, given = measured(bench.src, rig=bench.rig), measured(bench.src, "--depth-limit", 35, rig=bench.rig)
    assert [own["depth_limit_m"], own["ground_height_m"]] == [20, 0.1]
    assert given["depth_limit_m"] == 35
    assert own["pairs"]["mean"] != given["pairs"]["mean"]


def test_jobs_change_no_figure(bench: Bench) -> None:
    """Five samples with lenses of their own make as many batches, which processes then share."""
    kept = {row["token"] for row in rows(bench.src, "calibrated_sensor")}
    pictures = [row for row in rows(bench.src, "sample_data") if row["calibrated_sensor_token"] in kept]
    samples = sorted({row["sample_token"] for row in pictures})
    assert len(samples) == 4

    def own_calibrations(found: list[Row]) -> None:
        made = [
            {**row, "token": f"{row['token']}-{sample}", "camera_intrinsic": wider(row["camera_intrinsic"], sample)}
            for row in found
            for sample in samples
        ]
        found[:] = made

    def wider(intrinsic: list[list[float]], sample: str) -> list[list[float]]:
        if not intrinsic:
            return []
        factor = 1 + 0.01 * samples.index(sample)
        return [
            [intrinsic[0][0] * factor, 0, intrinsic[0][2]],
            [0, intrinsic[1][1] * factor, intrinsic[1][2]],
            [0, 0, 1],
        ]

    def point_there(found: list[Row]) -> None:
        for row in found:
            row["calibrated_sensor_token"] += f"-{row['sample_token']}"

    bench.edit("calibrated_sensor", own_calibrations)
    bench.edit("sample_data", point_there)
    found = [unidrive("measure", bench.src, "--rig", RIG, "--json", "--jobs", jobs) for jobs in (0, 2, 3)]
    assert [run.code for run in found] == [0, 0, 0], found[0].stderr
    assert len({run.stdout for run in found}) == 1


def test_coordinates_of_the_size_of_utm_change_nothing(bench: Bench) -> None:
    before = measured(bench.src)

    def move(found: list[Row]) -> None:
        for row in found:
            row["translation"] = [
                row["translation"][0] + 403_000,
                row["translation"][1] + 4_987_000,
                row["translation"][2],
            ]

    bench.edit("ego_pose", move)
    bench.edit("sample_annotation", move)
    after = measured(bench.src)
    assert after["pairs"] == pytest.approx(before["pairs"], abs=1e-4)
    assert after["blended"]["mean"] == pytest.approx(before["blended"]["mean"], abs=1e-7)


def test_the_same_from_python(keyframe: Path) -> None:
    told: list[tuple[int, int]] = []
    report = measure_projection(
        [open_dataset(keyframe)],
        load_gallery_rig(RIG),
        WarpChoices(),
        progress=lambda done, total: told.append((done, total)),
    )
    assert report.document() == measured(keyframe)
    assert told[-1] == (1, 1)


# --- text and picture -------------------------------------------------------------------------------------------


def test_the_table_fits_a_terminal(keyframe: Path, two_cars: Path) -> None:
    run = unidrive("measure", keyframe, two_cars, "--rig", RIG)
    assert (run.code, run.stderr) == (0, "")
    first, second, header, *lines = run.stdout.splitlines()
    assert first.startswith(
        "6 samples, 298 annotations; roof-6x70, depth limit 50 m; errors in metre-radians, 348.7"
    )
    assert second == "1,488 corners seen by a source, 2 of those (0.1%) by no virtual camera; 0 pairs behind it"
    assert header.split() == ["pairs", "mean", "median", "p90", "blended", "mean", "median", "p90"]
    assert max(len(line) for line in run.stdout.splitlines()) <= 100
    found = measured(keyframe, two_cars)
    pairs, blended = found["pairs"], found["blended"]
    assert lines[0].split() == [
        "all", f"{pairs['count']:,}",
        *(f"{pairs[key]:.4f}" for key in ("mean", "median", "p90")),
        f"{blended['count']:,}", *(f"{blended[key]:.4f}" for key in ("mean", "median", "p90")),
    ]  # fmt: skip
    names = {line[:34].strip() for line in lines}
    assert {*found["by_camera"], *found["by_source"], *found["by_class"], "0 to 10 m", "60 m and beyond"} <= names


def test_the_picture(keyframe: Path, tmp_path: Path) -> None:
    before = tree(keyframe)
    run = unidrive("measure", keyframe, "--rig", RIG, "--png", tmp_path / "error.png")
    assert run.code == 0, run.stderr
    picture = cv2.imread(str(tmp_path / "error.png"))
    assert picture.shape[0] > 700
    assert picture.shape[1] > 1500
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200
    assert [path.name for path in tmp_path.iterdir()] == ["error.png"]
    assert tree(keyframe) == before


def test_the_picture_where_there_is_no_error(painted: Path, tmp_path: Path) -> None:
    """Neither numbers to scale colours by, nor curves."""
    rig = tmp_path / "away.yaml"
    camera = "{width: 64, height: 36, hfov: 20, position: [0, 0, 1.6], yaw: 0, pitch: 80}"
    rig.write_text(f"name: up\ncameras:\n  CAM_UP: {camera}\n")
    run = unidrive("measure", painted, "--rig", rig, "--png", tmp_path / "error.png", "--json")
    assert run.code == 0, run.stderr
    found = run.json()
    assert found["pairs"] == {"count": 0, "sum": 0, "mean": None, "median": None, "p90": None}
    assert found["uncovered"]["count"] == found["uncovered"]["of"] > 0
    assert (tmp_path / "error.png").is_file()


# --- what is refused --------------------------------------------------------------------------------------------


def test_neither_rig_nor_truth(painted: Path) -> None:
    refused(unidrive("measure", painted), 2, "--rig or --truth is needed", "Give --rig RIG")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scene", "scene-0016"), ("scene-0016", "Did you mean scene-0061?")),
        (("--camera", "CAM_FRONT_LEF"), ("CAM_FRONT_LEF", "Did you mean CAM_FRONT_LEFT?")),
        (("--jobs", -1), ("--jobs must be 0 or more",)),
        (("--blend", "nearest"), ("--blend goes with --truth",)),
        (("--depth-limit", 1), ("CAM_FRONT", "depth limit")),
        (("--ground-height", 1.52), ("stands outside of the scene", "below the ground", "CAM_FRONT", "sample ")),
        (("--version", "v2"), ("--version v2",)),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else None,
)
def test_options_that_cannot_be(painted: Path, options: tuple[object, ...], words: tuple[str, ...]) -> None:
    refused(unidrive("measure", painted, "--rig", RIG, *options), 2, *words)


def test_a_source_beyond_the_depth_limit(bench: Bench) -> None:
    """CAM_FRONT stands 1.7 m ahead of the virtual CAM_BACK."""
    run = unidrive("measure", bench.src, "--rig", bench.rig, "--depth-limit", 1.65, "--no-ego-motion")
    refused(
        run, 2, f"{bench.src / VERSION}, sample ", "the camera CAM_FRONT stands outside", "CAM_BACK", "1.70 m away"
    )
    refused(run, 2, "--depth-limit")


def test_a_dataset_given_twice(painted: Path) -> None:
    refused(unidrive("measure", painted, painted, "--rig", RIG), 2, "is given 2 times")


def test_one_truth_for_several_datasets(painted: Path, keyframe: Path) -> None:
    run = unidrive("measure", painted, keyframe, "--rig", RIG, "--truth", painted)
    refused(run, 2, "compares the pictures of one dataset; 2 are given")


def test_a_dataset_without_boxes(bench: Bench) -> None:
    bench.edit("sample_annotation", lambda found: found.clear())
    bench.edit("instance", lambda found: found.clear())
    refused(
        unidrive("measure", bench.src, "--rig", RIG), 3, str(bench.src), "4 chosen samples have no annotated boxes"
    )


def test_boxes_that_nobody_sees(bench: Bench) -> None:
    def lift(found: list[Row]) -> None:
        for row in found:
            row["translation"][2] += 5000

    bench.edit("sample_annotation", lift)
    refused(unidrive("measure", bench.src, "--rig", RIG), 3, str(bench.src), "no camera sees any of the")


def test_a_box_without_an_instance(bench: Bench) -> None:
    bench.edit("sample_annotation", lambda found: found[3].update(instance_token="gone"))
    refused(unidrive("measure", bench.src, "--rig", RIG), 3, "sample_annotation.json", "instance_token", "'gone'")


def test_a_box_without_a_rotation(bench: Bench) -> None:
    bench.edit("sample_annotation", lambda found: found[3].update(rotation=[0, 0, 0, 0]))
    refused(unidrive("measure", bench.src, "--rig", RIG), 3, "sample_annotation.json", "rotation", "unit quaternion")


@pytest.mark.parametrize(
    ("table", "field", "value"),
    [
        ("ego_pose", "translation", [1e308, 0, 0]),
        ("calibrated_sensor", "translation", [0, -1e10, 0]),
        ("sample_annotation", "translation", [0, 0, 1e200]),
        ("sample_annotation", "size", [1, 1e308, 1]),
        ("sample_annotation", "size", [1, -1, 1]),
    ],
)
def test_lengths_that_are_none(bench: Bench, table: str, field: str, value: list[float]) -> None:
    bench.edit(table, lambda found: found[0].update({field: value}))
    refused(unidrive("measure", bench.src, "--rig", RIG), 3, f"{table}.json", field, "metres")


def test_samples_without_boxes_are_said(bench: Bench) -> None:
    one = rows(bench.src, "sample")[0]["token"]
    bench.edit(
        "sample_annotation",
        lambda found: found.__setitem__(slice(None), [r for r in found if r["sample_token"] != one]),
    )
    found = measured(bench.src)
    assert found["measured"]["samples"] == 3
    assert any("1 of 4 samples" in note for note in found["notes"])


def test_a_picture_that_cannot_be_written(painted: Path, tmp_path: Path) -> None:
    run = unidrive("measure", painted, "--rig", RIG, "--png", tmp_path / "no" / "error.png")
    refused(run, 4, "error.png", "cannot be written")
