"""STR: the tables are there, and are tables; and REF-3, what reading them has put in."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.check.subject import Subject
from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.converted import MARKER, WORK
from unidrive_cli.tables.dataset import OPTIONAL, Dataset
from unidrive_cli.tables.extra import extra_table_paths, read_extra_table
from unidrive_cli.tables.lacking import ASKED_FOR, lacking
from unidrive_cli.tables.scanned import SCANNED, ScannedTable, scan_tables
from unidrive_cli.tables.schema import NEEDED, TABLES
from unidrive_cli.tables.table import ListedTable, read_table


def unfinished_conversions(subject: Subject) -> Iterator[Broken]:
    """A conversion into the folder has been finished.

    Samples may be missing, and nothing has been verified.
    """
    root = subject.folder.parent
    for name in (MARKER, WORK):
        if (root / name).exists():
            yield str(root / name), "the conversion has not been finished; the same command completes it."


def missing_needed_tables(subject: Subject) -> Iterator[Broken]:
    """The tables sensor, calibrated_sensor, ego_pose, sample, sample_data and scene are there.

    Without them there is nothing to read.
    """
    for name in NEEDED:
        if name in subject.missing:
            yield str(subject.folder / f"{name}.json"), "this table is needed and missing."


def missing_tables(subject: Subject) -> Iterator[Broken]:
    """The other seven of the 13 tables are there.

    nuscenes-devkit does not open the dataset; a conversion writes valid minimal ones.
    """
    for name in OPTIONAL:
        if name in subject.missing:
            yield str(subject.folder / f"{name}.json"), "this table is missing; nuscenes-devkit needs all 13."


def unreadable_tables(subject: Subject) -> Iterator[Broken]:
    """Every table is a JSON list of rows with the fields and types of the schema.

    Every reader stops. Named is the first fault of each table.

    Raises:
        DatasetError: none of the needed tables can be read.
    """
    try:
        faults = _faults_of_rows(subject.dataset)
    except DatasetError as error:
        faults = _faults_of_tables(subject, error)
    for fault in faults:
        yield fault.where, f"{fault.what} {fault.hint}".strip()


def _faults_of_rows(dataset: Dataset) -> Iterator[DatasetError]:
    """The first fault of each table of which not every row has been decoded yet."""
    for name in SCANNED:
        table = getattr(dataset, name)
        if isinstance(table, ScannedTable):
            try:
                deque(table.rows, maxlen=0)
            except DatasetError as error:
                yield error


def _faults_of_tables(subject: Subject, whole: DatasetError) -> Iterator[DatasetError]:
    """The first fault of each table of a dataset that cannot be opened."""
    found: dict[str, DatasetError] = {}
    for name in TABLES:
        if name not in subject.missing:
            try:
                _read(subject, name)
            except DatasetError as error:
                found[name] = error
    if set(NEEDED) <= found.keys() | subject.missing:
        raise whole
    for path in extra_table_paths(subject.folder, frozenset(TABLES)):
        try:
            read_extra_table(path)
        except DatasetError as error:
            found[path.stem] = error
    if not found and not set(NEEDED) & subject.missing:
        found[""] = whole
    yield from found.values()


def repeated_tokens(subject: Subject) -> Iterator[Broken]:
    """No two rows of a table have one token.

    Readers find either of them.
    """
    for name in TABLES:
        table = getattr(subject.dataset, name)
        if isinstance(table, ListedTable):  # those of a scanned table are unique, or it would not be
            counts = Counter(row.token for row in table.rows)
            for token, count in counts.items():
                if count > 1:
                    yield f"{table.file}, token {token}", f"{count} rows have this token; tokens must be unique."


def maps_lacking_fields(subject: Subject) -> Iterator[Broken]:
    """Every row of map.json has filename and log_tokens.

    nuscenes-devkit does not open the dataset (nuScenes' teaser sets have no log_tokens); a conversion puts them in.
    """
    yield from _lacking_fields(subject, "map")


def rows_lacking_fields(subject: Subject) -> Iterator[Broken]:
    """Rows of log, scene, instance and sample_annotation have the fields that readers ask for.

    nuscenes-devkit's lists and evaluation, and most trainers, stop with a KeyError; a conversion puts them in.
    """
    for name in ASKED_FOR:
        if name != "map":
            yield from _lacking_fields(subject, name)


def _lacking_fields(subject: Subject, name: str) -> Iterator[Broken]:
    if name in subject.missing:
        return
    table = getattr(subject.dataset, name)
    found = lacking(table)
    for row, fields in zip(table.rows_at(np.array(list(found), dtype=np.int64)), found.values(), strict=True):
        for field in fields:
            yield table.place(row, field), "is missing."


def logs_without_map(subject: Subject) -> Iterator[Broken]:
    """Every log is named by a map.

    nuscenes-devkit stops with a KeyError.
    """
    if {"map", "log"} & subject.missing:
        return
    maps = read_table(subject.folder / "map.json", "map")  # without the row that opening the dataset assumes
    mapped = {token for row in maps.rows for token in row.log_tokens}
    table = subject.dataset.log
    for row in table.rows:
        if row.token not in mapped:
            yield table.place(row, "token"), "is in the log_tokens of no row of map.json; nuscenes-devkit needs one."


def _read(subject: Subject, name: str) -> None:
    if name not in SCANNED or name not in scan_tables(subject.folder, [name]):
        read_table(subject.folder / f"{name}.json", name)
