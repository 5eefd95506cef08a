"""Which scenes a split names, and what nuscenes-devkit must be told so that it finds them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from nuscenes.utils import splits as devkit

from tests.tables.small import tables, write
from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.tables.dataset import Dataset, open_dataset
from unidrive_cli.tables.splits import findable, own_splits, scenes_of, trimmed

NAMES = ("scene-0061", "scene-0103", "scene-0916", "garage")
"""mini_train and train; mini_val and val; mini_val and val; in none."""


def dataset_of(root: Path, splits: object = None, names: tuple[str, ...] = NAMES) -> Dataset:
    made = tables()
    (scene,) = made["scene"]
    made["scene"] = [scene, *({**scene, "token": name} for name in names[1:])]
    for row, name in zip(made["scene"], names, strict=True):
        row["name"] = name
    write(root, made)
    if splits is not None:
        (root / "v1.0-mini" / "splits.json").write_text(json.dumps(splits))
    return open_dataset(root)


def chosen(dataset: Dataset, *splits: str, names: tuple[str, ...] = ()) -> list[str]:
    return [scene.name for scene in scenes_of(dataset, names, splits)]


def test_the_premise_of_these_names() -> None:
    assert {"scene-0061"} == {name for name in NAMES if name in devkit.mini_train}
    assert {"scene-0103", "scene-0916"} == {name for name in NAMES if name in devkit.mini_val}
    assert {"scene-0103", "scene-0916"} == {name for name in NAMES if name in devkit.val}


def test_splits_of_the_devkit_and_of_the_file_meet_in_table_order(tmp_path: Path) -> None:
    dataset = dataset_of(tmp_path, {"night": ["garage", "scene-0061", "left-out"]})
    assert chosen(dataset) == list(NAMES)
    assert chosen(dataset, "mini_val") == ["scene-0103", "scene-0916"]
    assert chosen(dataset, "night") == ["scene-0061", "garage"]
    assert chosen(dataset, "night", "val") == list(NAMES)
    assert chosen(dataset, "val", names=("scene-0916", "garage")) == ["scene-0916"]


def test_the_file_goes_before_the_devkit(tmp_path: Path) -> None:
    assert chosen(dataset_of(tmp_path, {"val": ["garage"]}), "val") == ["garage"]


@pytest.mark.parametrize(
    ("split", "words"),
    [
        ("mini_vla", ("--split mini_vla: there is no such split", "Did you mean mini_val?")),
        ("nigth", ("--split nigth", "Did you mean night?")),
        ("zzz", ("neither nuScenes' own nor in splits.json", "Its scenes are in: train, val, mini_train")),
        ("test", ("--split test: no scene of", "Its scenes are in:", "night.")),
    ],
)
def test_splits_that_cannot_be_chosen(tmp_path: Path, split: str, words: tuple[str, ...]) -> None:
    with pytest.raises(UsageError) as caught:
        chosen(dataset_of(tmp_path, {"night": ["garage"]}), split)
    for word in words:
        assert word in str(caught.value)


def test_nothing_of_both(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="of garage none is in mini_val"):
        chosen(dataset_of(tmp_path), "mini_val", names=("garage",))


@pytest.mark.parametrize("splits", [["scene-0061"], {"val": "scene-0061"}, {"val": [61]}])
def test_a_file_that_holds_no_splits_is_named(tmp_path: Path, splits: object) -> None:
    with pytest.raises(DatasetError, match=r"splits\.json: is no list of scene names by split"):
        own_splits(dataset_of(tmp_path, splits))


def test_scenes_that_leave_leave_their_splits() -> None:
    splits = {"a": ["x", "y"], "b": ["y"], "c": []}
    assert trimmed(splits, {"x", "z"}) == {"a": ["x"]}


@pytest.mark.parametrize(
    ("splits", "scenes", "written"),
    [
        ({}, ["scene-0061"], {}),
        ({}, ["scene-0061", "garage"], {"all": ["scene-0061", "garage"]}),
        ({"night": ["garage"]}, ["scene-0061", "garage"], {"night": ["garage"]}),
        ({"all": ["scene-0061"]}, ["scene-0061", "garage"], {"all": ["scene-0061"]}),
        ({"val": ["scene-0103"]}, ["scene-0061", "scene-0103"], {"val": ["scene-0103"]}),
        (
            {"val": ["garage"]},
            ["garage", "scene-0103"],
            {"val": ["garage"], "custom_val": ["garage"]},
        ),
    ],
)
def test_what_the_devkit_must_be_told(
    splits: dict[str, list[str]], scenes: list[str], written: dict[str, list[str]]
) -> None:
    assert findable(splits, scenes) == written
