"""One table: read with the file, token and field in every error; written one row a line."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.schema import TABLES, Row

R = TypeVar("R", bound=Row)
_AGAIN = "Unpack or copy the table again."


@dataclass(frozen=True, eq=False)
class Table(Generic[R]):
    """Typed rows beside the JSON text that each was read from.

    Attributes:
        name: table name without `.json`.
        file: the path, for error sentences.
        rows: typed rows.
        raw: JSON text of each row, in the same order; what is written for rows that stay.
        digest: SHA-256 (hex) of the file.
    """

    name: str
    file: str
    rows: list[R]
    raw: list[bytes | msgspec.Raw]
    digest: str

    @cached_property
    def by_token(self) -> dict[str, R]:
        """Rows by token.

        Raises:
            DatasetError: two rows have one token.
        """
        index = {row.token: row for row in self.rows}
        if len(index) != len(self.rows):
            counts = Counter(row.token for row in self.rows)
            twice = next(token for token, count in counts.items() if count > 1)
            raise DatasetError(
                "two rows have this token; tokens must be unique.", where=f"{self.file}, token {twice}"
            )
        return index

    def get(self, token: str, wanted_by: str) -> R:
        """The row of that token.

        Raises:
            DatasetError: no such row; `wanted_by` names the file, token and field that point to it.
        """
        row = self.by_token.get(token)
        if row is None:
            raise DatasetError(
                f"points to {token!r}, which is not in {self.name}.json.",
                where=wanted_by,
                hint="The dataset is incomplete or was written by a broken converter.",
            )
        return row

    def extended(self, records: Iterable[dict[str, Any]]) -> Table[R]:
        """The table with further full records at its end; the digest stays that of the file."""
        added: Table[R] = table_of(self.name, records)
        return replace(self, rows=[*self.rows, *added.rows], raw=[*self.raw, *added.raw])

    def place(self, row: Row, field: str) -> str:
        """How an error sentence names a field of a row."""
        return f"{self.file}, token {row.token}, field {field}"


def read_table(path: Path, name: str) -> Table[Any]:
    """Reads one table.

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
        raise _bad_row(raw[len(rows)], len(rows), file, str(error)) from error
    return Table(name, file, rows, list(raw), hashlib.sha256(data).hexdigest())


def table_of(name: str, records: Iterable[dict[str, Any]]) -> Table[Any]:
    """A table that no file holds, from full records."""
    raw = [msgspec.json.encode(record) for record in records]
    decode = msgspec.json.Decoder(TABLES[name]).decode
    digest = hashlib.sha256(b"\n".join(raw)).hexdigest()
    return Table(name, f"{name}.json", [decode(text) for text in raw], list(raw), digest)


def write_rows(path: Path, raw: Iterable[bytes | msgspec.Raw]) -> int:
    """Writes rows of JSON text as a list, one row a line, atomically; returns their number."""
    count = 0
    temporary = path.with_name(path.name + ".part")
    with temporary.open("wb") as stream:
        stream.write(b"[")
        for text in raw:
            stream.write(b",\n" if count else b"\n")
            stream.write(memoryview(text) if isinstance(text, msgspec.Raw) else text)
            count += 1
        stream.write(b"\n]\n")
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(path)
    return count


def changed(raw: bytes | msgspec.Raw, changes: Mapping[str, Any]) -> bytes:
    """The row's JSON text with some fields replaced; all others keep their order and values."""
    record: dict[str, Any] = msgspec.json.decode(raw)
    record.update(changes)
    return msgspec.json.encode(record)


def _bad_row(text: bytes | msgspec.Raw, index: int, file: str, message: str) -> DatasetError:
    where = f"{file}, row {index}"
    with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
        where += f", token {json.loads(bytes(text))['token']}"
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
            return DatasetError(
                "is NaN or infinite; a finite number was expected.",
                where=f"{file}, row {index}, token {token}, field {path}",
            )
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
