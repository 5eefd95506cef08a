"""One table: every way in which a file can be wrong, named by file, row, token and field."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from tests.tables.small import tables
from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.table import RowsFile, changed, read_table, table_of, write_rows

ROWS = tables()


def refusal(folder: Path, data: bytes | None, name: str = "calibrated_sensor") -> str:
    """The sentence that a file's content is refused with."""
    path = folder / f"{name}.json"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(DatasetError) as caught:
        read_table(path, name)
    sentence = str(caught.value)
    assert caught.value.exit_code == 3
    assert sentence.startswith(str(path))
    assert "\n" not in sentence
    return sentence.removeprefix(str(folder))


def second_row_with(name: str, **changes: Any) -> bytes:
    """The small table with a change in its second row; `None` as a value means null, `...` no such field."""
    first, second, *rest = ROWS[name]
    second = {key: value for key, value in (second | changes).items() if value is not ...}
    return json.dumps([first, second, *rest]).encode()


# --- the file ----------------------------------------------------------------------------------------

WHOLE = json.dumps(ROWS["calibrated_sensor"]).encode()


def test_a_missing_table(tmp_path: Path) -> None:
    assert "needed and missing" in refusal(tmp_path, None)


def test_a_folder_in_place_of_a_table(tmp_path: Path) -> None:
    (tmp_path / "calibrated_sensor.json").mkdir()
    assert "cannot be read" in refusal(tmp_path, None)


@pytest.mark.parametrize("length", [0, 1, 40, len(WHOLE) // 2, len(WHOLE) - 1])
def test_a_truncated_table(tmp_path: Path, length: int) -> None:
    sentence = refusal(tmp_path, WHOLE[:length])
    assert "truncated" in sentence
    assert f"after {length} bytes" in sentence


@pytest.mark.parametrize("data", [b"{}", b'{"token": "a"}', b"3", b"null", b'"rows"'])
def test_a_table_that_is_no_list(tmp_path: Path, data: bytes) -> None:
    assert "is not a list of rows" in refusal(tmp_path, data)


@pytest.mark.parametrize(
    "data", [b"<html>", b"PK\x03\x04", WHOLE + b"x", WHOLE[:-1] + b",]", b"[" * 100_000, b"\0" * 9]
)
def test_a_table_that_is_no_json(tmp_path: Path, data: bytes) -> None:
    assert "is not valid JSON" in refusal(tmp_path, data)


@pytest.mark.parametrize("old", [b'"calibrated-lidar"', b'"sensor_token": "lidar"', b"[1.5, 0.0, 1.6]"])
def test_a_table_that_is_no_utf_8(tmp_path: Path, old: bytes) -> None:
    """In the token, in a field that is read, and in one that is only passed on."""
    new = b'[1.5, 0.0, 1.6], "extra": "\xff"' if old.startswith(b"[") else old[:-2] + b'\xff"'
    refusal(tmp_path, WHOLE.replace(old, new))


# --- its rows ----------------------------------------------------------------------------------------

MATRIX = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("table", "changes", "field", "words"),
    [
        ("calibrated_sensor", {"rotation": ...}, "rotation", "the field is missing. A quaternion w, x, y, z"),
        ("calibrated_sensor", {"sensor_token": ...}, "sensor_token", "the field is missing"),
        ("sample_data", {"ego_pose_token": ...}, "ego_pose_token", "the field is missing"),
        ("sample", {"prev": ...}, "prev", "the field is missing"),
        ("calibrated_sensor", {"rotation": MATRIX}, "rotation[0]", "A quaternion w, x, y, z is expected"),
        ("ego_pose", {"rotation": MATRIX}, "rotation[0]", "A quaternion w, x, y, z is expected"),
        ("ego_pose", {"rotation": [1, 0, 0]}, "rotation", "length 4"),
        ("ego_pose", {"rotation": [1, 0, 0, 0, 0]}, "rotation", "length 4"),
        ("ego_pose", {"rotation": None}, "rotation", "`null`"),
        ("ego_pose", {"translation": [0, "1", 0]}, "translation[1]", "`float`, got `str`"),
        ("ego_pose", {"translation": [0, True, 0]}, "translation[1]", "`float`, got `bool`"),
        ("ego_pose", {"translation": {"x": 0}}, "translation", "`object`"),
        ("ego_pose", {"timestamp": "now"}, "timestamp", "`str`"),
        ("ego_pose", {"translation": [0, float("nan"), 0]}, "translation[1]", "NaN or infinite"),
        ("ego_pose", {"rotation": [0, 0, 0, float("-inf")]}, "rotation[3]", "NaN or infinite"),
        ("ego_pose", {"twist": {"linear": [float("nan")]}}, "twist.linear[0]", "NaN or infinite"),
        ("ego_pose", {"translation": [0, 10**400, 0]}, "translation[1]", "out of range"),
        ("calibrated_sensor", {"camera_intrinsic": [[1, "f", 0]]}, "camera_intrinsic[0][1]", "`str`"),
        ("calibrated_sensor", {"camera_intrinsic": None}, "camera_intrinsic", "`null`"),
        ("sample_data", {"is_key_frame": 1}, "is_key_frame", "`bool`, got `int`"),
        ("sample_data", {"width": 1600.5}, "width", "`float`"),
        ("sample_data", {"filename": None}, "filename", "`str`, got `null`"),
        ("sample_annotation", {"size": [1, 2]}, "size", "length 3"),
        ("sample_annotation", {"attribute_tokens": "moving"}, "attribute_tokens", "`array`, got `str`"),
    ],
)
def test_a_wrong_row_is_named_by_row_token_and_field(
    tmp_path: Path, table: str, changes: dict[str, Any], field: str, words: str
) -> None:
    sentence = refusal(tmp_path, second_row_with(table, **changes), table)
    token = ROWS[table][1]["token"]
    assert sentence.startswith(f"/{table}.json, row 1, token {token}, field {field}: ")
    assert words in sentence


def test_a_number_beyond_float_is_named_with_its_token(tmp_path: Path) -> None:
    data = second_row_with("ego_pose", translation=[0, 123.25, 0]).replace(b"123.25", b"1e999")
    assert refusal(tmp_path, data, "ego_pose").startswith(
        "/ego_pose.json, row 1, token ego-s1, field translation[1]: "
    )


def test_a_file_that_is_abandoned_hides_no_error(tmp_path: Path) -> None:
    """What is buffered goes to a disk that is full, while another error is under way."""
    with Path("/dev/full").open("wb") as full:
        file = RowsFile(tmp_path / "table.json")
        file.write([b"{}"])
        os.dup2(full.fileno(), file._stream.fileno())
        file.abandon()
    assert not (tmp_path / "table.json").exists()


@pytest.mark.parametrize("number", [10**30, 2**63, -(10**400)])
def test_whole_numbers_that_nothing_can_hold(tmp_path: Path, number: int) -> None:
    made = tables()
    made["sample"][1]["timestamp"] = number
    path = tmp_path / "sample.json"
    path.write_text(json.dumps(made["sample"]))
    with pytest.raises(DatasetError, match="row 1, token s1, field timestamp: "):
        read_table(path, "sample")


@pytest.mark.parametrize(
    ("token", "shown"), [(..., "field token: the field is missing"), (7, "token 7, field token")]
)
def test_a_row_without_a_proper_token_is_named_by_its_number(tmp_path: Path, token: object, shown: str) -> None:
    assert f", row 1, {shown}" in refusal(tmp_path, second_row_with("ego_pose", token=token), "ego_pose")


@pytest.mark.parametrize("row", [3, None, "row", [], True])
def test_a_row_that_is_no_object(tmp_path: Path, row: object) -> None:
    assert "row 1: expected `object`" in refusal(tmp_path, json.dumps([ROWS["log"][0], row]).encode(), "log")


def test_duplicate_tokens(tmp_path: Path) -> None:
    (tmp_path / "ego_pose.json").write_bytes(second_row_with("ego_pose", token="ego-s0"))
    table = read_table(tmp_path / "ego_pose.json", "ego_pose")
    with pytest.raises(DatasetError, match=r"ego_pose\.json, token ego-s0: .*unique"):
        _ = table.by_token


def test_a_dangling_token_is_named_by_who_points_and_where(tmp_path: Path) -> None:
    table = table_of("sensor", ROWS["sensor"])
    assert table.get("cam", "here").channel == "CAM_FRONT"
    with pytest.raises(DatasetError, match=r"here: points to 'nobody', which is not in sensor\.json"):
        table.get("nobody", "here")


# --- what is kept ------------------------------------------------------------------------------------


def test_fields_beyond_the_schema_and_odd_but_usable_values_are_kept(tmp_path: Path) -> None:
    """Lyft: float times; T4: further fields; rosbag: numbers as exact text. What stays is written as it was."""
    text = b'{"extra": [1.0, null], "token": "a", "timestamp": 1556675185903083.2, "rotation": [-1, 0, 0, 0.0], '
    text += b'"translation": [1e6, 0, 12345678901234567890]}'
    (tmp_path / "ego_pose.json").write_bytes(b"[" + text + b"]")
    table = read_table(tmp_path / "ego_pose.json", "ego_pose")
    assert table.rows[0].timestamp == 1556675185903083.2
    assert table.rows[0].rotation == (-1, 0, 0, 0)
    assert write_rows(tmp_path / "out.json", table.raw) == 1
    assert (tmp_path / "out.json").read_bytes() == b"[\n" + text + b"\n]\n"
    assert not list(tmp_path.glob("*.part"))


def test_written_tables_are_one_row_a_line_and_read_back(tmp_path: Path) -> None:
    for name, rows in tables().items():
        path = tmp_path / f"{name}.json"
        assert write_rows(path, table_of(name, rows).raw) == len(rows)
        assert json.loads(path.read_bytes()) == rows
        assert read_table(path, name).rows == table_of(name, rows).rows
        assert len(path.read_bytes().splitlines()) == len(rows) + 2


def test_changed_replaces_fields_and_keeps_the_others_in_order() -> None:
    text = changed(b'{"token":"a","prev":"x","extra": {"b": 1.50e0 },"next":"y"}', {"prev": "", "next": "z"})
    assert text == b'{"token":"a","prev":"","extra":{"b": 1.50e0 },"next":"z"}'
