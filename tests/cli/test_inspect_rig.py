"""`unidrive inspect-rig`: shipped rigs, rig files and dataset folders, as text and as JSON."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.datasets import SMALL_RIG, VERSION, Bench, paint, rows, tree, unidrive
from tests.painted import nuscenes_like_cameras
from unidrive_cli.rig.gallery import gallery_names


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", samples=1)


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(SMALL_RIG)
    return path


def inspect(*arguments: object) -> dict[str, Any]:
    run = unidrive("inspect-rig", *arguments, "--json")
    assert run.code == 0, run.stderr
    assert run.stdout.count("\n") == 1
    document: dict[str, Any] = run.json()
    return document


def field_deg(focal_px: float, centre_px: float, side_px: int) -> float:
    """From border to border; pixel centres are whole numbers."""
    return float(
        np.degrees(np.arctan((centre_px + 0.5) / focal_px) + np.arctan((side_px - 0.5 - centre_px) / focal_px))
    )


# --- shipped rigs -----------------------------------------------------------------------------------------------


def test_a_shipped_rig() -> None:
    """6x60: six times 60 degrees are the whole circle, and overlap nowhere."""
    facts = inspect("6x60")
    assert facts["name"] == "6x60"
    yaws = {camera["channel"]: camera["yaw_deg"] for camera in facts["cameras"]}
    assert yaws == {
        "CAM_FRONT": 0,
        "CAM_FRONT_LEFT": 60,
        "CAM_FRONT_RIGHT": -60,
        "CAM_BACK": 180,
        "CAM_BACK_LEFT": 120,
        "CAM_BACK_RIGHT": -120,
    }
    for camera in facts["cameras"]:
        assert (camera["width_px"], camera["height_px"], camera["hfov_deg"]) == (1600, 900, 60)
        assert camera["vfov_deg"] == pytest.approx(
            2 * np.degrees(np.arctan(np.tan(np.radians(30)) * 900 / 1600)), abs=1e-3
        )
    assert (facts["covered_deg"], facts["overlaps_deg"], facts["blind_arcs_deg"]) == (360, [], [])
    assert facts["notes"] == []


def test_a_shipped_rig_as_text() -> None:
    run = unidrive("inspect-rig", "8x50")
    assert run.code == 0
    assert run.stderr == ""
    header, *lines = run.stdout.splitlines()[1:10]
    assert " ".join(header.split()) == "channel size px HFOV VFOV yaw pitch roll x m y m z m"
    assert [line.split()[0] for line in lines] == [camera["channel"] for camera in inspect("8x50")["cameras"]]
    assert all("1600x900" in line for line in lines)
    assert "sees 360 of 360 degrees" in run.stdout
    assert run.stdout.count("overlap  ") == 8  # each neighbour: 50 degrees every 45
    assert run.stdout.count(": 5 degrees") == 8
    assert "blind" not in run.stdout


@pytest.mark.parametrize("name", gallery_names())
def test_every_shipped_rig_can_be_inspected(name: str) -> None:
    facts = inspect(name)
    assert facts["cameras"]
    seen, blind = facts["covered_deg"], sum(end - start for start, end in facts["blind_arcs_deg"])
    assert seen + blind == pytest.approx(360, abs=1)


# --- rig files --------------------------------------------------------------------------------------------------


def test_a_rig_file(rig_file: Path) -> None:
    """80 degrees ahead and 80 behind: 160 are seen, 100 on either side are not."""
    facts = inspect(rig_file)
    front, back = facts["cameras"]
    assert front == {
        "channel": "CAM_FRONT",
        "width_px": 64,
        "height_px": 36,
        "hfov_deg": 80.0,
        "vfov_deg": pytest.approx(2 * np.degrees(np.arctan(np.tan(np.radians(40)) * 36 / 64)), abs=1e-3),
        "yaw_deg": 0.0,
        "pitch_deg": 0.0,
        "roll_deg": 0.0,
        "position_m": [1.5, 0.0, 1.6],
        "lens": "pinhole",
        "blank_share": 0.0,
    }
    assert (back["channel"], back["yaw_deg"], back["position_m"]) == ("CAM_BACK", 180.0, [0.0, 0.0, 1.6])
    assert facts["covered_deg"] == 160
    assert facts["overlaps_deg"] == []
    assert sorted(map(tuple, facts["blind_arcs_deg"])) == [(-140, -40), (40, 140)]
    assert (facts["depth_limit_m"], facts["ground_height_m"]) == (None, None)
    assert len(facts["digest"]) == 64


def test_a_rig_file_as_text(rig_file: Path) -> None:
    rig_file.write_text("description: a test\ndepth_limit: 33.5\nground_height: 0.25\n" + SMALL_RIG)
    run = unidrive("inspect-rig", rig_file)
    assert run.code == 0
    lines = run.stdout.splitlines()
    assert lines[0] == "small: a test"
    assert " ".join(lines[2].split()) == "CAM_FRONT 64x36 80.0 50.5 0.0 0.0 0.0 1.50 0.00 1.60"
    assert " ".join(lines[3].split()) == "CAM_BACK 64x36 80.0 50.5 180.0 0.0 0.0 0.00 0.00 1.60"
    for words in ("sees 160 of 360 degrees", "from 40 to 140", "depth limit 33.5 m", "ground height 0.25 m"):
        assert words in run.stdout


def test_angles_and_origin_of_a_rig_file(rig_file: Path) -> None:
    """Left is positive yaw, up is positive pitch; the origin moves every camera ahead."""
    rig_file.write_text(
        "name: turned\norigin: vehicle_centre\nrear_axle_to_centre: 1.3\ncameras:\n"
        "  CAM: {width: 640, height: 480, hfov: 60, position: [0.2, 0.5, 1.5], yaw: 30, pitch: 10, roll: -5}\n"
    )
    (camera,) = inspect(rig_file)["cameras"]
    assert camera["position_m"] == [1.5, 0.5, 1.5]
    angles = (camera["yaw_deg"], camera["pitch_deg"], camera["roll_deg"])
    assert angles == pytest.approx((30, 10, -5), abs=1e-3)


def test_a_rig_with_distortion(rig_file: Path) -> None:
    """The lens is a column only where there is one to speak of."""
    assert "lens" not in unidrive("inspect-rig", rig_file).stdout
    lens = ", distortion: {model: opencv, coefficients: [-0.45, 0, 0, 0]}}"
    rig_file.write_text(SMALL_RIG.replace("yaw: 180}", "yaw: 180" + lens))
    lines = unidrive("inspect-rig", rig_file).stdout.splitlines()
    assert lines[1].split()[-1] == "lens"
    assert (lines[2].split()[-1], lines[3].split()[-1]) == ("pinhole", "opencv")
    front, back = inspect(rig_file)["cameras"]
    assert (front["lens"], front["blank_share"], back["lens"]) == ("pinhole", 0.0, "opencv")
    assert f"CAM_BACK: {100 * back['blank_share']:.1f} % of the picture lies beyond the field" in lines[4]


def test_the_name_is_not_part_of_the_digest_but_a_camera_is(rig_file: Path) -> None:
    first = inspect(rig_file)["digest"]
    rig_file.write_text(SMALL_RIG.replace("name: small", "name: other"))
    assert inspect(rig_file)["digest"] == first
    rig_file.write_text(SMALL_RIG.replace("hfov: 80", "hfov: 81", 1))
    assert inspect(rig_file)["digest"] != first


# --- datasets ---------------------------------------------------------------------------------------------------


def test_a_painted_dataset(painted: Path) -> None:
    before = tree(painted)
    facts = inspect(painted)
    expected = nuscenes_like_cameras(0.05)
    found = {camera["channel"]: camera for camera in facts["cameras"]}
    assert set(found) == {camera.channel for camera in expected}
    for camera in expected:
        facts_of = found[camera.channel]
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsic
        assert (facts_of["width_px"], facts_of["height_px"]) == (80, 45)
        assert facts_of["hfov_deg"] == pytest.approx(field_deg(fx, cx, 80), abs=2e-3)
        assert facts_of["vfov_deg"] == pytest.approx(field_deg(fy, cy, 45), abs=2e-3)
        assert facts_of["position_m"] == pytest.approx(camera.ego_from_cam[:3, 3], abs=1e-4)
        ahead = camera.ego_from_cam[:3, 2]
        yaw = np.degrees(np.arctan2(ahead[1], ahead[0]))
        assert (facts_of["yaw_deg"] - yaw + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)
        assert (facts_of["pitch_deg"], facts_of["roll_deg"]) == pytest.approx((0, 0), abs=1e-3)
    assert facts["covered_deg"] == 360
    assert facts["name"] == painted.name
    assert tree(painted) == before


def test_a_real_keyframe(shared_data: Path) -> None:
    root = shared_data / "nuscenes-onekeyframe"
    found = {camera["channel"]: camera for camera in inspect(root)["cameras"]}
    sensors = {row["token"]: row["channel"] for row in rows(root, "sensor") if row["modality"] == "camera"}
    assert sorted(found) == sorted(sensors.values())
    for row in rows(root, "calibrated_sensor"):
        if row["sensor_token"] not in sensors:
            continue
        camera = found[sensors[row["sensor_token"]]]
        (fx, _, cx), (_, fy, cy), _ = row["camera_intrinsic"]
        assert (camera["width_px"], camera["height_px"]) == (1600, 900)
        assert camera["hfov_deg"] == pytest.approx(field_deg(fx, cx, 1600), abs=1e-3)
        assert camera["vfov_deg"] == pytest.approx(field_deg(fy, cy, 900), abs=1e-3)
        assert camera["position_m"] == pytest.approx(row["translation"], abs=1e-4)
    assert inspect(root)["covered_deg"] == 360


def test_a_real_keyframe_as_text(shared_data: Path) -> None:
    run = unidrive("inspect-rig", shared_data / "nuscenes-onekeyframe")
    assert run.code == 0
    assert "nuscenes-onekeyframe: the calibrated cameras of v1.0-mini" in run.stdout
    assert run.stdout.count("1600x900") == 6
    assert "sees 360 of 360 degrees" in run.stdout


def test_two_rigs_in_one_dataset(shared_data: Path) -> None:
    """The more frequent one, and it is said; a scene picks the other one."""
    root = shared_data / "dgp-tri-2scenes"
    facts = inspect(root)
    assert [camera["channel"] for camera in facts["cameras"]] == [f"CAMERA_0{n}" for n in (1, 5, 6, 7, 8, 9)]
    (note,) = facts["notes"]
    assert "2 different calibrations" in note
    assert "3 of 5 samples" in note
    assert note in unidrive("inspect-rig", root).stdout
    other = inspect(root, "--scene", "scene_01")
    assert [camera["channel"] for camera in other["cameras"]] == ["CAMERA_01", "CAMERA_05", "CAMERA_06"]
    assert other["notes"] == []


def test_tables_alone_are_enough(shared_data: Path) -> None:
    """No picture is opened: Lyft's genuine tables, which came without."""
    facts = inspect(shared_data / "tables-as-found" / "lyft-v1.01-train-tables")
    assert len(facts["cameras"]) == 7
    zoomed = next(camera for camera in facts["cameras"] if camera["channel"] == "CAM_FRONT_ZOOMED")
    assert zoomed["hfov_deg"] == pytest.approx(27.2, abs=0.1)


def test_a_converted_dataset_has_the_virtual_rig(painted: Path, rig_file: Path, tmp_path: Path) -> None:
    assert unidrive("convert", painted, tmp_path / "out", "--rig", rig_file, "--jobs", 0).code == 0
    there, back = inspect(rig_file), inspect(tmp_path / "out")
    assert back["cameras"] == there["cameras"]


def test_pictures_without_a_size_in_the_tables_take_the_files(painted: Path, tmp_path: Path) -> None:
    """Formats in the wild: a row without a size takes the file's."""
    root = Path(shutil.copytree(painted, tmp_path / "drive"))
    stripped = [{k: v for k, v in row.items() if k not in ("width", "height")} for row in rows(root, "sample_data")]
    (root / VERSION / "sample_data.json").write_text(json.dumps(stripped))
    assert inspect(root)["cameras"] == inspect(painted)["cameras"]


# --- errors -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argument", "code", "words"),
    [
        ("6x61", 2, ("6x61", "Did you mean 6x60?", "Shipped rigs: 4x95")),
        ("nowhere.yaml", 2, ("nowhere.yaml", "cannot be read")),
        ("nowhere/", 2, ("nowhere",)),
        ("a" * 300, 2, ("aaaa",)),
    ],
    ids=["name", "file", "folder", "long"],
)
def test_what_is_no_rig(argument: str, code: int, words: tuple[str, ...]) -> None:
    for options in ((), ("--json",)):
        run = unidrive("inspect-rig", argument, *options)
        assert (run.code, run.stdout) == (code, "")
        assert [word for word in words if word not in run.said] == []


def test_a_mistake_in_a_rig_file(rig_file: Path) -> None:
    rig_file.write_text(SMALL_RIG.replace("width: 64", "widht: 64", 1))
    run = unidrive("inspect-rig", rig_file)
    assert (run.code, run.stdout) == (2, "")
    for word in ("rig.yaml", "camera CAM_FRONT", "line 3", "widht is not a known key. Did you mean width?"):
        assert word in run.said


def test_a_broken_dataset(painted: Path, tmp_path: Path) -> None:
    run = unidrive("inspect-rig", tmp_path)
    assert (run.code, run.stdout) == (3, "")
    assert "holds no version folder" in run.said
    assert unidrive("inspect-rig", painted / VERSION).stdout == unidrive("inspect-rig", painted).stdout
    run = unidrive("inspect-rig", painted, "--scene", "scene-0016")
    assert run.code == 2
    assert "Did you mean scene-0061?" in run.said
    root = Path(shutil.copytree(painted, tmp_path / "drive"))
    (root / VERSION / "sample_data.json").write_text("[]")
    run = unidrive("inspect-rig", root)
    assert run.code == 3
    assert "no camera key frames" in run.said


def test_a_lens_for_a_camera_that_is_not_there(bench: Bench) -> None:
    lenses = bench.folder / "lenses.yaml"
    lenses.write_text("CAM_FRNT: {model: fisheye, coefficients: [0.1, 0, 0, 0]}\n")
    run = unidrive("inspect-rig", bench.src, "--lenses", lenses)
    assert run.code == 2
    assert "Did you mean CAM_FRONT?" in run.stderr


@pytest.mark.parametrize("options", [("--depth-limit", "1e9"), ("--depth-limit", -5), ("--ground-height", 2000)])
def test_what_a_rig_is_compared_under_must_be_lengths(options: tuple[str, object]) -> None:
    run = unidrive("inspect-rig", "roof-6x70", "--against", "6x60", *options)
    assert run.code == 2
    assert f"{options[0]} must be a" in run.stderr
