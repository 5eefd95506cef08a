"""`unidrive convert` on datasets, rigs and destinations that are broken in exactly one way each.

Every test knows the exit code and the words of the sentence beforehand. `Bench.refused` also holds that SRC stays
byte for byte as it was, that DST is not there (or as before), and that nothing else was written.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest

from tests.datasets import (
    SCRIPT,
    SMALL_RIG,
    VERSION,
    Bench,
    Row,
    assert_consistent,
    in_own_mounts,
    paint,
    rows,
    rows_of,
    spawn,
    tree,
    unidrive,
)
from unidrive_cli.tables import dataset as dataset_module

LARGE_RIG = SMALL_RIG.replace("width: 64, height: 36", "width: 1600, height: 900")
"""Takes long enough for a signal to arrive in the middle."""


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive")


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    return Bench(tmp_path, painted)


# --- SRC and its version folder ---------------------------------------------------------------------------------


def test_src_is_missing(bench: Bench) -> None:
    bench.refused(3, "nowhere", "no such folder", src=bench.folder / "nowhere")


def test_src_is_a_file(bench: Bench) -> None:
    bench.refused(3, "sensor.json", "is a file", "folder that holds v1.0-", src=bench.table("sensor"))


def test_src_has_no_version_folder(bench: Bench) -> None:
    shutil.rmtree(bench.src / VERSION)
    bench.refused(3, str(bench.src), "holds no version folder", "sensor.json and sample_data.json")


def test_src_is_the_version_folder_itself(bench: Bench) -> None:
    bench.refused(3, "is a version folder itself", f"Give the folder above it: {bench.src}", src=bench.src / VERSION)


@pytest.fixture
def two_versions(bench: Bench) -> Bench:
    shutil.copytree(bench.src / VERSION, bench.src / "v1.0-trainval")
    return bench


def test_two_versions_need_a_choice(two_versions: Bench) -> None:
    two_versions.refused(2, "2 version folders: v1.0-mini, v1.0-trainval", "--version")


def test_a_version_can_be_chosen(two_versions: Bench) -> None:
    assert two_versions.convert("--version", "v1.0-trainval").code == 0
    assert assert_consistent(two_versions.dst, "v1.0-trainval")
    assert not (two_versions.dst / VERSION).exists()


@pytest.mark.parametrize("name", ["v1.0-test", "../src/v1.0-mini", ""])
def test_an_unknown_version_is_refused(bench: Bench, name: str) -> None:
    bench.refused(2, f"--version {name}", "no such version folder", "v1.0-mini", options=("--version", name))


def test_a_rig_that_is_a_dataset_with_two_versions_is_not_answered_with_an_option_that_cannot_help(
    two_versions: Bench,
) -> None:
    """`--version` chooses in SRC; a dataset that stands for a rig has no such option."""
    rig = two_versions.folder / "rig-dataset"
    two_versions.src.rename(rig)
    shutil.copytree(rig, two_versions.src)
    shutil.rmtree(two_versions.src / "v1.0-trainval")
    run = two_versions.convert(rig=rig)
    assert run.code in (2, 3)
    assert "2 version folders" in run.said
    assert "Choose one with --version" not in run.said


# --- tables -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["sensor", "calibrated_sensor", "ego_pose", "sample", "sample_data", "scene"])
def test_a_needed_table_is_missing(bench: Bench, name: str) -> None:
    bench.table(name).unlink()
    said = bench.refused(3).said
    if name == "sensor":  # what makes a folder a version folder
        assert "holds no version folder" in said
        assert "sensor.json" in said
    else:
        assert f"{VERSION}/{name}.json: this table is needed and missing" in said


@pytest.mark.parametrize(
    "name", ["attribute", "category", "instance", "log", "map", "sample_annotation", "visibility"]
)
def test_an_optional_table_is_missing(bench: Bench, name: str) -> None:
    """Written in a valid minimal form, and said (docs/output.md)."""
    bench.table(name).unlink()
    assert f"{name}.json is missing" in bench.converted().stdout
    assert (bench.dst / VERSION / f"{name}.json").is_file()


def test_all_optional_tables_are_missing(bench: Bench) -> None:
    names = ("attribute", "category", "instance", "log", "map", "sample_annotation", "visibility")
    for name in names:
        bench.table(name).unlink()
    said = bench.converted().stdout
    assert [name for name in names if f"{name}.json is missing" not in said] == []


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        pytest.param(lambda text: text[:-40], ("is not valid JSON", "truncated"), id="truncated"),
        pytest.param(lambda text: "", ("is not valid JSON",), id="empty"),
        pytest.param(lambda text: '{"token": "a"}', ("is not a list of rows",), id="mapping"),
        pytest.param(lambda text: '["a"]', ("row 0", "expected `object`, got `str`"), id="list-of-texts"),
        pytest.param(lambda text: "[" * 100_000, ("is not valid JSON",), id="bottomless"),
        pytest.param(lambda text: "\udcff\udcfe" + text, (), id="not-utf-8"),
    ],
)
def test_a_table_is_not_a_list_of_rows(bench: Bench, break_it: Callable[[str], str], words: tuple[str, ...]) -> None:
    table = bench.table("sample")
    table.write_text(break_it(table.read_text()), errors="surrogateescape")
    bench.refused(3, f"{VERSION}/sample.json", *words)


def test_a_table_is_a_folder(bench: Bench) -> None:
    bench.table("sample").unlink()
    bench.table("sample").mkdir()
    bench.refused(3, f"{VERSION}/sample.json: cannot be read: Is a directory")


REFERENCES = [
    ("calibrated_sensor", "sensor_token", "sensor"),
    ("scene", "log_token", "log"),
    ("sample", "scene_token", "scene"),
    ("sample_data", "sample_token", "sample"),
    ("sample_data", "ego_pose_token", "ego_pose"),
    ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
    ("sample_annotation", "sample_token", "sample"),
    ("sample_annotation", "instance_token", "instance"),
    ("sample_annotation", "visibility_token", "visibility"),
    ("sample_annotation", "attribute_tokens", "attribute"),
    ("instance", "category_token", "category"),
]


@pytest.mark.parametrize(("table", "field", "target"), REFERENCES, ids=[f"{t}.{f}" for t, f, _ in REFERENCES])
def test_a_token_dangles(bench: Bench, table: str, field: str, target: str) -> None:
    token = rows(bench.src, table)[0]["token"]
    nowhere = ["nowhere"] if field.endswith("s") else "nowhere"
    bench.edit(table, lambda found: found[0].update({field: nowhere}))
    bench.refused(3, f"{VERSION}/{table}.json, token {token}, field {field}", "'nowhere'", f"not in {target}.json")


@pytest.mark.parametrize(
    ("table", "field"),
    [
        ("scene", "first_sample_token"),
        ("scene", "last_sample_token"),
        ("sample", "prev"),
        ("sample", "next"),
        ("sample_data", "prev"),
        ("sample_data", "next"),
        ("sample_annotation", "prev"),
        ("sample_annotation", "next"),
        ("instance", "first_annotation_token"),
        ("instance", "last_annotation_token"),
    ],
)
def test_a_list_link_that_leaves_an_extract_is_closed_and_said(bench: Bench, table: str, field: str) -> None:
    """Of the last row of its list (or the first): nothing is lost when it is closed."""

    def open_end(found: list[Row]) -> None:
        next(row for row in found if field not in ("prev", "next") or not row[field])[field] = "outside"

    bench.edit(table, open_end)
    assert "1 list links point outside of the dataset and are closed" in bench.converted().stdout


@pytest.mark.parametrize("name", ["sensor", "sample_data", "sample_annotation", "category"])
def test_two_rows_have_one_token(bench: Bench, name: str) -> None:
    token = rows(bench.src, name)[0]["token"]
    bench.edit(name, lambda found: found.append(dict(found[0])))
    bench.refused(3, f"{VERSION}/{name}.json, token {token}", "two rows have this token")


@pytest.mark.parametrize(
    ("table", "field", "value", "words"),
    [
        ("sample", "timestamp", None, "expected `int | float`, got `null`"),
        ("sample", "scene_token", 5, "expected `str`, got `int`"),
        ("sample_data", "width", "80", "expected `int | null`, got `str`"),
        ("sample_data", "is_key_frame", "yes", "expected `bool`, got `str`"),
        ("calibrated_sensor", "rotation", [1, 0, 0], "w, x, y, z"),
        ("calibrated_sensor", "rotation", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "w, x, y, z"),
        ("ego_pose", "translation", [1, 2], "length 3"),
    ],
)
def test_a_field_has_the_wrong_type(bench: Bench, table: str, field: str, value: object, words: str) -> None:
    token = rows(bench.src, table)[0]["token"]
    bench.edit(table, lambda found: found[0].update({field: value}))
    bench.refused(3, f"{VERSION}/{table}.json, row 0, token {token}, field {field}", words)


def test_a_field_is_missing(bench: Bench) -> None:
    token = rows(bench.src, "sample_data")[0]["token"]
    bench.edit("sample_data", lambda found: found[0].pop("ego_pose_token"))
    bench.refused(3, f"{VERSION}/sample_data.json, row 0, token {token}, field ego_pose_token: the field is missing")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("sample", ("field sample_token", "not in sample.json")),
        ("sample_data", ("the sample has no key frame",)),
        ("scene", ("field scene_token", "not in scene.json")),
    ],
)
def test_a_needed_table_is_an_empty_list(bench: Bench, name: str, words: tuple[str, ...]) -> None:
    bench.table(name).write_text("[]")
    bench.refused(3, *words)


def no_camera_rows(bench: Bench) -> None:
    cameras = {row["token"] for row in rows_of(bench.src, "camera")}
    kept = [row for row in rows(bench.src, "sample_data") if row["token"] not in cameras]
    bench.table("sample_data").write_text(json.dumps(kept))


def no_camera_sensors(bench: Bench) -> None:
    no_camera_rows(bench)
    lidar = [row for row in rows(bench.src, "sensor") if row["modality"] == "lidar"]
    kept = [row for row in rows(bench.src, "calibrated_sensor") if row["sensor_token"] == lidar[0]["token"]]
    bench.table("sensor").write_text(json.dumps(lidar))
    bench.table("calibrated_sensor").write_text(json.dumps(kept))


@pytest.mark.parametrize("strip", [no_camera_rows, no_camera_sensors])
def test_a_dataset_without_camera_pictures_is_refused(bench: Bench, strip: Callable[[Bench], None]) -> None:
    """Nothing could be rendered: black pictures and exit code 0 would be a lie."""
    strip(bench)
    bench.refused(3, "camera")


# --- maps, logs and extra tables: what the devkit needs is mended or refused before any work ---------------------


def add_unused_log(bench: Bench) -> None:
    bench.edit("log", lambda found: found.append({**found[0], "token": "unused"}))


@pytest.mark.parametrize(
    "break_it",
    [
        pytest.param(lambda bench: bench.table("map").write_text("[]"), id="no-map-rows"),
        pytest.param(
            lambda bench: bench.edit("map", lambda found: found[0].update(log_tokens=[])), id="no-log-of-map"
        ),
        pytest.param(add_unused_log, id="log-without-map"),
        pytest.param(
            lambda bench: (add_unused_log(bench), bench.table("map").unlink()), id="log-without-map-and-no-map-table"
        ),
    ],
)
def test_a_log_without_a_map_still_opens_in_the_devkit(bench: Bench, break_it: Callable[[Bench], None]) -> None:
    """nuscenes-devkit wants a map for every log; a dataset without one is mended like a missing table."""
    break_it(bench)
    bench.converted()


@pytest.mark.parametrize("content", ['[{"token": "a",', '[{"token": "a", "filename": "../x"}]'])
def test_an_extra_table_is_refused_before_any_work(bench: Bench, content: str) -> None:
    """Truncated, or with a file name that leaves the dataset."""
    bench.table("extra").write_text(content)
    bench.refused(3, "extra.json")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        pytest.param("extra.json", b'[{"token": "a", "sample_token": ["b"]}]', id="token-is-a-list"),
        pytest.param("extra.json", b'[{"token": "a", "score": NaN}]', id="nan-as-python-writes-it"),
        pytest.param("._sample.json", b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X", id="left-by-a-mac"),
        pytest.param("progress.json", b'{"done": 3}', id="mapping"),
    ],
)
def test_an_extra_file_in_the_version_folder_does_no_harm(bench: Bench, name: str, content: bytes) -> None:
    (bench.src / VERSION / name).write_bytes(content)
    bench.converted()


@pytest.mark.parametrize("kind", ["folder", "dangling-link"])
def test_something_else_that_is_called_json_does_no_harm(bench: Bench, kind: str) -> None:
    odd = bench.src / VERSION / "backup.json"
    odd.mkdir() if kind == "folder" else odd.symlink_to("nowhere")
    bench.converted()


# --- numbers ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize(
    ("table", "path"),
    [("calibrated_sensor", "translation[0]"), ("ego_pose", "rotation[0]"), ("sample", "timestamp")],
)
def test_a_number_is_not_finite(bench: Bench, table: str, path: str, number: float) -> None:
    token = rows(bench.src, table)[0]["token"]

    def spoil(found: list[Row]) -> None:
        field = path.partition("[")[0]
        if field == path:
            found[0][field] = number
        else:
            found[0][field][0] = number

    bench.edit(table, spoil)
    bench.refused(3, f"{VERSION}/{table}.json, row 0, token {token}, field {path}", "NaN or infinite")


@pytest.mark.parametrize("table", ["calibrated_sensor", "ego_pose", "sample_annotation"])
def test_a_quaternion_has_no_norm(bench: Bench, table: str) -> None:
    token = rows(bench.src, table)[0]["token"]
    bench.edit(table, lambda found: found[0].update(rotation=[0, 0, 0, 0]))
    bench.refused(
        3, f"{VERSION}/{table}.json, token {token}, field rotation", "norm 0", "unit quaternion w, x, y, z"
    )


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        pytest.param([[60, 1, 40], [0, 60, 22], [0, 0, 1]], "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", id="skew"),
        pytest.param([[0, 0, 40], [0, 60, 22], [0, 0, 1]], "focal lengths must be positive", id="zero-focal"),
        pytest.param([[60, 0, 40], [0, -60, 22], [0, 0, 1]], "focal lengths must be positive", id="negative-focal"),
        pytest.param([[60, 0, 40], [0, 60, 22], [0, 0, 2]], "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", id="last-row"),
        pytest.param([[60, 0], [0, 60]], "must have shape 3x3, got 2x2", id="2x2"),
        pytest.param([], "must have shape 3x3", id="none"),
        pytest.param([[60, 0, 40], [0, 60], [0, 0, 1]], "must be an array of numbers", id="ragged"),
    ],
)
def test_intrinsics_are_no_pinhole(bench: Bench, matrix: list[list[float]], words: str) -> None:
    token = rows(bench.src, "calibrated_sensor")[0]["token"]
    bench.edit("calibrated_sensor", lambda found: found[0].update(camera_intrinsic=matrix))
    bench.refused(3, f"{VERSION}/calibrated_sensor.json, token {token}, field camera_intrinsic", words)


def test_distortion_that_is_none(bench: Bench) -> None:
    token = rows(bench.src, "calibrated_sensor")[0]["token"]
    bench.edit("calibrated_sensor", lambda found: found[0].update(camera_distortion=[0.1, 0, 0]))
    place = f"{VERSION}/calibrated_sensor.json, token {token}, field camera_distortion"
    bench.refused(3, place, "the lens model opencv has 4, 5, 8, 12", "got 3")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("CAM_FRONT: [", ("lenses.yaml", "is not valid YAML")),
        (
            "CAM_TOP: {model: fisheye, coefficients: [0, 0, 0, 0]}",
            ("CAM_TOP, line 1", "no such camera", "Did you mean CAM_FRONT?"),
        ),
        ("CAM_FRONT: {model: opencv, coefficients: [1]}", ("CAM_FRONT, line 1", "has 4, 5, 8, 12", "got 1")),
        ("CAM_FRONT: {model: opencv, coefficients: [0, 0, 0, 0.1]}", ("is not the lens that the dataset gives",)),
    ],
)
def test_a_mistake_in_a_file_of_lenses(bench: Bench, text: str, words: tuple[str, ...]) -> None:
    sensor = next(row["token"] for row in rows(bench.src, "sensor") if row["channel"] == "CAM_FRONT")
    bench.edit(
        "calibrated_sensor",
        lambda found: [r.update(camera_distortion=[0.1, 0, 0, 0]) for r in found if r["sensor_token"] == sensor],
    )
    (bench.folder / "lenses.yaml").write_text(text)
    bench.refused(2, *words, options=("--lenses", bench.folder / "lenses.yaml"))


@pytest.mark.parametrize(("width", "height"), [(-80, 45), (100_000, 45)])
def test_a_picture_size_is_impossible(bench: Bench, width: int, height: int) -> None:
    bench.edit("sample_data", lambda found: found[0].update(width=width, height=height))
    bench.refused(3, f"width must be a whole number of pixels from 1 to 32766, got {width}")


def test_a_box_has_a_negative_size(bench: Bench) -> None:
    token = rows(bench.src, "sample_annotation")[0]["token"]
    bench.edit("sample_annotation", lambda found: found[0].update(size=[1, -1, 1]))
    bench.refused(3, f"{VERSION}/sample_annotation.json, token {token}, field size", "must be from 0 to")


@pytest.mark.parametrize("centre", [[20, 3, 1], [20.0, 3, 1]], ids=["whole", "mixed"])
def test_whole_numbers_are_coordinates_too(bench: Bench, centre: list[float]) -> None:
    """JSON knows one kind of number; a box at [20, 3, 1] is as good as one at [20.0, 3.0, 1.0]."""
    bench.edit("sample_annotation", lambda found: found[0].update(translation=centre))
    bench.converted()


@pytest.mark.parametrize("size", [[1e300, 1, 1], [1e308, 1e308, 1e308]], ids=["one-side", "all-sides"])
def test_an_absurd_box_is_a_sentence_or_converted(bench: Bench, size: list[float]) -> None:
    bench.edit("sample_annotation", lambda found: found[0].update(size=size))
    assert bench.convert().code in (0, 3)


def test_an_absurd_time_is_a_sentence(bench: Bench) -> None:
    """1e308 would be a file name of 309 digits."""
    lidar = {row["token"] for row in rows_of(bench.src, "lidar")}

    def spoil(found: list[Row]) -> None:
        for row in found:
            row["timestamp"] = 1e308 if row["token"] in lidar else row["timestamp"]

    bench.edit("sample_data", spoil)
    bench.refused(3, "sample_data.json", "timestamp")


# --- pictures ---------------------------------------------------------------------------------------------------


def crop(picture: Path) -> None:
    cv2.imwrite(str(picture), cv2.imread(str(picture))[:-1])


def replace_by_folder(picture: Path) -> None:
    picture.unlink()
    picture.mkdir()


BROKEN_PICTURES = [
    pytest.param(Path.unlink, ("missing", "is missing or is no file"), id="missing"),
    pytest.param(lambda path: path.write_bytes(b""), ("is empty", "is empty"), id="empty"),
    pytest.param(lambda path: path.write_bytes(path.read_bytes()[:-100]), ("broken JPEG",) * 2, id="truncated"),
    pytest.param(lambda path: path.write_bytes(path.read_bytes()[:200]), ("broken JPEG",) * 2, id="header-only"),
    pytest.param(crop, ("80x44 pixels, but its tables say 80x45",) * 2, id="other-size"),
    pytest.param(lambda path: path.write_text("hello"), ("neither a JPEG nor a PNG",) * 2, id="text"),
    pytest.param(replace_by_folder, ("is no file",) * 2, id="folder"),
]
"""How a picture breaks, and what is said of it with --on-error stop and skip."""


@pytest.mark.parametrize(("break_it", "words"), BROKEN_PICTURES)
def test_a_picture_is_broken(bench: Bench, break_it: Callable[[Path], None], words: tuple[str, str]) -> None:
    picture = bench.picture()
    break_it(picture)
    bench.refused(3, picture.name, words[0])


@pytest.mark.parametrize(("break_it", "words"), BROKEN_PICTURES)
def test_a_sample_with_a_broken_picture_is_left_out(
    bench: Bench, break_it: Callable[[Path], None], words: tuple[str, str]
) -> None:
    """The middle one of three: its neighbours are joined, and what was annotated in it leaves with it."""
    picture = bench.picture(sample=1)
    break_it(picture)
    run = bench.convert("--on-error", "skip")
    before, left_out, after = (row["token"] for row in rows(bench.src, "sample"))
    assert run.code == 1
    assert f"left out: sample {left_out}" in run.said
    assert picture.name in run.said
    assert words[1] in run.said
    nusc = assert_consistent(bench.dst)
    assert [row["token"] for row in nusc.sample] == [before, after]
    assert nusc.get("sample", before)["next"] == after
    assert nusc.scene[0]["nbr_samples"] == 2
    kept = [row["token"] for row in rows(bench.src, "sample_annotation") if row["sample_token"] != left_out]
    assert [row["token"] for row in nusc.sample_annotation] == kept
    annotated = {row["instance_token"] for row in nusc.sample_annotation}
    assert {row["token"] for row in nusc.instance} == annotated
    (failure,) = json.loads((bench.dst / "unidrive.json").read_text())["failures"]
    assert failure["sample_token"] == left_out
    assert picture.name in failure["sentence"]
    assert str(bench.folder) not in failure["sentence"]


def test_failures_are_in_the_json_too(bench: Bench) -> None:
    bench.picture(sample=1).unlink()
    run = bench.convert("--on-error", "skip", "--json")
    assert run.code == 1
    document = run.json()
    assert document["counts"]["samples"] == 2
    assert [failure["sample_token"] for failure in document["failures"]] == [rows(bench.src, "sample")[1]["token"]]


def test_every_sample_is_broken(bench: Bench) -> None:
    for row in rows_of(bench.src, "camera"):
        (bench.src / row["filename"]).write_bytes(b"x")
    bench.refused(1, "not one sample could be converted", options=("--on-error", "skip"))


def test_a_pipe_in_the_place_of_a_picture_does_not_hang(bench: Bench) -> None:
    picture = bench.picture(sample=1)
    picture.unlink()
    os.mkfifo(picture)
    options = ("--rig", bench.rig, "--jobs", 0, "--on-error", "skip")
    assert spawn("convert", bench.src, bench.dst, *options, timeout=60).code == 1


@pytest.mark.parametrize("jobs", [0, 2])
def test_a_broken_picture_in_the_middle_stops_and_the_same_command_continues(bench: Bench, jobs: int) -> None:
    """The last sample: what is done stays, nothing looks whole, and the end is that of an undisturbed run."""
    assert bench.convert(dst=bench.folder / "dst-undisturbed").code == 0
    picture = bench.picture(sample=2)
    whole = picture.read_bytes()
    picture.write_bytes(whole[:-100])
    run = bench.convert("--jobs", jobs, dst=bench.dst)
    assert run.code == 3
    assert picture.name in run.said
    assert_unfinished(bench.dst)
    picture.write_bytes(whole)
    bench.converted("--jobs", jobs)
    assert tree(bench.dst, apart=("run.json",)) == tree(bench.folder / "dst-undisturbed", apart=("run.json",))


def test_a_picture_that_was_restored_comes_into_the_dataset(bench: Bench) -> None:
    """The sentence says `restore it`: the same command must then take it, not say that nothing is to be done."""
    picture = bench.picture(sample=1)
    whole = picture.read_bytes()
    picture.unlink()
    assert bench.convert("--on-error", "skip").code == 1
    picture.write_bytes(whole)
    assert bench.convert("--on-error", "skip").code == 0
    assert len(rows(bench.dst, "sample")) == 3


# --- rigs -------------------------------------------------------------------------------------------------------


def test_an_unknown_rig_is_guessed_and_all_are_listed(bench: Bench) -> None:
    bench.refused(2, "6x61", "Did you mean 6x60?", "nuscenes-like", "roof-6x70", rig="6x61")


FISHEYE = "distortion: {model: fisheye, coefficients: [0.05, -0.01, 0.002, -0.0003]}"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("hfov: 80", "hfovv: 80", ("camera CAM_FRONT", "line 3", "hfovv is not a known key. Did you mean hfov?")),
        ("name: small", "nam: small", ("line 1", "nam is not a known key. Did you mean name?")),
        ("hfov: 80", "hfov: 180", ("CAM_FRONT", "field of view", "(0, 180)", "180")),
        ("hfov: 80", "hfov: 0", ("CAM_FRONT", "field of view", "(0, 180)")),
        ("hfov: 80, ", "", ("CAM_FRONT", "hfov or intrinsics")),
        ("yaw: 0", "rotation: [2, 0, 0, 0]", ("CAM_FRONT", "norm 1, got 2")),
        ("[1.5, 0.0, 1.6]", "[1.5, 0.0, -1.6]", ("CAM_FRONT", "position", "ground")),
        ("[1.5, 0.0, 1.6]", "[1.5, 0.0, 60]", ("CAM_FRONT", "depth limit (50 m)", "height", "60 m")),
        ("[1.5, 0.0, 1.6]", "[1.5, 0.0]", ("CAM_FRONT", "position", "3 numbers")),
        ("width: 64", "width: 6.4", ("CAM_FRONT", "width", "whole number")),
        ("width: 64", "width: 0", ("CAM_FRONT", "width", "0")),
        ("width: 64", "width: .nan", ("CAM_FRONT", "width", "nan")),
        ("CAM_BACK", "CAM_FRONT", ("CAM_FRONT is given twice",)),
        ("CAM_BACK", "cam_front", ("CAM_FRONT and cam_front differ only by case",)),
        ("CAM_FRONT", "lidar_top", ("LIDAR_TOP and lidar_top differ only by case",)),
        ("CAM_FRONT", "LIDAR_TOP", ("LIDAR_TOP is a channel of another sensor",)),
        ("CAM_FRONT", "../CAM", ("../CAM is not a channel name",)),
        ("cameras:", "cameras: [", ("is not valid YAML",)),
        ("name: small", "ground_height: 1.7\nname: small", ("CAM_FRONT", "position", "ground")),
        ("name: small", "depth_limit: -1\nname: small", ("depth_limit", "positive")),
        ("yaw: 0", f"yaw: 0, {FISHEYE}", ("small, camera CAM_FRONT", "fisheye", "a virtual camera is a pinhole")),
        (
            "yaw: 0",
            f"yaw: 0, {FISHEYE[:-1]}, k: 1}}",
            ("camera CAM_FRONT, distortion", "line 3", "k is not a known key"),
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_mistake_in_a_rig_file(bench: Bench, old: str, new: str, words: tuple[str, ...]) -> None:
    assert old in SMALL_RIG
    bench.rig.write_text(SMALL_RIG.replace(old, new, 1))
    bench.refused(2, *words)


@pytest.mark.parametrize("content", [b"", b"- a", b"\x00\xff\xfe\x80", b"&a [*a]", b"a: " + b"{a: " * 500])
def test_a_rig_file_that_is_none(bench: Bench, content: bytes) -> None:
    bench.rig.write_bytes(content)
    bench.refused(2, "rig.yaml")


@pytest.mark.parametrize(
    "name", ["nowhere.yaml", "a/b", "a" * 300, "a" * 5000], ids=["yaml", "path", "long", "longer"]
)
def test_a_rig_that_is_not_there(bench: Bench, name: str) -> None:
    bench.refused(2, name[:200], rig=name)


@pytest.mark.parametrize("link", ["one", "itself"])
def test_an_odd_link_as_a_rig(bench: Bench, link: str) -> None:
    (bench.folder / "link.yaml").symlink_to("nowhere" if link == "one" else "link.yaml")
    bench.refused(2, "link.yaml", rig=bench.folder / "link.yaml")


# --- options ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--depth-limit", "1.6"), ("CAM_FRONT", "depth limit (1.6 m)", "height")),
        (("--depth-limit", "1"), ("CAM_FRONT", "depth limit (1 m)", "height")),
        (("--depth-limit", "nan"), ("--depth-limit", "positive number of metres, got nan")),
        (("--depth-limit", "-5"), ("--depth-limit", "positive number of metres, got -5")),
        (("--depth-limit", "inf"), ("--depth-limit", "got inf")),
        (("--depth-limit", "far"), ("--depth-limit",)),
        (("--ground-height", "nan"), ("--ground-height", "got nan")),
        (("--ground-height", "1.7"), ("CAM_FRONT", "ground")),
        (("--quality", "0"), ("--quality must be from 1 to 100, got 0",)),
        (("--quality", "101"), ("--quality must be from 1 to 100, got 101",)),
        (("--quality", "best"), ("--quality",)),
        (("--jobs", "-1"), ("--jobs must be 0 or more, got -1",)),
        (("--scene", "scene-0016"), ("--scene scene-0016", "Did you mean scene-0061?")),
        (("--camera", "CAM_FRNT"), ("--camera CAM_FRNT", "Did you mean CAM_FRONT?")),
        (("--camera", "LIDAR_TOP"), ("--camera LIDAR_TOP", "There are: CAM_FRONT")),
        (("--blend", "best"), ("--blend", "angular", "nearest")),
        (("--masks", "all"), ("--masks", "frame", "camera", "none")),
        (("--link", "move"), ("--link", "hardlink", "symlink", "copy")),
        (("--on-error", "panic"), ("--on-error", "stop", "skip")),
        (("--no-such-option",), ("--no-such-option",)),
    ],
    ids=lambda value: " ".join(value) if value[0].startswith("--") and len(value) < 3 else "",
)
def test_an_option_that_cannot_be_carried_out(
    bench: Bench, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    bench.refused(2, *words, options=options)


# --- DST --------------------------------------------------------------------------------------------------------


def test_dst_is_not_ours(bench: Bench) -> None:
    bench.dst.mkdir()
    (bench.dst / "mine.txt").write_text("mine")
    for options in ((), ("--force",)):
        bench.refused(4, str(bench.dst), "was not made by unidrive", options=options)


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"plan": 3}'])
def test_a_provenance_file_that_is_not_ours(bench: Bench, content: str) -> None:
    bench.dst.mkdir()
    (bench.dst / "unidrive.json").write_text(content)
    bench.refused(4, "was not made by unidrive", options=("--force",))


def test_dst_is_a_file(bench: Bench) -> None:
    bench.dst.write_text("mine")
    bench.refused(4, str(bench.dst), "is a file")
    assert bench.dst.read_text() == "mine"


def test_dst_and_src_are_apart(bench: Bench) -> None:
    bench.refused(2, f"DST {bench.src} is SRC", dst=bench.src)
    bench.refused(2, "inside SRC", dst=bench.src / "out")
    bench.refused(2, "inside DST", dst=bench.folder)
    (bench.folder / "dst").symlink_to("src/samples")
    bench.refused(2, "inside SRC", dst=bench.dst / "out")


def test_dst_is_inside_a_folder_that_src_links_to(bench: Bench) -> None:
    """`samples` on another disk is SRC all the same."""
    disk = bench.folder / "disk"
    disk.mkdir()
    (bench.src / "samples").rename(disk / "samples")
    (bench.src / "samples").symlink_to(disk / "samples")
    bench.refused(2, "SRC", dst=disk / "samples" / "out")


def test_force_does_not_delete_what_src_links_to(bench: Bench) -> None:
    """SRC is made of links into an older conversion; replacing that one would take SRC's pictures away."""
    bench.converted()
    linked = bench.folder / "dst-linked"
    shutil.copytree(bench.dst / VERSION, linked / VERSION)
    for name in ("samples", "sweeps", "maps"):
        (linked / name).symlink_to(bench.dst / name)
    before = tree(bench.dst)
    run = unidrive("convert", linked, bench.dst, "--rig", "4x95", "--jobs", 0, "--force")
    assert tree(bench.dst) == before, run.stderr
    assert run.code == 2


def test_dst_is_below_a_file(bench: Bench) -> None:
    bench.refused(4, "rig.yaml/dst", "cannot be written", dst=bench.rig / "dst")


def test_dst_cannot_be_made(bench: Bench) -> None:
    bench.refused(4, "/proc/dst", "cannot be written", dst=Path("/proc/dst"))


def test_dst_has_an_impossible_name(bench: Bench) -> None:
    run = unidrive("convert", bench.src, bench.folder / ("a" * 256), "--rig", bench.rig)
    assert run.code == 4
    assert "File name too long" in run.said


@pytest.mark.parametrize("place", ["src", "dst"])
def test_a_link_that_leads_to_itself(bench: Bench, place: str) -> None:
    loop = bench.folder / "loop"
    loop.symlink_to("loop")
    run = bench.convert(src=loop) if place == "src" else bench.convert(dst=loop)
    assert run.code == (3 if place == "src" else 4)
    assert "loop" in run.said
    assert loop.is_symlink()


def test_a_failed_start_leaves_no_folders_behind(bench: Bench) -> None:
    bench.picture().write_bytes(b"x")
    assert bench.convert(dst=bench.folder / "a" / "b" / "c").code == 3
    assert not (bench.folder / "a").exists()


def test_a_failed_start_leaves_an_empty_dst_empty(bench: Bench) -> None:
    bench.dst.mkdir()
    bench.picture().write_bytes(b"x")
    bench.refused(3)


def stamps(root: Path) -> dict[str, int]:
    return {path.relative_to(root).as_posix(): path.lstat().st_mtime_ns for path in root.rglob("*")}


def test_other_options_need_force_and_the_same_command_redoes_nothing(bench: Bench) -> None:
    bench.converted()
    first = stamps(bench.dst)
    run = bench.converted()
    assert "already holds this conversion" in run.stdout
    assert stamps(bench.dst) == first
    bench.refused(2, "quality 95, now 50", "--force", options=("--quality", 50))
    bench.refused(2, "another rig", "--force", rig="6x60")
    bench.converted("--quality", 50, "--force")
    assert json.loads((bench.dst / "unidrive.json").read_text())["plan"]["options"]["quality"] == 50
    bench.converted("--force")
    assert stamps(bench.dst) != first


def test_another_way_to_bring_files_is_another_option(bench: Bench) -> None:
    """`--link copy` promises files of one's own: `nothing was done` on a DST of links would break that."""
    bench.converted("--link", "hardlink")
    run = bench.convert("--link", "copy")
    clouds = [bench.dst / row["filename"] for row in rows_of(bench.dst, "lidar")]
    own = all(path.stat().st_nlink == 1 for path in clouds)
    assert run.code == 2 or (run.code == 0 and own), run.stdout


def test_a_changed_source_is_another_source(bench: Bench) -> None:
    bench.converted()
    bench.edit("scene", lambda found: found[0].update(description="changed"))
    bench.refused(2, "another source", "--force")
    bench.converted("--force")


def test_a_dataset_of_which_the_tables_are_gone_is_not_complete(bench: Bench) -> None:
    bench.converted()
    shutil.rmtree(bench.dst / VERSION)
    run = bench.convert()
    assert run.code != 0 or (bench.dst / VERSION / "sample.json").is_file(), run.stdout


def test_dst_is_the_current_folder(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.dst.mkdir()
    monkeypatch.chdir(bench.dst)
    here = ("convert", bench.src, ".", "--rig", bench.rig, "--jobs", 0)
    assert unidrive(*here).code == 0
    assert unidrive(*here, "--quality", 50).code == 2
    run = unidrive(*here, "--quality", 50, "--force")
    assert run.code in (0, 2, 4)
    assert_consistent(bench.dst)


def test_dst_is_a_link_to_a_folder(bench: Bench) -> None:
    """People keep results on another disk; replacing one must not lose it, nor leave a stray link."""
    (bench.folder / "dst-disk").mkdir()
    bench.dst.symlink_to("dst-disk")
    run = unidrive("convert", bench.src, bench.dst, "--rig", bench.rig, "--jobs", 0)
    assert run.code == 0
    run = unidrive("convert", bench.src, bench.dst, "--rig", bench.rig, "--jobs", 0, "--quality", 50, "--force")
    assert sorted(path.name for path in bench.folder.iterdir()) == ["dst", "dst-disk", "rig.yaml", "src"], run.stderr
    assert run.code in (0, 2, 4)
    assert "None" not in run.said
    assert_consistent(bench.dst)


def test_dst_is_a_link_to_nowhere(bench: Bench) -> None:
    bench.dst.symlink_to("nowhere")
    run = bench.convert()
    assert run.code in (0, 4)
    assert bench.dst.is_symlink()


# --- files that go along ----------------------------------------------------------------------------------------


UNSAFE = {
    "above": "../x.bin",
    "above-below": "samples/../../x.bin",
    "absolute": "/etc/passwd",
    "nul": "samples/a\0b.bin",
    "backslash": "samples\\a.bin",
    "empty": "",
    "dot": ".",
    "endless": "a" * 2000,
    "too-long": "a" * 300,
}


@pytest.mark.parametrize("modality", ["camera", "lidar"])
@pytest.mark.parametrize("name", UNSAFE.values(), ids=UNSAFE)
def test_a_file_name_is_unsafe(bench: Bench, modality: str, name: str) -> None:
    token = rows_of(bench.src, modality)[0]["token"]

    def rename(found: list[Row]) -> None:
        next(row for row in found if row["token"] == token)["filename"] = name

    bench.edit("sample_data", rename)
    bench.refused(3, f"{VERSION}/sample_data.json, token {token}, field filename")


@pytest.mark.parametrize(
    "name", [name for name in UNSAFE.values() if name], ids=[key for key in UNSAFE if UNSAFE[key]]
)
def test_a_map_file_name_is_unsafe(bench: Bench, name: str) -> None:
    token = rows(bench.src, "map")[0]["token"]
    bench.edit("map", lambda found: found[0].update(filename=name))
    bench.refused(3, f"{VERSION}/map.json, token {token}, field filename")


@pytest.mark.parametrize("name", ["UNFINISHED.txt", ".unidrive/plan.json", "unidrive.json", f"{VERSION}/map.png"])
def test_a_file_name_that_the_output_needs_for_itself(bench: Bench, name: str) -> None:
    bench.edit("map", lambda found: found[0].update(filename=name))
    run = bench.convert()
    if run.code == 0:
        assert_consistent(bench.dst)
    else:
        assert run.code == 3
        assert not (bench.dst / VERSION).exists()


@pytest.mark.parametrize("modality", ["camera", "lidar"])
@pytest.mark.parametrize("level", ["file", "folder"])
def test_a_link_leads_out_of_the_dataset(bench: Bench, modality: str, level: str) -> None:
    row = rows_of(bench.src, modality)[0]
    inside = bench.src / row["filename"]
    inside = inside if level == "file" else inside.parent
    outside = bench.folder / "dst-private" / inside.name
    outside.parent.mkdir()
    inside.rename(outside)
    inside.symlink_to(outside)
    before = tree(outside.parent)
    bench.refused(3, row["token"], "field filename", "a link that leads out of the dataset")
    assert tree(outside.parent) == before


def test_a_top_level_folder_on_another_disk_is_fine(bench: Bench) -> None:
    disk = bench.folder / "dst-disk"
    disk.mkdir()
    for name in ("samples", "sweeps", "maps"):
        (bench.src / name).rename(disk / name)
        (bench.src / name).symlink_to(disk / name)
    bench.converted()
    assert sorted(path.name for path in (bench.dst / "maps").iterdir()) == [
        path.name for path in (disk / "maps").iterdir()
    ]


@pytest.mark.parametrize("where", ["outside", "inside"])
def test_a_link_in_the_maps_is_carried_or_refused_but_not_lost(bench: Bench, where: str) -> None:
    """`maps/expansion` is often unpacked elsewhere; below the top level such a link is refused, not forgotten."""
    store = (bench.folder / "dst-disk") if where == "outside" else (bench.src / "store")
    store.mkdir()
    (store / "singapore-onenorth.json").write_text("{}")
    (bench.src / "maps" / "expansion").symlink_to(store)
    run = bench.convert()
    if run.code == 0:
        assert (bench.dst / "maps" / "expansion" / "singapore-onenorth.json").read_text() == "{}"
    else:
        assert run.code == 3
        assert "maps/expansion" in run.said
        assert not bench.dst.exists()


@pytest.mark.parametrize("name", ["a\\b.png", "naïve.png", "with blank.png", os.fsdecode(b"\xff.png")])
def test_a_map_with_an_odd_name_does_no_harm(bench: Bench, name: str) -> None:
    (bench.src / "maps" / name).write_bytes(b"x")
    bench.converted()
    assert (bench.dst / "maps" / name).read_bytes() == b"x"


def test_a_lidar_file_that_the_source_lacks_is_said(bench: Bench) -> None:
    sweep = next(row for row in rows_of(bench.src, "lidar") if not row["is_key_frame"])
    (bench.src / sweep["filename"]).unlink()
    run = bench.convert()
    assert run.code == 0
    assert "missing in the source too" in run.stdout
    assert sweep["filename"] in run.stdout


@pytest.mark.parametrize("masks", ["frame", "camera", "none"])
def test_pictures_without_a_size_in_the_tables_take_the_files(bench: Bench, masks: str) -> None:
    """Formats in the wild: a row without a size takes the file's."""

    def strip(found: list[Row]) -> None:
        for row in found:
            del row["width"], row["height"]

    bench.edit("sample_data", strip)
    bench.converted("--masks", masks)


# --- datasets as others left them -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "bredton-8cam-tables",
            ("v1.0-mini/calibrated_sensor.json", "token 05f65b3ccff13671d5327d8f9d67d8e6", "rotation", "w, x, y, z"),
        ),
        ("simone-tables", ("sample_data.json", "needed and missing")),
        ("lyft-v1.01-train-tables", ("v1.01-train/sample_data.json", "field filename", ".jpeg is missing")),
        ("lyft-v1.01-train-tables/v1.01-train", ("is a version folder itself",)),
    ],
)
def test_tables_as_found_are_refused(shared_data: Path, bench: Bench, name: str, words: tuple[str, ...]) -> None:
    source = shared_data / "tables-as-found" / name
    before = tree(source)
    bench.refused(3, *words, src=source)
    assert tree(source) == before


def test_the_t4_test_set_converts(shared_data: Path, bench: Bench) -> None:
    """Its own layout; cameras that look straight up see nothing of what the virtual ones see."""
    source = shared_data / "tables-as-found" / "t4dataset-minimal"
    before = tree(source)
    run = bench.convert(src=source)
    assert run.code == 0
    assert tree(source) == before
    assert "3 samples, 6 pictures" in run.stdout
    assert "covered: CAM_FRONT 0%, CAM_BACK 0%" in run.stdout
    assert_consistent(bench.dst, "v1.0-trainval")


# --- interrupted ------------------------------------------------------------------------------------------------


def assert_unfinished(root: Path) -> None:
    """DST says so itself, and holds nothing that could be taken for a dataset."""
    assert "has not finished" in (root / "UNFINISHED.txt").read_text()
    assert not (root / VERSION).exists()
    assert not (root / "unidrive.json").exists()


def start(bench: Bench, *options: object) -> subprocess.Popen[str]:
    def default_interrupt() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a job in the background inherits SIG_IGN

    return subprocess.Popen(
        [SCRIPT, "convert", bench.src, bench.dst, "--rig", bench.rig, *map(str, options)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=default_interrupt,
    )


def wait_for_a_unit(bench: Bench, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 60
    while time.monotonic() < end and process.poll() is None:
        if list((bench.dst / ".unidrive" / "receipts").glob("*.json")):
            return
        time.sleep(0.005)
    pytest.fail(f"no unit was finished: {process.communicate()}")


def processes_of(group: int) -> dict[int, int]:
    """Processes of a process group that still live, with their parents."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == group and fields[0] != "Z":
            found[int(stat.parent.name)] = int(fields[1])
    return found


def workers_of(group: int) -> list[int]:
    """Those that a process of the group, but not the command itself, has forked."""
    found = processes_of(group)
    return [pid for pid, parent in found.items() if parent in found and parent != group]


@pytest.fixture
def long_bench(bench: Bench) -> Bench:
    bench.rig.write_text(LARGE_RIG)
    return bench


@pytest.fixture
def process(request: pytest.FixtureRequest, long_bench: Bench) -> Iterator[subprocess.Popen[str]]:
    """A run of several samples in which at least one is done and at least one is not."""
    started = start(long_bench, "--jobs", getattr(request, "param", 0))
    try:
        wait_for_a_unit(long_bench, started)
        yield started
    finally:
        for pid in processes_of(started.pid):
            os.kill(pid, signal.SIGKILL)
        started.communicate()


@pytest.mark.parametrize("process", [0, 2], indirect=True, ids=["jobs-0", "jobs-2"])
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGKILL], ids=["SIGINT", "SIGKILL"])
def test_an_interrupted_run_is_completed_by_the_same_command(
    long_bench: Bench, process: subprocess.Popen[str], kill: signal.Signals
) -> None:
    """Ctrl-C and kill -9 (of all its processes) in the middle."""
    os.killpg(process.pid, kill)
    stdout, stderr = process.communicate(timeout=20)
    if kill == signal.SIGINT:
        assert process.returncode == 130
        again = shlex.join(["unidrive", *map(str, process.args[1:])])
        assert f"interrupted. To continue:\n{again}\n" in stderr
    assert stdout == ""
    assert_unfinished(long_bench.dst)
    long_bench.converted()
    undisturbed = long_bench.folder / "dst-undisturbed"
    assert long_bench.convert(dst=undisturbed).code == 0
    assert tree(long_bench.dst, apart=("run.json",)) == tree(undisturbed, apart=("run.json",))


def test_ctrl_c_while_the_workers_start_shows_no_traceback(bench: Bench) -> None:
    """A terminal sends it to all processes: those that are just importing too."""
    told = []
    for pause_s in (0.05, 0.15, 0.25):
        started = start(bench, "--jobs", 2)
        try:
            while (
                started.poll() is None and len(processes_of(started.pid)) < 4
            ):  # tracker, server, and the first worker
                time.sleep(0.005)
            time.sleep(pause_s)
            os.killpg(started.pid, signal.SIGINT)
            told.append(started.communicate(timeout=20)[1])
        finally:
            for pid in processes_of(started.pid):
                os.kill(pid, signal.SIGKILL)
    assert [stderr for stderr in told if "Traceback" in stderr] == []


@pytest.mark.parametrize("process", [2], indirect=True, ids=["jobs-2"])
@pytest.mark.parametrize("kill", [signal.SIGTERM, signal.SIGKILL], ids=["SIGTERM", "SIGKILL"])
def test_no_worker_outlives_its_run(process: subprocess.Popen[str], kill: signal.Signals) -> None:
    """A batch system ends the process that it started; workers that go on would write into DST behind its back."""
    os.kill(process.pid, kill)
    process.wait(timeout=20)
    end = time.monotonic() + 10
    while processes_of(process.pid) and time.monotonic() < end:
        time.sleep(0.1)
    assert processes_of(process.pid) == {}


@pytest.mark.parametrize("process", [2], indirect=True, ids=["jobs-2"])
def test_a_worker_that_is_killed_is_said_and_the_same_command_continues(
    long_bench: Bench, process: subprocess.Popen[str]
) -> None:
    """As the kernel does when memory runs out: a sentence, not a hang."""
    os.kill(workers_of(process.pid)[0], signal.SIGKILL)
    _, stderr = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "a worker process was killed, most likely because memory ran out. The same command continues" in stderr
    assert "Traceback" not in stderr
    assert_unfinished(long_bench.dst)
    long_bench.converted()


def test_no_more_workers_than_samples(bench: Bench) -> None:
    """`--jobs 5000` must not start 5000 processes for three samples."""
    bench.rig.write_text(LARGE_RIG)
    run = start(bench, "--jobs", 6)
    most = 0
    try:
        while run.poll() is None:
            most = max(most, len(workers_of(run.pid)))
            time.sleep(0.02)
    finally:
        for pid in processes_of(run.pid):
            os.kill(pid, signal.SIGKILL)
        run.communicate()
    assert 2 <= most <= 3


@pytest.fixture
def half_done(bench: Bench) -> Bench:
    """A DST in which all samples but the last are done, and the source whole again."""
    picture = bench.picture(sample=2)
    whole = picture.read_bytes()
    picture.write_bytes(b"x")
    assert bench.convert().code == 3
    assert_unfinished(bench.dst)
    picture.write_bytes(whole)
    return bench


@pytest.mark.parametrize("what", ["samples", "masks"])
@pytest.mark.parametrize("damage", ["emptied", "zeros", "deleted"])
def test_a_picture_lost_with_the_power_is_made_again(half_done: Bench, damage: str, what: str) -> None:
    """A rename can survive a power cut that the bytes do not: the receipt is there, the picture is empty."""
    picture = next((half_done.dst / what / "CAM_FRONT").iterdir())
    whole = picture.read_bytes()
    if damage == "deleted":
        picture.unlink()
    else:
        picture.write_bytes(b"" if damage == "emptied" else bytes(len(whole)))
    half_done.converted()
    assert picture.read_bytes() == whole


def test_a_copy_lost_with_the_power_is_made_again(bench: Bench) -> None:
    """A carried file has no receipt: it must be as large as the source's."""
    picture = bench.picture(sample=1)
    content = picture.read_bytes()
    picture.unlink()
    assert bench.convert("--link", "copy", "--on-error", "skip").code == 1
    picture.write_bytes(content)
    cloud = next((bench.dst / "samples" / "LIDAR_TOP").iterdir())
    whole = cloud.read_bytes()
    cloud.write_bytes(b"")
    bench.converted("--link", "copy")
    assert cloud.read_bytes() == whole


def test_a_receipt_lost_with_the_power_is_made_again(half_done: Bench) -> None:
    for receipt in (half_done.dst / ".unidrive" / "receipts").iterdir():
        receipt.write_bytes(b"")
    half_done.converted()


def test_a_half_written_file_does_not_stay(half_done: Bench) -> None:
    (half_done.dst / ".unidrive" / "some.jpg.12345.part").write_bytes(b"x")
    half_done.converted()
    assert not list(half_done.dst.rglob("*.part*"))


def test_an_unfinished_dst_is_not_continued_with_other_options(half_done: Bench) -> None:
    half_done.refused(2, "quality 95, now 50", "--force", options=("--quality", 50))


def test_a_run_that_was_killed_before_its_plan_was_written_is_continued(bench: Bench) -> None:
    """Killed, or the disk full, between the folders and `plan.json`: DST is still ours."""
    (bench.dst / ".unidrive" / "receipts").mkdir(parents=True)
    (bench.dst / "UNFINISHED.txt").write_text(
        "unidrive has not finished here. Run the same command again to complete this dataset.\n"
    )
    bench.converted()


def test_a_finished_dataset_survives_a_failing_rerun(bench: Bench) -> None:
    """Killed while the work folder was removed: everything is there, and must stay whatever happens next."""
    bench.converted()
    whole = tree(bench.dst)
    (bench.dst / ".unidrive").mkdir()
    bench.picture().write_bytes(b"x")
    bench.convert()
    missing = {name for name in whole if not (bench.dst / name).exists()}
    assert missing == set()


# --- permissions, full disks, closed pipes: in processes of their own --------------------------------------------


def without_capabilities() -> tuple[str, ...]:
    """A command prefix under which file permissions hold for root too."""
    if os.geteuid() != 0:
        return ()
    if shutil.which("setpriv") is None:
        pytest.skip("running as root without setpriv: file permissions do not hold")
    return ("setpriv", "--bounding-set=-all", "--inh-caps=-all")


@pytest.fixture
def locked(bench: Bench) -> Iterator[Path]:
    """A folder below which nothing can be looked at."""
    folder = bench.folder / "locked"
    folder.mkdir()
    yield folder
    for path in (folder, *bench.src.rglob("*")):
        path.chmod(0o755)


@pytest.mark.parametrize(
    ("lock", "code", "words"),
    [
        ("dst", 4, ("locked/dst", "ermission denied")),
        ("read-only dst", 4, ("locked/dst", "cannot be written", "ermission denied")),
        ("src", 3, ("locked/src", "ermission denied")),
        ("rig", 2, ("locked/rig.yaml", "ermission denied")),
        ("picture", 3, ("samples/CAM_FRONT", "ermission denied")),
        ("pictures", 3, ("samples/CAM_FRONT", "ermission denied")),
        ("clouds", 3, ("samples/LIDAR_TOP", "cannot be read", "ermission denied")),
        ("table", 3, (f"{VERSION}/sample.json", "cannot be read", "ermission denied")),
        ("tables", 3, (VERSION, "ermission denied")),
        ("maps", 3, ("maps", "ermission denied")),
    ],
)
def test_what_may_not_be_read_or_written(
    bench: Bench, locked: Path, lock: str, code: int, words: tuple[str, ...]
) -> None:
    places = {
        "picture": bench.picture(),
        "pictures": bench.src / "samples" / "CAM_FRONT",
        "clouds": bench.src / "samples" / "LIDAR_TOP",
        "table": bench.table("sample"),
        "tables": bench.src / VERSION,
        "maps": bench.src / "maps",
    }
    source = locked / "src" if lock == "src" else bench.src
    target = locked / "dst" if "dst" in lock else bench.dst
    rig = locked / "rig.yaml" if lock == "rig" else bench.rig
    places.get(lock, locked).chmod(0o555 if lock == "read-only dst" else 0)
    arguments = ("convert", source, target, "--rig", rig, "--jobs", 0)
    run = spawn(*arguments, prefix=without_capabilities(), env={**os.environ, "COLUMNS": "300"})
    assert run.code == code, run.stdout + run.stderr
    for word in words:
        assert word in run.said
    assert not bench.dst.exists()


def test_dst_is_on_a_read_only_disk(bench: Bench) -> None:
    command = f"{SCRIPT} convert src disk/dst --rig rig.yaml --jobs 0"
    run = in_own_mounts(f"mkdir disk && mount -t tmpfs -o ro tmpfs disk && {command}", bench.folder)
    assert run.code == 4
    assert "disk/dst" in run.said
    assert "Read-only file system" in run.said


@pytest.mark.parametrize(("kilobytes", "jobs"), [(4, 0), (8, 0), (64, 0), (64, 2), (300, 0)])
def test_a_full_disk_is_said_and_the_same_command_continues(bench: Bench, kilobytes: int, jobs: int) -> None:
    """Full before the plan is written, among the pictures, and among the lidar files."""
    command = f"{SCRIPT} convert src disk/dst --rig rig.yaml --jobs {jobs} --link copy --no-space-check"
    script = f"""
        mkdir disk && mount -t tmpfs -o size={kilobytes}k tmpfs disk
        {command} && exit 99 || echo code $?
        ! test -e disk/dst/{VERSION}
        mount -o remount,size=100m disk
        {command} && cp -r disk/dst dst
    """
    run = in_own_mounts(script, bench.folder)
    assert "code 4" in run.stdout
    assert "No space left on device" in run.said
    assert run.code == 0, run.stderr
    assert_consistent(bench.dst)


def test_files_that_differ_by_case_on_a_disk_that_takes_no_notice_of_it(bench: Bench) -> None:
    """Such a disk finds `plan.json` under the name `PLAN.JSON` too; here that is a file of its own."""
    one, two = (row["filename"] for row in rows_of(bench.src, "lidar")[:2])
    twin = one.upper().replace("SAMPLES/LIDAR_TOP", "samples/LIDAR_TOP")
    (bench.src / two).rename(bench.src / twin)
    bench.edit("sample_data", lambda found: [row.update(filename=twin) for row in found if row["filename"] == two])
    bench.converted()
    bench.dst = bench.folder / "other"
    assert bench.convert("--part", "1/3").code == 0
    (bench.dst / ".unidrive" / "PLAN.JSON").write_text("")
    run = bench.convert()
    assert run.code == 4
    assert one in run.said
    assert twin in run.said
    assert "takes no notice of case" in run.said


def test_a_disk_that_is_too_small_is_said_before_the_start(bench: Bench) -> None:
    command = f"{SCRIPT} convert src disk/dst --rig rig.yaml --jobs 0"
    script = f"mkdir disk && mount -t tmpfs -o size=8k tmpfs disk && {command} --dry-run && {command}"
    run = in_own_mounts(script, bench.folder)
    assert run.code == 4
    assert "will take about" in run.said
    assert "--no-space-check" in run.said
    assert "the conversion will refuse to start" in run.stdout


@pytest.mark.parametrize("jobs", [0, 2])
def test_a_limit_of_file_sizes_is_said_and_the_same_command_continues(bench: Bench, jobs: int) -> None:
    """As a full disk; the tables are larger than the limit, the pictures are not (one block: 512 bytes)."""
    command = f"{SCRIPT} convert src dst --rig rig.yaml --jobs {jobs}"
    run = in_own_mounts(f"(ulimit -f 12; {command}) && exit 99 || echo code $?; {command}", bench.folder)
    assert "code 4" in run.stdout
    assert "File too large" in run.said
    assert run.code == 0, run.stderr
    assert_consistent(bench.dst)


def test_a_source_on_a_read_only_disk_is_copied_to_another_disk(bench: Bench) -> None:
    script = f"""
        mkdir ro disk
        mount --bind src ro && mount -o remount,ro,bind ro
        mount -t tmpfs tmpfs disk
        {SCRIPT} convert ro 'disk/my dr\303\251am' --rig rig.yaml --jobs 0 && cp -r 'disk/my dr\303\251am' dst
    """.replace("\\303\\251", "é")
    run = in_own_mounts(script, bench.folder)
    assert run.code == 0, run.stderr
    assert "DST is on another file system" in run.said
    assert_consistent(bench.dst)


@pytest.mark.parametrize(
    "arguments", [("inspect-rig", "6x60"), ("convert", "src", "dst", "--rig", "rig.yaml", "--jobs", "0")]
)
def test_a_reader_that_goes_away_is_no_bug(bench: Bench, arguments: tuple[str, ...]) -> None:
    """`unidrive inspect-rig 6x60 | head -1`."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [SCRIPT, *arguments]
    done = subprocess.run(command, cwd=bench.folder, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert "unexpected" not in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("role", ["src", "dst", "rig"])
def test_a_path_that_is_not_utf_8(bench: Bench, role: str) -> None:
    """A folder from an old disk: bytes that are no text are a path all the same."""
    odd = Path(os.fsdecode(bytes(bench.folder) + b"/dst\xff"))
    arguments: dict[str, Any] = {"src": bench.src, "dst": bench.dst, "rig": bench.rig}
    if role != "dst":
        shutil.copytree(bench.src, odd)
    arguments[role] = odd
    command = [SCRIPT, "convert", arguments["src"], arguments["dst"], "--rig", arguments["rig"], "--jobs", "0"]
    done = subprocess.run(command, capture_output=True, check=False)
    assert b"unexpected" not in done.stderr
    assert done.returncode == 0, done.stderr
    assert_consistent(arguments["dst"])


def test_the_interpreter_is_the_tests_own() -> None:
    """What `SCRIPT` starts is the package under test."""
    assert Path(SCRIPT).parent == Path(sys.executable).parent
    assert spawn("--version").stdout == unidrive("--version").stdout


def test_static_coverage_of_a_channel_that_is_given_twice(bench: Bench) -> None:
    """Of several key frames of one channel the nearest in time counts, as for the pictures."""

    def twice(found: list[Row]) -> None:
        front = [row for row in found if "/CAM_FRONT/" in row["filename"]]
        found.extend({**row, "token": f"{row['token']}b", "prev": "", "next": ""} for row in front)

    bench.converted("--masks", "camera", dst=bench.folder / "before")
    bench.edit("sample_data", twice)
    bench.converted("--masks", "camera")
    assert tree(bench.dst / "masks") == tree(bench.folder / "before" / "masks")


def test_static_coverage_without_a_picture_that_alone_knows_its_size(bench: Bench) -> None:
    bench.edit("sample_data", lambda found: [row.update(width=None, height=None) for row in found])
    bench.picture().unlink()
    run = bench.convert("--masks", "camera", "--on-error", "skip")
    assert run.code == 1
    assert "left out: " in run.stderr
    assert sorted(path.name for path in (bench.dst / "masks").iterdir()) == ["CAM_BACK.png", "CAM_FRONT.png"]


def test_what_a_dry_run_says_of_a_full_disk(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=10))
    assert "will refuse to start (--no-space-check)" in bench.convert("--dry-run").stdout
    assert "will start all the same" in bench.convert("--dry-run", "--no-space-check").stdout


@pytest.mark.parametrize("scanned", [False, True])
def test_rotations_that_are_no_unit_quaternions(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, scanned: bool
) -> None:
    """They are taken as their direction, which is said, and the output has none."""
    bench.converted(dst=bench.folder / "before")

    def halve(found: list[Row]) -> None:
        for row in found:
            row["rotation"] = [number / 2 for number in row["rotation"]]

    for table in ("ego_pose", "calibrated_sensor", "sample_annotation"):
        bench.edit(table, halve)
    if scanned:
        monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    run = bench.converted()
    for table in ("ego_pose", "calibrated_sensor", "sample_annotation"):
        found = rows(bench.src, table)
        words = f"{table}.json that are not of unit length: {len(found)}, the first of token {found[0]['token']}."
        assert words in run.stdout
    assert unidrive("validate", bench.dst).code == 0
    for picture in (bench.folder / "before" / "samples").rglob("*.jpg"):
        assert picture.read_bytes() == (bench.dst / picture.relative_to(bench.folder / "before")).read_bytes()


def test_a_source_that_is_a_conversion_is_said_to_be(bench: Bench) -> None:
    bench.converted()
    run = bench.converted(src=bench.dst, dst=bench.folder / "twice")
    assert "note: The source was itself written by unidrive convert" in run.stdout


def test_a_folder_of_several_datasets(bench: Bench) -> None:
    cars = bench.folder / "cars"
    for name in ("sedan", "van"):
        shutil.copytree(bench.src, cars / name)
    for options in ((), ("--version", VERSION), ("--version", f"van/{VERSION}")):
        bench.refused(2, "holds 2 datasets: sedan, van. Give the folder of one: ", src=cars, options=options)


def test_a_dry_run_sees_that_nothing_could_be_written(bench: Bench, locked: Path) -> None:
    locked.chmod(0o555)
    command = ("convert", bench.src, locked / "dst", "--rig", bench.rig, "--jobs", 0, "--dry-run")
    run = spawn(*command, prefix=without_capabilities())
    assert run.code == 4
    assert "locked/dst: cannot be written: Permission denied." in run.said
