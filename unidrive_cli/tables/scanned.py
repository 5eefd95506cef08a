"""Tables of millions of rows: DuckDB holds the columns that link them, the text of a row stays in its file."""

from __future__ import annotations

import glob
import hashlib
import os
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints, overload

import msgspec
import numpy as np

from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.tables.schema import TABLES, Row
from unidrive_cli.tables.table import EMPTY, NOWHERE, Indices, ListedTable, RawRow, Table, bad_row

R = TypeVar("R", bound=Row)
SCANNED = ("sample_data", "ego_pose", "sample_annotation")
"""The tables that grow with the length of the recordings."""
_PIECE_BYTES = 4 << 20
_PIECE_ROWS = 1 << 14
_FOLDER = """
case when strlen(filename) <= 255 and filename[1] not in ('/', '.') and not contains(filename, '..')
and not contains(filename, '/.') and not contains(filename, '//') and not contains(filename, chr(92))
and not contains(filename, chr(0)) then left(filename, length(filename) - strpos(reverse(filename), '/'))
else '' end as folder"""
"""SQL: the folder of a file name in which nothing is unusual (or a name without folder itself); '' of others."""


class _Odd(Exception):
    """The file is not as such files are; whether it is right must be seen by reading it row by row."""


def scan_tables(folder: Path, names: Sequence[str]) -> dict[str, ScannedTable[Any]]:
    """Scans the tables of a version folder that are in good order.

    Args:
        names: of `SCANNED`.

    Returns:
        By name. A table that holds anything out of the ordinary is missing: it must be read (`read_table`),
        which finds out whether it is wrong, and says where.

    Raises:
        OSError: a file cannot be read.
    """
    store = _Store()
    with ThreadPoolExecutor(2) as threads:
        loads = {name: threads.submit(store.load, folder / f"{name}.json", name) for name in names}
        files = {name: threads.submit(_File, folder / f"{name}.json") for name in names}
        found = {}
        for name in names:
            file = files[name].result()
            try:
                if loads[name].result() == file.row_count:
                    found[name] = ScannedTable[Any](store, name, file)
            except _Odd:
                continue
    return found


class ScannedTable(Table[R]):
    """A table of which DuckDB holds the columns, with tokens as 64-bit hashes that are unique in it.

    A row is decoded, and checked field by field, when it is asked for; of the others it is known that they are
    JSON objects with all fields that the schema wants, of which the numbers are numbers.
    """

    def __init__(self, store: _Store, name: str, file: _File) -> None:
        self.name = name
        self.file = file.path
        self.digest = file.digest
        self.size_bytes = file.size_bytes
        self._store = store
        self._file = file
        self._decode: Callable[[bytes], Any] = msgspec.json.Decoder(TABLES[name]).decode
        self._links: dict[tuple[str, str], Indices] = {}
        self._expected: dict[str, int] = {}
        self.rows: Sequence[R] = _Sequence(file.row_count, self.rows_at)
        self.raw: Sequence[RawRow] = _Sequence(file.row_count, self.raw_at)

    def find(self, tokens: Sequence[str]) -> Indices:
        return self._store.find(tokens, self.name)

    def get(self, token: str, wanted_by: str) -> R:
        index = self._expected.get(token, NOWHERE)
        if index < 0:
            index = int(self.find([token])[0])
        if index < 0:
            raise self.nowhere(token, wanted_by)
        return self.rows[index]

    def expect(self, tokens: Sequence[str]) -> None:
        self._expected.update(zip(tokens, self.find(tokens).tolist(), strict=True))

    def links(self, field: str, target: Table[Any]) -> Indices:
        key = (field, target.name)
        if key not in self._links:
            self._links[key] = self._store.links(self.name, field, _relation(target))
        return self._links[key]

    def rows_with_dangling(self, field: str, target: Table[Any]) -> Indices:
        return self._store.rows_with_dangling(self.name, field, _relation(target))

    def numbers(self, field: str) -> Float:
        count = len(_vector_fields(TABLES[self.name])[field])
        return self._store.columns(self.name, [f"{field}_{place}" for place in range(count)])

    def flags(self, field: str) -> Bool:
        return self._store.columns(self.name, [field])[:, 0].astype(bool)

    def names_to_check(self, rows: Indices, has_links: Callable[[str], bool]) -> Indices:
        folders, codes = self._store.folders(self.name)
        present, first, codes = np.unique(codes[rows], return_index=True, return_inverse=True)
        names = [folders[code] for code in present]
        one_by_one = np.array([not folder or has_links(folder) for folder in names], dtype=bool)
        return np.union1d(rows[one_by_one[codes]], rows[first])

    def rows_at(self, indices: Indices) -> Iterator[R]:
        decode = self._decode
        for index, text in zip(indices, self.raw_at(indices), strict=True):
            try:
                yield decode(text)
            except (msgspec.DecodeError, RecursionError) as error:
                raise bad_row(text, int(index), self.file, str(error)) from error

    def raw_at(self, indices: Indices) -> Iterator[bytes]:
        return self._file.texts(np.asarray(indices))


class _Sequence(Sequence[Any]):
    """Something per row, made when it is asked for."""

    def __init__(self, count: int, at: Callable[[Indices], Iterator[Any]]) -> None:
        self._count = count
        self._at = at

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Any]:
        for begin in range(0, self._count, _PIECE_ROWS):
            yield from self._at(np.arange(begin, min(begin + _PIECE_ROWS, self._count)))

    @overload
    def __getitem__(self, index: int) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> list[Any]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return list(self._at(np.arange(self._count)[index]))
        return next(self._at(np.array([range(self._count)[index]])))


class _File:
    """Where each row's text lies in a table's file, which must stay as it is.

    A list of objects that hold no further objects, and no braces in their texts, has as many braces of
    either kind as rows: where that is so, each pair is a row.

    Attributes:
        path: the file.
        digest: SHA-256 (hex) of it.
        size_bytes: its size.
        row_count: how many rows it can have; -1 where that is not to be told from its braces.
    """

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        self._stream = path.open("rb", buffering=0)
        self._state = self._state_now()
        digest = hashlib.sha256()
        begins, ends = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        at = 0
        buffer = bytearray(_PIECE_BYTES)
        while size := self._stream.readinto(buffer):
            piece = memoryview(buffer)[:size]
            digest.update(piece)
            codes = np.frombuffer(piece, dtype=np.uint8)
            begins.append(np.flatnonzero(codes == ord("{")) + at)
            ends.append(np.flatnonzero(codes == ord("}")) + at + 1)
            at += size
        self.size_bytes = at
        self.digest = digest.hexdigest()
        self._begins, self._ends = np.concatenate(begins), np.concatenate(ends)
        self.row_count = len(self._begins) if len(self._begins) == len(self._ends) else -1

    def texts(self, indices: Indices) -> Iterator[bytes]:
        """The text of some rows; neighbours are read together.

        Raises:
            DatasetError: the file is not as it was.
        """
        begins, ends = self._begins[indices], self._ends[indices]
        start = 0
        while start < len(begins):
            origin = int(begins[start])
            stop = start + 1
            if stop < len(begins) and 0 <= begins[stop] - origin < _PIECE_BYTES:
                window = begins[start : start + _PIECE_ROWS]
                far = np.flatnonzero((window - origin >= _PIECE_BYTES) | (np.diff(window, prepend=origin) < 0))
                stop = start + (int(far[0]) if len(far) else len(window))
            data = self._read(origin, int(ends[start:stop].max()))
            for begin, end in zip(
                (begins[start:stop] - origin).tolist(), (ends[start:stop] - origin).tolist(), strict=True
            ):
                yield data[begin:end]
            start = stop

    def _read(self, begin: int, end: int) -> bytes:
        data = os.pread(self._stream.fileno(), end - begin, begin)
        if len(data) != end - begin or self._state_now() != self._state:
            raise DatasetError(
                "was changed while it was being used.", where=self.path, hint="Give the same command again."
            )
        return data

    def _state_now(self) -> tuple[int, int]:
        status = os.fstat(self._stream.fileno())
        return status.st_size, status.st_mtime_ns


class _Store:
    """A DuckDB database in memory."""

    def __init__(self) -> None:
        import duckdb  # only where tables are large: its import takes a tenth of a second

        self._error = duckdb.Error
        self._database = duckdb.connect(
            config={"autoinstall_known_extensions": False, "autoload_known_extensions": False, "temp_directory": ""}
        )

    def load(self, path: Path, name: str) -> int:
        """Loads a table's columns; returns the number of its rows.

        Raises:
            _Odd: not a list of rows as the schema wants them, or a token twice.
        """
        read, selected, needed = _columns(TABLES[name])
        connection = self._database.cursor()
        try:
            connection.execute(
                f"create table {name} as select {', '.join(selected)}, {' and '.join(needed)} as is_whole "
                "from read_json(?, format = 'array', compression = 'uncompressed', hive_partitioning = false, "
                f"columns = {read})",
                [glob.escape(str(path))],
            )
            sums = f"count(*), count(distinct token), count(*) filter (is_whole) from {name}"
            count, distinct, whole = connection.execute(f"select {sums}").fetchall()[0]
        except self._error as error:
            raise _Odd from error
        if not count == distinct == whole:
            raise _Odd
        return int(count)

    def find(self, tokens: Sequence[str], target: str) -> Indices:
        """Where rows of a loaded table stand, by token."""
        wanted = "(select case when token <> '' then hash(token) end as link, position from given)"
        known, _ = _known(target)
        return self._joined(wanted, known, _numbered(tokens))

    def links(self, name: str, field: str, target: str | Sequence[str]) -> Indices:
        """Where the rows stand to which the rows of a loaded table point: in another, or in a list of tokens."""
        return self._joined(f"(select {field} as link, rowid as position from {name})", *_known(target))

    def rows_with_dangling(self, name: str, field: str, target: str | Sequence[str]) -> Indices:
        """The rows of which a list holds a token that the other table, or list, does not have."""
        known, given = _known(target)
        return self._indices(
            f"select distinct position from (select unnest({field}) as link, rowid as position from {name}) "
            f"anti join {known} on link = token order by position",
            given,
        )

    def columns(self, name: str, fields: Sequence[str]) -> Float:
        """(n, k) float64 columns of a loaded table."""
        found = self._fetch(f"select {', '.join(fields)} from {name}", {})
        return np.stack([np.asarray(found[field], dtype=np.float64) for field in fields], axis=1)

    def folders(self, name: str) -> tuple[list[str], Indices]:
        """The folders of plain file names ('' for all others), and the number of each row's folder."""
        found = self._fetch(f"select distinct folder from {name} order by folder", {})["folder"].tolist()
        folders = f"(select folder as link, rowid as position from {name})"
        codes = self._joined(folders, "(select token, position as place from given)", _numbered(found))
        return found, codes

    def _joined(self, wanted: str, known: str, given: dict[str, Any]) -> Indices:
        return self._indices(
            f"select coalesce(place, case when link is null then {EMPTY} else {NOWHERE} end) as place "
            f"from {wanted} left join {known} on link = token order by position",
            given,
        )

    def _indices(self, query: str, given: dict[str, Any]) -> Indices:
        """The one column that a query selects."""
        (column,) = self._fetch(query, given).values()
        indices: Indices = column.astype(np.int64)
        return indices

    def _fetch(self, query: str, given: dict[str, Any]) -> dict[str, Any]:
        connection = self._database.cursor()
        if given:
            connection.register("given", given)
        fetched: dict[str, Any] = connection.execute(query).fetchnumpy()
        return fetched


def _relation(target: Table[Any]) -> str | list[str]:
    if isinstance(target, ListedTable):
        return list(target.by_token)
    return target.name


def _known(target: str | Sequence[str]) -> tuple[str, dict[str, Any]]:
    """A relation of hashed tokens and their places, and what it is made from."""
    if isinstance(target, str):
        return f"(select token, rowid as place from {target})", {}
    return "(select hash(token) as token, position as place from given)", _numbered(target)


def _numbered(texts: Sequence[str]) -> dict[str, Any]:
    return {"token": np.array(texts, dtype=object), "position": np.arange(len(texts))}


def _columns(row_type: type[Row]) -> tuple[str, list[str], list[str]]:
    """SQL of what is read from a table's file, what is kept of it, and what must hold for every row."""
    read, selected, needed = [], [], []
    vectors, hints = _vector_fields(row_type), get_type_hints(row_type)
    for definition in msgspec.structs.fields(row_type):
        field, hint = definition.name, hints[definition.name]
        kept: list[str] = []
        if field in ("token", "prev", "next") or field.endswith("_token"):
            kept = [f"case when {field} <> '' then hash({field}) end as {field}"]
        elif field in vectors:
            numbers = [f"{field}[{place}]" for place in range(1, len(vectors[field]) + 1)]
            kept = [f"{number} as {field}_{place}" for place, number in enumerate(numbers)]
            needed += [f"len({field}) = {len(numbers)}", *(f"{number} is not null" for number in numbers)]
        elif hint == list[str]:
            kept = [f"list_transform({field}, lambda token: hash(token)) as {field}"]
        elif hint is bool:
            kept = [field]
        elif field == "filename":
            kept = [_FOLDER]
        if kept or definition.required:
            read.append(f"{field}: '{_sql_type(hint)}'")
        if definition.required:
            needed.append(f"{field} is not null")
        selected += kept
    return f"{{{', '.join(read)}}}", selected, needed


def _vector_fields(row_type: type[Row]) -> dict[str, tuple[Any, ...]]:
    """Fields of a fixed number of numbers."""
    hints = get_type_hints(row_type)
    return {field: get_args(hint) for field, hint in hints.items() if get_origin(hint) is tuple}


def _sql_type(hint: Any) -> str:
    if get_origin(hint) in (Union, types.UnionType):
        kinds = set(get_args(hint)) - {type(None)}
        hint = float if float in kinds else kinds.pop()
    if get_origin(hint) is tuple:
        return "DOUBLE[]"
    names = {str: "VARCHAR", bool: "BOOLEAN", int: "BIGINT", float: "DOUBLE", list[str]: "VARCHAR[]"}
    return names[hint]
