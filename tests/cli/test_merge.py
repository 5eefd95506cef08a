"""`unidrive merge`: parts of a source come to its whole; drives with the same tokens and names lie side by side.

Two painted drives have the same tokens, times, poses and file names, whatever their cameras.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.splits import get_scenes_of_split

from tests.datasets import (
    SCRIPT,
    SMALL_RIG,
    VERSION,
    Row,
    Run,
    assert_consistent,
    in_own_mounts,
    rows,
    rows_of,
    tree,
    unidrive,
)
from tests.evaluation import average_precisions
from tests.painted import nuscenes_like_cameras, write_painted
from unidrive_cli.tables import dataset as dataset_module

TABLES = (*dataset_module.TABLES, "image_annotations")
TRAINING, VALIDATION = "scene-0061", "scene-0103"
"""Of nuScenes' mini_train and mini_val."""


class Fleet:
    """Converted datasets of one virtual rig, which no test changes."""

    def __init__(self, folder: Path, painted: Path) -> None:
        self.folder = folder
        self.painted = painted
        self.rig = folder / "rig.yaml"
        self.rig.write_text(SMALL_RIG)
        self.training = self.convert("training", "--scene", TRAINING)
        self.validation = self.convert("validation", "--scene", VALIDATION)
        other = folder / "other-car"
        write_painted(other, cameras=nuscenes_like_cameras(0.04), scenes=2, samples_per_scene=2, supersample=1)
        self.other = self.convert("other", src=other)

    def convert(self, name: str, *options: object, src: Path | None = None, rig: Path | None = None) -> Path:
        arguments = (src or self.painted, self.folder / name, "--rig", rig or self.rig, "--jobs", 0, *options)
        run = unidrive("convert", *arguments)
        assert run.code == 0, run.stderr
        return self.folder / name


@pytest.fixture(scope="module")
def fleet(painted: Path, tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    return Fleet(tmp_path_factory.mktemp("fleet"), painted)


@pytest.fixture(scope="module")
def whole(fleet: Fleet, default: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive as the one car saw it, then as the other did."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    assert unidrive("merge", default, fleet.other, "--out", folder).code == 0
    return folder


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


def merge(*arguments: object) -> Run:
    return unidrive("merge", *arguments)


def merged(*arguments: object) -> Run:
    """Merges; the devkit must open what comes of it, with tokens and channels that are unique."""
    run = merge(*arguments)
    assert run.code == 0, run.stderr
    root = Path(str(arguments[arguments.index("--out") + 1]))
    assert_consistent(root)
    for table in TABLES:
        tokens = [row["token"] for row in rows(root, table) if "token" in row]
        assert len(set(tokens)) == len(tokens), table
    for table, field in (("scene", "name"), ("sensor", "channel"), ("category", "name"), ("attribute", "name")):
        names = [row[field] for row in rows(root, table)]
        assert len(set(names)) == len(names), names
    return run


def edited(root: Path, folder: Path, table: str, change: Callable[[list[Row]], object]) -> Path:
    """A copy of a dataset with other rows in a table."""
    copy = Path(shutil.copytree(root, folder))
    found = rows(copy, table)
    change(found)
    (copy / VERSION / f"{table}.json").write_text(json.dumps(found))
    return copy


def sorted_rows(root: Path, table: str) -> list[str]:
    return sorted(json.dumps(row, sort_keys=True) for row in rows(root, table))


def test_parts_of_a_source_come_to_its_whole(fleet: Fleet, default: Path, out: Path) -> None:
    """What `convert` makes of both scenes is what it makes of each, merged: the same rows and the same files."""
    merged(fleet.training, fleet.validation, "--out", out)
    for table in TABLES:
        assert sorted_rows(out, table) == sorted_rows(default, table), table
    apart = ("run.json", "unidrive.json", "TRAINING.md", VERSION)
    assert tree(out, apart) == tree(default, apart)
    assert not (out / VERSION / "splits.json").exists()
    made, whole = (json.loads((root / "unidrive.json").read_text()) for root in (out, default))
    assert made["counts"] == whole["counts"]
    assert made["covered"] == pytest.approx(whole["covered"], abs=1e-4)
    assert (out / "TRAINING.md").read_text().startswith((default / "TRAINING.md").read_text())


def shown(root: Path, scene: str) -> list[Any]:
    """What a trainer gets of a scene: the bytes of its files, their times, and its boxes by name."""
    nusc = NuScenes(version=VERSION, dataroot=str(root), verbose=False)
    (token,) = (row["token"] for row in nusc.scene if row["name"] == scene)
    found: list[Any] = []
    for sample in (row for row in nusc.sample if row["scene_token"] == token):
        for channel, data in sorted(sample["data"].items()):
            row = nusc.get("sample_data", data)
            pose = nusc.get("ego_pose", row["ego_pose_token"])["translation"]
            digest = hashlib.sha256((root / row["filename"]).read_bytes()).hexdigest()
            calibration = nusc.get("calibrated_sensor", row["calibrated_sensor_token"])["translation"]
            found.append((channel, row["timestamp"], digest, pose, calibration))
            if channel.startswith("CAM"):
                mask = Path("masks") / channel / (Path(row["filename"]).stem + ".png")
                found.append(hashlib.sha256((root / mask).read_bytes()).hexdigest())
        for annotation in map(nusc.get, ["sample_annotation"] * len(sample["anns"]), sample["anns"]):
            level = nusc.get("visibility", annotation["visibility_token"])["level"]
            attributes = [nusc.get("attribute", each)["name"] for each in annotation["attribute_tokens"]]
            found.append((annotation["category_name"], annotation["translation"], level, attributes))
    boxes = {row["sample_annotation_token"] for row in nusc.image_annotations}
    assert boxes <= {row["token"] for row in nusc.sample_annotation}
    return found


def boxes_of(root: Path, *tokens: str) -> Counter[str]:
    """2D boxes as (picture's bytes, corners, category), however rows and files are called."""
    pictures = {row["token"]: row["filename"] for row in rows(root, "sample_data")}
    found: Counter[str] = Counter()
    for row in rows(root, "image_annotations"):
        assert pictures[row["sample_data_token"]] == row["filename"]
        digest = hashlib.sha256((root / row["filename"]).read_bytes()).hexdigest()
        found[f"{digest} {row['bbox_corners']} {row['category_name']}"] += 1
    return found


def test_two_cars_that_recorded_the_same_drive(fleet: Fleet, default: Path, out: Path, tmp_path: Path) -> None:
    """All tokens, scene names and files of the second are taken; nothing of either is lost or mixed up."""
    run = merged(default, fleet.other, "--out", out)
    assert "4 samples are moments of an earlier one, seen by other cameras" in run.stdout
    assert [row["name"] for row in rows(out, "scene")] == [TRAINING, VALIDATION, f"{TRAINING}-2", f"{VALIDATION}-2"]
    for scene in (TRAINING, VALIDATION):
        assert shown(out, scene) == shown(default, scene)
        assert shown(out, f"{scene}-2") == shown(fleet.other, scene)
        assert shown(default, scene) != shown(fleet.other, scene)
    assert boxes_of(out) == boxes_of(default) + boxes_of(fleet.other)
    names = [row["filename"] for row in rows(out, "sample_data")]
    assert len(set(names)) == len(names)
    assert {row["token"] for row in rows(default, "sample")} < {row["token"] for row in rows(out, "sample")}
    checked = unidrive("validate", out)
    assert checked.code == 0, checked.stdout
    splits = json.loads((out / VERSION / "splits.json").read_text())
    assert splits["mini_val"] == splits["custom_mini_val"] == [VALIDATION, f"{VALIDATION}-2"]
    nusc = NuScenes(version=VERSION, dataroot=str(out), verbose=False)
    assert get_scenes_of_split("custom_mini_train", nusc) == [TRAINING, f"{TRAINING}-2"]
    precisions = average_precisions(out, "custom_mini_val", tmp_path)
    assert len(precisions) >= 4
    assert precisions == pytest.approx(dict.fromkeys(precisions, 1.0))


def test_tables_that_are_scanned_come_to_the_same_bytes(
    fleet: Fleet, default: Path, whole: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    merged(default, fleet.other, "--out", out)
    assert tree(out, ("run.json",)) == tree(whole, ("run.json",))


def numbered(source: Path, folder: Path, shift_m: float, *, backwards: bool) -> Path:
    """A copy of a painted drive, elsewhere, whose tokens are numbers in every table, as UniDrive's own are."""
    copy = Path(shutil.copytree(source, folder))
    tables = [path.stem for path in (copy / VERSION).glob("*.json")]
    numbers: dict[str, str] = {}
    for table in tables:
        found = rows(copy, table)
        for number, row in enumerate(reversed(found) if backwards else found, 1):
            numbers[row["token"]] = str(number)

    def renumbered(value: Any) -> Any:
        if isinstance(value, list):
            return [renumbered(item) for item in value]
        return numbers.get(value, value) if isinstance(value, str) else value

    for table in tables:
        found = [{name: renumbered(value) for name, value in row.items()} for row in rows(copy, table)]
        for row in found:
            if table in ("ego_pose", "sample_annotation"):
                row["translation"][0] += shift_m
        (copy / VERSION / f"{table}.json").write_text(json.dumps(found))
    return copy


def test_tokens_that_are_numbers(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    """Every table has rows 1, 2, 3, ...; in the second dataset they count backwards, and mean something else."""
    sources = [
        numbered(fleet.painted, tmp_path / "here", 0.0, backwards=False),
        numbered(fleet.painted, tmp_path / "there", 5000.0, backwards=True),
    ]
    places = [fleet.convert(str(tmp_path / f"dst-{place}"), src=source) for place, source in enumerate(sources)]
    run = merged(*places, "--out", out)
    assert "seen by other cameras" not in run.stdout
    for scene in (TRAINING, VALIDATION):
        assert shown(out, scene) == shown(places[0], scene)
        assert shown(out, f"{scene}-2") == shown(places[1], scene)
    assert len(rows(out, "category")) == len(rows(places[0], "category"))
    assert unidrive("validate", out).code == 0
    precisions = average_precisions(out, "custom_mini_train", tmp_path)
    assert precisions == pytest.approx(dict.fromkeys(precisions, 1.0))


def test_categories_attributes_and_levels_are_united_by_name(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    """The second dataset has other tokens for them, and one of each that the first lacks."""
    tables = ("category", "attribute", "visibility")
    other = Path(shutil.copytree(fleet.validation, tmp_path / "other"))
    for table in tables:
        text = (other / VERSION / f"{table}.json").read_text()
        tokens = {row["token"]: f"other-{row['token']}" for row in rows(other, table)}
        for path in (other / VERSION).glob("*.json"):
            text = path.read_text()
            for old, new in tokens.items():
                if table != "visibility":
                    text = text.replace(f'"{old}"', f'"{new}"')
                else:
                    text = text.replace(f'"visibility_token": "{old}"', f'"visibility_token": "{new}"')
                    text = text.replace(f'"visibility_token":"{old}"', f'"visibility_token":"{new}"')
            path.write_text(text)
    levels = [{**row, "token": f"other-{row['token']}"} for row in rows(fleet.validation, "visibility")]
    levels.append({"token": "1", "level": "full", "description": "another level, with a token that is taken"})
    (other / VERSION / "visibility.json").write_text(json.dumps(levels))
    categories = [*rows(other, "category"), {"token": "tram", "name": "vehicle.tram", "description": ""}]
    (other / VERSION / "category.json").write_text(json.dumps(categories))
    merged(fleet.training, other, "--out", out)
    assert shown(out, VALIDATION) == shown(fleet.validation, VALIDATION)
    assert [row["name"] for row in rows(out, "category")] == [row["name"] for row in categories]
    assert rows(out, "category")[:-1] == rows(fleet.training, "category")
    assert rows(out, "attribute") == rows(fleet.training, "attribute")
    *known, full = rows(out, "visibility")
    assert known == rows(fleet.training, "visibility")
    assert full["level"] == "full"
    assert full["token"] not in {row["token"] for row in known}


def test_a_merged_dataset_is_merged_again(fleet: Fleet, default: Path, out: Path, tmp_path: Path) -> None:
    merged(fleet.training, fleet.other, "--out", tmp_path / "first")
    merged(tmp_path / "first", fleet.validation, "--out", out)
    names = [TRAINING, f"{TRAINING}-2", VALIDATION, f"{VALIDATION}-2"]
    assert [row["name"] for row in rows(out, "scene")] == names
    assert shown(out, f"{TRAINING}-2") == shown(fleet.other, TRAINING)
    assert shown(out, VALIDATION) == shown(fleet.other, VALIDATION)
    assert shown(out, f"{VALIDATION}-2") == shown(default, VALIDATION)
    run = merge(tmp_path / "first", fleet.other, "--out", tmp_path / "twice")
    assert run.code == 2
    assert "holds the same conversion as" in run.said


def test_masks_of_two_cars(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    """Static masks stay one per camera where they are alike, and become one per picture where they are not."""
    camera = ("--masks", "camera")
    halves = [fleet.convert(str(tmp_path / scene), "--scene", scene, *camera) for scene in (TRAINING, VALIDATION)]
    merged(*halves, "--out", tmp_path / "alike")
    assert tree(tmp_path / "alike" / "masks") == tree(halves[0] / "masks")
    other = fleet.convert(str(tmp_path / "car"), *camera, "--camera", "CAM_FRONT", src=fleet.folder / "other-car")
    merged(halves[0], other, "--out", out)
    for row in rows_of(out, "camera"):
        channel = Path(row["filename"]).parent.name
        source = other if "-2__" in row["filename"] else halves[0]
        mask = out / "masks" / channel / (Path(row["filename"]).stem + ".png")
        assert mask.read_bytes() == (source / "masks" / f"{channel}.png").read_bytes()
    assert sum(path.is_file() for path in (out / "masks").rglob("*")) == len(rows_of(out, "camera")) == 12
    assert json.loads((out / "unidrive.json").read_text())["plan"]["options"]["masks"] == "frame"
    refused(2, "only some pictures would have masks", halves[0], converted_without_masks(fleet, tmp_path), out=out)


def converted_without_masks(fleet: Fleet, folder: Path) -> Path:
    return fleet.convert(str(folder / "bare"), "--masks", "none", "--scene", VALIDATION)


def test_extra_tables_maps_and_can_bus(fleet: Fleet, default: Path, out: Path, tmp_path: Path) -> None:
    """Rows of extra tables follow their pictures; files of one name and other bytes lie side by side."""
    places = [Path(shutil.copytree(root, tmp_path / root.name)) for root in (default, fleet.other)]
    for place, root in enumerate(places):
        labels = []
        for row in rows_of(root, "lidar"):
            if row["is_key_frame"]:
                name = f"lidarseg/{VERSION}/{row['token']}_lidarseg.bin"
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                (root / name).write_bytes(bytes([place]) * 3)
                labels.append({"token": row["token"], "sample_data_token": row["token"], "filename": name})
        (root / VERSION / "lidarseg.json").write_text(json.dumps(labels))
        categories = [{**row, "index": index} for index, row in enumerate(rows(root, "category"))]
        (root / VERSION / "category.json").write_text(json.dumps(categories))
        (root / "can_bus").mkdir()
        (root / "can_bus" / f"{TRAINING}_pose.json").write_text(f"[{place}]")
        (root / "can_bus" / "README.md").write_text(f"{place}")
        (map_row,) = rows(root, "map")
        (root / map_row["filename"]).unlink()
        shutil.copyfile(next((root / "samples" / "CAM_BACK").iterdir()), root / map_row["filename"])
    run = merge(*places, "--out", out)
    assert run.code == 0, run.stderr
    assert (
        "Dataset 2: 1 file is others than those of this name before, and left out (can_bus/README.md)." in run.stdout
    )
    assert (out / "can_bus" / f"{TRAINING}_pose.json").read_text() == "[0]"
    assert (out / "can_bus" / f"{TRAINING}-2_pose.json").read_text() == "[1]"
    owners = {row["token"]: row["filename"] for row in rows(out, "sample_data")}
    labels = rows(out, "lidarseg")
    assert len({row["token"] for row in labels}) == len({row["filename"] for row in labels}) == 8
    for row in labels:
        place = int("-2__" in owners[row["sample_data_token"]])
        assert (out / row["filename"]).read_bytes() == bytes([place]) * 3
    maps = rows(out, "map")
    assert len({row["filename"] for row in maps}) == 2
    for row, root in zip(maps, places, strict=True):
        assert (out / row["filename"]).read_bytes() == (root / rows(root, "map")[0]["filename"]).read_bytes()
    NuScenes(version=VERSION, dataroot=str(out), verbose=False)
    categories = rows(places[1], "category")
    categories[0]["index"], categories[1]["index"] = 1, 0
    (places[1] / VERSION / "category.json").write_text(json.dumps(categories))
    refused(2, "are labelled by other numbers", *places, out=tmp_path / "labels")


def test_names_that_differ_only_by_case_are_taken(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    """On some disks they are one file."""
    taken = rows_of(fleet.training, "lidar")[0]["filename"]
    own = rows_of(fleet.validation, "lidar")[0]["filename"]
    name = f"{Path(taken).parent}/{Path(taken).name.upper()}"
    other = edited(
        fleet.validation,
        tmp_path / "other",
        "sample_data",
        lambda found: [row.update(filename=name) for row in found if row["filename"] == own],
    )
    (other / own).rename(other / name)
    merged(fleet.training, other, "--out", out)
    names = [row["filename"] for row in rows(out, "sample_data")]
    assert len({found.lower() for found in names}) == len(names)
    assert sum("-2__" in found for found in names) == len(rows(other, "sample_data"))


def test_splits_of_files_are_joined(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    """A scene that only a file's split names, with one of nuScenes' own."""
    garage = edited(fleet.training, tmp_path / "garage", "scene", lambda found: found[0].update(name="garage"))
    splits = {"mini_val": ["garage"], "custom_mini_val": ["garage"], "night": ["garage"]}
    (garage / VERSION / "splits.json").write_text(json.dumps(splits))
    merged(garage, fleet.validation, "--out", out)
    assert json.loads((out / VERSION / "splits.json").read_text()) == {
        "mini_val": ["garage", VALIDATION],
        "custom_mini_val": ["garage", VALIDATION],
        "night": ["garage"],
    }


def refused(code: int, words: str, *datasets: Path, out: Path, options: tuple[object, ...] = ()) -> None:
    """Merging must stop with an exit code and a sentence, and write nothing."""
    before = tree(out) if out.exists() else None
    run = merge(*datasets, "--out", out, *options)
    assert run.code == code, run.stderr
    assert words in run.said, run.said
    assert run.stdout == ""
    assert (tree(out) if out.exists() else None) == before


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("hfov: 80, position: [1.5", "hfov: 81, position: [1.5", "which differ in CAM_FRONT (intrinsics)"),
        ("width: 64, height: 36", "width: 96, height: 54", "pictures of 96x54 and 64x36 pixels for CAM_FRONT"),
        ("CAM_BACK:", "CAM_REAR:", "with the cameras CAM_FRONT, CAM_REAR and CAM_FRONT, CAM_BACK"),
    ],
)
def test_other_rigs_are_refused(fleet: Fleet, out: Path, tmp_path: Path, old: str, new: str, words: str) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(SMALL_RIG.replace(old, new))
    other = fleet.convert(str(tmp_path / "other"), "--scene", VALIDATION, "--max-samples", 1, rig=rig)
    refused(2, words, fleet.training, other, out=out)


def test_what_is_no_finished_conversion_is_refused(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    refused(3, "was not written by unidrive convert", fleet.training, fleet.painted, out=out)
    refused(3, "there is no such folder", fleet.training, tmp_path / "nowhere", out=out)
    refused(2, "two datasets or more are needed", fleet.training, out=out)
    refused(2, "is given twice", fleet.training, fleet.validation, fleet.training, out=out)
    begun = Path(shutil.copytree(fleet.validation, tmp_path / "begun"))
    (begun / "UNFINISHED.txt").touch()
    refused(3, "has not been finished (UNFINISHED.txt)", fleet.training, begun, out=out)
    (begun / "UNFINISHED.txt").unlink()
    (begun / "unidrive.json").write_text('{"plan": {}}')
    refused(3, "is not a provenance file of unidrive", fleet.training, begun, out=out)


def test_another_method_is_refused(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(fleet.validation, tmp_path / "other"))
    document = json.loads((other / "unidrive.json").read_text())
    document["plan"]["method"] += 1
    (other / "unidrive.json").write_text(json.dumps(document))
    refused(2, "their pictures are not alike", fleet.training, other, out=out)


def test_the_same_scenes_twice_are_refused(fleet: Fleet, default: Path, out: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(fleet.training, tmp_path / "copy"))
    refused(2, "holds the same conversion as", fleet.training, copy, out=out)
    refused(2, "the same scenes twice. Convert one of them without these", fleet.training, default, out=out)
    lower = fleet.convert(str(tmp_path / "lower"), "--quality", 50, "--scene", TRAINING)
    refused(2, "the same scenes twice", fleet.training, lower, out=out)
    elsewhere = Path(shutil.copytree(fleet.painted, tmp_path / "elsewhere"))
    (elsewhere / VERSION / "attribute.json").write_text(json.dumps(rows(elsewhere, "attribute")))
    again = fleet.convert(str(tmp_path / "again"), "--scene", TRAINING, src=elsewhere)
    refused(2, "the same scenes twice", fleet.training, again, out=out)
    otherwise = fleet.convert(str(tmp_path / "otherwise"), "--quality", 50, "--scene", TRAINING, src=elsewhere)
    refused(2, "because they were converted otherwise", fleet.training, otherwise, out=out)


def test_places_that_cannot_be_are_refused(fleet: Fleet, default: Path, out: Path, tmp_path: Path) -> None:
    inside = fleet.training / "merged"
    refused(2, f"--out {inside} is inside DST", fleet.training, fleet.validation, out=inside)
    refused(2, "choose another --out", fleet.training, fleet.validation, out=fleet.folder)
    out.mkdir()
    (out / "thesis.tex").touch()
    refused(4, "was not made by unidrive", fleet.training, fleet.validation, out=out)
    mine = Path(shutil.copytree(default, tmp_path / "mine"))
    refused(2, "holds a dataset with other options", fleet.training, fleet.validation, out=mine)
    merged(fleet.training, fleet.validation, "--out", mine, "--force")


def test_a_dataset_that_was_broken_since_is_refused(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    resized = edited(
        fleet.validation, tmp_path / "resized", "sample_data", lambda found: [row.update(width=65) for row in found]
    )
    refused(3, "the picture has 65x36 pixels; 64x36 was expected", fleet.training, resized, out=out)
    dangling = edited(
        fleet.validation, tmp_path / "dangling", "sample", lambda found: found[0].update(scene_token="none")
    )
    refused(3, "points to 'none', which is not in scene.json", fleet.training, dangling, out=out)
    leaving = edited(
        fleet.validation, tmp_path / "leaving", "sample_data", lambda found: found[0].update(filename="../passwd")
    )
    refused(3, "leaves the dataset ('../passwd')", fleet.training, leaving, out=out)
    gone = Path(shutil.copytree(fleet.validation, tmp_path / "gone"))
    next((gone / "samples" / "CAM_BACK").iterdir()).unlink()
    run = merge(fleet.training, gone, "--out", out)
    assert (run.code, "the picture is missing" in run.said) == (3, True), run.stderr
    assert (out / "UNFINISHED.txt").exists()
    assert not (out / VERSION).exists()


def test_version_folders_of_two_names(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(fleet.validation, tmp_path / "other"))
    (other / VERSION).rename(other / "v1.0-trainval")
    refused(2, "the version folders have several names", fleet.training, other, out=out)
    refused(
        2,
        "--version a/b: that cannot be a version folder",
        fleet.training,
        other,
        out=out,
        options=("--version", "a/b"),
    )
    run = merge(fleet.training, other, "--out", out, "--version", "v1.0-trainval")
    assert run.code == 0, run.stderr
    assert_consistent(out, "v1.0-trainval")


@pytest.mark.parametrize("link", ["hardlink", "symlink", "copy"])
def test_links(fleet: Fleet, out: Path, link: str) -> None:
    merged(fleet.training, fleet.validation, "--out", out, "--link", link)
    for row in rows(out, "sample_data"):
        path = out / row["filename"]
        source = next(
            root / row["filename"]
            for root in (fleet.training, fleet.validation)
            if (root / row["filename"]).exists()
        )
        assert (path.samefile(source), path.is_symlink()) == (link != "copy", link == "symlink")


def test_a_disk_that_is_too_small_is_said_before_the_start(fleet: Fleet, tmp_path: Path) -> None:
    """No links lead from one disk to another, so the pictures would be copied."""
    command = f"{SCRIPT} merge '{fleet.training}' '{fleet.validation}' --out disk/out"
    run = in_own_mounts(f"mkdir disk && mount -t tmpfs -o size=8k tmpfs disk && {command}", tmp_path)
    assert run.code == 4
    assert "will take about" in run.said
    run = in_own_mounts(f"mkdir -p disk && mount -t tmpfs -o size=64m tmpfs disk && {command}", tmp_path)
    assert run.code == 0, run.stderr


def test_datasets_of_links_are_merged(fleet: Fleet, default: Path, out: Path, tmp_path: Path) -> None:
    link = ("--link", "symlink")
    halves = [fleet.convert(str(tmp_path / scene), "--scene", scene, *link) for scene in (TRAINING, VALIDATION)]
    merged(*halves, "--out", out)
    apart = ("run.json", "unidrive.json", "TRAINING.md", VERSION)
    assert tree(out, apart) == tree(default, apart)


def test_samples_that_were_left_out(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    """failures.txt names them by the tokens and scenes that they would have."""
    broken = Path(shutil.copytree(fleet.painted, tmp_path / "broken"))
    (key_frame,) = [row for row in rows_of(broken, "camera") if "CAM_FRONT/" in row["filename"]][:1]
    (broken / key_frame["filename"]).write_bytes(b"")
    arguments = ("--rig", fleet.rig, "--jobs", 0, "--on-error", "skip")
    assert unidrive("convert", broken, tmp_path / "left", *arguments).code == 1
    merged(fleet.other, tmp_path / "left", "--out", out)
    (line,) = (out / "failures.txt").read_text().splitlines()
    (original,) = (tmp_path / "left" / "failures.txt").read_text().splitlines()
    assert line.split("\t")[1:] == [f"{TRAINING}-2", original.split("\t")[2]]
    assert line.split("\t")[0] != original.split("\t")[0]
    assert [row["nbr_samples"] for row in rows(out, "scene")] == [2, 2, 1, 2]


def test_dry_run_and_json(fleet: Fleet, out: Path) -> None:
    document = merge(fleet.training, fleet.validation, "--out", out, "--dry-run", "--json").json()
    assert (document["scenes"], document["samples"], document["pictures"]) == (2, 4, 8)
    said = merge(fleet.training, fleet.other, "--out", out, "--dry-run").stdout
    assert f"{TRAINING} is {TRAINING}-2 now" in said
    assert not out.exists()
    done = merge(fleet.training, fleet.validation, "--out", out, "--json").json()
    assert (done["samples"], done["already_complete"]) == (4, False)
    assert merge(fleet.training, fleet.validation, "--out", out, "--json").json()["already_complete"] is True


@pytest.mark.parametrize("files", [0, 12])
def test_a_killed_merge_looks_like_nothing_whole_and_ends_with_the_same_bytes(
    fleet: Fleet, default: Path, whole: Path, tmp_path: Path, files: int
) -> None:
    """kill -9 once so many pictures are there: before any, and among them."""
    out = tmp_path / "out"
    arguments = [str(default), str(fleet.other), "--out", str(out)]
    running = subprocess.Popen([SCRIPT, "merge", *arguments], stdout=subprocess.DEVNULL)
    end = time.monotonic() + 60
    while running.poll() is None and not _has(out, files):
        assert time.monotonic() < end
        time.sleep(0.002)
    os.kill(running.pid, signal.SIGKILL) if running.poll() is None else None
    running.wait()
    if (out / ".unidrive").exists():
        assert unidrive("inspect-rig", out).code == 3
        refused(3, "has not been finished", out, fleet.validation, out=tmp_path / "further")
    merged(*arguments)
    assert tree(out, ("run.json",)) == tree(whole, ("run.json",))


def _has(out: Path, pictures: int) -> bool:
    return (out / "UNFINISHED.txt").exists() and len(list((out / "samples").glob("CAM*/*.jpg"))) >= pictures
