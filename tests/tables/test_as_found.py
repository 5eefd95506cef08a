"""Genuine tables of other people's converters: what is usable opens, what is not is refused by name."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pyquaternion import Quaternion

from unidrive_cli.check.references import check_references
from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.dataset import open_dataset


def test_lyft_opens(shared_data: Path) -> None:
    """Float times, 64-digit tokens, no sizes of lidar rows, neighbours outside of the extract."""
    root = shared_data / "tables-as-found" / "lyft-v1.01-train-tables"
    dataset = open_dataset(root)
    assert dataset.version == "v1.01-train"
    assert dataset.layout.title == "Lyft Level 5"
    assert len(dataset.camera_channels()) == 7
    assert "CAM_FRONT_ZOOMED" in dataset.camera_channels()
    (sample,) = dataset.sample.rows
    assert sample.timestamp == 1556675185903083.2
    assert len(dataset.keyframes[sample.token]) == 7 + 3
    findings = list(check_references(dataset))
    assert findings
    assert not any(finding.error for finding in findings)
    for row, raw in zip(
        dataset.ego_pose.rows, json.loads((root / "v1.01-train" / "ego_pose.json").read_bytes()), strict=True
    ):
        data = next(item for item in dataset.sample_data.rows if item.ego_pose_token == row.token)
        expected = Quaternion(raw["rotation"]).transformation_matrix
        expected[:3, 3] = raw["translation"]
        np.testing.assert_allclose(dataset.global_from_ego(data), expected, atol=1e-9)
    zoomed = next(row for row in dataset.calibrated_sensor.rows if row.token.startswith("4f30ede5"))
    assert dataset.lens(zoomed, 1920, 1080).fx_px == 3962.24093836


def test_bredton_is_refused_for_its_matrices(shared_data: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        open_dataset(shared_data / "tables-as-found" / "bredton-8cam-tables")
    sentence = str(caught.value)
    for word in (
        "v1.0-mini/calibrated_sensor.json",
        "token 05f65b3ccff13671d5327d8f9d67d8e6",
        "field rotation",
        "w, x, y, z",
    ):
        assert word in sentence


def test_bredton_with_quaternions_is_refused_for_its_missing_poses(shared_data: Path, tmp_path: Path) -> None:
    """What the next sentence would be, once a user has put the matrices right."""
    shutil.copytree(shared_data / "tables-as-found" / "bredton-8cam-tables" / "v1.0-mini", tmp_path / "v1.0-mini")
    path = tmp_path / "v1.0-mini" / "calibrated_sensor.json"
    rows = json.loads(path.read_bytes())
    path.chmod(0o644)
    path.write_text(json.dumps([row | {"rotation": [1, 0, 0, 0]} for row in rows]))
    with pytest.raises(DatasetError) as caught:
        open_dataset(tmp_path)
    sentence = str(caught.value)
    for word in ("sample_data.json", "token 86a0fe4d5a798c86288f1c42d7f4a933", "field ego_pose_token", "missing"):
        assert word in sentence


def test_simone_is_refused_for_its_missing_table_and_its_dangling_sensors(shared_data: Path) -> None:
    root = shared_data / "tables-as-found" / "simone-tables"
    with pytest.raises(DatasetError) as caught:
        open_dataset(root)
    first = json.loads((root / "calibrated_sensor.json").read_bytes())[0]
    sentence = str(caught.value)
    assert sentence.startswith(f"{root}/sample_data.json: this table is needed and missing. Besides, ")
    assert f"calibrated_sensor.json, token {first['token']}, field sensor_token" in sentence
    assert f"points to {first['sensor_token']!r}, which is not in sensor.json." in sentence


def test_the_partial_test_split_is_refused_for_its_missing_lists(shared_data: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        open_dataset(shared_data / "tables-as-found" / "partial-v1.0-test")
    sentence = str(caught.value)
    for word in ("v1.0-test/sample.json", "token ca9a282c9e77460f8360f564131a8af5", "field prev", "missing"):
        assert word in sentence


def test_t4_opens(shared_data: Path) -> None:
    dataset = open_dataset(shared_data / "tables-as-found" / "t4dataset-minimal")
    assert dataset.version == "annotation"
    assert dataset.layout.title == "T4"
    assert dataset.notes == []
    assert not list(check_references(dataset))
    assert set(dataset.extra_tables) == {"object_ann", "surface_ann", "vehicle_state"}


def test_simone_with_its_tables_completed_is_refused_for_its_dangling_sensors(
    shared_data: Path, tmp_path: Path
) -> None:
    shutil.copytree(shared_data / "tables-as-found" / "simone-tables", tmp_path / "v1.0-mini")
    (tmp_path / "v1.0-mini").chmod(0o755)
    for name in ("sample_data", "ego_pose"):
        (tmp_path / "v1.0-mini" / f"{name}.json").write_text("[]")
    dataset = open_dataset(tmp_path)
    first = dataset.calibrated_sensor.rows[0]
    place = f"{tmp_path}/v1.0-mini/calibrated_sensor.json, token {first.token}, field sensor_token"
    with pytest.raises(DatasetError) as caught:
        _ = dataset.sensor_of_calibration
    assert str(caught.value).startswith(f"{place}: points to '{first.sensor_token}', which is not in sensor.json")
    dangling = [finding for finding in check_references(dataset) if finding.where.endswith("field sensor_token")]
    assert len(dangling) == len(dataset.calibrated_sensor.rows) == 14
    assert all(finding.error for finding in dangling)
    assert dangling[0].where == place
