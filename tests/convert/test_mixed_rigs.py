"""Cameras that change, appear and vanish: every picture is what it would be with the cameras of its sample alone."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.datasets import CHANNELS, SMALL_RIG, VERSION, Row, Run, assert_consistent, rows, rows_of, unidrive
from tests.painted import PaintedCamera, nuscenes_like_cameras, write_painted

SIX, OTHER = "six", "other"
"""The cars."""


def other_cameras() -> Sequence[PaintedCamera]:
    """Four cameras, turned by 9 degrees and 0.2 m lower, with two picture sizes; one has a name of its own."""
    cosine, sine = np.cos(np.radians(9)), np.sin(np.radians(9))
    moved = np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, -0.2], [0, 0, 0, 1]])
    sizes = {"CAM_FRONT": (64, 36), "CAM_SIDE": (64, 36), "CAM_BACK_RIGHT": (96, 54), "CAM_BACK": (96, 60)}
    return [
        PaintedCamera(
            channel,
            width,
            height,
            np.array([[0.6 * width, 0, (width - 1) / 2], [0, 0.6 * width, (height - 1) / 2], [0, 0, 1]]),
            moved @ camera.ego_from_cam,
            camera.fires_us,
        )
        for camera, (channel, (width, height)) in zip(nuscenes_like_cameras(), sizes.items(), strict=False)
    ]


@pytest.fixture(scope="module")
def cars(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two scenes of two samples, seen by two cars: one with JPEG pictures, one with PNG."""
    folder = tmp_path_factory.mktemp("cars")
    for name, cameras, suffix in ((SIX, nuscenes_like_cameras(0.05), ".jpg"), (OTHER, other_cameras(), ".png")):
        write_painted(folder / name, cameras=cameras, scenes=2, supersample=1, picture_suffix=suffix)
    return {name: folder / name for name in (SIX, OTHER)}


@pytest.fixture(scope="module")
def alone(cars: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each car's drive, converted."""
    folder = tmp_path_factory.mktemp("alone")
    for name, drive in cars.items():
        converted(drive, folder / name)
    return {name: folder / name for name in cars}


def write_table(root: Path, name: str, found: list[Row]) -> None:
    (root / VERSION / f"{name}.json").write_text(json.dumps(found))


def write_pictures(root: Path, found: list[Row]) -> None:
    """Writes sample_data, linked per channel and scene."""
    scenes = {row["token"]: row["scene_token"] for row in rows(root, "sample")}
    lists: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(found, key=lambda row: row["timestamp"]):
        row["prev"] = row["next"] = ""
        lists.setdefault((scenes[row["sample_token"]], row["filename"].split("/")[1]), []).append(row)
    for own in lists.values():
        for before, after in pairwise(own):
            before["next"], after["prev"] = after["token"], before["token"]
    write_table(root, "sample_data", found)


def mixed(cars: dict[str, Path], root: Path, of_other: Sequence[int]) -> Path:
    """The drive of the six cameras, in which some samples, by their index, were seen by the other car."""
    shutil.copytree(cars[SIX], root)
    other = cars[OTHER]
    chosen = {rows(root, "sample")[index]["token"] for index in of_other}
    gone = {row["token"] for row in rows_of(root, "camera") if row["sample_token"] in chosen}
    added = [row for row in rows_of(other, "camera") if row["sample_token"] in chosen]
    known = {row["token"] for row in rows(root, "sensor")}
    write_table(root, "sensor", rows(root, "sensor") + [r for r in rows(other, "sensor") if r["token"] not in known])
    calibrations = [{**row, "token": f"other {row['token']}"} for row in rows(other, "calibrated_sensor")]
    write_table(root, "calibrated_sensor", rows(root, "calibrated_sensor") + calibrations)
    poses = {row["token"]: row for row in (*rows(root, "ego_pose"), *rows(other, "ego_pose"))}
    write_table(root, "ego_pose", list(poses.values()))
    for row in added:
        row["calibrated_sensor_token"] = f"other {row['calibrated_sensor_token']}"
        (root / row["filename"]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(other / row["filename"], root / row["filename"])
    write_pictures(root, [row for row in rows(root, "sample_data") if row["token"] not in gone] + added)
    return root


def without(root: Path, gone: Callable[[Row], bool]) -> Path:
    """Takes camera rows out of a drive; their pictures stay, as in a drive that was thinned."""
    tokens = {row["token"] for row in rows_of(root, "camera") if gone(row)}
    assert tokens
    write_pictures(root, [row for row in rows(root, "sample_data") if row["token"] not in tokens])
    return root


def blind_behind(cars: dict[str, Path], root: Path, samples: Sequence[int]) -> Path:
    """The drive of the six cameras, in which those that look back are missing in some samples."""
    shutil.copytree(cars[SIX], root)
    chosen = [rows(root, "sample")[index]["token"] for index in samples]
    return without(root, lambda row: row["sample_token"] in chosen and "/CAM_BACK" in row["filename"])


def run(source: Path, destination: Path, *options: object) -> Run:
    rig = destination.with_suffix(".yaml")
    rig.write_text(SMALL_RIG)
    return unidrive("convert", source, destination, "--rig", rig, "--jobs", 0, *options)


def converted(source: Path, destination: Path, *options: object) -> Run:
    done = run(source, destination, *options)
    assert done.code == 0, done.stderr
    assert_consistent(destination)
    gaps = (
        ["KEY-2"] if "lack cameras, at which" in done.stdout else []
    )  # a sample without one of its scene's cameras
    found = unidrive("validate", destination, "--json").json()
    assert [rule for rule, count in found["counts"].items() if count] in (gaps, [])
    return done


def pictures(root: Path, channel: str) -> dict[int, bytes]:
    """Picture and mask of a virtual camera, by the index of the sample."""
    samples = [row["token"] for row in rows(root, "sample")]
    return {
        samples.index(row["sample_token"]): (root / row["filename"]).read_bytes()
        + (root / "masks" / channel / Path(row["filename"]).with_suffix(".png").name).read_bytes()
        for row in rows_of(root, "camera")
        if f"/{channel}/" in row["filename"]
    }


# --- every sample with its own cameras ----------------------------------------------------------------------------


@pytest.mark.parametrize("of_other", [(2, 3), (1, 2)], ids=["from scene to scene", "from sample to sample"])
def test_each_sample_is_seen_as_if_its_car_were_alone(
    cars: dict[str, Path], alone: dict[str, Path], tmp_path: Path, of_other: tuple[int, ...]
) -> None:
    """Other calibrations, channels, picture sizes and formats."""
    source = mixed(cars, tmp_path / "src", of_other)
    suffixes = {Path(row["filename"]).suffix for row in rows_of(source, "camera")}
    assert suffixes == {".jpg", ".png"}
    converted(source, tmp_path / "dst")
    for channel in CHANNELS:
        found = pictures(tmp_path / "dst", channel)
        expected = {name: pictures(root, channel) for name, root in alone.items()}
        assert sorted(found) == [0, 1, 2, 3]
        for sample, picture in found.items():
            assert picture == expected[OTHER if sample in of_other else SIX][sample], (channel, sample)
            assert picture != expected[SIX if sample in of_other else OTHER][sample]


def test_cameras_vanish_and_appear(cars: dict[str, Path], alone: dict[str, Path], tmp_path: Path) -> None:
    """What looks ahead stays the same, what looked back is black, and comes back in the next sample."""
    source = blind_behind(cars, tmp_path / "src", (0, 3))
    done = converted(source, tmp_path / "dst")
    assert "2 of 4 samples lack some of the cameras" in done.stdout
    assert pictures(tmp_path / "dst", "CAM_FRONT") == pictures(alone[SIX], "CAM_FRONT")
    behind, before = pictures(tmp_path / "dst", "CAM_BACK"), pictures(alone[SIX], "CAM_BACK")
    assert {sample for sample in before if behind[sample] == before[sample]} == {1, 2}
    for path in sorted((tmp_path / "dst" / "samples" / "CAM_BACK").iterdir())[::3]:
        assert not cv2.imread(str(path)).any()


def test_a_picture_in_two_formats_is_one_camera(cars: dict[str, Path], tmp_path: Path) -> None:
    """PNG holds what the JPEG's decoder gives: the same virtual picture to a grey level or two."""
    source = Path(shutil.copytree(cars[SIX], tmp_path / "src"))
    found = rows(source, "sample_data")
    for row in found:
        if row["filename"].startswith("samples/CAM_FRONT/"):
            picture = cv2.imread(str(source / row["filename"]))
            row["filename"], row["fileformat"] = row["filename"].replace(".jpg", ".png"), "png"
            assert cv2.imwrite(str(source / row["filename"]), picture)
    write_table(source, "sample_data", found)
    converted(source, tmp_path / "dst")
    converted(cars[SIX], tmp_path / "same")
    for path in (tmp_path / "dst" / "samples" / "CAM_FRONT").iterdir():
        picture = cv2.imread(str(path)).astype(int)
        jpeg = cv2.imread(str(tmp_path / "same" / path.relative_to(tmp_path / "dst"))).astype(int)
        assert np.abs(picture - jpeg).mean() < 2


# --- coverage -----------------------------------------------------------------------------------------------------


def half_blind(cars: dict[str, Path], tmp_path: Path) -> Path:
    """CAM_BACK of the virtual rig: black in two of four samples, whole in the others."""
    return blind_behind(cars, tmp_path / "src", (0, 3))


def chain(root: Path, channel: str) -> list[tuple[str, str]]:
    return [(row["prev"], row["next"]) for row in rows_of(root, "camera") if f"/{channel}/" in row["filename"]]


def test_a_camera_below_the_least_coverage_is_dropped(
    cars: dict[str, Path], alone: dict[str, Path], tmp_path: Path
) -> None:
    done = converted(half_blind(cars, tmp_path), tmp_path / "dst", "--min-coverage", 0.6)
    assert "Left out, being covered less than 60% in the mean of all samples: CAM_BACK (50.0%)." in done.stdout
    assert "The rig has 1 cameras (CAM_FRONT)" in done.stdout
    document = json.loads((tmp_path / "dst" / "unidrive.json").read_text())
    assert list(document["rig"]["cameras"]) == ["CAM_FRONT"]
    assert document["counts"]["pictures"] == 4
    assert {row["channel"] for row in rows(tmp_path / "dst", "sensor") if row["modality"] == "camera"} == {
        "CAM_FRONT"
    }
    assert not (tmp_path / "dst" / "samples" / "CAM_BACK").exists()
    assert pictures(tmp_path / "dst", "CAM_FRONT") == pictures(alone[SIX], "CAM_FRONT")
    assert "CAM_BACK" not in (tmp_path / "dst" / "TRAINING.md").read_text()


def test_a_camera_above_it_stays_and_its_low_pictures_are_counted(cars: dict[str, Path], tmp_path: Path) -> None:
    done = converted(half_blind(cars, tmp_path), tmp_path / "dst", "--min-coverage", 0.4)
    assert "2 of 8 pictures are covered less than 40% (CAM_BACK 2), and kept." in done.stdout
    assert sorted(pictures(tmp_path / "dst", "CAM_BACK")) == [0, 1, 2, 3]


def test_low_pictures_are_dropped_one_by_one(cars: dict[str, Path], alone: dict[str, Path], tmp_path: Path) -> None:
    source = half_blind(cars, tmp_path)
    done = converted(source, tmp_path / "dst", "--min-coverage", 0.6, "--low-coverage", "drop-picture")
    assert (
        "2 of 8 pictures are covered less than 60% (CAM_BACK 2), and left out: 2 of 4 samples lack cameras"
        in done.stdout
    )
    assert "6 pictures" in done.stdout
    assert "CAM_BACK 100%" in done.stdout
    training = (tmp_path / "dst" / "TRAINING.md").read_text()
    assert "samples may lack cameras" in training
    assert "`--common-with` each of these cars" in training
    before = pictures(alone[SIX], "CAM_BACK")
    assert pictures(tmp_path / "dst", "CAM_BACK") == {sample: before[sample] for sample in (1, 2)}
    assert pictures(tmp_path / "dst", "CAM_FRONT") == pictures(alone[SIX], "CAM_FRONT")
    assert chain(tmp_path / "dst", "CAM_BACK") == [("", "")] * 2
    assert len(list((tmp_path / "dst" / "samples" / "CAM_BACK").iterdir())) == 2
    assert len(list((tmp_path / "dst" / "masks" / "CAM_BACK").iterdir())) == 2
    never_used = 2 * 3  # of the rows that `blind_behind` took out
    lidar = len(rows_of(tmp_path / "dst", "lidar"))
    assert len(rows(tmp_path / "dst", "ego_pose")) == lidar + never_used + 6
    named = {row["filename"] for row in rows(tmp_path / "dst", "image_annotations")}
    assert named <= {row["filename"] for row in rows_of(tmp_path / "dst", "camera")}


def test_pictures_that_were_left_out_cannot_be_measured(cars: dict[str, Path], tmp_path: Path) -> None:
    write_painted(tmp_path / "three", cameras=nuscenes_like_cameras(0.02), samples_per_scene=3, supersample=1)
    source = blind_behind({SIX: tmp_path / "three"}, tmp_path / "src", (1,))
    converted(source, tmp_path / "whole")
    converted(source, tmp_path / "dst", "--min-coverage", 0.6, "--low-coverage", "drop-picture")
    run = unidrive("measure", tmp_path / "dst", "--truth", tmp_path / "whole")
    assert run.code == 3
    assert "no picture of CAM_BACK: --low-coverage drop-picture left it out" in run.stderr
    assert "Measure the source with --rig." in run.stderr


def test_a_list_leads_past_a_picture_that_is_dropped(cars: dict[str, Path], tmp_path: Path) -> None:
    """Three samples; the one in the middle has nothing behind."""
    write_painted(tmp_path / "three", cameras=nuscenes_like_cameras(0.02), samples_per_scene=3, supersample=1)
    source = blind_behind({SIX: tmp_path / "three"}, tmp_path / "src", (1,))
    converted(source, tmp_path / "dst", "--min-coverage", 0.6, "--low-coverage", "drop-picture")
    first, last = (row for row in rows_of(tmp_path / "dst", "camera") if "/CAM_BACK/" in row["filename"])
    assert (first["next"], last["prev"], first["prev"], last["next"]) == (last["token"], first["token"], "", "")


def test_low_coverage_can_be_kept_and_is_reported(
    cars: dict[str, Path], alone: dict[str, Path], tmp_path: Path
) -> None:
    source = half_blind(cars, tmp_path)
    done = converted(source, tmp_path / "dst", "--min-coverage", 0.6, "--low-coverage", "keep")
    assert "2 of 8 pictures are covered less than 60% (CAM_BACK 2), and kept." in done.stdout
    assert pictures(tmp_path / "dst", "CAM_FRONT") == pictures(alone[SIX], "CAM_FRONT")
    assert sorted(pictures(tmp_path / "dst", "CAM_BACK")) == [0, 1, 2, 3]


def test_what_is_blackened_for_another_car_is_not_covered(cars: dict[str, Path], tmp_path: Path) -> None:
    """The six cameras see less of what lies ahead; a dry run says what the conversion would."""
    options = ("--min-coverage", 0.9, "--dry-run")
    alone = run(cars[OTHER], tmp_path / "dst", *options)
    assert alone.code == 0
    assert "Left out, being covered less than 90% in the mean of all samples: CAM_BACK (" in alone.stdout
    common = run(cars[OTHER], tmp_path / "dst", *options, "--common-with", cars[SIX])
    assert common.code == 2
    assert "CAM_FRONT comes nearest: 77.9% are covered" in common.said
    assert not (tmp_path / "dst").exists()


def test_no_camera_left_is_refused(cars: dict[str, Path], tmp_path: Path) -> None:
    done = run(half_blind(cars, tmp_path), tmp_path / "dst", "--camera", "CAM_BACK", "--min-coverage", 0.9)
    assert done.code == 2
    assert "no virtual camera reaches --min-coverage 0.9; CAM_BACK comes nearest: 50.0% are covered." in done.said
    assert not (tmp_path / "dst").exists()


@pytest.mark.parametrize("share", [-0.1, 30, "nan"])
def test_what_is_no_share_is_refused(cars: dict[str, Path], tmp_path: Path, share: object) -> None:
    done = run(cars[SIX], tmp_path / "dst", "--min-coverage", share)
    assert (done.code, "--min-coverage must be a share from 0 to 1" in done.said) == (2, True)


@pytest.mark.parametrize("low", ["drop-camera", "drop-picture"])
def test_parts_drop_what_the_whole_drops(cars: dict[str, Path], tmp_path: Path, low: str) -> None:
    source = half_blind(cars, tmp_path)
    options = ("--min-coverage", 0.6, "--low-coverage", low)
    converted(source, tmp_path / "whole", *options)
    for number in (2, 1):
        assert run(source, tmp_path / "parts", *options, "--part", f"{number}/2").code == 0
    rig = tmp_path / "parts.yaml"
    assert unidrive("finalise", source, tmp_path / "parts", "--rig", rig, *options).code == 0
    assert (tmp_path / "parts" / "unidrive.json").read_bytes() == (tmp_path / "whole" / "unidrive.json").read_bytes()
    for channel in CHANNELS if low == "drop-picture" else CHANNELS[:1]:
        assert pictures(tmp_path / "parts", channel) == pictures(tmp_path / "whole", channel)


def test_what_failed_is_tried_again_beside_dropped_pictures(cars: dict[str, Path], tmp_path: Path) -> None:
    source = half_blind(cars, tmp_path)
    broken = source / next(
        row["filename"]
        for row in rows_of(source, "camera")
        if "CAM_FRONT/" in row["filename"] and row["sample_token"] == rows(source, "sample")[1]["token"]
    )
    picture = broken.read_bytes()
    options = ("--min-coverage", 0.6, "--low-coverage", "drop-picture", "--on-error", "skip")
    broken.write_bytes(b"no picture")
    assert run(source, tmp_path / "dst", *options).code == 1
    broken.write_bytes(picture)
    done = converted(source, tmp_path / "dst", *options, "--only-failed")
    assert "4 samples, 6 pictures" in done.stdout


def test_sweeps_are_dropped_by_their_own_coverage(tmp_path: Path) -> None:
    drive = tmp_path / "src"
    write_painted(drive, cameras=nuscenes_like_cameras(0.02), lidar_sweeps=1, camera_sweeps=1, supersample=1)
    without(drive, lambda row: row["filename"].startswith("sweeps/CAM_BACK"))
    options = ("--sweeps", "--min-coverage", 0.6, "--low-coverage", "drop-picture")
    done = converted(drive, tmp_path / "dst", *options)
    assert "(CAM_BACK 1), and left out: 1 of 3 samples and sweeps lack cameras" in done.stdout
    assert not (tmp_path / "dst" / "sweeps" / "CAM_BACK").exists()
    assert len(list((tmp_path / "dst" / "sweeps" / "CAM_FRONT").iterdir())) == 1
