"""Genuine tables of other layouts, converted."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np

from tests.datasets import assert_consistent, rows, unidrive

RIG = """\
name: up-and-ahead
cameras:
  CAM_UP: {width: 64, height: 48, hfov: 38, position: [1.5, 0.0, 1.8], pitch: 89.9, yaw: 0}
  CAM_FRONT: {width: 64, height: 28, hfov: 80, position: [1.5, 0.0, 1.6], yaw: 0}
"""


def converted(source: Path, tmp_path: Path) -> Path:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    run = unidrive("convert", source, tmp_path / "out", "--rig", rig, "--jobs", 0)
    assert run.code == 0, run.stdout + run.stderr
    found = unidrive("validate", tmp_path / "out", "--json").json()
    assert found["findings"] == []
    assert found["opened_with_devkit"]
    return tmp_path / "out"


def test_t4s_minimal_dataset(shared_data: Path, tmp_path: Path) -> None:
    """Its cameras look straight up, so does one of ours."""
    source = shared_data / "tables-as-found" / "t4dataset-minimal"
    out = converted(source, tmp_path)
    nusc = assert_consistent(out, "v1.0-trainval")
    assert (len(nusc.sample), len(nusc.sample_annotation)) == (3, 4)
    covered = json.loads((out / "unidrive.json").read_bytes())["covered"]
    assert covered["CAM_UP"] == 1
    assert covered["CAM_FRONT"] == 0
    states = [
        json.loads((root / "vehicle_state.json").read_bytes())
        for root in (source / "annotation", out / nusc.version)
    ]
    assert states[0] == states[1]
    assert rows(out, "object_ann", nusc.version) == []  # their pictures are gone
    assert (out / "status.json").read_bytes() == (source / "status.json").read_bytes()
    assert (out / "map" / "lanelet2_map.osm").read_bytes() == (source / "map" / "lanelet2_map.osm").read_bytes()


def test_lyfts_tables_with_pictures_of_their_size(shared_data: Path, tmp_path: Path) -> None:
    """The extract has no pictures: each camera gets one of one colour, and so the front picture has only those."""
    source = Path(shutil.copytree(shared_data / "tables-as-found" / "lyft-v1.01-train-tables", tmp_path / "lyft"))
    for path in (source, *source.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    shots = rows(source, "sample_data", "v1.01-train")
    for row in shots:
        file = source / row["filename"]
        file.parent.mkdir(exist_ok=True)
        if row["fileformat"] == "jpeg":
            grey = np.full((row["height"], row["width"], 3), 120, np.uint8)
            file.write_bytes(cv2.imencode(".jpg", grey)[1].tobytes())
        else:
            np.zeros((4, 5), np.float32).tofile(file)
    out = converted(source, tmp_path)
    nusc = assert_consistent(out, "v1.0-trainval")
    assert len(nusc.sample) == 1
    assert {row["channel"] for row in nusc.sample_data} == {
        *("CAM_UP", "CAM_FRONT", "LIDAR_TOP", "LIDAR_FRONT_LEFT", "LIDAR_FRONT_RIGHT")
    }
    assert nusc.sample[0]["timestamp"] == 1556675185903083.2
    picture = cv2.imread(str(next((out / "samples" / "CAM_FRONT").iterdir())))
    assert np.abs(picture.astype(int) - 120).max() <= 2
    lidar = [row for row in shots if row["fileformat"] != "jpeg"]
    for row in lidar:
        assert list((out / "samples").rglob(Path(row["filename"]).name))
