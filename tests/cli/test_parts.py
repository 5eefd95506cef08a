"""`convert --part i/n` and `finalise`: an array job over one DST."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.datasets import SCRIPT, Bench, Run, assert_consistent, tree, unidrive
from unidrive_cli.tables.destination import held

SAMPLES = 4


def finalise(bench: Bench, *options: object, dst: Path | None = None) -> Run:
    return unidrive("finalise", bench.src, dst or bench.dst, "--rig", bench.rig, *options)


def receipts(dst: Path) -> int:
    return len(list((dst / ".unidrive" / "receipts").glob("*.json")))


@pytest.mark.parametrize("order", [(1, 2, 3), (3, 1, 2)])
def test_parts_and_finalise_are_the_same_bytes_as_the_whole(
    bench: Bench, default: Path, order: tuple[int, ...]
) -> None:
    for number in order:
        run = bench.convert("--part", f"{number}/3")
        assert run.code == 0, run.stderr
        assert (bench.dst / "UNFINISHED.txt").is_file()
        assert not (bench.dst / "unidrive.json").exists()
    assert "all samples of the whole are converted" in run.stdout
    assert "unidrive finalise SRC DST" in run.stdout
    done = finalise(bench)
    assert done.code == 0, done.stderr
    assert_consistent(bench.dst)
    assert tree(bench.dst, apart=("run.json",)) == tree(default, apart=("run.json",))


def test_convert_without_part_finishes_what_parts_have_done(bench: Bench, default: Path) -> None:
    assert bench.convert("--part", "1/1").code == 0
    pictures = {path: path.stat().st_mtime_ns for path in (bench.dst / "samples").rglob("*.jpg")}
    assert len(pictures) == SAMPLES * 2
    bench.converted()
    assert tree(bench.dst, apart=("run.json",)) == tree(default, apart=("run.json",))
    assert pictures == {path: path.stat().st_mtime_ns for path in pictures}


def test_parts_at_the_same_time(bench: Bench, default: Path) -> None:
    """Four processes that begin DST together."""
    command = [SCRIPT, "convert", str(bench.src), str(bench.dst), "--rig", str(bench.rig), "--jobs", "0", "--part"]
    running = [
        subprocess.Popen([*command, f"{number}/4"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for number in range(1, 5)
    ]
    for process in running:
        said = process.communicate(timeout=120)
        assert process.returncode == 0, said
    assert finalise(bench).code == 0
    assert tree(bench.dst, apart=("run.json",)) == tree(default, apart=("run.json",))


def test_a_part_says_what_is_left(bench: Bench) -> None:
    run = bench.convert("--part", "1/2", "--json")
    assert run.json() == {"part": "1/2", "samples": 2, "failures": [], "left": 2, "already_complete": False}
    assert "2 samples of the whole not converted yet" in bench.convert("--part", "1/2").stdout


def test_a_part_does_only_its_share_and_a_second_run_of_it_nothing(bench: Bench) -> None:
    bench.convert("--part", "2/4")
    assert receipts(bench.dst) == 1
    before = tree(bench.dst)
    assert bench.convert("--part", "2/4").code == 0
    assert tree(bench.dst) == before


def test_finalise_names_what_is_missing(bench: Bench) -> None:
    bench.convert("--part", "1/2")
    before = tree(bench.dst)
    run = finalise(bench)
    assert run.code == 1
    assert "2 samples are not converted yet" in run.said
    assert run.said.count(" of scene-0103") == 2
    assert "scene-0061" not in run.said
    assert "Run the parts that have not ended" in run.said
    assert tree(bench.dst) == before


def test_finalise_misses_a_picture_that_went_away(bench: Bench) -> None:
    bench.convert("--part", "1/1")
    next((bench.dst / "samples").rglob("*.jpg")).unlink()
    assert "1 sample is not converted yet" in finalise(bench).said


def test_finalise_of_nothing(bench: Bench) -> None:
    run = finalise(bench)
    assert (run.code, "holds no conversion that could be finalised" in run.said) == (2, True)
    assert not bench.dst.exists()


def test_finalise_with_other_options(bench: Bench) -> None:
    bench.convert("--part", "1/1")
    run = finalise(bench, "--quality", 90)
    assert (run.code, "quality 95, now 90" in run.said) == (2, True)


def test_finalise_and_parts_of_a_finished_dataset_change_nothing(bench: Bench) -> None:
    bench.converted()
    before = tree(bench.dst)
    assert "already holds this conversion, complete" in finalise(bench).stdout
    assert "already holds this conversion, complete" in bench.convert("--part", "1/2").stdout
    assert tree(bench.dst) == before


def test_finalise_takes_the_config_file_of_convert(bench: Bench) -> None:
    config = bench.folder / "config.yaml"
    config.write_text("jobs: 0\nquality: 90\nbackend: processes\n")
    assert bench.convert("--config", config, "--part", "1/1").code == 0
    assert finalise(bench, "--config", config).code == 0


def test_parts_hold_dst_together_and_nobody_else(bench: Bench) -> None:
    bench.convert("--part", "1/2")
    with held(bench.dst, shared=True):
        assert bench.convert("--part", "2/2").code == 0
        for run in (bench.convert(), finalise(bench)):
            assert (run.code, "another unidrive is writing here" in run.said) == (4, True)
    with held(bench.dst):
        run = bench.convert("--part", "1/2")
        assert (run.code, "another unidrive is writing here" in run.said) == (4, True)
    assert finalise(bench).code == 0


@pytest.mark.parametrize("part", ["0/2", "3/2", "x", "1"])
def test_a_part_that_is_none(bench: Bench, part: str) -> None:
    bench.refused(2, "--part must be i/n", options=("--part", part))


def test_part_and_force_exclude_each_other(bench: Bench) -> None:
    bench.refused(2, "--part and --force exclude each other", options=("--part", "1/2", "--force"))


def test_a_part_with_other_options_is_refused(bench: Bench) -> None:
    bench.convert("--part", "1/2")
    run = bench.convert("--part", "2/2", "--quality", 90)
    assert (run.code, "quality 95, now 90" in run.said) == (2, True)


def test_dry_run_says_the_share(bench: Bench) -> None:
    run = bench.convert("--part", "2/2", "--dry-run")
    assert "part 2/2: 2 samples of 1 scene" in run.stdout
    run = bench.convert("--part", "2/2", "--dry-run", "--json")
    assert run.json()["part"] == {"part": "2/2", "samples": 2, "scenes": ["scene-0103"]}
    assert not bench.dst.exists()


# --- broken pictures --------------------------------------------------------------------------------------------


@pytest.fixture
def broken(bench: Bench) -> Bench:
    """One picture of the first scene cannot be decoded."""
    bench.picture(0).write_bytes(b"no picture")
    return bench


def test_what_parts_left_out_is_left_out_by_finalise(broken: Bench) -> None:
    skip = ("--on-error", "skip")
    first = broken.convert("--part", "1/2", *skip)
    assert (first.code, first.stderr.count("left out: sample")) == (1, 1)
    assert broken.convert("--part", "2/2", *skip).code == 0
    done = finalise(broken, *skip)
    assert (done.code, done.stderr.count("left out: sample")) == (1, 1)
    assert_consistent(broken.dst)
    at_once = broken.folder / "dst" / ".." / "dst-whole"
    broken_whole = Path(shutil.copytree(broken.src, broken.folder / "src-2"))
    run = unidrive("convert", broken_whole, at_once, "--rig", broken.rig, "--jobs", 0, *skip)
    assert run.code == 1
    assert tree(at_once, apart=("run.json",)) == tree(broken.dst, apart=("run.json",))


def test_finalise_without_skip_says_what_failed(bench: Bench) -> None:
    """The end of a picture is cut off, which its head does not tell."""
    picture = bench.picture(0)
    picture.write_bytes(picture.read_bytes()[:-200])
    assert bench.convert("--part", "1/1", "--on-error", "skip").code == 1
    run = finalise(bench)
    assert run.code == 1
    assert "1 sample is not converted yet" in run.said
    assert "All of them failed" in run.said
    assert picture.name in run.said
    assert "--on-error skip leaves them out" in run.said


def test_a_failure_that_was_mended_is_forgotten(broken: Bench, painted: Path, default: Path) -> None:
    skip = ("--on-error", "skip")
    assert broken.convert("--part", "1/1", *skip).code == 1
    shutil.copyfile(painted / broken.picture(0).relative_to(broken.src), broken.picture(0))
    assert broken.convert("--part", "1/1", *skip).code == 0
    assert finalise(broken).code == 0
    assert json.loads((broken.dst / "unidrive.json").read_text())["failures"] == []
    assert tree(broken.dst, apart=("run.json",)) == tree(default, apart=("run.json",))


def test_samples_left_out_of_a_finished_dataset_are_tried_again_by_a_part(
    broken: Bench, painted: Path, default: Path
) -> None:
    assert broken.convert("--on-error", "skip").code == 1
    shutil.copyfile(painted / broken.picture(0).relative_to(broken.src), broken.picture(0))
    assert broken.convert("--part", "1/2").code == 0
    assert finalise(broken).code == 0
    assert tree(broken.dst, apart=("run.json",)) == tree(default, apart=("run.json",))
