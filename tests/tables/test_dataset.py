"""Opening a dataset: which folder is meant, what may be missing, and the sentence where it cannot be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.tables.small import VERSION, tables, write
from unidrive_cli.errors import DatasetError, UnidriveError, UsageError
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.schema import NEEDED, TABLES


def refusal(root: Path, kind: type[UnidriveError], version: str | None = None) -> str:
    with pytest.raises(kind) as caught:
        open_dataset(root, version)
    assert caught.value.exit_code == (2 if kind is UsageError else 3)
    return str(caught.value)


# --- which folder ------------------------------------------------------------------------------------


def test_opens_the_small_dataset(tmp_path: Path) -> None:
    dataset = open_dataset(write(tmp_path / "data"))
    assert (dataset.root, dataset.version, dataset.folder) == (
        tmp_path / "data", VERSION, tmp_path / "data" / VERSION)  # fmt: skip
    assert {name: len(getattr(dataset, name).rows) for name in TABLES} == {
        name: len(rows) for name, rows in tables().items()
    }
    assert dataset.notes == []
    assert dataset.extra_tables == {}


@pytest.mark.parametrize("version", ["v1.0-mini", "annotation", "v1.01-train", "my own"])
def test_the_version_folder_is_found_by_what_it_holds(tmp_path: Path, version: str) -> None:
    write(tmp_path, version=version)
    write(tmp_path, version=".v1.0-hidden")
    for other in ("samples", "maps", "v1.0-empty"):
        (tmp_path / other).mkdir()
    (tmp_path / "sensor.json.txt").write_text("[]")
    assert open_dataset(tmp_path).version == version
    assert open_dataset(tmp_path, version).version == version


def test_no_such_folder(tmp_path: Path) -> None:
    assert f"{tmp_path / 'none'}: there is no such folder" in refusal(tmp_path / "none", DatasetError)


def test_a_file(tmp_path: Path) -> None:
    (tmp_path / "data.zip").write_bytes(b"PK")
    assert f"{tmp_path / 'data.zip'}: is a file" in refusal(tmp_path / "data.zip", DatasetError)


def test_no_version_folder(tmp_path: Path) -> None:
    (tmp_path / "samples").mkdir()
    sentence = refusal(tmp_path, DatasetError)
    assert f"{tmp_path}: holds no version folder" in sentence
    assert "v1.0-" in sentence


def test_two_version_folders(tmp_path: Path) -> None:
    write(write(tmp_path), version="v1.0-trainval")
    sentence = refusal(tmp_path, UsageError)
    assert "2 version folders: v1.0-mini, v1.0-trainval" in sentence
    assert "--version" in sentence
    assert open_dataset(tmp_path, "v1.0-trainval").version == "v1.0-trainval"


def test_an_unknown_version(tmp_path: Path) -> None:
    sentence = refusal(write(tmp_path), UsageError, "v1.0-trainval")
    assert "--version v1.0-trainval" in sentence
    assert "It holds: v1.0-mini" in sentence


@pytest.mark.parametrize("version", ["..", "../data/v1.0-mini", "/", "", "v1.0-mini/"])
def test_a_version_is_a_name_and_no_path(tmp_path: Path, version: str) -> None:
    refusal(write(tmp_path / "data"), UsageError, version)


def test_the_version_folder_itself(tmp_path: Path) -> None:
    sentence = refusal(write(tmp_path) / VERSION, DatasetError)
    assert "is a version folder itself" in sentence
    assert f"Give the folder above it: {tmp_path}" in sentence


def test_a_folder_with_sensor_but_without_sample_data_is_second_choice(tmp_path: Path) -> None:
    write(tmp_path, version="v1.0-mini")
    (tmp_path / "lidarseg").mkdir()
    (tmp_path / "lidarseg" / "sensor.json").write_text("[]")
    assert open_dataset(tmp_path).version == "v1.0-mini"


# --- which tables ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NEEDED)
def test_a_needed_table_is_missing(tmp_path: Path, name: str) -> None:
    (write(tmp_path) / VERSION / f"{name}.json").unlink()
    sentence = refusal(tmp_path, DatasetError)
    if name != "sensor":  # without which the folder is not known for a version folder
        assert f"{tmp_path / VERSION / name}.json: this table is needed and missing" in sentence


@pytest.mark.parametrize("name", sorted(set(TABLES) - set(NEEDED)))
def test_another_table_is_missing_and_it_is_said(tmp_path: Path, name: str) -> None:
    (write(tmp_path) / VERSION / f"{name}.json").unlink()
    dataset = open_dataset(tmp_path)
    (note,) = dataset.notes
    assert f"{name}.json is missing" in note
    rows = getattr(dataset, name).rows
    assert f"{len(rows)} rows" in note
    pointed_to = {"instance": 1, "category": 1}  # by the annotation of the small dataset
    assert len(rows) == {"visibility": 4, "log": 1, "map": 1, **pointed_to}.get(name, 0)


def test_a_missing_log_is_made_so_that_no_scene_dangles(tmp_path: Path) -> None:
    made = tables()
    del made["log"], made["map"]
    dataset = open_dataset(write(tmp_path, made))
    assert [row.token for row in dataset.log.rows] == ["log"]
    assert dataset.map.rows[0].log_tokens == ["log"]


def test_extra_files_are_known_whether_they_are_tables_or_not(tmp_path: Path) -> None:
    """carla_nuscenes writes a progress.json that is no list."""
    (write(tmp_path) / VERSION / "progress.json").write_text('{"done": 1}')
    dataset = open_dataset(tmp_path)
    assert list(dataset.extra_tables) == ["progress"]
    assert dataset.extra_tables["progress"].rows is None
    digest = dataset.digest
    (tmp_path / VERSION / "progress.json").write_text('{"done": 2}')
    assert open_dataset(tmp_path).digest != digest


def test_the_digest_is_of_the_tables_and_not_of_the_place(tmp_path: Path) -> None:
    first, second = (open_dataset(write(tmp_path / name)).digest for name in ("here", "there"))
    assert first == second
    for name in TABLES:
        made = tables()
        made[name] = [*made[name], {**(made[name][0] if made[name] else {"name": "x"}), "token": "one more"}]
        assert open_dataset(write(tmp_path / name, made)).digest != first


# --- what is asked of it -----------------------------------------------------------------------------


def test_indexes(tmp_path: Path) -> None:
    made = tables()
    made["sample"].reverse()  # tables need not be in the order of time
    made["sample_data"][1]["is_key_frame"] = False
    dataset = open_dataset(write(tmp_path, made))
    assert [row.token for row in dataset.samples_of_scene["scene"]] == ["s0", "s1", "s2"]
    assert {token: [row.token for row in rows] for token, rows in dataset.keyframes.items()} == {
        "s0": ["cam-s0"], "s1": ["cam-s1", "lidar-s1"], "s2": ["cam-s2", "lidar-s2"]}  # fmt: skip
    assert [row.token for row in dataset.annotations("s1")] == ["car-s1"]
    assert dataset.sensor_of(dataset.sample_data.rows[1]).channel == "LIDAR_TOP"
    assert dataset.camera_channels() == ["CAM_FRONT"]


def test_poses_and_lens(tmp_path: Path) -> None:
    dataset = open_dataset(write(tmp_path))
    row, calibration = dataset.sample_data.rows[4], dataset.calibrated_sensor.rows[0]
    np.testing.assert_array_equal(dataset.global_from_ego(row)[:3, 3], [10, 0, 0])
    np.testing.assert_allclose(
        dataset.ego_from_sensor(calibration), [[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.6], [0, 0, 0, 1]]
    )
    lens = dataset.lens(calibration, 1600, 900)
    assert (lens.fx_px, lens.cx_px, lens.cy_px) == (800, 799.5, 449.5)


@pytest.mark.parametrize(
    ("table", "changes", "ask", "words"),
    [
        ("sample_data", {"ego_pose_token": "no"}, "pose", "token cam-s0, field ego_pose_token: points to 'no'"),
        (
            "sample_data",
            {"calibrated_sensor_token": "no"},
            "sensor",
            "field calibrated_sensor_token: points to 'no'",
        ),
        ("calibrated_sensor", {"sensor_token": "no"}, "sensor", "field sensor_token: points to 'no'"),
        ("sample", {"scene_token": "no"}, "samples", "token s0, field scene_token: points to 'no'"),
        ("ego_pose", {"rotation": [0, 0, 0, 0]}, "pose", "token ego-s0, field rotation: .*zero norm"),
        ("calibrated_sensor", {"camera_intrinsic": []}, "lens", "field camera_intrinsic: .*shape 3x3"),
        ("calibrated_sensor", {"camera_intrinsic": [[0, 0, 1], [0, 5, 1], [0, 0, 1]]}, "lens", "positive"),
    ],
)
def test_broken_rows_are_named_when_they_are_asked_for(
    tmp_path: Path, table: str, changes: dict, ask: str, words: str
) -> None:
    made = tables()
    made[table][0].update(changes)
    dataset = open_dataset(write(tmp_path, made))
    with pytest.raises(DatasetError, match=words) as caught:
        {
            "pose": lambda: dataset.global_from_ego(dataset.sample_data.rows[0]),
            "sensor": lambda: dataset.sensor_of(dataset.sample_data.rows[0]),
            "samples": lambda: dataset.samples_of_scene,
            "lens": lambda: dataset.lens(dataset.calibrated_sensor.rows[0], 1600, 900),
        }[ask]()
    assert str(caught.value).startswith(
        f"{tmp_path / VERSION / table}.json, token {made[table][0]['token']}, field "
    )


@pytest.mark.parametrize(
    ("method", "name", "words"),
    [
        ("scenes_named", "scene-001", "--scene scene-001: .*Did you mean scene-0001?"),
        ("scenes_named", "Paris", "--scene Paris: .*There are: scene-0001"),
        ("camera_channels", "CAM_FRON", "--camera CAM_FRON: .*Did you mean CAM_FRONT?"),
        ("camera_channels", "LIDAR_TOP", "--camera LIDAR_TOP: there is no such camera"),
    ],
)
def test_unknown_names(tmp_path: Path, method: str, name: str, words: str) -> None:
    dataset = open_dataset(write(tmp_path))
    with pytest.raises(UsageError, match=words):
        getattr(dataset, method)([name])


def test_known_names(tmp_path: Path) -> None:
    dataset = open_dataset(write(tmp_path))
    for names in ([], ["scene-0001"]):
        assert [scene.token for scene in dataset.scenes_named(names)] == ["scene"]
    assert dataset.camera_channels(["CAM_FRONT"]) == ["CAM_FRONT"]


def test_a_sensor_that_nothing_uses_is_no_camera_of_the_dataset(tmp_path: Path) -> None:
    """The partial set as found lists 12 sensors and uses 7."""
    made = tables()
    made["sensor"].append({"token": "spare", "channel": "CAM_SPARE", "modality": "camera"})
    assert open_dataset(write(tmp_path, made)).camera_channels() == ["CAM_FRONT"]


def test_tables_with_a_byte_changed_in_any_place_open_or_are_refused(tmp_path: Path) -> None:
    """The first calibration row, each byte in turn made a quote: never anything but a DatasetError."""
    path = write(tmp_path) / VERSION / "calibrated_sensor.json"
    text = path.read_bytes()
    refused, length = 0, len(json.dumps(tables()["calibrated_sensor"][0]))
    for place in range(length):
        path.write_bytes(text[:place] + b'"' + text[place + 1 :])
        try:
            open_dataset(tmp_path)
        except DatasetError as error:
            refused += str(path) in str(error)
    assert refused > 0.8 * length
