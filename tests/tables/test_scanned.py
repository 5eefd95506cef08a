"""Large tables: what DuckDB says of them is what reading them row by row says; what is odd is read row by row."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.datasets import Bench, paint, tree
from tests.tables.small import VERSION, Tables, tables, write
from unidrive_cli.check.references import check_references
from unidrive_cli.errors import DatasetError
from unidrive_cli.tables import dataset as dataset_module
from unidrive_cli.tables import scanned
from unidrive_cli.tables.dataset import Dataset, open_dataset
from unidrive_cli.tables.scanned import SCANNED, ScannedTable, _File
from unidrive_cli.tables.schema import Row
from unidrive_cli.tables.table import EMPTY, NOWHERE, ListedTable, read_table, write_rows


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted"), scenes=2)


@pytest.fixture
def scanning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every dataset counts as large."""
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)


def both(root: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Dataset, Dataset]:
    """The dataset read row by row, and scanned."""
    read = open_dataset(root)
    monkeypatch.setattr(dataset_module, "LARGE_BYTES", 0)
    return read, open_dataset(root)


def kinds(dataset: Dataset) -> dict[str, type]:
    return {name: type(getattr(dataset, name)) for name in SCANNED}


def test_small_tables_are_not_scanned(painted: Path) -> None:
    assert set(kinds(open_dataset(painted)).values()) == {ListedTable}


def test_a_scanned_table_says_what_a_read_one_says(painted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, scanned = both(painted, monkeypatch)
    assert set(kinds(scanned).values()) == {ScannedTable}
    assert scanned.digest == read.digest
    some = np.array([3, 1, 1, 5])
    for name in SCANNED:
        one, other = getattr(scanned, name), getattr(read, name)
        assert list(one.rows) == other.rows
        assert one.rows[2] == other.rows[2]
        assert one.rows[-1] == other.rows[-1]
        assert one.rows[1:6:2] == other.rows[1:6:2]
        assert list(map(bytes, one.raw)) == list(map(bytes, other.raw))
        assert list(one.rows_at(some)) == list(other.rows_at(some))
        tokens = [other.rows[4].token, "", "no such token", other.rows[0].token]
        assert one.find(tokens).tolist() == other.find(tokens).tolist() == [4, EMPTY, NOWHERE, 0]
        assert one.get(tokens[0], "somewhere") == other.rows[4]
        one.expect(tokens)
        assert one.get(tokens[3], "somewhere") == other.rows[0]
        with pytest.raises(DatasetError, match="somewhere"):
            one.get("no such token", "somewhere")
        assert (one.size_bytes, one.file, one.name) == (other.size_bytes, other.file, other.name)
    for name, field, target in [
        ("sample_data", "sample_token", "sample"),
        ("sample_data", "ego_pose_token", "ego_pose"),
        ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
        ("sample_data", "next", "sample_data"),
        ("sample_annotation", "prev", "sample_annotation"),
        ("sample_annotation", "visibility_token", "visibility"),
        ("instance", "first_annotation_token", "sample_annotation"),
    ]:
        links = [getattr(dataset, name).links(field, getattr(dataset, target)) for dataset in (read, scanned)]
        np.testing.assert_array_equal(*links)
        for empty in (False, True):
            rows = [
                getattr(dataset, name).unlinked(field, getattr(dataset, target), empty=empty)
                for dataset in (read, scanned)
            ]
            np.testing.assert_array_equal(*rows)
    for name, field in [("ego_pose", "rotation"), ("sample_annotation", "size"), ("ego_pose", "translation")]:
        numbers = [getattr(dataset, name).numbers(field) for dataset in (read, scanned)]
        np.testing.assert_array_equal(*numbers)
    np.testing.assert_array_equal(read.of_cameras, scanned.of_cameras)
    assert read.keyframes == scanned.keyframes
    for sample in read.sample.rows:
        assert read.annotations(sample.token) == scanned.annotations(sample.token)


def test_a_conversion_is_the_same_bytes(painted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some samples leave (their pictures are broken), so that lists are mended."""
    trees = []
    for name, large in (("read", dataset_module.LARGE_BYTES), ("scanned", 0)):
        monkeypatch.setattr(dataset_module, "LARGE_BYTES", large)
        (tmp_path / name).mkdir()
        bench = Bench(tmp_path / name, painted)
        for place in (1, 3):
            bench.picture(sample=place).write_bytes(b"x")
        bench.convert("--on-error", "skip", "--unseen-boxes", "drop", "--jobs", 0)
        trees.append(tree(bench.dst, ("run.json",)))
    assert trees[0] == trees[1]


def test_rows_that_lead_to_rows_that_leave(painted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, scanned = both(painted, monkeypatch)
    kept = np.ones(len(read.sample_data.rows), dtype=bool)
    kept[4] = False
    before, after = read.sample_data.rows[4].prev, read.sample_data.rows[4].next
    assert before
    assert after
    for dataset in (read, scanned):
        table = dataset.sample_data
        for field, neighbour in (("next", before), ("prev", after)):
            assert [row.token for row in table.rows_at(table.leading_out(field, kept))] == [neighbour]
        assert table.leading_out("next", np.ones_like(kept)).tolist() == []


@pytest.mark.usefixtures("scanning")
@pytest.mark.parametrize("separator", [",\n", ", ", "\n,", " , ", ","])
@pytest.mark.parametrize("piece", [{}, {"_PIECE_BYTES": 700}, {"_PIECE_ROWS": 2}], ids=str)
def test_rows_are_written_as_they_stand_but_for_their_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, separator: str, piece: dict[str, int]
) -> None:
    for name, value in piece.items():
        monkeypatch.setattr(scanned, name, value)
    made = tables()
    root = write(tmp_path, made)
    texts = [json.dumps(row, indent=1) for row in made["sample_data"]]
    (root / VERSION / "sample_data.json").write_text(f"[{separator.join(texts)}]")
    table = open_dataset(root).sample_data
    assert isinstance(table, ScannedTable)
    assert list(table.rows) == list(open_dataset(write(tmp_path / "plain")).sample_data.rows)
    indices, changes = np.array([0, 1, 3, 4, 5, 2]), {1: {"timestamp": 7}, 5: {"new": ""}}
    assert write_rows(tmp_path / "written.json", table.runs(indices, changes)) == len(indices)
    mended = [
        json.dumps(made["sample_data"][index] | changes[index], separators=(",", ":"))
        if index in changes
        else texts[index]
        for index in indices.tolist()
    ]
    assert (tmp_path / "written.json").read_text() == "[\n" + ",\n".join(mended) + "\n]\n"


@pytest.mark.usefixtures("scanning")
def test_only_some_fields_of_a_row(tmp_path: Path) -> None:
    """What is not asked for is not looked at; what is asked for must be right, and is named as it is elsewhere."""

    class Place(Row, frozen=True):
        translation: tuple[float, float, float]

    class Wrong(Row, frozen=True):
        translation: tuple[str, str, str]

    root = write(tmp_path, tables())
    table = open_dataset(root).ego_pose
    expected = [Place(row.token, row.translation) for row in (table.rows[2], table.rows[0])]
    for either in (table, read_table(Path(table.file), "ego_pose")):
        assert list(either.parts_at(np.array([2, 0]), Place)) == expected
    with pytest.raises(DatasetError, match=rf"row 2, token {table.rows[2].token}, field translation\[0\]"):
        list(table.parts_at(np.array([2, 0]), Wrong))


@pytest.mark.usefixtures("scanning")
def test_a_digest_of_a_file_that_has_changed(tmp_path: Path) -> None:
    path = write(tmp_path, tables()) / VERSION / "ego_pose.json"
    file = _File(path)
    path.write_bytes(path.read_bytes() + b" ")
    file.hash()
    with pytest.raises(DatasetError, match=r"ego_pose\.json: was changed while it was being used"):
        _ = file.digest


DANGLING: list[tuple[str, str, Any]] = [
    ("sample_data", "sample_token", "gone"),
    ("sample_data", "ego_pose_token", "gone"),
    ("sample_data", "calibrated_sensor_token", "gone"),
    ("sample_data", "next", "gone"),
    ("sample_annotation", "sample_token", "gone"),
    ("sample_annotation", "instance_token", "gone"),
    ("sample_annotation", "attribute_tokens", ["gone"]),
    ("sample_annotation", "prev", "gone"),
]


@pytest.mark.parametrize(("table", "field", "value"), DANGLING)
def test_dangling_tokens_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str, field: str, value: Any
) -> None:
    made = tables()
    made[table][1][field] = value
    read, scanned = both(write(tmp_path, made), monkeypatch)
    assert kinds(scanned)[table] is ScannedTable
    findings = list(check_references(read))
    assert len(findings) == 1
    assert list(check_references(scanned)) == findings


def change(table: str, field: str, value: Any) -> Callable[[Tables], None]:
    def edit(made: Tables) -> None:
        if value is ...:
            del made[table][1][field]
        else:
            made[table][1][field] = value

    return edit


WRONG = [
    change("sample_data", "token", "cam-s0"),
    change("sample_data", "prev", None),
    change("sample_data", "filename", ...),
    change("sample_data", "is_key_frame", "perhaps"),
    change("ego_pose", "rotation", [1, 0, 0]),
    change("ego_pose", "rotation", [1, 0, None, 0]),
    change("ego_pose", "translation", [1, 0, 0, 0]),
    change("ego_pose", "translation", "here"),
    change("ego_pose", "timestamp", ...),
    change("sample_annotation", "attribute_tokens", "none"),
    change("sample_annotation", "size", ...),
]


@pytest.mark.parametrize("edit", WRONG)
def test_what_is_wrong_gets_the_sentence_of_a_small_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edit: Callable[[Tables], None]
) -> None:
    made = tables()
    edit(made)
    root = write(tmp_path, made)
    sentences = []
    for large in (dataset_module.LARGE_BYTES, 0):
        monkeypatch.setattr(dataset_module, "LARGE_BYTES", large)
        with pytest.raises(DatasetError) as caught:
            list(check_references(open_dataset(root)))
        sentences.append(str(caught.value))
    assert sentences[0] == sentences[1]


@pytest.mark.parametrize(
    "cut", [lambda text: "", lambda text: text[:-1], lambda text: text[: text.index("}, {") + 2]]
)
def test_a_table_that_is_cut_off_gets_the_sentence_of_a_small_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: Callable[[str], str]
) -> None:
    """DuckDB takes what is empty, or cut off after a comma, for whole."""
    root = write(tmp_path, tables())
    path = root / VERSION / "sample_annotation.json"
    path.write_text(cut(path.read_text()))
    sentences = []
    for large in (dataset_module.LARGE_BYTES, 0):
        monkeypatch.setattr(dataset_module, "LARGE_BYTES", large)
        with pytest.raises(DatasetError) as caught:
            open_dataset(root)
        sentences.append(str(caught.value))
    assert sentences[0] == sentences[1]


@pytest.mark.usefixtures("scanning")
@pytest.mark.parametrize("extra", [{"a": 1}, [{"a": 1}, {"b": 2}], "}, {", "{", "}{"])
def test_braces_elsewhere_are_no_rows(tmp_path: Path, extra: Any) -> None:
    """Further objects in a row, or braces in its texts: read row by row."""
    made = tables()
    made["sample_data"][1]["further"] = extra
    dataset = open_dataset(write(tmp_path, made))
    assert kinds(dataset)["sample_data"] is ListedTable
    assert [json.loads(bytes(raw)) for raw in dataset.sample_data.raw] == made["sample_data"]


@pytest.mark.usefixtures("scanning")
def test_names_that_globs_and_partitions_would_read_otherwise(tmp_path: Path) -> None:
    root = write(tmp_path / "a[1]*?" / "year=2026", tables())
    assert set(kinds(open_dataset(root)).values()) == {ScannedTable}


@pytest.mark.usefixtures("scanning")
def test_a_file_that_changes_meanwhile(tmp_path: Path) -> None:
    root = write(tmp_path, tables())
    dataset = open_dataset(root)
    with (root / VERSION / "ego_pose.json").open("ab") as stream:
        stream.write(b" ")
    with pytest.raises(DatasetError, match=r"ego_pose\.json: was changed while it was being used"):
        list(dataset.ego_pose.rows)


@pytest.mark.usefixtures("scanning")
@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "samples/../../x", "samples/LIDAR_TOP/..", "a\\b", "a\0b", ".", "x" * 300]
)
def test_unusual_file_names_are_looked_at(tmp_path: Path, name: str) -> None:
    made = tables()
    made["sample_data"][3]["filename"] = name
    dataset = open_dataset(write(tmp_path, made))
    assert kinds(dataset)["sample_data"] is ScannedTable
    others = np.flatnonzero(~dataset.of_cameras)
    assert others.tolist() == [1, 3, 5]
    assert dataset.sample_data.names_to_check(others, lambda folder: False).tolist() == [1, 3]
    assert dataset.sample_data.names_to_check(others, lambda folder: True).tolist() == [1, 3, 5]


def test_links_out_of_the_dataset_are_refused(painted: Path, tmp_path: Path, scanning: None) -> None:
    bench = Bench(tmp_path, painted)
    lidar = next((bench.src / "samples" / "LIDAR_TOP").iterdir())
    (tmp_path / "elsewhere").write_bytes(lidar.read_bytes())
    lidar.unlink()
    lidar.symlink_to(tmp_path / "elsewhere")
    run = bench.convert("--jobs", 0)
    assert run.code == 3
    assert "is a link that leads out of the dataset" in run.said
