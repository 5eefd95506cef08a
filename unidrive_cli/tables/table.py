"""One table: read with the file, token and field in every error; written one row a line."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.tables.schema import TABLES, Row

R = TypeVar("R", bound=Row)
P = TypeVar("P", bound=msgspec.Struct)
RawRow = bytes | msgspec.Raw


class Run(NamedTuple):
    """Rows as they are written: their number, and their JSON texts with `SEPARATOR` between them."""

    number: int
    text: RawRow


RawRows = Iterable[RawRow | Run]
SEPARATOR = b",\n"
Indices = npt.NDArray[np.int64]
EMPTY, NOWHERE = -1, -2
"""In place of a row's index: the field is empty; the token is not in the table."""
_TEXTS_OF_FIELDS = msgspec.json.Decoder(dict[str, msgspec.Raw])
_ROWS_A_WRITE = 4096
_BUFFER_BYTES = 4 << 20
_AGAIN = "Unpack or copy the table again."
_NON_FINITE = "is NaN or infinite; a finite number was expected."


class Table(ABC, Generic[R]):
    """Typed rows, and the JSON text that each was read from.

    Attributes:
        name: table name without `.json`.
        file: the path, for error sentences.
        rows: typed rows.
        raw: JSON text of each row, in the same order; what is written for rows that stay.
        digest: SHA-256 (hex) of the file.
        size_bytes: size of the file.
    """

    name: str
    file: str
    rows: Sequence[R]
    raw: Sequence[RawRow]
    digest: str
    size_bytes: int

    @abstractmethod
    def find(self, tokens: Sequence[str]) -> Indices:
        """(n,) int64: where the rows with these tokens stand; EMPTY for an empty token, NOWHERE for an unknown one.

        Raises:
            DatasetError: two rows of the table have one token.
        """

    @abstractmethod
    def get(self, token: str, wanted_by: str) -> R:
        """The row of that token.

        Raises:
            DatasetError: no such row; `wanted_by` names the file, token and field that point to it.
        """

    def expect(self, tokens: Sequence[str]) -> None:
        """Says which tokens `get` will be asked for, many of them, soon."""
        return

    @abstractmethod
    def links(self, field: str, target: Table[Any]) -> Indices:
        """`target.find` for a field of all rows; a missing optional token counts as empty."""

    def unlinked(self, field: str, target: Table[Any], *, empty: bool) -> Indices:
        """The rows whose token `target` does not have; with `empty`, those too whose token is empty."""
        links = self.links(field, target)
        return np.flatnonzero(links < 0 if empty else links == NOWHERE)

    def leading_out(self, field: str, kept: Bool) -> Indices:
        """The rows that stay, and that point to one of the same table that does not, or is not there."""
        links = self.links(field, self)
        return np.flatnonzero(kept & (links != EMPTY) & ~are_kept(kept, links))

    @abstractmethod
    def rows_with_dangling(self, field: str, target: Table[Any]) -> Indices:
        """The rows whose list of tokens holds one that `target` does not have."""

    @abstractmethod
    def numbers(self, field: str) -> Float:
        """(n, k) float64: a field of k numbers, of all rows."""

    @abstractmethod
    def flags(self, field: str) -> Bool:
        """(n,) bool: a field that is true or false, of all rows."""

    @abstractmethod
    def names_to_check(self, rows: Indices, has_links: Callable[[str], bool]) -> Indices:
        """Of some rows with a `filename` those at which one must look to have checked them all.

        Args:
            rows: ascending.
            has_links: whether there are links in a folder (relative, POSIX).
        """

    @abstractmethod
    def rows_at(self, indices: Indices) -> Iterator[R]:
        """The typed rows at these indices."""

    @abstractmethod
    def parts_at(self, indices: Indices, part: type[P]) -> Iterator[P]:
        """The fields of `part`, of the rows at these indices."""

    @abstractmethod
    def raw_at(self, indices: Indices) -> Iterator[RawRow]:
        """The JSON text of the rows at these indices."""

    @abstractmethod
    def runs(self, indices: Indices, changes: Mapping[int, Mapping[str, Any]]) -> RawRows:
        """The JSON text of the rows at these indices, to be written, with the changed fields, by index, put in."""

    def place(self, row: Row, field: str) -> str:
        """How an error sentence names a field of a row."""
        return f"{self.file}, token {row.token}, field {field}"

    def nowhere(self, token: str, wanted_by: str) -> DatasetError:
        """The error for a token that no row has."""
        return DatasetError(
            f"points to {token!r}, which is not in {self.name}.json.",
            where=wanted_by,
            hint="The dataset is incomplete or was written by a broken converter.",
        )


@dataclass(frozen=True, eq=False)
class ListedTable(Table[R]):
    """A table whose rows are all in memory."""

    name: str
    file: str
    rows: list[R]
    raw: list[RawRow]
    digest: str
    size_bytes: int

    @cached_property
    def by_token(self) -> dict[str, R]:
        """Rows by token.

        Raises:
            DatasetError: two rows have one token.
        """
        return {token: self.rows[index] for token, index in self._index.items()}

    @cached_property
    def _index(self) -> dict[str, int]:
        index = {row.token: position for position, row in enumerate(self.rows)}
        if len(index) != len(self.rows):
            counts = Counter(row.token for row in self.rows)
            twice = next(token for token, count in counts.items() if count > 1)
            raise DatasetError(
                "two rows have this token; tokens must be unique.", where=f"{self.file}, token {twice}"
            )
        return index

    def find(self, tokens: Sequence[str]) -> Indices:
        index = self._index
        found = (index.get(token, NOWHERE) if token else EMPTY for token in tokens)
        return np.fromiter(found, dtype=np.int64, count=len(tokens))

    def get(self, token: str, wanted_by: str) -> R:
        row = self.by_token.get(token)
        if row is None:
            raise self.nowhere(token, wanted_by)
        return row

    def links(self, field: str, target: Table[Any]) -> Indices:
        return target.find([getattr(row, field) or "" for row in self.rows])

    def rows_with_dangling(self, field: str, target: Table[Any]) -> Indices:
        lists = [getattr(row, field) for row in self.rows]
        owners = np.repeat(np.arange(len(lists)), [len(tokens) for tokens in lists])
        dangling: Indices = np.unique(owners[target.find([token for tokens in lists for token in tokens]) < 0])
        return dangling

    def numbers(self, field: str) -> Float:
        rows = [getattr(row, field) for row in self.rows]
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(rows[0]) if rows else 0)

    def flags(self, field: str) -> Bool:
        return np.array([getattr(row, field) for row in self.rows], dtype=bool)

    def names_to_check(self, rows: Indices, has_links: Callable[[str], bool]) -> Indices:
        return rows

    def rows_at(self, indices: Indices) -> Iterator[R]:
        return (self.rows[index] for index in indices)

    def parts_at(self, indices: Indices, part: type[P]) -> Iterator[P]:
        return map(msgspec.json.Decoder(part).decode, self.raw_at(indices))

    def raw_at(self, indices: Indices) -> Iterator[RawRow]:
        return (self.raw[index] for index in indices)

    def runs(self, indices: Indices, changes: Mapping[int, Mapping[str, Any]]) -> RawRows:
        for index in indices.tolist():
            fields = changes.get(index)
            yield changed(self.raw[index], fields) if fields else self.raw[index]

    def mended(self, changes: Mapping[int, Mapping[str, Any]]) -> ListedTable[R]:
        """The table with changed fields, by index, put in; the digest stays that of the file."""
        rows: list[Any] = list(self.rows)
        raw = list(self.raw)
        decode = msgspec.json.Decoder(TABLES[self.name]).decode
        for index, fields in changes.items():
            raw[index] = changed(raw[index], fields)
            rows[index] = decode(raw[index])
        return replace(self, rows=rows, raw=raw)

    def only(self, kept: Bool) -> ListedTable[R]:
        """The table with some of its rows; the digest stays that of the file."""
        stays = np.flatnonzero(kept).tolist()
        return replace(self, rows=[self.rows[index] for index in stays], raw=[self.raw[index] for index in stays])

    def extended(self, records: Iterable[dict[str, Any]]) -> ListedTable[R]:
        """The table with further full records at its end; the digest stays that of the file."""
        added: ListedTable[R] = table_of(self.name, records)
        return replace(self, rows=[*self.rows, *added.rows], raw=[*self.raw, *added.raw])


def read_table(path: Path, name: str) -> ListedTable[Any]:
    """Reads one table into memory.

    Raises:
        DatasetError: missing, unreadable, not JSON, not a list, or a row with a missing or wrong field.
    """
    file = str(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(
            "this table is needed and missing.",
            where=file,
            hint="Unpack the dataset's metadata archive completely.",
        ) from error
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=file) from error
    try:
        if not data.isascii():
            data.decode()
    except UnicodeDecodeError as error:
        raise DatasetError(f"is not UTF-8 text (byte {error.start}).", where=file, hint=_AGAIN) from error
    try:
        raw = msgspec.json.decode(data, type=list[msgspec.Raw])
    except msgspec.ValidationError as error:
        raise DatasetError("is not a list of rows.", where=file) from error
    except (msgspec.DecodeError, RecursionError) as error:
        raise _malformed(data, file, str(error)) from error
    decode = msgspec.json.Decoder(TABLES[name]).decode
    rows: list[Any] = []
    try:
        for text in raw:
            rows.append(decode(text))
    except (msgspec.DecodeError, RecursionError) as error:
        raise bad_row(raw[len(rows)], len(rows), file, str(error)) from error
    return ListedTable(name, file, rows, list(raw), hashlib.sha256(data).hexdigest(), len(data))


def table_of(name: str, records: Iterable[dict[str, Any]]) -> ListedTable[Any]:
    """A table that no file holds, from full records."""
    raw = [msgspec.json.encode(record) for record in records]
    decode = msgspec.json.Decoder(TABLES[name]).decode
    digest = hashlib.sha256(b"\n".join(raw)).hexdigest()
    rows = [decode(text) for text in raw]
    return ListedTable(name, f"{name}.json", rows, list(raw), digest, sum(map(len, raw)))


class RowsFile:
    """A table that is written a part at a time, as a list with one row a line; it is in its place when closed.

    Attributes:
        count: how many rows were written.
    """

    def __init__(self, path: Path) -> None:
        self.count = 0
        self._path = path
        self._temporary = path.with_name(path.name + ".part")
        self._stream = self._temporary.open("wb", buffering=_BUFFER_BYTES)
        self._stream.write(b"[")

    def write(self, rows: RawRows) -> None:
        """Writes further rows of JSON text."""
        for run in _runs(rows):
            if run.number:
                self._stream.write(SEPARATOR if self.count else b"\n")
                self._stream.write(run.text)
                self.count += run.number

    def close(self) -> None:
        """Ends the list and brings the file to its place."""
        with self._stream as stream:
            stream.write(b"\n]\n")
            stream.flush()
            os.fsync(stream.fileno())
        self._temporary.replace(self._path)

    def abandon(self) -> None:
        """Closes what will not be brought to its place; a disk that is full by then is no news."""
        with contextlib.suppress(OSError):
            self._stream.close()


def write_rows(path: Path, rows: RawRows) -> int:
    """Writes rows of JSON text as a list, one row a line, atomically; returns their number."""
    file = RowsFile(path)
    try:
        file.write(rows)
    except BaseException:
        file.abandon()
        raise
    file.close()
    return file.count


def run_of(rows: Sequence[msgspec.Struct]) -> Run:
    """Rows as they are written; no line of JSON text has a line break in it."""
    return Run(len(rows), msgspec.json.Encoder().encode_lines(rows)[:-1].replace(b"\n", SEPARATOR))


def _runs(rows: RawRows) -> Iterator[Run]:
    """The rows that stand alone brought together."""
    alone: list[RawRow] = []
    for row in rows:
        if not isinstance(row, Run):
            alone.append(row)
            if len(alone) < _ROWS_A_WRITE:
                continue
        yield Run(len(alone), SEPARATOR.join(alone))
        alone.clear()
        if isinstance(row, Run):
            yield row
    yield Run(len(alone), SEPARATOR.join(alone))


def are_kept(kept: Bool, links: Indices) -> Bool:
    """Whether links lead to rows that stay; those that are empty or lead nowhere do not."""
    inside: Bool = (links >= 0) & kept[np.maximum(links, 0)]
    return inside


def changed(raw: RawRow, changes: Mapping[str, Any]) -> bytes:
    """The row's JSON text with some fields replaced; all others keep their order and their text."""
    record: dict[str, Any] = _TEXTS_OF_FIELDS.decode(raw)
    record.update(changes)
    return msgspec.json.encode(record)


def bad_row(text: RawRow, index: int, file: str, message: str) -> DatasetError:
    """The error for a row that could not be decoded: its token and field from msgspec's message."""
    where = f"{file}, row {index}"
    with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
        row = json.loads(bytes(text))
        where += f", token {row['token']}"
        for path in _non_finite(row):
            return DatasetError(_NON_FINITE, where=f"{where}, field {path}")
    match = re.fullmatch(r"(?P<what>.*?)(?: - at `\$\.?(?P<field>.*?)`)?", message, re.DOTALL)
    what, field = (match["what"], match["field"]) if match else (message, None)
    missing = re.fullmatch(r"Object missing required field `(.*)`", what)
    if missing:
        what, field = "the field is missing", missing.group(1)
    hint = "A quaternion w, x, y, z is expected." if field and field.startswith("rotation") else ""
    return DatasetError(f"{_decapitalised(what)}.", where=f"{where}, field {field}" if field else where, hint=hint)


def _malformed(data: bytes, file: str, message: str) -> DatasetError:
    """The sentence for a table that is not strict JSON: NaN is named by row, the rest by byte."""
    try:
        rows = json.loads(data)
    except (ValueError, RecursionError):
        rows = None
    for index, row in enumerate(rows if isinstance(rows, list) else []):
        for path in _non_finite(row):
            token = row.get("token") if isinstance(row, dict) else None
            return DatasetError(_NON_FINITE, where=f"{file}, row {index}, token {token}, field {path}")
    if "truncated" in message:
        message = f"the file ends in the middle after {len(data)} bytes: it was truncated"
    return DatasetError(f"is not valid JSON: {_decapitalised(message)}.", where=file, hint=_AGAIN)


def _decapitalised(message: str) -> str:
    return message if message[:4].isupper() else message[:1].lower() + message[1:]


def _non_finite(value: Any, path: str = "") -> Iterator[str]:
    if isinstance(value, float) and not math.isfinite(value):
        yield path
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _non_finite(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _non_finite(item, f"{path}[{index}]")
