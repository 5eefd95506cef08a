"""`convert --sweeps`: the pictures between the key frames too."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import pytest

from tests import layouts
from tests.datasets import CHANNELS, SMALL_RIG, Bench, Row, assert_consistent, rows, rows_of, tree, unidrive
from tests.painted import nuscenes_like_cameras, write_painted

SWEEPS = ("--sweeps",)


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of two samples; two sweeps of every sensor between them."""
    root = tmp_path_factory.mktemp("painted") / "drive"
    write_painted(
        root, cameras=nuscenes_like_cameras(0.05), scenes=2, lidar_sweeps=2, camera_sweeps=2, supersample=1
    )
    return root


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    return Bench(tmp_path, painted)


@pytest.fixture(scope="module")
def swept(painted: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    bench = Bench(tmp_path_factory.mktemp("swept"), painted)
    bench.converted(*SWEEPS)
    return bench.dst


def same(one: Path, other: Path) -> None:
    assert tree(one, apart=("run.json",)) == tree(other, apart=("run.json",))


def sweep_pictures(root: Path, channel: str = "CAM_FRONT") -> list[Path]:
    return sorted((root / "sweeps" / channel).iterdir())


def listed(root: Path) -> list[str]:
    return [line.split("\t")[0] for line in (root / "failures.txt").read_text().splitlines()]


def test_sweeps_are_rows_as_nuscenes_has_them(swept: Path, painted: Path) -> None:
    samples = rows(painted, "sample")
    lidar = {row["timestamp"]: row for row in rows_of(painted, "lidar")}
    source_poses = {row["token"]: row for row in rows(painted, "ego_pose")}
    poses = {row["token"]: row for row in rows(swept, "ego_pose")}
    found = rows_of(swept, "camera")
    for channel in CHANNELS:
        own = [row for row in found if f"/{channel}/" in row["filename"]]
        assert [row["is_key_frame"] for row in own] == [True, False, False, True] * 2
        assert [row["sample_token"] for row in own] == [
            samples[index]["token"] for index in (0, 1, 1, 1, 2, 3, 3, 3)
        ]
        assert [bool(row["prev"]) for row in own] == [False, True, True, True] * 2
        assert [row["next"] for row in own] == [row["token"] for row in own[1:4]] + [""] + [
            row["token"] for row in own[5:]
        ] + [""]
        assert [row["timestamp"] for row in own] == sorted(lidar)
        for row in own:
            reference = source_poses[lidar[row["timestamp"]]["ego_pose_token"]]
            pose = poses[row["ego_pose_token"]]
            assert {**pose, "token": ""} == {**reference, "token": ""}
            folder = "samples" if row["is_key_frame"] else "sweeps"
            assert Path(row["filename"]).parent.as_posix() == f"{folder}/{channel}"
            assert row["filename"].endswith(f"__{channel}__{row['timestamp']}.jpg")
            mask = cv2.imread(str(swept / "masks" / channel / f"{Path(row['filename']).stem}.png"), 0)
            assert mask.shape == (row["height"], row["width"]) == (36, 64)
    assert len(poses) == len(rows_of(painted, "lidar")) + len(found)
    assert len({row["token"] for row in found}) == 16


def test_key_frames_have_the_same_bytes_with_and_without_sweeps(swept: Path, bench: Bench) -> None:
    bench.converted()
    with_sweeps, without = tree(swept), tree(bench.dst)
    assert {name for name in with_sweeps if name.startswith("sweeps/CAM")} == {
        f"sweeps/{channel}/{path.name}" for channel in CHANNELS for path in sweep_pictures(swept, channel)
    } | {f"sweeps/{channel}" for channel in CHANNELS}
    apart = ("unidrive.json", "run.json", "TRAINING.md", "v1.0-mini/sample_data.json", "v1.0-mini/ego_pose.json")
    assert {name: what for name, what in without.items() if with_sweeps.get(name) != what}.keys() <= set(apart)
    key_frames = [row for row in rows_of(swept, "camera") if row["is_key_frame"]]
    for row, alone in zip(key_frames, rows_of(bench.dst, "camera"), strict=True):
        assert {**row, "prev": "", "next": ""} == {**alone, "prev": "", "next": ""}


def test_what_was_done_is_said(swept: Path, bench: Bench) -> None:
    document = json.loads((swept / "unidrive.json").read_text())
    assert (document["counts"]["samples"], document["counts"]["sweeps"]) == (4, 4)
    assert document["plan"]["options"]["sweeps"] is True
    assert "key frames and sweeps" in (swept / "TRAINING.md").read_text()
    run = bench.convert("--dry-run", *SWEEPS)
    assert "4 samples in 2 scenes and 4 sweeps" in run.stdout
    assert "reads  48 source pictures" in run.stdout
    assert "writes 16 pictures" in run.stdout
    found = bench.convert("--dry-run", "--json", *SWEEPS).json()
    assert (found["samples"], found["sweeps"], found["pictures"], found["source_pictures"]) == (4, 4, 16, 48)
    assert "4 samples and 4 sweeps, 16 pictures" in bench.converted(*SWEEPS).stdout


def test_the_validator_finds_nothing(swept: Path) -> None:
    run = unidrive("validate", swept)
    assert run.code == 0, run.stdout


def test_two_workers_write_the_same_bytes(swept: Path, bench: Bench) -> None:
    bench.converted(*SWEEPS, "--jobs", 2)
    same(bench.dst, swept)


def test_parts_and_finalise_write_the_same_bytes(swept: Path, bench: Bench) -> None:
    for number in (3, 1, 2):
        run = bench.convert("--part", f"{number}/3", *SWEEPS)
        assert run.code == 0, run.stderr
    assert "all moments of the whole are converted" in run.stdout
    done = unidrive("finalise", bench.src, bench.dst, "--rig", bench.rig, *SWEEPS)
    assert done.code == 0, done.stderr
    same(bench.dst, swept)


def test_finalise_names_sweeps_that_are_missing(bench: Bench) -> None:
    bench.convert("--part", "1/1", *SWEEPS)
    for picture in (bench.dst / "sweeps" / "CAM_FRONT").iterdir():
        picture.unlink()
    run = unidrive("finalise", bench.src, bench.dst, "--rig", bench.rig, *SWEEPS)
    assert run.code == 1
    assert "4 moments are not converted yet: sweep " in run.said


def test_a_stopped_run_continues_where_it_was(swept: Path, bench: Bench) -> None:
    bench.convert("--part", "1/2", *SWEEPS)
    done = {path: path.stat().st_mtime_ns for path in (bench.dst / "sweeps").rglob("*.jpg")}
    assert len(done) == 4
    bench.converted(*SWEEPS)
    assert done == {path: path.stat().st_mtime_ns for path in done}
    same(bench.dst, swept)


def test_sweeps_of_another_plan_are_refused_without_force(bench: Bench) -> None:
    bench.converted()
    run = bench.convert(*SWEEPS)
    assert (run.code, "sweeps False, now True" in run.said) == (2, True)


def test_the_variable_and_the_config_file_reach_it(swept: Path, bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text("sweeps: true\n")
    bench.converted("--config", config, "--jobs", 0)
    same(bench.dst, swept)
    bench.converted(env={"UNIDRIVE_SWEEPS": "1"}, dst=bench.folder / "other")
    same(bench.folder / "other", swept)


@pytest.mark.parametrize("options", [(), ("--keep-layout",)])
def test_t4_has_the_same_sweeps_whether_its_layout_is_kept_or_not(
    swept: Path, painted: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    """There key frames and sweeps lie in one folder, and sweeps name no sample."""
    source = layouts.t4(Path(shutil.copytree(painted, tmp_path / "src")))
    rig = tmp_path / "rig.yaml"
    rig.write_text(SMALL_RIG)
    run = unidrive("convert", source, tmp_path / "dst", "--rig", rig, "--jobs", 0, *SWEEPS, *options)
    assert run.code == 0, run.stderr
    version = "annotation" if options else "v1.0-trainval"
    assert_consistent(tmp_path / "dst", version)
    found = {
        (row["timestamp"], row["width"], row["sample_token"], Path(row["filename"]).parent.name): (
            tmp_path / "dst" / row["filename"]
        ).read_bytes()
        for row in rows(tmp_path / "dst", "sample_data", version)
        if not row["is_key_frame"] and row["fileformat"] == "jpg"
    }
    assert found == {
        (row["timestamp"], row["width"], row["sample_token"], Path(row["filename"]).parent.name): (
            swept / row["filename"]
        ).read_bytes()
        for row in rows_of(swept, "camera")
        if not row["is_key_frame"]
    }
    assert len(found) == 8


# --- broken pictures ----------------------------------------------------------------------------------------------


def broken_sweep(bench: Bench) -> Row:
    """The first sweep of CAM_FRONT is no picture."""
    row = next(row for row in rows_of(bench.src, "camera") if row["filename"].startswith("sweeps/CAM_FRONT/"))
    (bench.src / row["filename"]).write_bytes(b"no picture")
    return row


def test_a_missing_sweep_is_refused(bench: Bench) -> None:
    (bench.src / broken_sweep(bench)["filename"]).unlink()
    bench.refused(3, "sweeps/CAM_FRONT/", "is missing", "--on-error skip", options=SWEEPS)
    bench.converted()


def test_a_broken_sweep_is_left_out_and_its_sample_stays(swept: Path, bench: Bench, painted: Path) -> None:
    row = broken_sweep(bench)
    run = bench.convert(*SWEEPS, "--on-error", "skip")
    assert run.code == 1
    leading = next(row for row in rows_of(bench.src, "camera") if row["filename"].startswith("sweeps/CAM_BACK/"))
    assert listed(bench.dst) == [f"sweep {leading['token']}"]
    assert f"left out: sweep {leading['token']}: " in run.stderr
    assert len(assert_consistent(bench.dst).sample) == 4
    assert len(sweep_pictures(bench.dst)) == 3
    shutil.copyfile(painted / row["filename"], bench.src / row["filename"])
    bench.converted(*SWEEPS, "--only-failed")
    same(bench.dst, swept)


@pytest.mark.parametrize("only_failed", [(), ("--only-failed",)])
def test_sweeps_leave_with_their_sample(
    swept: Path, bench: Bench, painted: Path, only_failed: tuple[str, ...]
) -> None:
    """And so do their files; all come back when the sample can be read again."""
    key_frame = bench.picture(1)
    key_frame.write_bytes(b"no picture")
    run = bench.convert(*SWEEPS, "--on-error", "skip")
    assert run.code == 1
    assert "3 samples and 2 sweeps" in run.stdout
    assert run.stderr.count("its sample is left out") == 2
    assert len(listed(bench.dst)) == 3
    nusc = assert_consistent(bench.dst)
    assert len(nusc.sample) == 3
    named = {row["filename"] for row in nusc.sample_data}
    here = {path.relative_to(bench.dst).as_posix() for path in bench.dst.glob("s*/*/*")}
    assert here == named
    assert len(list((bench.dst / "masks").rglob("*.png"))) == (3 + 2) * 2
    shutil.copyfile(painted / key_frame.relative_to(bench.src), key_frame)
    bench.converted(*SWEEPS, *only_failed)
    same(bench.dst, swept)


def test_sweeps_of_samples_that_are_not_asked_for_leave(bench: Bench) -> None:
    run = bench.converted(*SWEEPS, "--max-samples", 3)
    assert "3 samples and 2 sweeps" in run.stdout
    assert_consistent(bench.dst)


def test_a_drive_without_camera_sweeps_is_said_to_have_none(painted: Path, tmp_path: Path) -> None:
    bench = Bench(tmp_path, painted)
    names = {row["token"]: row for row in rows_of(bench.src, "camera") if not row["is_key_frame"]}

    def remove(found: list[Row]) -> None:
        found[:] = [row for row in found if row["token"] not in names]

    bench.edit("sample_data", remove)
    run = bench.converted(*SWEEPS)
    assert "The source has no camera sweeps" in run.stdout
