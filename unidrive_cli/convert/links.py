"""Files that do not change: linked or copied from the source."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from unidrive_cli.convert.destination import Destination
from unidrive_cli.convert.options import Link
from unidrive_cli.errors import DatasetError, OutputError
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.schema import SampleData

CARRIED_FOLDERS = ("can_bus", "map", "maps")
"""Top-level folders that go along whole; other files go along where a table names them."""


def carried_files(dataset: Dataset, rows: list[SampleData], extra_rows: list[dict[str, Any]]) -> Iterator[str]:
    """File names, relative to the dataset, of everything that goes along unchanged.

    Args:
        rows: sample_data rows (no cameras) that stay.
        extra_rows: rows of extra tables that stay; those with a `filename` name a file.
    """
    for row in rows:
        yield row.filename
    for record in extra_rows:
        if isinstance(record.get("filename"), str) and record["filename"]:
            yield record["filename"]
    named = {row.filename for row in dataset.map.rows if row.filename}
    for folder in CARRIED_FOLDERS:
        for path, _, files in os.walk(dataset.root / folder):
            for name in sorted(files):
                named.add((Path(path) / name).relative_to(dataset.root).as_posix())
    yield from sorted(named)


def carry(dataset: Dataset, filename: str, destination: Destination, how: Link) -> bool:
    """Brings one file of the source into the destination; False where the source does not have it.

    Raises:
        DatasetError: the name leaves the dataset.
        OutputError: it cannot be written.
    """
    source = dataset.files.resolve(filename, f"{dataset.folder}, filename {filename!r:.80}")
    target = destination.root / filename
    if not source.is_file():
        return False
    if os.path.lexists(target):
        return True
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        real = source.resolve()
        if how == "symlink":
            target.symlink_to(real)
        elif how == "copy" or not _hard_link(real, target):
            temporary = destination.work / "carried.part"
            shutil.copyfile(real, temporary)
            temporary.replace(target)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(target)) from error
    return True


def read_extra_rows(path: Path) -> list[dict[str, Any]] | None:
    """The rows of an extra table, or None where the file is not a list of rows.

    Raises:
        DatasetError: it cannot be read.
    """
    try:
        document = msgspec.json.decode(path.read_bytes())
    except (OSError, msgspec.DecodeError, RecursionError) as error:
        raise DatasetError(f"is no table: {error}.", where=str(path)) from error
    if not isinstance(document, list) or not all(isinstance(row, dict) for row in document):
        return None
    return document


def _hard_link(source: Path, target: Path) -> bool:
    try:
        os.link(source, target)
    except OSError:
        return False
    return True
