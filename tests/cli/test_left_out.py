"""Samples that failed: listed with their reason, and tried again alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.datasets import Bench, assert_consistent, rows, tree

SKIP = ("--on-error", "skip")


@pytest.fixture
def broken(bench: Bench) -> Bench:
    """One picture of the first sample, and one of the third, cannot be decoded."""
    for sample in (0, 2):
        bench.picture(sample).write_bytes(b"no picture")
    return bench


def mend(bench: Bench, painted: Path, sample: int) -> None:
    shutil.copyfile(painted / bench.picture(sample).relative_to(bench.src), bench.picture(sample))


def listed(bench: Bench) -> list[list[str]]:
    return [line.split("\t") for line in (bench.dst / "failures.txt").read_text().splitlines()]


def test_what_was_left_out_is_listed_with_scene_and_reason(broken: Bench, painted: Path) -> None:
    assert broken.convert(*SKIP).code == 1
    tokens = [row["token"] for row in rows(broken.src, "sample")]
    found = listed(broken)
    assert [line[:2] for line in found] == [[tokens[0], "scene-0061"], [tokens[2], "scene-0103"]]
    assert all("neither a JPEG nor a PNG" in line[2] for line in found)
    mend(broken, painted, 2)
    assert broken.convert(*SKIP).code == 1
    assert [line[0] for line in listed(broken)] == [tokens[0]]
    mend(broken, painted, 0)
    broken.converted()
    assert not (broken.dst / "failures.txt").exists()


def test_only_failed_completes_a_finished_dataset(broken: Bench, painted: Path, default: Path) -> None:
    assert broken.convert(*SKIP).code == 1
    mend(broken, painted, 2)
    assert broken.convert("--only-failed", *SKIP).code == 1
    assert len(assert_consistent(broken.dst).sample) == 3
    mend(broken, painted, 0)
    broken.converted("--only-failed")
    assert tree(broken.dst, apart=("run.json",)) == tree(default, apart=("run.json",))
    assert "already holds this conversion" in broken.converted("--only-failed").stdout


def test_only_failed_leaves_the_others_of_an_unfinished_dataset(broken: Bench, painted: Path, default: Path) -> None:
    assert broken.convert("--part", "1/2", *SKIP).code == 1
    mend(broken, painted, 0)
    run = broken.convert("--only-failed")
    assert run.code == 1
    assert "2 samples are not converted yet" in run.said
    assert "The same command without --only-failed converts them" in run.said
    assert len(list((broken.dst / ".unidrive" / "receipts").iterdir())) == 2
    mend(broken, painted, 2)
    broken.converted()
    assert tree(broken.dst, apart=("run.json",)) == tree(default, apart=("run.json",))


def test_what_failed_in_a_run_that_was_stopped_is_known_to_the_next(broken: Bench, painted: Path) -> None:
    """Stopped by a picture that fails after another one was left out: here, with `stop` in the second run."""
    assert broken.convert("--part", "1/1", *SKIP).code == 1
    mend(broken, painted, 0)
    assert broken.convert("--only-failed").code == 3
    assert not (broken.dst / "unidrive.json").exists()
    mend(broken, painted, 2)
    broken.converted("--only-failed")


@pytest.mark.parametrize("place", ["variable", "config"])
def test_only_failed_by_variable_and_by_file(broken: Bench, painted: Path, tmp_path: Path, place: str) -> None:
    assert broken.convert("--part", "1/2", *SKIP).code == 1
    mend(broken, painted, 0)
    config = tmp_path / "options.yaml"
    config.write_text("only-failed: true\n")
    run = (
        broken.convert(env={"UNIDRIVE_ONLY_FAILED": "1"})
        if place == "variable"
        else broken.convert("--config", config, "--jobs", 0)
    )
    assert run.code == 1
    assert "2 samples are not converted yet" in run.said


def test_only_failed_needs_a_conversion(bench: Bench) -> None:
    bench.refused(2, "holds no conversion of which samples could have failed", options=("--only-failed",))


@pytest.mark.parametrize("other", [("--force",), ("--part", "1/2")])
def test_only_failed_goes_alone(bench: Bench, other: tuple[str, ...]) -> None:
    bench.refused(2, "exclude each other", options=("--only-failed", *other))
