"""Every layout, made from one painted drive: converted, opened by nuscenes-devkit, with the drive's pictures."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests import layouts
from tests.datasets import SMALL_RIG, Row, Run, assert_consistent, paint, rows, unidrive
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import Plan, make_plan
from unidrive_cli.rig.yaml_file import load_rig
from unidrive_cli.tables import dataset as dataset_module
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.scanned import ScannedTable

Pictures = dict[tuple[str, int], bytes]

LAYOUTS: dict[str, tuple[Callable[[Path], Path], str, str]] = {
    "nuscenes": (layouts.nuscenes_test, "nuScenes", "v1.0-test"),
    "lyft": (layouts.lyft, "Lyft Level 5", "v1.0-trainval"),
    "t4": (layouts.t4, "T4", "v1.0-trainval"),
    "truckscenes": (layouts.truckscenes, "MAN TruckScenes", "v1.0-mini"),
    "carla": (layouts.carla, "CARLA generator", "v1.0-trainval"),
    "unidrive": (layouts.numbered, "UniDrive", "v1.0-trainval"),
}
"""By the name that `--layout` takes: what makes it, its title, and the version folder of the output."""
SAMPLES = 4


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("drive") / "drive", scenes=2, samples=2)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "small.yaml"
    path.write_text(SMALL_RIG)
    return path


@pytest.fixture(scope="module")
def truth(drive: Path, rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The painted drive as it is, converted."""
    return converted(drive, tmp_path_factory.mktemp("truth") / "out", rig)[0]


@pytest.fixture(scope="module")
def sources(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The drive in every layout."""
    folder = tmp_path_factory.mktemp("layouts")
    return {name: make(Path(shutil.copytree(drive, folder / name))) for name, (make, _, _) in LAYOUTS.items()}


@pytest.fixture(scope="module")
def outputs(
    sources: dict[str, Path], rig: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[Path, Run]]:
    """All of them converted, and what was said."""
    folder = tmp_path_factory.mktemp("outputs")
    return {name: converted(source, folder / name, rig) for name, source in sources.items()}


def converted(source: Path, out: Path, rig: Path, *options: object) -> tuple[Path, Run]:
    run = unidrive("convert", source, out, "--rig", rig, "--jobs", 0, *options)
    assert run.code == 0, run.stdout + run.stderr
    return out, run


def pictures_of(root: Path, version: str) -> Pictures:
    """The virtual pictures by channel and number of the sample in its table."""
    samples = {row["token"]: index for index, row in enumerate(rows(root, "sample", version))}
    cameras = {row["token"]: row["channel"] for row in rows(root, "sensor", version) if row["modality"] == "camera"}
    channels = {
        row["token"]: cameras[row["sensor_token"]]
        for row in rows(root, "calibrated_sensor", version)
        if row["sensor_token"] in cameras
    }
    return {
        (channels[row["calibrated_sensor_token"]], samples[row["sample_token"]]): (
            root / row["filename"]
        ).read_bytes()
        for row in rows(root, "sample_data", version)
        if row["calibrated_sensor_token"] in channels
    }


@pytest.mark.parametrize("name", LAYOUTS)
def test_is_found_out_and_said(name: str, outputs: dict[str, tuple[Path, Run]]) -> None:
    """Nothing is to be said of nuScenes' own."""
    _, title, _ = LAYOUTS[name]
    out, run = outputs[name]
    assert (f"layout: {title} (" in run.said) == (name != "nuscenes")
    assert json.loads((out / "unidrive.json").read_bytes())["plan"]["source"]["layout"] == name


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_output_is_standard_nuscenes(name: str, outputs: dict[str, tuple[Path, Run]]) -> None:
    """nuscenes-devkit opens it, all lists are whole, and no rule finds anything."""
    (out, _), (_, _, version) = outputs[name], LAYOUTS[name]
    nusc = assert_consistent(out, version)
    assert len(nusc.sample) == SAMPLES
    assert len(nusc.scene) == 2
    tops = {row["filename"].split("/")[0] for row in nusc.sample_data}
    assert tops == {"samples", "sweeps"}
    for row in nusc.sample_data:
        folder = "samples" if row["is_key_frame"] else "sweeps"
        assert row["filename"].startswith(f"{folder}/{row['channel']}/")
    found = unidrive("validate", out, "--json")
    assert found.json()["findings"] == []
    assert found.json()["opened_with_devkit"]


@pytest.mark.parametrize("name", ["nuscenes", "lyft", "carla"])
def test_the_pictures_are_those_of_the_drive(name: str, outputs: dict[str, tuple[Path, Run]], truth: Path) -> None:
    """Tokens, names and times are others; poses, cameras and pixels are not."""
    pictures = pictures_of(outputs[name][0], LAYOUTS[name][2])
    assert len(pictures) == 2 * SAMPLES
    assert pictures == pictures_of(truth, "v1.0-mini")


def test_t4_does_not_read_the_picture_that_is_not_valid(outputs: dict[str, tuple[Path, Run]], truth: Path) -> None:
    out, run = outputs["t4"]
    pictures, others = pictures_of(out, "v1.0-trainval"), pictures_of(truth, "v1.0-mini")
    assert {key for key, data in pictures.items() if data != others[key]} == {("CAM_FRONT", 0)}
    assert "1 pictures are marked is_valid: false and are not read." in run.stdout


def test_one_pose_for_all_sensors_is_no_motion(
    drive: Path, rig: Path, outputs: dict[str, tuple[Path, Run]], tmp_path: Path
) -> None:
    """UniDrive's poses say what --no-ego-motion assumes of the drive."""
    still, _ = converted(drive, tmp_path / "still", rig, "--no-ego-motion")
    assert pictures_of(outputs["unidrive"][0], "v1.0-trainval") == pictures_of(still, "v1.0-mini")


def test_utm_coordinates_give_the_same_pictures(drive: Path, rig: Path, sources: dict[str, Path]) -> None:
    """600 km east and 5000 km north: every source sees the scene within 0.02 px of where it saw it before."""
    here, there = (plan_of(root, rig) for root in (drive, sources["truckscenes"]))
    worst = 0.0
    grid = np.stack(np.meshgrid([-50.0, -5.0, 5.0, 50.0], [-40.0, 3.0, 40.0], [-1.5, 0.0, 8.0]), -1).reshape(-1, 3)
    for one, other in zip(here.units, there.units, strict=True):
        for source, moved in zip(here.frame(one).sources, there.frame(other).sources, strict=True):
            seen = [
                lens.project(grid @ pose[:3, :3].T + pose[:3, 3])[0]
                for lens, pose in ((source.lens, source.cam_from_ego), (moved.lens, moved.cam_from_ego))
            ]
            inside = (np.abs(seen[0]) < 200).all(axis=1)
            assert inside.any()
            worst = max(worst, float(np.abs(seen[0] - seen[1])[inside].max()))
    assert worst < 0.02


def plan_of(root: Path, rig: Path) -> Plan:
    return make_plan(open_dataset(root), load_rig(rig), Options())


def test_utm_coordinates_give_the_same_pixels(outputs: dict[str, tuple[Path, Run]], truth: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    moved, here = pictures_of(outputs["truckscenes"][0], "v1.0-mini"), pictures_of(truth, "v1.0-mini")
    for key, data in moved.items():
        one, other = (cv2.imdecode(np.frombuffer(raw, np.uint8), 1).astype(int) for raw in (data, here[key]))
        assert np.abs(one - other).max() <= 2


@pytest.mark.parametrize(
    ("name", "table", "field"),
    [
        ("t4", "instance", "instance_name"),
        ("t4", "log", "data_captured"),
        ("t4", "sample_annotation", "automatic_annotation"),
        ("t4", "calibrated_sensor", "camera_distortion"),
        ("t4", "sample_data", "info_filename"),
        ("truckscenes", "category", "index"),
    ],
)
def test_further_fields_stay(
    name: str, table: str, field: str, sources: dict[str, Path], outputs: dict[str, tuple[Path, Run]]
) -> None:
    version = {"t4": "annotation", "truckscenes": "v1.1-mini"}[name]
    source = {row["token"]: row[field] for row in rows(sources[name], table, version)}
    found = {row["token"]: row[field] for row in rows(outputs[name][0], table, LAYOUTS[name][2]) if field in row}
    assert found
    assert found.items() <= source.items()


@pytest.mark.parametrize(
    ("name", "version", "table"),
    [
        ("t4", "annotation", "vehicle_state"),
        ("truckscenes", "v1.1-mini", "ego_motion_cabin"),
        ("truckscenes", "v1.1-mini", "weather_annotation"),
        ("carla", "v1.14", "progress"),
    ],
)
def test_further_tables_go_along(
    name: str, version: str, table: str, sources: dict[str, Path], outputs: dict[str, tuple[Path, Run]]
) -> None:
    files = (sources[name] / version, outputs[name][0] / LAYOUTS[name][2])
    source, found = (json.loads((folder / f"{table}.json").read_text()) for folder in files)
    assert source
    assert found == source


def test_rows_of_pictures_that_are_gone_leave_t4s_tables(outputs: dict[str, tuple[Path, Run]]) -> None:
    assert rows(outputs["t4"][0], "object_ann", "v1.0-trainval") == []


def test_t4s_other_files_go_along(sources: dict[str, Path], outputs: dict[str, tuple[Path, Run]]) -> None:
    out = outputs["t4"][0]
    for name in ("status.json", "map/lanelet2_map.osm", "data/LIDAR_TOP_INFO/00002.json"):
        assert (out / name).read_bytes() == (sources["t4"] / name).read_bytes()


def test_t4s_log_gains_the_date_that_nuscenes_has(outputs: dict[str, tuple[Path, Run]]) -> None:
    (log,) = rows(outputs["t4"][0], "log", "v1.0-trainval")
    assert log["date_captured"] == log["data_captured"] == "2026-01-01"


def test_truckscenes_gains_a_log_and_a_map(outputs: dict[str, tuple[Path, Run]]) -> None:
    out, run = outputs["truckscenes"]
    (log,), (a_map,) = rows(out, "log"), rows(out, "map")
    assert {scene["log_token"] for scene in rows(out, "scene")} == {log["token"]} == set(a_map["log_tokens"])
    assert f"log_token is empty in 2 scenes, because there are no logs; {log['token']} is put in." in run.stdout
    assert "log.json is missing; 1 rows are assumed." in run.stdout


def test_carla_gains_its_map_picture(outputs: dict[str, tuple[Path, Run]]) -> None:
    out, run = outputs["carla"]
    (a_map,) = rows(out, "map", "v1.0-trainval")
    assert (out / a_map["filename"]).is_file()
    assert f"The map picture {a_map['filename']} is missing in the source; an empty one was written." in run.stdout
    assert "carla_nuscenes writes tenths of microseconds" in run.stdout


def test_carlas_doubled_times_give_no_doubled_names(outputs: dict[str, tuple[Path, Run]]) -> None:
    """Both scenes begin at zero and have one log: pictures of two scenes at one time keep apart."""
    out = outputs["carla"][0]
    data = rows(out, "sample_data", "v1.0-trainval")
    pictures = [row for row in data if row["fileformat"] == "jpg"]
    assert len({row["timestamp"] for row in pictures}) == SAMPLES // 2
    assert len({row["filename"] for row in pictures}) == 2 * SAMPLES


def test_lyfts_times_and_counts_stay(outputs: dict[str, tuple[Path, Run]]) -> None:
    out, run = outputs["lyft"]
    assert all(row["timestamp"] % 1 == 0.25 for row in rows(out, "sample_data", "v1.0-trainval"))
    assert {row["num_lidar_pts"] for row in rows(out, "sample_annotation", "v1.0-trainval")} == {-1}
    assert {row["nbr_samples"] for row in rows(out, "scene", "v1.0-trainval")} == {2}
    for sentence in ("num_lidar_pts is -1", "Timestamps are fractions", "list links point outside"):
        assert sentence in run.stdout


def test_lyfts_inner_folder_opens_too(sources: dict[str, Path]) -> None:
    inner = open_dataset(sources["lyft"] / "v1.01-train")
    assert inner.folder == open_dataset(sources["lyft"]).folder == sources["lyft"] / "v1.01-train" / "v1.01-train"


def test_t4_can_be_kept(sources: dict[str, Path], rig: Path, tmp_path: Path) -> None:
    """Folders, names and fields are T4's; nuscenes-devkit and the rules take that too."""
    out, _ = converted(sources["t4"], tmp_path / "out", rig, "--keep-layout")
    assert_consistent(out, "annotation")
    assert {path.name for path in out.iterdir() if path.is_dir()} == {"annotation", "data", "map", "masks"}
    assert (out / "data" / "CAM_BACK" / "00003.jpg").is_file()
    assert (out / "masks" / "CAM_BACK" / "00003.png").is_file()
    assert all("camera_distortion" in row for row in rows(out, "calibrated_sensor", "annotation"))
    assert "date_captured" not in rows(out, "log", "annotation")[0]
    lidar = [row for row in rows(out, "sample_data", "annotation") if row["fileformat"] == "pcd.bin"]
    assert all(row["filename"].startswith("data/LIDAR_TOP/") for row in lidar)
    assert open_dataset(out).layout.title == "T4"
    assert unidrive("validate", out, "--json").json()["findings"] == []


def test_only_t4_can_be_kept(sources: dict[str, Path], rig: Path, tmp_path: Path) -> None:
    run = unidrive("convert", sources["carla"], tmp_path / "out", "--rig", rig, "--keep-layout")
    assert run.code == 2
    assert "is in the layout of CARLA generator; T4 alone can be kept" in run.said
    assert not (tmp_path / "out").exists()


def test_the_version_folder_can_be_chosen(drive: Path, rig: Path, tmp_path: Path) -> None:
    out, _ = converted(drive, tmp_path / "out", rig, "--output-version", "v1.0-trainval")
    assert_consistent(out, "v1.0-trainval")
    again = unidrive("convert", drive, out, "--rig", rig, "--jobs", 0, "--output-version", "v1.0-trainval")
    assert again.code == 0
    assert "already holds this conversion, complete" in again.stdout


@pytest.mark.parametrize("name", ["../x", "a/b", "samples", "masks", ".hidden"])
def test_a_version_folder_that_cannot_be_is_refused(name: str, drive: Path, rig: Path, tmp_path: Path) -> None:
    run = unidrive("convert", drive, tmp_path / "out", "--rig", rig, "--output-version", name)
    assert run.code == 2
    assert f"--output-version {name}: that cannot be a version folder." in run.said


def test_parts_know_the_layout_too(sources: dict[str, Path], rig: Path, tmp_path: Path) -> None:
    """A test split without annotations, in two parts, finalised."""
    arguments = (sources["nuscenes"], tmp_path / "out", "--rig", rig, "--layout", "nuscenes")
    for part in ("1/2", "2/2"):
        assert unidrive("convert", *arguments, "--jobs", 0, "--part", part).code == 0
    run = unidrive("finalise", *arguments)
    assert run.code == 0, run.stderr
    assert "layout: nuScenes (" in run.said
    assert "as told" in run.said
    nusc = assert_consistent(tmp_path / "out", "v1.0-test")
    assert nusc.sample_annotation == []
    assert rows(tmp_path / "out", "image_annotations", "v1.0-test") == []


def test_a_test_split_is_inspected_and_has_nothing_to_measure(sources: dict[str, Path], rig: Path) -> None:
    inspected = unidrive("inspect-rig", sources["nuscenes"], "--json")
    assert inspected.code == 0, inspected.stderr
    assert len(inspected.json()["cameras"]) == 6
    measured = unidrive("measure", sources["nuscenes"], "--rig", rig, "--jobs", 0, "--json")
    assert measured.code == 3
    assert "the 4 chosen samples have no annotated boxes" in measured.said
    assert unidrive("validate", sources["nuscenes"], "--json").json()["findings"] == []


@pytest.mark.parametrize(
    ("name", "rules"),
    [
        ("lyft", {"REF-2", "REC-1", "REC-2"}),  # an extract
        ("t4", set()),
        ("truckscenes", {"STR-3"}),
        ("carla", {"FILE-2"}),
        ("unidrive", set()),
    ],
)
def test_the_other_commands_read_it_too(name: str, rules: set[str], sources: dict[str, Path], rig: Path) -> None:
    """The painted boxes are measured, the cameras are there, and what nuScenes has and the layout lacks is found."""
    title = LAYOUTS[name][1]
    inspected = unidrive("inspect-rig", sources[name], "--json")
    assert f"layout: {title} (" in inspected.said
    assert len(inspected.json()["cameras"]) == 6
    measured = unidrive("measure", sources[name], "--rig", rig, "--jobs", 0, "--json")
    assert f"layout: {title} (" in measured.said
    assert measured.json()["pairs"]["count"] > 100
    found = unidrive("validate", sources[name], "--json")
    assert f"layout: {title} (" in found.said
    assert {rule for rule, count in found.json()["counts"].items() if count} == rules


@pytest.mark.parametrize("name", LAYOUTS)
def test_large_tables_are_read_the_same(
    name: str, sources: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    read = open_dataset(sources[name])
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    scanned = open_dataset(sources[name])
    assert isinstance(scanned.sample_data, ScannedTable) == (name != "t4")
    assert scanned.notes == read.notes
    assert [row.sample_token for row in scanned.sample_data.rows] == [
        row.sample_token for row in read.sample_data.rows
    ]


def test_a_file_beside_the_tables_that_leads_out_is_refused(
    sources: dict[str, Path], rig: Path, tmp_path: Path
) -> None:
    source = Path(shutil.copytree(sources["t4"], tmp_path / "t4"))
    (source / "status.json").unlink()
    (source / "status.json").symlink_to(rig)
    run = unidrive("convert", source, tmp_path / "out", "--rig", rig, "--dry-run")
    assert run.code == 3
    assert "t4/status.json" in run.said


def test_a_layout_can_be_forced(sources: dict[str, Path], rig: Path, tmp_path: Path) -> None:
    """UniDrive's folders are nuScenes', whose layout reads it too."""
    run = unidrive(
        *("convert", sources["unidrive"], tmp_path / "out", "--rig", rig, "--dry-run"),
        env={"UNIDRIVE_LAYOUT": "nuscenes"},
    )
    assert run.code == 0, run.stderr
    assert "layout: nuScenes (" in run.said
    assert "as told" in run.said
    assert "one ego pose" not in run.stdout


@pytest.mark.parametrize("command", ["convert", "validate", "inspect-rig", "measure"])
def test_an_unknown_layout_is_a_sentence(command: str, drive: Path, rig: Path, tmp_path: Path) -> None:
    more = {"convert": (tmp_path / "out", "--rig", rig), "measure": ("--rig", rig)}.get(command, ())
    run = unidrive(command, drive, *more, "--layout", "truckscene")
    assert run.code == 2
    assert "--layout truckscene: there is no such layout. Did you mean truckscenes?" in run.said


def test_two_files_of_one_name_are_refused(drive: Path, rig: Path, tmp_path: Path) -> None:
    """T4 may keep clouds of one name in two folders; nuScenes has one folder per channel."""
    source = layouts.t4(Path(shutil.copytree(drive, tmp_path / "t4")))
    path = source / "annotation" / "sample_data.json"
    data: list[Row] = json.loads(path.read_text())
    first, second, *_ = (row for row in data if row["fileformat"] == "pcd.bin" and row["is_key_frame"])
    second["filename"] = "data/LIDAR_TOP/again/" + Path(first["filename"]).name
    (source / "data" / "LIDAR_TOP" / "again").mkdir()
    shutil.copy(source / first["filename"], source / second["filename"])
    path.write_text(json.dumps(data))
    run = unidrive("convert", source, tmp_path / "out", "--rig", rig, "--dry-run")
    assert run.code == 3
    assert f"the files {first['filename']} and {second['filename']} would both become samples/LIDAR_TOP/" in run.said


def test_all_of_them_merge(outputs: dict[str, tuple[Path, Run]], tmp_path: Path) -> None:
    """Of one painted drive, with tokens and names in common; its scenes are there once per layout."""
    names = ("lyft", "t4", "truckscenes", "carla", "unidrive")
    out = tmp_path / "out"
    run = unidrive("merge", *(outputs[name][0] for name in names), "--out", out, "--version", "v1.0-trainval")
    assert run.code == 0, run.stderr
    checked = unidrive("validate", out)
    assert checked.code == 0, checked.stdout
    for table in ("sample", "sample_annotation", "image_annotations"):
        counts = [len(rows(outputs[name][0], table, LAYOUTS[name][2])) for name in names]
        assert len(rows(out, table, "v1.0-trainval")) == sum(counts) > 0
