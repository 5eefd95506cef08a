"""Every rule: a dataset that breaks it in one place is reported with its ID, and with no other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.datasets import Bench, Row, paint, tree
from unidrive_cli.check.rules import PAGE, PAGE_COMMAND, RULES, rules_page
from unidrive_cli.check.validation import KEPT_FINDINGS, Validation, find_subject, validate
from unidrive_cli.tables import dataset as dataset_module
from unidrive_cli.tables.scanned import ScannedTable
from unidrive_cli.warp.pictures import picture_size

Change = Callable[[list[Row]], object]
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", scenes=2, samples=3)


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    return Bench(tmp_path, painted)


def validated(root: Path, jobs: int = 1) -> Validation:
    """What the rules find; the dataset must stay as it was."""
    before = tree(root)
    found = validate(find_subject(root, None, picture_size, jobs))
    assert tree(root) == before
    return found


def broken(found: Validation) -> set[str]:
    return {rule for rule, count in found.counts.items() if count}


def put(table: str, change: Callable[[Row], object], index: int = 0) -> Callable[[Bench], object]:
    """Changes one row of a table."""
    return lambda bench: bench.edit(table, lambda rows: change(rows[index]))


def rows_put(table: str, change: Change) -> Callable[[Bench], object]:
    return lambda bench: bench.edit(table, change)


def sets(**fields: Any) -> Callable[[Row], object]:
    return lambda row: row.update(fields)


def camera_row(rows: list[Row]) -> Row:
    return next(row for row in rows if "/CAM_FRONT/" in row["filename"])


def cross_two_instances(rows: list[Row]) -> None:
    """The second halves of two tracks change places."""
    firsts = [row for row in rows if not row["prev"] and row["next"]]
    by_token = {row["token"]: row for row in rows}
    one = firsts[0]
    other = next(row for row in firsts if row["sample_token"] == one["sample_token"] and row is not one)
    one["next"], other["next"] = other["next"], one["next"]
    for row in (one, other):
        by_token[row["next"]]["prev"] = row["token"]


def cut_a_list(rows: list[Row]) -> None:
    second = next(row for row in rows if row["prev"])
    first = next(row for row in rows if row["token"] == second["prev"])
    second["prev"], first["next"] = "", ""


def intrinsic(row: int, column: int, value: float) -> Change:
    """Changes one number of a camera's matrix."""

    def change(rows: list[Row]) -> None:
        camera = next(calibration for calibration in rows if calibration["camera_intrinsic"])
        camera["camera_intrinsic"][row][column] = value

    return change


def distortion(*values: float, **fields: Any) -> Callable[[Bench], object]:
    """Gives a camera lens distortion."""

    def change(rows: list[Row]) -> None:
        camera = next(calibration for calibration in rows if calibration["camera_intrinsic"])
        camera.update(camera_distortion=list(values), **fields)

    return rows_put("calibrated_sensor", change)


def no_intrinsic(rows: list[Row]) -> None:
    next(row for row in rows if row["camera_intrinsic"])["camera_intrinsic"] = []


def matrix_for_a_lidar(rows: list[Row]) -> None:
    """A lidar gets a camera's matrix."""
    camera = next(row for row in rows if row["camera_intrinsic"])
    lidar = next(row for row in rows if not row["camera_intrinsic"])
    lidar["camera_intrinsic"] = camera["camera_intrinsic"]


def another_key_frame(rows: list[Row]) -> None:
    """One more picture at the end of a list, of the same sample."""
    last = next(row for row in rows if "/CAM_FRONT/" in row["filename"] and not row["next"])
    last["next"] = "again"
    again = {"token": "again", "prev": last["token"], "next": "", "timestamp": last["timestamp"] + 1000}
    rows.append({**last, **again})


def second_has_firsts(field: str) -> Change:
    return lambda rows: rows[1].update({field: rows[0][field]})


def sonar(rows: list[Row]) -> None:
    next(row for row in rows if row["modality"] == "lidar")["modality"] = "sonar"


def other_size(bench: Bench) -> None:
    cv2.imwrite(str(bench.picture()), np.zeros((10, 20, 3), np.uint8))


def link_out(bench: Bench) -> None:
    picture = bench.picture()
    outside = bench.folder / "outside.jpg"
    picture.rename(outside)
    picture.symlink_to(outside)


BREAKS: list[tuple[str, str, Callable[[Bench], object]]] = [
    ("STR-1", "no samples", lambda bench: bench.table("sample").unlink()),
    ("STR-2", "not JSON", lambda bench: bench.table("log").write_text("[{")),
    ("STR-2", "a field is missing", rows_put("sample", lambda rows: rows[1].pop("timestamp"))),
    ("STR-2", "extra table not JSON", lambda bench: bench.table("more").write_text("{")),
    ("STR-3", "no visibility", lambda bench: bench.table("visibility").unlink()),
    ("STR-4", "marker", lambda bench: (bench.src / "UNFINISHED.txt").write_text("")),
    ("STR-5", "token twice", rows_put("log", lambda rows: rows.append(dict(rows[0])))),
    ("STR-6", "no log_tokens", rows_put("map", lambda rows: rows.append({"token": "more", "filename": ""}))),
    ("STR-7", "no description", put("scene", lambda row: row.pop("description"))),
    ("STR-7", "no count of points", put("sample_annotation", lambda row: row.pop("num_radar_pts"))),
    ("REF-1", "visibility", put("sample_annotation", sets(visibility_token="9"))),
    ("REF-1", "attribute", put("sample_annotation", sets(attribute_tokens=["nowhere"]))),
    ("REF-2", "prev", put("sample", sets(prev="before"))),
    ("REF-2", "last annotation", put("instance", sets(last_annotation_token="nowhere"))),
    ("REF-3", "log without map", put("map", sets(log_tokens=[]))),
    ("LINK-1", "next is empty", put("sample", sets(next=""))),
    ("LINK-1", "prev is empty", put("sample", sets(prev=""), 1)),
    ("LINK-1", "annotation", put("sample_annotation", sets(next=""))),
    ("LINK-2", "two tracks", rows_put("sample_annotation", cross_two_instances)),
    ("LINK-3", "sweeps", rows_put("sample_data", cut_a_list)),
    ("TIME-1", "sample_data", rows_put("sample_data", lambda rows: camera_row(rows).update(timestamp=9e15))),
    ("REC-1", "count", put("scene", sets(nbr_samples=4))),
    ("REC-2", "count", put("instance", sets(nbr_annotations=99))),
    ("REC-3", "last is first", put("scene", lambda row: row.update(last_sample_token=row["first_sample_token"]))),
    ("REC-3", "another scene's", rows_put("scene", second_has_firsts("first_sample_token"))),
    ("REC-4", "empty", put("instance", sets(first_annotation_token=""))),
    ("REC-5", "scene name", rows_put("scene", second_has_firsts("name"))),
    ("REC-6", "channel", rows_put("sensor", second_has_firsts("channel"))),
    ("REC-7", "modality", rows_put("sensor", sonar)),
    ("REC-8", "unknown scene", put("scene", sets(name="scene-of-mine"))),
    ("KEY-1", "one more", rows_put("sample_data", another_key_frame)),
    ("KEY-2", "not a key frame", rows_put("sample_data", lambda rows: camera_row(rows).update(is_key_frame=False))),
    ("POSE-1", "ego", put("ego_pose", sets(rotation=[0, 0, 0, 0]))),
    ("POSE-2", "box", put("sample_annotation", sets(translation=[1e12, 0.0, 0.0]))),
    (
        "POSE-3",
        "calibration",
        put("calibrated_sensor", lambda row: row.update(rotation=[2 * x for x in row["rotation"]])),
    ),
    ("BOX-1", "flat", put("sample_annotation", sets(size=[1.0, 0.0, 1.0]))),
    ("CAM-1", "skew", rows_put("calibrated_sensor", intrinsic(0, 1, 3.0))),
    ("CAM-1", "empty", rows_put("calibrated_sensor", no_intrinsic)),
    ("CAM-1", "centre", rows_put("calibrated_sensor", intrinsic(0, 2, 800.0))),
    ("CAM-1", "field", rows_put("calibrated_sensor", intrinsic(0, 0, 0.5))),
    ("CAM-2", "lidar", rows_put("calibrated_sensor", matrix_for_a_lidar)),
    ("CAM-3", "three numbers", distortion(0.1, 0, 0)),
    ("CAM-3", "folds back", distortion(-50.0, 0, 0, 0)),
    ("CAM-3", "unknown model", distortion(0.1, 0, 0, 0, camera_model="omni")),
    ("FILE-1", "..", rows_put("sample_data", lambda rows: camera_row(rows).update(filename="../x.jpg"))),
    ("FILE-1", "absolute", rows_put("map", lambda rows: rows[0].update(filename="/etc/hostname"))),
    ("FILE-1", "link", link_out),
    ("FILE-2", "picture", lambda bench: bench.picture().unlink()),
    ("FILE-2", "empty", lambda bench: bench.picture().write_bytes(b"")),
    ("FILE-2", "map", lambda bench: next((bench.src / "maps").glob("*.png")).unlink()),
    ("PIC-1", "size", other_size),
    ("PIC-1", "no picture", lambda bench: bench.picture().write_text("hello")),
    ("PIC-2", "no size", rows_put("sample_data", lambda rows: camera_row(rows).update(width=None))),
    ("DEV-1", "lidarseg without its folder", lambda bench: bench.table("lidarseg").write_text("[]")),
]


@pytest.mark.parametrize(
    ("rule", "break_it"),
    [(rule, change) for rule, _, change in BREAKS],
    ids=[f"{rule} {name}" for rule, name, _ in BREAKS],
)
def test_one_broken_place_is_one_rule(bench: Bench, rule: str, break_it: Callable[[Bench], object]) -> None:
    break_it(bench)
    found = validated(bench.src)
    assert broken(found) == {rule}, [f"{f.rule} {f.where}: {f.what}" for f in found.findings]
    assert {finding.severity for finding in found.findings} == {next(r.severity for r in RULES if r.id == rule)}


def test_a_clean_dataset(painted: Path) -> None:
    found = validated(painted, jobs=3)
    assert found.findings == []
    assert found.not_checked == []
    assert found.opened_with_devkit
    assert list(found.counts) == [rule.id for rule in RULES]


@pytest.mark.parametrize("model", [None, "opencv", "fisheye"])
def test_a_lens_is_no_finding(bench: Bench, model: str | None) -> None:
    distortion(0.05, -0.01, 0.002, -0.0003, camera_model=model)(bench)
    assert broken(validated(bench.src)) == set()


def test_large_tables_give_the_same_findings(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read row by row, and scanned."""
    bench.edit("sample_data", cut_a_list)
    bench.edit("sample_data", lambda rows: camera_row(rows).update(filename="../x.jpg", width=None))
    bench.edit("sample_annotation", cross_two_instances)
    bench.edit("sample_annotation", lambda rows: rows[3].update(size=[0.0, 1.0, 1.0], rotation=[3.0, 0.0, 0.0, 0.0]))
    bench.edit("ego_pose", lambda rows: rows[2].update(translation=[0.0, 1e11, 0.0]))
    read = validated(bench.src)
    assert broken(read) == {"LINK-2", "LINK-3", "BOX-1", "POSE-2", "POSE-3", "FILE-1", "PIC-2"}
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    scanned = validated(bench.src)
    assert isinstance(find_subject(bench.src, None, picture_size).dataset.sample_data, ScannedTable)
    assert (scanned.findings, scanned.counts) == (read.findings, read.counts)


def test_rows_that_break_when_they_are_used(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A large table's rows are decoded late; what is wrong with one is a finding all the same."""
    bench.edit("sample_annotation", lambda rows: rows[5].update(num_lidar_pts="many", size=[0.0, 1.0, 1.0]))
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    found = validated(bench.src)
    assert broken(found) == {"STR-2"}


def test_several_broken_tables_are_all_reported(bench: Bench) -> None:
    bench.edit("sample", lambda rows: rows[1].pop("timestamp"))
    bench.table("ego_pose").write_text("{}")
    bench.table("instance").write_bytes(b"\xff")
    found = validated(bench.src)
    assert [Path(finding.where.split(",")[0]).stem for finding in found.findings] == [
        "ego_pose",
        "instance",
        "sample",
    ]
    assert not found.opened_with_devkit
    assert "REF-1" in found.not_checked


def test_findings_are_capped_and_counted(bench: Bench) -> None:
    def many(rows: list[Row]) -> None:
        rows.extend({**rows[0], "token": f"log-{number}"} for number in range(KEPT_FINDINGS + 7))

    bench.edit("log", many)
    found = validated(bench.src)
    assert found.counts["REF-3"] == KEPT_FINDINGS + 7
    assert Counter(finding.rule for finding in found.findings) == {"REF-3": KEPT_FINDINGS}
    assert found.document()["left_off"] == 7


def test_ids_are_unique_and_every_rule_has_a_test_and_a_text() -> None:
    ids = [rule.id for rule in RULES]
    assert len(set(ids)) == len(ids)
    assert set(ids) == {rule for rule, _, _ in BREAKS}
    for rule in RULES:
        assert rule.says.endswith(".")
        assert rule.why.endswith(".")


def test_the_page_of_rules_is_as_the_list_says() -> None:
    assert (ROOT / PAGE).read_text() == rules_page(), f"stale: {PAGE_COMMAND}"


@pytest.mark.parametrize("name", ["nuscenes-onekeyframe", "dgp-tri-2scenes"])
def test_real_datasets(shared_data: Path, name: str) -> None:
    """The scenes of the Toyota cars are in no split of nuScenes; there is nothing else to say."""
    found = validate(find_subject(shared_data / name, None, picture_size))
    assert [f"{f.where}: {f.what}" for f in found.findings if f.rule != "REC-8"] == []
    assert found.counts["REC-8"] == {"nuscenes-onekeyframe": 0, "dgp-tri-2scenes": 2}[name]
    assert found.opened_with_devkit
