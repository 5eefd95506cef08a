"""`--scene`, `--split` and `--max-samples`: on a painted drive of two scenes with two samples each."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from nuscenes.utils.splits import get_scenes_of_split

from tests.datasets import Bench, assert_consistent, rows, tree, unidrive

TRAINING, VALIDATION = "scene-0061", "scene-0103"
"""Of nuScenes' mini_train and mini_val."""


def scenes(root: Path) -> list[str]:
    return [row["name"] for row in rows(root, "scene")]


def splits_of(root: Path) -> dict[str, list[str]]:
    found: dict[str, list[str]] = json.loads((root / "v1.0-mini" / "splits.json").read_text())
    return found


def rename(bench: Bench, old: str, new: str) -> None:
    bench.edit("scene", lambda found: [row.update(name=new) for row in found if row["name"] == old])


def test_a_split_of_the_devkit(bench: Bench) -> None:
    bench.converted("--split", "mini_val")
    assert scenes(bench.dst) == [VALIDATION]
    assert not (bench.dst / "v1.0-mini" / "splits.json").exists()


def test_the_first_samples_by_scene_and_time(bench: Bench) -> None:
    bench.converted("--max-samples", 3)
    order = {row["token"]: place for place, row in enumerate(rows(bench.src, "scene"))}
    samples = sorted(rows(bench.src, "sample"), key=lambda row: (order[row["scene_token"]], row["timestamp"]))
    assert {row["token"] for row in rows(bench.dst, "sample")} == {row["token"] for row in samples[:3]}
    assert [row["nbr_samples"] for row in rows(bench.dst, "scene")] == [2, 1]
    (second,) = [row for row in rows(bench.dst, "scene") if row["name"] == VALIDATION]
    assert second["first_sample_token"] == second["last_sample_token"] == samples[2]["token"]


def test_together_they_meet(bench: Bench) -> None:
    bench.converted("--split", "mini_val", "--split", "mini_train", "--scene", VALIDATION, "--max-samples", 1)
    (scene,) = rows(bench.dst, "scene")
    assert (scene["name"], scene["nbr_samples"], len(rows(bench.dst, "sample"))) == (VALIDATION, 1, 1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--max-samples", 0), ("--max-samples must be 1 or more, got 0.",)),
        (("--split", "mini_vla"), ("--split mini_vla", "Did you mean mini_val?")),
        (("--split", "test"), ("no scene of", "Its scenes are in: train, val, mini_train, mini_val")),
        (("--split", "mini_val", "--scene", TRAINING), ("leave nothing", f"of {TRAINING} none is in mini_val")),
    ],
)
def test_what_cannot_be_chosen_is_refused(bench: Bench, options: tuple[object, ...], words: tuple[str, ...]) -> None:
    bench.refused(2, *words, options=options)


def test_the_devkit_finds_scenes_that_are_none_of_its_own(bench: Bench) -> None:
    rename(bench, TRAINING, "garage")
    bench.converted()
    assert splits_of(bench.dst) == {"all": ["garage", VALIDATION]}
    nusc = assert_consistent(bench.dst)
    assert get_scenes_of_split("all", nusc) == ["garage", VALIDATION]


def test_a_split_of_the_file_is_chosen_and_found_again(bench: Bench) -> None:
    rename(bench, TRAINING, "garage")
    source = {"night": ["garage", "elsewhere"], "day": [VALIDATION], "val": ["garage", VALIDATION]}
    bench.table("splits").write_text(json.dumps(source))
    bench.converted("--split", "night")
    assert scenes(bench.dst) == ["garage"]
    assert splits_of(bench.dst) == {"night": ["garage"], "val": ["garage"], "custom_val": ["garage"]}
    nusc = assert_consistent(bench.dst)
    assert get_scenes_of_split("custom_val", nusc) == ["garage"]


def test_a_file_in_which_nothing_changes_keeps_its_bytes(bench: Bench) -> None:
    text = f'{{"night":   ["{VALIDATION}"] }}'
    bench.table("splits").write_text(text)
    bench.converted()
    assert (bench.dst / "v1.0-mini" / "splits.json").read_text() == text


def test_a_file_that_holds_no_splits_goes_along_unless_it_is_asked(bench: Bench) -> None:
    bench.table("splits").write_text("[1]")
    bench.refused(3, "splits.json: is no list of scene names by split", options=("--split", "mini_val"))
    run = bench.converted()
    assert "splits.json: is no list of scene names by split" in run.stdout
    assert (bench.dst / "v1.0-mini" / "splits.json").read_text() == "[1]"


def test_parts_of_a_subset_are_the_same_bytes_as_the_whole(bench: Bench) -> None:
    options = ("--split", "mini_train", "--split", "mini_val", "--max-samples", 3)
    whole = bench.folder / "dst" / "whole"
    bench.converted(*options, dst=whole)
    parts = bench.folder / "dst" / "parts"
    for part in ("2/2", "1/2"):
        assert bench.convert(*options, "--part", part, dst=parts).code == 0
    done = unidrive("finalise", bench.src, parts, "--rig", bench.rig, *options)
    assert done.code == 0, done.stderr
    assert tree(parts, apart=("run.json",)) == tree(whole, apart=("run.json",))


def test_a_test_split_without_annotations(bench: Bench) -> None:
    for table in ("sample_annotation", "instance"):
        bench.edit(table, lambda found: found.clear())
    rename(bench, TRAINING, "scene-0077")
    bench.converted("--split", "test", "--max-samples", 1)
    assert [(row["name"], row["nbr_samples"]) for row in rows(bench.dst, "scene")] == [("scene-0077", 1)]
    assert rows(bench.dst, "sample_annotation") == rows(bench.dst, "image_annotations") == []


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [((), 3, "holds no samples to convert"), (("--split", "val"), 2, "Its scenes are in: no split at all.")],
)
def test_no_scene_at_all(bench: Bench, options: tuple[object, ...], code: int, words: str) -> None:
    for table in ("scene", "sample", "sample_data", "sample_annotation", "instance", "ego_pose"):
        bench.edit(table, lambda found: found.clear())
    bench.refused(code, words, options=options)
