"""FILE, PIC: the files that the tables name are there, inside the dataset, and as large as the tables say."""

from __future__ import annotations

import functools
import stat
from collections.abc import Callable, Iterator

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.check.subject import Subject
from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.schema import Row, Whole
from unidrive_cli.tables.table import Indices

NamedFile = tuple[str, Callable[[], str]]
"""A file name, and what error sentences call the field that holds it."""
_FIRST_BYTES = 1 << 12
_HEAD_BYTES = 1 << 16


class _Picture(Row, frozen=True, gc=False):
    filename: str
    width: Whole | None = None
    height: Whole | None = None


def named_files(dataset: Dataset, rows: Indices) -> Iterator[NamedFile]:
    """The files that some sample_data rows, and all maps and rows of extra tables, name."""
    table = dataset.sample_data
    for row in table.parts_at(rows, _Picture):
        yield row.filename, functools.partial(table.place, row, "filename")
    for map_row in dataset.map.rows:
        if map_row.filename:
            yield map_row.filename, functools.partial(dataset.map.place, map_row, "filename")
    for extra in dataset.extra_tables.values():
        for index, record in enumerate(extra.rows or []):
            if filename := extra.filename(record):
                yield filename, functools.partial("{}, row {}, field filename".format, extra.path, index)


def files_outside(subject: Subject) -> Iterator[Broken]:
    """A file name is relative, and stays inside the dataset without .. and links that lead elsewhere.

    The dataset breaks where it is copied; a reader may be led to any file.
    """
    data = subject.dataset
    rows = np.arange(len(data.sample_data.rows))
    for filename, where in named_files(data, data.sample_data.names_to_check(rows, data.files.has_links)):
        try:
            data.files.locate(filename, "")
        except DatasetError as error:
            yield where(), error.what


def missing_files(subject: Subject) -> Iterator[Broken]:
    """Every file that a table names is there, and not empty.

    Readers stop in the middle of an epoch; nuscenes-devkit does not open a dataset without its map pictures.
    """

    def look(files: list[NamedFile]) -> list[Broken]:
        return [(where(), what) for filename, where in files if (what := _lack(subject, filename))]

    rows = np.arange(len(subject.dataset.sample_data.rows))
    yield from subject.look_at(named_files(subject.dataset, rows), look)


def pictures_without_size(subject: Subject) -> Iterator[Broken]:
    """A camera row says its picture's width and height.

    nuscenes-devkit compares boxes with nothing.
    """
    table, shots = subject.dataset.sample_data, subject.shots
    sizeless = subject.of_cameras & ((shots.widths <= 0) | (shots.heights <= 0))
    for row in table.rows_at(np.flatnonzero(sizeless)):
        yield table.place(row, "width"), f"the picture is {row.width} x {row.height} pixels; its size was expected."


def pictures_of_other_size(subject: Subject) -> Iterator[Broken]:
    """A picture is one, and as large as its row says.

    The intrinsics do not fit the pixels.
    """
    table = subject.dataset.sample_data

    def look(rows: list[_Picture]) -> list[Broken]:
        return [(table.place(row, "filename"), what) for row in rows if (what := _picture_fault(subject, row))]

    rows = table.parts_at(np.flatnonzero(subject.of_cameras), _Picture)
    yield from subject.look_at(rows, look)


def _lack(subject: Subject, filename: str) -> str:
    """What is wrong with a file; nothing where its name is (FILE-1)."""
    try:
        status = subject.dataset.files.look_at(filename, "")
    except DatasetError:
        return ""
    except FileNotFoundError:
        return f"{filename} is missing."
    except OSError as error:
        return f"{filename} cannot be read: {error.strerror}."
    if not stat.S_ISREG(status.st_mode):
        return f"{filename} is no file."
    return "" if status.st_size else f"{filename} is empty."


def _picture_fault(subject: Subject, row: _Picture) -> str:
    """What is wrong with a picture that is there."""
    if _lack(subject, row.filename):
        return ""
    try:
        path = subject.dataset.files.locate(row.filename, "")
        with open(path, "rb", buffering=0) as stream:  # noqa: PTH123
            head = stream.read(_FIRST_BYTES)
            try:
                size = subject.picture_size(head, row.filename)
            except DatasetError:
                size = subject.picture_size(head + stream.read(_HEAD_BYTES - len(head)), row.filename)
    except DatasetError as error:
        return f"{row.filename}: {error.what}" if error.where else ""
    except OSError as error:
        return f"{row.filename} cannot be read: {error.strerror}."
    if row.width and row.height and size != (row.width, row.height):
        return f"{row.filename} is {size[0]}x{size[1]} pixels, but the row says {row.width}x{row.height}."
    return ""
