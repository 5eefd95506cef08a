"""Tables of millions of rows: DuckDB holds the columns that link them, the text of a row stays in its file."""

from __future__ import annotations

import bisect
import glob
import hashlib
import itertools
import os
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints, overload

import msgspec
import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.tables.lacking import ASKED_FOR
from unidrive_cli.tables.schema import TABLES, Row
from unidrive_cli.tables.table import (
    EMPTY,
    NOWHERE,
    SEPARATOR,
    Indices,
    ListedTable,
    RawRow,
    RawRows,
    Run,
    Table,
    bad_row,
    changed,
)

R = TypeVar("R", bound=Row)
P = TypeVar("P", bound=msgspec.Struct)
SCANNED = ("sample_data", "ego_pose", "sample_annotation")
"""The tables that grow with the length of the recordings."""
_PIECE_BYTES = 4 << 20
_HASHED_BYTES = 32 << 20
_PIECE_ROWS = 1 << 14
_EDGE_BYTES = 64
_MANY = 1 << 17
"""So many tokens are looked up in order, so that neighbouring questions have neighbouring answers."""
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
    Thread(target=_hash, args=([files[name].result() for name in found],), daemon=True).start()
    return found


def _hash(files: Sequence[_File]) -> None:
    for file in files:
        file.hash()


class ScannedTable(Table[R]):
    """A table of which DuckDB holds the columns, with tokens as 64-bit hashes that are unique in it.

    A row is decoded, and checked field by field, when it is asked for; of the others it is known that they are
    JSON objects with all fields that the schema wants or that are ASKED_FOR, of values that DuckDB can turn into
    what the schema wants.
    """

    def __init__(self, store: _Store, name: str, file: _File) -> None:
        self.name = name
        self.file = file.path
        self.size_bytes = file.size_bytes
        self._store = store
        self._file = file
        self._links: dict[tuple[str, str], Indices] = {}
        self._expected: dict[str, int] = {}
        self._to_expect: list[str] = []
        self.rows: Sequence[R] = _Sequence(file.row_count, self.rows_at)
        self.raw: Sequence[RawRow] = _Sequence(file.row_count, self.raw_at)

    @cached_property
    def digest(self) -> str:  # type: ignore[override]  # waited for where it is asked for
        return self._file.digest

    def find(self, tokens: Sequence[str]) -> Indices:
        return self._store.find(tokens, self.name)

    def get(self, token: str, wanted_by: str) -> R:
        if self._to_expect:
            tokens, self._to_expect = self._to_expect, []
            self._expected.update(zip(tokens, self.find(tokens).tolist(), strict=True))
        index = self._expected.get(token, NOWHERE)
        if index < 0:
            index = int(self.find([token])[0])
        if index < 0:
            raise self.nowhere(token, wanted_by)
        return self.rows[index]

    def expect(self, tokens: Sequence[str]) -> None:
        self._to_expect.extend(tokens)

    def links(self, field: str, target: Table[Any]) -> Indices:
        key = (field, target.name)
        if key not in self._links:
            self._links[key] = self._store.links(self.name, field, _relation(target))
        return self._links[key]

    def unlinked(self, field: str, target: Table[Any], *, empty: bool) -> Indices:
        return self._store.unlinked(self.name, field, _relation(target), empty=empty)

    def leading_out(self, field: str, kept: Bool) -> Indices:
        return self._store.leading_out(self.name, field, kept)

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
        return self._decoded(indices, TABLES[self.name])

    def parts_at(self, indices: Indices, part: type[P]) -> Iterator[P]:
        return self._decoded(indices, part)

    def _decoded(self, indices: Indices, row_type: type[msgspec.Struct]) -> Iterator[Any]:
        decode = msgspec.json.Decoder(list[row_type]).decode  # type: ignore[valid-type]
        start = 0
        for run in self._file.runs(indices, {}):
            try:
                rows = decode(b"[%b]" % run.text)
            except (msgspec.DecodeError, RecursionError):
                self._refuse_bad_row(indices[start : start + run.number], row_type)
                raise
            yield from rows
            start += run.number

    def _refuse_bad_row(self, indices: Indices, row_type: type[msgspec.Struct]) -> None:
        for index, text in zip(indices.tolist(), self.raw_at(indices), strict=True):
            try:
                msgspec.json.decode(text, type=row_type)
            except (msgspec.DecodeError, RecursionError) as error:
                raise bad_row(text, index, self.file, str(error)) from error

    def raw_at(self, indices: Indices) -> Iterator[bytes]:
        return self._file.texts(np.asarray(indices))

    def runs(self, indices: Indices, changes: Mapping[int, Mapping[str, Any]]) -> RawRows:
        return self._file.runs(indices, changes)


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
        size_bytes: its size.
        row_count: how many rows it can have; -1 where that is not to be told from its braces, or it is no list.
    """

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        self._stream = path.open("rb", buffering=0)
        self._state = self._state_now()
        self._digest: Future[str] = Future()
        begins, ends = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        are_separated = [np.zeros(0, dtype=bool)]
        at = 0
        buffer = bytearray(_PIECE_BYTES)
        while size := self._stream.readinto(buffer):
            piece = memoryview(buffer)[:size]
            codes = np.frombuffer(piece, dtype=np.uint8)
            begins.append(np.flatnonzero(codes == ord("{")) + at)
            ends_here = np.flatnonzero(codes == ord("}")) + 1
            ends.append(ends_here + at)
            are_separated.append(_are_separated(codes, ends_here))
            at += size
        self.size_bytes = at
        self._begins, self._ends = np.concatenate(begins), np.concatenate(ends)
        self._are_separated = np.concatenate(are_separated)
        are_pairs = len(self._begins) == len(self._ends)
        self.row_count = len(self._begins) if are_pairs and self._is_list() else -1

    def _is_list(self) -> bool:
        """Whether it begins and ends as a list; DuckDB also reads one that is cut off after a comma, or empty."""
        begin = self._read(0, min(_EDGE_BYTES, self.size_bytes))
        end = self._read(max(0, self.size_bytes - _EDGE_BYTES), self.size_bytes)
        return begin.lstrip().startswith(b"[") and end.rstrip().endswith(b"]")

    def hash(self) -> None:
        """Makes the digest, or what is raised for it."""
        try:
            digest = hashlib.sha256()
            for begin in range(0, self.size_bytes, _HASHED_BYTES):
                digest.update(self._read(begin, min(begin + _HASHED_BYTES, self.size_bytes)))
            self._digest.set_result(digest.hexdigest())
        except Exception as error:
            self._digest.set_exception(error)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the file; waits for `hash`.

        Raises:
            DatasetError: the file is not as it was, or cannot be read.
        """
        try:
            return self._digest.result()
        except OSError as error:
            raise DatasetError(f"cannot be read: {error.strerror}.", where=self.path) from error

    def texts(self, indices: Indices) -> Iterator[bytes]:
        """The text of some rows; neighbours are read together.

        Raises:
            DatasetError: the file is not as it was.
        """
        begins, ends = self._begins[indices], self._ends[indices]
        for start, stop in itertools.pairwise(_windows(begins)):
            origin = int(begins[start])
            data = self._read(origin, int(ends[stop - 1]))
            for begin, end in zip(begins[start:stop].tolist(), ends[start:stop].tolist(), strict=True):
                yield data[begin - origin : end - origin]

    def runs(self, indices: Indices, changes: Mapping[int, Mapping[str, Any]]) -> Iterator[Run]:
        """The rows as they are written, changed fields put in; what stands in the file just so is copied as it is.

        Raises:
            DatasetError: the file is not as it was.
        """
        begins, ends = self._begins[indices], self._ends[indices]
        are_changed = np.zeros(len(self._begins) if changes else 0, dtype=bool)
        are_changed[list(changes)] = True
        alone = are_changed[indices] if changes else np.zeros(len(indices), dtype=bool)
        windows = _windows(begins)
        # For all windows at once: beside other threads, NumPy waits for the interpreter after every long array.
        are_first = np.ones(len(indices), dtype=bool)
        are_first[1:] = ~self._are_separated[indices[:-1]] | (begins[1:] != ends[:-1] + len(SEPARATOR))
        are_first[1:] |= alone[1:] | alone[:-1]
        are_first[windows[:-1]] = True
        first, last = np.flatnonzero(are_first), np.flatnonzero(np.append(are_first, True)[1:])
        pieces = (indices[first], alone[first], begins[first], ends[last])
        of_windows = itertools.pairwise(np.searchsorted(first, windows).tolist())
        for (start, stop), (piece, next_piece) in zip(itertools.pairwise(windows), of_windows, strict=True):
            origin = int(begins[start])
            data = self._read(origin, int(ends[stop - 1]))
            texts = []
            for row, is_changed, begin, end in zip(
                *(column[piece:next_piece].tolist() for column in pieces), strict=True
            ):
                text = data[begin - origin : end - origin]
                texts.append(changed(text, changes[row]) if is_changed else text)
            yield Run(stop - start, SEPARATOR.join(texts))

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


def _windows(begins: Indices) -> list[int]:
    """Where, among rows that begin at these bytes, those begin that are read together; and their number."""
    windows = [0]
    for turn in [*(np.flatnonzero(begins[1:] < begins[:-1]) + 1).tolist(), len(begins)]:
        while (start := windows[-1]) < turn:
            far = begins[start] + _PIECE_BYTES
            windows.append(bisect.bisect_left(begins, far, start + 1, min(start + _PIECE_ROWS, turn)))
    return windows


def _are_separated(codes: npt.NDArray[np.uint8], ends: Indices) -> Bool:
    """(n,) whether SEPARATOR stands in a piece of a file where its rows end."""
    are_separated: Bool = ends + len(SEPARATOR) <= len(codes)
    for place, code in enumerate(SEPARATOR):
        are_separated[are_separated] = codes[ends[are_separated] + place] == code
    return are_separated


class _Store:
    """A DuckDB database in memory."""

    def __init__(self) -> None:
        import duckdb  # only where tables are large: its import takes a tenth of a second

        self._error = duckdb.Error
        self._database = duckdb.connect(
            config={"autoinstall_known_extensions": False, "autoload_known_extensions": False, "temp_directory": ""}
        )
        self._tokens: dict[str, _Tokens] = {}

    def load(self, path: Path, name: str) -> int:
        """Loads a table's columns; returns the number of its rows.

        Raises:
            _Odd: not a list of rows as the schema wants them, or a token twice.
        """
        read, selected, needed = _columns(TABLES[name], ASKED_FOR.get(name, {}))
        connection = self._database.cursor()
        try:
            connection.execute(
                f"create table {name} as select {', '.join(selected)}, {' and '.join(needed)} as is_whole "
                "from read_json(?, format = 'array', compression = 'uncompressed', hive_partitioning = false, "
                f"columns = {read})",
                [glob.escape(str(path))],
            )
            sums = f"count(*), count(token), count(*) filter (is_whole) from {name}"
            count, named, whole = connection.execute(f"select {sums}").fetchall()[0]
        except self._error as error:
            raise _Odd from error
        if not count == named == whole:
            raise _Odd
        self._tokens[name] = tokens = _Tokens(self._hashes(f"select token from {name}").values)
        if not tokens.are_unique():
            raise _Odd
        return int(count)

    def find(self, tokens: Sequence[str], target: str) -> Indices:
        """Where rows of a loaded table stand, by token."""
        return self._tokens[target].places(self._hashed(tokens))

    def links(self, name: str, field: str, target: str | Sequence[str]) -> Indices:
        """Where the rows stand to which the rows of a loaded table point: in another, or in a list of tokens."""
        return self._known(target).places(self._hashes(f"select {field} from {name}"))

    def unlinked(self, name: str, field: str, target: str | Sequence[str], *, empty: bool) -> Indices:
        """The rows of which the field's token is not in the other table, or list; and those without a token."""
        links = self._hashes(f"select {field} from {name}")
        return np.flatnonzero(self._known(target).are_missing(links) | (links.are_empty & empty))

    def leading_out(self, name: str, field: str, kept: Bool) -> Indices:
        """The rows of a loaded table, of some, that point to another row than one of these."""
        links, inside = self._hashes(f"select {field} from {name}"), np.flatnonzero(kept)
        tokens = self._tokens[name]
        if len(inside) < len(kept):
            tokens = _Tokens(tokens.hashes[inside])
        return inside[tokens.are_missing(_Hashes(links.values[inside], links.are_empty[inside]))]

    def rows_with_dangling(self, name: str, field: str, target: str | Sequence[str]) -> Indices:
        """The rows of which a list holds a token that the other table, or list, does not have."""
        lists = self._fetch(f"select len({field}) as size from {name}")["size"].astype(np.int64)
        tokens = self._hashes(f"select unnest({field}) from {name}")
        owners = np.repeat(np.arange(len(lists)), lists)
        rows: Indices = np.unique(owners[self._known(target).are_missing(tokens)])
        return rows

    def columns(self, name: str, fields: Sequence[str]) -> Float:
        """(n, k) float64 columns of a loaded table."""
        found = self._fetch(f"select {', '.join(fields)} from {name}")
        return np.stack([np.asarray(found[field], dtype=np.float64) for field in fields]).T

    def folders(self, name: str) -> tuple[list[str], Indices]:
        """The folders of plain file names ('' for all others), and the number of each row's folder."""
        found: list[str] = self._fetch(f"select distinct folder from {name} order by folder")["folder"].tolist()
        codes = self._hashes(f"select hash(folder) from {name}")
        return found, _Tokens(self._hashed(found, empty="hash('')").values).places(codes)

    def _known(self, target: str | Sequence[str]) -> _Tokens:
        return self._tokens[target] if isinstance(target, str) else _Tokens(self._hashed(target).values)

    def _hashed(self, texts: Sequence[str], empty: str = "null") -> _Hashes:
        given = {"text": np.array(texts, dtype=object), "position": np.arange(len(texts))}
        query = f"select case when text = '' then {empty} else hash(text) end from given order by position"
        return self._hashes(query, given)

    def _hashes(self, query: str, given: dict[str, Any] | None = None) -> _Hashes:
        """The one column that a query selects."""
        (column,) = self._fetch(query, given).values()
        values = np.asarray(column, dtype=np.uint64)
        return _Hashes(values, np.broadcast_to(getattr(column, "mask", False), values.shape))

    def _fetch(self, query: str, given: dict[str, Any] | None = None) -> dict[str, Any]:
        connection = self._database.cursor()
        if given:
            connection.register("given", given)
        fetched: dict[str, Any] = connection.execute(query).fetchnumpy()
        return fetched


class _Hashes(NamedTuple):
    """Hashed tokens: (n,) uint64, and (n,) bool where there is none."""

    values: npt.NDArray[np.uint64]
    are_empty: Bool


class _Tokens:
    """The hashed tokens of a table, to look others up in."""

    def __init__(self, hashes: npt.NDArray[np.uint64]) -> None:
        self.hashes = hashes
        self._ascending = np.sort(hashes)
        self._are_many = len(hashes) > _MANY

    def are_unique(self) -> bool:
        return bool((self._ascending[1:] != self._ascending[:-1]).all())

    def are_missing(self, wanted: _Hashes) -> Bool:
        """(n,) where a token is wanted that is not here."""
        if self._are_these(wanted):
            return np.zeros(len(wanted.values), dtype=bool)
        asked = wanted.values[~wanted.are_empty]
        if self._are_many:
            asked.sort()
        missing = asked[~self._are_at(np.searchsorted(self._ascending, asked), asked)]
        if not len(missing):
            return np.zeros(len(wanted.values), dtype=bool)
        return np.isin(wanted.values, missing) & ~wanted.are_empty

    def places(self, wanted: _Hashes) -> Indices:
        """(n,) where the wanted tokens stand, EMPTY or NOWHERE."""
        if self._are_these(wanted):
            return np.arange(len(self.hashes))
        order = np.argsort(wanted.values) if self._are_many else np.arange(len(wanted.values))
        asked = wanted.values[order]
        found = np.searchsorted(self._ascending, asked)
        there = self._are_at(found, asked)
        places = np.full(len(asked), NOWHERE)
        places[order[there]] = self._order[found[there]]
        places[wanted.are_empty] = EMPTY
        return places

    @cached_property
    def _order(self) -> Indices:
        return np.argsort(self.hashes)

    def _are_these(self, wanted: _Hashes) -> bool:
        """Whether just the tokens that are here are wanted, in their order."""
        return np.array_equal(wanted.values, self.hashes) and not wanted.are_empty.any()

    def _are_at(self, places: Indices, asked: npt.NDArray[np.uint64]) -> Bool:
        if not len(self._ascending):
            return np.zeros(len(asked), dtype=bool)
        are_at: Bool = self._ascending[np.minimum(places, len(self._ascending) - 1)] == asked
        return are_at


def _relation(target: Table[Any]) -> str | list[str]:
    if isinstance(target, ListedTable):
        return list(target.by_token)
    return target.name


def _columns(row_type: type[Row], asked_for: Collection[str]) -> tuple[str, list[str], list[str]]:
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
        is_needed = definition.required or field in asked_for
        if kept or is_needed:
            read.append(f"{field}: '{_sql_type(hint)}'")
        if is_needed:
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
