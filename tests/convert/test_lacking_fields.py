"""Rows without fields that nuscenes-devkit asks for: the output has them, and it is said."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from nuscenes.eval.common.loaders import load_gt
from nuscenes.eval.detection.data_classes import DetectionBox
from nuscenes.nuscenes import NuScenes

from tests.datasets import VERSION, Bench, Row, assert_consistent, paint, rows, rows_of, unidrive
from unidrive_cli.errors import CheckError
from unidrive_cli.tables import dataset as dataset_module
from unidrive_cli.tables.devkit import check_devkit

FILLED: dict[str, dict[str, Any]] = {
    "log": {"logfile": "", "location": ""},
    "map": {"filename": "", "log_tokens": []},
    "scene": {"description": ""},
    "instance": {"nbr_annotations": 0, "first_annotation_token": "", "last_annotation_token": ""},
    "sample_annotation": {
        **{"prev": "", "next": "", "visibility_token": "", "attribute_tokens": []},
        **{"num_lidar_pts": -1, "num_radar_pts": 0},
    },
}
"""What a row gets for a field that it lacks."""


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", samples=2)


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    return Bench(tmp_path, painted)


def strip(bench: Bench, table: str, *fields: str, index: int | None = None) -> None:
    """Takes fields out of all rows of a table, or out of one."""

    def change(found: list[Row]) -> None:
        for row in found if index is None else [found[index]]:
            for field in fields:
                del row[field]

    bench.edit(table, change)


def test_a_map_without_log_tokens(bench: Bench) -> None:
    """nuScenes' teaser sets; no log is mapped then, and an empty map is put in for them."""
    strip(bench, "map", "log_tokens")
    with pytest.raises(CheckError, match="does not open the dataset: Exception: Error: log_tokens not in map table"):
        check_devkit(bench.src, VERSION, len(rows(bench.src, "sample_annotation")))
    run = bench.converted()
    (log,) = rows(bench.dst, "log")
    assert [row["log_tokens"] for row in rows(bench.dst, "map")] == [[], [log["token"]]]
    assert "map.json: log_tokens is missing in 1 rows; [] is put in." in run.stdout


def test_logs_of_the_teaser_name_their_map(bench: Bench) -> None:
    strip(bench, "map", "log_tokens")
    (a_map,) = rows(bench.src, "map")
    bench.edit("log", lambda found: found[0].update(map_token=a_map["token"]))
    run = bench.converted()
    (log,) = rows(bench.dst, "log")
    (found,) = rows(bench.dst, "map")
    assert found == {**a_map, "log_tokens": [log["token"]]}
    assert "map.json: log_tokens is missing in 1 rows; the logs with their map_token are put in." in run.stdout


@pytest.mark.parametrize("scanned", [False, True], ids=["read", "scanned"])
def test_every_field_that_is_asked_for(bench: Bench, scanned: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first row of each table lacks all of them, the others keep what they have."""
    for table, fields in FILLED.items():
        strip(bench, table, *fields, index=0)
    if scanned:
        monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    run = bench.convert("--visibility", "keep")
    assert run.code == 0, run.stderr
    for table, fields in FILLED.items():
        source, found = rows(bench.src, table), rows(bench.dst, table)
        for field, value in fields.items():
            assert all(field in row for row in found), (table, field)
            assert f"{table}.json: {field} is missing in 1 rows; " in run.stdout
            if table in ("log", "scene") or field in ("visibility_token", "attribute_tokens", "num_lidar_pts"):
                assert found[0][field] == value
                assert [row[field] for row in found[1:]] == [row[field] for row in source[1:]]
    boxes = rows(bench.dst, "image_annotations")
    lacking = {box["num_lidar_pts"] for box in boxes if box["sample_annotation_token"] == source_token(bench)}
    assert lacking == {-1}
    nusc = NuScenes(VERSION, str(bench.dst), verbose=False)
    nusc.list_scenes()
    truth = load_gt(nusc, "mini_train", DetectionBox)
    assert min(box.num_pts for box in truth.all) == -1


def source_token(bench: Bench) -> str:
    token: str = rows(bench.src, "sample_annotation")[0]["token"]
    return token


def test_annotations_without_lists_are_linked_by_fix(bench: Bench) -> None:
    strip(bench, "sample_annotation", "prev", "next")
    assert unidrive("validate", bench.src, "--json").json()["counts"]["LINK-3"] > 0
    assert unidrive("validate", bench.src, "--fix", "--json").json()["counts"]["LINK-3"] == 0
    bench.converted()
    assert any(row["next"] for row in rows(bench.dst, "sample_annotation"))


def test_nothing_is_said_of_whole_rows(bench: Bench) -> None:
    run = bench.converted()
    assert "is missing in" not in run.stdout
    assert_consistent(bench.dst)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda row: row.update(index=7), ""),
        (lambda row: None, "the category {name} has no index"),
        (lambda row: row.update(index=None), "the category {name} has no index"),
        (lambda row: row.update(index=7, name="car"), "it has no colour for the category car"),
    ],
    ids=["nuScenes'", "no index", "null", "T4's names"],
)
def test_labels_of_points(bench: Bench, change: Callable[[Row], object], why: str) -> None:
    """Where nuscenes-devkit cannot name the categories, their table goes along under another name."""
    lidar = [row for row in rows_of(bench.src, "lidar") if row["is_key_frame"]]
    labels = [
        {**dict.fromkeys(("token", "sample_data_token"), row["token"]), "filename": f"lidarseg/{VERSION}/{n}.bin"}
        for n, row in enumerate(lidar)
    ]
    bench.table("lidarseg").write_text(json.dumps(labels))
    (bench.src / "lidarseg" / VERSION).mkdir(parents=True)
    for row in labels:
        (bench.src / row["filename"]).write_bytes(b"\1\2")
    bench.edit("category", lambda found: [row.update(index=n) for n, row in enumerate(found)])
    name = rows(bench.src, "category")[2]["name"]
    bench.edit("category", lambda found: (found[2].pop("index"), change(found[2])))
    run = bench.converted()
    table = "source_lidarseg" if why else "lidarseg"
    assert rows(bench.dst, table) == labels
    assert (bench.dst / VERSION / "lidarseg.json").exists() == (not why)
    assert all((bench.dst / row["filename"]).read_bytes() == b"\1\2" for row in labels)
    assert ("lidarseg.json goes along as source_lidarseg.json" in run.stdout) == bool(why)
    assert why.format(name=name) in run.stdout
