"""Lenses of a dataset's cameras: from its tables, or from a side file."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest

from tests.tables.small import VERSION, tables, write
from unidrive_cli.errors import DatasetError, RigError, UsageError
from unidrive_cli.geometry.lenses import FisheyeLens, Lens, OpenCVLens, Pinhole
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.lenses import read_lenses
from unidrive_cli.tables.rig_of_dataset import rig_of_dataset

BARREL = [-0.31, 0.12, 4e-4, -2e-4, -0.02]
FISHEYE = [0.05, -0.01, 2e-3, -3e-4]


def lens_of_table(tmp_path: Path, side_file: str = "", **fields: Any) -> Lens:
    made = tables()
    made["calibrated_sensor"][0].update(fields)
    (tmp_path / "lenses.yaml").write_text(side_file)
    lenses = read_lenses(tmp_path / "lenses.yaml") if side_file else None
    root = Path(tempfile.mkdtemp(dir=tmp_path))
    dataset = open_dataset(write(root, made), lenses=lenses)
    return dataset.lens(dataset.calibrated_sensor.rows[0], 1600, 900)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_opencv_coefficients_of_a_table(tmp_path: Path, count: int) -> None:
    values = [*BARREL, 0.01, 0.002, -0.001, 1e-4, 2e-4, -1e-4, 1e-5, 0.02, -0.01][:count]
    lens = lens_of_table(tmp_path, camera_distortion=values)
    assert isinstance(lens, OpenCVLens)
    assert lens.coefficients[:count] == tuple(values)
    assert (lens.fx_px, lens.cx_px, lens.width_px, lens.height_px) == (800, 799.5, 1600, 900)


def test_a_table_may_say_fisheye(tmp_path: Path) -> None:
    """Four coefficients are OpenCV's k1 k2 p1 p2 unless camera_model says otherwise."""
    assert isinstance(lens_of_table(tmp_path, camera_distortion=FISHEYE), OpenCVLens)
    lens = lens_of_table(tmp_path, camera_distortion=FISHEYE, camera_model="fisheye")
    assert isinstance(lens, FisheyeLens)
    assert lens.coefficients == tuple(FISHEYE)
    bare = lens_of_table(tmp_path, camera_distortion=[0, 0, 0, 0], camera_model="fisheye")
    assert isinstance(bare, FisheyeLens)


@pytest.mark.parametrize("nothing", [None, [], [0, 0, 0, 0, 0], [0.0] * 14])
@pytest.mark.parametrize("model", [None, "opencv", "pinhole"])
def test_no_distortion_is_a_pinhole(tmp_path: Path, nothing: Any, model: Any) -> None:
    assert isinstance(lens_of_table(tmp_path, camera_distortion=nothing, camera_model=model), Pinhole)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"camera_distortion": [0.1, 0, 0]}, "field camera_distortion: .* has 4, 5, 8, 12.* got 3"),
        ({"camera_distortion": [-50, 0, 0, 0]}, "field camera_distortion: .*folds back 4.67 degrees off the axis"),
        ({"camera_distortion": [0.1], "camera_model": "fisheye"}, "field camera_distortion: .*fisheye has 4"),
        ({"camera_distortion": FISHEYE, "camera_model": "fishey"}, "field camera_model: .*Did you mean fisheye"),
        ({"camera_distortion": FISHEYE, "camera_model": 7}, "field camera_model: .*must be opencv or fisheye"),
        ({"camera_distortion": [], "camera_model": "fisheye"}, "field camera_distortion: .*fisheye has 4 .* got 0"),
    ],
)
def test_a_table_that_says_no_lens(tmp_path: Path, fields: dict[str, Any], words: str) -> None:
    with pytest.raises(DatasetError, match=words) as caught:
        lens_of_table(tmp_path, **fields)
    token = tables()["calibrated_sensor"][0]["token"]
    assert f"{VERSION}/calibrated_sensor.json, token {token}, field camera_" in str(caught.value)


def test_the_side_file_says_the_lens(tmp_path: Path) -> None:
    lens = lens_of_table(tmp_path, f"CAM_FRONT: {{model: opencv, coefficients: {BARREL}}}")
    assert isinstance(lens, OpenCVLens)
    assert (lens.fx_px, lens.coefficients[:5]) == (800, tuple(BARREL))
    text = "CAM_FRONT:\n  model: fisheye\n  coefficients: [0.05, -0.01, 0.002, -0.0003]\n"
    own = lens_of_table(tmp_path, text + "  intrinsics: [480, 481, 790, 440]\n")
    assert isinstance(own, FisheyeLens)
    assert (own.fx_px, own.fy_px, own.cx_px, own.cy_px, own.width_px) == (480, 481, 790, 440, 1600)


def test_the_rig_of_a_dataset_has_the_side_files_lenses(tmp_path: Path) -> None:
    path = tmp_path / "lenses.yaml"
    path.write_text(f"CAM_FRONT: {{model: opencv, coefficients: {BARREL}}}")
    rig, _ = rig_of_dataset(open_dataset(write(tmp_path, tables()), lenses=read_lenses(path)))
    assert rig.cameras[0].lens.coefficients[:5] == tuple(BARREL)


def test_both_may_say_the_same_but_not_two_things(tmp_path: Path) -> None:
    same = f"CAM_FRONT: {{model: opencv, coefficients: {BARREL}}}"
    assert isinstance(lens_of_table(tmp_path, same, camera_distortion=[*BARREL, 0, 0, 0]), OpenCVLens)
    with pytest.raises(
        UsageError, match=r"lenses\.yaml, CAM_FRONT, line 1: is not the lens that the dataset gives"
    ) as e:
        lens_of_table(tmp_path, same, camera_distortion=[0.1, 0, 0, 0])
    assert "opencv [0.1, 0.0" in str(e.value)
    assert "calibrated_sensor.json, token" in str(e.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "must map channels to lenses: CAM_FRONT: .model: opencv or fisheye"),
        ("{}", "must map channels to lenses"),
        ("CAM_FRONT: [", "is not valid YAML"),
        ("CAM_FRONT: fisheye", "line 1: CAM_FRONT must be a mapping .*got 'fisheye'"),
        ("\nCAM_FRONT: {model: fisheye}", "CAM_FRONT.*coefficients"),
        ("CAM_FRONT: {coefficients: [0, 0, 0, 0]}", "CAM_FRONT.*model"),
        (
            "CAM_FRONT: {model: fish, coefficients: []}",
            "must be opencv or fisheye, got 'fish'. Did you mean fisheye?",
        ),
        ("CAM_FRONT: {model: fisheye, coefficients: 0.1}", "must be a list of numbers, got 0.1"),
        ("CAM_FRONT: {model: fisheye, coefficients: [a, 0, 0, 0]}", "number.*'a'"),
        ("CAM_FRONT: {model: fisheye, coefficients: [0, 0, 0, 0], k: 1}", "k is not a known key"),
        ("CAM_FRONT: {model: fisheye, coefficients: [0, 0, 0, 0], intrinsics: [1, 2]}", "intrinsics.*4 numbers"),
        ("A: {model: fisheye, coefficients: []}\nA: {model: fisheye, coefficients: []}", "A is given twice"),
    ],
)
def test_a_side_file_that_is_none(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "lenses.yaml"
    path.write_text(text)
    with pytest.raises(RigError, match=words) as caught:
        read_lenses(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("CAM_FRON: {model: fisheye, coefficients: [0, 0, 0, 0]}", "no such camera .*Did you mean CAM_FRONT?"),
        ("LIDAR_TOP: {model: fisheye, coefficients: [0, 0, 0, 0]}", "LIDAR_TOP, line 1: there is no such camera"),
        ("CAM_FRONT: {model: opencv, coefficients: [1, 2, 3]}", "has 4, 5, 8, 12.*got 3"),
        ("CAM_FRONT: {model: opencv, coefficients: [-50, 0, 0, 0]}", "CAM_FRONT, line 1: .*folds back"),
        (
            "\n\nCAM_FRONT: {model: fisheye, coefficients: [0, 0, 0, 0], intrinsics: [-1, 1, 1, 1]}",
            "CAM_FRONT, line 3: focal lengths must be positive",
        ),
    ],
)
def test_a_side_file_that_does_not_fit_the_dataset(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        lens_of_table(tmp_path, text)


def test_a_side_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"none\.yaml: "):
        read_lenses(tmp_path / "none.yaml")
