"""Rows that datasets have in common, or say in other words: sensors, calibrations, categories, maps and the like."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from unidrive_cli.errors import UsageError
from unidrive_cli.merge.renaming import Renaming
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.devkit import LABELS
from unidrive_cli.tables.schema import TABLES
from unidrive_cli.tables.table import RawRow
from unidrive_cli.tables.tokens import moved_token

Record = dict[str, Any]
UNITED = ("sensor", "calibrated_sensor", "category", "attribute", "visibility", "log", "map")
"""In an order in which a table comes after those that it points to."""


class United:
    """The united tables; datasets are added one after the other, and what was there first stays as it is."""

    def __init__(self) -> None:
        self._rows: dict[str, dict[str, Record]] = {name: {} for name in UNITED}
        """By table and token."""
        self._places: dict[str, dict[str, str]] = {name: {} for name in UNITED}
        """Tokens by table and by what makes two rows one."""
        self._indices: dict[Any, tuple[str, Path]] = {}
        self._labelled: Path | None = None

    def add(self, dataset: Dataset, renaming: Renaming) -> None:
        """Adds a dataset's rows; the tokens that change are noted in its renaming, which knows its files' new names.

        Raises:
            UsageError: a channel of several modalities, or labels of points that cannot be read together.
        """
        names = set(TABLES)
        for table in UNITED:
            renamed = renaming.tokens.setdefault(table, {})
            for raw in getattr(dataset, table).raw:
                old: Record = msgspec.json.decode(raw)
                record = renaming.record(table, {**old, "token": ""}, names) | {"token": old["token"]}
                token = self._add(table, record, renaming.plan_digest, dataset.folder)
                if token != old["token"]:
                    renamed[old["token"]] = token
        if any(name in dataset.extra_tables for name in LABELS):
            self._labelled = self._labelled or dataset.folder
            self._note_indices(dataset)

    def rows(self, table: str) -> list[RawRow]:
        """The rows of a united table, as they are written."""
        return [msgspec.json.encode(record) for record in self._rows[table].values()]

    def check_labels(self) -> None:
        """Refuses categories of which nuscenes-devkit could not tell the labels of points.

        Raises:
            UsageError: points are labelled, and a category has no `index`.
        """
        if self._labelled is None:
            return
        for record in self._rows["category"].values():
            if "index" not in record:
                raise UsageError(
                    f"the category {record['name']} has no index, and {self._labelled} labels points by it.",
                    hint="Take the category.json that came with the labels for all datasets.",
                )

    def _add(self, table: str, record: Record, plan_digest: str, folder: Path) -> str:
        """Adds a row, unless it is there; returns its token."""
        rows, place = self._rows[table], _KEYS[table](record)
        token = self._places[table].get(place)
        if token is not None:
            _join(table, rows[token], record, folder)
            return token
        token = record["token"]
        if token in rows:
            token = moved_token(table, token, plan_digest)
        self._places[table][place] = token
        rows[token] = {**record, "token": token}
        return token

    def _note_indices(self, dataset: Dataset) -> None:
        for raw in dataset.category.raw:
            record: Record = msgspec.json.decode(raw)
            for key, value in (("name", record["name"]), ("index", record.get("index"))):
                mine = f"{record['name']} {record.get('index')}"
                other, folder = self._indices.setdefault((key, value), (mine, dataset.folder))
                if other != mine and value is not None:
                    raise UsageError(
                        f"the points of {dataset.folder} and of {folder} are labelled by other numbers: "
                        f"{mine} here, {other} there.",
                        hint="Only datasets with the same index for every category can be merged with their labels.",
                    )


def _join(table: str, kept: Record, record: Record, folder: Path) -> None:
    """What a row says more than the one that it is united with."""
    if table == "map":
        kept["log_tokens"] = list(dict.fromkeys([*kept.get("log_tokens", []), *record.get("log_tokens", [])]))
    elif table == "category" and "index" in record:
        kept.setdefault("index", record["index"])
    elif table == "sensor" and kept["modality"] != record["modality"]:
        raise UsageError(
            f"{record['channel']} is a {record['modality']} in {folder}, and a {kept['modality']} in one before it."
        )


def _level(record: Record) -> str:
    return json.dumps([record["level"], record["token"] if record["level"] == "" else ""])


def _whole(*but: str) -> Callable[[Record], str]:
    return lambda record: json.dumps(
        {name: value for name, value in record.items() if name not in but}, sort_keys=True
    )


_KEYS: dict[str, Callable[[Record], str]] = {
    "sensor": lambda record: str(record["channel"]),
    "calibrated_sensor": _whole(),
    "category": lambda record: str(record["name"]),
    "attribute": lambda record: str(record["name"]),
    "visibility": _level,
    "log": _whole(),
    "map": _whole("log_tokens"),
}
"""What two rows of a united table have in common when they are one."""
