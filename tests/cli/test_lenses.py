"""A synthetic drive through rigs of each lens model, from `synth` to `convert`, and what the commands say of it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.datasets import Row, rows, tree, unidrive
from tests.frames import psnr_db
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.rig.yaml_file import load_rig
from unidrive_cli.tables.dataset import open_dataset

VERSION = "v1.0-trainval"
MODELS = {
    "plain": "",
    "opencv-5": "{model: opencv, coefficients: [-0.12, 0.02, 4e-4, -2e-4, 0.001]}",
    "opencv-8": "{model: opencv, coefficients: [0.4, 0.15, 1e-4, 1e-4, 0.01, 0.55, 0.2, 0.02]}",
    "opencv-12": "{model: opencv, coefficients: [-0.1, 0.02, 1e-3, 1e-3, 0, 0, 0, 0, 2e-3, -1e-3, 2e-3, 1e-3]}",
    "fisheye": "{model: fisheye, coefficients: [0.05, -0.01, 0.002, -0.0003]}",
}
"""All of about the middle's resolution, and wider than what the virtual rig looks at."""
CAMERAS = {"CAM_FRONT": (1.5, 0.0, 0), "CAM_FRONT_LEFT": (1.4, 0.4, 60), "CAM_BACK": (0.0, 0.0, 180)}
VIRTUAL = """\
name: truth
cameras:
  CAM_FRONT: {width: 320, height: 150, hfov: 62, position: [1.6, 0.1, 1.5], yaw: 24, pitch: -3}
  CAM_BACK: {width: 320, height: 150, hfov: 56, position: [0.1, 0.1, 1.6], yaw: 176, pitch: -2}
"""


def rig_text(name: str, distortion: str) -> str:
    lines = [f"name: {name}", "cameras:"]
    for channel, (x, y, yaw) in CAMERAS.items():
        lens = f", distortion: {distortion}" if distortion else ""
        lines.append(
            f"  {channel}: {{width: 480, height: 270, intrinsics: [250, 252, 241.5, 133.0], "
            f"position: [{x}, {y}, 1.6], yaw: {yaw}{lens}}}"
        )
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the rig files, and one drive of one sample through each of the rigs."""
    root = tmp_path_factory.mktemp("lenses")
    texts = {name: rig_text(name, distortion) for name, distortion in MODELS.items()} | {"truth": VIRTUAL}
    files = []
    for name, text in texts.items():
        files.append(root / f"{name}.yaml")
        files[-1].write_text(text)
    named = [part for path in files for part in ("--rig", path)]
    run = unidrive("synth", root / "made", *named, "--scenes", 1, "--keyframes", 1, "--seed", 7, "--jobs", 0,
                   "--firing", "together", "--instances")  # fmt: skip
    assert run.code == 0, run.stderr
    return root


@pytest.fixture(scope="module")
def fidelity(drives: Path) -> dict[str, dict[str, Any]]:
    """Of each rig's drive, converted."""
    found = {}
    for name in MODELS:
        converted(drives / "made" / name, drives / "out" / name, drives / "truth.yaml")
        run = unidrive("measure", drives / "out" / name, "--truth", drives / "made" / "truth", "--json")
        assert run.code == 0, run.stderr
        found[name] = run.json()
    return found


def converted(source: Path, out: Path, rig: Path, *options: object) -> Path:
    run = unidrive("convert", source, out, "--rig", rig, "--jobs", 0, *options)
    assert run.code == 0, run.stderr
    return out


def pictures(root: Path) -> dict[str, np.ndarray]:
    return {path.name: cv2.imread(str(path)) for path in sorted(root.glob("samples/CAM_*/*.jpg"))}


def set_rows(root: Path, table: str, change: Any) -> None:
    found: list[Row] = rows(root, table, VERSION)
    for row in found:
        change(row)
    (root / VERSION / f"{table}.json").write_text(json.dumps(found))


@pytest.mark.parametrize("name", [name for name in MODELS if name != "plain"])
def test_a_lens_costs_less_than_half_a_decibel(fidelity: dict[str, dict[str, Any]], name: str) -> None:
    plain, bent = fidelity["plain"], fidelity[name]
    assert plain["covered"] > 0.999
    assert bent["covered"] == pytest.approx(plain["covered"], abs=1e-3)
    assert bent["truth"]["psnr"] > plain["truth"]["psnr"] - 0.5


def test_the_pictures_of_all_lenses_show_the_same(drives: Path, fidelity: dict[str, dict[str, Any]]) -> None:
    """Nearer to those of the pinholes than either is to the truth."""
    plain = pictures(drives / "out" / "plain")
    for name in MODELS:
        for file, picture in pictures(drives / "out" / name).items():
            assert psnr_db(picture, plain[file]) > fidelity["plain"]["truth"]["psnr"] + 3


def test_the_commands_take_such_a_dataset(drives: Path) -> None:
    for name in ("opencv-12", "fisheye"):
        source = drives / "made" / name
        run = unidrive("validate", source)
        assert (run.code, run.stderr) == (0, ""), run.stdout
        run = unidrive("inspect-rig", source, "--json")
        assert run.code == 0, run.stderr
        assert {camera["lens"] for camera in run.json()["cameras"]} == {name.split("-")[0]}
        assert name.split("-")[0] in unidrive("inspect-rig", source).stdout
        run = unidrive("measure", source, "--rig", drives / "truth.yaml", "--json")
        assert run.code == 0, run.stderr
        assert run.json()["pairs"]["count"] > 20
    errors = {name: measured_error(drives, name) for name in ("plain", "opencv-8", "fisheye")}
    assert max(errors.values()) < 1.2 * min(errors.values())


def measured_error(drives: Path, name: str) -> float:
    run = unidrive("measure", drives / "made" / name, "--rig", drives / "truth.yaml", "--json")
    assert run.code == 0, run.stderr
    return float(run.json()["pairs"]["mean"])


@pytest.mark.parametrize("name", ["opencv-8", "fisheye"])
def test_a_side_file_says_what_the_tables_do_not(drives: Path, tmp_path: Path, name: str) -> None:
    """The same pictures, byte for byte, as from tables that say it; without either they are others."""
    said = converted(drives / "made" / name, tmp_path / "said", drives / "truth.yaml")
    source = Path(shutil.copytree(drives / "made" / name, tmp_path / "src"))
    set_rows(source, "calibrated_sensor", lambda row: (row.pop("camera_distortion", 0), row.pop("camera_model", 0)))
    (tmp_path / "lenses.yaml").write_text("".join(f"{channel}: {MODELS[name]}\n" for channel in CAMERAS))
    lenses = ("--lenses", tmp_path / "lenses.yaml")
    out = converted(source, tmp_path / "out", drives / "truth.yaml", *lenses)
    assert tree(out / "samples") == tree(said / "samples")
    taken_for_pinholes = converted(source, tmp_path / "wrong", drives / "truth.yaml")
    assert tree(taken_for_pinholes / "samples" / "CAM_FRONT") != tree(said / "samples" / "CAM_FRONT")
    run = unidrive("convert", source, out, "--rig", drives / "truth.yaml", "--jobs", 0)
    assert run.code != 0  # the lenses are part of what a folder is: no run goes on with others
    run = unidrive("inspect-rig", source, *lenses, "--json")
    assert {camera["lens"] for camera in run.json()["cameras"]} == {name.split("-")[0]}
    run = unidrive("measure", source, "--rig", drives / "truth.yaml", *lenses, "--json")
    assert run.json()["pairs"]["mean"] == pytest.approx(measured_error(drives, name), abs=1e-12)


def test_both_kernels_and_two_processes_draw_the_same(drives: Path, tmp_path: Path) -> None:
    source, rig = drives / "made" / "opencv-5", drives / "truth.yaml"
    alone = converted(source, tmp_path / "alone", rig)
    assert tree(converted(source, tmp_path / "two", rig, "--jobs", 2) / "samples") == tree(alone / "samples")
    slow = pictures(converted(source, tmp_path / "slow", rig, "--kernel", "opencv"))
    for file, picture in pictures(alone).items():
        assert psnr_db(picture, slow[file]) > 36


@pytest.mark.parametrize("name", ["plain", "fisheye"])
def test_utm_coordinates_make_no_difference(drives: Path, tmp_path: Path, name: str) -> None:
    """A drive 600 km east and 5,000 km north: source pixels move by less than 0.02 px, pictures by a grey level."""
    here, rig = drives / "made" / name, load_rig(drives / "truth.yaml")
    there = Path(shutil.copytree(here, tmp_path / "there"))

    def move(row: Row) -> None:
        x, y, z = row["translation"]
        row["translation"] = [x + 600_000, y + 5_000_000, z]

    for table in ("ego_pose", "sample_annotation"):
        set_rows(there, table, move)
    points = np.random.default_rng(0).normal(size=(5000, 3)) * [20, 20, 3] + [0, 0, 1]
    plans = [make_plan(open_dataset(root), rig, Options()) for root in (here, there)]
    for units in zip(*(plan.units for plan in plans), strict=True):
        frames = [plan.frame(unit) for plan, unit in zip(plans, units, strict=True)]
        for one, other in zip(frames[0].sources, frames[1].sources, strict=True):
            (pixels, inside), (moved, _) = (
                s.lens.project(points @ s.cam_from_ego[:3, :3].T + s.cam_from_ego[:3, 3]) for s in (one, other)
            )
            assert inside.any()
            assert np.abs(pixels[inside] - moved[inside]).max() < 0.02
    far = pictures(converted(there, tmp_path / "out", drives / "truth.yaml"))
    near = pictures(converted(here, tmp_path / "near", drives / "truth.yaml"))
    for file, picture in far.items():
        assert np.abs(picture.astype(int) - near[file]).max() <= 2
