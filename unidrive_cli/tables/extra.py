"""Tables beyond the 13: lidarseg, panoptic, T4's and other JSON files of a version folder."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unidrive_cli.errors import DatasetError

IMAGE_ANNOTATIONS = "image_annotations"
"""2D boxes of pictures: never taken over, because the pictures leave; as large as all else together."""


@dataclass(frozen=True, eq=False)
class ExtraTable:
    """A JSON file that unidrive passes on.

    Attributes:
        path: the file.
        rows: its rows; None where it is no list of rows, and is carried as it is, and for IMAGE_ANNOTATIONS.
        digest: SHA-256 (hex) of the file.
    """

    path: Path
    rows: list[dict[str, Any]] | None
    digest: str

    def filename(self, row: dict[str, Any]) -> str:
        """The file that a row names, or an empty text."""
        name = row.get("filename")
        return name if isinstance(name, str) else ""


def read_extra_table(path: Path) -> ExtraTable:
    """Reads an extra table; NaN is accepted, because Python writes it.

    Raises:
        DatasetError: it is not JSON.
        OSError: it cannot be read.
    """
    if path.stem == IMAGE_ANNOTATIONS:
        digest = hashlib.sha256()
        with path.open("rb") as stream:
            for piece in iter(lambda: stream.read(1 << 20), b""):
                digest.update(piece)
        return ExtraTable(path, None, digest.hexdigest())
    data = path.read_bytes()
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DatasetError(
            f"is not valid JSON: {error}.", where=str(path), hint="Restore it, or move it out of the version folder."
        ) from error
    is_table = isinstance(document, list) and all(isinstance(row, dict) for row in document)
    return ExtraTable(path, document if is_table else None, hashlib.sha256(data).hexdigest())


def extra_table_paths(folder: Path, known: frozenset[str]) -> list[Path]:
    """The JSON files of a version folder that are none of the `known` tables; hidden files are left alone."""
    return [
        path
        for path in sorted(folder.glob("*.json"))
        if path.stem not in known and not path.name.startswith(".") and path.is_file()
    ]
