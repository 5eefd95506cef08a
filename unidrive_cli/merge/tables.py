"""The tables of a merged dataset, written one dataset after the other."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from unidrive_cli.errors import DatasetError
from unidrive_cli.merge.drives import DRIVEN
from unidrive_cli.merge.plan import MergePlan, Part
from unidrive_cli.merge.renaming import Renaming
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.extra import IMAGE_ANNOTATIONS
from unidrive_cli.tables.schema import TABLES
from unidrive_cli.tables.table import RawRow, RawRows, RowsFile, Table, write_rows


class MergedTables:
    """The tables while they are written; a context manager, which closes them."""

    def __init__(self, plan: MergePlan, folder: Path) -> None:
        """
        Args:
            folder: where the tables go.
        """
        self._plan = plan
        self._folder = folder
        self._known = {*TABLES, *plan.extra, IMAGE_ANNOTATIONS}
        self._files: dict[str, RowsFile] = {}
        self.counts: dict[str, int] = {}
        """Rows by table, when all are closed."""

    def __enter__(self) -> MergedTables:
        self._files = {
            name: RowsFile(self._folder / f"{name}.json") for name in (*DRIVEN, *self._plan.extra, IMAGE_ANNOTATIONS)
        }
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            if kind is None:
                for name, file in self._files.items():
                    file.close()
                    self.counts[name] = file.count
                for name, rows in self._plan.united.items():
                    self.counts[name] = write_rows(self._folder / f"{name}.json", rows)
        finally:
            for file in self._files.values():
                file.abandon()

    def add(self, part: Part, dataset: Dataset) -> None:
        """Writes the rows of a dataset that are not united.

        Raises:
            DatasetError: a table has changed since it was planned.
        """
        for name in DRIVEN:
            self._files[name].write(_rows(getattr(dataset, name), part.renaming, self._known))
        for name in self._plan.extra:
            table = dataset.extra_tables.get(name)
            repeated = part.repeated.get(name, set())
            rows = (row for row in (table.rows if table else None) or [] if row.get("token") not in repeated)
            self._files[name].write(
                json.dumps(part.renaming.record(name, row, self._known)).encode() for row in rows
            )
        boxes = dataset.folder / f"{IMAGE_ANNOTATIONS}.json"
        if boxes.is_file():
            self._files[IMAGE_ANNOTATIONS].write(_boxes(boxes, part.renaming, self._known))


def _rows(table: Table[Any], renaming: Renaming, known: Collection[str]) -> RawRows:
    first: list[dict[str, Any]] = [msgspec.json.decode(raw) for raw in table.raw[:1]]
    fields = first[0] if first else {}
    if not renaming.touches(table.name, fields, known):
        return table.runs(np.arange(len(table.rows)), {})
    return _changed(table.raw, table.name, renaming, known)


def _changed(
    rows: Collection[RawRow] | Iterator[RawRow], table: str, renaming: Renaming, known: Collection[str]
) -> Iterator[RawRow]:
    for raw in rows:
        yield msgspec.json.encode(renaming.record(table, msgspec.json.decode(raw), known))


def _boxes(path: Path, renaming: Renaming, known: Collection[str]) -> RawRows:
    """The 2D boxes of a dataset."""
    rows = _lines(path)
    fields = "prev", "sample_data_token", "instance_token", "visibility_token", "attribute_tokens", "filename"
    if not renaming.touches(IMAGE_ANNOTATIONS, fields, known):
        return rows
    return _changed(rows, IMAGE_ANNOTATIONS, renaming, known)


def _lines(path: Path) -> Iterator[bytes]:
    """The rows of a table that has one row a line, as unidrive writes them; of another one too, all in memory.

    Raises:
        DatasetError: it is not a list of rows.
    """
    try:
        with path.open("rb") as stream:
            begin, row = stream.readline(), _row_of(stream.readline())
            if begin != b"[\n" or not (row.startswith(b"{") and row.endswith(b"}")):
                stream.seek(0)
                yield from map(bytes, msgspec.json.decode(stream.read(), type=list[msgspec.Raw]))
                return
            while row != b"]":
                yield bytes(msgspec.json.decode(row, type=msgspec.Raw))
                row = _row_of(stream.readline())
    except msgspec.DecodeError as error:
        raise DatasetError(
            f"is not a list of rows: {error}.", where=str(path), hint="Convert the dataset again."
        ) from error


def _row_of(line: bytes) -> bytes:
    return line.rstrip(b"\n").rstrip(b",")
